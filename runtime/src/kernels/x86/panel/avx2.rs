//! AVX2: 16 products an instruction, added in pairs (`vpmaddwd`). A pair cannot overflow: a weight is at most 128. With AVX-VNNI
//! the same instruction adds them to the sums, too (`vpdpwssd`, without saturation).
//!
//! A tile of 6 rows by 16 sums keeps 12 accumulators in registers; of the four that are left two hold weights, two a row's pair and products. It is
//! assembly because compilers spill accumulators here. The panel is int8 and widened as it is loaded: that takes two instructions for
//! 12 products, and saves half of the packing.

use super::{ROWS, SQUARE, add_last, padded, serves};
use crate::kernels::x86::avx2::channels;
use core::arch::asm;
use core::arch::x86_64::*;
use core::mem::MaybeUninit;

/// Rows of the larger tile.
const TALL: usize = 6;
/// Sums of a panel.
const SUMS: usize = SQUARE;
/// Pairs of terms that a panel has room for.
const PAIRS: usize = 256;

/// Weights by pairs of terms, `[PAIRS][SUMS][2]`, of which the first are there.
struct Panel {
    pairs: [MaybeUninit<__m256i>; PAIRS],
}

/// `acc[r][n] = sum of x[r][k] w[n][k]` for `x [rows][K]`, `w [N][K]`, `acc [rows][N]`. Returns whether it did: a panel serves many rows,
/// of which nothing is missing, and pairs of terms.
///
/// # Safety
/// With `VNNI` the processor has AVX-VNNI.
#[target_feature(enable = "avx2")]
pub unsafe fn forward<const VNNI: bool>(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) -> bool {
    if !inputs.is_multiple_of(2) || outputs < SUMS || !serves(x, w, (inputs, outputs), 2 * PAIRS, acc) {
        return false;
    }
    let mut panel = Panel::new();
    for first in (0..outputs).step_by(SUMS) {
        // Where fewer sums are left than a panel has, it takes some again.
        let first = first.min(outputs - SUMS);
        panel.put_turned(w.get(first * inputs..(first + SUMS) * inputs).unwrap_or(&[]), inputs);
        // SAFETY: the caller says so.
        unsafe { panel.multiply::<VNNI>(x, inputs, first, acc, outputs) };
    }
    true
}

/// `acc[r][k] = sum of g[r][n] w[n][k]` for `g [rows][N]`, `w [N][K]`, `acc [rows][K]`. Returns whether it did, as [`forward`].
///
/// # Safety
/// As of [`forward`].
#[target_feature(enable = "avx2")]
pub unsafe fn transposed<const VNNI: bool>(
    g: &[i16],
    w: &[i8],
    outputs: usize,
    inputs: usize,
    acc: &mut [i32],
) -> bool {
    if inputs < SUMS || !serves(g, w, (outputs, inputs), 2 * PAIRS, acc) {
        return false;
    }
    let mut panel = Panel::new();
    for first in (0..inputs).step_by(SUMS) {
        let first = first.min(inputs - SUMS);
        for (pair, w) in panel.pairs.iter_mut().zip(w.chunks_exact(2 * inputs)) {
            let (even, odd) = w.split_at_checked(inputs).unwrap_or((&[], &[]));
            let (even, odd) = (channels(even, first), channels(odd, first));
            pair.write(_mm256_set_m128i(_mm_unpackhi_epi8(even, odd), _mm_unpacklo_epi8(even, odd)));
        }
        // SAFETY: the caller says so.
        unsafe { panel.multiply::<VNNI>(g, outputs, first, acc, inputs) };
    }
    if let (false, Some(last)) = (outputs.is_multiple_of(2), w.get((outputs - 1) * inputs..)) {
        add_last(g, outputs, last, acc);
    }
    true
}

impl Panel {
    #[inline]
    const fn new() -> Self {
        Panel { pairs: [const { MaybeUninit::uninit() }; PAIRS] }
    }

