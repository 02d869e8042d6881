//! 1-D convolution, int8 weights, int16 rows: forward, upsampled forward, and input gradient of both.
//!
//! `y[t][n] = s[n] * sum_tap a_tap(t)[n] + b[n]`, `a_tap(t)[n] = sx[r] * sum_k q[r][k] w[tap][n][k]`, `r = t + (tap - c) d`,
//! `c` the middle tap, `d` the dilation, rows outside the sequence left out. The inner sum is int32; taps are added
//! in f32 in tap order, starting from zero.
//!
//! Weights of 16 bits are two planes, `w = 256 high + low`: `a_tap` is added in two parts, `256 sx sum q high` and `sx sum q low`, in this order.
//! Gradients go through the high plane alone, which is the weight rounded to 8 bits.

use super::epilogue::{self, Affine};
use super::quantise;
use crate::blob::{DType, Error, Tensors};
use crate::kernels::{linear_s16s8, linear_transposed_s16s8, room, wide};
use serde::Serialize;

/// Length of accumulators for so many rows of `sums` sums of `terms` terms, [`room`] behind them included.
#[must_use]
pub const fn accumulators(rows: usize, terms: usize, sums: usize) -> usize {
    rows * sums + room(rows, terms)
}

/// A convolution layer in flash.
#[derive(Debug, Clone, Copy)]
pub struct Conv1d<'a> {
    /// Kernel size: 1 or 3.
    taps: usize,
    /// Distance of neighbouring taps, rows.
    dilation: usize,
    /// Rows that the first tap looks back.
    left: usize,
    /// Input channels `K`.
    inputs: usize,
    /// Output channels `N`.
    outputs: usize,
    /// `[taps][N][K]`; the high plane of 16-bit ones.
    weights: &'a [i8],
    /// The low plane; empty where weights have 8 bits.
    #[cfg(feature = "wide-layers")]
    low: &'a [i8],
    /// `[N]`
    scales: &'a [f32],
    /// `[N]`
    biases: &'a [f32],
}

/// ConvShape of a layer to be read from a blob.
#[derive(Debug, Clone, Copy)]
pub struct ConvShape {
    /// Kernel size.
    pub taps: u16,
    /// Distance of neighbouring taps, rows.
    pub dilation: u8,
    /// Rows that the last tap looks ahead, at most as many as lie between it and the first.
    pub right: u16,
    /// Input channels.
    pub inputs: u16,
    /// Output channels.
    pub outputs: u16,
}

/// Rows of nothing before and behind a sequence, that a convolution's taps may reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Padding {
    /// Rows before the first: how far an output row looks back.
    pub left: u16,
    /// Rows behind the last: how far an output row looks ahead.
    pub right: u16,
}

impl ConvShape {
    /// Rows that the first tap looks back.
    pub(super) fn left(&self) -> usize {
        let span = usize::from(self.taps).saturating_sub(1) * usize::from(self.dilation);
        span.saturating_sub(usize::from(self.right))
    }
}

impl Padding {
    /// So many rows on either side.
    #[must_use]
    pub const fn symmetrical(rows: u16) -> Self {
        Padding { left: rows, right: rows }
    }
}

/// Quantised rows: `x[r][k] ~ q[r][k] * scales[r]`.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// `[R][K]`
    pub q: &'a [i16],
    /// `[R]`
    pub scales: &'a [f32],
}

impl<'a> Rows<'a> {
    /// `count` rows of `width` channels from row `first` on; fewer where the sequence ends.
    #[inline]
    pub(super) fn window(&self, first: usize, count: usize, width: usize) -> Rows<'a> {
        let q = part!(self.q, first * width..);
        let scales = part!(self.scales, first..);
        Rows { q: q.get(..count * width).unwrap_or(q), scales: scales.get(..count).unwrap_or(scales) }
    }
}

