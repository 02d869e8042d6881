//! Plain Rust kernels: the specification, and the fallback on every target.

/// `acc[r][n] = sum_k x[r][k] * w[n][k]`: rows `x [R][inputs]`, weights `w [N][inputs]`, `acc [R][N]`.
///
/// Incomplete rows are ignored; a zero width does nothing.
#[inline(never)]
pub fn linear_s16s8(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if inputs == 0 || outputs == 0 {
        return;
    }
    for (x, acc) in x.chunks_exact(inputs).zip(acc.chunks_exact_mut(outputs)) {
        for (w, acc) in w.chunks_exact(inputs).zip(acc) {
            let mut sum = 0i32;
            for (x, w) in x.iter().zip(w) {
                sum = sum.wrapping_add(i32::from(*x) * i32::from(*w));
            }
            *acc = sum;
        }
    }
}

/// `acc[r][k] = sum_n g[r][n] * w[n][k]`: the same weights read transposed, for input gradients.
///
/// Rows `g [R][N]`, weights `w [N][inputs]`, `acc [R][inputs]`.
#[inline(never)]
pub fn linear_transposed_s16s8(g: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if inputs == 0 || outputs == 0 {
        return;
    }
    for (g, acc) in g.chunks_exact(outputs).zip(acc.chunks_exact_mut(inputs)) {
        acc.fill(0);
        for (g, w) in g.iter().zip(w.chunks_exact(inputs)) {
            let g = i32::from(*g);
            for (acc, w) in acc.iter_mut().zip(w) {
                *acc = acc.wrapping_add(g * i32::from(*w));
            }
        }
    }
}

/// Runs an elementwise loop, compiled for the widest registers of the machine. The compiler neither reorders nor joins
/// floating-point operations, so the bits do not depend on the width.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
pub fn wide<R>(body: impl FnOnce() -> R) -> R {
    body()
}

/// `x[i] <- exp(x[i] - largest)`; returns their sum in order.
#[inline(always)]
pub fn exponentials(x: &mut [f32], largest: f32) -> f32 {
    let mut sum = 0.0;
    for v in x {
        *v = libm::expf(*v - largest);
        sum += *v;
    }
    sum
}

/// `x[i] <- x[i]/2 (1 + erf(x[i] / sqrt 2))`.
#[inline(always)]
pub fn gelu(x: &mut [f32]) {
    for x in x {
        *x = 0.5 * *x * (1.0 + libm::erff(*x * core::f32::consts::FRAC_1_SQRT_2));
    }
}
