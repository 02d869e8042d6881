//! From int32 sums to f32 rows: what layers do with their products (DESIGN section 4).
//!
//! Rows are `[R][N]`. `t[r][n] = acc[r][n] * sx[r]`, and layers have a scale `s[n]` and a bias `b[n]` an output. All operations are
//! rounded one by one, in the order in which they stand here.

use crate::kernels::wide;

/// Scales and biases of a layer's outputs, `[N]` each.
pub type Affine<'a> = (&'a [f32], &'a [f32]);

/// `y = t`, `width` numbers of every `stride` of `y`.
#[inline(never)]
pub fn set(y: &mut [f32], stride: usize, acc: &[i32], width: usize, sx: &[f32]) {
    wide!({
        for ((y, acc), sx) in y.chunks_mut(stride.max(1)).zip(acc.chunks_exact(width.max(1))).zip(sx) {
            for (y, a) in y.iter_mut().zip(acc) {
                *y = *a as f32 * *sx;
            }
        }
    });
}

/// `y += t`, likewise.
#[inline(never)]
pub fn add(y: &mut [f32], stride: usize, acc: &[i32], width: usize, sx: &[f32]) {
    wide!({
        for ((y, acc), sx) in y.chunks_mut(stride.max(1)).zip(acc.chunks_exact(width.max(1))).zip(sx) {
            for (y, a) in y.iter_mut().zip(acc) {
                *y += *a as f32 * *sx;
            }
        }
    });
}

/// `y += 256 t`, likewise: the high plane of weights of 16 bits.
#[cfg(feature = "wide-layers")]
#[inline(never)]
pub fn add_high(y: &mut [f32], stride: usize, acc: &[i32], width: usize, sx: &[f32]) {
    wide!({
        for ((y, acc), sx) in y.chunks_mut(stride.max(1)).zip(acc.chunks_exact(width.max(1))).zip(sx) {
            let sx = *sx * 256.0;
            for (y, a) in y.iter_mut().zip(acc) {
                *y += *a as f32 * sx;
            }
        }
    });
}

/// `y += t` for weights of 16 bits, `acc = 256 high + low`, likewise.
#[inline(never)]
pub fn add_planes(y: &mut [f32], stride: usize, high: &[i32], low: &[i32], width: usize, sx: &[f32]) {
    let width = width.max(1);
    wide!({
        let acc = high.chunks_exact(width).zip(low.chunks_exact(width));
        for ((y, (high, low)), sx) in y.chunks_mut(stride.max(1)).zip(acc).zip(sx) {
            for ((y, high), low) in y.iter_mut().zip(high).zip(low) {
                *y += (*high as f32 * 256.0 + *low as f32) * *sx;
            }
        }
    });
}

/// `y = t s + b`.
#[inline(never)]
pub fn finish(y: &mut [f32], acc: &[i32], sx: &[f32], affine: Affine<'_>) {
    wide!(rows(y, acc, sx, affine, |_, t, s, b| t * s + b));
}

/// `y = (y + t) s + b`.
#[inline(never)]
pub fn finish_sum(y: &mut [f32], acc: &[i32], sx: &[f32], affine: Affine<'_>) {
    wide!(rows(y, acc, sx, affine, |y, t, s, b| (y + t) * s + b));
}

/// `y += t s + b`.
#[inline(never)]
pub fn add_finished(y: &mut [f32], acc: &[i32], sx: &[f32], affine: Affine<'_>) {
    wide!(rows(y, acc, sx, affine, |y, t, s, b| y + (t * s + b)));
}

/// `y += 256 t s`: what the high plane of weights of 16 bits adds before [`add_finished`] adds the low one.
#[cfg(feature = "wide-layers")]
#[inline(never)]
pub fn add_high_scaled(y: &mut [f32], acc: &[i32], sx: &[f32], affine: Affine<'_>) {
    wide!(rows(y, acc, sx, affine, |y, t, s, _| y + t * 256.0 * s));
}

/// `y = y s + b`, `N` numbers of every `stride` of `y`.
#[inline(never)]
pub fn scale(y: &mut [f32], stride: usize, (scales, biases): Affine<'_>) {
    wide!({
        for y in y.chunks_mut(stride.max(1)) {
            for ((y, s), b) in y.iter_mut().zip(scales).zip(biases) {
                *y = *y * *s + *b;
            }
        }
    });
}

/// `y = f(y, t, s, b)`.
#[inline(always)]
fn rows(y: &mut [f32], acc: &[i32], sx: &[f32], (scales, biases): Affine<'_>, f: impl Fn(f32, f32, f32, f32) -> f32) {
    let width = scales.len().max(1);
    for ((y, acc), sx) in y.chunks_exact_mut(width).zip(acc.chunks_exact(width)).zip(sx) {
        row(y, acc, *sx, scales, biases, &f);
    }
}

// A function of its own: where loops are joined, the compiler gathers fours of several rows.
#[inline(always)]
fn row(y: &mut [f32], acc: &[i32], sx: f32, scales: &[f32], biases: &[f32], f: impl Fn(f32, f32, f32, f32) -> f32) {
    // Fours, so that the compiler need not find them: it runs out of registers where it looks for itself.
    let (y_fours, y_rest) = y.as_chunks_mut::<4>();
    let (acc_fours, acc_rest) = acc.as_chunks::<4>();
    let (scale_fours, scale_rest) = scales.as_chunks::<4>();
    let (bias_fours, bias_rest) = biases.as_chunks::<4>();
    for (((y, acc), s), b) in y_fours.iter_mut().zip(acc_fours).zip(scale_fours).zip(bias_fours) {
        for (((y, a), s), b) in y.iter_mut().zip(acc).zip(s).zip(b) {
            *y = f(*y, *a as f32 * sx, *s, *b);
        }
    }
    for (((y, a), s), b) in y_rest.iter_mut().zip(acc_rest).zip(scale_rest).zip(bias_rest) {
        *y = f(*y, *a as f32 * sx, *s, *b);
    }
}
