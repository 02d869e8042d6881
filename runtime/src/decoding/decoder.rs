//! The VQ decoder: `u [L][du]` to features `[T][C]`, `T = L * 2^stages`, and the input gradient.
//!
//! Order of execution (MoMask's and T2M-GPT's, DESIGN section 3): conv k3, ReLU, stages of { residual blocks, nearest
//! x2, conv k3 }, conv k3, ReLU, conv k3 to the features. One f32 buffer holds the sequence at its present length and
//! is updated in place; ReLUs leave one bit a value behind for the gradient.

use crate::arena::{Arena, ArenaTooSmall, bytes_of};
use crate::blob::{DecoderConfig, Error, MAX_BLOCKS, MAX_STAGES, Tensors};
use crate::nn::conv1d::{BLOCK, Conv1d, GradientBlock, Rows, Shape, accumulators};
use crate::nn::output::{self, Channels, Output};
use crate::nn::residual::{self, Masks, Residual};
use crate::nn::{mask, quantise};
use heapless::Vec;

/// Residual blocks and the upsampling convolution behind them.
#[derive(Debug, Clone)]
pub(super) struct Stage<'a> {
    pub(super) blocks: Vec<Residual<'a>, MAX_BLOCKS>,
    pub(super) upsample: Conv1d<'a>,
}

/// The decoder's layers in flash.
#[derive(Debug, Clone)]
pub struct Decoder<'a> {
    pub(super) input: Conv1d<'a>,
    pub(super) stages: Vec<Stage<'a>, MAX_STAGES>,
    pub(super) middle: Conv1d<'a>,
    pub(super) output: Output<'a>,
    pub(super) width: usize,
    code_width: usize,
}

pub use crate::nn::{Check, Interrupted};

/// All mutable memory of the decoder.
#[derive(Debug)]
pub struct Workspace<'a> {
    /// The sequence, `[T][W]` at its longest. Free for other use between calls.
    pub sequence: &'a mut [f32],
    masks: &'a mut [u32],
    scratch: residual::Scratch<'a>,
    output_row: &'a mut [f32],
    output_q: &'a mut [i16],
    acc_low: &'a mut [i32],
}

impl<'a> Workspace<'a> {
    /// Takes the sequence, and the last layer's input of the last [`Decoder::forward`] of so many `frames`.
    #[must_use]
    pub fn finish(self, frames: usize, width: usize) -> (&'a mut [f32], Rows<'a>) {
        (self.sequence, quantised(self.scratch.q, self.scratch.scales, frames, width))
    }
}

/// Elements of each buffer of a [`Workspace`].
#[derive(Debug, Clone, Copy)]
struct Sizes {
    frames: usize,
    sequence: usize,
    q: usize,
    masks: usize,
    row: usize,
    acc: usize,
    output: usize,
}

impl<'a> Decoder<'a> {
    /// Reads the decoder's layers in order from the next tensors and checks that activations stay finite.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(tensors: &mut Tensors<'a>, config: &DecoderConfig, largest_input: f32) -> Result<Self, Error> {
        let &DecoderConfig { width, code_width, features, .. } = config;
        let hidden = Shape { taps: 3, dilation: 1, inputs: width, outputs: width };
        let mut bound = largest_input;
        let mut index = tensors.index();
        let input = Conv1d::open(tensors, Shape { inputs: code_width, ..hidden })?;
        bound = bounded(input.bound(bound), index)?;
        let mut stages = Vec::new();
        for _ in 0..config.stages {
            let mut blocks = Vec::new();
            for &dilation in &config.dilations {
                index = tensors.index();
                let conv1 = Conv1d::open(tensors, Shape { dilation, ..hidden })?;
                let conv2 = Conv1d::open(tensors, Shape { taps: 1, ..hidden })?;
                bound = bounded(bound + conv2.bound(conv1.bound(bound)), index)?;
                blocks.push(Residual { conv1, conv2 }).map_err(|_| Error::Manifest)?;
            }
            index = tensors.index();
            let upsample = Conv1d::open(tensors, hidden)?;
            bound = bounded(upsample.bound(bound), index)?;
            stages.push(Stage { blocks, upsample }).map_err(|_| Error::Manifest)?;
        }
        index = tensors.index();
        let middle = Conv1d::open(tensors, hidden)?;
        bound = bounded(middle.bound(bound), index)?;
        index = tensors.index();
        let output = Output::open(tensors, Shape { outputs: features, ..hidden })?;
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

    /// Multiply-accumulates of one forward pass over `tokens` for `channels`, taps outside the sequence included;
    /// the gradient costs the same but for the upsampling convolutions, which it does once a tap as well.
    #[must_use]
    pub fn macs(&self, tokens: usize, channels: &Channels) -> u64 {
        let mut rows = tokens as u64;
        let mut macs = rows * self.input.macs();
        for stage in &self.stages {
            for block in &stage.blocks {
                macs += rows * (block.conv1.macs() + block.conv2.macs());
            }
            macs += rows * stage.upsample.macs();
            rows *= 2;
        }
        macs + rows * (self.middle.macs() + self.output.macs(channels))
    }

