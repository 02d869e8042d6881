//! The planner with its buffers: reads a prompt once, then proposes and advances tokens step by step.

use super::condition::Condition;
use super::control::Control;
use super::length;
use super::request::Planning;
use super::sampling::Sampling;
use super::tmd::{Metric, Step, Tmd};
use super::transformer::{Input, Planner};
use crate::decoding::codebook::Codebooks;
use crate::hash::Stream;
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::attention::SegmentMut;
use crate::nn::block::{Scratch, Sizes};
use crate::nn::linear::{LEAST_ROWS, MOST_ROWS};
use crate::nn::{Check, Interrupted};
use crate::perception::Text;
use crate::perception::anchors::AnchorSet;
use crate::perception::bank;
use crate::perception::prompt::{Heard, Prompt, PromptError};
use crate::perception::text::NONE;

/// Positions whose tokens are drawn together: the logits of more than these would take more memory than a pass.
const DRAWN: usize = 4;

/// The largest plan that is to be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Words of the prompt, or rows of a stored one.
    pub words: usize,
    /// Steps of the sampler.
    pub steps: u16,
    /// Whether guidance is on.
    pub guided: bool,
    /// Whether anchors condition the planner; of no account when the blob has no anchor control.
    pub anchors: bool,
}

/// Modules of a model that a session works with.
#[derive(Debug, Clone, Copy)]
pub struct Modules<'m, 'b> {
    /// Text encoder and stored prompts.
    pub text: &'m Text<'b>,
    /// Planner.
    pub planner: &'m Planner<'b>,
    /// What anchors tell the planner.
    pub control: Option<&'m Control<'b>>,
    /// The metric's code vectors.
    pub codebooks: &'m Codebooks<'b>,
}

/// Buffer lengths of a session.
#[derive(Debug, Clone, Copy)]
struct Lengths {
    words: usize,
    /// Rows of the prompt that says nothing; 0 without guidance.
    none: usize,
    /// Rows of the anchors' keys and values, rows that anchors tell something; 0 without them.
    anchors: (usize, usize),
    tokens: usize,
    /// The longest of memory, scaffold and planner rows.
    x: usize,
    own: usize,
    own_scales: usize,
    guided: usize,
    /// Of reading anchors.
    work: usize,
    codes: usize,
    /// Of the metric.
    units: usize,
    /// Of a pass, and of its logits.
    sizes: Sizes,
    logits: Sizes,
}

/// Bytes of a session by purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Bytes {
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

impl Bytes {
    /// In all.
    #[must_use]
    pub const fn all(&self) -> usize {
        self.text + self.anchors + self.rows + self.working()
    }

    /// Of [`Bytes::pass`] and [`Bytes::draw`], which take turns.
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
    scratch: Scratch<'s>,
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
            scratch: Scratch::new(arena, &l.sizes)?,
            guided: arena.take(l.guided)?,
            work: arena.take(l.work)?,
        })
    }

    /// Room for the keys and values of so many rows, and the rest.
    fn split(&mut self, rows: usize) -> (SegmentMut<'_>, &mut Scratch<'s>) {
        let Pass { keys, values, key_scales, value_scales, scratch, .. } = self;
        (SegmentMut { rows, keys, key_scales, values, value_scales }, scratch)
    }
}

/// What tokens are drawn in.
#[derive(Debug)]
struct Draw<'s> {
    scratch: Scratch<'s>,
    /// `[DRAWN][V]`
    logits: &'s mut [f32],
    /// `[V]`
    weights: &'s mut [f32],
    /// Of the metric, `[V][du]`.
    units: &'s mut [f32],
}

impl<'s> Draw<'s> {
    fn new(arena: &mut Arena<'s>, l: &Lengths) -> Result<Self, ArenaTooSmall> {
        Ok(Draw {
            scratch: Scratch::new(arena, &l.logits)?,
            logits: arena.take(DRAWN * l.codes)?,
            weights: arena.take(l.codes)?,
            units: arena.take(l.units)?,
        })
    }

    /// Computes the logits `[..][V]` of up to [`DRAWN`] positions, of the rows of a pass from theirs on.
    fn block(&mut self, planner: &Planner<'_>, rows: &[f32]) {
        let (width, codes) = (planner.width().max(1), planner.codes());
        let count = (rows.len() / width).min(DRAWN);
        if let (Some(rows), Some(logits)) = (rows.get(..count * width), self.logits.get_mut(..count * codes)) {
            planner.logits(rows, logits, &mut self.scratch);
        }
    }
}

impl<'m, 'b> Modules<'m, 'b> {
    /// Anchor control, where the blob has it and anchors are to condition the planner.
    fn control(&self, limits: &Limits) -> Option<&'m Control<'b>> {
        self.control.filter(|_| limits.anchors)
    }