    /// Packs 16 rows of weights, turned over.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn put_turned(&mut self, w: &[i8], inputs: usize) {
        let whole = if w.len() == SUMS * inputs { inputs / SQUARE } else { 0 };
        let (squares, _) = self.pairs.as_chunks_mut();
        for (square, pairs) in squares.iter_mut().take(inputs.div_ceil(SQUARE)).enumerate() {
            let at = square * SQUARE;
            if square < whole {
                // SAFETY: there are 16 rows, and 16 bytes of each from here on.
                unsafe { put_square(pairs, w.as_ptr().wrapping_add(at), inputs) };
            } else {
                let padded = padded(w, inputs, at);
                // SAFETY: as above.
                unsafe { put_square(pairs, padded.as_ptr().cast(), SQUARE) };
            }
        }
    }

    /// 16 sums from `first` on of rows `x [rows][terms]`, into `acc [rows][width]`.
    ///
    /// # Safety
    /// As of [`forward`].
    #[inline]
    #[target_feature(enable = "avx2")]
    unsafe fn multiply<const VNNI: bool>(&self, x: &[i16], terms: usize, first: usize, acc: &mut [i32], width: usize) {
        let rows = (x.len() / terms).min(acc.len() / width);
        let mut at = 0;
        while at < rows {
            // Where fewer rows are left than a tile has, it takes some again; of seven or eight, four twice.
            let left = rows - at;
            let tall = rows >= TALL && left > ROWS && left != 7 && left != 8;
            let count = if tall { TALL } else { ROWS };
            let from = at.min(rows - count);
            let (Some(x), Some(acc)) = (x.get(from * terms..), acc.get_mut(from * width + first..)) else { return };
            let tile = Tile {
                x: x.as_ptr(),
                row: 2 * terms,
                panel: self.pairs.as_ptr().cast(),
                pairs: terms / 2,
                acc: acc.as_mut_ptr(),
                width: 4 * width,
            };
            // SAFETY: there are as many rows of `x` and `acc` from here on as the tile has, 16 sums in each of the latter, and
            // `terms / 2` rows of the panel have been packed; with `VNNI` the caller vouches for the processor.
            unsafe { tile.of::<VNNI>(count) };
            at += count;
        }
    }
}

/// Turns 16 rows of 16 weights over, `stride` bytes apart: eight pairs of them all.
///
/// # Safety
/// The rows are there.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn put_square(to: &mut [MaybeUninit<__m256i>; SQUARE / 2], rows: *const i8, stride: usize) {
    // SAFETY: 16 bytes of a row.
    let row = |r: usize| unsafe { _mm_loadu_si128(rows.wrapping_add(r * stride).cast()) };
    let both = |r: usize| _mm256_set_m128i(row(r + 8), row(r));
    let mut x = [both(0), both(1), both(2), both(3), both(4), both(5), both(6), both(7)];
    // Three times interleaved, the first half with the second: rows have become pairs, eight rows in each half of a vector.
    for _ in 0..3 {
        let [a, b, c, d, e, f, g, h] = x;
        let (low_ae, high_ae) = (_mm256_unpacklo_epi16(a, e), _mm256_unpackhi_epi16(a, e));
        let (low_bf, high_bf) = (_mm256_unpacklo_epi16(b, f), _mm256_unpackhi_epi16(b, f));
        let (low_cg, high_cg) = (_mm256_unpacklo_epi16(c, g), _mm256_unpackhi_epi16(c, g));
        let (low_dh, high_dh) = (_mm256_unpacklo_epi16(d, h), _mm256_unpackhi_epi16(d, h));
        x = [low_ae, high_ae, low_bf, high_bf, low_cg, high_cg, low_dh, high_dh];
    }
    for (to, pair) in to.iter_mut().zip(x) {
        to.write(pair);
    }
}

/// Some rows by 16 sums.
struct Tile {
    x: *const i16,
    /// Bytes of a row of `x`.
    row: usize,
    panel: *const __m256i,
    pairs: usize,
    acc: *mut i32,
    /// Bytes of a row of `acc`.
    width: usize,
}

/// Sets a row's sums to zero.
macro_rules! zeros {
    ($($sum:literal)*) => {
        concat!($("vpxor ymm", $sum, ", ymm", $sum, ", ymm", $sum, "\n",)*)
    };
}

