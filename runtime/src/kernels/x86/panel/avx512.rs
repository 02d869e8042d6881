//! AVX-512 with VNNI: 32 products an instruction (`vpdpwssd`), accumulated without saturation.
//!
//! A tile of 8 rows by 48 sums keeps 24 accumulators in registers, and each product's operands are loaded once for 3 or 8 products. It is
//! assembly because compilers spill accumulators here.

use super::{SQUARE, add_last, padded, serves};
use core::arch::asm;
use core::arch::x86_64::*;
use core::mem::MaybeUninit;

/// Sums of a vector.
const LANES: usize = SQUARE;
/// Vectors of a panel's row.
const COLUMNS: usize = 3;
/// Pairs of terms that a panel has room for.
const PAIRS: usize = 128;

/// Weights by pairs of terms, `[PAIRS][COLUMNS][LANES][2]` as int16, of which the first are there.
struct Panel {
    pairs: [Pair; PAIRS],
}

/// A pair of terms of all sums.
type Pair = [MaybeUninit<__m512i>; COLUMNS];

/// `acc[r][n] = sum of x[r][k] w[n][k]` for `x [rows][K]`, `w [N][K]`, `acc [rows][N]`. Returns whether it did: a panel serves many rows,
/// of which nothing is missing, and pairs of terms.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub fn forward(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) -> bool {
    if !inputs.is_multiple_of(2) || !serves(x, w, (inputs, outputs), 2 * PAIRS, acc) {
        return false;
    }
    let mut panel = Panel::new();
    for first in (0..outputs).step_by(COLUMNS * LANES) {
        let sums = (outputs - first).min(COLUMNS * LANES);
        for column in 0..sums.div_ceil(LANES) {
            let begin = first + column * LANES;
            let rows = w.get(begin * inputs..(begin + LANES).min(outputs) * inputs).unwrap_or(&[]);
            panel.put_turned(rows, inputs, column);
        }
        panel.multiply(x, inputs, first, sums, acc, outputs);
    }
    true
}

/// `acc[r][k] = sum of g[r][n] w[n][k]` for `g [rows][N]`, `w [N][K]`, `acc [rows][K]`. Returns whether it did, as [`forward`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub fn transposed(g: &[i16], w: &[i8], outputs: usize, inputs: usize, acc: &mut [i32]) -> bool {
    if !serves(g, w, (outputs, inputs), 2 * PAIRS, acc) {
        return false;
    }
    let mut panel = Panel::new();
    for first in (0..inputs).step_by(COLUMNS * LANES) {
        let sums = (inputs - first).min(COLUMNS * LANES);
        for column in 0..sums.div_ceil(LANES) {
            let at = first + column * LANES;
            let there = mask(inputs - at);
            for (pair, w) in panel.pairs.iter_mut().zip(w.chunks_exact(2 * inputs)) {
                let (even, odd) = w.split_at_checked(inputs).unwrap_or((&[], &[]));
                let (even, odd) = (lanes(even, at, there), lanes(odd, at, there));
                put(pair, column, _mm512_mask_blend_epi16(ODD, even, _mm512_slli_epi32::<16>(odd)));
            }
        }
        panel.multiply(g, outputs, first, sums, acc, inputs);
    }
    if let (false, Some(last)) = (outputs.is_multiple_of(2), w.get((outputs - 1) * inputs..)) {
        add_last(g, outputs, last, acc);
    }
    true
}

/// The high halves of all lanes.
const ODD: u32 = 0xAAAA_AAAA;

/// 16 weights from `at` on, those of the mask.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn lanes(row: &[i8], at: usize, there: u16) -> __m512i {
    let rest = row.get(at..).unwrap_or(&[]);
    // SAFETY: only the bytes that there are, are read.
    _mm512_cvtepi8_epi32(unsafe { _mm_maskz_loadu_epi8(there & mask(rest.len()), rest.as_ptr()) })
}

/// The first `count` of 16 lanes.
#[inline]
const fn mask(count: usize) -> u16 {
    if count < LANES { (1 << count) - 1 } else { u16::MAX }
}

impl Panel {
    #[inline]
    const fn new() -> Self {
        Panel { pairs: [const { [const { MaybeUninit::uninit() }; COLUMNS] }; PAIRS] }
    }

    /// Packs up to 16 rows of weights, turned over.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vl")]
    fn put_turned(&mut self, w: &[i8], inputs: usize, column: usize) {
        let whole = if w.len() < LANES * inputs { 0 } else { inputs / LANES };
        let (pairs, _) = self.pairs.as_chunks_mut();
        for (square, pairs) in pairs.iter_mut().take(inputs.div_ceil(LANES)).enumerate() {
            let at = square * LANES;
            if square < whole {
                // SAFETY: there are 16 rows, and 16 bytes of each from here on.
                unsafe { put_square(pairs, column, w.as_ptr().wrapping_add(at), inputs) };
            } else {
                let padded = padded(w, inputs, at);
                // SAFETY: as above.
                unsafe { put_square(pairs, column, padded.as_ptr().cast(), LANES) };
            }
        }
    }

