//! What a run belongs to and begins with.

use motionette_host::checkpoint::prior::{codebook_hash, weights_hash};
use motionette_host::reference::scaffold::{Statistics, VALUES};
use serde_json::{Map, Value};

use super::Error;
use super::config::Config;
use super::frozen::Frozen;
use super::model;
use crate::harness;
use crate::tensor_file::{self, TensorFile};
use crate::transformer::Layout;

/// A run between two steps; beside the parameters it keeps the statistics of the values that anchors fix.
pub type State = harness::State<Config>;

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
        // As a converter counts them: a table that comes with the words is none of the weights.
        let trained = frozen.layout.split(&frozen.prior.parameters).filter(|(parameter, _)| !parameter.frozen);
        let named = trained.map(|(parameter, values)| (parameter.name.as_str(), values));
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

impl harness::Sources for Sources {
    fn difference(&self, other: &Self) -> Option<&'static str> {
        let what = if self.prior == other.prior { "dataset" } else { "prior" };
        (self != other).then_some(what)
    }
}

/// Names and shapes of the parameters of a control of these networks.
pub fn layout(config: &Config, frozen: &Frozen) -> Layout {
    let prior = &frozen.prior.config.architecture;
    model::layout(&config.architecture, &prior.planner, prior.text.width)
}

impl State {
    /// A run that has not begun.
    pub fn begin(config: &Config, sources: Sources, statistics: Statistics, frozen: &Frozen) -> Self {
        let prior = |name: &str| {
            let mut parameters = frozen.layout.split(&frozen.prior.parameters);
            parameters.find(|(parameter, _)| parameter.name == name).map(|(_, values)| values)
        };
        let parameters = model::initial(&layout(config, frozen), config.seed, prior);
        Self::new(config.clone(), sources, parameters, statistics)
    }

    /// Names and shapes of the parameters.
    pub fn layout(&self, frozen: &Frozen) -> Layout {
        layout(&self.config, frozen)
    }
}

impl harness::Extra<Config> for Statistics {
    fn store(&self, _run: &mut Map<String, Value>, file: &mut TensorFile) {
        store_statistics(self, file);
    }

    fn restore(_config: &Config, file: &TensorFile) -> Result<Self, harness::Error> {
        Ok(restore_statistics(file)?)
    }
}

/// Adds `control.mean` and `control.std`.
pub(super) fn store_statistics(statistics: &Statistics, file: &mut TensorFile) {
    file.insert("control.mean", &[VALUES], statistics.mean.clone());
    file.insert("control.std", &[VALUES], statistics.std.clone());
}

/// Reads what [`store_statistics`] wrote.
pub(super) fn restore_statistics(file: &TensorFile) -> Result<Statistics, tensor_file::Error> {
    let values = |name: &str| file.values(name, &[VALUES]).map(<[f32]>::to_vec);
    Ok(Statistics { mean: values("control.mean")?, std: values("control.std")? })
}
