//! Plain Rust kernels: the specification, and the fallback on every target.

/// The square root, correctly rounded; no number of a negative one.
#[cfg(any(not(fpu), test, feature = "check-kernels"))]
#[inline]
#[must_use]
pub fn sqrt(x: f32) -> f32 {
    libm::sqrtf(x)
}

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

/// Inputs whose 4-bit weights are packed together, and the bytes that they take.
pub const GROUP: usize = 16;
/// See [`GROUP`].
pub const GROUP_BYTES: usize = GROUP / 2;
/// What is added to a 4-bit weight where it is stored.
const OFFSET: i8 = 8;

/// `acc[r][n] = sum_k x[r][k] * w[n][k]` with 4-bit weights: rows `x [R][inputs]`, weights `w [N][inputs / 2]`, `acc [R][N]`.
///
/// Of 16 weights in a row, byte `i` of eight holds number `i` in its low half and number `8 + i` in its high half, 8 added to each.
/// Incomplete rows are ignored; a width that is no multiple of [`GROUP`] does nothing.
#[inline(never)]
pub fn linear_s16s4(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if inputs == 0 || outputs == 0 || !inputs.is_multiple_of(GROUP) {
        return;
    }
    for (x, acc) in x.chunks_exact(inputs).zip(acc.chunks_exact_mut(outputs)) {
        let groups = x.as_chunks::<GROUP>().0;
        for (w, acc) in w.chunks_exact(inputs / 2).zip(acc) {
            *acc = 0;
            for (x, w) in groups.iter().zip(w.as_chunks::<GROUP_BYTES>().0) {
                let mut sum = [0];
                linear_s16s8(x, &unpacked(w), GROUP, 1, &mut sum);
                *acc = acc.wrapping_add(sum[0]);
            }
        }
    }
}

/// The weights of a group, -8..=7.
#[inline(never)]
#[must_use]
pub fn unpacked(bytes: &[u8; GROUP_BYTES]) -> [i8; GROUP] {
    let mut weights = [0; GROUP];
    let (low, high) = weights.split_at_mut(GROUP_BYTES);
    for ((low, high), byte) in low.iter_mut().zip(high).zip(bytes) {
        (*low, *high) = ((byte & 15) as i8 - OFFSET, (byte >> 4) as i8 - OFFSET);
    }
    weights
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

/// The largest magnitude of `x`, as bits without the sign, shifted to its place: so finite numbers order, and what is not
/// finite is larger. 0 where there are none.
#[cfg(any(not(kernels = "mve"), test, feature = "check-kernels"))]
#[inline(always)]
#[must_use]
pub fn largest_magnitude(x: &[f32]) -> u32 {
    let mut largest = 0;
    for v in x {
        let magnitude = v.to_bits() << 1;
        if magnitude > largest {
            largest = magnitude;
        }
    }
    largest
}

/// `q[k] = round(x[k] * factor)`, as many as both have.
#[cfg(any(not(kernels = "mve"), test, feature = "check-kernels"))]
#[inline(always)]
pub fn round_scaled(x: &[f32], factor: f32, q: &mut [i16]) {
    for (q, v) in q.iter_mut().zip(x) {
        *q = round(*v * factor);
    }
}

/// Adding this to `|v| < 2^22` leaves the nearest integer (ties to even) in the low mantissa bits.
const ROUND: f32 = 12_582_912.0;

/// The nearest integer to `v`, ties to even, for `|v| < 2^15`.
#[inline(always)]
#[must_use]
pub fn round(v: f32) -> i16 {
    (v + ROUND).to_bits() as i16
}

/// `x <- relu(x)` for at most 32 numbers, others are left as they are; bit k says whether `x[k]` was positive.
#[inline(always)]
pub fn relu(x: &mut [f32]) -> u32 {
    let mut bits = 0;
    for (k, v) in x.iter_mut().take(32).enumerate() {
        if *v > 0.0 {
            bits |= 1 << k;
        } else {
            *v = 0.0;
        }
    }
    bits
}

/// Runs an elementwise loop, compiled for the widest registers of the machine. The compiler neither reorders nor joins
/// floating-point operations, so the bits do not depend on the width.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
pub fn widened<R>(body: impl FnOnce() -> R) -> R {
    body()
}
