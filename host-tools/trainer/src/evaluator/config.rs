//! What an evaluator run is made of: sizes, schedule, weights of the objective.

use serde::{Deserialize, Serialize};

use super::state::{Metrics, Point};
use crate::chart::Panel;
use crate::harness::configuration::DatasetHash;
use crate::harness::{Configuration, Curves, Evaluation};
use crate::setting::{OutOfRange, require};
use crate::tensor_file::Format;
use crate::{optimizer, schedule};

/// Longest motion that is judged, frames; longer ones are cut. One more than a model's 49 tokens.
pub const MAX_FRAMES: usize = 197;
/// Shortest motion that is learnt from and measured, frames: three tokens.
pub const MIN_FRAMES: usize = 12;

/// Everything that decides a run beside the dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Seed of weights and batches.
    pub seed: u64,
    /// Steps of the run.
    pub steps: u64,
    /// Pairs of motion and sentence in a batch.
    pub batch: usize,
    /// Channels of the motion encoder.
    pub width: usize,
    /// Channels between pooling and embedding, and of the text encoder.
    pub hidden: usize,
    /// Width of a word.
    pub word_width: usize,
    /// Words of a sentence that are read.
    pub max_words: usize,
    /// Width of the embedding.
    pub embedding: usize,
    /// Share of hidden channels that a step leaves out.
    pub dropout: f64,
    /// Similarities (cosines) are divided by this.
    pub temperature: f32,
    /// Weight of the cross-entropy of the content.
    pub content: f32,
    /// Weight of the cross-entropy of the style.
    pub style: f32,
    /// Share of examples that are cropped and played at another tempo.
    pub cropped: f64,
    /// Share of examples that are several motions of one label, joined.
    pub joined: f64,
    /// Largest relative change of tempo.
    pub tempo: f64,
    /// Share of examples with recorded legs whose legs and contacts are hidden.
    #[serde(default)]
    pub hidden_legs: f64,
    /// Share of examples with synthetic legs that get the legs of another motion; those of the rest are hidden.
    #[serde(default)]
    pub exchanged_legs: f64,
    /// An example is drawn with a probability that falls with this power of the number of those of its action, or of its style where
    /// that is rarer; 0 draws all alike, 1 makes labels equally frequent.
    #[serde(default)]
    pub balance: f64,
    /// Course of the learning rate.
    pub schedule: schedule::Settings,
    /// Decoupled weight decay.
    pub weight_decay: f32,
    /// Largest global norm of the gradient.
    pub clip: f32,
    /// Decay of the averaged weights, which become the checkpoint.
    pub average_decay: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            steps: 3600,
            batch: 64,
            width: 128,
            hidden: 256,
            word_width: 48,
            max_words: 32,
            embedding: 32,
            dropout: 0.2,
            temperature: 0.1,
            content: 1.0,
            style: 1.0,
            cropped: 0.35,
            joined: 0.15,
            tempo: 0.05,
            hidden_legs: 0.3,
            exchanged_legs: 0.7,
            balance: 0.4,
            schedule: schedule::Settings { learning_rate: 1e-3, warm_up: 100, decay: 1.0, final_rate: 0.01 },
            weight_decay: 0.02,
            clip: 1.0,
            average_decay: 0.995,
        }
    }
}

impl Configuration for Config {
    const STATE: Format = Format { name: "motionette-evaluator-state", version: "1" };
    type Sources = DatasetHash;
    type Extra = ();
    type Point = Point;
    type Evaluation = Evaluation<Metrics>;

    fn check(&self) -> Result<(), OutOfRange> {
        for (field, size) in [
            ("width", self.width),
            ("hidden", self.hidden),
            ("word_width", self.word_width),
            ("max_words", self.max_words),
            ("embedding", self.embedding),
        ] {
            require((1..=1024).contains(&size), field, size, "1 to 1024")?;
        }
        require((2..=4096).contains(&self.batch), "batch", self.batch, "2 to 4096")?;
        for (field, share) in [("dropout", self.dropout), ("tempo", self.tempo)] {
            require((0.0..=0.5).contains(&share), field, share, "0 to 0.5")?;
        }
        for (field, share) in
            [("hidden_legs", self.hidden_legs), ("exchanged_legs", self.exchanged_legs), ("balance", self.balance)]
        {
            require((0.0..=1.0).contains(&share), field, share, "0 to 1")?;
        }
        let shares = self.cropped >= 0.0 && self.joined >= 0.0 && self.cropped + self.joined <= 1.0;
        require(shares, "cropped", format!("{} beside joined {}", self.cropped, self.joined), "0 to 1 together")?;
        require(self.temperature > 0.0, "temperature", self.temperature, "above 0")
    }

    fn schedule(&self) -> schedule::Settings {
        self.schedule
    }

    fn optimizer(&self) -> optimizer::Settings {
        optimizer::Settings::new(self.weight_decay, self.clip, self.average_decay)
    }

    fn panels(_curves: &Curves<Point, Evaluation<Metrics>>) -> Vec<Panel> {
        Vec::new()
    }
}
