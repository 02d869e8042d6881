//! What the planner's rows and blocks are told beside its tokens: by a text, or by anchors.

use super::transformer::Planner;
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::attention::{Heads, Segment, SegmentMut};

/// Shares of the planner's first rows, and keys and values for each of its blocks.
#[derive(Debug)]
pub struct Condition<'w> {
    /// Rows `n` that each block attends to; 0: there are none.
    pub rows: usize,
    /// What is added to row `i` of the planner, `[biased][d]`.
    pub row_bias: &'w mut [f32],
    /// `[layers][H][n][dh]`
    keys: &'w mut [i8],
    /// `[layers][H][n]`
    key_scales: &'w mut [f32],
    /// `[layers][H][n][dh]`
    values: &'w mut [i8],
    /// `[layers][H][n]`
    value_scales: &'w mut [f32],
    /// Low planes of keys and values, where these have 16 bits.
    #[cfg(feature = "wide-layers")]
    low: (&'w mut [i8], &'w mut [i8]),
}

impl<'w> Condition<'w> {
    /// Takes the buffers for up to `rows` rows of keys and values, and biases for the planner's first `biased` rows.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn new(
        planner: &Planner<'_>,
        arena: &mut Arena<'w>,
        rows: usize,
        biased: usize,
    ) -> Result<Self, ArenaTooSmall> {
        let (numbers, scales) = lengths(planner.heads(), planner.layers(), rows);
        Ok(Condition {
            rows: 0,
            row_bias: arena.take(biased * planner.width())?,
            keys: arena.take(numbers)?,
            values: arena.take(numbers)?,
            key_scales: arena.take(scales)?,
            value_scales: arena.take(scales)?,
            #[cfg(feature = "wide-layers")]
            low: {
                let numbers = if planner.wide() { numbers } else { 0 };
                (arena.take(numbers)?, arena.take(numbers)?)
            },
        })
    }

    /// Keys and values of a block.
    #[must_use]
    pub fn layer(&self, heads: Heads, layer: usize) -> Segment<'_> {
        let (numbers, scales) = lengths(heads, 1, self.rows);
        let of_scales = layer * scales..(layer + 1) * scales;
        let of_numbers = layer * numbers..(layer + 1) * numbers;
        Segment {
            rows: self.rows,
            #[cfg(feature = "autoregressive")]
            room: self.rows,
            keys: part!(self.keys, of_numbers.clone()),
            key_scales: part!(self.key_scales, of_scales.clone()),
            values: part!(self.values, of_numbers.clone()),
            value_scales: part!(self.value_scales, of_scales),
            #[cfg(feature = "wide-layers")]
            low: match self.low.0.is_empty() {
                true => (&[], &[]),
                false => (part!(self.low.0, of_numbers.clone()), part!(self.low.1, of_numbers)),
            },
        }
    }

    /// The same, to be written.
    pub fn layer_mut(&mut self, heads: Heads, layer: usize) -> SegmentMut<'_> {
        let (numbers, scales) = lengths(heads, 1, self.rows);
        let of_scales = layer * scales..(layer + 1) * scales;
        let of_numbers = layer * numbers..(layer + 1) * numbers;
        SegmentMut {
            rows: self.rows,
            keys: part_mut!(self.keys, of_numbers.clone()),
            key_scales: part_mut!(self.key_scales, of_scales.clone()),
            values: part_mut!(self.values, of_numbers.clone()),
            value_scales: part_mut!(self.value_scales, of_scales),
            #[cfg(feature = "wide-layers")]
            low: match self.low.0.is_empty() {
                true => (&mut [], &mut []),
                false => (part_mut!(self.low.0, of_numbers.clone()), part_mut!(self.low.1, of_numbers)),
            },
        }
    }
}

/// Numbers and scales of keys, and of values.
const fn lengths(heads: Heads, layers: usize, rows: usize) -> (usize, usize) {
    let scales = layers * rows * heads.count;
    (scales * heads.width, scales)
}
