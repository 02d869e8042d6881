//! Transition masked diffusion on the codebook (EQUATIONS section 4): corruption, and sampling from proposals.
//!
//! `dist(i, x) = (2 - 2 cos(e_i, e_x))^2`, `beta(t) = c (t / (1 - t))^a`, `q_t(i | x) = softmax_i(-beta(t) dist(i, x))`.
//!
//! Sampling draws from one [`Stream`] in a fixed order, so that whoever draws in the same order stays in step: first a token a
//! position, `below(V)`. Then in every step, position by position, the draws of the proposal, one number for "update?" and one for the
//! new token, whether they are needed or not.

use motionette::numerics::hash::Stream;

use super::real::Real;
use super::transformer::{first_largest, softmax};

/// When the steps of sampling happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Schedule {
    /// `t_k = k / S`.
    #[default]
    Uniform,
    /// `t_k = 1 - cos(pi / 2 k / S)`: short steps first.
    Cosine,
}

/// How a proposal is made of logits.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Sampling {
    /// The largest logit, the first of equals. Draws nothing.
    #[default]
    Greedy,
    /// From the softmax. Draws one number.
    Sample {
        /// Divides the logits, positive.
        temperature: f32,
        /// Only so many of the most probable codes (and those as probable as the last); 0 = all.
        top_k: u16,
        /// Then only the most probable codes whose shares sum to this (and those as probable as the last); 1 = all.
        top_p: f32,
    },
    /// The largest `logit + temperature g`, `g = -ln(-ln u)`. Draws V numbers.
    Gumbel {
        /// Multiplies the noise.
        temperature: f32,
    },
}

/// How a motion is sampled.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Of the random numbers.
    pub seed: u64,
    /// Steps S, at least 1.
    pub steps: usize,
    /// When they happen.
    pub schedule: Schedule,
    /// How proposals are made.
    pub sampling: Sampling,
    /// Positions whose token is given; it never changes.
    pub fixed: Vec<(usize, u16)>,
}

impl Default for Settings {
    fn default() -> Self {
        let sampling = Sampling::Sample { temperature: 1.0, top_k: 0, top_p: 1.0 };
        Self { seed: 0, steps: 5, schedule: Schedule::Uniform, sampling, fixed: Vec::new() }
    }
}

/// The process on one codebook.
#[derive(Debug, Clone)]
pub struct Tmd<T> {
    /// Codes V.
    pub codes: usize,
    /// `[V][V]`, symmetric.
    distances: Vec<T>,
    c: f64,
    a: f64,
}

impl<T: Real> Tmd<T> {
    /// On a codebook `[V][width]`.
    #[must_use]
    pub fn new(codebook: &[f32], width: usize, c: f64, a: f64) -> Self {
        let unit: Vec<f64> = codebook
            .chunks_exact(width)
            .flat_map(|code| {
                let length = code.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt();
                // A code without a direction is at right angles to all others.
                code.iter().map(move |&v| if length > 0.0 { f64::from(v) / length } else { 0.0 })
            })
            .collect();
        let codes = codebook.len() / width;
        let row = |i: usize| &unit[i * width..][..width];
        let distance = |i: usize, j: usize| {
            if i == j {
                return 0.0;
            }
            let cosine: f64 = row(i).iter().zip(row(j)).map(|(a, b)| a * b).sum();
            let d = (2.0 - 2.0 * cosine).max(0.0);
            d * d
        };
        let distances = (0..codes * codes).map(|k| T::from_f64(distance(k / codes, k % codes))).collect();
        Self { codes, distances, c, a }
    }

    /// `dist(i, x)` for all i, `[V]`.
    ///
    /// # Panics
    /// When `x` is outside the codebook.
    #[must_use]
    pub fn distances(&self, x: u16) -> &[T] {
        &self.distances[usize::from(x) * self.codes..][..self.codes]
    }

    /// `beta(t)` for `t` in `0..1`.
    #[must_use]
    pub fn beta(&self, t: f64) -> f64 {
        if t > 0.0 { self.c * (t / (1.0 - t)).powf(self.a) } else { 0.0 }
    }

    /// `q_t(. | x)`, `[V]`.
    #[must_use]
    pub fn marginal(&self, x: u16, t: f64) -> Vec<T> {
        let beta = T::from_f64(self.beta(t));
        let mut q: Vec<T> = self.distances(x).iter().map(|&d| -beta * d).collect();
        softmax(&mut q);
        q
    }

    /// `z_t` of clean tokens: every position drawn from `q_t` with one number.
    #[must_use]
    pub fn corrupt(&self, tokens: &[u16], t: f64, stream: &mut Stream) -> Vec<u16> {
        tokens.iter().map(|&x| choose(&self.marginal(x, t), stream.unit()).map_or(x, |i| i as u16)).collect()
    }

