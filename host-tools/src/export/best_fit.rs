//! The rotation that takes one bundle of vectors closest to another.

use nalgebra::{Matrix4, SymmetricEigen};

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
    let SymmetricEigen { eigenvectors, eigenvalues } = Matrix4::from(n).symmetric_eigen();
    q::normalise(eigenvectors.column(eigenvalues.imax()).into_owned().into())
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
