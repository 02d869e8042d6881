//! Fully connected layer, int8 weights, int16 rows (DESIGN section 4).
//!
//! `y[r][n] = (sx[r] * sum_k q[r][k] w[n][k]) * s[n] + b[n]`; the sum is int32.

use super::conv1d::{Rows, larger, row_bound, weight_norm};
use crate::blob::{Error, Tensors};
use crate::kernels::{linear_s16s8, wide};

/// Rows that go through a transformer's layers together.
pub const BLOCK: usize = 4;

/// A linear layer in flash.
#[derive(Debug, Clone, Copy)]
pub struct Linear<'a> {
    /// Input channels `K`.
    inputs: usize,
    /// Output channels `N`.
    outputs: usize,
    /// `[N][K]`
    weights: &'a [i8],
    /// `[N]`
    scales: &'a [f32],
    /// `[N]`
    biases: &'a [f32],
}

impl<'a> Linear<'a> {
    /// Reads weights, scales and biases from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or holds refused values.
    #[inline(never)]
    pub fn open(tensors: &mut Tensors<'a>, inputs: u16, outputs: u16) -> Result<Self, Error> {
        Ok(Linear {
            inputs: usize::from(inputs),
            outputs: usize::from(outputs),
            weights: tensors.take()?.bytes([1, outputs, inputs])?,
            scales: tensors.take()?.scales(outputs)?,
            biases: tensors.take()?.singles(outputs)?,
        })
    }

    /// A layer of weights `[N][K]`, scales and biases `[N]`; `None` where their lengths do not go together.
    #[must_use]
    pub fn new(inputs: usize, weights: &'a [i8], scales: &'a [f32], biases: &'a [f32]) -> Option<Self> {
        let outputs = scales.len();
        let fits = outputs.checked_mul(inputs) == Some(weights.len()) && biases.len() == outputs;
        fits.then_some(Linear { inputs, outputs, weights, scales, biases })
    }

    /// Input channels.
    #[must_use]
    pub const fn inputs(&self) -> usize {
        self.inputs
    }

    /// Output channels.
    #[must_use]
    pub const fn outputs(&self) -> usize {
        self.outputs
    }

    /// Multiply-accumulates a row.
    #[must_use]
    pub const fn macs(&self) -> u64 {
        (self.inputs * self.outputs) as u64
    }

    /// The layer of `count` outputs from `first` on; none where they are out of range.
    #[must_use]
    pub fn part(&self, first: usize, count: usize) -> Linear<'a> {
        let weights = self.weights.get(first * self.inputs..(first + count) * self.inputs).unwrap_or(&[]);
        let scales = self.scales.get(first..first + count).unwrap_or(&[]);
        let biases = self.biases.get(first..first + count).unwrap_or(&[]);
        Linear { inputs: self.inputs, outputs: scales.len(), weights, scales, biases }
    }

    /// Weights of output `n` and their scale: `w[n][k] = q[k] * scale`.
    #[must_use]
    pub fn row(&self, n: usize) -> (&'a [i8], f32) {
        let weights = self.weights.get(n * self.inputs..(n + 1) * self.inputs).unwrap_or(&[]);
        (weights, self.scales.get(n).copied().unwrap_or(0.0))
    }

    /// A bound of `|y|` when `|x| <= input` (row norms of the weights).
    #[must_use]
    #[inline(never)]
    pub fn bound(&self, input: f32) -> f32 {
        let mut bound = 0.0;
        let rows = self.weights.chunks_exact(self.inputs.max(1)).zip(self.scales).zip(self.biases);
        for ((weights, scale), bias) in rows {
            bound = larger(bound, row_bound(weight_norm(Some(weights)) as f32, input, *scale, *bias));
        }
        bound
    }

    /// Largest magnitude of a weight.
    #[must_use]
    pub fn largest(&self) -> f32 {
        super::embedding::largest(self.weights, self.scales, self.inputs)
    }

    /// `out [R][N]` of `x [R][K]`. `acc` has `R N` numbers, and [`room`](crate::kernels::room) behind them.
    #[inline(never)]
    pub fn forward(&self, x: Rows<'_>, out: &mut [f32], acc: &mut [i32]) {
        let width = self.outputs.max(1);
        linear_s16s8(x.q, self.weights, self.inputs, self.outputs, acc);
        for ((out, acc), sx) in out.chunks_exact_mut(width).zip(acc.chunks_exact(width)).zip(x.scales) {
            wide(|| finish(out, acc, *sx, self.scales, self.biases));
        }
    }
}

/// `y[n] = acc[n] * sx * scales[n] + biases[n]`.
#[inline]
fn finish(y: &mut [f32], acc: &[i32], sx: f32, scales: &[f32], biases: &[f32]) {
    // Fours, so that the compiler need not find them: it runs out of registers where it looks for itself.
    let (y_fours, y_rest) = y.as_chunks_mut::<4>();
    let (acc_fours, acc_rest) = acc.as_chunks::<4>();
    let (scale_fours, scale_rest) = scales.as_chunks::<4>();
    let (bias_fours, bias_rest) = biases.as_chunks::<4>();
    for (((y, acc), scales), biases) in y_fours.iter_mut().zip(acc_fours).zip(scale_fours).zip(bias_fours) {
        for (((y, a), scale), bias) in y.iter_mut().zip(acc).zip(scales).zip(biases) {
            *y = *a as f32 * sx * *scale + *bias;
        }
    }
    for (((y, a), scale), bias) in y_rest.iter_mut().zip(acc_rest).zip(scale_rest).zip(bias_rest) {
        *y = *a as f32 * sx * *scale + *bias;
    }
}
