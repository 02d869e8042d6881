//! The bidirectional or causal transformer that proposes clean tokens for noisy, masked or coming ones, given a text.
//!
//! Over rows `0..=L`, `L` the number of tokens `z`: row 0 says what is asked for, `global(pooled)`, row 1 + i says token i; what else they are
//! made of is in [`super::inputs`]. Blocks with self-attention over all rows, or over those before, and cross-attention to the text memory where
//! there is one; hidden rows `h` and `logits_i = out h_{1+i}` are in [`super::head`].
//!
//! With anchors that condition it ([`crate::conditioning::anchor_kv`]), self-attention reads their keys and values beside its own, and what they tell
//! a row joins its sum as the last term. Without them nothing is added and nothing read: the bits are those of a planner that
//! knows no anchors.

use super::Planning;
use super::condition::Condition;
use super::head::Head;
use super::inputs::{self, Inputs, Timed};
use super::sampler::Sampler;
use super::tmd::Tmd;
#[cfg(any(feature = "masked", feature = "autoregressive"))]
use crate::blob::PrefixConfig;
use crate::blob::{Corruption, Error, HeadConfig, PlannerConfig, Tensors};
use crate::nn::attention::Heads;
use crate::nn::block::{BlockScratch, Sizes, Stack, StackScratch, below};
use crate::nn::linear::Linear;
use crate::nn::norm::MAX_INPUT;
use crate::stop::{Check, Stop};
use crate::text::Text;
use core::ops::ControlFlow;

/// The planner in flash.
#[derive(Debug, Clone, Copy)]
pub struct Planner<'a> {
    sampler: Sampler,
    /// That it is made for, 1 for none.
    #[cfg(any(feature = "masked", feature = "autoregressive"))]
    guidance: f32,
    /// Tokens `V`.
    codes: u16,
    /// Index of its first tensor.
    first: u16,
    global: Linear<'a>,
    inputs: Inputs<'a>,
    stack: Stack<'a>,
    head: Head<'a>,
}

/// What the planner sees beside the text.
#[derive(Debug, Clone, Copy)]
pub struct Input<'i> {
    /// Tokens `z_t [L]`; V is a masked one.
    pub tokens: &'i [u16],
    /// Time `t`, 0 to 1.
    pub time: f32,
    /// Which positions are given.
    pub planning: &'i Planning<'i>,
}

