//! Kernels for many rows: weights are packed into a panel whose lanes are sums, so that no lanes are left to be added up,
//! and rows are broadcast.

pub mod avx2;
pub mod avx512;

/// Rows from which a panel pays: those of the smallest tile.
const ROWS: usize = 4;
/// Rows and weights of a square that is packed at once.
const SQUARE: usize = 16;

/// Whether there are enough rows, not too many `terms`, and nothing is missing of `x [..][terms]`, the weights and `acc [..][sums]`.
/// That no tile reads or writes beyond them rests on it.
fn serves(x: &[i16], w: &[i8], (terms, sums): (usize, usize), most: usize, acc: &[i32]) -> bool {
    let rows = x.len() / terms.max(1);
    rows >= ROWS
        && terms > 1
        && terms <= most
        && sums > 0
        && terms.checked_mul(sums) == Some(w.len())
        && acc.len() / sums >= rows
}

/// The weights from `at` on, of 16 rows `w [..][terms]` 16; zeros where there are none.
#[inline(never)]
fn padded(w: &[i8], terms: usize, at: usize) -> [[i8; SQUARE]; SQUARE] {
    let mut square = [[0; SQUARE]; SQUARE];
    for (to, row) in square.iter_mut().zip(w.chunks_exact(terms)) {
        let row = row.get(at..).unwrap_or(&[]);
        match row.first_chunk() {
            Some(row) => *to = *row,
            None => to.iter_mut().zip(row).for_each(|(to, from)| *to = *from),
        }
    }
    square
}

/// Adds what the last of an odd number of terms makes, `acc[r][n] += x[r][terms - 1] w[n]`, for weights `w [sums]`.
#[inline(always)]
fn add_last(x: &[i16], terms: usize, w: &[i8], acc: &mut [i32]) {
    for (x, acc) in x.chunks_exact(terms).zip(acc.chunks_exact_mut(w.len())) {
        let x = x.last().copied().map_or(0, i32::from);
        for (acc, w) in acc.iter_mut().zip(w) {
            *acc = acc.wrapping_add(x * i32::from(*w));
        }
    }
}
