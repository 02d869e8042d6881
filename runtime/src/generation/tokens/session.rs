//! The planner with its buffers: reads a prompt once, then proposes and advances tokens step by step.

use super::condition::Condition;
use super::length;
use super::request::Planning;
#[cfg(feature = "residual")]
use super::residual::Residual;
use super::sampler::{Draw, Logits, TokenSampler};
use super::transformer::{Input, Planner};
use crate::codec::codebook::Codebooks;
use crate::conditioning::anchor_kv::{self, AnchorControl};
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::attention::SegmentMut;
use crate::nn::block::{BlockScratch, Sizes, StackScratch};
use crate::nn::linear::{LEAST_ROWS, MOST_ROWS};
use crate::numerics::hash::Stream;
use crate::request::conditions::AnchorSet;
use crate::request::prompt::{Prompt, PromptError, PromptStats};
use crate::stop::{Check, Stop};
use crate::text::bank;
use crate::text::meaning::{Meanings, Understood};
use crate::text::words::UNCONDITIONAL;
use crate::text::{Text, VECTORS};
use core::ops::ControlFlow;

/// What is worked in; there is room for it, since the session took as much.
macro_rules! worked_in {
    ($taken:expr $(, $otherwise:expr)?) => {{
        let taken = $taken;
        invariant!(taken.is_ok(), "the session took less than it works in");
        match taken {
            Ok(taken) => taken,
            Err(_) => return $($otherwise)?,
        }
    }};
}

#[cfg(feature = "residual")]
mod detail;
#[cfg(feature = "autoregressive")]
mod turns;

/// Tokens of a motion that the planner sees in front of the next clause of its prompt.
pub const CONTEXT: usize = 8;
/// Distance of the seeds of neighbouring segments or clauses: 2^64 over the golden ratio, odd.
pub const SEED_STEP: u64 = 0x9E37_79B9_7F4A_7C15;

/// The largest plan that is to be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlanningLimits {
    /// Words of the prompt, or rows of a stored one.
    pub words: usize,
    /// Steps of the sampler.
    pub steps: u16,
    /// Whether guidance is on.
    pub guided: bool,
    /// Whether anchors condition the planner; of no account when the blob has no anchor control.
    pub anchors: bool,
    /// Clauses of the prompt ([`crate::Clauses`]), each of which is planned for itself; 1 for any other. They cost time and no memory.
    pub clauses: usize,
}

/// Modules of a model that a session works with.
#[derive(Debug, Clone, Copy)]
pub struct Modules<'m, 'b> {
    /// Text encoder and stored prompts.
    pub text: &'m Text<'b>,
    /// Planner.
    pub planner: &'m Planner<'b>,
    /// What anchors tell the planner.
    pub control: Option<&'m AnchorControl<'b>>,
    /// The metric's code vectors.
    pub codebooks: &'m Codebooks<'b>,
    /// Planner of the further quantizers.
    #[cfg(feature = "residual")]
    pub residual: Option<&'m Residual<'b>>,
}

/// Buffer lengths of a session.
#[derive(Debug, Clone, Copy)]
struct Lengths {
    words: usize,
    /// Rows of the prompt that says nothing; 0 unless guidance takes two passes.
    unconditional: usize,
    /// Phrases that a prompt may mean.
    phrases: usize,
    /// Rows of the anchors' keys and values, rows that anchors tell something; 0 without them.
    anchors: (usize, usize),
    tokens: usize,
    /// The longest of memory, scaffold and planner rows.
    x: usize,
    own: usize,
    own_scales: usize,
    /// Of low planes of keys and values.
    #[cfg(feature = "wide-layers")]
    own_low: usize,
    guided: usize,
    /// Rows whose keys and values are kept from one token to the next.
    #[cfg(feature = "autoregressive")]
    cached: usize,
    /// Of reading anchors.
    work: usize,
    /// Of a pass.
    sizes: Sizes,
}