impl<'a> Planner<'a> {
    /// Reads a planner of noisy or masked tokens from the next tensors. [`Planner::check`] is to follow.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(tensors: &mut Tensors<'a>, config: &PlannerConfig, text: &Text<'_>, codes: u16) -> Result<Self, Error> {
        let transformer = config.transformer;
        let memory = u16::try_from(text.width()).map_err(|_| Error::Manifest)?;
        let first = tensors.index();
        let global = Linear::open(tensors, memory, transformer.width)?;
        let inputs = Inputs::Timed(Timed::open(tensors, config)?);
        let stack = Stack::open(tensors, transformer, Some(memory))?;
        let head = Head::open(tensors, &transformer, HeadConfig::Norm, codes, true)?;
        Ok(Planner {
            sampler: match config.corruption {
                Corruption::Near { c, a } => Sampler::Tmd(Tmd { c, a }),
                #[cfg(feature = "masked")]
                Corruption::Masks => Sampler::Masked(super::masked::Masked),
                // Refused where the manifest was read.
                #[cfg(not(feature = "masked"))]
                Corruption::Masks => return Err(Error::Manifest),
            },
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            guidance: Planning::DEFAULT.guidance,
            codes,
            first,
            global,
            inputs,
            stack,
            head,
        })
    }

    /// Reads a masked planner that is given a vector from the next tensors. [`Planner::check`] is to follow.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    #[cfg(feature = "masked")]
    pub fn open_masked(
        tensors: &mut Tensors<'a>,
        config: &PrefixConfig,
        text: &Text<'_>,
        codes: u16,
    ) -> Result<Self, Error> {
        let sampler = Sampler::Masked(super::masked::Masked);
        // Token V stands for what is to be planned.
        Self::open_prefix(tensors, config, text, (codes, codes.saturating_add(1), codes), sampler)
    }

    /// Reads a planner of a token at a time from the next tensors. [`Planner::check`] is to follow.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    #[cfg(feature = "autoregressive")]
    pub fn open_in_turn(
        tensors: &mut Tensors<'a>,
        config: &PrefixConfig,
        text: &Text<'_>,
        codes: u16,
    ) -> Result<Self, Error> {
        // Class V ends the motion.
        Self::open_prefix(tensors, config, text, (codes, codes, codes.saturating_add(1)), Sampler::InTurn)
    }

    #[cfg(any(feature = "masked", feature = "autoregressive"))]
    fn open_prefix(
        tensors: &mut Tensors<'a>,
        config: &PrefixConfig,
        text: &Text<'_>,
        (codes, tokens, classes): (u16, u16, u16),
        sampler: Sampler,
    ) -> Result<Self, Error> {
        let PrefixConfig { transformer, max_tokens, head, guidance, .. } = *config;
        let width = u16::try_from(text.width()).map_err(|_| Error::Manifest)?;
        let first = tensors.index();
        let global = Linear::open(tensors, width, transformer.width)?;
        let inputs = Inputs::Placed(inputs::Placed::open(tensors, transformer.width, tokens, max_tokens)?);
        let stack = Stack::open(tensors, transformer, None)?;
        let head = Head::open(tensors, &transformer, head, classes, false)?;
        Ok(Planner { sampler, guidance, codes, first, global, inputs, stack, head })
    }

    /// Checks that activations stay finite when anchors tell a row no more than `share` in magnitude, and keys and values of
    /// theirs are at most `values`; 0 for neither.
    ///
    /// # Errors
    /// [`Error::Unbounded`].
    pub fn check(&self, text: &Text<'_>, (share, values): (f32, f32)) -> Result<(), Error> {
        let rows = inputs::largest(self.inputs.bounds(self.head.out()), self.global.bound(text.bound()));
        let rows = below(rows + share, MAX_INPUT, self.first)?;
        let rows = self.stack.bound(rows, text.bound(), values)?;
        below(self.head.inner_bound(rows), MAX_INPUT, self.first).map(|_| ())
    }

    /// Whether guidance takes one pass, to which its strength is told.
    #[must_use]
    pub const fn one_pass(&self) -> bool {
        self.inputs.know_guidance()
    }

    /// Whether guidance takes a second pass, without text and anchors. One that plans a token at a time is not guided.
    #[must_use]
    pub const fn two_passes(&self) -> bool {
        !self.in_turn() && !self.inputs.know_guidance()
    }

    /// How its logits become tokens.
    #[must_use]
    pub const fn sampler(&self) -> &Sampler {
        &self.sampler
    }

    /// Whether it plans a token at a time.
    #[must_use]
    pub const fn in_turn(&self) -> bool {
        match self.sampler {
            #[cfg(feature = "autoregressive")]
            Sampler::InTurn => true,
            _ => false,
        }
    }

    /// How it is meant to plan, of a predicted length: [`Planning::DEFAULT`] of TMD, with ten steps where tokens are masked; given a vector as
    /// its authors do, ten steps and draws from a tenth of the codes where it is masked (MoMask's evaluation), draws from all of them a token
    /// at a time.
    #[must_use]
    pub fn defaults(&self) -> Planning<'static> {
        #[cfg(any(feature = "masked", feature = "autoregressive"))]
        if !matches!(self.sampler, Sampler::Tmd(_)) {
            let all = self.in_turn() || matches!(self.inputs, Inputs::Timed(_));
            let top_k = if all { 0 } else { self.codes.div_ceil(10) };
            return Planning {
                steps: 10,
                guidance: self.guidance,
                sampling: super::Sampling::Sample { temperature: 1.0, top_k, top_p: 1.0 },
                ..Planning::DEFAULT
            };
        }
        Planning::DEFAULT
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
        self.codes as usize
    }

    /// Whether keys and values have 16 bits.
    #[cfg(feature = "wide-layers")]
    #[must_use]
    pub const fn wide(&self) -> bool {
        self.stack.wide()
    }

    /// What makes logits of hidden rows.
    #[must_use]
    pub const fn head(&self) -> &Head<'a> {
        &self.head
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

    /// Multiply-accumulates of one pass over `tokens` tokens, logits of all positions left out.
    #[must_use]
    pub fn pass_macs(&self, tokens: usize, anchors: usize, memory: usize) -> u64 {
        self.stack.macs(1 + tokens, anchors, memory) + (1 + tokens) as u64 * self.head.hidden_macs()
    }

    /// The same of a planner of a token at a time: a row for each token, which attends to itself and those before it.
    #[cfg(feature = "autoregressive")]
    #[must_use]
    pub fn turns_macs(&self, tokens: usize) -> u64 {
        let row = |at| self.stack.macs(1, at, 0) + self.head.hidden_macs();
        (0..tokens).map(row).sum()
    }

    /// Multiply-accumulates of one position's logits.
    #[must_use]
    pub const fn logits_macs(&self) -> u64 {
        self.head.out().macs()
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
        self.inputs.fill(input, text.row_bias, self.head.out(), x);
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
        self.head.hide(x, scratch.block);
        ControlFlow::Continue(())
    }

    /// One more row of a planner of a token at a time: what is asked for in front of the first token, then `token`, which stands at
    /// position `at - 1`. Hidden row into `x [d]`; keys and values of all rows before it are in `cache`, its own come there.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    #[cfg(feature = "autoregressive")]
    pub fn extend(
        &self,
        (token, at): (u16, usize),
        text: &Condition<'_>,
        cache: &mut Condition<'_>,
        x: &mut [f32],
        scratch: &mut BlockScratch<'_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        match (&self.inputs, at.checked_sub(1)) {
            (Inputs::Placed(placed), Some(position)) => placed.row(token, position, x),
            _ => inputs::begin(text.row_bias, x),
        }
        for (layer, block) in self.stack.blocks().enumerate() {
            block.append(x, at, &mut cache.layer_mut(self.heads(), layer), scratch);
            check()?;
        }
        self.head.hide(x, scratch);
        ControlFlow::Continue(())
    }
}