/// A row's pair broadcast, times both vectors of weights.
macro_rules! products {
    (vpdpwssd: $at:literal, $a:literal $b:literal) => {
        concat!(
            "vpbroadcastd ymm14, dword ptr [",
            $at,
            "]\n",
            "{{vex}} vpdpwssd ymm",
            $a,
            ", ymm12, ymm14\n",
            "{{vex}} vpdpwssd ymm",
            $b,
            ", ymm13, ymm14",
        )
    };
    (vpmaddwd: $at:literal, $a:literal $b:literal) => {
        concat!(
            "vpbroadcastd ymm14, dword ptr [",
            $at,
            "]\n",
            "vpmaddwd ymm15, ymm12, ymm14\n",
            "vpmaddwd ymm14, ymm13, ymm14\n",
            "vpaddd ymm",
            $a,
            ", ymm",
            $a,
            ", ymm15\n",
            "vpaddd ymm",
            $b,
            ", ymm",
            $b,
            ", ymm14",
        )
    };
}

/// Stores a row of sums, and goes on to the next.
macro_rules! sums {
    ($a:literal $b:literal) => {
        concat!(
            "vmovdqu ymmword ptr [{acc}], ymm",
            $a,
            "\n",
            "vmovdqu ymmword ptr [{acc} + 32], ymm",
            $b,
            "\n",
            "add {acc}, {width}",
        )
    };
}

/// A tile: what multiplies, how many rows lie before `y`, and each row's place and sums.
macro_rules! tile {
    ($name:ident, $multiply:ident, $before_y:literal: $([$at:literal] $a:literal $b:literal),*) => {
        /// # Safety
        /// The rows of `x`, of the panel and of `acc` are there, and the processor has the instructions.
        #[target_feature(enable = "avx2")]
        unsafe fn $name(&self) {
            // SAFETY: it reads and writes those rows, `pairs` of the panel and of each row's pairs, and no stack.
            unsafe {
                asm!(
                    $(zeros!($a $b),)*
                    "2:",
                    "vpmovsxbw ymm12, xmmword ptr [{panel}]",
                    "vpmovsxbw ymm13, xmmword ptr [{panel} + 16]",
                    "add {panel}, 32",
                    $(products!($multiply: $at, $a $b),)*
                    "add {x}, 4",
                    "add {y}, 4",
                    "dec {pairs}",
                    "jnz 2b",
                    $(sums!($a $b),)*
                    x = inout(reg) self.x => _,
                    y = inout(reg) self.x.wrapping_byte_add($before_y * self.row) => _,
                    row = in(reg) self.row,
                    panel = inout(reg) self.panel => _,
                    pairs = inout(reg) self.pairs => _,
                    acc = inout(reg) self.acc => _,
                    width = in(reg) self.width,
                    out("ymm0") _, out("ymm1") _, out("ymm2") _, out("ymm3") _, out("ymm4") _, out("ymm5") _,
                    out("ymm6") _, out("ymm7") _, out("ymm8") _, out("ymm9") _, out("ymm10") _, out("ymm11") _,
                    out("ymm12") _, out("ymm13") _, out("ymm14") _, out("ymm15") _,
                    options(nostack),
                );
            }
        }
    };
}

impl Tile {
    /// Of six rows, or of four.
    ///
    /// # Safety
    /// As of whichever it is.
    #[inline]
    #[target_feature(enable = "avx2")]
    unsafe fn of<const VNNI: bool>(&self, rows: usize) {
        let multiply: unsafe fn(&Tile) = match (rows, VNNI) {
            (TALL, false) => Tile::of_6,
            (TALL, true) => Tile::of_6_vnni,
            (_, false) => Tile::of_4,
            (_, true) => Tile::of_4_vnni,
        };
        // SAFETY: the caller says so.
        unsafe { multiply(self) };
    }
}

/// Both ways to multiply.
macro_rules! tiles {
    ($name:ident, $vnni:ident, $($shape:tt)*) => {
        tile!($name, vpmaddwd, $($shape)*);
        tile!($vnni, vpdpwssd, $($shape)*);
    };
}

impl Tile {
    tiles!(of_4, of_4_vnni, 2: ["{x}"] "0" "1", ["{x} + {row}"] "2" "3", ["{y}"] "4" "5", ["{y} + {row}"] "6" "7");
    tiles!(of_6, of_6_vnni, 3: ["{x}"] "0" "1", ["{x} + {row}"] "2" "3", ["{x} + 2*{row}"] "4" "5",
        ["{y}"] "6" "7", ["{y} + {row}"] "8" "9", ["{y} + 2*{row}"] "10" "11");
}
