//! Fully connected layer, int8 or 4-bit weights, int16 rows (DESIGN section 4).
//!
//! `y[r][n] = (sx[r] * sum_k q[r][k] w[n][k]) * s[n] + b[n]`; the sum is int32. Weights of 16 bits are two planes, `w = 256 high + low`:
//! `y = (sx sum q high) 256 s`, then `y += (sx sum q low) s + b`.

use super::conv1d::{Rows, larger, row_bound, weight_norm};
use super::epilogue;
use crate::blob::{DType, Error, Tensors};
use crate::kernels::{linear_s16s4, linear_s16s8, unpacked};

/// Fewest rows that go through a transformer's layers together.
pub const LEAST_ROWS: usize = 4;
/// Most of them.
pub const MOST_ROWS: usize = 24;

/// Weights, a row an output.
#[derive(Debug, Clone, Copy)]
pub enum Weights<'a> {
    /// `[N][K]`
    I8(&'a [i8]),
    /// `[N][K / 2]`, packed as [`linear_s16s4`] reads them.
    I4(&'a [u8]),
}

/// A linear layer in flash.
#[derive(Debug, Clone, Copy)]
pub struct Linear<'a> {
    /// Input channels `K`.
    inputs: usize,
    /// Bytes of a row of weights: `K`, or `K / 2` of 4-bit ones.
    stride: usize,
    /// `[N][stride]`; the high plane of 16-bit ones.
    weights: &'a [u8],
    /// The low plane, `[N][K]`; empty where weights have fewer bits.
    #[cfg(feature = "wide-layers")]
    low: &'a [i8],
    /// `[N]`
    scales: &'a [f32],
    /// `[N]`
    biases: &'a [f32],
}

impl<'a> Linear<'a> {
    /// Reads weights of either width, scales and biases from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or holds refused values.
    #[inline(never)]
    pub fn open(tensors: &mut Tensors<'a>, inputs: u16, outputs: u16) -> Result<Self, Error> {
        let (tensor, shape) = (tensors.take()?, [1, outputs, inputs]);
        let packed = tensor.entry.dtype == DType::I4;
        #[cfg(feature = "wide-layers")]
        let (high, low): (Option<&[i8]>, &[i8]) = match tensor.entry.dtype {
            DType::I16Planes => tensor.planes(shape).map(|(high, low)| (Some(high), low))?,
            _ => (None, &[]),
        };
        #[cfg(not(feature = "wide-layers"))]
        let high: Option<&[i8]> = None;
        Ok(Linear {
            inputs: usize::from(inputs),
            stride: usize::from(if packed { inputs / 2 } else { inputs }),
            weights: match high {
                Some(high) => bytemuck::cast_slice(high),
                None if packed => tensor.nibbles(shape)?,
                None => bytemuck::cast_slice(tensor.bytes(shape)?),
            },
            #[cfg(feature = "wide-layers")]
            low,
            scales: tensors.take()?.scales(outputs)?,
            biases: tensors.take()?.f32s(outputs)?,
        })
    }

    /// A layer of no outputs.
    #[must_use]
    pub const fn none(inputs: u16) -> Self {
        Linear {
            inputs: inputs as usize,
            stride: inputs as usize,
            weights: &[],
            #[cfg(feature = "wide-layers")]
            low: &[],
            scales: &[],
            biases: &[],
        }
    }

    /// A layer of weights, scales and biases `[N]`; `None` where their lengths do not go together.
    #[must_use]
    pub fn new(inputs: usize, weights: Weights<'a>, scales: &'a [f32], biases: &'a [f32]) -> Option<Self> {
        let (weights, stride) = match weights {
            Weights::I8(weights) => (bytemuck::cast_slice(weights), inputs),
            Weights::I4(weights) => (weights, inputs / 2),
        };
        let outputs = scales.len();
        let fits = outputs.checked_mul(stride) == Some(weights.len()) && biases.len() == outputs;
        fits.then_some(Linear {
            inputs,
            stride,
            weights,
            #[cfg(feature = "wide-layers")]
            low: &[],
            scales,
            biases,
        })
    }

    /// Whether weights have 16 bits.
    #[must_use]
    pub const fn wide(&self) -> bool {
        #[cfg(feature = "wide-layers")]
        return !self.low.is_empty();
        #[cfg(not(feature = "wide-layers"))]
        false
    }

