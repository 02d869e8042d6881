//! The finished prior as a file, in the names that `motionette convert` reads.
//!
//! Every parameter of [`super::model::layout`] is a tensor of its name. `__metadata__` has `format`, `version`, `config` (JSON: sizes,
//! vocabulary, corruption, provenance, metrics) and `training` (JSON: the whole [`Config`]).

use std::path::Path;

use serde_json::json;

use super::config::{Config, MAX_TOKENS};
use super::state::{Sources, State};
use super::validation::Report;
use crate::harness::{Configuration, Error};
use crate::tensor_file::Format;
use crate::transformer::EPSILON;

/// Format of the file.
pub const FORMAT: Format = Format { name: "motionette-prior", version: "1" };

/// A prior that was trained.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// How.
    pub config: Config,
    /// On what, with the words it knows.
    pub sources: Sources,
    /// Its parameters in the order of [`Sources::layout`].
    pub parameters: Vec<f32>,
}

/// Writes the averaged weights of a run whole or not at all, with `report` as their metrics.
///
/// # Errors
/// [`Error::File`].
pub fn save(state: &State, path: &Path, report: &Report) -> Result<(), Error> {
    let (config, sources) = (&state.config, &state.sources);
    let a = &config.architecture;
    let facts = json!({
        "vocabulary": sources.vocabulary,
        "word_vectors": sources.word_vectors,
        "word_tiers": sources.word_tiers,
        "meanings": sources.meanings,
        "guidance": sources.guidance,
        "threshold": report.understanding.map_or(0.5, |understanding| understanding.threshold),
        "teacher": sources.teacher,
        "phrases": sources.phrases,
        "max_words": a.max_words,
        "max_tokens": MAX_TOKENS,
        "codes": sources.codes,
        "code_dim": sources.code_dim,
        "text": a.text,
        "planner": a.planner,
        "epsilon": EPSILON,
        "norm": "pre",
        "activation": "gelu",
        "corruption": config.corruption,
        "c": config.c,
        "a": config.a,
        "tokenizer": sources.tokenizer,
        "preset": config.preset,
        "seed": config.seed,
        "steps": state.step,
        "data_hash": sources.data_hash,
        "metrics": report,
    });
    let mut file = FORMAT.file();
    file.describe("config", facts.to_string());
    file.describe("training", serde_json::to_string(config).unwrap_or_default());
    state.layout().store(&state.optimizer.average, &mut file);
    Ok(file.save(path)?)
}

/// Reads a file that [`save`] wrote.
///
/// # Errors
/// [`Error::File`] naming the entry or tensor that is missing or does not fit, [`Error::Setting`] for a configuration out of range.
pub fn load(path: &Path) -> Result<Checkpoint, Error> {
    let file = FORMAT.load(path)?;
    let config = file.parsed::<Config>("training")?.checked()?;
    let sources: Sources = file.parsed("config")?;
    let parameters = sources.layout(&config).restore(&file)?;
    Ok(Checkpoint { config, sources, parameters })
}
