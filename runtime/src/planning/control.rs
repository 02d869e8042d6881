//! Anchor control: what anchors tell the planner (EQUATIONS section 3).
//!
//! `H` is the anchors' scaffold ([`ScaffoldEncoder`]), one row a token. Each block of the planner attends to keys and values
//! `kv_m(down_m H)` of low rank beside its own (AnchorKV). With dual context row 0 is told `out(gelu(in(mean H)))` and row 1 + l
//! `local H_l`. All of it depends on the anchors alone and is computed once a request.

use super::condition::Condition;
use super::transformer::Planner;
use crate::blob::{Activation, ControlConfig, Error, Tensors};
use crate::nn::attention::SegmentMut;
use crate::nn::block::{Scratch, Sizes, below, project_low_rank};
use crate::nn::conv1d::larger;
use crate::nn::linear::Linear;
use crate::nn::norm::MAX_INPUT;
use crate::nn::{Check, Interrupted, activation};
use crate::perception::anchors::AnchorSet;
use crate::perception::scaffold_encoder::ScaffoldEncoder;

/// Anchor control in flash.
#[derive(Debug, Clone, Copy)]
pub struct Control<'a> {
    scaffold: ScaffoldEncoder<'a>,
    /// Width of the planner, `d`.
    width: u16,
    /// Blocks of the planner.
    layers: u8,
    rank: u16,
    /// Two layers a block, left in the tensor table.
    projections: Tensors<'a>,
    context: Option<Context<'a>>,
    /// Bounds of what it tells a row, and of its keys and values.
    bounds: (f32, f32),
}

/// Dual context.
#[derive(Debug, Clone, Copy)]
struct Context<'a> {
    /// `ds` to `ds`.
    enter: Linear<'a>,
    /// `ds` to `d`.
    leave: Linear<'a>,
    /// `ds` to `d`.
    local: Linear<'a>,
}

/// The layers that make keys and values of one block: `ds` to `r`, `r` to `2 d`.
fn projection<'a>(
    tensors: &mut Tensors<'a>,
    scaffold: usize,
    rank: u16,
    width: u16,
) -> Result<(Linear<'a>, Linear<'a>), Error> {
    let down = Linear::open(tensors, scaffold as u16, rank)?;
    Ok((down, Linear::open(tensors, rank, width.saturating_mul(2))?))
}

