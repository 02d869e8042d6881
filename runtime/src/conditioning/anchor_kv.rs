//! Anchor control: what anchors tell the planner (EQUATIONS section 3).
//!
//! `H` is the anchors' scaffold ([`ScaffoldEncoder`]), one row a token. Each block of the planner attends to keys and values
//! `kv_m(down_m H)` of low rank beside its own (AnchorKV). With dual context row 0 is told `out(gelu(in(mean H)))` and row 1 + l
//! `local H_l`. All of it depends on the anchors alone and is computed once a request.

use crate::blob::{ControlConfig, Error, Tensors};
use crate::conditioning::scaffold_encoder::{self, ScaffoldEncoder, Timing};
use crate::generation::tokens::condition::Condition;
use crate::generation::tokens::transformer::Planner;
use crate::nn::activation::{self, Activation};
use crate::nn::attention::Heads;
use crate::nn::block::{Sizes, StackScratch, below, heads, project_low_rank};
use crate::nn::conv1d::larger;
use crate::nn::linear::Linear;
use crate::nn::norm::MAX_INPUT;
use crate::request::conditions::{AnchorSet, Family};
use crate::stop::{Check, Stop};
use crate::text::Text;
use core::ops::ControlFlow;

/// Anchor control, left in the tensor table: a model costs no memory for layers that are used once a request.
#[derive(Debug, Clone, Copy)]
pub struct AnchorControl<'a> {
    config: ControlConfig,
    timing: Timing,
    /// Width of the planner, `d`.
    width: u16,
    /// Blocks of the planner.
    layers: u8,
    first: Tensors<'a>,
}

/// Its layers.
#[derive(Debug, Clone, Copy)]
struct Layers<'a> {
    scaffold: ScaffoldEncoder<'a>,
    /// Two layers for each block of the planner, left in the tensor table.
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

/// What [`AnchorControl::read`] works in.
#[derive(Debug)]
pub struct Buffers<'w> {
    /// The scaffold `[L][ds]`, for a motion of `L` tokens.
    pub h: &'w mut [f32],
    /// [`AnchorControl::work`] numbers.
    pub work: &'w mut [f32],
}

