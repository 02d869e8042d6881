//! The planner: a bidirectional transformer that proposes clean tokens for noisy ones, given a text.
//!
//! Over rows `0..=L`, `L` the number of tokens `z`:
//! row 0 = `global(pooled) + time[floor(32 t)] + boundary[2 start_open + end_open]`,
//! row 1 + i = `token[z_i] + position[i] + end[L - 1 - i]` (the last only when the motion ends there) `+ fixed` (only where
//! token i is given); blocks with self-attention over all rows and cross-attention to the text memory;
//! `h = LN x`, `logits_i = token h_{1+i} + bias`, the token embeddings once more.
//!
//! Conditions to come have their seams: self-attention reads a further segment of keys and values a block
//! ([`crate::nn::block::Block::forward`], `extra`), and rows 1 + i are sums that another row may join.

use super::request::MAX_GUIDANCE;
use super::tmd::Tmd;
use crate::arena::{Arena, ArenaTooSmall, bytes_of};
use crate::blob::{Error, PlannerConfig, Sampler, Tensors};
use crate::model::MAX_MAGNITUDE;
use crate::nn::attention::{Heads, Segment, SegmentMut};
use crate::nn::block::{Scratch, Sizes, Stack, below};
use crate::nn::conv1d::larger;
use crate::nn::embedding::{Embedding, add_row};
use crate::nn::linear::Linear;
use crate::nn::norm::{LayerNorm, MAX_INPUT};
use crate::nn::{Check, Interrupted};
use crate::perception::Text;

/// Time embeddings: time `t` takes number `floor(TIMES t)`.
pub const TIMES: u16 = 32;
/// Begin and end of a motion, each whole or open.
const BOUNDARIES: u16 = 4;

/// The planner in flash.
#[derive(Debug, Clone, Copy)]
pub struct Planner<'a> {
    tmd: Tmd,
    global: Linear<'a>,
    time: Embedding<'a>,
    boundary: Embedding<'a>,
    position: Embedding<'a>,
    end: Embedding<'a>,
    fixed: Embedding<'a>,
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

/// What the planner knows of a text: row 0's share of it, and keys and values of every block's cross-attention.
#[derive(Debug)]
pub struct Condition<'w> {
    rows: usize,
    /// `[d]`
    global: &'w mut [f32],
    /// `[layers][H][n][dh]`
    keys: &'w mut [i8],
    /// `[layers][H][n]`
    key_scales: &'w mut [f32],
    /// `[layers][H][n][dh]`
    values: &'w mut [i8],
    /// `[layers][H][n]`
    value_scales: &'w mut [f32],
}

impl<'w> Condition<'w> {
    /// Arena bytes of [`Condition::new`].
    #[must_use]
    pub fn bytes(planner: &Planner<'_>, rows: usize) -> usize {
        let (layers, heads) = (planner.layers(), planner.stack.heads());
        bytes_of::<f32>(planner.width())
            + 2 * bytes_of::<i8>(layers * rows * heads.count * heads.width)
            + 2 * bytes_of::<f32>(layers * rows * heads.count)
    }

    /// Takes the buffers for texts of up to `rows` rows.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn new(planner: &Planner<'_>, arena: &mut Arena<'w>, rows: usize) -> Result<Self, ArenaTooSmall> {
        let (layers, heads) = (planner.layers(), planner.stack.heads());
        let (numbers, scales) = (layers * rows * heads.count * heads.width, layers * rows * heads.count);
        Ok(Condition {
            rows: 0,
            global: arena.take(planner.width())?,
            keys: arena.take(numbers)?,
            values: arena.take(numbers)?,
            key_scales: arena.take(scales)?,
            value_scales: arena.take(scales)?,
        })
    }

    /// Without room for anything.
    #[must_use]
    pub const fn none() -> Self {
        Condition {
            rows: 0,
            global: &mut [],
            keys: &mut [],
            key_scales: &mut [],
            values: &mut [],
            value_scales: &mut [],
        }
    }

    fn layer(&self, heads: Heads, layer: usize) -> Segment<'_> {
        let (scales, numbers) = (self.rows * heads.count, self.rows * heads.count * heads.width);
        let of_scales = layer * scales..(layer + 1) * scales;
        let of_numbers = layer * numbers..(layer + 1) * numbers;
        Segment {
            rows: self.rows,
            keys: self.keys.get(of_numbers.clone()).unwrap_or(&[]),
            key_scales: self.key_scales.get(of_scales.clone()).unwrap_or(&[]),
            values: self.values.get(of_numbers).unwrap_or(&[]),
            value_scales: self.value_scales.get(of_scales).unwrap_or(&[]),
        }
    }

    fn layer_mut(&mut self, heads: Heads, layer: usize) -> SegmentMut<'_> {
        let (scales, numbers) = (self.rows * heads.count, self.rows * heads.count * heads.width);
        let of_scales = layer * scales..(layer + 1) * scales;
        let of_numbers = layer * numbers..(layer + 1) * numbers;
        SegmentMut {
            rows: self.rows,
            keys: self.keys.get_mut(of_numbers.clone()).unwrap_or(&mut []),
            key_scales: self.key_scales.get_mut(of_scales.clone()).unwrap_or(&mut []),
            values: self.values.get_mut(of_numbers).unwrap_or(&mut []),
            value_scales: self.value_scales.get_mut(of_scales).unwrap_or(&mut []),
        }
    }
}

