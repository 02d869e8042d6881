//! AVX-512 with VNNI for many rows: weights are packed into a panel whose lanes are sums, so that no lanes are left to be
//! added up, and rows are broadcast.
//!
//! A tile of 8 rows by 48 sums keeps 24 accumulators in registers, and each product's operands are loaded once for 3 or 8 products. It is
//! assembly because compilers spill accumulators here.

use core::arch::asm;
use core::arch::x86_64::*;
use core::mem::MaybeUninit;

/// Rows from which a panel pays.
pub const ROWS: usize = 8;
/// Sums of a vector.
const LANES: usize = 16;
/// Vectors of a panel's row.
const COLUMNS: usize = 3;
/// Pairs of terms that a panel has room for.
const PAIRS: usize = 128;

/// Weights by pairs of terms, `[pairs][columns][LANES][2]` as int16.
struct Panel {
    vectors: [MaybeUninit<__m512i>; PAIRS * COLUMNS],
}

/// Whether a panel can serve so many rows of `terms` terms a sum.
pub const fn serves(rows: usize, terms: usize) -> bool {
    rows >= ROWS && terms > 1 && terms <= 2 * PAIRS
}

/// `acc[r][n] = sum of x[r][k] w[n][k]` for complete `x [rows][K]`, `w [N][K]`, `acc [rows][N]` that a panel [`serves`], `K` even.
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub fn forward(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    let mut panel = Panel::new();
    for first in (0..outputs).step_by(COLUMNS * LANES) {
        let sums = (outputs - first).min(COLUMNS * LANES);
        let columns = sums.div_ceil(LANES);
        for column in 0..columns {
            let begin = first + column * LANES;
            let rows = w.get(begin * inputs..(begin + LANES).min(outputs) * inputs).unwrap_or(&[]);
            for at in (0..inputs).step_by(2 * LANES) {
                panel.put_transposed(rows, inputs, at, (columns, column));
            }
        }
        panel.multiply(x, inputs, first, sums, acc, outputs);
    }
}

/// `acc[r][k] = sum of g[r][n] w[n][k]` for complete `g [rows][N]`, `w [N][K]`, `acc [rows][K]` that a panel [`serves`].
#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
pub fn transposed(g: &[i16], w: &[i8], outputs: usize, inputs: usize, acc: &mut [i32]) {
    let mut panel = Panel::new();
    for first in (0..inputs).step_by(COLUMNS * LANES) {
        let sums = (inputs - first).min(COLUMNS * LANES);
        let columns = sums.div_ceil(LANES);
        for (pair, w) in w.chunks_exact(2 * inputs).enumerate() {
            let (even, odd) = w.split_at_checked(inputs).unwrap_or((&[], &[]));
            for column in 0..columns {
                let at = first + column * LANES;
                let (even, odd) = (lanes(even, at), lanes(odd, at));
                let both = _mm256_set_m128i(_mm_unpackhi_epi8(even, odd), _mm_unpacklo_epi8(even, odd));
                panel.put(pair * columns + column, _mm512_cvtepi8_epi16(both));
            }
        }
        panel.multiply(g, outputs, first, sums, acc, inputs);
    }
    // The row of weights that makes no pair.
    if let (false, Some(last)) = (outputs.is_multiple_of(2), w.get((outputs - 1) * inputs..)) {
        for (g, acc) in g.chunks_exact(outputs).zip(acc.chunks_exact_mut(inputs)) {
            let g = g.last().copied().map_or(0, i32::from);
            for (acc, w) in acc.iter_mut().zip(last) {
                *acc = acc.wrapping_add(g * i32::from(*w));
            }
        }
    }
}

/// 16 weights from `at` on, zeros behind the end.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn lanes(row: &[i8], at: usize) -> __m128i {
    let rest = row.get(at..).unwrap_or(&[]);
    // SAFETY: only the bytes that there are, are read.
    unsafe { _mm_maskz_loadu_epi8(mask(rest.len()), rest.as_ptr()) }
}