impl<'a> Conv1d<'a> {
    /// Reads weights, scales and biases from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or holds refused values.
    pub fn open(tensors: &mut Tensors<'a>, shape: ConvShape) -> Result<Self, Error> {
        let ConvShape { taps, dilation, inputs, outputs, .. } = shape;
        #[cfg(feature = "wide-layers")]
        let (weights, low): (&[i8], &[i8]) = if planes_follow(tensors) {
            tensors.take()?.planes([taps, outputs, inputs])?
        } else {
            (tensors.take()?.bytes([taps, outputs, inputs])?, &[])
        };
        #[cfg(not(feature = "wide-layers"))]
        let weights = tensors.take()?.bytes([taps, outputs, inputs])?;
        let scales = tensors.take()?.scales(outputs)?;
        let biases = tensors.take()?.f32s(outputs)?;
        Ok(Conv1d {
            taps: usize::from(taps),
            dilation: usize::from(dilation),
            left: shape.left(),
            inputs: usize::from(inputs),
            outputs: usize::from(outputs),
            weights,
            #[cfg(feature = "wide-layers")]
            low,
            scales,
            biases,
        })
    }

    /// A layer of weights `[taps][N][K]`, scales and biases `[N]`; `None` where their lengths do not go together.
    #[must_use]
    pub fn new(shape: ConvShape, weights: &'a [i8], scales: &'a [f32], biases: &'a [f32]) -> Option<Self> {
        let (taps, inputs, outputs) = (usize::from(shape.taps), usize::from(shape.inputs), usize::from(shape.outputs));
        let fits = weights.len() == taps * inputs * outputs && scales.len() == outputs && biases.len() == outputs;
        let (dilation, left) = (usize::from(shape.dilation), shape.left());
        fits.then_some(Conv1d {
            taps,
            dilation,
            left,
            inputs,
            outputs,
            weights,
            #[cfg(feature = "wide-layers")]
            low: &[],
            scales,
            biases,
        })
    }

    /// The same with weights of 16 bits, `256 weights + low`; `None` where there are not as many.
    #[cfg(feature = "wide-layers")]
    #[must_use]
    pub fn with_low(self, low: &'a [i8]) -> Option<Self> {
        (low.len() == self.weights.len()).then_some(Conv1d { low, ..self })
    }

    /// Whether weights have 16 bits.
    #[must_use]
    pub const fn wide(&self) -> bool {
        #[cfg(feature = "wide-layers")]
        return !self.low.is_empty();
        #[cfg(not(feature = "wide-layers"))]
        false
    }

    /// What a scale stands for where gradients pass.
    const fn step(&self) -> f32 {
        if self.wide() { 256.0 } else { 1.0 }
    }

    /// Output channels.
    #[must_use]
    pub const fn outputs(&self) -> usize {
        self.outputs
    }

    /// Input channels.
    #[must_use]
    pub const fn inputs(&self) -> usize {
        self.inputs
    }

    /// Rows before it that an output row depends on.
    #[must_use]
    pub const fn left(&self) -> usize {
        self.left
    }

    /// Rows behind it that an output row depends on.
    #[must_use]
    pub const fn right(&self) -> usize {
        (self.taps.saturating_sub(1) * self.dilation).saturating_sub(self.left)
    }

    /// Multiply-accumulates for one output row whose taps all lie inside.
    #[must_use]
    pub const fn macs(&self) -> u64 {
        let planes = if self.wide() { 2 } else { 1 };
        (planes * self.taps * self.inputs * self.outputs) as u64
    }

    /// A bound of `|y|` when `|x| <= input` (row norms of the weights).
    #[must_use]
    #[inline(never)]
    pub fn bound(&self, input: f32) -> f32 {
        let mut bound = 0.0f32;
        for (n, (scale, bias)) in self.scales.iter().zip(self.biases).enumerate() {
            let mut norm = 0u32;
            for tap in 0..self.taps {
                norm += weight_norm(self.tap(tap).get(n * self.inputs..(n + 1) * self.inputs));
            }
            #[cfg(feature = "wide-layers")]
            if self.wide() {
                norm *= 256;
                for tap in 0..self.taps {
                    norm += weight_norm(self.low_tap(tap).get(n * self.inputs..(n + 1) * self.inputs));
                }
            }
            bound = larger(bound, row_bound(norm as f32, input, *scale, *bias));
        }
        bound
    }

