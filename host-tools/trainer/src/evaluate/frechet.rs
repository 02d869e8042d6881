//! Fréchet distance between two sets of embeddings, each taken as a Gaussian (Heusel et al. 2017, equation 6):
//! `|m - n|^2 + tr(A + B - 2 (A B)^(1/2))`.
//!
//! `tr (A B)^(1/2) = tr (A^(1/2) B A^(1/2))^(1/2)`: the right side takes roots of symmetric matrices only.

use nalgebra::{DMatrix, SymmetricEigen};

/// Mean and covariance of a set of vectors.
#[derive(Clone, Debug, PartialEq)]
pub struct Gaussian {
    /// `[D]`.
    pub mean: Vec<f64>,
    /// `[D][D]`, divided by n - 1.
    pub covariance: Vec<f64>,
}

impl Gaussian {
    /// Of vectors of one length; zero everywhere for none, zero covariance for one.
    pub fn of<'a>(vectors: impl Iterator<Item = &'a [f64]> + Clone) -> Self {
        let count = vectors.clone().count();
        let width = vectors.clone().next().map_or(0, <[f64]>::len);
        let mut mean = vec![0.0; width];
        for vector in vectors.clone() {
            mean.iter_mut().zip(vector).for_each(|(sum, x)| *sum += x / count as f64);
        }
        let mut covariance = vec![0.0; width * width];
        let share = 1.0 / count.saturating_sub(1).max(1) as f64;
        let mut offset = vec![0.0; width];
        for vector in vectors {
            offset.iter_mut().zip(vector).zip(&mean).for_each(|((o, x), m)| *o = x - m);
            for (row, a) in covariance.chunks_exact_mut(width).zip(&offset) {
                row.iter_mut().zip(&offset).for_each(|(sum, b)| *sum += share * a * b);
            }
        }
        Self { mean, covariance }
    }

    /// Symmetric root of the covariance.
    pub fn root(&self) -> Vec<f64> {
        root(&self.covariance, self.mean.len())
    }
}

/// Fréchet distance, in squared units of the vectors; never negative.
pub fn distance(a: &Gaussian, b: &Gaussian) -> f64 {
    distance_with_root(a, &a.root(), b)
}

/// The same when the root of `a`'s covariance is known.
pub fn distance_with_root(a: &Gaussian, root_of_a: &[f64], b: &Gaussian) -> f64 {
    let n = a.mean.len();
    let means: f64 = a.mean.iter().zip(&b.mean).map(|(x, y)| (x - y).powi(2)).sum();
    let trace = |m: &[f64]| (0..n).map(|i| m[i * n + i]).sum::<f64>();
    let product = multiply(&multiply(root_of_a, &b.covariance, n), root_of_a, n);
    let cross: f64 = eigenvalues(product, n).iter().map(|x| x.max(0.0).sqrt()).sum();
    (means + trace(&a.covariance) + trace(&b.covariance) - 2.0 * cross).max(0.0)
}

fn multiply(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let mut c = vec![0.0; n * n];
    for (row, out) in a.chunks_exact(n.max(1)).zip(c.chunks_exact_mut(n.max(1))) {
        for (x, other) in row.iter().zip(b.chunks_exact(n)) {
            out.iter_mut().zip(other).for_each(|(sum, y)| *sum += x * y);
        }
    }
    c
}

/// Symmetric root of a symmetric matrix; negative eigenvalues count as 0.
fn root(matrix: &[f64], n: usize) -> Vec<f64> {
    if n == 0 {
        return Vec::new();
    }
    let SymmetricEigen { eigenvectors, eigenvalues } = DMatrix::from_row_slice(n, n, matrix).symmetric_eigen();
    let roots = DMatrix::from_diagonal(&eigenvalues.map(|x| x.max(0.0).sqrt()));
    (&eigenvectors * roots * eigenvectors.transpose()).as_slice().to_vec()
}

