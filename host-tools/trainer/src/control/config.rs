//! What a run of control is made of: sizes, variant, anchors, loss, schedule.

use motionette_host::reference::scaffold::Statistics;
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

/// How anchors reach the frozen planner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Variant {
    /// Low-rank keys and values beside each block's own (EQUATIONS section 3). The one that ships.
    AnchorKv,
    /// Baseline: a further cross-attention behind each block.
    Cross,
    /// Baseline: a trainable copy of the blocks, joined by linears that begin at zero.
    Copy,
}

/// What the decoder is given in training, where tokens have no gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Decoded {
    /// The expected code vector, `softmax(logits) E`.
    Expected,
    /// The most probable code's vector, with the gradient of the expected one.
    Straight,
}

/// Sizes of the anchor context.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// How anchors reach the planner.
    pub variant: Variant,
    /// Whether pooled and local anchor context enter the planner's rows (dual context).
    pub context: bool,
    /// Width of a frame before frames merge to tokens.
    pub frame_width: usize,
    /// The scaffold encoder's blocks.
    pub scaffold: Sizes,
    /// Rank of AnchorKV.
    pub rank: usize,
}

/// Everything that decides a run. Two runs with equal configuration, data, prior, tokenizer and version give equal weights.
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
    /// Share of activations that the scaffold encoder's branches drop.
    pub dropout: f32,
    /// Share of prompts replaced by the empty one, for guidance.
    pub text_dropout: f64,
    /// Share of motions of which only a piece is shown, with open ends.
    pub crops: f64,
    /// Share of motions that are joined with another one of the same caption.
    pub joins: f64,
    /// Numbers of anchors, each as likely as the others.
    pub anchors: Vec<usize>,
    /// Steps in which the scaffold encoder learns alone which tokens anchors suggest, without the planner.
    pub alone: u64,
    /// Weight of the anchor loss, `lambda_anc`; 0 is off.
    pub anchor_loss: f32,
    /// Frames on either side of an anchor that the loss looks at, `delta`.
    pub support: usize,
    /// What the anchor loss decodes.
    pub decoded: Decoded,
    /// Share of motions whose anchors are places of another motion, as far away as that went.
    #[serde(default)]
    pub foreign: f64,
    /// Share of motions whose anchors are their own with a longer or shorter path, by a factor from [`SCALES`].
    #[serde(default)]
    pub scaled: f64,
    /// Where the prior is guided in one pass: share of the motions that meet their anchors which learn to say at other strengths what two passes would,
    /// by the control's own word. That feeds back: what one pass says too surely, the next is taught more so.
    #[serde(default)]
    pub guided: f64,
    /// Weight of the tokens of such motions, whose anchors they do not meet, beside 1 of the others.
    #[serde(default)]
    pub far_tokens: f32,
}

/// Factors by which a path is made shorter or longer.
pub const SCALES: [f32; 2] = [0.5, 1.6];

impl Config {
    /// The configuration of a preset: `nano` is the model that ships, `tiny` is for tests.
    ///
    /// # Errors
    /// [`Error::UnknownPreset`] for any other name.
    pub fn preset(name: &str) -> Result<Self, Error> {
        let nano = Self {
            preset: name.to_owned(),
            architecture: Architecture {
                variant: Variant::AnchorKv,
                context: true,
                frame_width: 48,
                scaffold: Sizes { width: 64, heads: 4, layers: 2, hidden: 128 },
                rank: 32,
            },
            seed: 1,
            batch: 48,
            schedule: schedule::Settings { learning_rate: 2e-3, warm_up: 100, decay: 0.5, final_rate: 0.01 },
            weight_decay: 0.01,
            clip: 1.0,
            average_decay: 0.998,
            dropout: 0.05,
            text_dropout: 0.1,
            crops: 0.15,
            joins: 0.3,
            anchors: vec![2, 4, 8, 16, 32],
            alone: 2000,
            anchor_loss: 0.3,
            support: 2,
            decoded: Decoded::Expected,
            foreign: 0.12,
            scaled: 0.1,
            guided: 0.0,
            far_tokens: 0.2,
        };
        match name {
            "nano" => Ok(nano),
            "tiny" => Ok(Self {
                architecture: Architecture {
                    frame_width: 6,
                    scaffold: Sizes { width: 8, heads: 2, layers: 1, hidden: 12 },
                    rank: 4,
                    ..nano.architecture
                },
                batch: 6,
                alone: 2,
                ..nano
            }),
            _ => Err(Error::UnknownPreset { name: name.to_owned(), known: "nano or tiny" }),
        }
    }
}

impl Configuration for Config {
    const STATE: Format = Format { name: "motionette-control-state", version: "1" };
    type Sources = Sources;
    type Extra = Statistics;
    type Point = Point;
    type Evaluation = Evaluation<Report>;

    fn check(&self) -> Result<(), OutOfRange> {
        let Architecture { scaffold, frame_width, rank, .. } = &self.architecture;
        scaffold.check("architecture.scaffold")?;
        for (field, value) in [("architecture.frame_width", frame_width), ("architecture.rank", rank)] {
            require((1..=1024).contains(value), field, value, "1 to 1024")?;
        }
        require((1..=4096).contains(&self.batch), "batch", self.batch, "1 to 4096")?;
        require((0.0..0.9).contains(&self.dropout), "dropout", self.dropout, "0 to 0.9")?;
        let shares = [
            ("text_dropout", self.text_dropout),
            ("crops", self.crops),
            ("joins", self.joins),
            ("foreign", self.foreign),
            ("scaled", self.scaled),
            ("guided", self.guided),
            ("far_tokens", f64::from(self.far_tokens)),
        ];
        for (field, share) in shares {
            require((0.0..=1.0).contains(&share), field, share, "0 to 1")?;
        }
        let own = 1.0 - self.foreign;
        require(self.scaled <= own, "scaled", self.scaled, "at most what `foreign` leaves")?;
        let counts = !self.anchors.is_empty() && self.anchors.iter().all(|k| (1..=32).contains(k));
        require(counts, "anchors", format!("{:?}", self.anchors), "numbers from 1 to 32, at least one")?;
        let weight = self.anchor_loss >= 0.0 && self.anchor_loss.is_finite();
        require(weight, "anchor_loss", self.anchor_loss, "0 or more")?;
        require(self.support <= 20, "support", self.support, "0 to 20")
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
