//! The finished tokenizer as a file: MoMask's names and torch layout, everything needed to use it inside.
//!
//! Convolutions are `[out, in, k]`, the codebook is `quantizer.layers.0.codebook` `[codes, code_dim]`, `mean` and `std` are `[263]`.
//! `__metadata__` has `format`, `version`, `config` (JSON: sizes, seed, steps, data hash, metrics) and `training` (JSON: the whole
//! [`Config`]). Dilations of the encoder that are not the decoder's and a decoder that looks less far ahead than back are entries
//! `encoder_dilations` and `right` of the sizes, see [`Architecture`]; other checkpoints lack them.

use std::path::Path;

use serde_json::json;

use super::config::{Architecture, Config, DOWN_T, FEATURES, FPS};
use super::metrics::Report;
use super::model;
use crate::convolution::{self, Order};
use crate::harness::{Configuration, Error};
use crate::normalization::Normalization;
use crate::tensor_file::Format;

/// Format of the file.
pub const FORMAT: Format = Format { name: "motionette-tokenizer", version: "1" };
const CODEBOOK: &str = "quantizer.layers.0.codebook";

/// A tokenizer that can encode and decode.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// How it was trained.
    pub config: Config,
    /// Flat parameters in the order of [`model::shapes`].
    pub parameters: Vec<f32>,
    /// `[codes][code_dim]`.
    pub codebook: Vec<f32>,
    /// Of the features it was trained on.
    pub normalization: Normalization,
    /// Steps of training.
    pub steps: u64,
    /// Hash of the dataset.
    pub data_hash: String,
}

impl Checkpoint {
    /// Writes the file whole or not at all, with `reports` as its metrics.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn save(&self, path: &Path, reports: &[Report]) -> Result<(), Error> {
        let a = &self.config.architecture;
        let mut config = json!({
            "width": a.width,
            "encoder_width": a.encoder_width,
            "code_dim": a.code_dim,
            "codes": a.codes,
            "quantizers": 1,
            "depth": a.dilations.len(),
            "dilations": a.dilations,
            "down_t": DOWN_T,
            "features": FEATURES,
            "fps": FPS,
            "preset": self.config.preset,
            "seed": self.config.seed,
            "steps": self.steps,
            "data_hash": self.data_hash,
            "metrics": reports,
        });
        for (name, values) in [("encoder_dilations", &a.encoder_dilations), ("right", &a.right)] {
            if !values.is_empty() {
                config[name] = json!(values);
            }
        }
        let mut file = FORMAT.file();
        file.describe("config", config.to_string());
        file.describe("training", serde_json::to_string(&self.config).unwrap_or_default());
        convolution::store(&model::shapes(a), &self.parameters, Order::Torch, &mut file);
        file.insert(CODEBOOK, &[a.codes, a.code_dim], self.codebook.clone());
        self.normalization.store(&mut file);
        Ok(file.save(path)?)
    }

    /// Reads a file that [`Self::save`] wrote.
    ///
    /// # Errors
    /// [`Error::File`] naming the entry or tensor that is missing or does not fit, [`Error::Setting`] for a configuration out of
    /// range.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let file = FORMAT.load(path)?;
        let config = file.parsed::<Config>("training")?.checked()?;
        let facts: Facts = file.parsed("config")?;
        let Architecture { codes, code_dim, .. } = config.architecture;
        let parameters = convolution::restore(&model::shapes(&config.architecture), Order::Torch, &file)?;
        let normalization = Normalization::restored(&file)?;
        let codebook = file.values(CODEBOOK, &[codes, code_dim])?.to_vec();
        Ok(Self { config, parameters, codebook, normalization, steps: facts.steps, data_hash: facts.data_hash })
    }
}

/// The entries of `config` that are not in `training`.
#[derive(serde::Deserialize)]
struct Facts {
    steps: u64,
    data_hash: String,
}
