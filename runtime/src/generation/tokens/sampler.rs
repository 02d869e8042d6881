//! How tokens come to be: the seam between the network that proposes and the rule that decides.

use super::Planning;
use super::head::Head;
#[cfg(feature = "masked")]
use super::masked::{self, Masked};
use super::tmd::{self, Tmd};
use crate::codec::codebook::Codebooks;
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::block::{BlockScratch, Sizes};
use crate::numerics::hash::Stream;

/// Positions whose logits are computed together: those of more would take more memory than a pass.
const TOGETHER: usize = 4;

/// A rule that turns the network's logits into tokens, in a bounded number of steps.
///
/// A step MUST draw the same numbers from the random stream whatever the logits are, given tokens included, so that a stream's place
/// depends on step and position alone.
pub trait TokenSampler {
    /// What a step works in.
    type Work<'s>: core::fmt::Debug;

    /// Takes what a step works in, for so many tokens of `codebooks`.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    fn layout<'s>(
        &self,
        arena: &mut Arena<'s>,
        tokens: usize,
        codebooks: &Codebooks<'_>,
    ) -> Result<Self::Work<'s>, ArenaTooSmall>;

    /// The time of step `step`, counted from 0: what the network is told.
    fn time(&self, planning: &Planning<'_>, step: u16) -> f32;

    /// Multiply-accumulates of one position in one step, its logits left out.
    fn macs(&self, codebooks: &Codebooks<'_>) -> u64;

    /// The tokens before the first pass.
    fn begin(&self, planning: &Planning<'_>, codes: usize, random: &mut Stream, tokens: &mut [u16]);

    /// Moves the tokens on by the planning's step `step`, counted from 0, which is not the last, and leaves what it would end with in
    /// `proposals`.
    fn step(
        &self,
        step: u16,
        logits: &mut Logits<'_, '_, '_>,
        codebooks: &Codebooks<'_>,
        work: &mut Self::Work<'_>,
        draw: Draw<'_>,
    );

    /// The last step: what it leaves is the motion's.
    fn finish(&self, logits: &mut Logits<'_, '_, '_>, work: &mut Self::Work<'_>, draw: Draw<'_>);
}

/// What a step reads and writes beside the logits.
#[derive(Debug)]
pub struct Draw<'d> {
    /// What was asked for: sampling, given tokens.
    pub planning: &'d Planning<'d>,
    /// The request's random stream.
    pub random: &'d mut Stream,
    /// Tokens `[L]`, those that the pass saw before, the next ones behind.
    pub tokens: &'d mut [u16],
    /// What the step would end with, `[L]`.
    pub proposals: &'d mut [u16],
}

/// Logits of the positions of a pass, computed a few at a time.
#[derive(Debug)]
pub struct Logits<'l, 'b, 's> {
    head: &'l Head<'b>,
    /// Hidden rows, `[L][d]`.
    rows: &'l [f32],
    scratch: BlockScratch<'s>,
    /// `[TOGETHER][V]`
    block: &'s mut [f32],
}

impl<'l, 'b, 's> Logits<'l, 'b, 's> {
    /// Takes the buffers for the logits of hidden rows `[L][d]`.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub(super) fn new(head: &'l Head<'b>, rows: &'l [f32], arena: &mut Arena<'s>) -> Result<Self, ArenaTooSmall> {
        let (inputs, outputs) = (head.out().inputs(), head.out().outputs());
        let scratch = BlockScratch::new(arena, &Sizes { rows: TOGETHER, inputs, outputs, ..Sizes::default() })?;
        let block = arena.take(TOGETHER * outputs)?;
        Ok(Logits { head, rows, scratch, block })
    }

    /// Hands position and logits `[V]` of every position to `take`, in order; it may overwrite them.
    pub fn each(&mut self, mut take: impl FnMut(usize, &mut [f32])) {
        let Logits { head, rows, scratch, block } = self;
        let (width, codes) = (head.out().inputs().max(1), head.out().outputs().max(1));
        for (index, rows) in rows.chunks((TOGETHER * width).max(1)).enumerate() {
            let block = part_mut!(block, ..rows.len() / width * codes);
            head.logits(rows, block, scratch);
            for (i, logits) in block.chunks_exact_mut(codes).enumerate() {
                take(index * TOGETHER + i, logits);
            }
        }
    }

    /// The buffer of the first position's logits, `[V]`, as [`Logits::each`] left it.
    pub(super) fn first(self) -> &'s mut [f32] {
        part_mut!(self.block, ..self.head.out().outputs())
    }
}

