//! The corruption that TMD is trained to undo (EQUATIONS section 4): tokens move to codes that are near in the codebook.

use crate::random::Random;

/// Distances of all codes from one another.
#[derive(Clone, Debug)]
pub struct Metric {
    /// `[V][V]`, `(2 - 2 cos)^2`.
    distances: Vec<f32>,
    codes: usize,
    c: f32,
    a: f32,
}

impl Metric {
    /// Of a codebook `[V][width]`.
    pub fn new(codebook: &[f32], width: usize, c: f32, a: f32) -> Self {
        let rows: Vec<&[f32]> = codebook.chunks_exact(width).collect();
        let dot = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
        let norms: Vec<f64> = rows.iter().map(|row| dot(row, row).sqrt().max(1e-12)).collect();
        let distance = |i: usize, j: usize| (2.0 - 2.0 * dot(rows[i], rows[j]) / (norms[i] * norms[j])).powi(2) as f32;
        let codes = rows.len();
        Self { distances: (0..codes * codes).map(|k| distance(k / codes, k % codes)).collect(), codes, c, a }
    }

    /// Number of codes.
    pub fn codes(&self) -> usize {
        self.codes
    }

    /// Distance of two codes.
    pub fn distance(&self, i: u16, j: u16) -> f32 {
        self.distances[usize::from(i) * self.codes + usize::from(j)]
    }

    /// A token of `q_t(. | clean)`.
    pub fn corrupt(&self, clean: u16, t: f32, random: &mut Random) -> u16 {
        let beta = self.c * (t / (1.0 - t).max(1e-6)).powf(self.a);
        let row = &self.distances[usize::from(clean) * self.codes..][..self.codes];
        let weights = || row.iter().map(|d| f64::from((-beta * d).exp()));
        let mut left = random.unit() * weights().sum::<f64>();
        for (i, weight) in weights().enumerate() {
            left -= weight;
            if left < 0.0 {
                return i as u16;
            }
        }
        clean
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frequencies against the formula, at three times, chi-square.
    #[test]
    fn corruption_follows_its_distribution() {
        let codebook = [1.0, 0.0, 0.8, 0.6, 0.0, 1.0, -1.0, 0.2, 0.3, -0.9];
        let metric = Metric::new(&codebook, 2, 3.0, 0.9);
        for t in [0.1f32, 0.4, 0.7] {
            let beta = 3.0 * f64::from(t / (1.0 - t)).powf(0.9);
            let weights: Vec<f64> = (0..5)
                .map(|i| {
                    let (x, y) = (&codebook[2 * i..2 * i + 2], &codebook[2..4]);
                    let cos = (x[0] * y[0] + x[1] * y[1]) / (x[0].hypot(x[1]) * y[0].hypot(y[1]));
                    (-beta * (2.0 - 2.0 * f64::from(cos)).powi(2)).exp()
                })
                .collect();
            let total: f64 = weights.iter().sum();
            let (mut counts, draws) = ([0.0f64; 5], 40_000);
            let mut random = Random::new(3, u64::from(t.to_bits()));
            for _ in 0..draws {
                counts[usize::from(metric.corrupt(1, t, &mut random))] += 1.0;
            }
            let chi: f64 = weights
                .iter()
                .zip(counts)
                .map(|(w, n)| {
                    let expected = w / total * f64::from(draws);
                    if expected < 1e-3 { 0.0 } else { (n - expected).powi(2) / expected }
                })
                .sum();
            assert!(chi < 23.5, "chi-square {chi} at t = {t} with 4 degrees of freedom");
        }
    }
}
