//! Everything a run needs to go on, as one file: parameters, moments, averages, step, plan, curves.

use std::path::Path;

use serde_json::json;

use super::Error;
use super::captions::Vocabulary;
use super::config::Config;
use super::curves::Curves;
use super::model;
use crate::optimizer::AdamW;
use crate::schedule::Plan;
use crate::tensor_file::TensorFile;
use crate::transformer::Layout;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-prior-state";
/// Value of `version` in the metadata.
pub const VERSION: &str = "1";

/// What a run belongs to.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Sources {
    /// Hash of the dataset.
    pub data_hash: String,
    /// Hash of the tokenizer's codebook.
    pub tokenizer: String,
    /// Codes of the tokenizer.
    pub codes: usize,
    /// Width of a code.
    pub code_dim: usize,
    /// Words in the order of their ids.
    pub vocabulary: Vec<String>,
}

/// A run between two steps.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Configuration of the run.
    pub config: Config,
    /// What it belongs to.
    pub sources: Sources,
    /// Steps done.
    pub step: u64,
    /// Seconds spent in steps, over all parts of the run.
    pub seconds: f64,
    /// The end, once it is known.
    pub plan: Option<Plan>,
    /// Parameters, moments, average.
    pub optimizer: AdamW,
    /// The course so far.
    pub curves: Curves,
}

impl State {
    /// A run that has not begun.
    pub fn new(config: &Config, sources: Sources) -> Self {
        let layout = model::layout(&config.architecture, sources.vocabulary.len(), sources.codes);
        Self {
            config: config.clone(),
            sources,
            step: 0,
            seconds: 0.0,
            plan: None,
            optimizer: AdamW::new(layout.initial(config.seed)),
            curves: Curves::default(),
        }
    }

    /// The parameters' names and shapes.
    pub fn layout(&self) -> Layout {
        model::layout(&self.config.architecture, self.sources.vocabulary.len(), self.sources.codes)
    }

    /// The words.
    pub fn vocabulary(&self) -> Vocabulary {
        Vocabulary::new(self.sources.vocabulary.clone())
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        let run = json!({
            "config": self.config,
            "sources": self.sources,
            "step": self.step,
            "seconds": self.seconds,
            "plan": self.plan,
            "updates": self.optimizer.updates,
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
        let length = model::layout(&run.config.architecture, run.sources.vocabulary.len(), run.sources.codes).len();
        let optimizer = AdamW::restore(&file, length, run.updates)?;
        let curves = file.parsed("curves")?;
        let Run { config, sources, step, seconds, plan, .. } = run;
        Ok(Self { config, sources, step, seconds, plan, optimizer, curves })
    }
}

/// Metadata entry `run`.
#[derive(serde::Deserialize)]
struct Run {
    config: Config,
    sources: Sources,
    step: u64,
    seconds: f64,
    plan: Option<Plan>,
    updates: u64,
}
