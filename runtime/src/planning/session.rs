//! The planner with its buffers: reads a prompt once, then proposes and advances tokens step by step.

use super::condition::Condition;
use super::control::Control;
use super::length;
use super::request::Planning;
use super::sampling::Sampling;
use super::tmd::{Metric, Step, Tmd};
use super::transformer::{Input, Planner};
use crate::arena::{Arena, ArenaTooSmall, bytes_of};
use crate::decoding::codebook::Codebooks;
use crate::hash::Stream;
use crate::nn::attention::SegmentMut;
use crate::nn::block::{Scratch, Sizes};
use crate::nn::linear::BLOCK;
use crate::nn::{Check, Interrupted};
use crate::perception::Text;
use crate::perception::anchors::AnchorSet;
use crate::perception::bank;
use crate::perception::prompt::{Heard, Prompt, PromptError};
use crate::perception::text::NONE;

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
    hidden: usize,
    /// The larger of a block's logits and what reading anchors needs.
    logits: usize,
    sizes: Sizes,
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

    fn lengths(&self, tokens: usize, limits: &Limits) -> Lengths {
        let most = |a: usize, b: usize| if a > b { a } else { b };
        let none = if limits.guided { self.none_rows() } else { 0 };
        let (words, memory) = (limits.words, most(limits.words, none));
        let (d, dt) = (self.planner.width(), self.text.width());
        let rows = 1 + tokens;
        let control = self.control(limits);
        let anchors = control.map_or((0, 0), |control| (tokens, control.shares(tokens)));
        let mut sizes = self.planner.sizes(tokens, anchors.0, memory);
        sizes = sizes.with(Sizes { outputs: self.text.length().outputs(), inputs: dt, ..Sizes::default() });
        let (mut own, mut own_scales) = (rows * d, rows * self.planner.heads().count);
        if let Some(encoder) = self.text.encoder() {
            sizes = sizes.with(encoder.sizes(memory));
            own = most(own, memory * dt);
            own_scales = most(own_scales, memory * encoder.stack().heads().count);
        }
        let (mut x, mut logits) = (most(memory * dt, rows * d), BLOCK * self.planner.codes());
        if let Some(control) = control {
            sizes = sizes.with(control.sizes(tokens));
            own = most(own, tokens * control.scaffold_width());
            own_scales = most(own_scales, tokens * control.scaffold_heads().count);
            x = most(x, tokens * control.scaffold_width());
            logits = most(logits, control.work());
        }
        Lengths {
            words,
            none,
            anchors,
            tokens,
            x,
            own,
            own_scales,
            hidden: if limits.guided { tokens * d } else { 0 },
            logits,
            sizes,
        }
    }

    /// Arena bytes of [`Session::new`].
    #[must_use]
    pub fn bytes(&self, tokens: usize, limits: &Limits) -> usize {
        let l = self.lengths(tokens, limits);
        let codes = self.planner.codes();
        Condition::bytes(self.planner, l.words, 1)
            + Condition::bytes(self.planner, l.none, usize::from(limits.guided))
            + Condition::bytes(self.planner, l.anchors.0, l.anchors.1)
            + bytes_of::<u16>(l.words)
            + bytes_of::<f32>(self.text.width())
            + bytes_of::<f32>(self.text.length().outputs())
            + bytes_of::<f32>(l.x)
            + 2 * bytes_of::<i8>(l.own)
            + 2 * bytes_of::<f32>(l.own_scales)
            + bytes_of::<f32>(l.hidden)
            + Scratch::bytes(&l.sizes)
            + bytes_of::<f32>(Metric::len(self.codebooks))
            + bytes_of::<f32>(l.logits)
            + bytes_of::<f32>(codes)
            + bytes_of::<u16>(l.tokens)
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
    keys: &'w mut [i8],
    values: &'w mut [i8],
    key_scales: &'w mut [f32],
    value_scales: &'w mut [f32],
    /// `[L][d]`
    hidden: &'w mut [f32],
    scratch: Scratch<'w>,
    metric: Metric<'w>,
    /// `[BLOCK][V]`, before that scratch of reading anchors.
    logits: &'w mut [f32],
    /// `[V]`
    weights: &'w mut [f32],
    /// `[L]`
    proposal: &'w mut [u16],
    predicted: usize,
    /// Whether there is room for anchors.
    anchored: bool,
}