#[cfg(feature = "residual")]
impl Lengths {
    /// Those that serve the planner of further quantizers as well.
    fn with(self, residual: &Residual<'_>) -> Self {
        let (rows, width) = (2 + self.tokens, residual.width());
        Lengths {
            x: self.x.max(rows * width),
            own: self.own.max(rows * width),
            #[cfg(feature = "wide-layers")]
            own_low: self.own_low.max(if residual.wide() { self.own.max(rows * width) } else { 0 }),
            own_scales: self.own_scales.max(rows * residual.heads().count),
            guided: self.guided.max(if residual.guided() { self.tokens * width } else { 0 }),
            sizes: self.sizes.with(residual.sizes(self.tokens)),
            ..self
        }
    }
}

/// PlanningBytes of a session by purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PlanningBytes {
    /// Keys and values of prompts.
    pub text: usize,
    /// Keys and values of anchors, and what they tell each row.
    pub anchors: usize,
    /// Rows, proposals and what was read.
    pub rows: usize,
    /// One pass of the planner.
    pub pass: usize,
    /// Drawing tokens by the last pass, in the place of that pass.
    pub draw: usize,
}

impl PlanningBytes {
    /// In all.
    #[must_use]
    pub const fn all(&self) -> usize {
        self.text + self.anchors + self.rows + self.working()
    }

    /// Of [`PlanningBytes::pass`] and [`PlanningBytes::draw`], which take turns.
    #[must_use]
    pub const fn working(&self) -> usize {
        if self.pass > self.draw { self.pass } else { self.draw }
    }
}

/// What the blocks work in, while text and anchors are read and in each pass over the tokens.
#[derive(Debug)]
struct Pass<'s> {
    keys: &'s mut [i8],
    values: &'s mut [i8],
    key_scales: &'s mut [f32],
    value_scales: &'s mut [f32],
    /// Low planes of keys and values, where these have 16 bits.
    #[cfg(feature = "wide-layers")]
    low: (&'s mut [i8], &'s mut [i8]),
    scratch: BlockScratch<'s>,
    /// Rows of the pass that knows the prompt, `[L][d]`; none without guidance.
    guided: &'s mut [f32],
    /// Of reading anchors.
    work: &'s mut [f32],
}

impl<'s> Pass<'s> {
    fn new(arena: &mut Arena<'s>, l: &Lengths) -> Result<Self, ArenaTooSmall> {
        Ok(Pass {
            keys: arena.take(l.own)?,
            values: arena.take(l.own)?,
            key_scales: arena.take(l.own_scales)?,
            value_scales: arena.take(l.own_scales)?,
            #[cfg(feature = "wide-layers")]
            low: (arena.take(l.own_low)?, arena.take(l.own_low)?),
            scratch: BlockScratch::new(arena, &l.sizes)?,
            guided: arena.take(l.guided)?,
            work: arena.take(l.work)?,
        })
    }

    /// For so many rows.
    fn rows(&mut self, rows: usize) -> StackScratch<'_, 's> {
        let Pass { keys, values, key_scales, value_scales, scratch, .. } = self;
        StackScratch {
            own: SegmentMut {
                rows,
                keys,
                key_scales,
                values,
                value_scales,
                #[cfg(feature = "wide-layers")]
                low: (self.low.0, self.low.1),
            },
            block: scratch,
        }
    }
}

impl<'r> Reading<'r> {
    /// Of a prompt whose memory has so many rows.
    const fn of(prompt: &Prompt<'r>, rows: usize) -> Self {
        match *prompt {
            Prompt::Bank(name) => Reading::Stored(name),
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            Prompt::Vector(vector) => Reading::Vector(vector),
            _ => Reading::Words(rows),
        }
    }

