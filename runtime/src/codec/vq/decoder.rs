//! The VQ decoder: `u [L][du]` to features `[T][C]`, `T = L * 2^stages`, and the input gradient.
//!
//! Order of execution (MoMask's and T2M-GPT's, DESIGN section 3): conv k3, ReLU, stages of { residual blocks, nearest
//! x2, conv k3 }, conv k3, ReLU, conv k3 to the features. A motion passes through it some tokens at a time; of what lies between
//! the layers one bit a value is kept for the gradient where there is a ReLU.

use super::layer::Direction;
use super::step::ReluMask;
use crate::blob::{DecoderConfig, Error, MAX_BLOCKS, MAX_STAGES, Tensors};
use crate::channels::Channels;
use crate::codec::Decode;
use crate::memory::{Arena, ArenaTooSmall, bytes_of};
use crate::nn::conv1d::{Conv1d, ConvShape};
use crate::nn::linear::{LEAST_ROWS, MOST_ROWS};
use crate::nn::mask;
use crate::nn::output::Output;
use crate::nn::residual::Residual;
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;
use heapless::Vec;

/// What passes through the decoder at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChunkShape {
    /// Tokens.
    pub tokens: usize,
    /// Rows that a layer multiplies together, at most: its weights are read once for so many.
    pub rows: usize,
}

impl ChunkShape {
    /// Of a motion of so many tokens, where `rows` of the planner's pass at a time ([`crate::Limits::rows`]): half as many tokens more, and
    /// three times as many rows a layer. What both take grows alike.
    #[must_use]
    pub fn new(tokens: usize, rows: usize) -> Self {
        let rows = rows.clamp(LEAST_ROWS, MOST_ROWS);
        ChunkShape { tokens: tokens.clamp(1, rows + rows / 2), rows: 3 * rows }
    }
}

/// Residual blocks and the upsampling convolution behind them.
#[derive(Debug, Clone)]
pub(super) struct UpsampleStage<'a> {
    pub(super) blocks: Vec<Residual<'a>, MAX_BLOCKS>,
    pub(super) upsample: Conv1d<'a>,
}

/// The decoder's layers in flash.
#[derive(Debug, Clone)]
pub struct Decoder<'a> {
    pub(super) input: Conv1d<'a>,
    pub(super) stages: Vec<UpsampleStage<'a>, MAX_STAGES>,
    pub(super) middle: Conv1d<'a>,
    pub(super) output: Output<'a>,
    pub(super) width: usize,
    code_width: usize,
}

/// All mutable memory of the decoder.
#[derive(Debug)]
pub struct Workspace<'a> {
    portion: ChunkShape,
    gates: &'a mut [u32],
    /// Where passes work.
    spare: Arena<'a>,
}

