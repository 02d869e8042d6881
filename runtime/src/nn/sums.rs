//! Sums along rows, each in channel order: the order is part of what a sum is, since rounding depends on it.
//!
//! An addition waits for the one before it, so four rows are summed side by side.

/// Rows that are summed together.
pub const ROWS: usize = 4;

/// The sums of at most four rows `x [R][width]`, none of them empty. Where there are fewer the last one stands for those that are
/// missing.
#[inline(never)]
pub fn totals(x: &[f32], width: usize) -> [f32; ROWS] {
    sums(x, width, |x, _| x, [0.0; ROWS])
}

/// The sums of squares of what `x` is off the row's `from`, in the same way.
#[inline(never)]
pub fn squares(x: &[f32], width: usize, from: [f32; ROWS]) -> [f32; ROWS] {
    sums(x, width, |x, from| (x - from) * (x - from), from)
}

#[inline(always)]
fn sums(x: &[f32], width: usize, term: impl Fn(f32, f32) -> f32, from: [f32; ROWS]) -> [f32; ROWS] {
    let mut sums = [0.0; ROWS];
    let mut rows = x.chunks_exact(if width == 0 { 1 } else { width });
    let a = rows.next().unwrap_or(&[]);
    let b = rows.next().unwrap_or(a);
    let c = rows.next().unwrap_or(b);
    let d = rows.next().unwrap_or(c);
    for (((a, b), c), d) in a.iter().zip(b).zip(c).zip(d) {
        for ((sum, x), from) in sums.iter_mut().zip([a, b, c, d]).zip(from) {
            *sum += term(*x, from);
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
        let from = [0.5, 0.0, -1.0, 6.5];
        for rows in 1..=ROWS {
            let x = &x[..4 * rows];
            let (totals, squares) = (totals(x, 4), squares(x, 4, from));
            for (r, row) in x.chunks(4).enumerate() {
                assert_eq!(totals[r], row.iter().fold(0.0, |sum, x| sum + x), "row {r} of {rows}");
                let square = |x: &f32| (x - from[r]) * (x - from[r]);
                assert_eq!(squares[r], row.iter().fold(0.0, |sum, x| sum + square(x)), "row {r} of {rows}");
            }
        }
    }
}