/// The first `count` of 16 lanes.
#[inline]
const fn mask(count: usize) -> u16 {
    if count < LANES { (1 << count) - 1 } else { u16::MAX }
}

impl Panel {
    #[inline]
    const fn new() -> Self {
        Panel { vectors: [const { MaybeUninit::uninit() }; PAIRS * COLUMNS] }
    }

    #[inline]
    fn put(&mut self, at: usize, vector: __m512i) {
        if let Some(to) = self.vectors.get_mut(at) {
            to.write(vector);
        }
    }

    /// Packs the pairs from input `at` on, 16 of them or what there are, of up to 16 rows of weights; zeros where there is no row.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vl")]
    fn put_transposed(&mut self, w: &[i8], inputs: usize, at: usize, (columns, column): (usize, usize)) {
        let (there, to) = (inputs - at, at / 2 * columns + column);
        if w.len() >= LANES * inputs && there >= 2 * LANES {
            return self.put_square(turned(w.get(at..).unwrap_or(&[]), inputs), LANES, to, columns);
        }
        let mut square = [0; LANES * 2 * LANES];
        for (to, row) in square.chunks_exact_mut(2 * LANES).zip(w.chunks_exact(inputs)) {
            for (to, from) in to.iter_mut().zip(row.iter().skip(at)) {
                *to = *from;
            }
        }
        self.put_square(turned(&square, 2 * LANES), there.min(2 * LANES) / 2, to, columns);
    }

