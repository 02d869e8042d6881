//! Anchors to a scaffold, one row a token (EQUATIONS section 3).
//!
//! `f_t = relu(frame c_t)`, `h_l = merge [f of the token's frames, one behind another]`, then an [`Encoder`]: positions, blocks,
//! norm, mean. Features `c_t` are those of [`super::scaffold`].

use super::scaffold::{LIMIT, Scaffold, Statistics, WIDTH};
use crate::blob::{ControlConfig, Error, Tensors};
use crate::nn::activation::{self, Activation};
use crate::nn::block::{self, BlockScratch, Sizes, StackScratch, below};
use crate::nn::encoder::Encoder;
use crate::nn::linear::{LEAST_ROWS, Linear};
use crate::nn::norm::MAX_INPUT;
use crate::request::conditions::AnchorSet;
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;

/// The motions it is for.
#[derive(Debug, Clone, Copy)]
pub struct Timing {
    /// Frames a second.
    pub rate: u16,
    /// Frames a token.
    pub frames: u16,
    /// Tokens at most.
    pub tokens: u16,
}

/// What a [`BlockScratch`] must serve for so many tokens.
#[must_use]
pub fn sizes(config: &ControlConfig, timing: Timing, tokens: usize) -> Sizes {
    let outputs = usize::from(config.frame_width);
    let frame = Sizes { inputs: WIDTH, outputs, ..Sizes::default() };
    let merge = Sizes { inputs: usize::from(timing.frames) * outputs, ..Sizes::default() };
    block::sizes(&config.scaffold, 0, tokens, 0).with(frame).with(merge)
}

/// Numbers of `work` in [`ScaffoldEncoder::encode`].
#[must_use]
pub const fn work(config: &ControlConfig, timing: Timing) -> usize {
    Scaffold::NUMBERS
        + frames_per_block_of(timing.frames as usize) * WIDTH
        + timing.frames as usize * config.frame_width as usize
}

/// Frames of a token that are read together.
const fn frames_per_block_of(frames: usize) -> usize {
    if frames < LEAST_ROWS { frames } else { LEAST_ROWS }
}

/// Multiply-accumulates of a scaffold of so many tokens.
#[must_use]
pub fn macs(config: &ControlConfig, timing: Timing, tokens: usize) -> u64 {
    let frame = u64::from(config.frame_width) * (WIDTH as u64 + u64::from(config.scaffold.width));
    tokens as u64 * u64::from(timing.frames) * frame + block::macs(&config.scaffold, tokens, tokens, None)
}

/// The encoder in flash.
#[derive(Debug, Clone, Copy)]
pub struct ScaffoldEncoder<'a> {
    families: u8,
    /// Frames a second.
    rate: f32,
    statistics: Statistics<'a>,
    frame: Linear<'a>,
    merge: Linear<'a>,
    encoder: Encoder<'a>,
}

impl<'a> ScaffoldEncoder<'a> {
    /// Reads the encoder from the next tensors, for motions of such `timing`, and checks that activations stay finite.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(tensors: &mut Tensors<'a>, config: &ControlConfig, timing: Timing) -> Result<Self, Error> {
        let ControlConfig { scaffold, frame_width, families, .. } = *config;
        let statistics = Statistics::open(tensors)?;
        let index = tensors.index();
        let frame = Linear::open(tensors, WIDTH as u16, frame_width)?;
        let merge = Linear::open(tensors, timing.frames.saturating_mul(frame_width), scaffold.width)?;
        let merged = merge.bound(below(frame.bound(LIMIT), MAX_INPUT, index)?);
        let encoder = Encoder::open(tensors, timing.tokens, scaffold, merged)?;
        Ok(ScaffoldEncoder { families, rate: f32::from(timing.rate), statistics, frame, merge, encoder })
    }

    /// A bound of the scaffold and of its mean.
    #[must_use]
    pub fn bound(&self) -> f32 {
        self.encoder.bound()
    }

    /// Encodes `anchors` into `x [L][ds]` and its mean into `mean [ds]`. `own` has room for as many rows, `work` for
    /// [`work`] numbers.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn encode(
        &self,
        anchors: &AnchorSet,
        x: &mut [f32],
        mean: &mut [f32],
        work: &mut [f32],
        scratch: &mut StackScratch<'_, '_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        self.read(anchors, x, work, scratch.block);
        self.encoder.forward(x, mean, scratch, check)
    }

    /// Rows `h_l` of the scaffold.
    #[inline(never)]
    fn read(&self, anchors: &AnchorSet, x: &mut [f32], work: &mut [f32], scratch: &mut BlockScratch<'_>) {
        let width = self.frame.outputs().max(1);
        let frames_per_block = frames_per_block_of(self.merge.inputs() / width).max(1);
        let needed = Scaffold::NUMBERS + frames_per_block * WIDTH + self.merge.inputs();
        invariant!(work.len() >= needed, "{} numbers, {needed} needed", work.len());
        let (bends, work) = work.split_at_mut_checked(Scaffold::NUMBERS).unwrap_or_default();
        let (features, work) = work.split_at_mut_checked(frames_per_block * WIDTH).unwrap_or_default();
        let merged = part_mut!(work, ..self.merge.inputs());
        let scaffold = Scaffold::new(anchors, self.families, self.statistics, self.rate, bends);
        let mut frame = 0;
        for row in x.chunks_exact_mut(self.merge.outputs().max(1)) {
            for rows in merged.chunks_mut((frames_per_block * width).max(1)) {
                let features = part_mut!(features, ..rows.len() / width * WIDTH);
                for c in features.chunks_exact_mut(WIDTH) {
                    scaffold.features(frame, c);
                    frame += 1;
                }
                scratch.linear(&self.frame, features, rows);
            }
            activation::apply(Activation::Relu, merged);
            scratch.linear(&self.merge, merged, row);
        }
    }
}
