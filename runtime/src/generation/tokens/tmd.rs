//! Transition masked diffusion (EQUATIONS section 4; AnchorRoute, equations 18 and 21 to 23).
//!
//! Corruption `q_t(i | x) = softmax_i(-beta(t) dist(i, x))`, `dist(i, x) = (2 - 2 cos(e_i, e_x))^2`,
//! `beta(t) = c (t / (1 - t))^a`. A step from `t` to `t + h` moves a token `x_t` towards the proposal `x^`:
//! `w_i = q_{t+h/2}(i | x^) [dist(x_t, x^) - dist(i, x^)]_+`, `lambda = (beta(t+h) - beta(t)) sum_i w_i`; with
//! probability `1 - exp(-lambda)` the new token is drawn from `w`.
//!
//! The metric is computed from unit code vectors, not tabulated: a table of 512 x 512 distances would take half a MiB of
//! flash, a row of distances costs `V du` multiply-accumulates a position and step.

use super::Planning;
use super::sampler::{Draw, Logits, TokenSampler};
use super::sampling::draw;
use crate::codec::codebook::Codebooks;
use crate::kernels::{self, wide};
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::softmax;
use crate::numerics::hash::Stream;

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
        if t > 0.0 && t < 1.0 { self.c * libm::expf(self.a * libm::logf(t / (1.0 - t))) } else { 0.0 }
    }

    /// The step from time `from` to `to < 1`.
    #[must_use]
    pub fn stride(&self, from: f32, to: f32) -> Step {
        Step { middle: self.beta(0.5 * (from + to)), increase: self.beta(to) - self.beta(from) }
    }
}

/// What a step works in.
#[derive(Debug)]
pub struct Work<'s> {
    /// `[V]`
    weights: &'s mut [f32],
    /// Of the metric, `[V][du]`.
    units: &'s mut [f32],
}

impl Tmd {
    /// Draws a proposal for every position and moves its token towards it: the whole way without a `step` and its metric.
    fn advance(
        metric: Option<(&Step, &Metric<'_>)>,
        logits: &mut Logits<'_, '_, '_>,
        weights: &mut [f32],
        draw: Draw<'_>,
    ) {
        let Draw { planning, random, tokens, proposals } = draw;
        logits.each(|i, logits| {
            invariant!(i < tokens.len() && i < proposals.len(), "row {i} of {} tokens", tokens.len());
            let (Some(token), Some(proposal)) = (tokens.get_mut(i), proposals.get_mut(i)) else { return };
            let proposed = planning.sampling.propose(logits, random);
            let draws = (random.unit(), random.unit());
            if planning.fixed_at(i).is_some() {
                *proposal = *token;
                return;
            }
            *proposal = proposed;
            *token = match metric {
                None => proposed,
                Some((step, metric)) => metric.advance(*token, proposed, step, draws, logits, weights),
            };
        });
    }
}

impl TokenSampler for Tmd {
    type Work<'s> = Work<'s>;

    fn layout<'s>(
        &self,
        arena: &mut Arena<'s>,
        _tokens: usize,
        codebooks: &Codebooks<'_>,
    ) -> Result<Work<'s>, ArenaTooSmall> {
        Ok(Work { weights: arena.take(codebooks.codes())?, units: arena.take(Metric::len(codebooks))? })
    }

    fn time(&self, planning: &Planning<'_>, step: u16) -> f32 {
        planning.schedule.time(step, planning.steps)
    }

    fn macs(&self, codebooks: &Codebooks<'_>) -> u64 {
        Metric::len(codebooks) as u64
    }

    /// Random tokens, given ones in their places.
    fn begin(&self, planning: &Planning<'_>, codes: usize, random: &mut Stream, tokens: &mut [u16]) {
        let codes = u32::try_from(codes).unwrap_or(0);
        for (i, token) in tokens.iter_mut().enumerate() {
            let drawn = random.below(codes);
            *token = planning.fixed_at(i).unwrap_or(u16::try_from(drawn).unwrap_or(0));
        }
    }

    fn step(
        &self,
        step: u16,
        logits: &mut Logits<'_, '_, '_>,
        codebooks: &Codebooks<'_>,
        work: &mut Work<'_>,
        draw: Draw<'_>,
    ) {
        // Computed anew in each step: it costs less than the memory that it would take from the passes.
        let metric = Metric::new(codebooks, work.units);
        let stride = self.stride(self.time(draw.planning, step), self.time(draw.planning, step + 1));
        Self::advance(Some((&stride, &metric)), logits, work.weights, draw);
    }

    fn finish(&self, logits: &mut Logits<'_, '_, '_>, work: &mut Work<'_>, draw: Draw<'_>) {
        Self::advance(None, logits, work.weights, draw);
    }
}