    /// What was encoded elsewhere: its memory, at the front of `x`, and its pooled vector. Nothing of words.
    fn recall<'x>(self, text: &Text<'_>, x: &'x mut [f32], pooled: &mut [f32]) -> &'x mut [f32] {
        match self {
            Reading::Words(_) => &mut [],
            Reading::Stored(name) => match text.bank().get(name) {
                None => &mut [],
                Some(entry) => {
                    let memory = part_mut!(x, ..entry.rows() * text.width());
                    entry.read(memory, pooled);
                    memory
                }
            },
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            Reading::Vector(vector) => {
                for (i, to) in pooled.iter_mut().enumerate() {
                    *to = vector.get(i).copied().unwrap_or(0.0);
                }
                &mut []
            }
        }
    }
}

impl<'m, 'b> Modules<'m, 'b> {
    /// Quantizers of a planned motion: planners that read words know one.
    #[must_use]
    pub const fn quantizers(&self) -> usize {
        let quantizers = self.codebooks.quantizers();
        if VECTORS && quantizers > 1 { quantizers } else { 1 }
    }

    /// Anchor control, where the blob has it and anchors are to condition the planner.
    fn control(&self, limits: &PlanningLimits) -> Option<&'m AnchorControl<'b>> {
        self.control.filter(|_| limits.anchors)
    }

    /// Rows of the prompt that says nothing.
    fn unconditional_rows(&self) -> usize {
        match self.text.encoder() {
            Some(_) => 1,
            None => self.text.bank().get(bank::UNCONDITIONAL).map_or(0, |entry| entry.rows()),
        }
    }

    /// Takes what so many tokens are drawn in, behind a pass that left hidden rows `[L][d]`.
    fn draw<'l, 's, S: TokenSampler>(
        &self,
        sampler: &S,
        tokens: usize,
        rows: &'l [f32],
        arena: &mut Arena<'s>,
    ) -> Result<(Logits<'l, 'b, 's>, S::Work<'s>), ArenaTooSmall>
    where
        'm: 'l,
    {
        Ok((Logits::new(self.planner.head(), rows, arena)?, sampler.layout(arena, tokens, self.codebooks)?))
    }

    /// Bytes of drawing so many tokens.
    fn draw_bytes(&self, tokens: usize) -> usize {
        let drawn = Arena::measure(|arena| self.draw(self.planner.sampler(), tokens, &[], arena));
        #[cfg(feature = "residual")]
        if let Some(residual) = self.residual {
            let head = residual.head(1);
            let detail = head.map_or(0, |head| Arena::measure(|arena| Logits::new(&head, &[], arena)));
            return if detail > drawn { detail } else { drawn };
        }
        drawn
    }

    /// Whether guidance takes a second pass.
    fn two_passes(&self, limits: &PlanningLimits) -> bool {
        limits.guided && self.planner.two_passes()
    }

