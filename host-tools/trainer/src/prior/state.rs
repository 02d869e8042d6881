//! What a run belongs to and begins with.

use super::captions::Vocabulary;
use super::checkpoint::Checkpoint;
use super::config::Config;
use super::model;
use crate::harness;
use crate::transformer::Layout;
use motionette_host::checkpoint::WordTable;
use motionette_host::checkpoint::prior::Meaning;

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
    /// Numbers of a word's vector; 0 where every word has an embedding of its own.
    #[serde(default)]
    pub word_vectors: usize,
    /// Tier of each word with a vector.
    #[serde(default)]
    pub word_tiers: Vec<u8>,
    /// What sentences may mean, actions before styles.
    #[serde(default)]
    pub meanings: Vec<Meaning>,
    /// Whether the planner is told how strongly it is guided.
    #[serde(default)]
    pub guidance: bool,
    /// SHA-256 of the prior whose two passes it was distilled from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub teacher: Option<String>,
    /// SHA-256 of the file of phrases, where there was one.
    #[serde(default)]
    pub phrases: Option<String>,
}

impl Sources {
    /// Names and shapes of the parameters of networks for these words and codes.
    pub fn layout(&self, config: &Config) -> Layout {
        model::layout(config, self)
    }

    /// The words.
    pub fn vocabulary(&self) -> Vocabulary {
        Vocabulary::new(self.vocabulary.clone())
    }
}

impl harness::Sources for Sources {
    fn difference(&self, other: &Self) -> Option<&'static str> {
        let what = match self {
            _ if self.tokenizer != other.tokenizer => "tokenizer",
            _ if self.data_hash != other.data_hash => "dataset",
            _ if self.phrases != other.phrases => "phrases",
            _ if self.teacher != other.teacher => "teacher",
            _ => "words",
        };
        (self != other).then_some(what)
    }
}

impl State {
    /// A run that has not begun, with the vectors of its words where it has some.
    pub fn begin(config: &Config, sources: Sources, table: Option<&WordTable>) -> Self {
        let layout = sources.layout(config);
        let mut parameters = layout.initial(config.seed);
        if let Some(table) = table {
            let numbers: Vec<f32> = table.numbers.iter().copied().map(f32::from).collect();
            for (name, values) in [("text.vectors.weight", &numbers), ("text.scales.weight", &table.scales)] {
                layout.fill(&mut parameters, name, values);
            }
        }
        Self::new(config.clone(), sources, parameters, ())
    }

    /// A run that goes on where `other` ended, in networks of these sources that may have more parameters.
    pub fn after(config: &Config, sources: Sources, other: &Checkpoint) -> Self {
        let layout = sources.layout(config);
        let mut parameters = layout.initial(config.seed);
        for (parameter, values) in other.sources.layout(&other.config).split(&other.parameters) {
            layout.fill(&mut parameters, &parameter.name, values);
        }
        Self::new(config.clone(), sources, parameters, ())
    }

    /// Names and shapes of the parameters.
    pub fn layout(&self) -> Layout {
        self.sources.layout(&self.config)
    }
}
