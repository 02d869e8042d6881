//! What a run of the prior is made of: sizes, corruption, augmentation, schedule.

use motionette_host::checkpoint::prior::Corruption;
use serde::{Deserialize, Serialize};

use super::curves::{Point, panels};
use super::state::Sources;
use super::validation::Report;
use crate::chart::Panel;
use crate::harness::{Configuration, Curves, Error, Evaluation};
use crate::setting::{OutOfRange, require};
use crate::tensor_file::Format;
use crate::transformer::Sizes;
use crate::{optimizer, schedule};

/// Longest motion, tokens.
pub const MAX_TOKENS: usize = 49;
/// Times that the planner tells apart.
pub const TIME_BINS: usize = 32;

/// Sizes of text encoder and planner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// Text encoder.
    pub text: Sizes,
    /// Planner.
    pub planner: Sizes,
    /// Most words of a prompt.
    pub max_words: usize,
}

/// Everything that decides a run. Two runs with equal configuration, data, tokenizer and version give equal weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the preset the configuration began as.
    pub preset: String,
    /// Sizes.
    pub architecture: Architecture,
    /// Seed of weights, batches and dropout.
    pub seed: u64,
    /// Motions in a batch.
    pub batch: usize,
    /// Course of the learning rate.
    pub schedule: schedule::Settings,
    /// Decoupled weight decay.
    pub weight_decay: f32,
    /// Largest global norm of the gradient.
    pub clip: f32,
    /// Decay of the averaged weights, which become the checkpoint.
    pub average_decay: f32,
    /// Share of activations that residual branches drop.
    pub dropout: f32,
    /// What clean tokens are recovered from: tokens that moved to near codes, or masks.
    #[serde(default, skip_serializing_if = "Corruption::is_near")]
    pub corruption: Corruption,
    /// How far tokens move to near codes: `beta(t) = c (t / (1 - t))^a`. Of no account for masks.
    pub c: f32,
    /// The exponent of it.
    pub a: f32,
    /// Share of prompts replaced by the empty one, for guidance.
    pub text_dropout: f64,
    /// Share of words replaced by the unknown one.
    pub word_dropout: f64,
    /// Share of motions of which only a piece is shown, with open ends.
    pub crops: f64,
    /// Share of motions that are joined with another one of the same caption.
    pub joins: f64,
    /// Share of motions with tokens fixed in advance.
    pub fixed: f64,
    /// Weight of the length head's cross-entropy.
    pub length: f32,
    /// Share of sentences that are phrases, where there are some for the motion, not captions.
    #[serde(default)]
    pub phrases: f64,
    /// Share of examples that are two motions of different actions, one after the other.
    #[serde(default)]
    pub sequences: f64,
    /// How far rare actions are drawn more often: by their number to the power of minus this; 0 for as often as they come.
    #[serde(default)]
    pub balance: f64,
    /// The same for rare styles among the motions of an action.
    #[serde(default)]
    pub style_balance: f64,
    /// Weight of the cross-entropies of what sentences mean.
    #[serde(default)]
    pub meaning: f32,
    /// Sentences without a meaning in a step, beside the batch.
    #[serde(default)]
    pub nonsense: usize,
    /// SHA-256 of the checkpoint whose weights the run began with; none for one that began with random ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begun_with: Option<String>,
}

impl Config {
    /// The configuration of a preset: `nano` is the model that ships, `micro` about four times that, `tiny` is for tests.
    ///
    /// # Errors
    /// [`Error::UnknownPreset`] for any other name.
    pub fn preset(name: &str) -> Result<Self, Error> {
        let sizes = |width, layers| Sizes { width, heads: 4, layers, hidden: 2 * width };
        let nano = Self {
            preset: name.to_owned(),
            architecture: Architecture { text: sizes(128, 1), planner: sizes(128, 4), max_words: 32 },
            seed: 1,
            batch: 64,
            schedule: schedule::Settings { learning_rate: 1e-3, warm_up: 300, decay: 0.4, final_rate: 0.01 },
            weight_decay: 0.02,
            clip: 1.0,
            average_decay: 0.999,
            dropout: 0.1,
            corruption: Corruption::Near,
            c: 3.0,
            a: 0.9,
            text_dropout: 0.1,
            word_dropout: 0.03,
            crops: 0.25,
            joins: 0.1,
            fixed: 0.25,
            length: 0.1,
            phrases: 0.75,
            sequences: 0.1,
            balance: 0.5,
            style_balance: 0.75,
            meaning: 0.05,
            nonsense: 16,
            begun_with: None,
        };
        match name {
            "nano" => Ok(nano),
            "micro" => {
                Ok(Self { architecture: Architecture { planner: sizes(256, 4), ..nano.architecture.clone() }, ..nano })
            }
            "tiny" => Ok(Self {
                architecture: Architecture {
                    text: Sizes { width: 8, heads: 2, layers: 1, hidden: 12 },
                    planner: Sizes { width: 12, heads: 2, layers: 2, hidden: 16 },
                    max_words: 12,
                },
                batch: 6,
                ..nano
            }),
            _ => Err(Error::UnknownPreset { name: name.to_owned(), known: "nano, micro or tiny" }),
        }
    }
}

impl Configuration for Config {
    const STATE: Format = Format { name: "motionette-prior-state", version: "1" };
    type Sources = Sources;
    type Extra = ();
    type Point = Point;
    type Evaluation = Evaluation<Report>;

    fn check(&self) -> Result<(), OutOfRange> {
        let a = &self.architecture;
        a.text.check("architecture.text")?;
        a.planner.check("architecture.planner")?;
        require((1..=64).contains(&a.max_words), "max_words", a.max_words, "1 to 64")?;
        require((1..=4096).contains(&self.batch), "batch", self.batch, "1 to 4096")?;
        require((0.0..0.9).contains(&self.dropout), "dropout", self.dropout, "0 to 0.9")?;
        let corruption = self.c > 0.0 && self.c < 1e3 && self.a > 0.0 && self.a <= 4.0;
        require(corruption, "c, a", format!("{}, {}", self.c, self.a), "c above 0, below 1000; a above 0, at most 4")?;
        for (field, share) in [
            ("text_dropout", self.text_dropout),
            ("word_dropout", self.word_dropout),
            ("crops", self.crops),
            ("joins", self.joins),
            ("fixed", self.fixed),
            ("phrases", self.phrases),
            ("sequences", self.sequences),
            ("balance", self.balance),
            ("style_balance", self.style_balance),
        ] {
            require((0.0..=1.0).contains(&share), field, share, "0 to 1")?;
        }
        require(self.nonsense <= 4096, "nonsense", self.nonsense, "at most 4096")?;
        for (field, weight) in [("length", self.length), ("meaning", self.meaning)] {
            require(weight >= 0.0 && weight.is_finite(), field, weight, "0 or more")?;
        }
        Ok(())
    }

    fn schedule(&self) -> schedule::Settings {
        self.schedule
    }

    fn optimizer(&self) -> optimizer::Settings {
        optimizer::Settings::new(self.weight_decay, self.clip, self.average_decay)
    }

    fn panels(curves: &Curves<Point, Evaluation<Report>>) -> Vec<Panel> {
        panels(curves)
    }
}
