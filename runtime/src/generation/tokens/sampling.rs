//! How a proposal is drawn from logits.

use crate::nn::softmax;
use crate::numerics::hash::Stream;

/// Range of temperatures.
pub const TEMPERATURES: (f32, f32) = (1e-3, 1e3);

/// The way a token is chosen from logits `l [V]`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Sampling {
    /// The largest logit, the lowest token on ties. Draws nothing.
    Greedy,
    /// One draw from `softmax(l / temperature)`, cut to its most probable tokens. Takes one `unit()`.
    Sample {
        /// Above 1 more variety, below 1 less.
        temperature: f32,
        /// Only the so many most probable tokens, those as probable as the last of them included; 0 = all.
        top_k: u16,
        /// Of these only the smallest set of most probable tokens with at least this share of their mass, ties included;
        /// 1 = all.
        top_p: f32,
    },
    /// The largest `l + temperature g`, `g = -ln(-ln u)`: a draw from `softmax(l / temperature)`. Takes `V` `unit()`s.
    Gumbel {
        /// Above 1 more variety, below 1 less.
        temperature: f32,
    },
}

impl Default for Sampling {
    /// A draw from the whole distribution.
    fn default() -> Self {
        Sampling::Sample { temperature: 1.0, top_k: 0, top_p: 1.0 }
    }
}

/// A sampling option out of its range.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SamplingError {
    /// The temperature is not in [`TEMPERATURES`].
    Temperature {
        /// What was asked for.
        found: f32,
    },
    /// `top_p` is not above 0 and at most 1.
    TopP {
        /// What was asked for.
        found: f32,
    },
}

impl core::fmt::Display for SamplingError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            SamplingError::Temperature { found: _ } => {
                write!(f, "the temperature must be a number from 0.001 to 1000")
            }
            SamplingError::TopP { found: _ } => write!(f, "top-p must be a number above 0 and at most 1"),
        }
    }
}

impl core::error::Error for SamplingError {}

impl Sampling {
    /// Checks the options.
    ///
    /// # Errors
    /// [`SamplingError`].
    pub fn check(&self) -> Result<(), SamplingError> {
        let within = |found: f32| {
            let (least, most) = TEMPERATURES;
            if found >= least && found <= most { Ok(()) } else { Err(SamplingError::Temperature { found }) }
        };
        match *self {
            Sampling::Greedy => Ok(()),
            Sampling::Gumbel { temperature } => within(temperature),
            Sampling::Sample { temperature, top_p: found, .. } => {
                within(temperature)?;
                if found > 0.0 && found <= 1.0 { Ok(()) } else { Err(SamplingError::TopP { found }) }
            }
        }
    }

    /// Chooses a token. Overwrites `logits` for its own purposes.
    #[inline(never)]
    pub fn propose(&self, logits: &mut [f32], stream: &mut Stream) -> u16 {
        let chosen = match *self {
            Sampling::Greedy => largest(logits.iter().copied()),
            Sampling::Gumbel { temperature } => largest(logits.iter().map(|l| {
                let g = -libm::logf(-libm::logf(stream.unit()));
                *l + temperature * g
            })),
            Sampling::Sample { temperature, top_k, top_p } => {
                for l in logits.iter_mut() {
                    *l /= temperature;
                }
                softmax::softmax(logits);
                if top_k > 0 {
                    cut(logits, |p, least| above(p, least).count() >= usize::from(top_k));
                }
                if top_p < 1.0 {
                    let wanted = top_p * mass(logits, 0.0);
                    cut(logits, |p, least| mass(p, least) >= wanted);
                }
                draw(logits, mass(logits, 0.0), stream.unit())
            }
        };
        u16::try_from(chosen).unwrap_or(0)
    }
}

/// Place of the largest number, the first of several.
fn largest(values: impl Iterator<Item = f32>) -> usize {
    let (mut best, mut place) = (f32::NEG_INFINITY, 0);
    for (i, value) in values.enumerate() {
        if value > best {
            (best, place) = (value, i);
        }
    }
    place
}

/// The values that are at least `least`.
fn above(values: &[f32], least: f32) -> impl Iterator<Item = f32> {
    values.iter().copied().filter(move |p| *p >= least)
}