impl<'a> Decoder<'a> {
    /// Reads the decoder's layers in order from the next tensors and checks that activations stay finite.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(tensors: &mut Tensors<'a>, config: &DecoderConfig, largest_input: f32) -> Result<Self, Error> {
        let &DecoderConfig { width, code_width, features, .. } = config;
        let mut padding = config.padding.iter();
        // Of each convolution with three taps in the order of execution.
        let mut ahead = |dilation: u8| {
            let right = padding.next().map_or(u16::from(dilation), |padding| padding.right);
            ConvShape { taps: 3, dilation, right, inputs: width, outputs: width }
        };
        let mut bound = largest_input;
        let mut index = tensors.index();
        let input = Conv1d::open(tensors, ConvShape { inputs: code_width, ..ahead(1) })?;
        bound = bounded(input.bound(bound), index)?;
        let mut stages = Vec::new();
        for _ in 0..config.stages {
            let mut blocks = Vec::new();
            for &dilation in &config.dilations {
                index = tensors.index();
                let hidden = ahead(dilation);
                let conv1 = Conv1d::open(tensors, hidden)?;
                let conv2 = Conv1d::open(tensors, ConvShape { taps: 1, dilation: 1, right: 0, ..hidden })?;
                bound = bounded(bound + conv2.bound(conv1.bound(bound)), index)?;
                blocks.push(Residual { conv1, conv2 }).map_err(|_| Error::Manifest)?;
            }
            index = tensors.index();
            let upsample = Conv1d::open(tensors, ahead(1))?;
            bound = bounded(upsample.bound(bound), index)?;
            stages.push(UpsampleStage { blocks, upsample }).map_err(|_| Error::Manifest)?;
        }
        index = tensors.index();
        let middle = Conv1d::open(tensors, ahead(1))?;
        bound = bounded(middle.bound(bound), index)?;
        index = tensors.index();
        let output = Output::open(tensors, ConvShape { outputs: features, ..ahead(1) })?;
        bounded(output.bound(bound), index)?;
        let (width, code_width) = (usize::from(width), usize::from(code_width));
        Ok(Decoder { input, stages, middle, output, width, code_width })
    }

    /// The last layer.
    #[must_use]
    pub const fn output(&self) -> &Output<'a> {
        &self.output
    }

    /// Frames a token.
    #[must_use]
    pub fn upsampling(&self) -> usize {
        1 << self.stages.len()
    }

    /// Width of a code, `du`.
    #[must_use]
    pub const fn code_width(&self) -> usize {
        self.code_width
    }

    /// Output features, `F`.
    #[must_use]
    pub const fn features(&self) -> usize {
        self.output.outputs()
    }

    /// Leading output features with int16 weights.
    #[must_use]
    pub const fn wide(&self) -> usize {
        self.output.wide()
    }

    /// Multiply-accumulates of one forward pass over `tokens` for `channels` at most, in a workspace for so many rows
    /// ([`Decoder::workspace`]), taps outside the sequence included; the gradient costs the same but for the upsampling convolutions,
    /// which it does once a tap as well.
    #[must_use]
    pub fn macs(&self, tokens: usize, channels: &Channels, rows: usize) -> u64 {
        let chunks = (tokens + self.radius_tokens()).div_ceil(ChunkShape::new(tokens, rows).tokens.max(1));
        tokens as u64 * self.token_macs(channels) + chunks as u64 * self.chunk_macs()
    }

    /// Multiply-accumulates of a token.
    pub(super) fn token_macs(&self, channels: &Channels) -> u64 {
        let mut rows = 1;
        let mut macs = self.input.macs();
        for stage in &self.stages {
            for block in &stage.blocks {
                macs += rows * (block.conv1.macs() + block.conv2.macs());
            }
            macs += rows * stage.upsample.macs();
            rows *= 2;
        }
        macs + rows * (self.middle.macs() + self.output.macs(channels))
    }

    /// Those of a chunk beyond its tokens': the row that it and the next both multiply in the upsampling convolutions, by one of three taps.
    pub(super) fn chunk_macs(&self) -> u64 {
        self.stages.iter().map(|stage| stage.upsample.macs().div_ceil(3)).sum()
    }

    /// Bytes of [`Decoder::workspace`] that grow with the motion: a bit for each ReLU.
    #[must_use]
    pub fn gate_bytes(&self, tokens: usize) -> usize {
        bytes_of::<u32>(self.gate_words(tokens))
    }

    fn gate_words(&self, tokens: usize) -> usize {
        self.gates(tokens) * mask::words(self.width)
    }

    /// Bytes of a pass, whichever way.
    fn pass_bytes(&self, portion: ChunkShape, channels: usize) -> usize {
        let bytes = |way| Arena::measure(|arena| self.chain(arena, way, portion, channels));
        let [forward, back] = [Direction::Forward, Direction::Back].map(bytes);
        if forward > back { forward } else { back }
    }

    /// Arena bytes of [`Decoder::workspace`].
    #[must_use]
    pub fn workspace_bytes(&self, tokens: usize, channels: usize, rows: usize) -> usize {
        Arena::measure(|arena| self.workspace(arena, tokens, channels, rows))
    }

    /// Takes the buffers for motions of `tokens` tokens and at most `channels` output channels, as much at a time as `rows` says
    /// ([`crate::Limits::rows`]).
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn workspace<'w>(
        &self,
        arena: &mut Arena<'w>,
        tokens: usize,
        channels: usize,
        rows: usize,
    ) -> Result<Workspace<'w>, ArenaTooSmall> {
        let portion = ChunkShape::new(tokens, rows);
        Ok(Workspace {
            portion,
            gates: arena.take(self.gate_words(tokens))?,
            spare: arena.part(self.pass_bytes(portion, channels))?,
        })
    }
}