    fn sizes(&self, tokens: usize, channels: usize, columns: usize) -> Sizes {
        let frames = tokens * self.upsampling();
        let (width, words) = (self.width, mask::words(self.width));
        let widest = if self.code_width > width { self.code_width } else { width };
        // The input sequence is `tokens` rows of `du`; everything later is rows of `width`.
        let (short, long) = (tokens * self.code_width, frames * width);
        let mut masked_rows = tokens + frames;
        let mut rows = tokens;
        for stage in &self.stages {
            masked_rows += 2 * rows * stage.blocks.len();
            rows *= 2;
        }
        let most = if channels > widest { channels } else { widest };
        Sizes {
            frames,
            sequence: frames * if columns > width { columns } else { width },
            q: if short > long { short } else { long },
            masks: masked_rows * words,
            row: widest,
            // Forward and backward: whatever counts the sums may count the terms.
            acc: accumulators(BLOCK, most, most),
            output: channels,
        }
    }

    /// Arena bytes of [`Decoder::workspace`].
    #[must_use]
    pub fn workspace_bytes(&self, tokens: usize, channels: usize, columns: usize) -> usize {
        let s = self.sizes(tokens, channels, columns);
        bytes_of::<f32>(s.sequence)
            + bytes_of::<u32>(s.masks)
            + bytes_of::<i16>(s.q)
            + bytes_of::<f32>(s.frames)
            + bytes_of::<f32>(BLOCK * s.row)
            + bytes_of::<i16>(BLOCK * s.row)
            + bytes_of::<f32>(BLOCK)
            + bytes_of::<f32>(s.row)
            + bytes_of::<i32>(s.acc)
            + bytes_of::<f32>(s.output)
            + bytes_of::<i16>(BLOCK * s.output)
            + bytes_of::<i32>(s.acc)
    }

    /// Takes the buffers for motions of `tokens` tokens and at most `channels` output channels. The sequence buffer
    /// has at least `columns` values a frame, for the caller's own use when the decoder is done.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn workspace<'w>(
        &self,
        arena: &mut Arena<'w>,
        tokens: usize,
        channels: usize,
        columns: usize,
    ) -> Result<Workspace<'w>, ArenaTooSmall> {
        let s = self.sizes(tokens, channels, columns);
        Ok(Workspace {
            sequence: arena.take(s.sequence)?,
            masks: arena.take(s.masks)?,
            scratch: residual::Scratch {
                q: arena.take(s.q)?,
                scales: arena.take(s.frames)?,
                row: arena.take(s.row)?,
                block: residual::Block {
                    rows: arena.take(BLOCK * s.row)?,
                    q: arena.take(BLOCK * s.row)?,
                    scales: arena.take(BLOCK)?,
                    acc: arena.take(s.acc)?,
                },
            },
            output_row: arena.take(s.output)?,
            output_q: arena.take(BLOCK * s.output)?,
            acc_low: arena.take(s.acc)?,
        })
    }

    /// Decodes `u [L][du]` to normalised features `out [T][C]` of `channels`.
    ///
    /// # Errors
    /// [`Interrupted`] when `check` says so; `out` is then undefined.
    pub fn forward(
        &self,
        u: &[f32],
        channels: &Channels,
        out: &mut [f32],
        work: &mut Workspace<'_>,
        check: Check<'_>,
    ) -> Result<(), Interrupted> {
        let Workspace { sequence, masks, scratch, output_row, output_q, acc_low } = work;
        let (width, words) = (self.width, mask::words(self.width));
        let mut rows = u.len() / self.code_width.max(1);
        let mut masks = Carver::new(masks);

        let x = quantise_rows(u, scratch.q, scratch.scales, rows, self.code_width);
        let y = sequence.get_mut(..rows * width).unwrap_or(&mut []);
        self.input.forward(x, 0, y, scratch.block.acc);
        relu_rows(y, masks.front(rows * words), width);
        check()?;
        for stage in &self.stages {
            for block in &stage.blocks {
                let x = sequence.get_mut(..rows * width).unwrap_or(&mut []);
                let mut masks = Masks { input: masks.front(rows * words), hidden: masks.front(rows * words) };
                block.forward(x, scratch, &mut masks);
                check()?;
            }
            let x = quantise_rows(sequence, scratch.q, scratch.scales, rows, width);
            let y = sequence.get_mut(..2 * rows * width).unwrap_or(&mut []);
            stage.upsample.forward_upsampled(x, 0, y, scratch.block.acc);
            rows *= 2;
            check()?;
        }
        let x = quantise_rows(sequence, scratch.q, scratch.scales, rows, width);
        let y = sequence.get_mut(..rows * width).unwrap_or(&mut []);
        self.middle.forward(x, 0, y, scratch.block.acc);
        relu_rows(y, masks.front(rows * words), width);
        check()?;
        let x = quantise_rows(y, scratch.q, scratch.scales, rows, width);
        let mut last = output::Scratch { row: output_row, q: output_q, acc: scratch.block.acc, acc_low };
        self.output.forward(x, 0, channels, out, &mut last);
        check()
    }

    /// Carries `g = dJ/d(features) [T][C]` of the last [`Decoder::forward`] back to `du = dJ/du [L][du]`.
    ///
    /// # Errors
    /// [`Interrupted`] when `check` says so; `du` is then undefined.
    pub fn backward(
        &self,
        g: &[f32],
        channels: &Channels,
        du: &mut [f32],
        work: &mut Workspace<'_>,
        check: Check<'_>,
    ) -> Result<(), Interrupted> {
        let Workspace { sequence, masks, scratch, output_row, output_q, acc_low } = work;
        let (width, words) = (self.width, mask::words(self.width));
        let tokens = du.len() / self.code_width.max(1);
        let mut rows = tokens * self.upsampling();
        let used = self.sizes(tokens, 0, 0).masks;
        let mut masks = Carver::new(masks.get_mut(..used).unwrap_or(&mut []));

        let dx = sequence.get_mut(..rows * width).unwrap_or(&mut []);
        let mut last = output::Scratch { row: output_row, q: output_q, acc: scratch.block.acc, acc_low };
        self.output.backward(g, channels, dx, &mut last);
        gate_rows(dx, masks.back(rows * words), width);
        check()?;
        self.middle.quantise_gradient(dx, scratch.q, scratch.scales, scratch.row);
        let g = quantised(scratch.q, scratch.scales, rows, width);
        self.middle.backward(g, 0, dx, scratch.block.acc);
        check()?;
        for stage in self.stages.iter().rev() {
            let g = sequence.get_mut(..rows * width).unwrap_or(&mut []);
            let mut block = GradientBlock {
                row: scratch.row,
                sums: scratch.block.rows,
                q: scratch.block.q,
                scales: scratch.block.scales,
            };
            stage.upsample.backward_upsampled(g, &mut block, scratch.block.acc);
            rows /= 2;
            check()?;
            for block in stage.blocks.iter().rev() {
                let g = sequence.get_mut(..rows * width).unwrap_or(&mut []);
                let hidden = masks.back(rows * words);
                let masks = Masks { input: masks.back(rows * words), hidden };
                block.backward(g, scratch, &masks);
                check()?;
            }
        }
        let g = sequence.get_mut(..rows * width).unwrap_or(&mut []);
        gate_rows(g, masks.back(rows * words), width);
        self.input.quantise_gradient(g, scratch.q, scratch.scales, scratch.row);
        let g = quantised(scratch.q, scratch.scales, rows, width);
        self.input.backward(g, 0, du, scratch.block.acc);
        check()
    }
}

