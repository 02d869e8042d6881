//! Sums and updates over slices in one written order, without panics: where lengths differ, the shorter one counts.

use core::slice::{ChunksExact, ChunksExactMut};

/// `sum a_i b_i`, first to last.
pub(crate) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        sum += x * y;
    }
    sum
}

/// `a += scale * b`.
pub(crate) fn axpy(a: &mut [f32], scale: f32, b: &[f32]) {
    for (x, y) in a.iter_mut().zip(b) {
        *x += scale * y;
    }
}

/// `a = b`.
pub(crate) fn copy(a: &mut [f32], b: &[f32]) {
    for (x, y) in a.iter_mut().zip(b) {
        *x = *y;
    }
}

/// `a = 0`.
pub(crate) fn clear(a: &mut [f32]) {
    for x in a {
        *x = 0.0;
    }
}

/// `||a - b||^2`.
pub(crate) fn squared_distance(a: &[f32], b: &[f32]) -> f32 {
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        let d = x - y;
        sum += d * d;
    }
    sum
}

/// True when every element is a finite number.
pub(crate) fn all_finite(a: &[f32]) -> bool {
    a.iter().all(|x| x.is_finite())
}

/// The larger of two numbers; the first when they do not compare.
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// Rows of `width` numbers; a width of 0 counts as 1 (shapes are checked before any work starts).
pub(crate) fn rows(a: &[f32], width: usize) -> ChunksExact<'_, f32> {
    a.chunks_exact(if width == 0 { 1 } else { width })
}

/// Rows of `width` numbers, mutable.
pub(crate) fn rows_mut(a: &mut [f32], width: usize) -> ChunksExactMut<'_, f32> {
    a.chunks_exact_mut(if width == 0 { 1 } else { width })
}