    /// Times of the steps and the end, `[S + 1]`: singles, so that which row of the table of times a step takes does not depend on the
    /// precision of everything else.
    #[must_use]
    pub fn times(schedule: Schedule, steps: usize) -> Vec<f64> {
        let time = |k: usize| {
            let share = k as f32 / steps as f32;
            match schedule {
                Schedule::Uniform => share,
                Schedule::Cosine if k == steps => 1.0,
                Schedule::Cosine => 1.0 - f64::from(core::f32::consts::FRAC_PI_2 * share).cos() as f32,
            }
        };
        (0..=steps).map(|k| f64::from(time(k))).collect()
    }

    /// Samples `length` tokens. `logits` gives `[L][V]` for the present tokens and the time. Returns the tokens after every step; the
    /// last are the result.
    pub fn sample(
        &self,
        length: usize,
        settings: &Settings,
        mut logits: impl FnMut(&[u16], f64) -> Vec<T>,
    ) -> Vec<Vec<u16>> {
        let mut stream = Stream::new(settings.seed);
        let mut z: Vec<u16> = (0..length).map(|_| stream.below(self.codes as u32) as u16).collect();
        let mut fixed = vec![false; length];
        for &(position, token) in &settings.fixed {
            (z[position], fixed[position]) = (token, true);
        }
        let times = Self::times(settings.schedule, settings.steps);
        let mut trace = Vec::with_capacity(settings.steps);
        for (k, span) in times.windows(2).enumerate() {
            let logits = logits(&z, span[0]);
            for (position, logits) in logits.chunks_exact(self.codes).enumerate() {
                let proposal = propose(logits, settings.sampling, &mut stream);
                let (update, which) = (stream.unit(), stream.unit());
                if fixed[position] {
                    continue;
                }
                z[position] = if k + 1 == settings.steps {
                    proposal
                } else {
                    self.jump(z[position], proposal, span[0], span[1], update, which)
                };
            }
            trace.push(z.clone());
        }
        trace
    }

    /// One position over one step: the rate towards codes nearer to the proposal, integrated over the step.
    fn jump(&self, x: u16, proposal: u16, from: f64, to: f64, update: f32, which: f32) -> u16 {
        let distances = self.distances(proposal);
        let here = distances[usize::from(x)];
        let middle = self.marginal(proposal, 0.5 * (from + to));
        let rates: Vec<T> = middle.iter().zip(distances).map(|(&q, &d)| q * (here - d).relu()).collect();
        let total = rates.iter().fold(T::ZERO, |s, &r| s + r);
        let lambda = T::from_f64(self.beta(to) - self.beta(from)) * total;
        if T::from_f32(update) < T::ONE - (-lambda).exp() { choose(&rates, which).map_or(x, |i| i as u16) } else { x }
    }
}

/// The first code at which the running sum passes `u` times the whole; `None` when all weights are zero.
fn choose<T: Real>(weights: &[T], u: f32) -> Option<usize> {
    let total = weights.iter().fold(T::ZERO, |s, &w| s + w);
    let aim = T::from_f32(u) * total;
    let mut sum = T::ZERO;
    let found = weights.iter().position(|&w| {
        sum += w;
        sum > aim
    });
    // Rounding may leave the last of the running sums a little short.
    found.or_else(|| weights.iter().rposition(|&w| w > T::ZERO))
}

/// A clean token from logits.
pub(super) fn propose<T: Real>(logits: &[T], sampling: Sampling, stream: &mut Stream) -> u16 {
    match sampling {
        Sampling::Greedy => first_largest(logits) as u16,
        Sampling::Gumbel { temperature } => {
            let noisy: Vec<T> = logits
                .iter()
                .map(|&l| l - T::from_f32(temperature) * (-T::from_f32(stream.unit()).ln()).ln())
                .collect();
            first_largest(&noisy) as u16
        }
        Sampling::Sample { temperature, top_k, top_p } => {
            let mut p: Vec<T> = logits.iter().map(|&l| l / T::from_f32(temperature)).collect();
            softmax(&mut p);
            if top_k > 0 {
                keep(&mut p, |ranked| usize::from(top_k).min(ranked.len()));
            }
            if top_p < 1.0 {
                let aim = T::from_f32(top_p);
                keep(&mut p, |ranked| {
                    let mut sum = T::ZERO;
                    let last = ranked.iter().position(|&p| {
                        sum += p;
                        sum >= aim
                    });
                    last.map_or(ranked.len(), |last| last + 1)
                });
            }
            choose(&p, stream.unit()).unwrap_or(0) as u16
        }
    }
}

/// Sets to zero what is less probable than the last of so many of the ranked, and makes the rest sum to one.
fn keep<T: Real>(p: &mut [T], count: impl FnOnce(&[T]) -> usize) {
    let mut ranked = p.to_vec();
    ranked.sort_by(|a, b| b.partial_cmp(a).unwrap_or(core::cmp::Ordering::Equal));
    let least = ranked[count(&ranked).max(1) - 1];
    p.iter_mut().filter(|p| **p < least).for_each(|p| *p = T::ZERO);
    let sum = p.iter().fold(T::ZERO, |s, &p| s + p);
    p.iter_mut().for_each(|p| *p = *p / sum);
}
