//! Everything a run needs to go on, as one file: parameters, moments, averages, step, plan, curves.

use std::path::Path;

use motionette_host::checkpoint::prior::{codebook_hash, weights_hash};
use motionette_host::reference::scaffold::{Statistics, VALUES};
use serde_json::json;

use super::Error;
use super::config::Config;
use super::curves::Curves;
use super::model;
use super::training::Frozen;
use crate::optimizer::AdamW;
use crate::schedule::Plan;
use crate::tensor_file::TensorFile;
use crate::transformer::Layout;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-control-state";
/// Value of `version` in the metadata.
pub const VERSION: &str = "1";

/// What a run belongs to.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Sources {
    /// Hash of the dataset.
    pub data_hash: String,
    /// Hash of the tokenizer's codebook.
    pub tokenizer: String,
    /// Hash of the prior's weights.
    pub prior: String,
    /// Hash of the tokenizer's weights.
    pub decoder: String,
}

impl Sources {
    /// Of a dataset and frozen networks as they are now.
    pub fn of(data_hash: &str, frozen: &Frozen) -> Self {
        let named = frozen.layout.split(&frozen.values).map(|(parameter, values)| (parameter.name.as_str(), values));
        Self {
            data_hash: data_hash.to_owned(),
            tokenizer: codebook_hash(&frozen.tokenizer.codebook),
            prior: weights_hash(named),
            decoder: codebook_hash(&frozen.tokenizer.parameters),
        }
    }

    /// Whether frozen networks are what they were.
    ///
    /// # Errors
    /// [`Error::Thawed`].
    pub fn check_frozen(&self, frozen: &Frozen) -> Result<(), Error> {
        let now = Self::of(&self.data_hash, frozen);
        let parts = [("prior", &self.prior, now.prior), ("decoder", &self.decoder, now.decoder)];
        for (what, before, after) in parts {
            if *before != after {
                return Err(Error::Thawed { what, before: before.clone(), after });
            }
        }
        Ok(())
    }
}

/// A run between two steps.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Configuration of the run.
    pub config: Config,
    /// What it belongs to.
    pub sources: Sources,
    /// Of the values that anchors fix.
    pub statistics: Statistics,
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

fn layout(config: &Config, frozen: &Frozen) -> Layout {
    let prior = &frozen.config.architecture;
    model::layout(&config.architecture, &prior.planner, prior.text.width)
}

impl State {
    /// A run that has not begun.
    pub fn new(config: &Config, sources: Sources, statistics: Statistics, frozen: &Frozen) -> Self {
        let prior = |name: &str| {
            let mut parameters = frozen.layout.split(&frozen.values);
            parameters.find(|(parameter, _)| parameter.name == name).map(|(_, values)| values)
        };
        let values = model::initial(&layout(config, frozen), config.seed, prior);
        Self {
            config: config.clone(),
            sources,
            statistics,
            step: 0,
            seconds: 0.0,
            plan: None,
            optimizer: AdamW::new(values),
            curves: Curves::default(),
        }
    }

    /// The parameters' names and shapes.
    pub fn layout(&self, frozen: &Frozen) -> Layout {
        layout(&self.config, frozen)
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
        store_statistics(&self.statistics, &mut file);
        self.optimizer.store(&mut file);
        Ok(file.save(path)?)
    }

    /// Reads a file that [`Self::save`] wrote.
    ///
    /// # Errors
    /// [`Error::File`] naming the entry or tensor that does not fit, [`Error::Setting`] for a configuration out of range.
    pub fn load(path: &Path, frozen: &Frozen) -> Result<Self, Error> {
        let file = TensorFile::load(path)?;
        file.expect("format", FORMAT)?;
        file.expect("version", VERSION)?;
        let run: Run = file.parsed("run")?;
        run.config.check()?;
        let optimizer = AdamW::restore(&file, layout(&run.config, frozen).len(), run.updates)?;
        let curves = file.parsed("curves")?;
        let statistics = restore_statistics(&file)?;
        let Run { config, sources, step, seconds, plan, .. } = run;
        Ok(Self { config, sources, statistics, step, seconds, plan, optimizer, curves })
    }
}

/// Adds `control.mean` and `control.std`.
pub(super) fn store_statistics(statistics: &Statistics, file: &mut TensorFile) {
    file.insert("control.mean", &[VALUES], statistics.mean.clone());
    file.insert("control.std", &[VALUES], statistics.std.clone());
}

/// Reads what [`store_statistics`] wrote.
pub(super) fn restore_statistics(file: &TensorFile) -> Result<Statistics, Error> {
    let values = |name: &str| Ok::<_, Error>(file.values(name, &[VALUES])?.to_vec());
    Ok(Statistics { mean: values("control.mean")?, std: values("control.std")? })
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