/// Refuses magnitudes beyond which a sum of squares would overflow.
fn bounded(bound: f32, index: u16) -> Result<f32, Error> {
    if bound < crate::model::MAX_MAGNITUDE { Ok(bound) } else { Err(Error::Unbounded { index }) }
}

fn quantised<'q>(q: &'q [i16], scales: &'q [f32], rows: usize, width: usize) -> Rows<'q> {
    Rows { q: q.get(..rows * width).unwrap_or(&[]), scales: scales.get(..rows).unwrap_or(&[]) }
}

/// Quantises the first `rows` rows of `x`.
fn quantise_rows<'q>(x: &[f32], q: &'q mut [i16], scales: &'q mut [f32], rows: usize, width: usize) -> Rows<'q> {
    let x = x.get(..rows * width).unwrap_or(&[]);
    quantise::rows(x, width, quantise::limit(width), q, scales);
    quantised(q, scales, rows, width)
}

fn relu_rows(x: &mut [f32], masks: &mut [u32], width: usize) {
    let words = mask::words(width).max(1);
    for (x, mask) in x.chunks_exact_mut(width.max(1)).zip(masks.chunks_exact_mut(words)) {
        mask::relu(x, mask);
    }
}

fn gate_rows(g: &mut [f32], masks: &[u32], width: usize) {
    let words = mask::words(width).max(1);
    for (g, mask) in g.chunks_exact_mut(width.max(1)).zip(masks.chunks_exact(words)) {
        mask::gate(g, mask);
    }
}

/// Takes pieces from either end of a buffer.
struct Carver<'a> {
    rest: &'a mut [u32],
}

impl<'a> Carver<'a> {
    fn new(rest: &'a mut [u32]) -> Self {
        Carver { rest }
    }

    fn front(&mut self, count: usize) -> &'a mut [u32] {
        let rest = core::mem::take(&mut self.rest);
        match rest.split_at_mut_checked(count) {
            Some((piece, rest)) => {
                self.rest = rest;
                piece
            }
            None => &mut [],
        }
    }

    fn back(&mut self, count: usize) -> &'a mut [u32] {
        let rest = core::mem::take(&mut self.rest);
        let keep = rest.len().saturating_sub(count);
        match rest.split_at_mut_checked(keep) {
            Some((rest, piece)) => {
                self.rest = rest;
                piece
            }
            None => &mut [],
        }
    }
}
