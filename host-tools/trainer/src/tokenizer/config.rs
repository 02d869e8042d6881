//! What a tokenizer run is made of: sizes, schedule, loss weights.

use serde::{Deserialize, Serialize};

use super::curves::{Evaluation, Point, panels};
use super::quantizer::Codebook;
use crate::chart::Panel;
use crate::harness::configuration::DatasetHash;
use crate::harness::{Configuration, Curves, Error};
use crate::setting::{OutOfRange, require};
use crate::tensor_file::Format;
use crate::{optimizer, schedule};

/// Features of one frame (EQUATIONS section 1).
pub const FEATURES: usize = 263;
/// Frames per second.
pub const FPS: usize = 20;
/// Stages that halve (encoder) or double (decoder) the number of samples.
pub const DOWN_T: usize = 2;
/// Frames a token stands for.
pub const FRAMES_PER_TOKEN: usize = 1 << DOWN_T;
/// Longest motion of a model: 49 tokens.
pub const MAX_FRAMES: usize = 196;

/// Sizes of the networks. The topology is MoMask's and fixed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Architecture {
    /// Channels of the decoder.
    pub width: usize,
    /// Channels of the encoder, which never leaves the host.
    pub encoder_width: usize,
    /// Width of a code.
    pub code_dim: usize,
    /// Rows of the codebook.
    pub codes: usize,
    /// Dilations of the residual blocks of a stage, in the order of execution.
    pub dilations: Vec<usize>,
    /// The encoder's, where they are not the decoder's. It never leaves the host, and may look as far as it likes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub encoder_dilations: Vec<usize>,
    /// Samples that each convolution with three taps of the decoder looks ahead, in the order of execution: from 0 to its dilation.
    /// What it does not look ahead it looks back, twice its dilation in all. None: all look as far ahead as back.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub right: Vec<usize>,
}

impl Architecture {
    /// Dilations of the encoder's residual blocks.
    pub fn encoder_dilations(&self) -> &[usize] {
        if self.encoder_dilations.is_empty() { &self.dilations } else { &self.encoder_dilations }
    }

    /// Dilations of the decoder's convolutions with three taps, in the order of execution.
    fn decoder_dilations(&self) -> Vec<usize> {
        let stage = || self.dilations.iter().copied().chain([1]);
        let stages = (0..DOWN_T).flat_map(|_| stage());
        std::iter::once(1).chain(stages).chain([1, 1]).collect()
    }

    /// How far each of them looks ahead.
    pub fn decoder_right(&self) -> Vec<usize> {
        if self.right.is_empty() { self.decoder_dilations() } else { self.right.clone() }
    }

    /// Frames by which the decoder's output lags behind its tokens: frame t depends on frames to t plus so many.
    pub fn look_ahead_frames(&self) -> usize {
        let right = self.decoder_right();
        let mut right = right.iter();
        let mut ahead = |count: usize| right.by_ref().take(count).sum::<usize>();
        let mut lag = ahead(1);
        for _ in 0..DOWN_T {
            lag += ahead(self.dilations.len());
            // A sample that is yet to come is now two.
            lag = 2 * lag + ahead(1);
        }
        lag + ahead(2)
    }

    /// The same in tokens, rounded up.
    pub fn look_ahead_tokens(&self) -> usize {
        self.look_ahead_frames().div_ceil(FRAMES_PER_TOKEN)
    }

    fn check(&self) -> Result<(), OutOfRange> {
        let widths = [("width", self.width), ("encoder_width", self.encoder_width), ("code_dim", self.code_dim)];
        for (field, width) in widths {
            require((1..=1024).contains(&width), field, width, "1 to 1024")?;
        }
        require((2..=65536).contains(&self.codes), "codes", self.codes, "2 to 65536")?;
        for (field, dilations) in [("dilations", &*self.dilations), ("encoder_dilations", self.encoder_dilations())] {
            let fits = (1..=8).contains(&dilations.len()) && dilations.iter().all(|d| (1..=64).contains(d));
            require(fits, field, format!("{dilations:?}"), "1 to 8 values, each 1 to 64")?;
        }
        let (right, dilations) = (self.decoder_right(), self.decoder_dilations());
        let fits = right.len() == dilations.len() && right.iter().zip(&dilations).all(|(right, most)| right <= most);
        let allowed = "one value for each convolution with three taps of the decoder, each 0 to its dilation";
        require(fits, "right", format!("{right:?}"), allowed)
    }
}

/// Weights of the terms of the objective, see [`super::loss`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LossWeights {
    /// Smooth-L1 on normalised features, one share a group: yaw velocity, planar velocity, height, local positions, rotations,
    /// velocities, contacts.
    pub groups: [f32; 7],
    /// Mean distance of local joint positions, per metre.
    pub position: f32,
    /// Mean square of that distance, per square metre: what is far off, a leg that kicks, counts for more than a little everywhere.
    #[serde(default)]
    pub square: f32,
    /// Mean change of that error from frame to frame, per metre.
    pub velocity: f32,
    /// Mean error of the bones' lengths, per metre; configurations from before this term have none.
    #[serde(default)]
    pub bones: f32,
    /// Mean change of the velocity of legs whose clips say nothing of them, per metre a frame squared; none before this term.
    #[serde(default)]
    pub legs: f32,
    /// Share of their usual weight that features have whose clips made them up: of legs and contacts of a Kinect.
    #[serde(default)]
    pub made_up: f32,
    /// Mean distance of the rolled-out root on the floor, per metre.
    pub root: f32,
    /// Mean error of the rolled-out heading, per radian.
    pub heading: f32,
    /// Commitment: mean squared distance of latents to their codes.
    pub commitment: f32,
}

