//! From real weights to integers: one scale a row, values in `-levels..=levels`.
//!
//! Three ways, each measured against the first: to nearest; to nearest with the scale that loses least; and with feedback, where every
//! rounding error is passed on to the weights that are not rounded yet so that the layer's *output* changes least (optimal brain
//! quantisation in the order of Frantar et al., GPTQ, arXiv:2210.17323). What a change costs at the output is a quadratic form:
//! `cost(e) = e^T H e` with `H` the covariance of the layer's input.

use nalgebra::{Cholesky, DMatrix};

/// How weights are rounded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rounding {
    /// Nearest, scale = largest weight.
    Nearest,
    /// Nearest, the scale of least cost.
    Clipped,
    /// With feedback, the scale of least cost.
    Feedback,
}

/// Scales tried, as shares of the largest weight.
const CLIPS: [f64; 14] = [1.0, 0.97, 0.94, 0.91, 0.88, 0.85, 0.82, 0.79, 0.76, 0.73, 0.7, 0.66, 0.62, 0.58];

/// A rounded row: weight = integer * scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Integers in `-levels..=levels`.
    pub values: Vec<i32>,
    /// Positive, exactly representable in f32.
    pub scale: f64,
}

/// What rounding knows about a layer's input.
#[derive(Debug, Clone)]
pub struct Metric {
    n: usize,
    /// `[n][n]`
    cost: Vec<f64>,
    /// Weights in the order of rounding: largest variance first.
    order: Vec<usize>,
    /// Upper factor of the inverse in that order, rows `[n][n]`.
    feedback: Vec<f64>,
}

impl Metric {
    /// From a covariance `[n][n]` that is positive definite (add a ridge first); `None` when it is not.
    #[must_use]
    pub fn new(cost: &[f64], n: usize) -> Option<Self> {
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&a, &b| cost[b * n + b].total_cmp(&cost[a * n + a]).then(a.cmp(&b)));
        let permuted = DMatrix::from_fn(n, n, |i, j| cost[order[i] * n + order[j]]);
        let inverse = Cholesky::new(permuted)?.inverse();
        // H^-1 = U^T U with U upper: the transposed lower factor, whose columns are the rows of U.
        let feedback = Cholesky::new(inverse)?.unpack().as_slice().to_vec();
        Some(Self { n, cost: cost.to_vec(), order, feedback })
    }

    /// `e^T H e`.
    #[must_use]
    pub fn cost(&self, e: &[f64]) -> f64 {
        let row = |(row, &a): (&[f64], &f64)| a * row.iter().zip(e).map(|(h, b)| h * b).sum::<f64>();
        self.cost.chunks_exact(self.n).zip(e).map(row).sum()
    }

    /// Rounds with feedback at a given scale.
    fn feed_back(&self, weights: &[f64], scale: f64, levels: i32) -> Vec<i32> {
        let n = self.n;
        let mut left: Vec<f64> = self.order.iter().map(|&i| weights[i]).collect();
        let mut values = vec![0; n];
        for (i, &place) in self.order.iter().enumerate() {
            let v = nearest(left[i] / scale, levels);
            values[place] = v;
            let u = &self.feedback[i * n..(i + 1) * n];
            let error = (left[i] - f64::from(v) * scale) / u[i];
            for (w, u) in left[i + 1..].iter_mut().zip(&u[i + 1..]) {
                *w -= error * u;
            }
        }
        values
    }

    /// Moves single integers by one as long as that lowers the cost: descent over coordinates, at most `rounds` sweeps.
    fn polish(&self, weights: &[f64], row: &mut Row, levels: i32, rounds: usize) {
        let n = self.n;
        let error: Vec<f64> = weights.iter().zip(&row.values).map(|(w, &v)| f64::from(v) * row.scale - w).collect();
        let mut slope: Vec<f64> =
            self.cost.chunks_exact(n).map(|h| h.iter().zip(&error).map(|(h, e)| h * e).sum()).collect();
        for _ in 0..rounds {
            let mut moved = false;
            for i in 0..n {
                // cost(e + d) - cost(e) = 2 d slope + d^2 H_ii; best whole number of steps.
                let best = nearest(-slope[i] / (self.cost[i * n + i] * row.scale), levels * 2);
                let next = (row.values[i] + best).clamp(-levels, levels);
                let step = f64::from(next - row.values[i]) * row.scale;
                if step != 0.0 && 2.0 * step * slope[i] + step * step * self.cost[i * n + i] < 0.0 {
                    row.values[i] = next;
                    for (s, h) in slope.iter_mut().zip(&self.cost[i * n..(i + 1) * n]) {
                        *s += step * h;
                    }
                    moved = true;
                }
            }
            if !moved {
                break;
            }
        }
    }
}

