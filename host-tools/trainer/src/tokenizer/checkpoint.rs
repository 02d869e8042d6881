//! The finished tokenizer as a file: MoMask's names and torch layout, everything needed to use it inside.
//!
//! Convolutions are `[out, in, k]`, the codebook is `quantizer.layers.0.codebook` `[codes, code_dim]`, `mean` and `std` are `[263]`.
//! `__metadata__` has `format`, `version`, `config` (JSON: sizes, seed, steps, data hash, metrics) and `training` (JSON: the whole
//! [`Config`]).

use std::path::Path;

use serde_json::json;

use super::Error;
use super::config::{Architecture, Config, DOWN_T, FEATURES, FPS};
use super::metrics::Report;
use super::model;
use crate::convolution::Shape;
use crate::normalization::Normalization;
use crate::tensor_file::TensorFile;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-tokenizer";
/// Value of `version` in the metadata.
pub const VERSION: &str = "1";
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
        let config = json!({
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
        let mut file = TensorFile::default();
        for (entry, text) in [
            ("format", FORMAT.to_owned()),
            ("version", VERSION.to_owned()),
            ("config", config.to_string()),
            ("training", serde_json::to_string(&self.config).unwrap_or_default()),
        ] {
            file.metadata.insert(entry.to_owned(), text);
        }
        let mut rest = &self.parameters[..];
        for shape in model::shapes(a) {
            let (own, after) = rest.split_at(shape.parameters());
            rest = after;
            let (weight, bias) = own.split_at(shape.weights());
            let torch = [shape.outputs, shape.inputs, shape.kernel];
            file.insert(format!("{}.weight", shape.name), &torch, to_torch(&shape, weight));
            file.insert(format!("{}.bias", shape.name), &[shape.outputs], bias.to_vec());
        }
        file.insert(CODEBOOK, &[a.codes, a.code_dim], self.codebook.clone());
        file.insert("mean", &[FEATURES], self.normalization.mean.clone());
        file.insert("std", &[FEATURES], self.normalization.std.clone());
        Ok(file.save(path)?)
    }

    /// Reads a file that [`Self::save`] wrote.
    ///
    /// # Errors
    /// [`Error::File`] naming the entry or tensor that is missing or does not fit, [`Error::Setting`] for a configuration out of
    /// range.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let file = TensorFile::load(path)?;
        file.expect("format", FORMAT)?;
        file.expect("version", VERSION)?;
        let config: Config = file.parsed("training")?;
        config.check()?;
        let facts: Facts = file.parsed("config")?;
        let Architecture { codes, code_dim, .. } = config.architecture;
        let shapes = model::shapes(&config.architecture);
        let mut parameters = Vec::with_capacity(model::parameter_count(&shapes));
        for shape in &shapes {
            let torch = [shape.outputs, shape.inputs, shape.kernel];
            parameters.extend(from_torch(shape, file.values(&format!("{}.weight", shape.name), &torch)?));
            parameters.extend(file.values(&format!("{}.bias", shape.name), &[shape.outputs])?);
        }
        let normalization = Normalization {
            mean: file.values("mean", &[FEATURES])?.to_vec(),
            std: file.values("std", &[FEATURES])?.to_vec(),
        };
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

/// `[k][in][out]` to `[out][in][k]`.
fn to_torch(shape: &Shape, weight: &[f32]) -> Vec<f32> {
    let Shape { inputs, outputs, kernel, .. } = *shape;
    let at = |o: usize, i: usize, k: usize| weight[(k * inputs + i) * outputs + o];
    let mut turned = Vec::with_capacity(weight.len());
    for o in 0..outputs {
        for i in 0..inputs {
            turned.extend((0..kernel).map(|k| at(o, i, k)));
        }
    }
    turned
}

/// `[out][in][k]` to `[k][in][out]`.
fn from_torch(shape: &Shape, weight: &[f32]) -> Vec<f32> {
    let Shape { inputs, outputs, kernel, .. } = *shape;
    let at = |o: usize, i: usize, k: usize| weight[(o * inputs + i) * kernel + k];
    let mut turned = Vec::with_capacity(weight.len());
    for k in 0..kernel {
        for i in 0..inputs {
            turned.extend((0..outputs).map(|o| at(o, i, k)));
        }
    }
    turned
}
