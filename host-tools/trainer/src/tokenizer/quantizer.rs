//! The codebook: nearest rows, running means instead of gradients, and a second life for codes nobody uses.
//!
//! Every row is the mean of the latents it was chosen for, with sums and counts that decay by `decay` a batch (van den Oord et al.
//! 2017, appendix A.1). A row whose running count falls below a threshold is moved to a random latent of the batch.

use crate::random::Random;

/// Running state of one codebook.
#[derive(Clone, Debug, PartialEq)]
pub struct Codebook {
    /// `[codes][dim]`: the rows.
    pub rows: Vec<f32>,
    /// `[codes]`: running number of latents a batch.
    pub counts: Vec<f32>,
    /// `[codes][dim]`: running sum of latents a batch.
    pub sums: Vec<f32>,
    dim: usize,
}

/// Running count of a code that has just been moved: enough for it to survive until it had a fair chance of being chosen.
const COUNT_AFTER_RESET: f32 = 1.0;

/// Lloyd iterations of the initial codebook.
const KMEANS_ITERATIONS: usize = 12;

impl Codebook {
    /// From stored parts.
    ///
    /// # Panics
    /// When the lengths do not belong together.
    pub fn from_parts(rows: Vec<f32>, counts: Vec<f32>, sums: Vec<f32>, dim: usize) -> Self {
        assert_eq!(rows.len(), counts.len() * dim, "rows and counts differ in number of codes");
        assert_eq!(rows.len(), sums.len(), "rows and sums differ in length");
        Self { rows, counts, sums, dim }
    }

    /// k-means over `latents` `[N][dim]`, started from distinct random latents (repeated when there are fewer than `codes`).
    pub fn from_latents(latents: &[f32], codes: usize, dim: usize, random: &mut Random) -> Self {
        let n = latents.len() / dim;
        let mut order: Vec<usize> = (0..n).collect();
        for i in 0..codes.min(n) {
            order.swap(i, i + random.below(n - i));
        }
        let rows = (0..codes).flat_map(|k| latents[order[k % n] * dim..][..dim].iter().copied()).collect();
        let mut book = Self { rows, counts: vec![0.0; codes], sums: vec![0.0; codes * dim], dim };
        for _ in 0..KMEANS_ITERATIONS {
            let ids = book.nearest(latents);
            let (counts, sums) = book.totals(latents, &ids);
            for k in 0..codes {
                if counts[k] > 0.0 {
                    for c in 0..dim {
                        book.rows[k * dim + c] = sums[k * dim + c] / counts[k];
                    }
                } else {
                    let pick = random.below(n);
                    book.rows[k * dim..][..dim].copy_from_slice(&latents[pick * dim..][..dim]);
                }
            }
        }
        book.restart_counts();
        book
    }

    /// Number of rows.
    pub fn codes(&self) -> usize {
        self.counts.len()
    }

    /// Width of a row.
    pub fn dim(&self) -> usize {
        self.dim
    }

    fn restart_counts(&mut self) {
        self.counts.fill(COUNT_AFTER_RESET);
        self.sums.copy_from_slice(&self.rows);
    }

    /// Index of the nearest row of every latent, by `|c|^2 - 2 z.c`; the first wins a tie.
    pub fn nearest(&self, latents: &[f32]) -> Vec<u16> {
        nearest(&self.rows, self.dim, latents)
    }

    fn totals(&self, latents: &[f32], ids: &[u16]) -> (Vec<f32>, Vec<f32>) {
        let mut counts = vec![0.0; self.codes()];
        let mut sums = vec![0.0; self.rows.len()];
        for (latent, id) in latents.chunks_exact(self.dim).zip(ids) {
            let id = usize::from(*id);
            counts[id] += 1.0;
            for (sum, z) in sums[id * self.dim..][..self.dim].iter_mut().zip(latent) {
                *sum += z;
            }
        }
        (counts, sums)
    }

    /// Moves the rows towards the latents they were chosen for; returns how many dead codes were moved to a random latent.
    /// With `dead_below` = 0 none is.
    pub fn update(&mut self, latents: &[f32], ids: &[u16], decay: f32, dead_below: f32, random: &mut Random) -> usize {
        let (counts, sums) = self.totals(latents, ids);
        let n = ids.len();
        let dim = self.dim;
        let mut moved = 0;
        for k in 0..self.codes() {
            self.counts[k] = decay * self.counts[k] + (1.0 - decay) * counts[k];
            let own = k * dim..(k + 1) * dim;
            if self.counts[k] < dead_below && n > 0 {
                let pick = random.below(n);
                self.rows[own.clone()].copy_from_slice(&latents[pick * dim..][..dim]);
                self.counts[k] = COUNT_AFTER_RESET;
                self.sums[own.clone()].copy_from_slice(&latents[pick * dim..][..dim]);
                moved += 1;
                continue;
            }
            for i in own {
                self.sums[i] = decay * self.sums[i] + (1.0 - decay) * sums[i];
                // A code that is never chosen fades in both, so its row stays.
                if self.counts[k] > 1e-6 {
                    self.rows[i] = self.sums[i] / self.counts[k];
                }
            }
        }
        moved
    }
}