/// Their sum, in order.
#[inline(never)]
fn mass(values: &[f32], least: f32) -> f32 {
    let mut sum = 0.0;
    for p in above(values, least) {
        sum += p;
    }
    sum
}

/// Sets to zero all that is below the largest threshold whose set is `enough`: the smallest set of largest values, ties
/// included. `enough` must not become false when the set grows. Nothing is sorted: positive numbers order as their bit
/// patterns do, so the threshold is found bit by bit, in 31 sweeps.
fn cut(p: &mut [f32], enough: impl Fn(&[f32], f32) -> bool) {
    let mut threshold = 0u32;
    for bit in (0..31).rev() {
        let raised = threshold | 1 << bit;
        let least = f32::from_bits(raised);
        if least.is_finite() && enough(p, least) {
            threshold = raised;
        }
    }
    let least = f32::from_bits(threshold);
    for p in p {
        if *p < least {
            *p = 0.0;
        }
    }
}

/// The token at which the running sum of `weights` passes `unit * sum`; the last one with any weight at the end.
#[inline(never)]
pub(super) fn draw(weights: &[f32], sum: f32, unit: f32) -> usize {
    let target = unit * sum;
    let (mut running, mut last) = (0.0, 0);
    for (i, w) in weights.iter().enumerate() {
        if *w > 0.0 {
            running += *w;
            last = i;
            if running > target {
                break;
            }
        }
    }
    last
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Logits whose softmax is 0.4, 0.1, 0.3, 0.05, 0.15.
    fn logits() -> Vec<f32> {
        [0.4f32, 0.1, 0.3, 0.05, 0.15].iter().map(|p| p.ln()).collect()
    }

    fn shares(sampling: Sampling, draws: u32) -> Vec<f64> {
        let mut stream = Stream::new(5);
        let mut counts = [0.0; 5];
        for _ in 0..draws {
            counts[usize::from(sampling.propose(&mut logits(), &mut stream))] += 1.0;
        }
        counts.map(|count: f64| count / f64::from(draws)).to_vec()
    }

    /// Largest difference of drawn shares from `expected`, in standard deviations.
    fn deviation(sampling: Sampling, expected: [f64; 5]) -> f64 {
        const DRAWS: u32 = 40_000;
        let found = shares(sampling, DRAWS);
        let deviation = |(found, p): (&f64, f64)| {
            let sigma = (p * (1.0 - p) / f64::from(DRAWS)).sqrt();
            if sigma == 0.0 { if *found == p { 0.0 } else { f64::INFINITY } } else { (found - p).abs() / sigma }
        };
        found.iter().zip(expected).map(deviation).fold(0.0, f64::max)
    }

    fn powered(temperature: f64) -> [f64; 5] {
        let p = [0.4f64, 0.1, 0.3, 0.05, 0.15].map(|p| p.powf(1.0 / temperature));
        let sum: f64 = p.iter().sum();
        p.map(|p| p / sum)
    }

    #[test]
    fn greedy_takes_the_largest_and_draws_nothing() {
        let mut stream = Stream::new(3);
        assert_eq!(Sampling::Greedy.propose(&mut logits(), &mut stream), 0);
        assert_eq!(Sampling::Greedy.propose(&mut [1.0, 3.0, 3.0], &mut stream), 1);
        assert_eq!(stream, Stream::new(3));
    }

    #[test]
    fn temperature_flattens_or_sharpens() {
        for temperature in [0.5f32, 1.0, 2.0] {
            let expected = powered(f64::from(temperature));
            let sample = Sampling::Sample { temperature, top_k: 0, top_p: 1.0 };
            assert!(deviation(sample, expected) < 4.5, "{temperature}");
            assert!(deviation(Sampling::Gumbel { temperature }, expected) < 4.5, "{temperature}");
            // The test can fail.
            assert!(deviation(sample, powered(f64::from(temperature) * 1.25)) > 4.5);
        }
    }

    #[test]
    fn top_k_and_top_p_cut_the_least_probable() {
        let cut = |top_k, top_p| Sampling::Sample { temperature: 1.0, top_k, top_p };
        assert!(deviation(cut(2, 1.0), [4.0 / 7.0, 0.0, 3.0 / 7.0, 0.0, 0.0]) < 4.5);
        assert!(deviation(cut(1, 1.0), [1.0, 0.0, 0.0, 0.0, 0.0]) < 4.5);
        assert!(deviation(cut(5, 1.0), [0.4, 0.1, 0.3, 0.05, 0.15]) < 4.5);
        assert!(deviation(cut(999, 1.0), [0.4, 0.1, 0.3, 0.05, 0.15]) < 4.5);
        assert!(deviation(cut(0, 0.69), [4.0 / 7.0, 0.0, 3.0 / 7.0, 0.0, 0.0]) < 4.5);
        assert!(deviation(cut(0, 0.71), [0.4 / 0.85, 0.0, 0.3 / 0.85, 0.0, 0.15 / 0.85]) < 4.5);
        assert!(deviation(cut(0, 1e-6), [1.0, 0.0, 0.0, 0.0, 0.0]) < 4.5);
        // Top-p of what top-k has left: 0.4 of 0.7 is 57 %.
        assert!(deviation(cut(2, 0.56), [1.0, 0.0, 0.0, 0.0, 0.0]) < 4.5);
        assert!(deviation(cut(2, 0.58), [4.0 / 7.0, 0.0, 3.0 / 7.0, 0.0, 0.0]) < 4.5);
    }

    #[test]
    fn ties_are_kept() {
        let drawn = |top_k, top_p| {
            let sampling = Sampling::Sample { temperature: 1.0, top_k, top_p };
            let mut stream = Stream::new(1);
            let mut seen = [false; 4];
            for _ in 0..200 {
                seen[usize::from(sampling.propose(&mut [1.0, 0.0, 1.0, 1.0], &mut stream))] = true;
            }
            seen
        };
        assert_eq!(drawn(1, 1.0), [true, false, true, true]);
        assert_eq!(drawn(0, 0.01), [true, false, true, true]);
    }

    #[test]
    fn every_way_takes_the_draws_it_says() {
        let after = |draws: usize| {
            let mut stream = Stream::new(8);
            for _ in 0..draws {
                let _ = stream.unit();
            }
            stream
        };
        for (sampling, draws) in [
            (Sampling::default(), 1),
            (Sampling::Sample { temperature: 2.0, top_k: 2, top_p: 0.5 }, 1),
            (Sampling::Gumbel { temperature: 1.0 }, 5),
        ] {
            let mut stream = Stream::new(8);
            let _ = sampling.propose(&mut logits(), &mut stream);
            assert_eq!(stream, after(draws), "{sampling:?}");
        }
    }

    #[test]
    fn extreme_logits_give_a_token() {
        let mut stream = Stream::new(2);
        for sampling in [
            Sampling::Greedy,
            Sampling::default(),
            Sampling::Sample { temperature: 1e-3, top_k: 1, top_p: 1e-30 },
            Sampling::Gumbel { temperature: 1e-3 },
            Sampling::Gumbel { temperature: 1e3 },
        ] {
            assert_eq!(sampling.propose(&mut [-1e30, 1e30, 0.0], &mut stream), 1, "{sampling:?}");
            assert!(sampling.propose(&mut [0.0; 7], &mut stream) < 7, "{sampling:?}");
            assert_eq!(sampling.propose(&mut [], &mut stream), 0, "{sampling:?}");
        }
    }

    #[test]
    fn options_out_of_range_are_refused() {
        let sample = |temperature, top_p| Sampling::Sample { temperature, top_k: 0, top_p };
        for bad in [0.0, -1.0, f32::NAN, f32::INFINITY, 1001.0] {
            assert!(matches!(sample(bad, 1.0).check(), Err(SamplingError::Temperature { .. })), "{bad}");
            assert!(matches!(Sampling::Gumbel { temperature: bad }.check(), Err(SamplingError::Temperature { .. })));
        }
        for bad in [0.0, -0.5, f32::NAN, 1.01] {
            assert!(matches!(sample(1.0, bad).check(), Err(SamplingError::TopP { .. })), "{bad}");
        }
        assert_eq!(sample(0.7, 0.9).check(), Ok(()));
    }
}
