//! Transition masked diffusion (EQUATIONS section 4; AnchorRoute, equations 18 and 21 to 23).
//!
//! Corruption `q_t(i | x) = softmax_i(-beta(t) dist(i, x))`, `dist(i, x) = (2 - 2 cos(e_i, e_x))^2`,
//! `beta(t) = c (t / (1 - t))^a`. A step from `t` to `t + h` moves a token `x_t` towards the proposal `x^`:
//! `w_i = q_{t+h/2}(i | x^) [dist(x_t, x^) - dist(i, x^)]_+`, `lambda = (beta(t+h) - beta(t)) sum_i w_i`; with
//! probability `1 - exp(-lambda)` the new token is drawn from `w`.
//!
//! The metric is computed from unit code vectors, not tabulated: a table of 512 x 512 distances would take half a MiB of
//! flash, a row of distances costs `V du` multiply-accumulates a position and step.

use super::sampling::draw;
use crate::decoding::codebook::Codebooks;
use crate::nn::softmax;

/// The sampler's constants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tmd {
    /// Factor of `beta`.
    pub c: f32,
    /// Exponent of `beta`.
    pub a: f32,
}

/// One step's share of `beta`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// `beta(t + h/2)`
    pub middle: f32,
    /// `beta(t + h) - beta(t)`
    pub increase: f32,
}

impl Tmd {
    /// `beta(t)` for `0 <= t < 1`.
    #[must_use]
    pub fn beta(&self, t: f32) -> f32 {
        if t > 0.0 && t < 1.0 { self.c * libm::powf(t / (1.0 - t), self.a) } else { 0.0 }
    }

    /// The step from time `from` to `to < 1`.
    #[must_use]
    pub fn step(&self, from: f32, to: f32) -> Step {
        Step { middle: self.beta(0.5 * (from + to)), increase: self.beta(to) - self.beta(from) }
    }
}

/// Code vectors of length 1, `[V][du]`: what distances are measured with.
#[derive(Debug)]
pub struct Metric<'w> {
    units: &'w mut [f32],
    width: usize,
}

impl<'w> Metric<'w> {
    /// Numbers that [`Metric::new`] needs.
    #[must_use]
    pub const fn len(codebooks: &Codebooks<'_>) -> usize {
        codebooks.codes() * codebooks.width()
    }

    /// Normalises the first codebook into `units`; a code of zeros stays zeros.
    #[must_use]
    pub fn new(codebooks: &Codebooks<'_>, units: &'w mut [f32]) -> Self {
        let width = codebooks.width().max(1);
        for (code, unit) in units.chunks_exact_mut(width).enumerate() {
            codebooks.code(code, unit);
            let mut squares = 0.0;
            for v in unit.iter() {
                squares += *v * *v;
            }
            let factor = if squares > 0.0 { 1.0 / libm::sqrtf(squares) } else { 0.0 };
            for v in unit {
                *v *= factor;
            }
        }
        Metric { units, width }
    }

    /// `dist(i, x)` for all `i`, into `out [V]`; 0 for `x` itself.
    #[inline(never)]
    pub fn distances(&self, x: u16, out: &mut [f32]) {
        let x = usize::from(x);
        let of = self.units.get(x * self.width..(x + 1) * self.width).unwrap_or(&[]);
        #[cfg(feature = "count")]
        crate::kernels::count::add(self.units.len());
        for (i, (unit, out)) in self.units.chunks_exact(self.width.max(1)).zip(out).enumerate() {
            let mut cosine = 0.0;
            for (a, b) in unit.iter().zip(of) {
                cosine += *a * *b;
            }
            let apart = 2.0 - 2.0 * cosine;
            *out = if i == x { 0.0 } else { apart * apart };
        }
    }

    /// The token that `present` becomes in a step towards `proposal`: itself, unless `update` falls below the
    /// probability of a change; then the one that `choice` draws. `distance` and `weights` are scratch `[V]`.
    #[must_use]
    pub fn advance(
        &self,
        present: u16,
        proposal: u16,
        step: &Step,
        (update, choice): (f32, f32),
        distance: &mut [f32],
        weights: &mut [f32],
    ) -> u16 {
        if present == proposal {
            return present;
        }
        self.distances(proposal, distance);
        let here = distance.get(usize::from(present)).copied().unwrap_or(0.0);
        for (w, d) in weights.iter_mut().zip(distance.iter()) {
            *w = -step.middle * *d;
        }
        let total = softmax::exponentials(weights);
        let mut sum = 0.0;
        for (w, d) in weights.iter_mut().zip(distance.iter()) {
            let closer = here - *d;
            *w *= if closer > 0.0 { closer } else { 0.0 };
            sum += *w;
        }
        let rate = step.increase * (sum / total);
        if update < 1.0 - libm::expf(-rate) {
            u16::try_from(draw(weights, sum, choice)).unwrap_or(present)
        } else {
            present
        }
    }
}