/// Everything that decides a run. Two runs with equal configuration, data and version give equal weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the preset the configuration began as.
    pub preset: String,
    /// Sizes.
    pub architecture: Architecture,
    /// Seed of weights, batches and code resets.
    pub seed: u64,
    /// Crops in a batch.
    pub batch: usize,
    /// Frames of a crop, a multiple of 4.
    pub window: usize,
    /// Largest learning rate.
    pub learning_rate: f32,
    /// Steps of linear warm-up.
    pub warm_up: u64,
    /// Last share of the steps, in which the learning rate falls along a cosine.
    pub decay: f64,
    /// Learning rate at the end as a share of the largest.
    pub final_rate: f32,
    /// Decoupled weight decay.
    pub weight_decay: f32,
    /// Largest global norm of the gradient.
    pub clip: f32,
    /// Decay of the averaged weights, which become the checkpoint.
    pub average_decay: f32,
    /// Steps before quantisation begins; then the codebook starts from k-means over latents.
    pub quantize_from: u64,
    /// Decay of the codebook's running sums.
    pub codebook_decay: f32,
    /// A code whose running count of tokens a batch falls below this is dead and moves to a latent of the batch.
    pub dead_below: f32,
    /// How far rare actions are drawn more often: by the frames of theirs to the power of minus this; 0 for as often as they come.
    #[serde(default)]
    pub balance: f64,
    /// SHA-256 of the checkpoint whose weights the run began with; none for one that began with random ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begun_with: Option<String>,
    /// Loss weights.
    pub loss: LossWeights,
}

impl Config {
    /// The configuration of a preset: `nano` is the model that ships, `tiny` is for tests.
    ///
    /// # Errors
    /// [`Error::UnknownPreset`] for any other name.
    pub fn preset(name: &str) -> Result<Self, Error> {
        let nano = Self {
            preset: name.to_owned(),
            architecture: Architecture {
                width: 96,
                encoder_width: 160,
                code_dim: 32,
                codes: 512,
                dilations: vec![9, 3, 1],
                encoder_dilations: Vec::new(),
                right: Vec::new(),
            },
            seed: 1,
            batch: 24,
            window: 80,
            learning_rate: 1e-3,
            warm_up: 200,
            decay: 0.35,
            final_rate: 0.01,
            weight_decay: 0.01,
            clip: 1.0,
            average_decay: 0.999,
            quantize_from: 400,
            codebook_decay: 0.99,
            dead_below: 0.1,
            balance: 0.0,
            begun_with: None,
            loss: LossWeights {
                groups: [0.15, 0.15, 0.05, 0.40, 0.10, 0.12, 0.03],
                position: 2.0,
                square: 0.0,
                velocity: 2.0,
                bones: 4.0,
                legs: 2.0,
                made_up: 0.1,
                root: 1.0,
                heading: 0.5,
                commitment: 0.1,
            },
        };
        match name {
            "nano" => Ok(nano),
            "tiny" => Ok(Self {
                architecture: Architecture {
                    width: 8,
                    encoder_width: 12,
                    code_dim: 4,
                    codes: 8,
                    dilations: vec![3, 1],
                    ..nano.architecture
                },
                batch: 4,
                window: 16,
                warm_up: 2,
                quantize_from: 3,
                ..nano
            }),
            _ => Err(Error::UnknownPreset { name: name.to_owned(), known: "nano or tiny" }),
        }
    }
}

impl Configuration for Config {
    const STATE: Format = Format { name: "motionette-tokenizer-state", version: "1" };
    type Sources = DatasetHash;
    type Extra = Option<Codebook>;
    type Point = Point;
    type Evaluation = Evaluation;

    fn check(&self) -> Result<(), OutOfRange> {
        self.architecture.check()?;
        require((1..=4096).contains(&self.batch), "batch", self.batch, "1 to 4096")?;
        let window = self.window.is_multiple_of(FRAMES_PER_TOKEN) && (8..=MAX_FRAMES).contains(&self.window);
        require(window, "window", self.window, "a multiple of 4 from 8 to 196")?;
        require((0.0..1.0).contains(&self.codebook_decay), "codebook_decay", self.codebook_decay, "0 to 1")?;
        require((0.0..=1.0).contains(&self.balance), "balance", self.balance, "0 to 1")?;
        let l = &self.loss;
        let terms = [l.position, l.square, l.velocity, l.bones, l.legs, l.made_up, l.root, l.heading, l.commitment];
        let weights = l.groups.iter().chain(&terms).all(|w| w.is_finite() && *w >= 0.0);
        require(weights, "loss", format!("{l:?}"), "weights that are finite and not negative")
    }

    fn schedule(&self) -> schedule::Settings {
        let Self { learning_rate, warm_up, decay, final_rate, .. } = *self;
        schedule::Settings { learning_rate, warm_up, decay, final_rate }
    }

    fn optimizer(&self) -> optimizer::Settings {
        optimizer::Settings::new(self.weight_decay, self.clip, self.average_decay)
    }

    fn panels(curves: &Curves<Point, Evaluation>) -> Vec<Panel> {
        panels(curves)
    }
}
