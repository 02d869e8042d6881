//! The finished control as a file, in the names that `motionette convert --control` reads.
//!
//! Every parameter of [`super::model::layout`] is a tensor of its name, with `control.mean` and `control.std` beside them. `__metadata__`
//! has `format`, `version`, `config` (JSON: sizes, what it belongs to, provenance, metrics) and `training` (JSON: the whole
//! [`Config`]).

use std::path::Path;

use motionette_host::reference::scaffold::Statistics;
use serde_json::json;

use super::config::Config;
use super::frozen::Frozen;
use super::state::{State, layout, restore_statistics, store_statistics};
use super::validation::Report;
use crate::harness::{Configuration, Error};
use crate::prior::config::MAX_TOKENS;
use crate::tensor_file::Format;
use crate::transformer::EPSILON;

/// Format of the file.
pub const FORMAT: Format = Format { name: "motionette-control", version: "1" };

/// A control that was trained.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// How.
    pub config: Config,
    /// Of the values that anchors fix.
    pub statistics: Statistics,
    /// Its parameters in the order of [`layout`].
    pub parameters: Vec<f32>,
}

/// Writes the averaged weights of a run whole or not at all, with `report` as their metrics.
///
/// # Errors
/// [`Error::File`].
pub fn save(state: &State, frozen: &Frozen, path: &Path, report: &Report) -> Result<(), Error> {
    let (config, sources) = (&state.config, &state.sources);
    let (a, planner) = (&config.architecture, &frozen.prior.config.architecture.planner);
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
    let mut file = FORMAT.file();
    file.describe("config", facts.to_string());
    file.describe("training", serde_json::to_string(config).unwrap_or_default());
    store_statistics(&state.extra, &mut file);
    state.layout(frozen).store(&state.optimizer.average, &mut file);
    Ok(file.save(path)?)
}

/// Reads a file that [`save`] wrote for these frozen networks; `prior` is the hash of the prior's weights.
///
/// # Errors
/// [`Error::File`] naming the entry or tensor that is missing or does not fit, [`Error::Setting`] for a configuration out of range,
/// [`Error::OtherRun`] when it was trained on another prior.
pub fn load(path: &Path, frozen: &Frozen, prior: &str) -> Result<Checkpoint, Error> {
    let file = FORMAT.load(path)?;
    let config = file.parsed::<Config>("training")?.checked()?;
    let facts: Facts = file.parsed("config")?;
    if facts.prior != prior {
        return Err(Error::OtherRun { path: path.to_path_buf(), what: "prior" });
    }
    let parameters = layout(&config, frozen).restore(&file)?;
    Ok(Checkpoint { config, statistics: restore_statistics(&file)?, parameters })
}

/// Takes the scaffold encoder, and what it suggests, from a file that [`save`] wrote.
///
/// # Errors
/// [`Error::File`] naming the entry or tensor that is missing or of another size.
pub fn adopt_scaffold(state: &mut State, path: &Path, frozen: &Frozen) -> Result<(), Error> {
    let file = FORMAT.load(path)?;
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
    state.extra = restore_statistics(&file)?;
    Ok(())
}

/// The entry of `config` that is not in `training`.
#[derive(serde::Deserialize)]
struct Facts {
    prior: String,
}