    /// Weights `[N][K]` of one tap.
    #[inline]
    fn tap(&self, tap: usize) -> &'a [i8] {
        let size = self.outputs * self.inputs;
        part!(self.weights, tap * size..(tap + 1) * size)
    }

    /// The low plane of one tap.
    #[cfg(feature = "wide-layers")]
    fn low_tap(&self, tap: usize) -> &'a [i8] {
        let size = self.outputs * self.inputs;
        part!(self.low, tap * size..(tap + 1) * size)
    }

    /// [`Conv1d::forward`] of weights of 16 bits.
    #[cfg(feature = "wide-layers")]
    #[inline(never)]
    fn forward_wide(&self, x: Rows<'_>, first: usize, out: &mut [f32], rows_per_block: usize, acc: &mut [i32]) {
        let (width, rows) = (self.outputs, x.scales.len());
        out.fill(0.0);
        for (block, out) in out.chunks_mut((rows_per_block * width).max(1)).enumerate() {
            let (first, count) = (first + block * rows_per_block, out.len() / width.max(1));
            for tap in 0..self.taps {
                let Some(Span { skip, source, rows }) = Span::new(first, count, rows, self.offset(tap)) else {
                    continue;
                };
                let (x, out) = (x.window(source, rows, self.inputs), part_mut!(out, skip * width..));
                linear_s16s8(x.q, self.tap(tap), self.inputs, width, acc);
                epilogue::add_high(out, width, acc, width, x.scales);
                linear_s16s8(x.q, self.low_tap(tap), self.inputs, width, acc);
                epilogue::add(out, width, acc, width, x.scales);
            }
            epilogue::scale(out, width, self.affine());
        }
    }

    /// Computes output rows `first..` of `x`, as many as `out [B][N]` holds, `together` at a time: weights are read, and widened or transposed, once
    /// for so many. `acc` holds [`accumulators`] of these, or of as many as `out` has.
    pub fn forward(&self, x: Rows<'_>, first: usize, out: &mut [f32], rows_per_block: usize, acc: &mut [i32]) {
        #[cfg(feature = "wide-layers")]
        if self.wide() {
            return self.forward_wide(x, first, out, rows_per_block, acc);
        }
        let (width, rows) = (self.outputs, x.scales.len());
        for (block, out) in out.chunks_mut((rows_per_block * width).max(1)).enumerate() {
            let (first, count) = (first + block * rows_per_block, out.len() / width.max(1));
            for tap in 0..self.taps {
                let span = Span::new(first, count, rows, self.offset(tap));
                let last = tap + 1 == self.taps;
                let combine = combine(tap, count, span.as_ref(), out, last);
                if let Some(Span { skip, source, rows }) = span {
                    let x = x.window(source, rows, self.inputs);
                    linear_s16s8(x.q, self.tap(tap), self.inputs, width, acc);
                    if last && rows == count {
                        epilogue::finish_sum(out, acc, x.scales, self.affine());
                        continue;
                    }
                    combine(part_mut!(out, skip * width..), width, acc, width, x.scales);
                }
                if last {
                    epilogue::scale(out, width, self.affine());
                }
            }
        }
    }

    /// Adds what the middle tap makes of rows `x [B][K]`, which is all where the kernel size is 1, to `out [B][N]`, no more rows than
    /// `acc` has room for.
    pub fn add_pointwise(&self, x: Rows<'_>, out: &mut [f32], acc: &mut [i32]) {
        let tap = self.taps / 2;
        linear_s16s8(x.q, self.tap(tap), self.inputs, self.outputs, acc);
        #[cfg(feature = "wide-layers")]
        if self.wide() {
            epilogue::add_high_scaled(out, acc, x.scales, self.affine());
            linear_s16s8(x.q, self.low_tap(tap), self.inputs, self.outputs, acc);
        }
        epilogue::add_finished(out, acc, x.scales, self.affine());
    }

    /// Computes the convolution of `x` with every row repeated twice: rows `first..` of its `2 R`, as many as
    /// `out [B][N]` holds. A row's products serve both its copies, so this costs half of what the repeated sequence
    /// would, with the same bits.
    pub fn forward_upsampled(
        &self,
        x: Rows<'_>,
        first: usize,
        out: &mut [f32],
        rows_per_block: usize,
        acc: &mut [i32],
    ) {
        let (width, rows) = (self.outputs, x.scales.len());
        let count = out.len() / width.max(1);
        out.fill(0.0);
        for tap in 0..self.taps {
            // Copy c of the repeated sequence reaches row c + left - lead of `out`.
            let lead = first + tap;
            let start = lead.saturating_sub(self.left) / 2;
            let end = (lead + count).saturating_sub(self.left).div_ceil(2).min(rows);
            for source in (start..end).step_by(rows_per_block.max(1)) {
                let x = x.window(source, end.saturating_sub(source).min(rows_per_block), self.inputs);
                let mut copies = |acc: &[i32], add: fn(&mut [f32], usize, &[i32], usize, &[f32])| {
                    for copy in 0..2 {
                        // Of the sources' copies every other row; those before the first row are left out.
                        let at = 2 * source + copy + self.left;
                        let skip = lead.saturating_sub(at).div_ceil(2);
                        let out = part_mut!(out, (at + 2 * skip - lead) * width..);
                        add(out, 2 * width, part!(acc, skip * width..), width, part!(x.scales, skip..));
                    }
                };
                linear_s16s8(x.q, self.tap(tap), self.inputs, width, acc);
                #[cfg(feature = "wide-layers")]
                if self.wide() {
                    copies(acc, epilogue::add_high);
                    linear_s16s8(x.q, self.low_tap(tap), self.inputs, width, acc);
                }
                copies(acc, epilogue::add);
            }
        }
        epilogue::scale(out, width, self.affine());
    }

    /// Quantises gradients `g [R][N]` with the output scales folded in, which is what the backward passes read.
    pub fn quantise_gradient(&self, g: &[f32], q: &mut [i16], scales: &mut [f32], row: &mut [f32]) {
        let width = self.outputs.max(1);
        let limit = quantise::limit(self.outputs);
        let (row, step) = (part_mut!(row, ..width), self.step());
        for ((g, q), scale) in g.chunks_exact(width).zip(q.chunks_exact_mut(width)).zip(scales) {
            wide!({
                for ((row, g), s) in row.iter_mut().zip(g).zip(self.scales) {
                    *row = *g * *s;
                }
            });
            *scale = quantise::row(row, q, limit) * step;
        }
    }

    /// Input gradient: rows `first..` of `dJ/dx`, as many as `out [B][K]` holds, from quantised gradients `g [R][N]`,
    /// as [`Conv1d::forward`].
    pub fn backward(&self, g: Rows<'_>, first: usize, out: &mut [f32], rows_per_block: usize, acc: &mut [i32]) {
        let (width, rows) = (self.inputs, g.scales.len());
        for (block, out) in out.chunks_mut((rows_per_block * width).max(1)).enumerate() {
            let (first, count) = (first + block * rows_per_block, out.len() / width.max(1));
            for tap in 0..self.taps {
                let span = Span::new(first, count, rows, -self.offset(tap));
                let combine = combine(tap, count, span.as_ref(), out, false);
                let Some(span) = span else { continue };
                let g = g.window(span.source, span.rows, self.outputs);
                let out = part_mut!(out, span.skip * width..);
                linear_transposed_s16s8(g.q, self.tap(tap), width, self.outputs, acc);
                combine(out, width, acc, width, g.scales);
            }
        }
    }

    /// Input gradient of [`Conv1d::forward_upsampled`], in place: of the window `g [2 R + 2][N]`, which begins [`Conv1d::right`] rows before
    /// the first row's copies and ends [`Conv1d::left`] behind the last's, the first rows become `dJ/dx [R][K]` (`N = K`; three taps). The
    /// two copies' gradients are added before they are quantised.
    pub fn backward_upsampled(&self, g: &mut [f32], block: &mut GradientBlock<'_>, acc: &mut [i32]) {
        let width = self.outputs.max(1);
        if self.inputs != self.outputs {
            return;
        }
        let rows = (g.len() / width / 2).saturating_sub(1);
        let rows_per_block = block.scales.len();
        for first in (0..rows).step_by(rows_per_block.max(1)) {
            let count = (rows - first).min(rows_per_block);
            block.sums.fill(0.0);
            for tap in 0..self.taps {
                for r in 0..count {
                    let row = part_mut!(block.row, ..width);
                    row.fill(0.0);
                    for copy in 0..2 {
                        let Some(t) = (2 * (first + r) + copy + self.taps - 1).checked_sub(tap) else { continue };
                        let g = part!(g, t * width..(t + 1) * width);
                        wide!({
                            for ((row, g), s) in row.iter_mut().zip(g).zip(self.scales) {
                                *row += *g * *s;
                            }
                        });
                    }
                    let q = part_mut!(block.q, r * width..(r + 1) * width);
                    if let Some(scale) = block.scales.get_mut(r) {
                        *scale = quantise::row(row, q, quantise::limit(width)) * self.step();
                    }
                }
                let q = part!(block.q, ..count * width);
                linear_transposed_s16s8(q, self.tap(tap), width, width, acc);
                epilogue::add(block.sums, width, acc, width, part!(block.scales, ..count));
            }
            // Rows up to 2 (first + count) are done with before row first + count - 1 is overwritten.
            for (to, from) in g.iter_mut().skip(first * width).zip(block.sums.iter().take(count * width)) {
                *to = *from;
            }
        }
    }

    /// Row offset of a tap.
    #[inline]
    const fn offset(&self, tap: usize) -> isize {
        (tap * self.dilation) as isize - self.left as isize
    }

    const fn affine(&self) -> Affine<'a> {
        (self.scales, self.biases)
    }
}

