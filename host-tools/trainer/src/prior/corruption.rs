//! What planners are trained to undo: tokens move to codes that are near in the codebook (TMD, EQUATIONS section 4), or are masked
//! (MoMask 3.3).

use motionette_host::checkpoint::prior::Corruption;

use super::config::Config;
use crate::random::Random;

/// Distances of all codes from one another, and how tokens are corrupted.
#[derive(Clone, Debug)]
pub struct Metric {
    /// `[V][V]`, `(2 - 2 cos)^2`.
    distances: Vec<f32>,
    codes: usize,
    corruption: Corruption,
    c: f32,
    a: f32,
}

/// Tokens of so many that are masked at time `t`: `cos(pi/2 t)` of them, to the nearest whole number, at least one.
pub fn masked(tokens: usize, t: f32) -> usize {
    let share = (std::f32::consts::FRAC_PI_2 * t).cos();
    ((share * tokens as f32).round_ties_even() as usize).max(1).min(tokens)
}

impl Metric {
    /// Of a codebook `[V][width]`; corrupts as `config` says.
    pub fn new(codebook: &[f32], width: usize, config: &Config) -> Self {
        let rows: Vec<&[f32]> = codebook.chunks_exact(width).collect();
        let dot = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
        let norms: Vec<f64> = rows.iter().map(|row| dot(row, row).sqrt().max(1e-12)).collect();
        let distance = |i: usize, j: usize| (2.0 - 2.0 * dot(rows[i], rows[j]) / (norms[i] * norms[j])).powi(2) as f32;
        let codes = rows.len();
        let distances = (0..codes * codes).map(|k| distance(k / codes, k % codes)).collect();
        let Config { corruption, c, a, .. } = *config;
        Self { distances, codes, corruption, c, a }
    }

    /// Number of codes.
    pub fn codes(&self) -> usize {
        self.codes
    }

    /// Distance of two codes.
    pub fn distance(&self, i: u16, j: u16) -> f32 {
        self.distances[usize::from(i) * self.codes + usize::from(j)]
    }

    /// What becomes of tokens at time `t`, of those that are not `fixed`; V is a masked one.
    pub fn corrupt(&self, clean: &[u16], fixed: &[bool], t: f32, random: &mut Random) -> Vec<u16> {
        let mut z = clean.to_vec();
        let mut free: Vec<usize> = (0..z.len()).filter(|i| !fixed[*i]).collect();
        match self.corruption {
            Corruption::Near => free.iter().for_each(|i| z[*i] = self.near(z[*i], t, random)),
            Corruption::Masks => {
                for drawn in 0..masked(free.len(), t) {
                    let of = drawn + random.below(free.len() - drawn);
                    free.swap(drawn, of);
                    z[free[drawn]] = self.codes as u16;
                }
            }
        }
        z
    }

    /// A token of `q_t(. | clean)`.
    fn near(&self, clean: u16, t: f32, random: &mut Random) -> u16 {
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

    /// As many masks as the schedule says, at least one, none where tokens are fixed, every place as often as any other; of all times together
    /// `2 / pi`.
    #[test]
    fn masks_follow_the_schedule() {
        let config = Config { corruption: Corruption::Masks, ..Config::preset("tiny").unwrap() };
        let metric = Metric::new(&[1.0, 0.0, 0.8, 0.6, 0.0, 1.0], 2, &config);
        let (clean, mut random) = ([2u16, 0, 1, 1, 0, 2, 2, 1, 0, 0, 1, 2], Random::new(5, 1));
        let (mut all, mut places) = (0.0, [0.0f64; 12]);
        let draws = 20_000;
        for _ in 0..draws {
            let t = random.unit() as f32;
            let fixed: Vec<bool> = clean.iter().map(|_| random.unit() < 0.3).collect();
            let free = fixed.iter().filter(|f| !**f).count();
            let z = metric.corrupt(&clean, &fixed, t, &mut random);
            let is_masked: Vec<bool> = z.iter().map(|z| *z == 3).collect();
            let count = is_masked.iter().filter(|m| **m).count() as f64;
            let wanted = (std::f64::consts::FRAC_PI_2 * f64::from(t)).cos() * free as f64;
            assert!((count - wanted.max(1.0)).abs() <= 0.5 + 1e-4 || free == 0, "{count} of {free} at {t}");
            for i in 0..12 {
                assert!(is_masked[i] && !fixed[i] || z[i] == clean[i]);
                places[i] += if is_masked[i] { count.recip() } else { 0.0 };
            }
            all += wanted / free.max(1) as f64;
        }
        let share = all / f64::from(draws);
        assert!((share - std::f64::consts::FRAC_2_PI).abs() < 0.01, "{share}");
        let each = f64::from(draws) / 12.0;
        assert!(places.iter().all(|n| (n / each - 1.0).abs() < 0.1), "{places:?}");
        assert_eq!([masked(49, 0.0), masked(49, 1.0), masked(1, 0.99), masked(0, 0.5)], [49, 1, 1, 0]);
    }

    /// Frequencies against the formula, at three times, chi-square.
    #[test]
    fn corruption_follows_its_distribution() {
        let codebook = [1.0, 0.0, 0.8, 0.6, 0.0, 1.0, -1.0, 0.2, 0.3, -0.9];
        let metric = Metric::new(&codebook, 2, &Config::preset("tiny").unwrap());
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
                counts[usize::from(metric.corrupt(&[1], &[false], t, &mut random)[0])] += 1.0;
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