    /// Sums `first..first + sums` of rows `x [rows][terms]`, into `acc [rows][width]`.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
    fn multiply(&self, x: &[i16], terms: usize, first: usize, sums: usize, acc: &mut [i32], width: usize) {
        let rows = (x.len() / terms).min(acc.len() / width);
        let last = mask(sums - sums.saturating_sub(1) / LANES * LANES);
        let mut at = 0;
        while at < rows {
            // Where fewer rows are left than a tile has, it takes some again.
            let tall = rows >= 8 && rows - at > 4;
            let from = at.min(rows - if tall { 8 } else { 4 });
            let (Some(x), Some(acc)) = (x.get(from * terms..), acc.get_mut(from * width + first..)) else { return };
            let tile = Tile {
                x: x.as_ptr(),
                row: 2 * terms,
                panel: self.pairs.as_ptr().cast(),
                pairs: terms / 2,
                acc: acc.as_mut_ptr(),
                width: 4 * width,
                last,
            };
            let multiply: unsafe fn(&Tile) = match (sums.div_ceil(LANES), tall) {
                (1, false) => Tile::of_4x1,
                (1, true) => Tile::of_8x1,
                (2, false) => Tile::of_4x2,
                (2, true) => Tile::of_8x2,
                (_, false) => Tile::of_4x3,
                (_, true) => Tile::of_8x3,
            };
            // SAFETY: there are as many rows of `x` and `acc` from here on as the tile has, `terms / 2` rows of the panel have been
            // packed, and the mask leaves out what lies behind the row's last sum.
            unsafe { multiply(&tile) };
            at += if tall { 8 } else { 4 };
        }
    }
}

/// Turns 16 rows of 16 weights over, `stride` bytes apart: eight pairs of them all.
///
/// # Safety
/// The rows are there.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn put_square(to: &mut [Pair; LANES / 2], column: usize, rows: *const i8, stride: usize) {
    // SAFETY: 16 bytes of a row.
    let row = |r: usize| unsafe { _mm_loadu_si128(rows.wrapping_add(r * stride).cast()) };
    // Each four bytes in the order 2, 0, 3, 1: the high ones are a pair, and the low ones the next.
    let order = _mm512_set4_epi32(0x0D_0F_0C_0E, 0x09_0B_08_0A, 0x05_07_04_06, 0x01_03_00_02);
    let fourth = |first: usize| {
        let rows = _mm512_inserti32x4::<1>(_mm512_castsi128_si512(row(first)), row(first + 4));
        let rows = _mm512_inserti32x4::<2>(rows, row(first + 8));
        _mm512_shuffle_epi8(_mm512_inserti32x4::<3>(rows, row(first + 12)), order)
    };
    let (a, b, c, d) = (fourth(0), fourth(1), fourth(2), fourth(3));
    let (low_ab, high_ab) = (_mm512_unpacklo_epi32(a, b), _mm512_unpackhi_epi32(a, b));
    let (low_cd, high_cd) = (_mm512_unpacklo_epi32(c, d), _mm512_unpackhi_epi32(c, d));
    let fours = [
        _mm512_unpacklo_epi64(low_ab, low_cd),
        _mm512_unpackhi_epi64(low_ab, low_cd),
        _mm512_unpacklo_epi64(high_ab, high_cd),
        _mm512_unpackhi_epi64(high_ab, high_cd),
    ];
    for ([first, second], fours) in to.as_chunks_mut().0.iter_mut().zip(fours) {
        put(first, column, _mm512_srai_epi16::<8>(fours));
        put(second, column, _mm512_srai_epi16::<8>(_mm512_slli_epi16::<8>(fours)));
    }
}

#[inline]
fn put(to: &mut Pair, column: usize, vector: __m512i) {
    if let Some(to) = to.get_mut(column) {
        to.write(vector);
    }
}

/// Some rows by some vectors of sums.
struct Tile {
    x: *const i16,
    /// Bytes of a row of `x`.
    row: usize,
    panel: *const __m512i,
    pairs: usize,
    acc: *mut i32,
    /// Bytes of a row of `acc`.
    width: usize,
    /// Lanes of the last vector that are sums.
    last: u16,
}

/// Sets a row's sums to zero.
macro_rules! zeros {
    ($($sum:literal)*) => {
        concat!($("vpxord zmm", $sum, ", zmm", $sum, ", zmm", $sum, "\n",)*)
    };
}

/// Loads a panel's row, and goes on to the next.
macro_rules! weights {
    ($($register:literal at $place:literal),*) => {
        concat!(
            $("vmovdqu64 zmm", $register, ", zmmword ptr [{panel} + ", $place, "]\n",)*
            "add {panel}, 192",
        )
    };
    (1) => { weights!("24" at "0") };
    (2) => { weights!("24" at "0", "25" at "64") };
    (3) => { weights!("24" at "0", "25" at "64", "26" at "128") };
}