fn eigenvalues(matrix: Vec<f64>, n: usize) -> Vec<f64> {
    if n == 0 {
        return Vec::new();
    }
    DMatrix::from_vec(n, n, matrix).symmetric_eigenvalues().as_slice().to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn noise(n: usize, stream: u64) -> Vec<f64> {
        let mut random = Random::new(5, stream);
        (0..n).map(|_| random.symmetric()).collect()
    }

    /// `R S R^T` of a diagonal S and a rotation R made of plane rotations.
    fn turned(diagonal: &[f64], stream: u64) -> Vec<f64> {
        let n = diagonal.len();
        let mut matrix = vec![0.0; n * n];
        diagonal.iter().enumerate().for_each(|(i, x)| matrix[i * n + i] = *x);
        let mut angles = noise(n * n, stream).into_iter();
        for p in 0..n {
            for q in p + 1..n {
                let (sin, cos) = (3.0 * angles.next().unwrap()).sin_cos();
                let mut r = vec![0.0; n * n];
                (0..n).for_each(|i| r[i * n + i] = 1.0);
                (r[p * n + p], r[p * n + q], r[q * n + p], r[q * n + q]) = (cos, -sin, sin, cos);
                let transposed: Vec<f64> = (0..n * n).map(|i| r[i % n * n + i / n]).collect();
                matrix = multiply(&multiply(&r, &matrix, n), &transposed, n);
            }
        }
        matrix
    }

    #[test]
    fn roots_and_eigenvalues_of_a_turned_diagonal() {
        let diagonal = [4.0, 0.25, 9.0, 0.0, 1.0];
        let matrix = turned(&diagonal, 1);
        let mut values = eigenvalues(matrix.clone(), 5);
        values.sort_by(f64::total_cmp);
        for (x, y) in values.iter().zip([0.0, 0.25, 1.0, 4.0, 9.0]) {
            assert!((x - y).abs() < 1e-12, "{values:?}");
        }
        let root = root(&matrix, 5);
        for (x, y) in multiply(&root, &root, 5).iter().zip(&matrix) {
            assert!((x - y).abs() < 1e-7);
        }
    }

    /// Covariances that commute: the distance is that of means and of deviations, axis by axis.
    #[test]
    fn gaussians_with_common_axes() {
        let (s, t) = ([4.0, 1.0, 0.25, 9.0], [1.0, 2.25, 0.25, 16.0]);
        let a = Gaussian { mean: vec![1.0, 0.0, 2.0, 0.0], covariance: turned(&s, 2) };
        let b = Gaussian { mean: vec![0.0, 0.5, 2.0, -2.0], covariance: turned(&t, 2) };
        let roots: f64 = s.iter().zip(&t).map(|(x, y)| (x.sqrt() - y.sqrt()).powi(2)).sum();
        assert!((distance(&a, &b) - (1.0 + 0.25 + 4.0 + roots)).abs() < 1e-9);
        assert!((distance(&a, &b) - distance(&b, &a)).abs() < 1e-9);
        assert!(distance(&a, &a) < 1e-9);
    }

    /// Two dimensions, no common axes: tr (A B)^(1/2) = (tr A B + 2 (det A B)^(1/2))^(1/2).
    #[test]
    fn gaussians_in_two_dimensions() {
        let a = Gaussian { mean: vec![0.0; 2], covariance: vec![2.0, 0.7, 0.7, 1.0] };
        let b = Gaussian { mean: vec![0.0; 2], covariance: vec![0.5, -0.3, -0.3, 3.0] };
        let trace = 2.0 * 0.5 - 0.7 * 0.3 - 0.7 * 0.3 + 3.0;
        let determinant: f64 = (2.0 - 0.49) * (1.5 - 0.09);
        let cross = (trace + 2.0 * determinant.sqrt()).sqrt();
        assert!((distance(&a, &b) - (3.0 + 3.5 - 2.0 * cross)).abs() < 1e-9);
    }

    #[test]
    fn mean_and_covariance_by_hand() {
        let vectors: [&[f64]; 3] = [&[1.0, 2.0], &[3.0, 2.0], &[2.0, 5.0]];
        let gaussian = Gaussian::of(vectors.into_iter());
        assert_eq!(gaussian.mean, [2.0, 3.0]);
        for (x, y) in gaussian.covariance.iter().zip([1.0, 0.0, 0.0, 3.0]) {
            assert!((x - y).abs() < 1e-12);
        }
        assert_eq!(Gaussian::of([].into_iter()).mean, [0.0; 0]);
    }

    /// More samples of one distribution come nearer to each other; moved ones do not.
    #[test]
    fn samples_of_one_distribution_are_near() {
        let sample = |n: usize, stream| noise(3 * n, stream);
        let of = |values: &[f64]| Gaussian::of(values.chunks_exact(3));
        let few = distance(&of(&sample(50, 1)), &of(&sample(50, 2)));
        let many = distance(&of(&sample(5000, 3)), &of(&sample(5000, 4)));
        let moved: Vec<f64> = sample(5000, 4).iter().map(|x| x + 0.5).collect();
        assert!(many < 0.3 * few, "{many} {few}");
        assert!((distance(&of(&sample(5000, 3)), &of(&moved)) - 0.75).abs() < 0.1);
    }
}
