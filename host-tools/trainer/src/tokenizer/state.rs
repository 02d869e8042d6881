//! Everything a run needs to go on, as one file: parameters, moments, averages, running sums of the codebook, step, plan, curves.
//!
//! Random numbers need no state: they depend on seed and step.

use std::path::Path;

use serde_json::json;

use super::Error;
use super::config::Config;
use super::curves::Curves;
use super::model;
use super::quantizer::Codebook;
use crate::optimizer::AdamW;
use crate::schedule::Plan;
use crate::tensor_file::TensorFile;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-tokenizer-state";
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
    /// Seconds spent in steps, over all parts of the run.
    pub seconds: f64,
    /// The end, once it is known.
    pub plan: Option<Plan>,
    /// Parameters, moments, average.
    pub optimizer: AdamW,
    /// None before quantisation begins.
    pub codebook: Option<Codebook>,
    /// The course so far.
    pub curves: Curves,
}

impl State {
    /// A run that has not begun.
    pub fn new(config: &Config, data_hash: &str) -> Self {
        let shapes = model::shapes(&config.architecture);
        Self {
            config: config.clone(),
            data_hash: data_hash.to_owned(),
            step: 0,
            seconds: 0.0,
            plan: None,
            optimizer: AdamW::new(model::initial_parameters(&shapes, config.seed)),
            codebook: None,
            curves: Curves::default(),
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
            "plan": self.plan,
            "updates": self.optimizer.updates,
            "quantized": self.codebook.is_some(),
        });
        let mut file = TensorFile::default();
        for (entry, text) in [
            ("format", FORMAT.to_owned()),
            ("version", VERSION.to_owned()),
            ("run", run.to_string()),
            ("curves", json!(self.curves).to_string()),
        ] {
            file.metadata.insert(entry.to_owned(), text);
        }
        self.optimizer.store(&mut file);
        if let Some(book) = &self.codebook {
            let shape = [book.codes(), book.dim()];
            file.insert("codebook.rows", &shape, book.rows.clone());
            file.insert("codebook.sums", &shape, book.sums.clone());
            file.insert("codebook.counts", &shape[..1], book.counts.clone());
        }
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
        let length = model::parameter_count(&model::shapes(&run.config.architecture));
        let optimizer = AdamW::restore(&file, length, run.updates)?;
        let codebook = if run.quantized {
            let shape = [run.config.architecture.codes, run.config.architecture.code_dim];
            let rows = file.values("codebook.rows", &shape)?.to_vec();
            let sums = file.values("codebook.sums", &shape)?.to_vec();
            let counts = file.values("codebook.counts", &shape[..1])?.to_vec();
            Some(Codebook::from_parts(rows, counts, sums, shape[1]))
        } else {
            None
        };
        Ok(Self {
            config: run.config,
            data_hash: run.data_hash,
            step: run.step,
            seconds: run.seconds,
            plan: run.plan,
            optimizer,
            codebook,
            curves: file.parsed("curves")?,
        })
    }
}

/// Metadata entry `run`.
#[derive(serde::Deserialize)]
struct Run {
    config: Config,
    data_hash: String,
    step: u64,
    seconds: f64,
    plan: Option<Plan>,
    updates: u64,
    quantized: bool,
}
