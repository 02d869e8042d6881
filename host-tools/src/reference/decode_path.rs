//! The differentiable decode path from latent vectors to joints: decoder, denormalisation, recovery.

use super::decoder::{Decoder, Trace};
use super::real::{Real, convert};
use super::recover::{self, CHANNELS, JOINTS};
use crate::checkpoint::TokenizerCheckpoint;

/// A checkpoint that no decode path can be built from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodePathError {
    /// No mean and std.
    #[error(
        "the checkpoint has no mean and std, without which features are no motion; give them with --mean and --std"
    )]
    NoStatistics,
    /// Too few channels for 22 joints.
    #[error("the checkpoint has {features} features, joint positions need at least {CHANNELS}")]
    TooFewFeatures {
        /// Features of the checkpoint.
        features: usize,
    },
}

/// Decoder and statistics, restricted to the channels that joint positions depend on.
#[derive(Debug, Clone)]
pub struct DecodePath<T> {
    /// The decoder, [`CHANNELS`] features only.
    pub decoder: Decoder<T>,
    mean: Vec<T>,
    std: Vec<T>,
}

/// One pass along the decode path, kept.
#[derive(Debug, Clone)]
pub struct Pass<T> {
    /// The decoder's pass.
    pub trace: Trace<T>,
    /// Unnormalised features `[T][67]`.
    pub features: Vec<T>,
    /// Joints `[T]`, metres.
    pub joints: Vec<[[T; 3]; JOINTS]>,
}

impl<T: Real> DecodePath<T> {
    /// From a checkpoint.
    ///
    /// # Errors
    /// [`DecodePathError`].
    pub fn new(checkpoint: &TokenizerCheckpoint) -> Result<Self, DecodePathError> {
        let statistics = checkpoint.statistics.as_ref().ok_or(DecodePathError::NoStatistics)?;
        let features = checkpoint.config.features;
        if features < CHANNELS {
            return Err(DecodePathError::TooFewFeatures { features });
        }
        Ok(Self {
            decoder: Decoder::new(&checkpoint.decoder, CHANNELS),
            mean: convert(&statistics.mean[..CHANNELS]),
            std: convert(&statistics.std[..CHANNELS]),
        })
    }

    /// Latent `[L][du]` to joints.
    #[must_use]
    pub fn forward(&self, latent: &[T]) -> Pass<T> {
        let trace = self.decoder.forward(latent);
        let mut features = trace.features.clone();
        for row in features.chunks_exact_mut(CHANNELS) {
            for ((x, &mean), &std) in row.iter_mut().zip(&self.mean).zip(&self.std) {
                *x = *x * std + mean;
            }
        }
        let joints = recover::joints(&features, CHANNELS);
        Pass { trace, features, joints }
    }

    /// `dJ/djoints` at `pass` to `dJ/dlatent` `[L][du]`.
    #[must_use]
    pub fn backward(&self, pass: &Pass<T>, gradient: &[[[T; 3]; JOINTS]]) -> Vec<T> {
        let mut d = recover::joints_backward(&pass.features, CHANNELS, gradient);
        for row in d.chunks_exact_mut(CHANNELS) {
            for (d, &std) in row.iter_mut().zip(&self.std) {
                *d *= std;
            }
        }
        self.decoder.backward(&pass.trace, &d)
    }
}