impl<'a> Planner<'a> {
    /// Reads the planner from the next tensors and checks that activations stay finite.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(
        tensors: &mut Tensors<'a>,
        config: &PlannerConfig,
        text: &Text<'_>,
        codes: u16,
        max_tokens: u16,
    ) -> Result<Self, Error> {
        let PlannerConfig { transformer, sampler: Sampler::Tmd { c, a } } = *config;
        let memory = u16::try_from(text.width()).map_err(|_| Error::Manifest)?;
        let width = transformer.width;
        let index = tensors.index();
        let global = Linear::open(tensors, memory, width)?;
        let mut table = |rows| Embedding::open(tensors, rows, width);
        let (time, boundary) = (table(TIMES)?, table(BOUNDARIES)?);
        let (position, end, fixed) = (table(max_tokens)?, table(max_tokens)?, table(1)?);
        let stack = Stack::open(tensors, transformer, Some(memory))?;
        let norm = LayerNorm::open(tensors, width, transformer.epsilon)?;
        let token_index = tensors.index();
        let token = Linear::open(tensors, width, codes)?;
        let tokens = position.bound() + end.bound() + fixed.bound() + token.largest();
        let first = global.bound(text.bound()) + time.bound() + boundary.bound();
        let rows = below(larger(tokens, first), MAX_INPUT, index)?;
        stack.bound(rows, text.bound())?;
        // Guidance stretches hidden rows before they meet the token layer.
        below(token.bound((1.0 + 2.0 * MAX_GUIDANCE) * norm.bound()), MAX_MAGNITUDE, token_index)?;
        Ok(Planner { tmd: Tmd { c, a }, global, time, boundary, position, end, fixed, stack, norm, token })
    }

    /// The sampler's constants.
    #[must_use]
    pub const fn tmd(&self) -> &Tmd {
        &self.tmd
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

    /// What a [`Scratch`] must serve for so many tokens and rows of memory.
    #[must_use]
    pub fn sizes(&self, tokens: usize, memory: usize) -> Sizes {
        let sizes = self.stack.sizes(1 + tokens, memory);
        sizes.with(Sizes { outputs: self.codes(), ..Sizes::default() })
    }

    /// Multiply-accumulates of one pass over `tokens` tokens, logits of all positions left out.
    #[must_use]
    pub fn pass_macs(&self, tokens: usize, memory: usize) -> u64 {
        self.stack.macs(1 + tokens, memory)
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
    /// # Errors
    /// [`Interrupted`] when `check` says so; it is asked behind every block.
    pub fn read(
        &self,
        memory: &[f32],
        pooled: &[f32],
        condition: &mut Condition<'_>,
        scratch: &mut Scratch<'_>,
        check: Check<'_>,
    ) -> Result<(), Interrupted> {
        condition.rows = memory.len() / pooled.len().max(1);
        scratch.linear(&self.global, pooled, condition.global);
        for (layer, block) in self.stack.blocks().enumerate() {
            block.read_memory(memory, &mut condition.layer_mut(self.heads(), layer), scratch);
            check()?;
        }
        Ok(())
    }

    /// One pass: hidden rows `h` into `x [1 + L][d]`. `own` has room for `1 + L` rows.
    ///
    /// # Errors
    /// [`Interrupted`] when `check` says so; it is asked behind every block.
    pub fn forward(
        &self,
        input: &Input<'_>,
        condition: &Condition<'_>,
        x: &mut [f32],
        own: &mut SegmentMut<'_>,
        scratch: &mut Scratch<'_>,
        check: Check<'_>,
    ) -> Result<(), Interrupted> {
        let width = self.width().max(1);
        let Input { tokens, time, planning } = *input;
        let mut rows = x.chunks_exact_mut(width);
        if let Some(row) = rows.next() {
            for (to, from) in row.iter_mut().zip(condition.global.iter()) {
                *to = *from;
            }
            let number = (time * f32::from(TIMES)) as usize;
            let last = usize::from(TIMES) - 1;
            self.time.add(if number < last { number } else { last }, row);
            self.boundary.add(2 * usize::from(planning.start_open) + usize::from(planning.end_open), row);
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
        for (layer, block) in self.stack.blocks().enumerate() {
            block.forward(x, own, None, Some(condition.layer(self.heads(), layer)), scratch);
            check()?;
        }
        self.norm.forward_in_place(x);
        Ok(())
    }

    /// Logits `[R][V]` of hidden rows `h [R][d]`.
    pub fn logits(&self, h: &[f32], logits: &mut [f32], scratch: &mut Scratch<'_>) {
        scratch.linear(&self.token, h, logits);
    }
}