impl<'a> AnchorControl<'a> {
    /// Checks anchor control of `planner` in the next tensors, for motions of such `timing`, and that activations stay finite: its own,
    /// and those of the planner that it conditions.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(
        tensors: &mut Tensors<'a>,
        config: &ControlConfig,
        timing: Timing,
        planner: &Planner<'_>,
        text: &Text<'_>,
    ) -> Result<Self, Error> {
        let (width, layers) = (planner.width() as u16, planner.layers() as u8);
        let control = AnchorControl { config: *config, timing, width, layers, first: tensors.trusted() };
        planner.check(text, control.layers(tensors)?.bounds)?;
        Ok(control)
    }

    /// Reads its layers from the next tensors. Bounds are those of what it tells a row, and of its keys and values.
    #[inline(never)]
    fn layers(&self, tensors: &mut Tensors<'a>) -> Result<Layers<'a>, Error> {
        let scaffold = ScaffoldEncoder::open(tensors, &self.config, self.timing)?;
        let (projections, bound) = (tensors.trusted(), scaffold.bound());
        let mut values = 0.0;
        for _ in 0..self.layers {
            let index = tensors.index();
            let (down, kv) = self.projection(tensors)?;
            values = larger(values, kv.bound(below(down.bound(bound), MAX_INPUT, index)?));
        }
        let (mut context, mut share) = (None, 0.0);
        if self.config.context {
            let (index, inner) = (tensors.index(), self.config.scaffold.width);
            let enter = Linear::open(tensors, inner, inner)?;
            let leave = Linear::open(tensors, inner, self.width)?;
            let local = Linear::open(tensors, inner, self.width)?;
            let global = leave.bound(below(enter.bound(bound), MAX_INPUT, index)?);
            share = larger(global, local.bound(bound));
            context = Some(Context { enter, leave, local });
        }
        Ok(Layers { scaffold, projections, context, bounds: (share, values) })
    }

    /// The layers that make keys and values of one block: `ds` to `r`, `r` to `2 d`.
    fn projection(&self, tensors: &mut Tensors<'a>) -> Result<(Linear<'a>, Linear<'a>), Error> {
        let rank = self.config.rank;
        let down = Linear::open(tensors, self.config.scaffold.width, rank)?;
        Ok((down, Linear::open(tensors, rank, self.width.saturating_mul(2))?))
    }

    /// Whether it was trained for anchors of a family; it passes over others.
    #[must_use]
    pub const fn sees(&self, family: Family) -> bool {
        family.bit() & self.config.families != 0
    }

    /// Width of the scaffold, `ds`.
    #[must_use]
    pub const fn scaffold_width(&self) -> usize {
        self.config.scaffold.width as usize
    }

    /// How the width of the scaffold is split.
    #[must_use]
    pub const fn scaffold_heads(&self) -> Heads {
        heads(&self.config.scaffold)
    }

    /// Rows of the planner that are told something, of a motion of `tokens` tokens.
    #[must_use]
    pub const fn biased_rows(&self, tokens: usize) -> usize {
        if self.config.context { 1 + tokens } else { 0 }
    }

    /// What a [`BlockScratch`] must serve for so many tokens.
    #[must_use]
    pub fn sizes(&self, tokens: usize) -> Sizes {
        let [width, rank, inner] = [self.width, self.config.rank, self.config.scaffold.width].map(usize::from);
        let low = Sizes { width: rank, inputs: inner, outputs: rank, ..Sizes::default() };
        let high = Sizes { width, inputs: rank, outputs: width, ..Sizes::default() };
        scaffold_encoder::sizes(&self.config, self.timing, tokens).with(low).with(high)
    }

    /// Numbers of `work` in [`AnchorControl::read`].
    #[must_use]
    pub const fn work(&self) -> usize {
        // The mean, then what the encoder needs, in its place one more row of that width.
        2 * self.scaffold_width() + scaffold_encoder::work(&self.config, self.timing)
    }

    /// Multiply-accumulates of [`AnchorControl::read`] for so many tokens.
    #[must_use]
    pub fn macs(&self, tokens: usize) -> u64 {
        let [width, rank, inner] = [self.width, self.config.rank, self.config.scaffold.width].map(u64::from);
        let rows = tokens as u64;
        let low = u64::from(self.layers) * rows * rank * (inner + 2 * width);
        let context = if self.config.context { inner * (inner + width) + rows * inner * width } else { 0 };
        scaffold_encoder::macs(&self.config, self.timing, tokens) + low + context
    }

    /// What `anchors` tell the planner of a motion of as many tokens as the buffers have rows, into `condition`.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    #[inline(never)]
    pub fn read(
        &self,
        planner: &Planner<'_>,
        anchors: &AnchorSet,
        Buffers { h, work }: Buffers<'_>,
        condition: &mut Condition<'_>,
        scratch: &mut StackScratch<'_, '_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        // They opened once, so they open again.
        let mut tensors = self.first;
        let layers = self.layers(&mut tensors);
        invariant!(layers.is_ok(), "{layers:?}");
        let Ok(layers) = layers else { return ControlFlow::Continue(()) };
        let Layers { scaffold, mut projections, context, .. } = layers;
        let inner = self.scaffold_width().max(1);
        invariant!(work.len() == self.work());
        let (mean, work) = work.split_at_mut_checked(inner).unwrap_or_default();
        scaffold.encode(anchors, h, mean, work, scratch, check)?;
        let scratch = &mut *scratch.block;
        condition.rows = h.len() / inner;
        for layer in 0..usize::from(self.layers) {
            let projection = self.projection(&mut projections);
            invariant!(projection.is_ok(), "{projection:?}");
            let Ok((down, kv)) = projection else { break };
            let mut segment = condition.layer_mut(planner.heads(), layer);
            project_low_rank(planner.heads(), &down, &kv, h, &mut segment, scratch);
            check()?;
        }
        if let Some(Context { enter, leave, local }) = &context {
            let width = usize::from(self.width).max(1);
            invariant!(condition.row_bias.len() >= width + h.len() / inner * width);
            let (global, locals) = condition.row_bias.split_at_mut_checked(width).unwrap_or_default();
            let hidden = work.get_mut(..inner).unwrap_or_default();
            scratch.linear(enter, mean, hidden);
            activation::apply(Activation::Gelu, hidden);
            scratch.linear(leave, hidden, global);
            for (row, out) in h.chunks_exact(inner).zip(locals.chunks_exact_mut(width)) {
                scratch.linear(local, row, out);
            }
        }
        ControlFlow::Continue(())
    }
}
