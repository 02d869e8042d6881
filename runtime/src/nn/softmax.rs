//! Softmax in f32: largest first taken off, exponentials summed in order.

use super::exp::exp;
use super::sums::{ROWS, sums};
use crate::kernels::wide;

/// Numbers among which the largest is looked for side by side.
const LANES: usize = 8;

/// `x[r][i] <- exp(x[r][i] - max) / sum_j exp(x[r][j] - max)`, `max` the largest of row `r`, in all rows `x [R][width]`.
#[inline(never)]
pub fn rows(x: &mut [f32], width: usize) {
    let width = if width == 0 { 1 } else { width };
    for x in x.chunks_mut((ROWS * width).max(1)) {
        for x in x.chunks_exact_mut(width) {
            powers(x);
        }
        let sums = sums(x, width, [0.0; ROWS], |x, _| x);
        for (x, sum) in x.chunks_exact_mut(width).zip(sums) {
            wide!({
                for x in x {
                    *x /= sum;
                }
            });
        }
    }
}

/// The same of one row.
pub fn softmax(x: &mut [f32]) {
    rows(x, x.len());
}

/// `x[i] <- exp(x[i] - max)`; returns their sum, at least 1 for finite inputs.
#[inline(never)]
pub fn exponentials(x: &mut [f32]) -> f32 {
    powers(x);
    let [sum, ..] = sums(x, x.len(), [0.0; ROWS], |x, _| x);
    sum
}

/// `x[i] <- exp(x[i] - max)`.
#[inline(never)]
fn powers(x: &mut [f32]) {
    wide!({
        let largest = largest(x);
        for v in x.iter_mut() {
            *v = exp(*v - largest);
        }
    });
}

#[inline(always)]
fn largest(x: &[f32]) -> f32 {
    let larger = |a: f32, b: f32| if b > a { b } else { a };
    let (eights, rest) = x.as_chunks::<LANES>();
    let mut lanes = [f32::NEG_INFINITY; LANES];
    for eight in eights {
        for (lane, v) in lanes.iter_mut().zip(eight) {
            *lane = larger(*lane, *v);
        }
    }
    lanes.iter().chain(rest).fold(f32::NEG_INFINITY, |largest, v| larger(largest, *v))
}