    fn lengths(&self, tokens: usize, limits: &PlanningLimits, rows: usize) -> Lengths {
        let most = |a: usize, b: usize| if a > b { a } else { b };
        let guided = self.two_passes(limits);
        let unconditional = if guided { self.unconditional_rows() } else { 0 };
        let phrases = self.text.meanings().map_or(0, Meanings::len);
        let (words, memory) = (limits.words, most(limits.words, unconditional));
        let (d, dt) = (self.planner.width(), self.text.width());
        // Of a planner of a token at a time keys and values of all rows are kept, and one row passes.
        let in_turn = self.planner.in_turn();
        let own_rows = if in_turn { 1 } else { 1 + tokens };
        let control = self.control(limits);
        let anchors = control.map_or((0, 0), |control| (tokens, control.biased_rows(tokens)));
        let mut sizes = self.planner.sizes(tokens, anchors.0, memory);
        let outputs = most(self.text.length().outputs(), phrases);
        sizes = sizes.with(Sizes { outputs, inputs: dt, ..Sizes::default() });
        let kept = if in_turn { 0 } else { own_rows };
        let (mut own, mut own_scales) = (kept * d, kept * self.planner.heads().count);
        if let Some(encoder) = self.text.encoder() {
            sizes = sizes.with(encoder.sizes(memory));
            own = most(own, memory * dt);
            own_scales = most(own_scales, memory * encoder.stack().heads().count);
        }
        let (mut x, mut work) = (most(memory * dt, own_rows * d), 0);
        if let Some(control) = control {
            sizes = sizes.with(control.sizes(tokens));
            own = most(own, tokens * control.scaffold_width());
            own_scales = most(own_scales, tokens * control.scaffold_heads().count);
            x = most(x, tokens * control.scaffold_width());
            work = control.work();
        }
        sizes.rows = rows.clamp(LEAST_ROWS, MOST_ROWS);
        let lengths = Lengths {
            words,
            unconditional,
            phrases,
            anchors,
            tokens,
            x,
            own,
            own_scales,
            #[cfg(feature = "wide-layers")]
            own_low: if self.planner.wide() { own } else { 0 },
            guided: if guided { tokens * d } else { 0 },
            #[cfg(feature = "autoregressive")]
            cached: if in_turn { 1 + tokens } else { 0 },
            work,
            sizes,
        };
        #[cfg(feature = "residual")]
        let lengths = self.residual.map_or(lengths, |residual| lengths.with(residual));
        lengths
    }

    /// Arena bytes of [`Session::new`].
    #[must_use]
    #[inline(never)]
    pub fn bytes(&self, tokens: usize, limits: &PlanningLimits, rows: usize) -> PlanningBytes {
        let session = Session::new(*self, &mut Arena::measuring(), tokens, limits, rows);
        invariant!(session.is_ok(), "an arena that measures refuses nothing");
        session.map_or(PlanningBytes::default(), |session| session.bytes)
    }

    /// Multiply-accumulates of a plan at most: text and anchors read, all passes, logits and distances of every position and step.
    #[must_use]
    pub fn macs(&self, tokens: usize, limits: &PlanningLimits) -> u64 {
        let more = limits.clauses.saturating_sub(1);
        // The work grows faster than the motion: parts of it, each behind its context, take less than all of them at once.
        let parts = self.macs_of(tokens + more * CONTEXT, limits);
        // The whole is read first, each clause twice.
        if more == 0 { parts } else { parts + (2 * more + 2) as u64 * self.macs_of(1, limits) }
    }

    /// The same of one clause.
    fn macs_of(&self, tokens: usize, limits: &PlanningLimits) -> u64 {
        let guided = self.two_passes(limits);
        let unconditional = if guided { self.unconditional_rows() } else { 0 };
        let encode = |rows: usize| self.text.encoder().map_or(0, |encoder| encoder.macs(rows));
        let each = |rows: usize| {
            if rows == 0 && !self.text.takes_vectors() { 0 } else { encode(rows) + self.planner.read_macs(rows) }
        };
        let (anchors, scaffold) = self.control(limits).map_or((0, 0), |control| (tokens, control.macs(tokens)));
        let meanings = self.text.meanings().map_or(0, |meanings| meanings.head().macs());
        let read = each(limits.words) + each(unconditional) + self.text.length().macs() + meanings + scaffold;
        let guided = if guided { self.planner.pass_macs(tokens, 0, unconditional) } else { 0 };
        let passes = self.planner.pass_macs(tokens, anchors, limits.words) + guided;
        let position = self.planner.logits_macs() + self.planner.sampler().macs(self.codebooks);
        let planned = read + u64::from(limits.steps) * (passes + tokens as u64 * position);
        #[cfg(feature = "autoregressive")]
        let planned = match self.planner.in_turn() {
            true => read + self.planner.turns_macs(tokens) + tokens as u64 * position,
            false => planned,
        };
        #[cfg(feature = "residual")]
        let planned = planned + self.residual.map_or(0, |residual| residual.macs(tokens));
        planned
    }
}

