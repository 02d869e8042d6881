//! A checkpoint made ready to run: features to ids, ids to features.

use super::decoder::Decoder;
use super::encoder::Encoder;
use super::quantizer::{BadId, Quantizer};
use super::real::Real;
use crate::checkpoint::TokenizerCheckpoint;

/// Why features could not be encoded.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// The checkpoint was stripped of its encoder.
    #[error("the checkpoint has no encoder; use the full checkpoint of the trainer")]
    NoEncoder,
    /// No mean and std.
    #[error("the checkpoint has no mean and std; give them with --mean and --std")]
    NoStatistics,
    /// Not whole rows, too short, or not finite.
    #[error("features {what}; expected at least {least} rows of {columns} finite numbers")]
    Features {
        /// What is wrong.
        what: String,
        /// Fewest rows.
        least: usize,
        /// Numbers a row.
        columns: usize,
    },
}

/// Encoder, codebooks, full decoder and statistics.
#[derive(Debug, Clone)]
pub struct Tokenizer<T> {
    /// The encoder, where the checkpoint has one.
    pub encoder: Option<Encoder<T>>,
    /// The codebooks.
    pub quantizer: Quantizer<T>,
    /// The decoder with all features.
    pub decoder: Decoder<T>,
    statistics: Option<(Vec<f64>, Vec<f64>)>,
    features: usize,
    frames_per_token: usize,
}

impl<T: Real> Tokenizer<T> {
    /// From a checkpoint.
    #[must_use]
    pub fn new(checkpoint: &TokenizerCheckpoint) -> Self {
        Self {
            encoder: checkpoint.encoder.as_ref().map(Encoder::new),
            quantizer: Quantizer::new(&checkpoint.codebooks, checkpoint.config.code_dim),
            decoder: Decoder::new(&checkpoint.decoder, checkpoint.config.features),
            statistics: checkpoint.statistics.as_ref().map(|s| (s.mean.clone(), s.std.clone())),
            features: checkpoint.config.features,
            frames_per_token: checkpoint.config.frames_per_token(),
        }
    }

    /// Unnormalised features `[T][F]` to ids `[L][Q]`, `L = T / r` rounded down; frames beyond `L r` are dropped, as the published
    /// scripts do.
    ///
    /// # Errors
    /// [`EncodeError`].
    pub fn encode(&self, features: &[f32]) -> Result<Vec<i64>, EncodeError> {
        let encoder = self.encoder.as_ref().ok_or(EncodeError::NoEncoder)?;
        let (mean, std) = self.statistics.as_ref().ok_or(EncodeError::NoStatistics)?;
        let bad = |what: String| EncodeError::Features { what, least: self.frames_per_token, columns: self.features };
        if !features.len().is_multiple_of(self.features) {
            return Err(bad(format!("hold {} numbers, not whole rows", features.len())));
        }
        if let Some(at) = features.iter().position(|v| !v.is_finite()) {
            let (row, channel) = (at / self.features, at % self.features);
            return Err(bad(format!("hold {} at row {row}, channel {channel}", features[at])));
        }
        let frames = features.len() / self.features / self.frames_per_token * self.frames_per_token;
        if frames == 0 {
            return Err(bad(format!("have {} rows", features.len() / self.features)));
        }
        let normalised: Vec<T> = features[..frames * self.features]
            .chunks_exact(self.features)
            .flat_map(|row| row.iter().zip(mean).zip(std).map(|((&x, m), s)| T::from_f64((f64::from(x) - m) / s)))
            .collect();
        Ok(self.quantizer.encode(&encoder.forward(&normalised)))
    }

    /// Ids `[L][Q]` to normalised features `[L r][F]`.
    ///
    /// # Errors
    /// [`BadId`].
    pub fn decode_normalised(&self, ids: &[i64]) -> Result<Vec<T>, BadId> {
        Ok(self.decoder.forward(&self.quantizer.decode(ids)?).features)
    }

    /// Normalised features `[T][F]` to unnormalised ones: `x * std + mean` in f64, then rounded to f32.
    ///
    /// # Errors
    /// [`EncodeError::NoStatistics`].
    pub fn denormalise(&self, features: &[T]) -> Result<Vec<f32>, EncodeError> {
        let (mean, std) = self.statistics.as_ref().ok_or(EncodeError::NoStatistics)?;
        let row = |row: &[T]| -> Vec<f32> {
            row.iter().zip(mean).zip(std).map(|((x, m), s)| (x.to_f64() * s + m) as f32).collect()
        };
        Ok(features.chunks_exact(self.features).flat_map(row).collect())
    }
}
