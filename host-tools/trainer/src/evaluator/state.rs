//! Everything a run needs to go on, as one file: configuration, step, parameters, moments, averages.
//!
//! Random numbers need no state: they depend on seed and step. Labels, vocabulary and normalisation follow from the dataset.

use std::path::Path;

use serde_json::json;

use super::Error;
use super::config::Config;
use super::model;
use crate::convolution::Shape;
use crate::optimizer::AdamW;
use crate::tensor_file::TensorFile;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-evaluator-state";
/// Value of `version` in the metadata.
pub const VERSION: &str = "1";

/// A run between two steps.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Configuration of the run.
    pub config: Config,
    /// Hash of the dataset.
    pub data_hash: String,
    /// Steps done.
    pub step: u64,
    /// Seconds of training so far.
    pub seconds: f64,
    /// Parameters, moments, averages; empty before the first step.
    pub optimizer: AdamW,
}

impl State {
    /// A run that has not begun.
    pub fn new(config: &Config, data_hash: &str) -> Self {
        let optimizer = AdamW::new(Vec::new());
        Self { config: config.clone(), data_hash: data_hash.to_owned(), step: 0, seconds: 0.0, optimizer }
    }

    /// Draws the first weights, unless there are some.
    pub(super) fn begin(&mut self, shapes: &[Shape]) {
        if self.optimizer.values.is_empty() {
            self.optimizer = AdamW::new(model::initial_parameters(shapes, self.config.seed));
        }
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        let run = json!({
            "config": self.config,
            "data_hash": self.data_hash,
            "step": self.step,
            "seconds": self.seconds,
            "updates": self.optimizer.updates,
            "parameters": self.optimizer.values.len(),
        });
        let mut file = TensorFile::default();
        for (entry, text) in [("format", FORMAT.to_owned()), ("version", VERSION.to_owned()), ("run", run.to_string())]
        {
            file.metadata.insert(entry.to_owned(), text);
        }
        self.optimizer.store(&mut file);
        Ok(file.save(path)?)
    }

    /// Reads a file that [`Self::save`] wrote.
    ///
    /// # Errors
    /// [`Error::File`] naming the entry or tensor that does not fit, [`Error::Setting`] for a configuration out of range.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let file = TensorFile::load(path)?;
        file.expect("format", FORMAT)?;
        file.expect("version", VERSION)?;
        let run: Run = file.parsed("run")?;
        run.config.check()?;
        let optimizer = AdamW::restore(&file, run.parameters, run.updates)?;
        Ok(Self { config: run.config, data_hash: run.data_hash, step: run.step, seconds: run.seconds, optimizer })
    }
}

/// Metadata entry `run`.
#[derive(serde::Deserialize)]
struct Run {
    config: Config,
    data_hash: String,
    step: u64,
    seconds: f64,
    updates: u64,
    parameters: usize,
}
