//! Softmax in f32: largest first taken off, exponentials summed in order.

use super::exp::exp;
use crate::kernels::wide;

/// `x[i] <- exp(x[i] - max) / sum_j exp(x[j] - max)`.
#[inline(never)]
pub fn softmax(x: &mut [f32]) {
    let sum = exponentials(x);
    for x in x {
        *x /= sum;
    }
}

/// `x[i] <- exp(x[i] - max)`; returns their sum, at least 1 for finite inputs.
#[inline(never)]
pub fn exponentials(x: &mut [f32]) -> f32 {
    let mut largest = f32::NEG_INFINITY;
    for v in x.iter() {
        if *v > largest {
            largest = *v;
        }
    }
    wide(|| {
        for v in x.iter_mut() {
            *v = exp(*v - largest);
        }
    });
    // In order, lane by lane: the sum has one written order.
    let mut sum = 0.0;
    for v in x {
        sum += *v;
    }
    sum
}
