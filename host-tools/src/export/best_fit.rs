//! The rotation that takes one bundle of vectors closest to another.

use crate::motion::quaternion::{self as q, Quaternion, Vector};

/// The rotation `R` that minimises the sum of `|R from - to|^2` over the pairs `(from, to)`: the eigenvector of the largest eigenvalue
/// of Horn's symmetric 4 x 4 matrix (Horn, Closed-form solution of absolute orientation using unit quaternions, J. Opt. Soc. Am. A 4,
/// 1987). The identity when the pairs say nothing.
pub(super) fn best_fit(pairs: impl IntoIterator<Item = (Vector, Vector)>) -> Quaternion {
    let mut s = [[0.0; 3]; 3];
    for (from, to) in pairs {
        for (row, f) in s.iter_mut().zip(from) {
            for (sum, t) in row.iter_mut().zip(to) {
                *sum += f * t;
            }
        }
    }
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = s;
    let (a, b, c) = (yz - zy, zx - xz, xy - yx);
    let (d, e, f) = (xy + yx, zx + xz, yz + zy);
    let n = [[xx + yy + zz, a, b, c], [a, xx - yy - zz, d, e], [b, d, yy - xx - zz, f], [c, e, f, zz - xx - yy]];
    q::normalise(largest_eigenvector(n))
}

/// Cyclic Jacobi rotations on a symmetric matrix; converges quadratically, so the fixed number of sweeps is ample.
fn largest_eigenvector(mut m: [[f64; 4]; 4]) -> [f64; 4] {
    const SWEEPS: usize = 12;
    // Columns are the eigenvectors.
    let mut vectors = [[0.0; 4]; 4];
    (0..4).for_each(|i| vectors[i][i] = 1.0);
    for _ in 0..SWEEPS {
        for p in 0..3 {
            for r in p + 1..4 {
                if m[p][r] == 0.0 {
                    continue;
                }
                let theta = (m[r][r] - m[p][p]) / (2.0 * m[p][r]);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let cos = 1.0 / t.hypot(1.0);
                let sin = t * cos;
                for k in 0..4 {
                    (m[k][p], m[k][r]) = (cos * m[k][p] - sin * m[k][r], sin * m[k][p] + cos * m[k][r]);
                }
                for k in 0..4 {
                    (m[p][k], m[r][k]) = (cos * m[p][k] - sin * m[r][k], sin * m[p][k] + cos * m[r][k]);
                }
                for v in &mut vectors {
                    (v[p], v[r]) = (cos * v[p] - sin * v[r], sin * v[p] + cos * v[r]);
                }
            }
        }
    }
    let largest = (1..4).fold(0, |best, i| if m[i][i] > m[best][best] { i } else { best });
    vectors.map(|row| row[largest])
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUNDLE: [Vector; 3] = [[0.6, -0.7, 0.1], [-0.6, -0.7, 0.0], [0.0, 1.0, -0.2]];

    #[test]
    fn finds_the_rotation_that_turned_a_bundle() {
        for (axis, angle) in [([1.0, 0.0, 0.0], 0.4), ([0.0, 0.6, 0.8], 3.1), ([0.0, 1.0, 0.0], -1.7)] {
            let turn = q::about(axis, angle);
            let found = best_fit(BUNDLE.map(|v| (v, q::rotate(turn, v))));
            for v in BUNDLE {
                assert!(q::length(q::subtract(q::rotate(found, v), q::rotate(turn, v))) < 1e-12, "{axis:?} {angle}");
            }
        }
    }

    #[test]
    fn no_rotation_nearby_fits_a_bent_bundle_better() {
        let bent = [[0.5, -0.8, 0.3], [-0.7, -0.5, -0.2], [0.2, 0.9, 0.1]];
        let misfit = |turn: Quaternion| -> f64 {
            BUNDLE.iter().zip(bent).map(|(&v, to)| q::length(q::subtract(q::rotate(turn, v), to)).powi(2)).sum()
        };
        let best = best_fit(BUNDLE.into_iter().zip(bent));
        for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            for angle in [-0.5, -0.01, 0.01, 0.5, 3.0] {
                assert!(misfit(q::multiply(q::about(axis, angle), best)) > misfit(best), "{axis:?} {angle}");
            }
        }
    }

    #[test]
    fn nothing_to_fit_is_the_identity() {
        assert_eq!(best_fit([]), q::IDENTITY);
        assert_eq!(best_fit([([1.0, 2.0, 3.0], [0.0; 3])]), q::IDENTITY);
    }
}
