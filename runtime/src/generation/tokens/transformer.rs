//! The planner: a bidirectional transformer that proposes clean tokens for noisy ones, given a text.
//!
//! Over rows `0..=L`, `L` the number of tokens `z`:
//! row 0 = `global(pooled) + time[floor(32 t)] + boundary[2 start_open + end_open]`, and where guidance takes one pass
//! `+ (1 - f) guidance[i] + f guidance[i + 1]`, `i + f` the strength of guidance, 0 to 4,
//! row 1 + i = `token[z_i] + position[i] + end[L - 1 - i]` (the last only when the motion ends there) `+ fixed` (only where
//! token i is given); blocks with self-attention over all rows and cross-attention to the text memory;
//! `h = LN x`, `logits_i = token h_{1+i} + bias`, the token embeddings once more.
//!
//! With anchors that condition it ([`crate::conditioning::anchor_kv`]), self-attention reads their keys and values beside its own, and what they tell
//! a row joins its sum as the last term. Without them nothing is added and nothing read: the bits are those of a planner that
//! knows no anchors.

use super::condition::Condition;
use super::request::MAX_GUIDANCE;
use super::sampler::Sampler;
use super::tmd::Tmd;
use crate::blob::{Error, Guidance, PlannerConfig, Tensors};
use crate::model::MAX_MAGNITUDE;
use crate::nn::attention::Heads;
use crate::nn::block::{BlockScratch, Sizes, Stack, StackScratch, below};
use crate::nn::conv1d::larger;
use crate::nn::embedding::{Embedding, add_row};
use crate::nn::linear::Linear;
use crate::nn::norm::{LayerNorm, MAX_INPUT};
use crate::stop::{Check, Stop};
use crate::text::Text;
use core::ops::ControlFlow;

/// Time embeddings: time `t` takes number `floor(TIMES t)`.
pub const TIMES: u16 = 32;
/// Begin and end of a motion, each whole or open.
const BOUNDARIES: u16 = 4;

/// Rows of the strength of guidance, 0 to 4.
pub const STRENGTHS: u16 = 5;

/// The planner in flash.
#[derive(Debug, Clone, Copy)]
pub struct Planner<'a> {
    sampler: Sampler,
    /// Index of its first tensor.
    first: u16,
    global: Linear<'a>,
    time: Embedding<'a>,
    boundary: Embedding<'a>,
    position: Embedding<'a>,
    end: Embedding<'a>,
    fixed: Embedding<'a>,
    /// Rows by the strength of guidance, where it takes one pass.
    guidance: Option<Embedding<'a>>,
    stack: Stack<'a>,
    norm: LayerNorm<'a>,
    token: Linear<'a>,
}

/// What the planner sees beside the text.
#[derive(Debug, Clone, Copy)]
pub struct Input<'i> {
    /// Tokens `z_t [L]`.
    pub tokens: &'i [u16],
    /// Time `t`, 0 to 1.
    pub time: f32,
    /// Which positions are given.
    pub planning: &'i super::Planning<'i>,
}