/// The rules that models come with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sampler {
    /// Token metric diffusion.
    Tmd(Tmd),
    /// Confidence re-masking.
    #[cfg(feature = "masked")]
    Masked(Masked),
    /// A token at a time ([`super::Session::extend`]): there are no steps.
    #[cfg(feature = "autoregressive")]
    InTurn,
}

/// What their steps work in.
#[derive(Debug)]
pub enum Work<'s> {
    /// Of [`Sampler::Tmd`].
    Tmd(tmd::Work<'s>),
    /// Of [`Sampler::Masked`].
    #[cfg(feature = "masked")]
    Masked(masked::Work<'s>),
    /// Of [`Sampler::InTurn`].
    #[cfg(feature = "autoregressive")]
    InTurn,
}

impl TokenSampler for Sampler {
    type Work<'s> = Work<'s>;

    fn layout<'s>(
        &self,
        arena: &mut Arena<'s>,
        tokens: usize,
        codebooks: &Codebooks<'_>,
    ) -> Result<Work<'s>, ArenaTooSmall> {
        match self {
            Sampler::Tmd(tmd) => tmd.layout(arena, tokens, codebooks).map(Work::Tmd),
            #[cfg(feature = "masked")]
            Sampler::Masked(masked) => masked.layout(arena, tokens, codebooks).map(Work::Masked),
            #[cfg(feature = "autoregressive")]
            Sampler::InTurn => Ok(Work::InTurn),
        }
    }

    fn time(&self, planning: &Planning<'_>, step: u16) -> f32 {
        match self {
            Sampler::Tmd(tmd) => tmd.time(planning, step),
            #[cfg(feature = "masked")]
            Sampler::Masked(masked) => masked.time(planning, step),
            #[cfg(feature = "autoregressive")]
            Sampler::InTurn => 0.0,
        }
    }

    fn macs(&self, codebooks: &Codebooks<'_>) -> u64 {
        match self {
            Sampler::Tmd(tmd) => tmd.macs(codebooks),
            #[cfg(feature = "masked")]
            Sampler::Masked(masked) => masked.macs(codebooks),
            #[cfg(feature = "autoregressive")]
            Sampler::InTurn => 0,
        }
    }

    fn begin(&self, planning: &Planning<'_>, codes: usize, random: &mut Stream, tokens: &mut [u16]) {
        match self {
            Sampler::Tmd(tmd) => tmd.begin(planning, codes, random, tokens),
            #[cfg(feature = "masked")]
            Sampler::Masked(masked) => masked.begin(planning, codes, random, tokens),
            #[cfg(feature = "autoregressive")]
            Sampler::InTurn => {}
        }
    }

    fn step(
        &self,
        step: u16,
        logits: &mut Logits<'_, '_, '_>,
        codebooks: &Codebooks<'_>,
        work: &mut Work<'_>,
        draw: Draw<'_>,
    ) {
        match (self, work) {
            (Sampler::Tmd(tmd), Work::Tmd(work)) => tmd.step(step, logits, codebooks, work, draw),
            #[cfg(feature = "masked")]
            (Sampler::Masked(masked), Work::Masked(work)) => masked.step(step, logits, codebooks, work, draw),
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            _ => invariant!(false, "a sampler takes steps, in what it took"),
        }
    }

    fn finish(&self, logits: &mut Logits<'_, '_, '_>, work: &mut Work<'_>, draw: Draw<'_>) {
        match (self, work) {
            (Sampler::Tmd(tmd), Work::Tmd(work)) => tmd.finish(logits, work, draw),
            #[cfg(feature = "masked")]
            (Sampler::Masked(masked), Work::Masked(work)) => masked.finish(logits, work, draw),
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            _ => invariant!(false, "a sampler takes steps, in what it took"),
        }
    }
}
