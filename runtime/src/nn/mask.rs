//! One bit an activation: whether a ReLU let it through, kept for the input gradient.

use crate::kernels::{self, wide};

/// Words that hold `bits` bits.
#[must_use]
pub const fn words(bits: usize) -> usize {
    bits.div_ceil(32)
}

/// `x <- relu(x)`; bit k of `mask` says whether `x[k]` was positive.
#[inline(never)]
pub fn relu(x: &mut [f32], mask: &mut [u32]) {
    wide!(relu_words(x, mask));
}

#[inline(always)]
fn relu_words(x: &mut [f32], mask: &mut [u32]) {
    // Whole words apart: the compiler has them side by side where it knows how long they are.
    let (words, rest) = x.as_chunks_mut();
    for (x, mask) in words.iter_mut().zip(mask.iter_mut()) {
        *mask = kernels::relu_word(x);
    }
    if let Some(mask) = mask.get_mut(words.len()) {
        *mask = kernels::relu(rest);
    }
}

/// The same for rows `[R][width]`, with a row of `masks` each.
#[inline(never)]
pub fn relu_rows(x: &mut [f32], masks: &mut [u32], width: usize) {
    let words = words(width).max(1);
    for (x, mask) in x.chunks_exact_mut(width.max(1)).zip(masks.chunks_exact_mut(words)) {
        relu(x, mask);
    }
}

/// `g <- g` where the ReLU let through, 0 elsewhere.
#[inline(never)]
pub fn gate(g: &mut [f32], mask: &[u32]) {
    wide!(gate_words(g, mask));
}

#[inline(always)]
fn gate_words(g: &mut [f32], mask: &[u32]) {
    let (words, rest) = g.as_chunks_mut::<32>();
    for (g, mask) in words.iter_mut().zip(mask) {
        gate_word(g, *mask);
    }
    if let Some(mask) = mask.get(words.len()) {
        gate_word(rest, *mask);
    }
}

#[inline(always)]
fn gate_word(g: &mut [f32], mask: u32) {
    for (k, v) in g.iter_mut().enumerate() {
        // All ones where the bit is set.
        let kept = (mask >> k & 1).wrapping_neg();
        *v = f32::from_bits(v.to_bits() & kept);
    }
}

/// The same for rows `[R][width]`, with a row of `masks` each.
#[inline(never)]
pub fn gate_rows(g: &mut [f32], masks: &[u32], width: usize) {
    let words = words(width).max(1);
    for (g, mask) in g.chunks_exact_mut(width.max(1)).zip(masks.chunks_exact(words)) {
        gate(g, mask);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn gate_follows_relu() {
        let x: Vec<f32> = (0..71).map(|i| ((i * 37 % 71) as f32) - 35.0).collect();
        let (mut y, mut bits) = (x.clone(), [0u32; words(71)]);
        relu(&mut y, &mut bits);
        let mut g = std::vec![1.0f32; 71];
        gate(&mut g, &bits);
        for ((x, y), g) in x.iter().zip(&y).zip(&g) {
            assert_eq!(*y, if *x > 0.0 { *x } else { 0.0 });
            assert_eq!(*g, if *x > 0.0 { 1.0 } else { 0.0 });
        }
    }
}
