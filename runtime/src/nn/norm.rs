//! Layer normalisation: `y = (x - mean) / sqrt(var + eps) * weight + bias`, biased variance, sums in channel order.

use super::conv1d::larger;
use super::sums::{ROWS, squares, totals};
use crate::blob::{Error, Tensors};
use crate::kernels::{self, wide};

/// Rows beyond this magnitude are not normalised: the sum of squares of a row must stay finite.
pub const MAX_INPUT: f32 = 1e16;

/// A normalisation in flash.
#[derive(Debug, Clone, Copy)]
pub struct LayerNorm<'a> {
    /// `[d]`
    weight: &'a [f32],
    /// `[d]`
    bias: &'a [f32],
    epsilon: f32,
}

impl<'a> LayerNorm<'a> {
    /// Reads weight and bias from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or not finite.
    #[inline(never)]
    pub fn open(tensors: &mut Tensors<'a>, width: u16, epsilon: f32) -> Result<Self, Error> {
        Ok(LayerNorm { weight: tensors.take()?.f32s(width)?, bias: tensors.take()?.f32s(width)?, epsilon })
    }

    /// A bound of `|y|` for any input: `sqrt(d) max |weight| + max |bias|`.
    #[must_use]
    #[inline(never)]
    pub fn bound(&self) -> f32 {
        let largest = |values: &[f32]| values.iter().fold(0.0, |largest, v| larger(largest, v.abs()));
        kernels::sqrt(self.weight.len() as f32) * largest(self.weight) + largest(self.bias)
    }

    /// Normalises rows `x [R][d]` into `out [R][d]`.
    pub fn forward(&self, x: &[f32], out: &mut [f32]) {
        for (to, from) in out.iter_mut().zip(x) {
            *to = *from;
        }
        self.forward_in_place(out);
    }

    /// The same in place.
    #[inline(never)]
    pub fn forward_in_place(&self, x: &mut [f32]) {
        let width = self.weight.len().max(1);
        for x in x.chunks_mut((ROWS * width).max(1)) {
            let moments = moments(x, width, self.epsilon);
            for (x, moments) in x.chunks_exact_mut(width).zip(moments) {
                self.normalise(x, moments);
            }
        }
    }

    // Its own function: there would be one for each of the rows that are summed together.
    #[inline(never)]
    fn normalise(&self, x: &mut [f32], (mean, factor): (f32, f32)) {
        wide!({
            for (x, (weight, bias)) in x.iter_mut().zip(self.weight.iter().zip(self.bias)) {
                *x = (*x - mean) * factor * *weight + *bias;
            }
        });
    }
}

/// Mean of each of at most four rows, and `1 / sqrt(var + eps)`.
fn moments(x: &[f32], width: usize, epsilon: f32) -> [(f32, f32); ROWS] {
    let count = width as f32;
    let means = totals(x, width).map(|sum| sum / count);
    let mut moments = [(0.0, 0.0); ROWS];
    for ((to, mean), squares) in moments.iter_mut().zip(means).zip(squares(x, width, means)) {
        *to = (mean, 1.0 / kernels::sqrt(squares / count + epsilon));
    }
    moments
}
