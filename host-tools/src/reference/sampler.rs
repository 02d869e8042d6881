//! How a prior's tokens come to be, and what it was trained to undo.

use motionette::numerics::hash::Stream;

use super::masked::Masked;
use super::real::Real;
use super::tmd::{Settings, Tmd};
use crate::checkpoint::prior::Corruption;

/// The process of a prior.
#[derive(Debug, Clone)]
pub enum Sampler<T> {
    /// Tokens move to near codes.
    Tmd(Tmd<T>),
    /// Tokens are masked.
    Masked(Masked),
}

impl<T: Real> Sampler<T> {
    /// On a codebook `[V][width]`; `c` and `a` of `beta(t)` count where tokens move to near codes.
    #[must_use]
    pub fn new(corruption: Corruption, (codebook, width): (&[f32], usize), (c, a): (f64, f64)) -> Self {
        match corruption {
            Corruption::Near => Self::Tmd(Tmd::new(codebook, width, c, a)),
            Corruption::Masks => Self::Masked(Masked { codes: codebook.len() / width }),
        }
    }

    /// Clean tokens as they are at time `t`.
    #[must_use]
    pub fn corrupt(&self, tokens: &[u16], t: f64, stream: &mut Stream) -> Vec<u16> {
        match self {
            Self::Tmd(tmd) => tmd.corrupt(tokens, t, stream),
            Self::Masked(masked) => masked.corrupt(tokens, t, stream),
        }
    }

    /// Samples `length` tokens. `logits` gives `[L][V]` for the present tokens and the time. Returns the tokens after every step; the
    /// last are the result.
    pub fn sample(
        &self,
        length: usize,
        settings: &Settings,
        logits: impl FnMut(&[u16], f64) -> Vec<T>,
    ) -> Vec<Vec<u16>> {
        match self {
            Self::Tmd(tmd) => tmd.sample(length, settings, logits),
            Self::Masked(masked) => masked.sample(length, settings, logits),
        }
    }
}
