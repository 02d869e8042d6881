//! Sums along rows, each in channel order: the order is part of what a sum is, since rounding depends on it.
//!
//! An addition waits for the one before it, so four rows are summed side by side.

/// Rows of [`sums`].
pub const ROWS: usize = 4;

/// The sums of `term(x[r][k], shift[r])` over `k` for at most four rows `x [R][width]`; 0 where there is no row.
#[inline(always)]
pub fn sums(x: &[f32], width: usize, shifts: [f32; ROWS], term: impl Fn(f32, f32) -> f32) -> [f32; ROWS] {
    let mut sums = [0.0; ROWS];
    let width = if width == 0 { 1 } else { width };
    let mut rows = x.chunks_exact(width);
    if let (Some(a), Some(b), Some(c), Some(d)) = (rows.next(), rows.next(), rows.next(), rows.next()) {
        for (((a, b), c), d) in a.iter().zip(b).zip(c).zip(d) {
            for ((sum, x), shift) in sums.iter_mut().zip([a, b, c, d]).zip(shifts) {
                *sum += term(*x, shift);
            }
        }
        return sums;
    }
    for ((sum, row), shift) in sums.iter_mut().zip(x.chunks_exact(width)).zip(shifts) {
        for x in row {
            *sum += term(*x, shift);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_summed_in_order_however_many_there_are() {
        // Big numbers swallow what is added to them, so that every other order gives other sums.
        let x = [1e8f32, 3.0, -1e8, 1.0, 1e8, 3.0, -1e8, 1.0, 2.0, -1e8, 3.0, 1e8, 5.0, 6.0, 7.0, 8.0];
        for rows in 0..=ROWS {
            let found = sums(&x[..4 * rows], 4, [0.0, 0.0, 0.5, -1.0], |x, shift| x - shift);
            for (r, sum) in found.iter().enumerate() {
                let row = if r < rows { &x[4 * r..4 * r + 4] } else { &[] };
                let shift = [0.0, 0.0, 0.5, -1.0][r];
                assert_eq!(*sum, row.iter().fold(0.0, |sum, x| sum + (x - shift)), "row {r} of {rows}");
            }
        }
    }
}