/// Codes whose distances are computed side by side.
const LANES: usize = 8;

/// Code vectors of length 1, `[V / LANES][du][LANES]`, with zeros behind the last: what distances are measured with.
#[derive(Debug)]
pub struct Metric<'w> {
    units: &'w [[f32; LANES]],
    width: usize,
}

/// Puts a code into one lane; returns its sum of squares.
#[inline(never)]
fn put_code(units: &mut [[f32; LANES]], lane: usize, code: impl Iterator<Item = f32>) -> f32 {
    let mut squares = 0.0;
    for (unit, v) in units.iter_mut().zip(code) {
        if let Some(unit) = unit.get_mut(lane) {
            *unit = v;
        }
        squares += v * v;
    }
    squares
}

impl<'w> Metric<'w> {
    /// Numbers that [`Metric::new`] needs.
    #[must_use]
    pub const fn len(codebooks: &Codebooks<'_>) -> usize {
        codebooks.codes().next_multiple_of(LANES) * codebooks.width()
    }

    /// Normalises the first codebook into `units`, all zero before; a code of zeros stays zeros.
    #[must_use]
    pub fn new(codebooks: &Codebooks<'_>, units: &'w mut [f32]) -> Self {
        let width = codebooks.width().max(1);
        let (units, _) = units.as_chunks_mut();
        for (group, units) in units.chunks_exact_mut(width).enumerate() {
            let mut factors = [0.0; LANES];
            for (lane, factor) in factors.iter_mut().enumerate() {
                let squares = put_code(units, lane, codebooks.values(group * LANES + lane));
                *factor = if squares > 0.0 { 1.0 / kernels::sqrt(squares) } else { 0.0 };
            }
            wide!({
                for unit in units {
                    for (v, factor) in unit.iter_mut().zip(factors) {
                        *v *= factor;
                    }
                }
            });
        }
        Metric { units, width }
    }

    /// `dist(i, x)` for all `i`, into `out [V]`; 0 for `x` itself.
    #[inline(never)]
    pub fn distances(&self, x: u16, out: &mut [f32]) {
        let (x, width) = (usize::from(x), self.width.max(1));
        #[cfg(feature = "count")]
        kernels::count::add(LANES * self.units.len());
        wide!({
            for (units, out) in self.units.chunks_exact(width).zip(out.chunks_mut(LANES)) {
                let mut cosines = [0.0f32; LANES];
                let of = self.units.iter().skip(x / LANES * width);
                for (unit, of) in units.iter().zip(of) {
                    let of = of.get(x % LANES).copied().unwrap_or(0.0);
                    for (cosine, unit) in cosines.iter_mut().zip(unit) {
                        *cosine += *unit * of;
                    }
                }
                for (out, cosine) in out.iter_mut().zip(cosines) {
                    let apart = 2.0 - 2.0 * cosine;
                    *out = apart * apart;
                }
            }
        });
        if let Some(own) = out.get_mut(x) {
            *own = 0.0;
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
        invariant!(usize::from(present) < distance.len(), "token {present} of {} codes", distance.len());
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
