//! Masked planning (MoMask 3.4, MaskGIT): all positions are drawn at once, the least certain ones are masked again. V, behind the codes, is a
//! masked token.

use motionette::numerics::hash::Stream;

use super::real::Real;
use super::tmd::{Schedule, Settings, Tmd, propose};
use super::transformer::softmax;

/// Of a position that was not masked: it is never masked again.
const KEPT: f64 = 1e5;

/// A step of the process.
#[derive(Debug, Clone, PartialEq)]
pub struct Step<T> {
    /// Positions that were masked.
    pub masked: usize,
    /// What the network read; V where a position was masked.
    pub before: Vec<usize>,
    /// What was drawn, for masked positions and others.
    pub drawn: Vec<usize>,
    /// The tokens then.
    pub after: Vec<usize>,
    /// How probable a token was, `1e5` where it had been there.
    pub scores: Vec<T>,
    /// Logits `[L][V]`.
    pub logits: Vec<T>,
}

/// Positions of so many that are masked at a time: `max(1, round(cos(pi / 2 * time) length))`, halves to the even number.
#[must_use]
pub fn masked(time: f64, length: usize) -> usize {
    let share = (time as f32 * core::f32::consts::PI * 0.5).cos();
    ((share * length as f32).round_ties_even() as usize).max(1).min(length)
}

/// Times of so many steps: from 0 in the first to 1 in the last.
#[must_use]
pub fn times(schedule: Schedule, steps: usize) -> Vec<f64> {
    if steps < 2 { vec![0.0] } else { Tmd::<f64>::times(schedule, steps - 1) }
}

/// Plans the tokens of V `codes` that are masked in `start`, a step at each of `times`; `logits` gives `[L][V]` for tokens some of which are V
/// and the time, `draw` the token of a step and position from its logits. Every step comes back, the last holds the result.
pub fn plan<T: Real>(
    (start, codes): (Vec<usize>, usize),
    times: &[f64],
    mut logits: impl FnMut(&[usize], f64) -> Vec<T>,
    mut draw: impl FnMut(usize, usize, &[T]) -> usize,
) -> Vec<Step<T>> {
    let free: Vec<usize> = (0..start.len()).filter(|&position| start[position] == codes).collect();
    let (mut tokens, mut scores) = (start, Vec::new());
    scores.resize(tokens.len(), T::ZERO);
    let mut steps = Vec::with_capacity(times.len());
    for (step, &time) in times.iter().enumerate() {
        let count = masked(time, free.len());
        let mut order = free.clone();
        order.sort_by(|&a, &b| scores[a].partial_cmp(&scores[b]).unwrap_or(core::cmp::Ordering::Equal));
        let mut is_masked = vec![false; tokens.len()];
        for &position in order.iter().take(count) {
            (is_masked[position], tokens[position]) = (true, codes);
        }
        let before = tokens.clone();
        let all = logits(&before, time);
        let mut drawn = Vec::with_capacity(tokens.len());
        for (position, logits) in all.chunks_exact(codes).enumerate() {
            let token = draw(step, position, logits);
            drawn.push(token);
            if is_masked[position] {
                tokens[position] = token;
            }
            scores[position] = match is_masked[position] {
                true => probability(logits, token),
                false => T::from_f64(KEPT),
            };
        }
        let after = tokens.clone();
        steps.push(Step { masked: count, before, drawn, after, scores: scores.clone(), logits: all });
    }
    steps
}

/// The probability of a class.
fn probability<T: Real>(logits: &[T], class: usize) -> T {
    let mut all = logits.to_vec();
    softmax(&mut all);
    all[class]
}

/// The process of a prior's planner.
#[derive(Debug, Clone, Copy)]
pub struct Masked {
    /// Codes V.
    pub codes: usize,
}

impl Masked {
    /// Clean tokens, of which as many as the time says are masked, any of them.
    #[must_use]
    pub fn corrupt(&self, tokens: &[u16], time: f64, stream: &mut Stream) -> Vec<u16> {
        let mut places: Vec<usize> = (0..tokens.len()).collect();
        let mut z = tokens.to_vec();
        for drawn in 0..masked(time, z.len()) {
            places.swap(drawn, drawn + stream.below((z.len() - drawn) as u32) as usize);
            z[places[drawn]] = self.codes as u16;
        }
        z
    }

    /// Samples `length` tokens. `logits` gives `[L][V]` for the present tokens and the time. Returns what every step left for the next one,
    /// masked tokens among them; the last are the result. Positions in order, in every step each draws its proposal, masked or not.
    pub fn sample<T: Real>(
        &self,
        length: usize,
        settings: &Settings,
        mut logits: impl FnMut(&[u16], f64) -> Vec<T>,
    ) -> Vec<Vec<u16>> {
        let short = |tokens: &[usize]| -> Vec<u16> { tokens.iter().map(|&token| token as u16).collect() };
        let mut start = vec![self.codes; length];
        for &(position, token) in &settings.fixed {
            start[position] = usize::from(token);
        }
        let mut stream = Stream::new(settings.seed);
        let steps = plan(
            (start, self.codes),
            &times(settings.schedule, settings.steps),
            |tokens, time| logits(&short(tokens), time),
            |_, _, logits| usize::from(propose(logits, settings.sampling, &mut stream)),
        );
        let left = steps.iter().skip(1).map(|step| &step.before).chain(steps.last().map(|step| &step.after));
        left.map(|tokens| short(tokens)).collect()
    }
}
