//! Embedding table: int8 or int16 rows with one scale each.

use super::conv1d::larger;
#[cfg(feature = "wide-layers")]
use super::conv1d::planes_follow;
use crate::blob::{Error, Tensors};

/// A table in flash: `e[r][k] = w[r][k] * s[r]`; weights of 16 bits are two planes, `w = 256 high + low`.
#[derive(Debug, Clone, Copy)]
pub struct Embedding<'a> {
    width: usize,
    /// `[rows][width]`; the high plane of 16-bit ones.
    weights: &'a [i8],
    /// The low plane; empty where weights have 8 bits.
    #[cfg(feature = "wide-layers")]
    low: &'a [i8],
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
        #[cfg(feature = "wide-layers")]
        if planes_follow(tensors) {
            let (weights, low) = tensors.take()?.planes([1, rows, width])?;
            return Ok(Embedding { width: usize::from(width), weights, low, scales: tensors.take()?.scales(rows)? });
        }
        let weights = tensors.take()?.bytes([1, rows, width])?;
        Ok(Embedding {
            width: usize::from(width),
            weights,
            #[cfg(feature = "wide-layers")]
            low: &[],
            scales: tensors.take()?.scales(rows)?,
        })
    }

    /// Rows.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.scales.len()
    }

    /// Adds row `row` to `x [width]`; a row that is not there adds nothing.
    pub fn add(&self, row: usize, x: &mut [f32]) {
        #[cfg(feature = "wide-layers")]
        if let Some(low) = self.low.get(row * self.width..(row + 1) * self.width)
            && !self.low.is_empty()
        {
            let (high, scale) = self.row(row);
            add_row((high, 256.0 * scale), x);
            return add_row((low, scale), x);
        }
        add_row(self.row(row), x);
    }

    /// Weights of row `row` and their scale, of int8 rows; nothing where there is no such row.
    #[must_use]
    pub fn row(&self, row: usize) -> (&'a [i8], f32) {
        let weights = self.weights.get(row * self.width..(row + 1) * self.width).unwrap_or(&[]);
        (weights, self.scales.get(row).copied().unwrap_or(0.0))
    }

    /// Largest magnitude in the table.
    #[must_use]
    pub fn bound(&self) -> f32 {
        let bound = largest(self.weights, self.scales, self.width);
        // The low plane adds half a step of the high one at most.
        #[cfg(feature = "wide-layers")]
        let bound =
            if self.low.is_empty() { bound } else { 256.0 * bound + largest(self.low, self.scales, self.width) };
        bound
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
