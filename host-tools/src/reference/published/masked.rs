//! The published masked process ([`crate::reference::masked`]): noisy choices, even times, nothing given.

use super::draw::Choice;
pub use crate::reference::masked::Step;
use crate::reference::masked::{self, times};
use crate::reference::real::Real;
use crate::reference::tmd::Schedule;

/// How a motion is planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Passes, at least 1.
    pub steps: usize,
    /// How tokens are drawn.
    pub choice: Choice,
}

impl Default for Settings {
    fn default() -> Self {
        Self { steps: 10, choice: Choice::PUBLISHED }
    }
}

/// Plans `length` tokens of V `codes`; `logits` gives `[L][V]` for tokens some of which are V, `uniform` the number of a step, position and class.
/// Every step comes back, the last holds the result.
pub fn plan<T: Real>(
    (length, codes): (usize, usize),
    settings: &Settings,
    mut logits: impl FnMut(&[usize]) -> Vec<T>,
    mut uniform: impl FnMut(usize, usize, usize) -> f32,
) -> Vec<Step<T>> {
    let draw = |step: usize, position: usize, logits: &[T]| {
        let mut class = 0;
        settings.choice.draw(logits, || {
            class += 1;
            uniform(step, position, class - 1)
        })
    };
    let times = times(Schedule::Uniform, settings.steps);
    masked::plan((vec![codes; length], codes), &times, |tokens, _| logits(tokens), draw)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::masked::masked;

    /// The published counts, as the fixtures of MoMask's format name them.
    #[test]
    fn the_published_schedule() {
        let counts = |steps: usize| -> Vec<usize> {
            times(Schedule::Uniform, steps).into_iter().map(|time| masked(time, 49)).collect()
        };
        assert_eq!(counts(10), [49, 48, 46, 42, 38, 31, 24, 17, 9, 1]);
        assert_eq!(counts(18), [49, 49, 48, 47, 46, 44, 42, 39, 36, 33, 30, 26, 22, 18, 13, 9, 5, 1]);
        assert_eq!(counts(1), [49]);
        assert_eq!(masked(0.0, 1), 1);
    }

    /// For every length and number of steps: fewer positions are masked in every step, those of the least certain tokens, and what was not
    /// masked stays.
    #[test]
    fn tokens_that_stay_are_never_masked_again() {
        for length in 1..=49 {
            for steps in [1, 2, 3, 7, 20] {
                let mut state = (length * steps) as u64;
                let uniform = |_: usize, _: usize, _: usize| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    (state >> 40) as f32 / (1 << 24) as f32
                };
                let logits = |tokens: &[usize]| -> Vec<f64> {
                    let value = |i: usize, c: usize| ((7 * i + 3 * c) % 11) as f64 * 0.2;
                    (0..tokens.len()).flat_map(|i| (0..5).map(move |c| value(i, c))).collect()
                };
                let settings = Settings { steps, choice: Choice { temperature: 1.0, filter: 0.0 } };
                let all = plan((length, 5), &settings, logits, uniform);
                assert_eq!(all.len(), steps);
                for (k, step) in all.iter().enumerate() {
                    assert_eq!(step.before.iter().filter(|token| **token == 5).count(), step.masked);
                    assert!(step.after.iter().all(|token| *token < 5));
                    let Some(next) = all.get(k + 1) else { continue };
                    assert!(next.masked <= step.masked);
                    let kept = |i: &usize| next.before[*i] != 5;
                    assert!((0..length).filter(kept).all(|i| next.before[i] == step.after[i]));
                    let most = (0..length).filter(|i| !kept(i)).map(|i| step.scores[i]).fold(0.0, f64::max);
                    let least = (0..length).filter(kept).map(|i| step.scores[i]).fold(f64::INFINITY, f64::min);
                    assert!(most <= least, "length {length}, step {k} of {steps}");
                }
            }
        }
    }
}