/// BlockScratch of [`Conv1d::backward_upsampled`].
#[derive(Debug)]
pub struct GradientBlock<'a> {
    /// `[N]`
    pub row: &'a mut [f32],
    /// `[B][N]`
    pub sums: &'a mut [f32],
    /// `[B][N]`
    pub q: &'a mut [i16],
    /// `[B]`, `B` the rows at a time.
    pub scales: &'a mut [f32],
}

/// The rows of a block that have a source row at some offset.
pub(super) struct Span {
    /// Rows of the block before the first that has one.
    pub skip: usize,
    /// First source row.
    pub source: usize,
    /// How many.
    pub rows: usize,
}

impl Span {
    /// Of the `count` rows from `first` on, those whose source `offset` rows further lies within `rows`.
    pub(super) fn new(first: usize, count: usize, rows: usize, offset: isize) -> Option<Span> {
        let start = first.saturating_add_signed(offset);
        let skip = if offset < 0 { offset.unsigned_abs().saturating_sub(first) } else { 0 };
        let end = (first + count).checked_add_signed(offset)?;
        let end = if end > rows { rows } else { end };
        if skip >= count || end <= start { None } else { Some(Span { skip, source: start, rows: end - start }) }
    }
}

/// How a tap's sums come into the `count` rows of `out`: the first tap's are put there if it has a source row for each and is
/// not the last, which is what adding them to zeros gives; else zeros are, and all taps' sums are added.
fn combine(
    tap: usize,
    count: usize,
    span: Option<&Span>,
    out: &mut [f32],
    last: bool,
) -> fn(&mut [f32], usize, &[i32], usize, &[f32]) {
    if tap > 0 {
        return epilogue::add;
    }
    if !last && span.is_some_and(|span| span.rows == count) {
        return epilogue::set;
    }
    out.fill(0.0);
    epilogue::add
}

/// Sum of magnitudes.
#[inline(never)]
pub(super) fn weight_norm(weights: Option<&[i8]>) -> u32 {
    weights.unwrap_or(&[]).iter().fold(0, |sum, w| sum + u32::from(w.unsigned_abs()))
}

/// A bound of one output channel; infinite when the sum before its scale could overflow.
pub(super) fn row_bound(norm: f32, input: f32, scale: f32, bias: f32) -> f32 {
    let sum = norm * input;
    if sum < 1e36 { sum * scale + bias.abs() } else { f32::INFINITY }
}

/// The larger of two numbers, the first when they do not compare.
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// Whether the next tensor holds int16 planes.
pub(super) fn planes_follow(tensors: &Tensors<'_>) -> bool {
    tensors.peek() == Some(DType::I16Planes)
}
