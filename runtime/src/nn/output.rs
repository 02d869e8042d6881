//! The last convolution, k3: evaluates only the feature channels a request needs, and keeps its leading rows in int16.
//!
//! Root velocities integrate over time, so their rows are stored with 16 bits, as two int8 planes: no kernel is added
//! (`acc = 256 acc_high + acc_low`, combined in f32) and nothing overflows.

use super::conv1d::{ConvShape, Rows, Span, larger, planes_follow, row_bound, weight_norm};
use super::{epilogue, quantise};
use crate::blob::{Error, Tensors};
use crate::channels::{Channels, Range};
use crate::kernels::{linear_s16s8, linear_transposed_s16s8, wide};

/// Rows of gradients that so many rows of the input's gradient depend on.
#[must_use]
pub const fn window(rows: usize) -> usize {
    rows + 2
}

/// Convolution to the features, in flash.
#[derive(Debug, Clone, Copy)]
pub struct Output<'a> {
    taps: usize,
    /// Rows that the first tap looks back.
    left: usize,
    inputs: usize,
    outputs: usize,
    /// Leading output channels with int16 weights.
    wide: usize,
    /// `[taps][wide][K]`
    high: &'a [i8],
    /// `[taps][wide][K]`
    low: &'a [i8],
    /// `[taps][N - wide][K]`
    weights: &'a [i8],
    scales: &'a [f32],
    biases: &'a [f32],
}

/// OutputScratch of one call.
#[derive(Debug)]
pub struct OutputScratch<'a> {
    /// One row of selected channels, `[C]`.
    pub row: &'a mut [f32],
    /// Rows of selected channels, quantised, range by range: `[window(B)][C]`, or as many as there are.
    pub q: &'a mut [i16],
    /// Scales of their int16 parts, then of the others: `[2][window(B)]`.
    pub scales: &'a mut [f32],
    /// Rows that are multiplied at a time, `B`.
    pub rows_per_block: usize,
    /// As [`accumulators`](super::conv1d::accumulators) says for so many rows, or for as many as there are.
    pub acc: &'a mut [i32],
    /// The same.
    pub acc_low: &'a mut [i32],
}

impl<'a> Output<'a> {
    /// Reads planes (if the layer has int16 rows), int8 rows, scales and biases from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or holds refused values.
    pub fn open(tensors: &mut Tensors<'a>, shape: ConvShape) -> Result<Self, Error> {
        let ConvShape { taps, inputs, outputs, .. } = shape;
        let (mut wide, mut high, mut low): (u16, &[i8], &[i8]) = (0, &[], &[]);
        if planes_follow(tensors) {
            let tensor = tensors.take()?;
            let [_, rows, _] = tensor.entry.shape;
            wide = if rows > outputs { outputs } else { rows };
            (high, low) = tensor.planes([taps, wide, inputs])?;
        }
        let weights: &[i8] =
            if wide == outputs { &[] } else { tensors.take()?.bytes([taps, outputs - wide, inputs])? };
        let scales = tensors.take()?.scales(outputs)?;
        let biases = tensors.take()?.f32s(outputs)?;
        Ok(Output {
            taps: usize::from(taps),
            left: shape.left(),
            inputs: usize::from(inputs),
            outputs: usize::from(outputs),
            wide: usize::from(wide),
            high,
            low,
            weights,
            scales,
            biases,
        })
    }

    /// Output channels in all.
    #[must_use]
    pub const fn outputs(&self) -> usize {
        self.outputs
    }

    /// Input channels.
    #[must_use]
    pub const fn inputs(&self) -> usize {
        self.inputs
    }

    /// Leading output channels with int16 weights.
    #[must_use]
    pub const fn wide(&self) -> usize {
        self.wide
    }

    /// Rows before it that an output row depends on.
    #[must_use]
    pub const fn left(&self) -> usize {
        self.left
    }

    /// Rows behind it that an output row depends on.
    #[must_use]
    pub const fn right(&self) -> usize {
        self.taps.saturating_sub(1).saturating_sub(self.left)
    }

    /// A bound of `|y|` when `|x| <= input`.
    #[must_use]
    pub fn bound(&self, input: f32) -> f32 {
        let mut bound = 0.0f32;
        for (n, (scale, bias)) in self.scales.iter().zip(self.biases).enumerate() {
            let mut norm = 0.0f32;
            for tap in 0..self.taps {
                let one = Range { first: n, count: 1 };
                norm += if n < self.wide {
                    256.0 * weight_norm(Some(self.rows(self.high, self.wide, tap, one))) as f32
                        + weight_norm(Some(self.rows(self.low, self.wide, tap, one))) as f32
                } else {
                    let one = Range { first: n - self.wide, count: 1 };
                    weight_norm(Some(self.rows(self.weights, self.outputs - self.wide, tap, one))) as f32
                };
            }
            bound = larger(bound, row_bound(norm, input, *scale, *bias));
        }
        bound
    }

