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