/// Index of the nearest of `rows` `[codes][dim]` for every latent `[N][dim]`.
pub fn nearest(rows: &[f32], dim: usize, latents: &[f32]) -> Vec<u16> {
    let codes = rows.len() / dim;
    // Channels first, so that the inner loop runs over codes and vectorises.
    let mut turned = vec![0.0f32; rows.len()];
    let mut norms = vec![0.0f32; codes];
    for k in 0..codes {
        for c in 0..dim {
            let value = rows[k * dim + c];
            turned[c * codes + k] = -2.0 * value;
            norms[k] += value * value;
        }
    }
    let mut distances = vec![0.0f32; codes];
    let one = |latent: &[f32]| {
        distances.copy_from_slice(&norms);
        for (z, row) in latent.iter().zip(turned.chunks_exact(codes)) {
            for (distance, value) in distances.iter_mut().zip(row) {
                *distance += z * value;
            }
        }
        let mut best = 0;
        for (k, distance) in distances.iter().enumerate() {
            if *distance < distances[best] {
                best = k;
            }
        }
        best as u16
    };
    latents.chunks_exact(dim).map(one).collect()
}

/// How evenly codes are used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Usage {
    /// Codes that occur at all.
    pub used: usize,
    /// Exponential of the entropy of the code frequencies.
    pub perplexity: f64,
}

impl Usage {
    /// From the number of times each code occurs.
    pub fn of(counts: &[u64]) -> Self {
        let total = counts.iter().sum::<u64>().max(1) as f64;
        let present = counts.iter().filter(|n| **n > 0);
        let entropy: f64 = present.clone().map(|n| -(*n as f64 / total) * (*n as f64 / total).ln()).sum();
        Self { used: present.count(), perplexity: entropy.exp() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(n: usize, stream: u64) -> Vec<f32> {
        let mut random = Random::new(3, stream);
        (0..n).map(|_| random.symmetric() as f32).collect()
    }

    fn book(codes: usize, dim: usize) -> Codebook {
        let rows = noise(codes * dim, 1);
        Codebook::from_parts(rows.clone(), vec![1.0; codes], rows, dim)
    }

    #[test]
    fn nearest_agrees_with_brute_force() {
        let book = book(17, 5);
        let latents = noise(5 * 200, 2);
        for (latent, id) in latents.chunks(5).zip(book.nearest(&latents)) {
            let distance =
                |k: usize| -> f64 { (0..5).map(|c| f64::from(latent[c] - book.rows[k * 5 + c]).powi(2)).sum() };
            let best = (0..17).map(distance).fold(f64::INFINITY, f64::min);
            assert!(distance(usize::from(id)) <= best + 1e-6);
        }
    }

    /// The running mean against a second computation: after many updates with the same latents a row is the mean of its members.
    #[test]
    fn rows_converge_to_the_mean_of_their_latents() {
        let mut book = book(4, 3);
        let latents = noise(3 * 64, 4);
        let ids: Vec<u16> = (0..64).map(|i| i % 4).collect();
        let mut random = Random::new(0, 0);
        for _ in 0..400 {
            assert_eq!(book.update(&latents, &ids, 0.9, 0.0, &mut random), 0);
        }
        for k in 0..4 {
            for c in 0..3 {
                let mean = (0..64).filter(|i| i % 4 == k).map(|i| latents[i * 3 + c]).sum::<f32>() / 16.0;
                assert!((book.rows[k * 3 + c] - mean).abs() < 1e-4, "code {k}");
            }
            assert!((book.counts[k] - 16.0).abs() < 1e-3);
        }
    }

    /// One update, written out.
    #[test]
    fn one_update_is_the_decayed_mean() {
        let mut book = Codebook::from_parts(vec![1.0, 2.0], vec![3.0, 1.0], vec![3.0, 2.0], 1);
        book.update(&[5.0, 7.0], &[0, 0], 0.75, 0.0, &mut Random::new(0, 0));
        assert_eq!(book.counts, [0.75 * 3.0 + 0.25 * 2.0, 0.75]);
        assert_eq!(book.rows[0], (0.75 * 3.0 + 0.25 * 12.0) / 2.75);
        assert_eq!(book.rows[1], 2.0, "a code that was not chosen stays");
    }

    #[test]
    fn a_dead_code_moves_to_a_latent_and_only_then() {
        let mut book = book(3, 2);
        let latents = vec![9.0, 8.0, 9.0, 8.0];
        let mut moved_at = Vec::new();
        for step in 0..60 {
            if book.update(&latents, &[0, 0], 0.9, 0.05, &mut Random::new(5, step)) > 0 {
                moved_at.push(step);
            }
        }
        // 0.9^n < 0.05 for the first time at n = 29, then again 29 updates later.
        assert_eq!(moved_at, [28, 57]);
        assert_eq!(book.rows[2..], [9.0, 8.0, 9.0, 8.0]);
    }

    #[test]
    fn kmeans_finds_separate_clusters() {
        let centres = [[0.0f32, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]];
        let jitter = noise(2 * 400, 6);
        let latents: Vec<f32> =
            (0..400).flat_map(|i| [centres[i % 4][0] + jitter[2 * i], centres[i % 4][1] + jitter[2 * i + 1]]).collect();
        let book = Codebook::from_latents(&latents, 8, 2, &mut Random::new(1, 1));
        for (latent, id) in latents.chunks(2).zip(book.nearest(&latents)) {
            let row = &book.rows[usize::from(id) * 2..][..2];
            assert!((latent[0] - row[0]).hypot(latent[1] - row[1]) < 3.0);
        }
    }

    #[test]
    fn usage_of_known_frequencies() {
        let usage = Usage::of(&[4, 4, 0, 4, 4]);
        assert_eq!(usage.used, 4);
        assert!((usage.perplexity - 4.0).abs() < 1e-12);
        assert_eq!(Usage::of(&[0, 0]).used, 0);
    }
}