    /// Multiply-accumulates for one row of `channels` whose taps all lie inside; int16 rows count twice.
    #[must_use]
    pub fn macs(&self, channels: &Channels) -> u64 {
        let mut rows = 0;
        for range in channels.ranges() {
            let (wide, narrow) = self.split(range);
            rows += 2 * wide.count + narrow.count;
        }
        (self.taps * self.inputs * rows) as u64
    }

    /// Computes `channels` of rows `first..`, as many as `out [B][C]` holds, `C = channels.count()`.
    pub fn forward(
        &self,
        x: Rows<'_>,
        first: usize,
        channels: &Channels,
        out: &mut [f32],
        scratch: &mut OutputScratch<'_>,
    ) {
        let width = channels.count().max(1);
        let (count, rows) = (out.len() / width, x.scales.len());
        if count == 0 {
            return;
        }
        out.fill(0.0);
        for tap in 0..self.taps {
            let offset = tap as isize - self.left as isize;
            for block in (0..count).step_by(scratch.rows_per_block.max(1)) {
                let rows_per_block = scratch.rows_per_block.min(count.saturating_sub(block));
                let Some(span) = Span::new(first + block, rows_per_block, rows, offset) else {
                    continue;
                };
                let Rows { q, scales } = x.window(span.source, span.rows, self.inputs);
                let out = part_mut!(out, (block + span.skip) * width..);
                let mut column = 0;
                for range in channels.ranges() {
                    let (wide, narrow) = self.split(range);
                    if wide.count > 0 {
                        let out = part_mut!(out, column..);
                        let (high, low) = (&mut *scratch.acc, &mut *scratch.acc_low);
                        linear_s16s8(q, self.rows(self.high, self.wide, tap, wide), self.inputs, wide.count, high);
                        linear_s16s8(q, self.rows(self.low, self.wide, tap, wide), self.inputs, wide.count, low);
                        epilogue::add_planes(out, width, high, low, wide.count, scales);
                    }
                    column += wide.count;
                    if narrow.count > 0 {
                        let out = part_mut!(out, column..);
                        let weights = self.rows(self.weights, self.outputs - self.wide, tap, narrow);
                        linear_s16s8(q, weights, self.inputs, narrow.count, scratch.acc);
                        epilogue::add(out, width, scratch.acc, narrow.count, scales);
                    }
                    column += narrow.count;
                }
            }
        }
        let mut column = 0;
        for range in channels.ranges() {
            let constants = range.first..range.first + range.count;
            let scales = part!(self.scales, constants.clone());
            let biases = part!(self.biases, constants);
            epilogue::scale(part_mut!(out, column..), width, (scales, biases));
            column += range.count;
        }
    }

    /// Input gradient: rows `first..` of `dJ/dx`, as many as `dx [B][K]` holds, from `g [R][C]` of the selected channels. Root rows
    /// and the others are quantised apart, since root gradients are sums over time and much larger.
    pub fn backward(
        &self,
        g: &[f32],
        channels: &Channels,
        first: usize,
        dx: &mut [f32],
        scratch: &mut OutputScratch<'_>,
    ) {
        let width = channels.count().max(1);
        let limit = quantise::limit(self.outputs);
        let all = g.len() / width;
        dx.fill(0.0);
        let all_scales = core::mem::take(&mut scratch.scales);
        let (wide_scales, narrow_scales) = all_scales.split_at_mut_checked(all_scales.len() / 2).unwrap_or_default();
        for (block, dx) in dx.chunks_mut((scratch.rows_per_block * self.inputs).max(1)).enumerate() {
            let (first, count) = (first + block * scratch.rows_per_block, dx.len() / self.inputs.max(1));
            let start = first.saturating_sub(self.right());
            let g = part!(g, start * width..(first + count + self.left).min(all) * width);
            let rows = g.len() / width;
            for (r, (g, scales)) in
                g.chunks_exact(width).zip(wide_scales.iter_mut().zip(narrow_scales.iter_mut())).enumerate()
            {
                (*scales.0, *scales.1) = self.quantise_row(g, channels, limit, (r, rows), scratch);
            }
            // Descending taps: a row of dx takes its sums in the order of the rows that they come from.
            for tap in (0..self.taps).rev() {
                let offset = self.left as isize - tap as isize;
                let Some(span) = Span::new(first, count, all, offset) else { continue };
                let dx = part_mut!(dx, span.skip * self.inputs..);
                let from = span.source.saturating_sub(start);
                let part = (from..from + span.rows, rows);
                self.backward_tap(tap, part, channels, dx, (wide_scales, narrow_scales), scratch);
            }
        }
        scratch.scales = all_scales;
    }

