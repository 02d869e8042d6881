//! The finished prior as a file, in the names that `motionette convert` reads.
//!
//! Every parameter of [`super::model::layout`] is a tensor of its name. `__metadata__` has `format`, `version`, `config` (JSON: sizes,
//! vocabulary, corruption, provenance, metrics) and `training` (JSON: the whole [`Config`]).

use std::path::Path;

use serde_json::json;

use super::Error;
use super::config::{Config, MAX_TOKENS};
use super::model;
use super::state::{Sources, State};
use super::validation::Report;
use crate::tensor_file::TensorFile;
use crate::transformer::EPSILON;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-prior";
/// Value of `version` in the metadata.
pub const VERSION: &str = "1";

/// Writes the averaged weights of a run whole or not at all, with `report` as their metrics.
///
/// # Errors
/// [`Error::File`].
pub fn save(state: &State, path: &Path, report: &Report) -> Result<(), Error> {
    let (config, sources) = (&state.config, &state.sources);
    let a = &config.architecture;
    let facts = json!({
        "vocabulary": sources.vocabulary,
        "max_words": a.max_words,
        "max_tokens": MAX_TOKENS,
        "codes": sources.codes,
        "code_dim": sources.code_dim,
        "text": a.text,
        "planner": a.planner,
        "epsilon": EPSILON,
        "norm": "pre",
        "activation": "gelu",
        "c": config.c,
        "a": config.a,
        "tokenizer": sources.tokenizer,
        "preset": config.preset,
        "seed": config.seed,
        "steps": state.step,
        "data_hash": sources.data_hash,
        "metrics": report,
    });
    let mut file = TensorFile::default();
    for (entry, text) in [
        ("format", FORMAT.to_owned()),
        ("version", VERSION.to_owned()),
        ("config", facts.to_string()),
        ("training", serde_json::to_string(config).unwrap_or_default()),
    ] {
        file.metadata.insert(entry.to_owned(), text);
    }
    for (parameter, values) in state.layout().split(&state.optimizer.average) {
        file.insert(parameter.name.clone(), &parameter.shape(), values.to_vec());
    }
    Ok(file.save(path)?)
}

/// Configuration, sources and flat weights of a file that [`save`] wrote.
///
/// # Errors
/// [`Error::File`] naming the entry or tensor that is missing or does not fit, [`Error::Setting`] for a configuration out of range.
pub fn load(path: &Path) -> Result<(Config, Sources, Vec<f32>), Error> {
    let file = TensorFile::load(path)?;
    file.expect("format", FORMAT)?;
    file.expect("version", VERSION)?;
    let config: Config = file.parsed("training")?;
    config.check()?;
    let sources: Sources = file.parsed("config")?;
    let layout = model::layout(&config.architecture, sources.vocabulary.len(), sources.codes);
    let mut values = Vec::with_capacity(layout.len());
    for parameter in &layout.parameters {
        values.extend(file.values(&parameter.name, &parameter.shape())?);
    }
    Ok((config, sources, values))
}