    /// Rows of the prompt that says nothing.
    fn none_rows(&self) -> usize {
        match self.text.encoder() {
            Some(_) => 1,
            None => self.text.bank().get(bank::NONE).map_or(0, |entry| entry.rows()),
        }
    }

    fn lengths(&self, tokens: usize, limits: &Limits, rows: usize) -> Lengths {
        let most = |a: usize, b: usize| if a > b { a } else { b };
        let none = if limits.guided { self.none_rows() } else { 0 };
        let (words, memory) = (limits.words, most(limits.words, none));
        let (d, dt) = (self.planner.width(), self.text.width());
        let own_rows = 1 + tokens;
        let control = self.control(limits);
        let anchors = control.map_or((0, 0), |control| (tokens, control.shares(tokens)));
        let mut sizes = self.planner.sizes(tokens, anchors.0, memory);
        sizes = sizes.with(Sizes { outputs: self.text.length().outputs(), inputs: dt, ..Sizes::default() });
        let (mut own, mut own_scales) = (own_rows * d, own_rows * self.planner.heads().count);
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
        Lengths {
            words,
            none,
            anchors,
            tokens,
            x,
            own,
            own_scales,
            guided: if limits.guided { tokens * d } else { 0 },
            work,
            codes: self.planner.codes(),
            units: Metric::len(self.codebooks),
            sizes,
            logits: self.planner.logits_sizes(DRAWN),
        }
    }

    /// Arena bytes of [`Session::new`].
    #[must_use]
    #[inline(never)]
    pub fn bytes(&self, tokens: usize, limits: &Limits, rows: usize) -> Bytes {
        let session = Session::new(*self, &mut Arena::measuring(), tokens, limits, rows);
        invariant!(session.is_ok(), "an arena that measures refuses nothing");
        session.map_or(Bytes::default(), |session| session.bytes)
    }

    /// Multiply-accumulates of a plan at most: text and anchors read, all passes, logits and distances of every position and step.
    #[must_use]
    pub fn macs(&self, tokens: usize, limits: &Limits) -> u64 {
        let none = if limits.guided { self.none_rows() } else { 0 };
        let encode = |rows: usize| self.text.encoder().map_or(0, |encoder| encoder.macs(rows));
        let each = |rows: usize| {
            if rows == 0 { 0 } else { encode(rows) + self.planner.read_macs(rows) }
        };
        let (anchors, scaffold) = self.control(limits).map_or((0, 0), |control| (tokens, control.macs(tokens)));
        let read = each(limits.words) + each(none) + self.text.length().macs() + scaffold;
        let guided = if none == 0 { 0 } else { self.planner.pass_macs(tokens, 0, none) };
        let passes = self.planner.pass_macs(tokens, anchors, limits.words) + guided;
        let position = self.planner.logits_macs() + Metric::len(self.codebooks) as u64;
        read + u64::from(limits.steps) * (passes + tokens as u64 * position)
    }
}

/// What is to be read.
#[derive(Debug, Clone, Copy)]
enum Reading<'r> {
    /// The words' ids are in the session.
    Words(usize),
    Stored(&'r str),
}

/// The planner at work on one request.
#[derive(Debug)]
pub struct Session<'m, 'b, 'w> {
    modules: Modules<'m, 'b>,
    text: Condition<'w>,
    none: Condition<'w>,
    anchors: Condition<'w>,
    /// `[words]`
    words: &'w mut [u16],
    /// `[dt]`
    pooled: &'w mut [f32],
    /// `[max_tokens]`
    lengths: &'w mut [f32],
    /// Memory `[n][dt]` while text is read, the scaffold `[L][ds]` while anchors are, then rows `[1 + L][d]`.
    x: &'w mut [f32],
    /// `[L]`
    proposal: &'w mut [u16],
    predicted: usize,
    needed: Lengths,
    /// What it has taken.
    bytes: Bytes,
    /// Where [`Pass`] and [`Draw`] take turns.
    spare: Arena<'w>,
}

