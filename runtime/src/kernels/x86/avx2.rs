//! AVX2: 16 products an instruction, added in pairs (`vpmaddwd`). A pair cannot overflow: a weight is at most 128.

use super::panel::avx2 as panel;
use super::rows::{by_rows, in_steps, padded, pair, present, put, row, tiles};
use crate::kernels::{GROUP, GROUP_BYTES};
use core::arch::x86_64::*;

/// Products of a step.
const STEP: usize = 16;
/// Outputs of a tile: with four rows eight sums, half the registers.
const OUTPUTS: usize = 2;

/// See [`super::widened`].
#[inline]
#[target_feature(enable = "avx2")]
pub fn widened<R>(body: impl FnOnce() -> R) -> R {
    body()
}

/// See [`super::portable::linear_s16s8`]; many rows by AVX-VNNI where `VNNI` says so.
///
/// # Safety
/// With `VNNI` the processor has AVX-VNNI.
#[target_feature(enable = "avx2")]
pub unsafe fn linear_s16s8<const VNNI: bool>(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    // SAFETY: the caller says so.
    if !unsafe { panel::forward::<VNNI>(x, w, inputs, outputs, acc) } {
        by_rows!(forward, x, inputs, acc, outputs, w);
    }
}

/// See [`super::portable::linear_s16s4`].
#[target_feature(enable = "avx2")]
pub fn linear_s16s4(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if inputs.is_multiple_of(GROUP) {
        by_rows!(forward_s4, x, inputs, acc, outputs, w);
    }
}

/// See [`super::portable::linear_transposed_s16s8`]; as above.
///
/// # Safety
/// As of [`linear_s16s8`].
#[target_feature(enable = "avx2")]
pub unsafe fn linear_transposed_s16s8<const VNNI: bool>(
    g: &[i16],
    w: &[i8],
    inputs: usize,
    outputs: usize,
    acc: &mut [i32],
) {
    // SAFETY: the caller says so.
    if !unsafe { panel::transposed::<VNNI>(g, w, outputs, inputs, acc) } {
        by_rows!(transposed, g, outputs, acc, inputs, w);
    }
}

#[target_feature(enable = "avx2")]
fn forward<const R: usize>(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    tiles(x, (w, inputs), inputs, outputs, acc, |x: [_; R], w| {
        tile(x, w, inputs, |w| _mm256_cvtepi8_epi16(load_i8(w)))
    });
}

#[target_feature(enable = "avx2")]
fn forward_s4<const R: usize>(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    tiles(x, (w, inputs / 2), inputs, outputs, acc, |x: [_; R], w| tile(x, w, inputs, |w| load_s4(w)));
}

/// Dot products of `R` rows and two outputs.
#[inline]
#[target_feature(enable = "avx2")]
fn tile<const R: usize, const S: usize, W: Copy + Default>(
    x: [&[i16]; R],
    w: [&[W]; OUTPUTS],
    inputs: usize,
    load: impl Fn(&[W; S]) -> __m256i,
) -> [[i32; OUTPUTS]; R] {
    let steps = inputs / STEP;
    let (mut x_windows, mut w_windows): ([&[_]; R], [&[_]; OUTPUTS]) = ([&[]; R], [&[]; OUTPUTS]);
    for (windows, row) in x_windows.iter_mut().zip(x) {
        *windows = in_steps(row, steps);
    }
    for (windows, row) in w_windows.iter_mut().zip(w) {
        *windows = in_steps(row, steps);
    }
    let mut sums = [[_mm256_setzero_si256(); OUTPUTS]; R];
    if x_windows.iter().all(|row| row.len() == steps) && w_windows.iter().all(|row| row.len() == steps) {
        for step in 0..steps {
            let mut weights = [_mm256_setzero_si256(); OUTPUTS];
            for (weights, row) in weights.iter_mut().zip(w_windows) {
                // SAFETY: every row has `steps` windows.
                *weights = load(unsafe { row.get_unchecked(step) });
            }
            for (sums, row) in sums.iter_mut().zip(x_windows) {
                // SAFETY: as above.
                multiply(sums, load_i16(unsafe { row.get_unchecked(step) }), weights);
            }
        }
    }
    if steps * STEP < inputs {
        let mut weights = [_mm256_setzero_si256(); OUTPUTS];
        for (weights, row) in weights.iter_mut().zip(w) {
            *weights = load(&padded(row, steps * S));
        }
        for (sums, row) in sums.iter_mut().zip(x) {
            multiply(sums, load_i16(&padded(row, steps * STEP)), weights);
        }
    }
    let mut all = [[0; OUTPUTS]; R];
    for (all, sums) in all.iter_mut().zip(sums) {
        *all = totals(sums);
    }
    all
}