impl<'a> Planner<'a> {
    /// Reads the planner from the next tensors. [`Planner::check`] is to follow.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(tensors: &mut Tensors<'a>, config: &PlannerConfig, text: &Text<'_>, codes: u16) -> Result<Self, Error> {
        let PlannerConfig { transformer, max_tokens, c, a, guidance, .. } = *config;
        let memory = u16::try_from(text.width()).map_err(|_| Error::Manifest)?;
        let width = transformer.width;
        let first = tensors.index();
        let global = Linear::open(tensors, memory, width)?;
        let mut table = |rows| Embedding::open(tensors, rows, width);
        let (time, boundary) = (table(TIMES)?, table(BOUNDARIES)?);
        let (position, end, fixed) = (table(max_tokens)?, table(max_tokens)?, table(1)?);
        let guidance = match guidance {
            Guidance::TwoPass => None,
            Guidance::OnePass => Some(table(STRENGTHS)?),
        };
        let stack = Stack::open(tensors, transformer, Some(memory))?;
        let norm = LayerNorm::open(tensors, width, transformer.epsilon)?;
        let token_index = tensors.index();
        let token = Linear::open(tensors, width, codes)?;
        if token.packed() {
            // Its rows are embeddings as well.
            return Err(Error::TensorShape { index: token_index, found: 0, expected: token.macs() as u32 });
        }
        // Guidance stretches hidden rows before they meet the token layer.
        below(token.bound((1.0 + 2.0 * MAX_GUIDANCE) * norm.bound()), MAX_MAGNITUDE, token_index)?;
        Ok(Planner {
            sampler: Sampler::Tmd(Tmd { c, a }),
            first,
            global,
            time,
            boundary,
            position,
            end,
            fixed,
            guidance,
            stack,
            norm,
            token,
        })
    }

    /// Checks that activations stay finite when anchors tell a row no more than `share` in magnitude, and keys and values of
    /// theirs are at most `values`; 0 for neither.
    ///
    /// # Errors
    /// [`Error::Unbounded`].
    pub fn check(&self, text: &Text<'_>, (share, values): (f32, f32)) -> Result<(), Error> {
        let tokens = self.position.bound() + self.end.bound() + self.fixed.bound() + self.token.largest();
        let guidance = self.guidance.map_or(0.0, |table| table.bound());
        let first = self.global.bound(text.bound()) + self.time.bound() + self.boundary.bound() + guidance;
        let rows = below(larger(tokens, first) + share, MAX_INPUT, self.first)?;
        self.stack.bound(rows, text.bound(), values).map(|_| ())
    }

    /// Whether guidance takes one pass, to which its strength is told.
    #[must_use]
    pub const fn one_pass(&self) -> bool {
        self.guidance.is_some()
    }

    /// How its logits become tokens.
    #[must_use]
    pub const fn sampler(&self) -> &Sampler {
        &self.sampler
    }

    /// Width of a row, `d`.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.stack.config().width as usize
    }

    /// Blocks.
    #[must_use]
    pub const fn layers(&self) -> usize {
        self.stack.config().layers as usize
    }

    /// Tokens `V`.
    #[must_use]
    pub const fn codes(&self) -> usize {
        self.token.outputs()
    }

    /// How the width is split.
    #[must_use]
    pub const fn heads(&self) -> Heads {
        self.stack.heads()
    }

    /// What a [`BlockScratch`] must serve for so many tokens, rows of anchors and rows of memory.
    #[must_use]
    pub fn sizes(&self, tokens: usize, anchors: usize, memory: usize) -> Sizes {
        self.stack.sizes(1 + tokens, anchors, memory)
    }

    /// The same for [`Planner::logits`] of up to `rows` rows.
    #[must_use]
    pub fn logits_sizes(&self, rows: usize) -> Sizes {
        Sizes { rows, inputs: self.width(), outputs: self.codes(), ..Sizes::default() }
    }

    /// Multiply-accumulates of one pass over `tokens` tokens, logits of all positions left out.
    #[must_use]
    pub fn pass_macs(&self, tokens: usize, anchors: usize, memory: usize) -> u64 {
        self.stack.macs(1 + tokens, anchors, memory)
    }

    /// Multiply-accumulates of one position's logits.
    #[must_use]
    pub const fn logits_macs(&self) -> u64 {
        self.token.macs()
    }

    /// Multiply-accumulates of [`Planner::read`].
    #[must_use]
    pub fn read_macs(&self, memory: usize) -> u64 {
        self.global.macs() + self.stack.memory_macs(memory)
    }

    /// What the blocks need of a text: `memory [n][dt]`, `pooled [dt]`.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn read(
        &self,
        memory: &[f32],
        pooled: &[f32],
        condition: &mut Condition<'_>,
        scratch: &mut BlockScratch<'_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        condition.rows = memory.len() / pooled.len().max(1);
        scratch.linear(&self.global, pooled, condition.row_bias);
        for (layer, block) in self.stack.blocks().enumerate() {
            block.read_memory(memory, &mut condition.layer_mut(self.heads(), layer), scratch);
            check()?;
        }
        ControlFlow::Continue(())
    }

    /// One pass: hidden rows `h` into `x [1 + L][d]`, under what a text and anchors say.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn forward(
        &self,
        input: &Input<'_>,
        text: &Condition<'_>,
        anchors: Option<&Condition<'_>>,
        x: &mut [f32],
        scratch: &mut StackScratch<'_, '_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        let width = self.width().max(1);
        let Input { tokens, time, planning } = *input;
        let mut rows = x.chunks_exact_mut(width);
        if let Some(row) = rows.next() {
            for (to, from) in row.iter_mut().zip(text.row_bias.iter()) {
                *to = *from;
            }
            let number = (time * f32::from(TIMES)) as usize;
            let last = usize::from(TIMES) - 1;
            self.time.add(if number < last { number } else { last }, row);
            self.boundary.add(2 * usize::from(planning.start_open) + usize::from(planning.end_open), row);
            if let Some(table) = &self.guidance {
                add_strength(table, planning.guidance, row);
            }
        }
        for (i, (token, row)) in tokens.iter().zip(rows).enumerate() {
            row.fill(0.0);
            add_row(self.token.row(usize::from(*token)), row);
            self.position.add(i, row);
            if !planning.end_open {
                self.end.add(tokens.len().saturating_sub(i + 1), row);
            }
            if planning.fixed_at(i).is_some() {
                self.fixed.add(0, row);
            }
        }
        let heads = self.heads();
        let anchors = anchors.filter(|anchors| anchors.rows > 0);
        if let Some(anchors) = anchors {
            for (x, share) in x.iter_mut().zip(anchors.row_bias.iter()) {
                *x += *share;
            }
        }
        for (layer, block) in self.stack.blocks().enumerate() {
            let extra = anchors.map(|anchors| anchors.layer(heads, layer));
            block.forward(x, &mut scratch.own, extra, Some(text.layer(heads, layer)), scratch.block);
            check()?;
        }
        self.norm.forward_in_place(x);
        ControlFlow::Continue(())
    }

    /// Logits `[R][V]` of hidden rows `h [R][d]`.
    pub fn logits(&self, h: &[f32], logits: &mut [f32], scratch: &mut BlockScratch<'_>) {
        scratch.linear(&self.token, h, logits);
    }
}

/// Adds what stands between two rows of strengths; strengths beyond the table count as its last.
#[inline(never)]
fn add_strength(table: &Embedding<'_>, strength: f32, row: &mut [f32]) {
    let last = usize::from(STRENGTHS) - 1;
    let below = strength as usize;
    let below = if below < last { below } else { last - 1 };
    let share = if strength < last as f32 { strength - below as f32 } else { 1.0 };
    for (place, share) in [(below, 1.0 - share), (below + 1, share)] {
        let (weights, scale) = table.row(place);
        add_row((weights, scale * share), row);
    }
}
