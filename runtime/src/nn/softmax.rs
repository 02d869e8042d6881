//! Softmax in f32: largest first taken off, exponentials summed in order.

use super::exp::exp;
use super::sums::{ROWS, totals};
use crate::kernels::wide;

/// `x[r][i] <- exp(x[r][i] - max) / sum_j exp(x[r][j] - max)`, `max` the largest of row `r`, in all rows `x [R][width]`.
#[inline(never)]
pub fn rows(x: &mut [f32], width: usize) {
    let width = if width == 0 { 1 } else { width };
    for x in x.chunks_mut((ROWS * width).max(1)) {
        for x in x.chunks_exact_mut(width) {
            powers(x);
        }
        let sums = totals(x, width);
        for (x, sum) in x.chunks_exact_mut(width).zip(sums) {
            divide(x, sum);
        }
    }
}

// Its own function: there would be one for each of the rows that are summed together.
#[inline(never)]
fn divide(x: &mut [f32], by: f32) {
    wide!({
        for x in x {
            *x /= by;
        }
    });
}

/// The same of one row.
pub fn softmax(x: &mut [f32]) {
    rows(x, x.len());
}

/// `x[i] <- exp(x[i] - max)`; returns their sum, at least 1 for finite inputs.
#[inline(never)]
pub fn exponentials(x: &mut [f32]) -> f32 {
    powers(x);
    // In order: the sum has one written order.
    let mut sum = 0.0;
    for v in x {
        sum += *v;
    }
    sum
}

/// `x[i] <- exp(x[i] - max)`.
#[inline(never)]
fn powers(x: &mut [f32]) {
    wide!({
        // As integers: their largest does not depend on the order in which it is looked for.
        let mut largest = i32::MIN;
        for v in x.iter() {
            let ordered = ordered(v.to_bits() as i32);
            if ordered > largest {
                largest = ordered;
            }
        }
        let largest = f32::from_bits(ordered(largest) as u32);
        for v in x.iter_mut() {
            *v = exp(*v - largest);
        }
    });
}

/// The bits of a number as an integer that grows with it; the same back.
#[inline(always)]
const fn ordered(bits: i32) -> i32 {
    bits ^ ((bits >> 31) & i32::MAX)
}