impl Decode for Decoder<'_> {
    type Workspace<'w> = Workspace<'w>;

    fn code_width(&self) -> usize {
        self.code_width
    }

    fn frames_per_token(&self) -> usize {
        self.upsampling()
    }

    /// Decodes `u [L][du]` to normalised features `out [T][C]` of `channels`. With a workspace that was taken for
    /// fewer of them or fewer tokens `out` is undefined.
    ///
    /// Breaks off when `check` says so; `out` is then undefined.
    fn forward(
        &self,
        u: &[f32],
        channels: &Channels,
        out: &mut [f32],
        work: &mut Workspace<'_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        let tokens = u.len() / self.code_width.max(1);
        let mut gates = ReluMask { bits: work.gates, words: mask::words(self.width), kept: Some(tokens) };
        let chunk = work.portion.tokens;
        let mut chain = self.chain(&mut work.spare.overlay(), Direction::Forward, work.portion, channels.count());
        invariant!(chain.is_ok(), "{:?}", chain.as_ref().err());
        let Ok(chain) = &mut chain else { return ControlFlow::Continue(()) };
        let mut chunks = u.chunks((chunk * self.code_width).max(1));
        let mut out = out.iter_mut();
        while !chain.ended() {
            let now = chunks.next().unwrap_or(&[]);
            copy(now, chain.begin(self, now.len() / self.code_width.max(1)));
            if chunks.len() == 0 {
                chain.end();
            }
            let rows = chain.pass(self, channels, &mut gates, check)?;
            for (from, to) in rows.iter().zip(out.by_ref()) {
                *to = *from;
            }
        }
        ControlFlow::Continue(())
    }

    /// Carries `g = dJ/d(features) [T][C]` of the last [`Decoder::forward`] back to `du = dJ/du [L][du]`, with the workspace of that
    /// pass.
    ///
    /// Breaks off when `check` says so; `du` is then undefined.
    fn backward(
        &self,
        g: &[f32],
        channels: &Channels,
        du: &mut [f32],
        work: &mut Workspace<'_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        let tokens = du.len() / self.code_width.max(1);
        let mut gates = ReluMask { bits: work.gates, words: mask::words(self.width), kept: Some(tokens) };
        let chunk = work.portion.tokens;
        let mut chain = self.chain(&mut work.spare.overlay(), Direction::Back, work.portion, channels.count());
        invariant!(chain.is_ok(), "{:?}", chain.as_ref().err());
        let Ok(chain) = &mut chain else { return ControlFlow::Continue(()) };
        let (frames, step) = (tokens * self.upsampling(), chunk * self.upsampling());
        let (mut first, mut du) = (0, du.iter_mut());
        while !chain.ended() {
            let count = step.min(frames.saturating_sub(first));
            chain.begin_gradient(self, g, channels, first, count);
            first += count;
            if first >= frames {
                chain.end();
            }
            let rows = chain.pass(self, channels, &mut gates, check)?;
            for (from, to) in rows.iter().zip(du.by_ref()) {
                *to = *from;
            }
        }
        ControlFlow::Continue(())
    }
}

/// Copies as many values as both have.
pub(super) fn copy<T: Copy>(from: &[T], to: &mut [T]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}

/// Refuses magnitudes beyond which a sum of squares would overflow.
fn bounded(bound: f32, index: u16) -> Result<f32, Error> {
    if bound < crate::model::MAX_MAGNITUDE { Ok(bound) } else { Err(Error::Unbounded { index }) }
}
