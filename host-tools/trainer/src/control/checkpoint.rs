//! The finished control as a file, in the names that `motionette convert --control` reads.
//!
//! Every parameter of [`super::model::layout`] is a tensor of its name, with `control.mean` and `control.std` beside them. `__metadata__`
//! has `format`, `version`, `config` (JSON: sizes, what it belongs to, provenance, metrics) and `training` (JSON: the whole
//! [`Config`]).

use std::path::Path;

use serde_json::json;

use super::Error;
use super::config::Config;
use super::state::{State, restore_statistics, store_statistics};
use super::training::Frozen;
use super::validation::Report;
use crate::prior::config::MAX_TOKENS;
use crate::tensor_file::TensorFile;
use crate::transformer::EPSILON;
use motionette_host::reference::scaffold::Statistics;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-control";
/// Value of `version` in the metadata.
pub const VERSION: &str = "1";

/// Writes the averaged weights of a run whole or not at all, with `report` as their metrics.
///
/// # Errors
/// [`Error::File`].
pub fn save(state: &State, frozen: &Frozen, path: &Path, report: &Report) -> Result<(), Error> {
    let (config, sources) = (&state.config, &state.sources);
    let (a, planner) = (&config.architecture, &frozen.config.architecture.planner);
    let facts = json!({
        "max_tokens": MAX_TOKENS,
        "variant": a.variant,
        "frame_width": a.frame_width,
        "scaffold": a.scaffold,
        "rank": a.rank,
        "planner_width": planner.width,
        "planner_layers": planner.layers,
        "epsilon": EPSILON,
        "norm": "pre",
        "activation": "gelu",
        "context": a.context,
        "families": ["root3d", "planar", "body"],
        "tokenizer": sources.tokenizer,
        "prior": sources.prior,
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
    store_statistics(&state.statistics, &mut file);
    for (parameter, values) in state.layout(frozen).split(&state.optimizer.average) {
        file.insert(parameter.name.clone(), &parameter.shape(), values.to_vec());
    }
    Ok(file.save(path)?)
}

/// Configuration, statistics and flat weights of a file that [`save`] wrote for these frozen networks.
///
/// # Errors
/// [`Error::File`] naming the entry or tensor that is missing or does not fit, [`Error::OtherRun`] when it was trained on another prior.
pub fn load(path: &Path, frozen: &Frozen, prior: &str) -> Result<(Config, Statistics, Vec<f32>), Error> {
    let file = TensorFile::load(path)?;
    file.expect("format", FORMAT)?;
    file.expect("version", VERSION)?;
    let config: Config = file.parsed("training")?;
    config.check()?;
    let facts: Facts = file.parsed("config")?;
    if facts.prior != prior {
        return Err(Error::OtherRun { path: path.to_path_buf(), what: "prior" });
    }
    let a = &frozen.config.architecture;
    let layout = super::model::layout(&config.architecture, &a.planner, a.text.width);
    let mut values = Vec::with_capacity(layout.len());
    for parameter in &layout.parameters {
        values.extend(file.values(&parameter.name, &parameter.shape())?);
    }
    Ok((config, restore_statistics(&file)?, values))
}

/// Takes the scaffold encoder, and what it suggests, from a file that [`save`] wrote.
///
/// # Errors
/// [`Error::File`] naming the entry or tensor that is missing or of another size.
pub fn adopt_scaffold(state: &mut State, path: &Path, frozen: &Frozen) -> Result<(), Error> {
    let file = TensorFile::load(path)?;
    file.expect("format", FORMAT)?;
    file.expect("version", VERSION)?;
    let parts = ["frame", "merge", "position", "layers", "norm", "local"].map(|part| format!("control.{part}."));
    let layout = state.layout(frozen);
    let mut rest = &mut state.optimizer.values[..];
    for parameter in &layout.parameters {
        let (own, after) = rest.split_at_mut(parameter.len());
        rest = after;
        if parts.iter().any(|part| parameter.name.starts_with(part)) {
            own.copy_from_slice(file.values(&parameter.name, &parameter.shape())?);
        }
    }
    state.optimizer.average.copy_from_slice(&state.optimizer.values);
    state.statistics = restore_statistics(&file)?;
    Ok(())
}

/// The entry of `config` that is not in `training`.
#[derive(serde::Deserialize)]
struct Facts {
    prior: String,
}