impl<'a> Control<'a> {
    /// Reads anchor control of a planner of `layers` blocks of `width` from the next tensors, for motions of `rate` frames a second,
    /// `frames` of them a token and at most `max_tokens` tokens, and checks that activations stay finite.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(
        tensors: &mut Tensors<'a>,
        config: &ControlConfig,
        planner: &Planner<'_>,
        (rate, frames, max_tokens): (u16, u16, u16),
    ) -> Result<Self, Error> {
        let scaffold = ScaffoldEncoder::open(tensors, config, rate, frames, max_tokens)?;
        let (width, layers, rank) = (planner.width() as u16, planner.layers() as u8, config.rank);
        let projections = tensors.trusted();
        let bound = scaffold.bound();
        let mut values = 0.0;
        for _ in 0..layers {
            let index = tensors.index();
            let (down, kv) = projection(tensors, scaffold.width(), rank, width)?;
            values = larger(values, kv.bound(below(down.bound(bound), MAX_INPUT, index)?));
        }
        let (mut context, mut share) = (None, 0.0);
        if config.context {
            let (index, inner) = (tensors.index(), config.scaffold.width);
            let enter = Linear::open(tensors, inner, inner)?;
            let leave = Linear::open(tensors, inner, width)?;
            let local = Linear::open(tensors, inner, width)?;
            let global = leave.bound(below(enter.bound(bound), MAX_INPUT, index)?);
            share = larger(global, local.bound(bound));
            context = Some(Context { enter, leave, local });
        }
        Ok(Control { scaffold, width, layers, rank, projections, context, bounds: (share, values) })
    }

    /// Bounds of what it tells a row, and of its keys and values.
    #[must_use]
    pub const fn bounds(&self) -> (f32, f32) {
        self.bounds
    }

    /// The encoder of anchors.
    #[must_use]
    pub const fn scaffold(&self) -> &ScaffoldEncoder<'a> {
        &self.scaffold
    }

    /// Rows of the planner that are told something, of a motion of `tokens` tokens.
    #[must_use]
    pub const fn shares(&self, tokens: usize) -> usize {
        if self.context.is_some() { 1 + tokens } else { 0 }
    }

    /// What a [`Scratch`] must serve for so many tokens.
    #[must_use]
    pub fn sizes(&self, tokens: usize) -> Sizes {
        let (width, rank, inner) = (usize::from(self.width), usize::from(self.rank), self.scaffold.width());
        let inner = Sizes { width: rank, inputs: inner, outputs: inner, ..Sizes::default() };
        let outer = Sizes { width, inputs: rank, outputs: width, ..Sizes::default() };
        self.scaffold.sizes(tokens).with(inner).with(outer)
    }

    /// Numbers of `work` in [`Control::read`].
    #[must_use]
    pub const fn work(&self) -> usize {
        // The mean, then what the encoder needs, then one more row of that width in its place.
        self.scaffold.width() + self.scaffold.work() + self.scaffold.width()
    }

    /// Multiply-accumulates of [`Control::read`] for so many tokens.
    #[must_use]
    pub fn macs(&self, tokens: usize) -> u64 {
        let (width, rank, inner) = (u64::from(self.width), u64::from(self.rank), self.scaffold.width() as u64);
        let rows = tokens as u64;
        let low = u64::from(self.layers) * rows * rank * (inner + 2 * width);
        let context = if self.context.is_some() { inner * (inner + width) + rows * inner * width } else { 0 };
        self.scaffold.macs(tokens) + low + context
    }

    /// What `anchors` tell the planner of a motion of as many tokens as `h [L][ds]` has rows, into `condition`. `h` and `own` are
    /// scratch, as is `work`, of [`Control::work`] numbers.
    ///
    /// # Errors
    /// [`Interrupted`] when `check` says so; it is asked behind every block.
    #[inline(never)]
    pub fn read(
        &self,
        planner: &Planner<'_>,
        anchors: &AnchorSet,
        h: &mut [f32],
        own: &mut SegmentMut<'_>,
        condition: &mut Condition<'_>,
        work: &mut [f32],
        scratch: &mut Scratch<'_>,
        check: Check<'_>,
    ) -> Result<(), Interrupted> {
        let inner = self.scaffold.width().max(1);
        let (mean, work) = work.split_at_mut_checked(inner).unwrap_or_default();
        self.scaffold.encode(anchors, h, mean, own, work, scratch, check)?;
        condition.rows = h.len() / inner;
        let mut projections = self.projections;
        for layer in 0..usize::from(self.layers) {
            // They opened once, so they open again.
            let Ok((down, kv)) = projection(&mut projections, inner, self.rank, self.width) else { break };
            let mut segment = condition.layer_mut(planner.heads(), layer);
            project_low_rank(planner.heads(), &down, &kv, h, &mut segment, scratch);
            check()?;
        }
        if let Some(Context { enter, leave, local }) = &self.context {
            let width = usize::from(self.width).max(1);
            let (global, locals) = condition.shares.split_at_mut_checked(width).unwrap_or_default();
            let hidden = work.get_mut(..inner).unwrap_or_default();
            scratch.linear(enter, mean, hidden);
            activation::apply(Activation::Gelu, hidden);
            scratch.linear(leave, hidden, global);
            for (row, out) in h.chunks_exact(inner).zip(locals.chunks_exact_mut(width)) {
                scratch.linear(local, row, out);
            }
        }
        Ok(())
    }
}
