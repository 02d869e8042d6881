//! Symmetric positive systems of a few dozen unknowns.

use crate::kernels;
use crate::refining::vector::{axpy, dot, rows, rows_mut};

/// Numbers that a system of so many unknowns takes: its lower triangle.
#[must_use]
pub const fn triangle(order: usize) -> usize {
    order * (order + 1) / 2
}

/// `A = L L^T`, the lower triangle row by row, each diagonal as its reciprocal.
#[derive(Debug)]
pub struct Cholesky<'a> {
    lower: &'a [f32],
}

impl<'a> Cholesky<'a> {
    /// Factors the matrix whose element at row i, column j <= i is `entry(i, j)`, with `ridge` times the mean of the diagonal added to the
    /// diagonal, in `lower`, of [`triangle`] numbers. An unknown whose pivot is lost to rounding comes out as 0.
    // Not one a matrix: all together they would take more flash than the sums.
    #[inline(never)]
    pub fn new(lower: &'a mut [f32], order: usize, ridge: f32, entry: &dyn Fn(usize, usize) -> f32) -> Self {
        invariant!(lower.len() >= triangle(order), "{} numbers for {order} unknowns", lower.len());
        let mut trace = 0.0;
        for i in 0..order {
            trace += entry(i, i);
        }
        let added = ridge * trace / (if order > 0 { order as f32 } else { 1.0 });
        for i in 0..order {
            let (done, rest) = lower.split_at_mut_checked(triangle(i)).unwrap_or_default();
            let row = part_mut!(rest, ..i + 1);
            for (j, value) in row.iter_mut().enumerate() {
                *value = entry(i, j) + if i == j { added } else { 0.0 };
            }
            for j in 0..i {
                let earlier = part!(done, triangle(j)..triangle(j + 1));
                let (own, behind) = row.split_at_mut_checked(j).unwrap_or_default();
                if let (Some(value), Some((reciprocal, earlier))) = (behind.first_mut(), earlier.split_last()) {
                    *value = (*value - dot(own, earlier)) * reciprocal;
                }
            }
            if let Some((pivot, own)) = row.split_last_mut() {
                let whole = *pivot;
                let left = whole - dot(own, own);
                *pivot = if left > 1e-7 * whole { 1.0 / kernels::sqrt(left) } else { 0.0 };
            }
        }
        Cholesky { lower: part!(lower, ..triangle(order)) }
    }

    /// Replaces the right sides `x [order][width]` by the solutions.
    #[inline(never)]
    pub fn solve(&self, x: &mut [f32], width: usize) {
        let order = x.len().checked_div(width).unwrap_or(0);
        invariant!(self.lower.len() == triangle(order), "{order} right sides");
        for i in 0..order {
            let row = part!(self.lower, triangle(i)..triangle(i + 1));
            let (done, rest) = x.split_at_mut_checked(i * width).unwrap_or_default();
            let (values, Some((reciprocal, row))) = (part_mut!(rest, ..width), row.split_last()) else { continue };
            for (earlier, factor) in rows(done, width).zip(row) {
                axpy(values, -factor, earlier);
            }
            scale(values, *reciprocal);
        }
        for i in (0..order).rev() {
            let row = part!(self.lower, triangle(i)..triangle(i + 1));
            let (done, rest) = x.split_at_mut_checked(i * width).unwrap_or_default();
            let (values, Some((reciprocal, row))) = (part_mut!(rest, ..width), row.split_last()) else { continue };
            scale(values, *reciprocal);
            for (earlier, factor) in rows_mut(done, width).zip(row) {
                axpy(earlier, -factor, values);
            }
        }
    }
}

fn scale(values: &mut [f32], by: f32) {
    for value in values {
        *value *= by;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{vec, vec::Vec};

    /// Against the product: A x is what was on the right.
    #[test]
    fn solutions_solve() {
        for order in 0..34usize {
            let entry = |i: usize, j: usize| {
                let gram = |k: usize| ((i * 7 + k * 3) % 11) as f32 * 0.1 * (((j * 7 + k * 3) % 11) as f32 * 0.1);
                (0..5).map(gram).sum::<f32>() + if i == j { 1.0 } else { 0.0 }
            };
            let mut lower = vec![0.0; triangle(order)];
            let factor = Cholesky::new(&mut lower, order, 0.0, &entry);
            let right: Vec<[f32; 2]> = (0..order).map(|i| [i as f32 - 3.0, 1.0 / (1.0 + i as f32)]).collect();
            let mut x = right.clone();
            factor.solve(x.as_flattened_mut(), 2);
            for (i, wanted) in right.iter().enumerate() {
                for c in 0..2 {
                    let got: f64 = (0..order).map(|j| f64::from(entry(i.max(j), i.min(j))) * f64::from(x[j][c])).sum();
                    assert!((got - f64::from(wanted[c])).abs() < 1e-4, "{order}: row {i}, {got} {wanted:?}");
                }
            }
        }
    }

    /// Two equal rows: without a ridge one of them is dropped, with one they share.
    #[test]
    fn rows_that_say_the_same_leave_no_infinity() {
        let mut lower = [0.0; 3];
        let mut x = [[2.0], [2.0]];
        Cholesky::new(&mut lower, 2, 0.0, &|_, _| 1.0).solve(x.as_flattened_mut(), 1);
        assert_eq!(x, [[2.0], [0.0]]);
        let mut x = [[2.0], [2.0]];
        Cholesky::new(&mut lower, 2, 1e-3, &|_, _| 1.0).solve(x.as_flattened_mut(), 1);
        assert!((x[0][0] - x[1][0]).abs() < 1e-3 && (x[0][0] + x[1][0] - 2.0).abs() < 1e-2, "{x:?}");
    }
}
