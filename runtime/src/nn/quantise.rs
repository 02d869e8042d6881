//! f32 rows to int16 rows with one dynamic scale a row (DESIGN section 4).
//!
//! The scale covers the row's channels only, never time: a sequence processed in segments gives the same bits.

use crate::kernels::{largest_magnitude, round, round_scaled, wide};

/// Largest magnitude an activation may take so that `terms` products with an int8 weight fit an int32.
///
/// 128 rather than 127 because the low plane of an int16 weight may be -128.
#[must_use]
pub const fn limit(terms: usize) -> i16 {
    let terms = if terms == 0 { 1 } else { terms };
    let fits = i32::MAX as usize / 128 / terms;
    if fits > i16::MAX as usize { i16::MAX } else { fits as i16 }
}

/// Rows with no value above this are stored as zeros: their reciprocal would leave the normal range.
const TINY: f32 = 1e-30;

/// Largest int8 magnitude.
const NARROW: f32 = 127.0;

/// The largest magnitude of a row that is worth quantising; `None` stores zeros.
#[inline(always)]
fn largest(x: &[f32]) -> Option<f32> {
    let largest = f32::from_bits(largest_magnitude(x) >> 1);
    if largest > TINY && largest.is_finite() { Some(largest) } else { None }
}

/// Quantises one row: `x[k] ~ q[k] * scale`, `|q[k]| <= limit`. Returns the scale.
#[inline(never)]
pub fn row(x: &[f32], q: &mut [i16], limit: i16) -> f32 {
    wide!({
        let Step { factor, scale } = step_of(x, limit);
        scaled(x, factor, q);
        scale
    })
}

/// How a row is quantised: `q[k] = round(x[k] * factor)`, `x[k] ~ q[k] * scale`. Both are 0 for a row that is stored as zeros.
#[derive(Debug, Clone, Copy, Default)]
pub struct Step {
    /// What numbers are multiplied by.
    pub factor: f32,
    /// What turns them back.
    pub scale: f32,
}

/// The step of a row, to quantise it part by part with `part`.
#[inline(never)]
pub fn step(x: &[f32], limit: i16) -> Step {
    wide!(step_of(x, limit))
}

/// Quantises a part of a row.
#[inline(never)]
pub fn part(x: &[f32], step: Step, q: &mut [i16]) {
    wide!(scaled(x, step.factor, q));
}

#[inline(always)]
fn step_of(x: &[f32], limit: i16) -> Step {
    let limit = f32::from(limit);
    largest(x).map_or(Step::default(), |largest| Step { factor: limit / largest, scale: largest / limit })
}

#[inline(always)]
fn scaled(x: &[f32], factor: f32, q: &mut [i16]) {
    // Not only for speed: the row may hold what is not finite.
    if factor == 0.0 {
        q.fill(0);
        return;
    }
    round_scaled(x, factor, q);
}

/// The same to int8, `|q[k]| <= 127`: keys and values of attention.
#[inline(never)]
pub fn row_narrow(x: &[f32], q: &mut [i8]) -> f32 {
    wide!({
        let Some(largest) = largest(x) else {
            q.fill(0);
            return 0.0;
        };
        let factor = NARROW / largest;
        for (q, v) in q.iter_mut().zip(x) {
            *q = round(*v * factor) as i8;
        }
        largest / NARROW
    })
}

/// The same to two planes, `q[k] = 256 high[k] + low[k]`, `|q[k]| <= 32512`.
#[cfg(feature = "wide-layers")]
#[inline(never)]
pub fn row_planes(x: &[f32], high: &mut [i8], low: &mut [i8]) -> f32 {
    const LIMIT: i16 = 127 * 256;
    let step = step(x, LIMIT);
    let mut q = [0i16; 8];
    for ((x, high), low) in x.chunks(q.len()).zip(high.chunks_mut(q.len())).zip(low.chunks_mut(q.len())) {
        part(x, step, part_mut!(q, ..x.len()));
        for ((q, high), low) in q.iter().zip(high).zip(low) {
            *high = ((i32::from(*q) + 128) >> 8) as i8;
            *low = (i32::from(*q) - 256 * i32::from(*high)) as i8;
        }
    }
    step.scale
}

/// Quantises `rows x [R][width]` into `q` and `scales`.
pub fn rows(x: &[f32], width: usize, limit: i16, q: &mut [i16], scales: &mut [f32]) {
    if width == 0 {
        return;
    }
    for ((x, q), scale) in x.chunks_exact(width).zip(q.chunks_exact_mut(width)).zip(scales) {
        *scale = row(x, q, limit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limit_keeps_accumulators_inside_i32() {
        for terms in [1usize, 96, 288, 511, 512, 513, 2048, 100_000] {
            assert!(terms as i64 * 128 * i64::from(limit(terms)) <= i64::from(i32::MAX), "{terms}");
        }
        assert_eq!(limit(96), i16::MAX);
    }

    #[test]
    fn error_is_at_most_half_a_step_and_ties_go_to_even() {
        let x = [0.5f32, -1.5, 2.5, -127.0, 126.4, 0.0];
        let mut q = [0i16; 6];
        let scale = row(&x, &mut q, 127);
        assert_eq!(scale, 1.0);
        assert_eq!(q, [0, -2, 2, -127, 126, 0]);
    }

    #[test]
    fn zeros_tiny_and_non_finite_rows_become_zero() {
        for x in [[0.0f32, -0.0], [1e-38, 0.0], [f32::INFINITY, 1.0], [f32::NAN, 1.0]] {
            let mut q = [7i16; 2];
            assert_eq!(row(&x, &mut q, 100), 0.0);
            assert_eq!(q, [0, 0]);
        }
    }
}