/// What is to be read.
#[derive(Debug, Clone, Copy)]
enum Reading<'r> {
    /// The words' ids are in the session.
    Words(usize),
    Stored(&'r str),
    /// What stands for the whole prompt; empty: zeros, which say nothing.
    #[cfg(any(feature = "masked", feature = "autoregressive"))]
    Vector(&'r [f32]),
}

/// The planner at work on one request.
#[derive(Debug)]
pub struct Session<'m, 'b, 'w> {
    modules: Modules<'m, 'b>,
    text: Condition<'w>,
    unconditional: Condition<'w>,
    anchors: Condition<'w>,
    /// Keys and values of the rows so far, of a planner of a token at a time.
    #[cfg(feature = "autoregressive")]
    cache: Condition<'w>,
    /// `[words]`
    words: &'w mut [u16],
    /// `[dt]`
    pooled: &'w mut [f32],
    /// `[max_tokens]`
    lengths: &'w mut [f32],
    /// `[phrases]`
    meanings: &'w mut [f32],
    /// Memory `[n][dt]` while text is read, the scaffold `[L][ds]` while anchors are, then rows `[1 + L][d]`.
    x: &'w mut [f32],
    /// `[L]`
    proposal: &'w mut [u16],
    predicted: usize,
    needed: Lengths,
    /// What it has taken.
    bytes: PlanningBytes,
    /// Where passes and draws take turns.
    spare: Arena<'w>,
}

impl<'m, 'b, 'w> Session<'m, 'b, 'w> {
    /// Takes the buffers for motions of up to `tokens` tokens, of whose rows so many pass at a time ([`crate::PlanningLimits::rows`]).
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn new(
        modules: Modules<'m, 'b>,
        arena: &mut Arena<'w>,
        tokens: usize,
        limits: &PlanningLimits,
        rows: usize,
    ) -> Result<Self, ArenaTooSmall> {
        let l = modules.lengths(tokens, limits, rows);
        let begin = arena.used();
        let text = Condition::new(modules.planner, arena, l.words, 1)?;
        let unconditional = Condition::new(modules.planner, arena, l.unconditional, usize::from(l.guided > 0))?;
        let of_text = arena.used() - begin;
        let anchors = Condition::new(modules.planner, arena, l.anchors.0, l.anchors.1)?;
        let of_anchors = arena.used() - begin - of_text;
        #[cfg(feature = "autoregressive")]
        let mut cache = Condition::new(modules.planner, arena, l.cached, 0)?;
        #[cfg(feature = "autoregressive")]
        {
            cache.rows = l.cached;
        }
        let words = arena.take(l.words)?;
        let pooled = arena.take(modules.text.width())?;
        let lengths = arena.take(modules.text.length().outputs())?;
        let meanings = arena.take(l.phrases)?;
        let x = arena.take(l.x)?;
        let proposal = arena.take(l.tokens)?;
        let bytes = PlanningBytes {
            text: of_text,
            anchors: of_anchors,
            rows: arena.used() - begin - of_text - of_anchors,
            pass: Arena::measure(|arena| Pass::new(arena, &l)),
            draw: modules.draw_bytes(l.tokens),
        };
        let spare = arena.part(bytes.working())?;
        let (predicted, needed) = (0, l);
        Ok(Session {
            modules,
            text,
            unconditional,
            anchors,
            #[cfg(feature = "autoregressive")]
            cache,
            words,
            pooled,
            lengths,
            meanings,
            x,
            proposal,
            predicted,
            needed,
            bytes,
            spare,
        })
    }

