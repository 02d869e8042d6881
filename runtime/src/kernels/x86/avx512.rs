//! AVX-512 with VNNI: 32 products an instruction (`vpdpwssd`), accumulated without saturation.

use super::panel::avx512 as panel;
use super::rows::{by_rows, in_steps, padded, pair, present, put, row, tiles};
use crate::kernels::{GROUP, GROUP_BYTES};
use core::arch::x86_64::*;

/// Products of a step.
const STEP: usize = 32;
/// Outputs of a tile.
const OUTPUTS: usize = 4;

/// See [`super::portable::linear_s16s8`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub fn linear_s16s8(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if !panel::forward(x, w, inputs, outputs, acc) {
        by_rows!(forward, x, inputs, acc, outputs, w);
    }
}

/// See [`super::portable::linear_s16s4`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub fn linear_s16s4(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if inputs.is_multiple_of(GROUP) {
        by_rows!(forward_s4, x, inputs, acc, outputs, w);
    }
}

/// See [`super::portable::linear_transposed_s16s8`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub fn linear_transposed_s16s8(g: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if !panel::transposed(g, w, outputs, inputs, acc) {
        by_rows!(transposed, g, outputs, acc, inputs, w);
    }
}

#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
fn forward<const R: usize>(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    tiles(x, (w, inputs), inputs, outputs, acc, |x: [_; R], w| {
        tile(x, w, inputs, |w| _mm512_cvtepi8_epi16(load_i8(w)))
    });
}

#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
fn forward_s4<const R: usize>(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    tiles(x, (w, inputs / 2), inputs, outputs, acc, |x: [_; R], w| tile(x, w, inputs, |w| load_s4(w)));
}

/// Dot products of `R` rows and four outputs.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
fn tile<const R: usize, const S: usize, W: Copy + Default>(
    x: [&[i16]; R],
    w: [&[W]; OUTPUTS],
    inputs: usize,
    load: impl Fn(&[W; S]) -> __m512i,
) -> [[i32; OUTPUTS]; R] {
    let steps = inputs / STEP;
    let (mut x_windows, mut w_windows): ([&[_]; R], [&[_]; OUTPUTS]) = ([&[]; R], [&[]; OUTPUTS]);
    for (windows, row) in x_windows.iter_mut().zip(x) {
        *windows = in_steps(row, steps);
    }
    for (windows, row) in w_windows.iter_mut().zip(w) {
        *windows = in_steps(row, steps);
    }
    let mut sums = [[_mm512_setzero_si512(); OUTPUTS]; R];
    if x_windows.iter().all(|row| row.len() == steps) && w_windows.iter().all(|row| row.len() == steps) {
        for step in 0..steps {
            let mut weights = [_mm512_setzero_si512(); OUTPUTS];
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
        let mut weights = [_mm512_setzero_si512(); OUTPUTS];
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
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn totals([a, b, c, d]: [__m512i; OUTPUTS]) -> [i32; OUTPUTS] {
    let ab = _mm512_add_epi32(_mm512_unpacklo_epi32(a, b), _mm512_unpackhi_epi32(a, b));
    let cd = _mm512_add_epi32(_mm512_unpacklo_epi32(c, d), _mm512_unpackhi_epi32(c, d));
    let abcd = _mm512_add_epi32(_mm512_unpacklo_epi64(ab, cd), _mm512_unpackhi_epi64(ab, cd));
    let half = _mm256_add_epi32(_mm512_castsi512_si256(abcd), _mm512_extracti64x4_epi64::<1>(abcd));
    let sums = _mm_add_epi32(_mm256_castsi256_si128(half), _mm256_extracti128_si256::<1>(half));
    let mut totals = [0; OUTPUTS];
    // SAFETY: the array has the 16 bytes that are written.
    unsafe { _mm_storeu_si128(totals.as_mut_ptr().cast(), sums) };
    totals
}

/// Sums along N: pairs of weight rows interleaved, so that a lane is an input channel.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
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
        let mut sums = [[_mm512_setzero_si512(); 2]; R];
        for (p, w) in w.chunks_exact(2 * inputs).enumerate() {
            let (even, odd) = w.split_at_checked(inputs).unwrap_or((&[], &[]));
            let weights = interleaved(even, odd, at);
            for (sums, row) in sums.iter_mut().zip(g_rows) {
                let [low, high] = *row.get(p).unwrap_or(&[0; 2]);
                multiply(sums, _mm512_set1_epi32(pair(low, high)), weights);
            }
        }
        if 2 * pairs < count {
            let weights = interleaved(last.get(..inputs).unwrap_or(&[]), &[], at);
            for (sums, g) in sums.iter_mut().zip(odd) {
                multiply(sums, _mm512_set1_epi32(pair(g, 0)), weights);
            }
        }
        for ([low, high], acc) in sums.into_iter().zip(acc.chunks_exact_mut(inputs)) {
            // Interleaving works in lanes of 128 bits: `low` has channels 0..8 and 16..24, `high` those between.
            put(acc, at, &store(_mm512_shuffle_i64x2::<0b01_00_01_00>(low, high)));
            put(acc, at + STEP / 2, &store(_mm512_shuffle_i64x2::<0b11_10_11_10>(low, high)));
        }
    }
}

/// `sums[n] += x * weights[n]`.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
fn multiply<const N: usize>(sums: &mut [__m512i; N], x: __m512i, weights: [__m512i; N]) {
    for (sum, weights) in sums.iter_mut().zip(weights) {
        *sum = _mm512_dpwssd_epi32(*sum, x, weights);
    }
}

/// Channels from `at` on of two weight rows, in pairs.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn interleaved(even: &[i8], odd: &[i8], at: usize) -> [__m512i; 2] {
    let (even, odd) = (channels(even, at), channels(odd, at));
    let (low, high) = (_mm256_unpacklo_epi8(even, odd), _mm256_unpackhi_epi8(even, odd));
    [_mm512_cvtepi8_epi16(low), _mm512_cvtepi8_epi16(high)]
}

/// Weights from `at` on, zeros behind the end of the row.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn channels(row: &[i8], at: usize) -> __m256i {
    match row.get(at..).and_then(|rest| rest.first_chunk()) {
        Some(window) => load_i8(window),
        None => load_i8(&padded(row, at)),
    }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn load_i16(x: &[i16; STEP]) -> __m512i {
    // SAFETY: the array has the 64 bytes that are read.
    unsafe { _mm512_loadu_si512(x.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn load_i8(x: &[i8; STEP]) -> __m256i {
    // SAFETY: the array has the 32 bytes that are read.
    unsafe { _mm256_loadu_si256(x.as_ptr().cast()) }
}

/// Two groups of weights.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn load_s4(w: &[u8; 2 * GROUP_BYTES]) -> __m512i {
    // SAFETY: the array has the 16 bytes that are read.
    let both = unsafe { _mm_loadu_si128(w.as_ptr().cast()) };
    let high = _mm_srli_epi16::<4>(both);
    let groups = _mm256_set_m128i(_mm_unpackhi_epi64(both, high), _mm_unpacklo_epi64(both, high));
    let weights = _mm256_sub_epi8(_mm256_and_si256(groups, _mm256_set1_epi8(15)), _mm256_set1_epi8(8));
    _mm512_cvtepi8_epi16(weights)
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn store(x: __m512i) -> [i32; STEP / 2] {
    let mut values = [0; STEP / 2];
    // SAFETY: the array has the 64 bytes that are written.
    unsafe { _mm512_storeu_si512(values.as_mut_ptr().cast(), x) };
    values
}