impl<'m, 'b, 'w> Session<'m, 'b, 'w> {
    /// Takes the buffers for motions of up to `tokens` tokens.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn new(
        modules: Modules<'m, 'b>,
        arena: &mut Arena<'w>,
        tokens: usize,
        limits: &Limits,
    ) -> Result<Self, ArenaTooSmall> {
        let l = modules.lengths(tokens, limits);
        let codes = modules.planner.codes();
        Ok(Session {
            modules,
            text: Condition::new(modules.planner, arena, l.words, 1)?,
            none: Condition::new(modules.planner, arena, l.none, usize::from(limits.guided))?,
            anchors: Condition::new(modules.planner, arena, l.anchors.0, l.anchors.1)?,
            words: arena.take(l.words)?,
            pooled: arena.take(modules.text.width())?,
            lengths: arena.take(modules.text.length().outputs())?,
            x: arena.take(l.x)?,
            keys: arena.take(l.own)?,
            values: arena.take(l.own)?,
            key_scales: arena.take(l.own_scales)?,
            value_scales: arena.take(l.own_scales)?,
            hidden: arena.take(l.hidden)?,
            scratch: Scratch::new(arena, &l.sizes)?,
            metric: Metric::new(modules.codebooks, arena.take(Metric::len(modules.codebooks))?),
            logits: arena.take(l.logits)?,
            weights: arena.take(codes)?,
            proposal: arena.take(l.tokens)?,
            predicted: 0,
            anchored: l.anchors.0 > 0,
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
        self.scratch.linear(self.modules.text.length(), self.pooled, self.lengths);
        self.predicted = length::median(self.lengths);
        if self.hidden.is_empty() {
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
        let width = text.width();
        let memory = match reading {
            Reading::Words(count) => {
                let memory = self.x.get_mut(..count * width).unwrap_or(&mut []);
                if let Some(encoder) = text.encoder() {
                    let words = self.words.get(..count).unwrap_or(&[]);
                    let mut own = SegmentMut {
                        rows: count,
                        keys: self.keys,
                        key_scales: self.key_scales,
                        values: self.values,
                        value_scales: self.value_scales,
                    };
                    encoder.encode(words, memory, self.pooled, &mut own, &mut self.scratch, check)?;
                }
                memory
            }
            Reading::Stored(name) => match text.bank().get(name) {
                None => &mut [],
                Some(entry) => {
                    let memory = self.x.get_mut(..entry.rows() * width).unwrap_or(&mut []);
                    entry.read(memory, self.pooled);
                    memory
                }
            },
        };
        let condition = if none { &mut self.none } else { &mut self.text };
        planner.read(memory, self.pooled, condition, &mut self.scratch, check)
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
        if !self.anchored || !anchors.iter().any(|anchor| control.sees(anchor.family)) {
            return Ok(());
        }
        let mut own = SegmentMut {
            rows: tokens,
            keys: self.keys,
            key_scales: self.key_scales,
            values: self.values,
            value_scales: self.value_scales,
        };
        control.read(planner, anchors, h, &mut own, &mut self.anchors, self.logits, &mut self.scratch, check)
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
        let mut own = SegmentMut {
            rows,
            keys: self.keys,
            key_scales: self.key_scales,
            values: self.values,
            value_scales: self.value_scales,
        };
        let input = Input { tokens, time, planning };
        planner.forward(&input, &self.text, Some(&self.anchors), x, &mut own, &mut self.scratch, check)?;
        if !planning.guided() || self.hidden.is_empty() {
            return Ok(());
        }
        for (to, from) in self.hidden.iter_mut().zip(x.iter().skip(width)) {
            *to = *from;
        }
        // What guides is text and anchors together: the other end knows neither.
        planner.forward(&input, &self.none, None, x, &mut own, &mut self.scratch, check)?;
        for (none, text) in x.iter_mut().skip(width).zip(self.hidden.iter()) {
            *none += planning.guidance * (*text - *none);
        }
        Ok(())
    }

    /// Logits of up to [`BLOCK`] positions from `first` on, `[..][V]`, of the last pass over `tokens` tokens.
    fn block(&mut self, first: usize, tokens: usize) -> &mut [f32] {
        let planner = self.modules.planner;
        let (width, codes) = (planner.width(), planner.codes());
        let left = tokens.saturating_sub(first);
        let count = if left < BLOCK { left } else { BLOCK };
        let h = self.x.get((1 + first) * width..(1 + first + count) * width).unwrap_or(&[]);
        let Some(logits) = self.logits.get_mut(..count * codes) else { return &mut [] };
        planner.logits(h, logits, &mut self.scratch);
        logits
    }

    /// Guided logits `[V]` of one position, as the last pass left them.
    pub fn logits(&mut self, position: usize) -> &[f32] {
        self.block(position, position + 1)
    }

    /// Draws a proposal for every position of the last pass, and moves `tokens` towards it: the whole way without `step`.
    pub fn advance(&mut self, planning: &Planning<'_>, step: Option<&Step>, stream: &mut Stream, tokens: &mut [u16]) {
        let (count, codes) = (tokens.len(), self.modules.planner.codes().max(1));
        let sampling: Sampling = planning.sampling;
        for first in (0..count).step_by(BLOCK) {
            let _ = self.block(first, count);
            let positions = tokens.iter_mut().zip(self.proposal.iter_mut()).enumerate().skip(first);
            for (logits, (i, (token, proposal))) in self.logits.chunks_exact_mut(codes).take(BLOCK).zip(positions) {
                let proposed = sampling.propose(logits, stream);
                let draws = (stream.unit(), stream.unit());
                if planning.fixed_at(i).is_some() {
                    *proposal = *token;
                    continue;
                }
                *proposal = proposed;
                *token = match step {
                    None => proposed,
                    Some(step) => self.metric.advance(*token, proposed, step, draws, logits, self.weights),
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
