//! How tokens come to be: the seam between the network that proposes and the rule that decides.

use super::Planning;
use super::tmd::{self, Tmd};
use super::transformer::Planner;
use crate::codec::codebook::Codebooks;
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::block::BlockScratch;
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

    /// Takes what a step works in, for tokens of `codebooks`.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    fn layout<'s>(&self, arena: &mut Arena<'s>, codebooks: &Codebooks<'_>) -> Result<Self::Work<'s>, ArenaTooSmall>;

    /// Multiply-accumulates of one position in one step, its logits left out.
    fn macs(&self, codebooks: &Codebooks<'_>) -> u64;

    /// The tokens before the first pass.
    fn begin(&self, planning: &Planning<'_>, codes: usize, random: &mut Stream, tokens: &mut [u16]);

    /// Moves the tokens on by one step, from time `times.0` to `times.1`, both 0 to 1, and leaves what it would end with in
    /// `proposals`.
    fn step(
        &self,
        times: (f32, f32),
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
    planner: &'l Planner<'b>,
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
    pub(super) fn new(planner: &'l Planner<'b>, rows: &'l [f32], arena: &mut Arena<'s>) -> Result<Self, ArenaTooSmall> {
        let scratch = BlockScratch::new(arena, &planner.logits_sizes(TOGETHER))?;
        let block = arena.take(TOGETHER * planner.codes())?;
        Ok(Logits { planner, rows, scratch, block })
    }

    /// Hands position and logits `[V]` of every position to `take`, in order; it may overwrite them.
    pub fn each(&mut self, mut take: impl FnMut(usize, &mut [f32])) {
        let Logits { planner, rows, scratch, block } = self;
        let (width, codes) = (planner.width().max(1), planner.codes().max(1));
        for (index, rows) in rows.chunks(TOGETHER * width).enumerate() {
            let block = part_mut!(block, ..rows.len() / width * codes);
            planner.logits(rows, block, scratch);
            for (i, logits) in block.chunks_exact_mut(codes).enumerate() {
                take(index * TOGETHER + i, logits);
            }
        }
    }

    /// The buffer of the first position's logits, `[V]`, as [`Logits::each`] left it.
    pub(super) fn first(self) -> &'s [f32] {
        part!(self.block, ..self.planner.codes())
    }
}

/// The rules that models come with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sampler {
    /// Token metric diffusion.
    Tmd(Tmd),
}

/// What their steps work in.
#[derive(Debug)]
pub enum Work<'s> {
    /// Of [`Sampler::Tmd`].
    Tmd(tmd::Work<'s>),
}

impl TokenSampler for Sampler {
    type Work<'s> = Work<'s>;

    fn layout<'s>(&self, arena: &mut Arena<'s>, codebooks: &Codebooks<'_>) -> Result<Work<'s>, ArenaTooSmall> {
        match self {
            Sampler::Tmd(tmd) => tmd.layout(arena, codebooks).map(Work::Tmd),
        }
    }

    fn macs(&self, codebooks: &Codebooks<'_>) -> u64 {
        match self {
            Sampler::Tmd(tmd) => tmd.macs(codebooks),
        }
    }

    fn begin(&self, planning: &Planning<'_>, codes: usize, random: &mut Stream, tokens: &mut [u16]) {
        match self {
            Sampler::Tmd(tmd) => tmd.begin(planning, codes, random, tokens),
        }
    }

    fn step(
        &self,
        times: (f32, f32),
        logits: &mut Logits<'_, '_, '_>,
        codebooks: &Codebooks<'_>,
        work: &mut Work<'_>,
        draw: Draw<'_>,
    ) {
        match (self, work) {
            (Sampler::Tmd(tmd), Work::Tmd(work)) => tmd.step(times, logits, codebooks, work, draw),
        }
    }

    fn finish(&self, logits: &mut Logits<'_, '_, '_>, work: &mut Work<'_>, draw: Draw<'_>) {
        match (self, work) {
            (Sampler::Tmd(tmd), Work::Tmd(work)) => tmd.finish(logits, work, draw),
        }
    }
}
