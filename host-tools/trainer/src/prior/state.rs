//! What a run belongs to and begins with.

use super::captions::Vocabulary;
use super::config::Config;
use super::model;
use crate::harness;
use crate::transformer::Layout;

/// A run between two steps.
pub type State = harness::State<Config>;

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

impl Sources {
    /// Names and shapes of the parameters of networks for these words and codes.
    pub fn layout(&self, config: &Config) -> Layout {
        model::layout(&config.architecture, self.vocabulary.len(), self.codes)
    }

    /// The words.
    pub fn vocabulary(&self) -> Vocabulary {
        Vocabulary::new(self.vocabulary.clone())
    }
}

impl harness::Sources for Sources {
    fn difference(&self, other: &Self) -> Option<&'static str> {
        let what = if self.tokenizer == other.tokenizer { "dataset" } else { "tokenizer" };
        (self != other).then_some(what)
    }
}

impl State {
    /// A run that has not begun.
    pub fn begin(config: &Config, sources: Sources) -> Self {
        let parameters = sources.layout(config).initial(config.seed);
        Self::new(config.clone(), sources, parameters, ())
    }

    /// Names and shapes of the parameters.
    pub fn layout(&self) -> Layout {
        self.sources.layout(&self.config)
    }
}