    /// Encodes `prompt`, and the prompt that says nothing if the session is guided, and predicts the length.
    ///
    /// # Errors
    /// A [`PromptError`]. Breaks off when `check`, which is asked behind every block, says so.
    pub fn read(
        &mut self,
        prompt: &Prompt<'_>,
        check: Check<'_>,
    ) -> Result<ControlFlow<Stop, PromptStats>, PromptError> {
        let rows = self.modules.text.rows(prompt)?;
        let heard = match *prompt {
            Prompt::Text(text) => self.modules.text.ids(text, self.words)?,
            Prompt::Bank(_) | Prompt::Vector(_) => {
                PromptStats { words: u16::try_from(rows).unwrap_or(u16::MAX), ..PromptStats::default() }
            }
        };
        Ok(match self.read_both(Reading::of(prompt, rows), check) {
            ControlFlow::Continue(understood) => ControlFlow::Continue(PromptStats { understood, ..heard }),
            ControlFlow::Break(stop) => ControlFlow::Break(stop),
        })
    }

    fn read_both(&mut self, reading: Reading<'_>, check: Check<'_>) -> ControlFlow<Stop, Option<Understood>> {
        self.encode(reading, false, check)?;
        let mut spare = self.spare.overlay();
        let mut pass = worked_in!(Pass::new(&mut spare, &self.needed), ControlFlow::Continue(None));
        pass.scratch.linear(self.modules.text.length(), self.pooled, self.lengths);
        self.predicted = length::median(self.lengths);
        let meanings = self.modules.text.meanings();
        let understood = meanings.map(|all| all.understand(self.pooled, self.meanings, &mut pass.scratch));
        if self.needed.guided == 0 {
            return ControlFlow::Continue(understood);
        }
        let unconditional = match self.modules.text.encoder() {
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            None if self.modules.text.takes_vectors() => Reading::Vector(&[]),
            None => Reading::Stored(bank::UNCONDITIONAL),
            Some(_) => {
                if let Some(word) = self.words.first_mut() {
                    *word = UNCONDITIONAL;
                }
                Reading::Words(1)
            }
        };
        self.encode(unconditional, true, check)?;
        ControlFlow::Continue(understood)
    }

    fn encode(&mut self, reading: Reading<'_>, unconditional: bool, check: Check<'_>) -> ControlFlow<Stop> {
        let Modules { text, planner, .. } = self.modules;
        let mut spare = self.spare.overlay();
        let mut pass = worked_in!(Pass::new(&mut spare, &self.needed), ControlFlow::Continue(()));
        let width = text.width();
        let memory = match reading {
            Reading::Words(count) => {
                let memory = part_mut!(self.x, ..count * width);
                if let Some(encoder) = text.encoder() {
                    let words = part!(self.words, ..count);
                    encoder.encode(words, memory, self.pooled, &mut pass.rows(count), check)?;
                }
                memory
            }
            encoded => encoded.recall(text, self.x, self.pooled),
        };
        let condition = if unconditional { &mut self.unconditional } else { &mut self.text };
        planner.read(memory, self.pooled, condition, &mut pass.scratch, check)
    }