    /// Row `r` of `rows`: gradients `g [C]` times the output scales, quantised into `scratch.q`, where each part of a range
    /// is `[rows][count]`. Returns the scales of the int16 and the int8 part.
    fn quantise_row(
        &self,
        g: &[f32],
        channels: &Channels,
        limit: i16,
        (r, rows): (usize, usize),
        scratch: &mut OutputScratch<'_>,
    ) -> (f32, f32) {
        let row = part_mut!(scratch.row, ..g.len());
        let (mut wide_count, mut column) = (0, 0);
        for range in channels.ranges() {
            let scales = part!(self.scales, range.first..range.first + range.count);
            let row = part_mut!(row, column..);
            wide!({
                for ((row, g), s) in row.iter_mut().zip(part!(g, column..)).zip(scales) {
                    *row = *g * *s;
                }
            });
            column += range.count;
            wide_count += self.split(range).0.count;
        }
        let Some((wide_row, narrow_row)) = row.split_at_checked(wide_count) else { return (0.0, 0.0) };
        let wide = quantise::step(wide_row, limit);
        let narrow = quantise::step(narrow_row, limit);
        let mut column = 0;
        for range in channels.ranges() {
            let (wide_part, narrow_part) = self.split(range);
            for (count, step) in [(wide_part.count, wide), (narrow_part.count, narrow)] {
                let first = column * rows + r * count;
                let q = part_mut!(scratch.q, first..first + count);
                quantise::part(part!(row, column..column + count), step, q);
                column += count;
            }
        }
        (wide.scale, narrow.scale)
    }

    /// Adds what one tap carries back from a range of the quantised rows, of which there are so many, to `dx`, one row each.
    fn backward_tap(
        &self,
        tap: usize,
        (range, rows): (core::ops::Range<usize>, usize),
        channels: &Channels,
        dx: &mut [f32],
        (wide_scales, narrow_scales): (&[f32], &[f32]),
        scratch: &mut OutputScratch<'_>,
    ) {
        let width = self.inputs.max(1);
        let core::ops::Range { start, end } = range;
        let part = |column: usize, count: usize| column * rows + start * count..column * rows + end * count;
        let wide_scales = part!(wide_scales, start..end);
        let narrow_scales = part!(narrow_scales, start..end);
        let mut column = 0;
        for range in channels.ranges() {
            let (wide, narrow) = self.split(range);
            if wide.count > 0 {
                let q = part!(scratch.q, part(column, wide.count));
                let high = self.rows(self.high, self.wide, tap, wide);
                let low = self.rows(self.low, self.wide, tap, wide);
                linear_transposed_s16s8(q, high, self.inputs, wide.count, scratch.acc);
                linear_transposed_s16s8(q, low, self.inputs, wide.count, scratch.acc_low);
                epilogue::add_planes(dx, width, scratch.acc, scratch.acc_low, width, wide_scales);
            }
            column += wide.count;
            if narrow.count > 0 {
                let q = part!(scratch.q, part(column, narrow.count));
                let weights = self.rows(self.weights, self.outputs - self.wide, tap, narrow);
                linear_transposed_s16s8(q, weights, self.inputs, narrow.count, scratch.acc);
                epilogue::add(dx, width, scratch.acc, width, narrow_scales);
            }
            column += narrow.count;
        }
    }

    /// The int16 and the int8 part of a range; the int8 part counts from the first int8 row.
    fn split(&self, range: Range) -> (Range, Range) {
        let end = range.first + range.count;
        let wide_end = if end < self.wide { end } else { self.wide };
        let wide = Range { first: range.first, count: wide_end.saturating_sub(range.first) };
        let first = range.first.saturating_sub(self.wide);
        (wide, Range { first, count: range.count - wide.count })
    }

    /// Weights `[range.count][K]` of one tap in `plane [taps][rows][K]`.
    fn rows(&self, plane: &'a [i8], rows: usize, tap: usize, range: Range) -> &'a [i8] {
        let first = (tap * rows + range.first) * self.inputs;
        part!(plane, first..first + range.count * self.inputs)
    }
}