/// The sum over the lanes of each.
#[inline]
#[target_feature(enable = "avx2")]
fn totals([a, b]: [__m256i; OUTPUTS]) -> [i32; OUTPUTS] {
    let ab = _mm256_add_epi32(_mm256_unpacklo_epi32(a, b), _mm256_unpackhi_epi32(a, b));
    let half = _mm_add_epi32(_mm256_castsi256_si128(ab), _mm256_extracti128_si256::<1>(ab));
    let sums = _mm_cvtsi128_si64(_mm_add_epi32(half, _mm_unpackhi_epi64(half, half)));
    [sums as i32, (sums >> 32) as i32]
}

/// Sums along N: pairs of weight rows interleaved, so that a lane is an input channel.
#[target_feature(enable = "avx2")]
fn transposed<const R: usize>(g: &[i16], w: &[i8], outputs: usize, inputs: usize, acc: &mut [i32]) {
    let count = present(w, inputs, outputs);
    let pairs = count / 2;
    let mut g_rows: [&[[i16; 2]]; R] = [&[]; R];
    let mut odd = [0i16; R];
    for (r, (g_row, odd)) in g_rows.iter_mut().zip(&mut odd).enumerate() {
        let (windows, rest) = row(g, r, outputs).get(..count).unwrap_or(&[]).as_chunks();
        *g_row = windows.get(..pairs).unwrap_or(&[]);
        *odd = rest.first().copied().unwrap_or(0);
    }
    let (w, last) = w.split_at_checked(2 * pairs * inputs).unwrap_or((&[], &[]));
    for at in (0..inputs).step_by(STEP) {
        let mut sums = [[_mm256_setzero_si256(); 2]; R];
        for (p, w) in w.chunks_exact(2 * inputs).enumerate() {
            let (even, odd) = w.split_at_checked(inputs).unwrap_or((&[], &[]));
            let weights = interleaved(even, odd, at);
            for (sums, row) in sums.iter_mut().zip(g_rows) {
                let [low, high] = *row.get(p).unwrap_or(&[0; 2]);
                multiply(sums, _mm256_set1_epi32(pair(low, high)), weights);
            }
        }
        if 2 * pairs < count {
            let weights = interleaved(last.get(..inputs).unwrap_or(&[]), &[], at);
            for (sums, g) in sums.iter_mut().zip(odd) {
                multiply(sums, _mm256_set1_epi32(pair(g, 0)), weights);
            }
        }
        for ([low, high], acc) in sums.into_iter().zip(acc.chunks_exact_mut(inputs)) {
            put(acc, at, &store(low));
            put(acc, at + STEP / 2, &store(high));
        }
    }
}

/// `sums[n] += x * weights[n]`.
#[inline]
#[target_feature(enable = "avx2")]
fn multiply<const N: usize>(sums: &mut [__m256i; N], x: __m256i, weights: [__m256i; N]) {
    for (sum, weights) in sums.iter_mut().zip(weights) {
        *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(x, weights));
    }
}

/// Channels from `at` on of two weight rows, in pairs.
#[inline]
#[target_feature(enable = "avx2")]
fn interleaved(even: &[i8], odd: &[i8], at: usize) -> [__m256i; 2] {
    let (even, odd) = (channels(even, at), channels(odd, at));
    let (low, high) = (_mm_unpacklo_epi8(even, odd), _mm_unpackhi_epi8(even, odd));
    [_mm256_cvtepi8_epi16(low), _mm256_cvtepi8_epi16(high)]
}

/// Weights from `at` on, zeros behind the end of the row.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn channels(row: &[i8], at: usize) -> __m128i {
    match row.get(at..).and_then(|rest| rest.first_chunk()) {
        Some(window) => load_i8(window),
        None => load_i8(&padded(row, at)),
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn load_i16(x: &[i16; STEP]) -> __m256i {
    // SAFETY: the array has the 32 bytes that are read.
    unsafe { _mm256_loadu_si256(x.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn load_i8(x: &[i8; STEP]) -> __m128i {
    // SAFETY: the array has the 16 bytes that are read.
    unsafe { _mm_loadu_si128(x.as_ptr().cast()) }
}

/// One group of weights.
#[inline]
#[target_feature(enable = "avx2")]
fn load_s4(w: &[u8; GROUP_BYTES]) -> __m256i {
    let both = _mm_cvtsi64_si128(i64::from_le_bytes(*w));
    let halves = _mm_unpacklo_epi64(both, _mm_srli_epi16::<4>(both));
    let weights = _mm_sub_epi8(_mm_and_si128(halves, _mm_set1_epi8(15)), _mm_set1_epi8(8));
    _mm256_cvtepi8_epi16(weights)
}

#[inline]
#[target_feature(enable = "avx2")]
fn store(x: __m256i) -> [i32; STEP / 2] {
    let mut values = [0; STEP / 2];
    // SAFETY: the array has the 32 bytes that are written.
    unsafe { _mm256_storeu_si256(values.as_mut_ptr().cast(), x) };
    values
}