    /// Reads the anchors of a motion of `tokens` tokens, no more than the session was made for: from here on they condition every
    /// pass. Without room for them ([`PlanningLimits::anchors`]), or with none of a family that the planner was trained for, nothing
    /// happens.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn anchor(&mut self, anchors: &AnchorSet, tokens: usize, check: Check<'_>) -> ControlFlow<Stop> {
        let Modules { planner, control: Some(control), .. } = self.modules else { return ControlFlow::Continue(()) };
        if self.needed.anchors.0 == 0 || !anchors.iter().any(|anchor| control.sees(anchor.family)) {
            return ControlFlow::Continue(());
        }
        let h = part_mut!(self.x, ..tokens * control.scaffold_width());
        let mut spare = self.spare.overlay();
        let mut pass = worked_in!(Pass::new(&mut spare, &self.needed), ControlFlow::Continue(()));
        let work = core::mem::take(&mut pass.work);
        let buffers = anchor_kv::Buffers { h, work };
        control.read(planner, anchors, buffers, &mut self.anchors, &mut pass.rows(tokens), check)
    }

    /// The length that the text suggests, tokens.
    #[must_use]
    pub const fn predicted_length(&self) -> usize {
        self.predicted
    }

    /// Where the model's sampler begins.
    pub fn begin(&self, planning: &Planning<'_>, random: &mut Stream, tokens: &mut [u16]) {
        let planner = self.modules.planner;
        planner.sampler().begin(planning, planner.codes(), random, tokens);
    }

    /// The time of step `step` of the model's sampler, counted from 0.
    #[must_use]
    pub fn time(&self, planning: &Planning<'_>, step: u16) -> f32 {
        self.modules.planner.sampler().time(planning, step)
    }

    /// One pass over `tokens` at time `time`, two where guidance takes a second one: what [`Session::logits`] and [`Session::advance`] read.
    /// No more tokens than the session was made for, each in the codebook, or V, a masked one, where the sampler masks.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn pass(&mut self, tokens: &[u16], time: f32, planning: &Planning<'_>, check: Check<'_>) -> ControlFlow<Stop> {
        let planner = self.modules.planner;
        let width = planner.width();
        let rows = 1 + tokens.len();
        let x = part_mut!(self.x, ..rows * width);
        let mut spare = self.spare.overlay();
        let mut pass = worked_in!(Pass::new(&mut spare, &self.needed), ControlFlow::Continue(()));
        let guided = core::mem::take(&mut pass.guided);
        let mut scratch = pass.rows(rows);
        let input = Input { tokens, time, planning };
        planner.forward(&input, &self.text, Some(&self.anchors), x, &mut scratch, check)?;
        if !planning.guided() || guided.is_empty() {
            return ControlFlow::Continue(());
        }
        for (to, from) in guided.iter_mut().zip(x.iter().skip(width)) {
            *to = *from;
        }
        // What guides is text and anchors together: the other end knows neither.
        planner.forward(&input, &self.unconditional, None, x, &mut scratch, check)?;
        for (unconditional, text) in x.iter_mut().skip(width).zip(guided.iter()) {
            *unconditional += planning.guidance * (*text - *unconditional);
        }
        ControlFlow::Continue(())
    }

    /// Guided logits `[V]` of one position, as the last pass left them.
    pub fn logits(&mut self, position: usize) -> &[f32] {
        let planner = self.modules.planner;
        let width = planner.width();
        let row = part!(self.x, (1 + position) * width..(2 + position) * width);
        let mut spare = self.spare.overlay();
        let mut logits = worked_in!(Logits::new(planner.head(), row, &mut spare), &[]);
        logits.each(|_, _| {});
        logits.first()
    }

    /// Moves `tokens` on by step `step` of the model's sampler, counted from 0, by the last pass; without a step it is the last one.
    pub fn advance(&mut self, planning: &Planning<'_>, step: Option<u16>, random: &mut Stream, tokens: &mut [u16]) {
        self.advance_by(self.modules.planner.sampler(), planning, step, random, tokens);
    }

    /// The same by another sampler, which must not need more memory than the model's.
    pub fn advance_by<S: TokenSampler>(
        &mut self,
        sampler: &S,
        planning: &Planning<'_>,
        step: Option<u16>,
        random: &mut Stream,
        tokens: &mut [u16],
    ) {
        let (modules, width) = (self.modules, self.modules.planner.width());
        let rows = part!(self.x, width..(1 + tokens.len()) * width);
        let mut spare = self.spare.overlay();
        let (mut logits, mut work) = worked_in!(modules.draw(sampler, tokens.len(), rows, &mut spare));
        let draw = Draw { planning, random, tokens, proposals: self.proposal };
        match step {
            Some(step) => sampler.step(step, &mut logits, modules.codebooks, &mut work, draw),
            None => sampler.finish(&mut logits, &mut work, draw),
        }
    }

    /// The proposals of the last [`Session::advance`].
    #[must_use]
    pub fn proposal(&self) -> &[u16] {
        self.proposal
    }
}