    /// Puts so many pairs of 16 rows, from `to` on, one every `columns` vectors.
    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,avx512vl")]
    fn put_square(&mut self, pairs: [__m256i; LANES], count: usize, to: usize, columns: usize) {
        for (r, pairs) in pairs.into_iter().enumerate().take(count) {
            self.put(to + r * columns, _mm512_cvtepi8_epi16(pairs));
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
            let tall = rows - at > 4;
            let from = at.min(rows - if tall { 8 } else { 4 });
            let (Some(x), Some(acc)) = (x.get(from * terms..), acc.get_mut(from * width + first..)) else { return };
            let tile = Tile {
                x: x.as_ptr(),
                row: 2 * terms,
                panel: self.vectors.as_ptr().cast(),
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

/// Merges eight vectors' pairs, each of 16 bits, the first four with the last four.
macro_rules! merged {
    ($a:ident $b:ident $c:ident $d:ident $e:ident $f:ident $g:ident $h:ident) => {
        [
            _mm256_unpacklo_epi16($a, $e),
            _mm256_unpackhi_epi16($a, $e),
            _mm256_unpacklo_epi16($b, $f),
            _mm256_unpackhi_epi16($b, $f),
            _mm256_unpacklo_epi16($c, $g),
            _mm256_unpackhi_epi16($c, $g),
            _mm256_unpacklo_epi16($d, $h),
            _mm256_unpackhi_epi16($d, $h),
        ]
    };
}

/// Turns both halves of eight rows over: three merges do it for squares of 8 x 8.
macro_rules! turned_halves {
    ($load:expr, $first:expr) => {{
        let load = $load;
        let [a, b, c, d, e, f, g, h] = [
            load($first), load($first + 1), load($first + 2), load($first + 3),
            load($first + 4), load($first + 5), load($first + 6), load($first + 7),
        ];
        let [a, b, c, d, e, f, g, h] = merged!(a b c d e f g h);
        let [a, b, c, d, e, f, g, h] = merged!(a b c d e f g h);
        merged!(a b c d e f g h)
    }};
}

/// Pairs of bytes of 16 rows of 32, `stride` bytes apart: vector `p` has every row's pair `p`. Zeros where rows are missing.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn turned(rows: &[i8], stride: usize) -> [__m256i; LANES] {
    if rows.len() < (LANES - 1) * stride + 2 * LANES {
        return [_mm256_setzero_si256(); LANES];
    }
    // SAFETY: the last row's last byte is there, as was looked.
    let load = |r: usize| unsafe { _mm256_loadu_si256(rows.as_ptr().wrapping_add(r * stride).cast()) };
    let [a, b, c, d, e, f, g, h] = turned_halves!(load, 0);
    let [i, j, k, l, m, n, o, p] = turned_halves!(load, 8);
    let low = |x, y| _mm256_inserti128_si256::<1>(x, _mm256_castsi256_si128(y));
    let high = |x, y| _mm256_permute2x128_si256::<0x31>(x, y);
    [
        low(a, i),
        low(b, j),
        low(c, k),
        low(d, l),
        low(e, m),
        low(f, n),
        low(g, o),
        low(h, p),
        high(a, i),
        high(b, j),
        high(c, k),
        high(d, l),
        high(e, m),
        high(f, n),
        high(g, o),
        high(h, p),
    ]
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

/// A row's pair broadcast, times each vector of weights.
macro_rules! products {
    ($at:literal, $($weights:literal $sum:literal)*) => {
        concat!(
            "vpbroadcastd zmm27, dword ptr [", $at, "]\n",
            $("vpdpwssd zmm", $sum, ", zmm", $weights, ", zmm27\n",)*
        )
    };
}

/// Stores a row of sums, the last vector by its mask.
macro_rules! sums {
    ($($at:literal $sum:literal)*; $last_at:literal $last:literal) => {
        concat!(
            $("vmovdqu32 zmmword ptr [{acc} + ", $at, "], zmm", $sum, "\n",)*
            "vmovdqu32 zmmword ptr [{acc} + ", $last_at, "]{{k1}}, zmm", $last, "\n",
            "add {acc}, {width}\n",
        )
    };
}

/// A tile: what each row does in each step, its accumulators, and how they are stored.
macro_rules! tile {
    ($name:ident, $bytes:literal, [$($weights:literal at $place:literal),*], [$($products:expr),*], [$($zero:literal)*], [$($sums:expr),*]) => {
        /// # Safety
        /// The rows of `x`, of the panel and of `acc` are there, and the processor has AVX-512 with VNNI.
        #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vnni")]
        unsafe fn $name(&self) {
            // SAFETY: it reads and writes those rows, `pairs` of the panel and of each row's pairs, and no stack.
            unsafe {
                asm!(
                    $(concat!("vpxord zmm", $zero, ", zmm", $zero, ", zmm", $zero),)*
                    "2:",
                    $(concat!("vmovdqu64 zmm", $weights, ", zmmword ptr [{panel} + ", $place, "]"),)*
                    $($products,)*
                    "add {x}, 4",
                    "add {y}, 4",
                    concat!("add {panel}, ", $bytes),
                    "dec {pairs}",
                    "jnz 2b",
                    $($sums,)*
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
    tile!(
        of_4x1, "64", ["24" at "0"],
        [
            products!("{x}", "24" "0"),
            products!("{x} + {row}", "24" "1"),
            products!("{x} + 2*{row}", "24" "2"),
            products!("{x} + {rows3}", "24" "3")
        ],
        ["0" "1" "2" "3"],
        [
            sums!(; "0" "0"),
            sums!(; "0" "1"),
            sums!(; "0" "2"),
            sums!(; "0" "3")
        ]
    );
    tile!(
        of_4x2, "128", ["24" at "0", "25" at "64"],
        [
            products!("{x}", "24" "0" "25" "1"),
            products!("{x} + {row}", "24" "2" "25" "3"),
            products!("{x} + 2*{row}", "24" "4" "25" "5"),
            products!("{x} + {rows3}", "24" "6" "25" "7")
        ],
        ["0" "1" "2" "3" "4" "5" "6" "7"],
        [
            sums!("0" "0"; "64" "1"),
            sums!("0" "2"; "64" "3"),
            sums!("0" "4"; "64" "5"),
            sums!("0" "6"; "64" "7")
        ]
    );
    tile!(
        of_4x3, "192", ["24" at "0", "25" at "64", "26" at "128"],
        [
            products!("{x}", "24" "0" "25" "1" "26" "2"),
            products!("{x} + {row}", "24" "3" "25" "4" "26" "5"),
            products!("{x} + 2*{row}", "24" "6" "25" "7" "26" "8"),
            products!("{x} + {rows3}", "24" "9" "25" "10" "26" "11")
        ],
        ["0" "1" "2" "3" "4" "5" "6" "7" "8" "9" "10" "11"],
        [
            sums!("0" "0" "64" "1"; "128" "2"),
            sums!("0" "3" "64" "4"; "128" "5"),
            sums!("0" "6" "64" "7"; "128" "8"),
            sums!("0" "9" "64" "10"; "128" "11")
        ]
    );
    tile!(
        of_8x1, "64", ["24" at "0"],
        [
            products!("{x}", "24" "0"),
            products!("{x} + {row}", "24" "1"),
            products!("{x} + 2*{row}", "24" "2"),
            products!("{x} + {rows3}", "24" "3"),
            products!("{y}", "24" "4"),
            products!("{y} + {row}", "24" "5"),
            products!("{y} + 2*{row}", "24" "6"),
            products!("{y} + {rows3}", "24" "7")
        ],
        ["0" "1" "2" "3" "4" "5" "6" "7"],
        [
            sums!(; "0" "0"),
            sums!(; "0" "1"),
            sums!(; "0" "2"),
            sums!(; "0" "3"),
            sums!(; "0" "4"),
            sums!(; "0" "5"),
            sums!(; "0" "6"),
            sums!(; "0" "7")
        ]
    );
    tile!(
        of_8x2, "128", ["24" at "0", "25" at "64"],
        [
            products!("{x}", "24" "0" "25" "1"),
            products!("{x} + {row}", "24" "2" "25" "3"),
            products!("{x} + 2*{row}", "24" "4" "25" "5"),
            products!("{x} + {rows3}", "24" "6" "25" "7"),
            products!("{y}", "24" "8" "25" "9"),
            products!("{y} + {row}", "24" "10" "25" "11"),
            products!("{y} + 2*{row}", "24" "12" "25" "13"),
            products!("{y} + {rows3}", "24" "14" "25" "15")
        ],
        ["0" "1" "2" "3" "4" "5" "6" "7" "8" "9" "10" "11" "12" "13" "14" "15"],
        [
            sums!("0" "0"; "64" "1"),
            sums!("0" "2"; "64" "3"),
            sums!("0" "4"; "64" "5"),
            sums!("0" "6"; "64" "7"),
            sums!("0" "8"; "64" "9"),
            sums!("0" "10"; "64" "11"),
            sums!("0" "12"; "64" "13"),
            sums!("0" "14"; "64" "15")
        ]
    );
    tile!(
        of_8x3, "192", ["24" at "0", "25" at "64", "26" at "128"],
        [
            products!("{x}", "24" "0" "25" "1" "26" "2"),
            products!("{x} + {row}", "24" "3" "25" "4" "26" "5"),
            products!("{x} + 2*{row}", "24" "6" "25" "7" "26" "8"),
            products!("{x} + {rows3}", "24" "9" "25" "10" "26" "11"),
            products!("{y}", "24" "12" "25" "13" "26" "14"),
            products!("{y} + {row}", "24" "15" "25" "16" "26" "17"),
            products!("{y} + 2*{row}", "24" "18" "25" "19" "26" "20"),
            products!("{y} + {rows3}", "24" "21" "25" "22" "26" "23")
        ],
        ["0" "1" "2" "3" "4" "5" "6" "7" "8" "9" "10" "11" "12" "13" "14" "15" "16" "17" "18" "19" "20" "21" "22" "23"],
        [
            sums!("0" "0" "64" "1"; "128" "2"),
            sums!("0" "3" "64" "4"; "128" "5"),
            sums!("0" "6" "64" "7"; "128" "8"),
            sums!("0" "9" "64" "10"; "128" "11"),
            sums!("0" "12" "64" "13"; "128" "14"),
            sums!("0" "15" "64" "16"; "128" "17"),
            sums!("0" "18" "64" "19"; "128" "20"),
            sums!("0" "21" "64" "22"; "128" "23")
        ]
    );
}
