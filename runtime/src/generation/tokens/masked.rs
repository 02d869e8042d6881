//! Confidence re-masking (MoMask 3.4, ControlMM 3.1; MaskGIT): every position is drawn in every step, the least certain ones are masked again.
//!
//! Step `k` of `S` draws all masked positions. Of those that are not given, `n = max(1, round(cos(pi/2 t) n_0))` are masked for step `k + 1`,
//! `n_0` how many there are, `t` the time of that step, halves rounded to the even number: the ones whose token was least
//! probable when it was drawn, by the whole distribution, the first on ties. What was not masked before a step is never masked again.
//! The time of step `k` is `k / (S - 1)` or what the schedule makes of it, 0 in the first: planners that are told it saw as large a share of
//! masks at this time in training.

use super::Planning;
use super::sampler::{Draw, Logits, TokenSampler};
use crate::codec::codebook::Codebooks;
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::softmax;
use crate::numerics::angle::sin_cos;
use crate::numerics::hash::Stream;

/// Of a position that was not masked, above every probability.
const KEPT: f32 = 1e5;
/// Adding this to a number below 2^22 rounds it to a whole one, halves to the even one.
const ROUND: f32 = 12_582_912.0;

/// The sampler. Token V, behind the codes, is a masked one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Masked;

/// What a step works in.
#[derive(Debug)]
pub struct Work<'s> {
    /// `[V]`
    weights: &'s mut [f32],
    /// How certain the token of each position is, `[L]`.
    scores: &'s mut [f32],
}

/// Positions that are masked behind step `step` of `steps`, of so many.
#[must_use]
pub fn masked(planning: &Planning<'_>, step: u16, positions: usize) -> usize {
    let time = Masked.time(planning, step.saturating_add(1));
    let (_, share) = sin_cos(time * core::f32::consts::PI * 0.5);
    let count = (share * positions as f32 + ROUND - ROUND) as usize;
    count.max(1).min(positions)
}

/// Whether position `i` comes before position `j` when the least certain are masked.
fn before((i, a): (usize, f32), (j, b): (usize, f32)) -> bool {
    a < b || (a == b && i < j)
}

impl Masked {
    /// Draws all positions; those that were not masked keep their tokens.
    fn draw(logits: &mut Logits<'_, '_, '_>, work: &mut Work<'_>, draw: Draw<'_>) {
        let Draw { planning, random, tokens, proposals } = draw;
        logits.each(|i, logits| {
            let weights = part_mut!(work.weights, ..logits.len());
            for (weight, logit) in weights.iter_mut().zip(logits.iter()) {
                *weight = *logit;
            }
            let drawn = planning.sampling.propose(logits, random);
            invariant!(i < tokens.len() && i < proposals.len() && i < work.scores.len(), "row {i}");
            let (Some(token), Some(proposal), Some(score)) =
                (tokens.get_mut(i), proposals.get_mut(i), work.scores.get_mut(i))
            else {
                return;
            };
            *score = KEPT;
            if usize::from(*token) == weights.len() {
                softmax::softmax(weights);
                *score = weights.get(usize::from(drawn)).copied().unwrap_or(0.0);
                *token = drawn;
            }
            *proposal = *token;
        });
    }
}

impl TokenSampler for Masked {
    type Work<'s> = Work<'s>;

    fn layout<'s>(
        &self,
        arena: &mut Arena<'s>,
        tokens: usize,
        codebooks: &Codebooks<'_>,
    ) -> Result<Work<'s>, ArenaTooSmall> {
        Ok(Work { weights: arena.take(codebooks.codes())?, scores: arena.take(tokens)? })
    }

    fn time(&self, planning: &Planning<'_>, step: u16) -> f32 {
        if step == 0 { 0.0 } else { planning.schedule.time(step, planning.steps.saturating_sub(1)) }
    }

    fn macs(&self, _: &Codebooks<'_>) -> u64 {
        0
    }

    /// All masked, given ones in their places. Draws nothing.
    fn begin(&self, planning: &Planning<'_>, codes: usize, _: &mut Stream, tokens: &mut [u16]) {
        for (i, token) in tokens.iter_mut().enumerate() {
            *token = planning.fixed_at(i).unwrap_or(u16::try_from(codes).unwrap_or(u16::MAX));
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
        let Draw { planning, random, tokens, proposals } = draw;
        Self::draw(logits, work, Draw { planning, random, tokens, proposals });
        let scores = part!(work.scores, ..tokens.len());
        let free = || scores.iter().copied().enumerate().filter(|(i, _)| planning.fixed_at(*i).is_none());
        let count = masked(planning, step, free().count());
        let mask = u16::try_from(codebooks.codes()).unwrap_or(u16::MAX);
        for this in free() {
            let rank = free().filter(|other| before(*other, this)).count();
            if rank < count
                && let Some(token) = tokens.get_mut(this.0)
            {
                *token = mask;
            }
        }
    }

    fn finish(&self, logits: &mut Logits<'_, '_, '_>, work: &mut Work<'_>, draw: Draw<'_>) {
        Self::draw(logits, work, draw);
    }
}
