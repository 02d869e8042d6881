//! Embedding table: int8 rows with one scale each.

use super::conv1d::larger;
use crate::blob::{Error, Tensors};

/// A table in flash: `e[r][k] = w[r][k] * s[r]`.
#[derive(Debug, Clone, Copy)]
pub struct Embedding<'a> {
    width: usize,
    /// `[rows][width]`
    weights: &'a [i8],
    /// `[rows]`
    scales: &'a [f32],
}

impl<'a> Embedding<'a> {
    /// Reads rows and scales from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or holds refused values.
    #[inline(never)]
    pub fn open(tensors: &mut Tensors<'a>, rows: u16, width: u16) -> Result<Self, Error> {
        let weights = tensors.take()?.bytes([1, rows, width])?;
        Ok(Embedding { width: usize::from(width), weights, scales: tensors.take()?.scales(rows)? })
    }

    /// Rows.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.scales.len()
    }

    /// Adds row `row` to `x [width]`; a row that is not there adds nothing.
    pub fn add(&self, row: usize, x: &mut [f32]) {
        add_row(self.row(row), x);
    }

    /// Weights of row `row` and their scale; nothing where there is no such row.
    #[must_use]
    pub fn row(&self, row: usize) -> (&'a [i8], f32) {
        let weights = self.weights.get(row * self.width..(row + 1) * self.width).unwrap_or(&[]);
        (weights, self.scales.get(row).copied().unwrap_or(0.0))
    }

    /// Largest magnitude in the table.
    #[must_use]
    pub fn bound(&self) -> f32 {
        largest(self.weights, self.scales, self.width)
    }
}

/// Largest magnitude of `w[r][k] * s[r]`.
#[inline(never)]
pub(super) fn largest(weights: &[i8], scales: &[f32], width: usize) -> f32 {
    let mut bound = 0.0;
    for (weights, scale) in weights.chunks_exact(width.max(1)).zip(scales) {
        let largest = weights.iter().fold(0u8, |largest, w| largest.max(w.unsigned_abs()));
        bound = larger(bound, f32::from(largest) * *scale);
    }
    bound
}

/// `x[k] += w[k] * scale`.
#[inline(never)]
pub fn add_row((weights, scale): (&[i8], f32), x: &mut [f32]) {
    for (x, w) in x.iter_mut().zip(weights) {
        *x += f32::from(*w) * scale;
    }
}