/// A row's pair broadcast, times each vector of weights.
macro_rules! products {
    ($at:literal: $($weights:literal $sum:literal)*) => {
        concat!(
            "vpbroadcastd zmm27, dword ptr [", $at, "]\n",
            $("vpdpwssd zmm", $sum, ", zmm", $weights, ", zmm27\n",)*
        )
    };
    ($at:literal, $a:literal) => { products!($at: "24" $a) };
    ($at:literal, $a:literal $b:literal) => { products!($at: "24" $a "25" $b) };
    ($at:literal, $a:literal $b:literal $c:literal) => { products!($at: "24" $a "25" $b "26" $c) };
}

/// Stores a row of sums, the last vector by its mask, and goes on to the next.
macro_rules! sums {
    ($($at:literal $sum:literal)*; $last_at:literal $last:literal) => {
        concat!(
            $("vmovdqu32 zmmword ptr [{acc} + ", $at, "], zmm", $sum, "\n",)*
            "vmovdqu32 zmmword ptr [{acc} + ", $last_at, "]{{k1}}, zmm", $last, "\n",
            "add {acc}, {width}",
        )
    };
    ($a:literal) => { sums!(; "0" $a) };
    ($a:literal $b:literal) => { sums!("0" $a; "64" $b) };
    ($a:literal $b:literal $c:literal) => { sums!("0" $a "64" $b; "128" $c) };
}

/// A tile: its vectors a row, and the registers of each row's sums.
macro_rules! tile {
    ($name:ident, $columns:tt: [$($a:literal)*] [$($b:literal)*] [$($c:literal)*] [$($d:literal)*]
        $([$($e:literal)*] [$($f:literal)*] [$($g:literal)*] [$($h:literal)*])?) => {
        /// # Safety
        /// The rows of `x`, of the panel and of `acc` are there, and the processor has AVX-512 with VNNI.
        #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
        unsafe fn $name(&self) {
            // SAFETY: it reads and writes those rows, `pairs` of the panel and of each row's pairs, and no stack.
            unsafe {
                asm!(
                    zeros!($($a)* $($b)* $($c)* $($d)* $($($e)* $($f)* $($g)* $($h)*)?),
                    "2:",
                    weights!($columns),
                    products!("{x}", $($a)*),
                    products!("{x} + {row}", $($b)*),
                    products!("{x} + 2*{row}", $($c)*),
                    products!("{x} + {rows3}", $($d)*),
                    $(
                        products!("{y}", $($e)*),
                        products!("{y} + {row}", $($f)*),
                        products!("{y} + 2*{row}", $($g)*),
                        products!("{y} + {rows3}", $($h)*),
                    )?
                    "add {x}, 4",
                    "add {y}, 4",
                    "dec {pairs}",
                    "jnz 2b",
                    sums!($($a)*),
                    sums!($($b)*),
                    sums!($($c)*),
                    sums!($($d)*),
                    $(sums!($($e)*), sums!($($f)*), sums!($($g)*), sums!($($h)*),)?
                    x = inout(reg) self.x => _,
                    y = inout(reg) self.x.wrapping_byte_add(4 * self.row) => _,
                    row = in(reg) self.row,
                    rows3 = in(reg) 3 * self.row,
                    panel = inout(reg) self.panel => _,
                    pairs = inout(reg) self.pairs => _,
                    acc = inout(reg) self.acc => _,
                    width = in(reg) self.width,
                    in("k1") self.last,
                    out("zmm0") _, out("zmm1") _, out("zmm2") _, out("zmm3") _, out("zmm4") _, out("zmm5") _,
                    out("zmm6") _, out("zmm7") _, out("zmm8") _, out("zmm9") _, out("zmm10") _, out("zmm11") _,
                    out("zmm12") _, out("zmm13") _, out("zmm14") _, out("zmm15") _, out("zmm16") _, out("zmm17") _,
                    out("zmm18") _, out("zmm19") _, out("zmm20") _, out("zmm21") _, out("zmm22") _, out("zmm23") _,
                    out("zmm24") _, out("zmm25") _, out("zmm26") _, out("zmm27") _,
                    options(nostack),
                );
            }
        }
    };
}

impl Tile {
    tile!(of_4x1, 1: ["0"] ["1"] ["2"] ["3"]);
    tile!(of_8x1, 1: ["0"] ["1"] ["2"] ["3"] ["4"] ["5"] ["6"] ["7"]);
    tile!(of_4x2, 2: ["0" "1"] ["2" "3"] ["4" "5"] ["6" "7"]);
    tile!(of_8x2, 2: ["0" "1"] ["2" "3"] ["4" "5"] ["6" "7"] ["8" "9"] ["10" "11"] ["12" "13"] ["14" "15"]);
    tile!(of_4x3, 3: ["0" "1" "2"] ["3" "4" "5"] ["6" "7" "8"] ["9" "10" "11"]);
    tile!(of_8x3, 3: ["0" "1" "2"] ["3" "4" "5"] ["6" "7" "8"] ["9" "10" "11"]
        ["12" "13" "14"] ["15" "16" "17"] ["18" "19" "20"] ["21" "22" "23"]);
}