/// Rounds one row of weights. Without a metric all weights count alike.
#[must_use]
pub fn round_row(weights: &[f64], levels: i32, rounding: Rounding, metric: Option<&Metric>) -> Row {
    let largest = weights.iter().fold(0.0_f64, |m, w| m.max(w.abs()));
    if largest == 0.0 {
        return Row { values: vec![0; weights.len()], scale: 1.0 };
    }
    let at = |clip: f64| -> Row {
        let scale = f32_not_below(largest * clip / f64::from(levels));
        let values = match (rounding, metric) {
            (Rounding::Feedback, Some(metric)) => metric.feed_back(weights, scale, levels),
            _ => weights.iter().map(|w| nearest(w / scale, levels)).collect(),
        };
        Row { values, scale }
    };
    if rounding == Rounding::Nearest {
        return at(1.0);
    }
    let cost = |row: &Row| -> f64 {
        let error: Vec<f64> = weights.iter().zip(&row.values).map(|(w, &v)| w - f64::from(v) * row.scale).collect();
        metric.map_or_else(|| error.iter().map(|e| e * e).sum(), |m| m.cost(&error))
    };
    let mut best = at(1.0);
    let mut least = cost(&best);
    for clip in &CLIPS[1..] {
        let row = at(*clip);
        let c = cost(&row);
        if c < least {
            (best, least) = (row, c);
        }
    }
    if let (Rounding::Feedback, Some(metric)) = (rounding, metric) {
        metric.polish(weights, &mut best, levels, 20);
    }
    best
}

/// Nearest integer, ties to even, within `-levels..=levels`.
fn nearest(v: f64, levels: i32) -> i32 {
    v.round_ties_even().clamp(-f64::from(levels), f64::from(levels)) as i32
}

/// The next f32 not below `v`, so that a clip of 1 never overflows; at least the smallest normal one.
fn f32_not_below(v: f64) -> f64 {
    let near = (v as f32).max(f32::MIN_POSITIVE);
    f64::from(if f64::from(near) < v { near.next_up() } else { near })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weights(n: usize, seed: u64) -> Vec<f64> {
        let mut s = seed;
        let mut next = || {
            s = s.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (s >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
        };
        (0..n).map(|_| next()).collect()
    }

    /// Covariance of strongly correlated inputs.
    fn correlated(n: usize) -> Vec<f64> {
        (0..n * n)
            .map(|k| 0.9_f64.powi((k / n).abs_diff(k % n) as i32) * (1.0 + (k / n + k % n) as f64 / n as f64))
            .collect()
    }

    #[test]
    fn round_trip_is_within_half_a_step() {
        for levels in [127, 127 * 256] {
            let w = weights(40, 3);
            let row = round_row(&w, levels, Rounding::Nearest, None);
            for (w, &v) in w.iter().zip(&row.values) {
                assert!(v.abs() <= levels);
                assert!((w - f64::from(v) * row.scale).abs() <= 0.5 * row.scale * (1.0 + 1e-12));
            }
            // Integers times a scale come back as they were.
            let whole: Vec<f64> = row.values.iter().map(|&v| f64::from(v) * 0.5).collect();
            let again =
                round_row(&whole, row.values.iter().map(|v| v.abs()).max().expect("a weight"), Rounding::Nearest, None);
            assert_eq!(again.values, row.values);
        }
    }

    #[test]
    fn zero_rows_and_tiny_rows_have_usable_scales() {
        for w in [vec![0.0; 5], vec![1e-42, -1e-43, 0.0]] {
            let row = round_row(&w, 127, Rounding::Clipped, None);
            assert!((row.scale as f32).is_normal() && row.values.iter().all(|v| v.abs() <= 127));
        }
    }

    #[test]
    fn each_refinement_costs_less_at_the_output() {
        let n = 24;
        let cost = correlated(n);
        let metric = Metric::new(&cost, n).expect("positive definite");
        let mut sums = [0.0; 3];
        for seed in 0..20 {
            let w = weights(n, seed);
            let price = |rounding| {
                let row = round_row(&w, 7, rounding, Some(&metric));
                let e: Vec<f64> = w.iter().zip(&row.values).map(|(w, &v)| w - f64::from(v) * row.scale).collect();
                metric.cost(&e)
            };
            let costs = [Rounding::Nearest, Rounding::Clipped, Rounding::Feedback].map(price);
            assert!(costs[1] <= costs[0], "seed {seed}: {costs:?}");
            sums.iter_mut().zip(costs).for_each(|(s, c)| *s += c);
        }
        assert!(sums[2] < 0.6 * sums[1] && sums[1] < 0.95 * sums[0], "{sums:?}");
    }
}