    /// The low plane of `count` outputs from `first` on.
    #[cfg(feature = "wide-layers")]
    fn low_rows(&self, first: usize, count: usize) -> &'a [i8] {
        if self.wide() { part!(self.low, first * self.inputs..(first + count) * self.inputs) } else { &[] }
    }

    /// Whether weights are 4-bit.
    #[must_use]
    pub const fn packed(&self) -> bool {
        self.stride != self.inputs
    }

    /// Weights of `count` outputs from `first` on.
    fn rows(&self, first: usize, count: usize) -> &'a [u8] {
        part!(self.weights, first * self.stride..(first + count) * self.stride)
    }

    /// Input channels.
    #[must_use]
    pub const fn inputs(&self) -> usize {
        self.inputs
    }

    /// Output channels.
    #[must_use]
    pub const fn outputs(&self) -> usize {
        self.scales.len()
    }

    /// Multiply-accumulates a row.
    #[must_use]
    pub const fn macs(&self) -> u64 {
        let planes = if self.wide() { 2 } else { 1 };
        (planes * self.inputs * self.outputs()) as u64
    }

    /// The layer of `count` outputs from `first` on.
    #[must_use]
    pub fn part(&self, first: usize, count: usize) -> Linear<'a> {
        let weights = self.rows(first, count);
        let scales = part!(self.scales, first..first + count);
        let biases = part!(self.biases, first..first + count);
        Linear {
            weights,
            #[cfg(feature = "wide-layers")]
            low: self.low_rows(first, count),
            scales,
            biases,
            ..*self
        }
    }

    /// Weights of output `n` and their scale, `w[n][k] = q[k] * scale`, of int8 weights.
    #[must_use]
    pub fn row(&self, n: usize) -> (&'a [i8], f32) {
        (bytemuck::cast_slice(self.rows(n, 1)), self.scales.get(n).copied().unwrap_or(0.0))
    }

    /// Bias of output `n`.
    #[must_use]
    pub fn bias(&self, n: usize) -> f32 {
        self.biases.get(n).copied().unwrap_or(0.0)
    }

    /// A bound of `|y|` when `|x| <= input` (row norms of the weights).
    #[must_use]
    #[inline(never)]
    pub fn bound(&self, input: f32) -> f32 {
        let mut bound = 0.0;
        for (n, (scale, bias)) in self.scales.iter().zip(self.biases).enumerate() {
            let weights = self.rows(n, 1);
            let norm =
                if self.packed() { packed_norm(weights) } else { weight_norm(Some(bytemuck::cast_slice(weights))) };
            #[cfg(feature = "wide-layers")]
            let norm = if self.wide() { 256 * norm + weight_norm(Some(self.low_rows(n, 1))) } else { norm };
            bound = larger(bound, row_bound(norm as f32, input, *scale, *bias));
        }
        bound
    }

    /// Largest magnitude of a weight, of int8 weights.
    #[must_use]
    pub fn largest(&self) -> f32 {
        super::embedding::largest(bytemuck::cast_slice(self.weights), self.scales, self.inputs)
    }

    /// `out [R][N]` of `x [R][K]`. `acc` has `R N` numbers, and [`room`](crate::kernels::room) behind them.
    #[inline(never)]
    pub fn forward(&self, x: Rows<'_>, out: &mut [f32], acc: &mut [i32]) {
        #[cfg(feature = "wide-layers")]
        if self.wide() {
            out.fill(0.0);
            return self.add(x, out, acc);
        }
        self.multiply(x, acc);
        epilogue::finish(out, acc, x.scales, (self.scales, self.biases));
    }

    /// Adds what [`Linear::forward`] would write to `out`.
    #[inline(never)]
    pub fn add(&self, x: Rows<'_>, out: &mut [f32], acc: &mut [i32]) {
        self.multiply(x, acc);
        #[cfg(feature = "wide-layers")]
        if self.wide() {
            epilogue::add_high_scaled(out, acc, x.scales, (self.scales, self.biases));
            linear_s16s8(x.q, self.low, self.inputs, self.outputs(), acc);
        }
        epilogue::add_finished(out, acc, x.scales, (self.scales, self.biases));
    }

    fn multiply(&self, x: Rows<'_>, acc: &mut [i32]) {
        if self.packed() {
            linear_s16s4(x.q, self.weights, self.inputs, self.outputs(), acc);
        } else {
            linear_s16s8(x.q, bytemuck::cast_slice(self.weights), self.inputs, self.outputs(), acc);
        }
    }
}

/// Sum of magnitudes of 4-bit weights.
#[inline(never)]
fn packed_norm(weights: &[u8]) -> u32 {
    weights.as_chunks().0.iter().fold(0, |sum, group| sum + weight_norm(Some(&unpacked(group))))
}