impl<'m, 'b, 'w> Session<'m, 'b, 'w> {
    /// Takes the buffers for motions of up to `tokens` tokens, of whose rows so many pass at a time ([`crate::Limits::rows`]).
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn new(
        modules: Modules<'m, 'b>,
        arena: &mut Arena<'w>,
        tokens: usize,
        limits: &Limits,
        rows: usize,
    ) -> Result<Self, ArenaTooSmall> {
        let l = modules.lengths(tokens, limits, rows);
        let begin = arena.used();
        let text = Condition::new(modules.planner, arena, l.words, 1)?;
        let none = Condition::new(modules.planner, arena, l.none, usize::from(limits.guided))?;
        let of_text = arena.used() - begin;
        let anchors = Condition::new(modules.planner, arena, l.anchors.0, l.anchors.1)?;
        let of_anchors = arena.used() - begin - of_text;
        let words = arena.take(l.words)?;
        let pooled = arena.take(modules.text.width())?;
        let lengths = arena.take(modules.text.length().outputs())?;
        let x = arena.take(l.x)?;
        let proposal = arena.take(l.tokens)?;
        let bytes = Bytes {
            text: of_text,
            anchors: of_anchors,
            rows: arena.used() - begin - of_text - of_anchors,
            pass: Arena::measure(|arena| Pass::new(arena, &l)),
            draw: Arena::measure(|arena| Draw::new(arena, &l)),
        };
        let spare = arena.part(bytes.working())?;
        let (predicted, needed) = (0, l);
        Ok(Session {
            modules,
            text,
            none,
            anchors,
            words,
            pooled,
            lengths,
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
    /// A [`PromptError`] in the outer result; in the inner one [`Interrupted`] when `check` says so, which is asked behind
    /// every block.
    pub fn read(&mut self, prompt: &Prompt<'_>, check: Check<'_>) -> Result<Result<Heard, Interrupted>, PromptError> {
        let rows = self.modules.text.rows(prompt)?;
        let heard = match *prompt {
            Prompt::Text(text) => self.modules.text.ids(text, self.words)?,
            Prompt::Bank(_) => Heard { words: u16::try_from(rows).unwrap_or(u16::MAX), unknown_words: 0 },
        };
        let reading = match *prompt {
            Prompt::Text(_) => Reading::Words(rows),
            Prompt::Bank(name) => Reading::Stored(name),
        };
        Ok(self.read_both(reading, check).map(|()| heard))
    }

    fn read_both(&mut self, reading: Reading<'_>, check: Check<'_>) -> Result<(), Interrupted> {
        self.encode(reading, false, check)?;
        if let Ok(mut pass) = Pass::new(&mut self.spare.overlay(), &self.needed) {
            pass.scratch.linear(self.modules.text.length(), self.pooled, self.lengths);
        }
        self.predicted = length::median(self.lengths);
        if self.needed.guided == 0 {
            return Ok(());
        }
        let none = match self.modules.text.encoder() {
            None => Reading::Stored(bank::NONE),
            Some(_) => {
                if let Some(word) = self.words.first_mut() {
                    *word = NONE;
                }
                Reading::Words(1)
            }
        };
        self.encode(none, true, check)
    }

    fn encode(&mut self, reading: Reading<'_>, none: bool, check: Check<'_>) -> Result<(), Interrupted> {
        let Modules { text, planner, .. } = self.modules;
        let Ok(mut pass) = Pass::new(&mut self.spare.overlay(), &self.needed) else { return Ok(()) };
        let width = text.width();
        let memory = match reading {
            Reading::Words(count) => {
                let memory = part_mut!(self.x, ..count * width);
                if let Some(encoder) = text.encoder() {
                    let words = part!(self.words, ..count);
                    let (mut own, scratch) = pass.split(count);
                    encoder.encode(words, memory, self.pooled, &mut own, scratch, check)?;
                }
                memory
            }
            Reading::Stored(name) => match text.bank().get(name) {
                None => &mut [],
                Some(entry) => {
                    let memory = part_mut!(self.x, ..entry.rows() * width);
                    entry.read(memory, self.pooled);
                    memory
                }
            },
        };
        let condition = if none { &mut self.none } else { &mut self.text };
        planner.read(memory, self.pooled, condition, &mut pass.scratch, check)
    }

    /// Reads the anchors of a motion of `tokens` tokens, no more than the session was made for: from here on they condition every
    /// pass. Without room for them ([`Limits::anchors`]), or with none of a family that the planner was trained for, nothing
    /// happens.
    ///
    /// # Errors
    /// [`Interrupted`] when `check` says so; it is asked behind every block.
    pub fn anchor(&mut self, anchors: &AnchorSet, tokens: usize, check: Check<'_>) -> Result<(), Interrupted> {
        let Modules { planner, control: Some(control), .. } = self.modules else { return Ok(()) };
        let Some(h) = self.x.get_mut(..tokens * control.scaffold_width()) else { return Ok(()) };
        if self.needed.anchors.0 == 0 || !anchors.iter().any(|anchor| control.sees(anchor.family)) {
            return Ok(());
        }
        let Ok(mut pass) = Pass::new(&mut self.spare.overlay(), &self.needed) else { return Ok(()) };
        let work = core::mem::take(&mut pass.work);
        let (mut own, scratch) = pass.split(tokens);
        control.read(planner, anchors, h, &mut own, &mut self.anchors, work, scratch, check)
    }

    /// The sampler's constants.
    #[must_use]
    pub const fn tmd(&self) -> &'m Tmd {
        self.modules.planner.tmd()
    }

    /// The length that the text suggests, tokens.
    #[must_use]
    pub const fn predicted_length(&self) -> usize {
        self.predicted
    }

    /// Random tokens, given ones in their places: where a sampler begins.
    pub fn begin(&self, planning: &Planning<'_>, stream: &mut Stream, tokens: &mut [u16]) {
        let codes = u32::try_from(self.modules.planner.codes()).unwrap_or(0);
        for (i, token) in tokens.iter_mut().enumerate() {
            let drawn = stream.below(codes);
            *token = planning.fixed_at(i).unwrap_or(u16::try_from(drawn).unwrap_or(0));
        }
    }

    /// One pass over `tokens` at time `time`, with guidance two: what [`Session::logits`] and [`Session::advance`] read.
    /// No more tokens than the session was made for, each in the codebook.
    ///
    /// # Errors
    /// [`Interrupted`] when `check` says so; it is asked behind every block.
    pub fn pass(
        &mut self,
        tokens: &[u16],
        time: f32,
        planning: &Planning<'_>,
        check: Check<'_>,
    ) -> Result<(), Interrupted> {
        let planner = self.modules.planner;
        let width = planner.width();
        let rows = 1 + tokens.len();
        let Some(x) = self.x.get_mut(..rows * width) else { return Ok(()) };
        let Ok(mut pass) = Pass::new(&mut self.spare.overlay(), &self.needed) else { return Ok(()) };
        let guided = core::mem::take(&mut pass.guided);
        let (mut own, scratch) = pass.split(rows);
        let input = Input { tokens, time, planning };
        planner.forward(&input, &self.text, Some(&self.anchors), x, &mut own, scratch, check)?;
        if !planning.guided() || guided.is_empty() {
            return Ok(());
        }
        for (to, from) in guided.iter_mut().zip(x.iter().skip(width)) {
            *to = *from;
        }
        // What guides is text and anchors together: the other end knows neither.
        planner.forward(&input, &self.none, None, x, &mut own, scratch, check)?;
        for (none, text) in x.iter_mut().skip(width).zip(guided.iter()) {
            *none += planning.guidance * (*text - *none);
        }
        Ok(())
    }

    /// Guided logits `[V]` of one position, as the last pass left them.
    pub fn logits(&mut self, position: usize) -> &[f32] {
        let planner = self.modules.planner;
        let Ok(mut draw) = Draw::new(&mut self.spare.overlay(), &self.needed) else { return &[] };
        let width = planner.width();
        draw.block(planner, part!(self.x, (1 + position) * width..(2 + position) * width));
        part!(draw.logits, ..planner.codes())
    }

    /// Draws a proposal for every position of the last pass, and moves `tokens` towards it: the whole way without `step`.
    pub fn advance(&mut self, planning: &Planning<'_>, step: Option<&Step>, stream: &mut Stream, tokens: &mut [u16]) {
        let planner = self.modules.planner;
        let (width, codes) = (planner.width().max(1), planner.codes().max(1));
        let Ok(mut draw) = Draw::new(&mut self.spare.overlay(), &self.needed) else { return };
        let units = core::mem::take(&mut draw.units);
        // Computed anew in each step: it costs less than the memory that it would take from the passes.
        let metric = step.map(|step| (step, Metric::new(self.modules.codebooks, units)));
        let sampling: Sampling = planning.sampling;
        let rows = part!(self.x, width..(1 + tokens.len()) * width);
        let mut positions = tokens.iter_mut().zip(self.proposal.iter_mut()).enumerate();
        for rows in rows.chunks(DRAWN * width) {
            draw.block(planner, rows);
            let logits = draw.logits.chunks_exact_mut(codes).take(rows.len() / width);
            for (logits, (i, (token, proposal))) in logits.zip(positions.by_ref()) {
                let proposed = sampling.propose(logits, stream);
                let draws = (stream.unit(), stream.unit());
                if planning.fixed_at(i).is_some() {
                    *proposal = *token;
                    continue;
                }
                *proposal = proposed;
                *token = match &metric {
                    None => proposed,
                    Some((step, metric)) => metric.advance(*token, proposed, step, draws, logits, draw.weights),
                };
            }
        }
    }

    /// The proposals of the last [`Session::advance`].
    #[must_use]
    pub fn proposal(&self) -> &[u16] {
        self.proposal
    }
}
