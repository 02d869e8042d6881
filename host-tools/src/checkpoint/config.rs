//! What a tokenizer checkpoint says about itself.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::error::{ErrorKind, Result};
use super::options::Options;

/// Largest width, code count, ... that is believed; anything larger is a damaged option.
const MAX_EXTENT: usize = 1 << 16;
/// Most residual blocks a stage.
const MAX_DEPTH: usize = 16;
/// Most halvings of the frame rate.
const MAX_DOWN: usize = 4;
/// Largest dilation.
const MAX_DILATION: usize = 1 << 10;

/// Whose layout a checkpoint has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// Written by `motionette-train tokenizer`.
    #[default]
    Motionette,
    /// MoMask's RVQ-VAE.
    Momask,
    /// T2M-GPT's VQ-VAE.
    T2mGpt,
}

/// The `config` entry of a checkpoint's metadata, its values unchecked.
///
/// # Errors
/// [`ErrorKind::Option`] when the JSON is broken or not that of a `C`.
pub(in crate::checkpoint) fn parse<C: DeserializeOwned>(text: &str) -> Result<C> {
    serde_json::from_str(text).map_err(|e| ErrorKind::Option {
        key: "config".into(),
        value: e.to_string(),
        expected: "the JSON object that motionette-train writes".into(),
    })
}

/// Sizes and provenance of a tokenizer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Decoder channels.
    pub width: usize,
    /// Encoder channels.
    pub encoder_width: usize,
    /// Code width du.
    pub code_dim: usize,
    /// Codes V of each codebook.
    pub codes: usize,
    /// Codebooks, summed.
    pub quantizers: usize,
    /// Residual blocks a stage.
    pub depth: usize,
    /// Dilations in order of execution, `depth` of them.
    pub dilations: Vec<usize>,
    /// Those of the encoder, where they are not the decoder's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub encoder_dilations: Vec<usize>,
    /// Samples that each convolution with three taps of the decoder looks ahead, in order of execution: at most its dilation. None: all
    /// look as far ahead as back.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub right: Vec<usize>,
    /// Halvings of the frame rate: r = 2^down_t frames a token.
    pub down_t: usize,
    /// Features F a frame.
    pub features: usize,
    /// Frames a second.
    pub fps: f64,
    /// Name of the configuration ("nano").
    #[serde(default)]
    pub preset: String,
    /// Seed of the training run.
    #[serde(default)]
    pub seed: u64,
    /// Optimiser steps taken.
    #[serde(default)]
    pub steps: u64,
    /// Hash of the dataset it was trained on.
    #[serde(default)]
    pub data_hash: String,
    /// Revision of the trainer.
    #[serde(default)]
    pub git: Option<String>,
    /// Figures of the training run, as the trainer wrote them.
    #[serde(default)]
    pub metrics: serde_json::Value,
    /// Whose layout the file had.
    #[serde(default)]
    pub source: Source,
}

impl Config {
    /// Reads the `config` entry of our own checkpoints.
    ///
    /// # Errors
    /// [`ErrorKind::Option`] when the JSON is broken or a size is out of range.
    pub fn from_json(text: &str) -> Result<Self> {
        let config: Self = parse(text)?;
        config.check()?;
        Ok(config)
    }

    /// Reads the options of a published checkpoint. Sizes that the tensors tell (code counts, widths) must agree later.
    ///
    /// # Errors
    /// [`ErrorKind::MissingOption`], [`ErrorKind::Option`].
    pub fn from_options(options: &Options, source: Source) -> Result<Self> {
        options.require("vq_act", &["relu"])?;
        options.require("vq_norm", &["None", "null"])?;
        options.require("stride_t", &["2"])?;
        options.require("shared_codebook", &["False"])?;
        let depth = options.count("depth", MAX_DEPTH)?;
        let growth = options.count("dilation_growth_rate", MAX_DILATION)?;
        // Both repositories build the blocks ascending and reverse the list: growth^(depth-1), ..., growth, 1.
        let dilations = (0..depth)
            .rev()
            .map(|b| growth.checked_pow(b as u32).filter(|d| *d <= MAX_DILATION))
            .collect::<Option<Vec<usize>>>()
            .ok_or_else(|| ErrorKind::Option {
                key: "dilation_growth_rate".into(),
                value: growth.to_string(),
                expected: format!("dilations of at most {MAX_DILATION} with depth {depth}"),
            })?;
        let width = options.count("width", MAX_EXTENT)?;
        let quantizers = if source == Source::Momask { options.count("num_quantizers", 64)? } else { 1 };
        let config = Self {
            width,
            encoder_width: width,
            code_dim: options.count("code_dim", MAX_EXTENT)?,
            codes: options.count("nb_code", MAX_EXTENT)?,
            quantizers,
            depth,
            dilations,
            encoder_dilations: Vec::new(),
            right: Vec::new(),
            down_t: options.count("down_t", MAX_DOWN)?,
            features: 263,
            fps: 20.0,
            preset: options.text("name").unwrap_or_default().to_owned(),
            seed: options.text("seed").and_then(|s| s.parse().ok()).unwrap_or_default(),
            steps: 0,
            data_hash: String::new(),
            git: None,
            metrics: serde_json::Value::Null,
            source,
        };
        config.check()?;
        Ok(config)
    }

    /// Frames a token.
    #[must_use]
    pub fn frames_per_token(&self) -> usize {
        1 << self.down_t
    }

    /// Dilations of the encoder's residual blocks.
    #[must_use]
    pub fn encoder_dilations(&self) -> &[usize] {
        if self.encoder_dilations.is_empty() { &self.dilations } else { &self.encoder_dilations }
    }

    /// Dilations of the decoder's convolutions with three taps, in order of execution.
    fn decoder_dilations(&self) -> Vec<usize> {
        let stage = || self.dilations.iter().copied().chain([1]);
        let stages = (0..self.down_t).flat_map(|_| stage());
        std::iter::once(1).chain(stages).chain([1, 1]).collect()
    }

    /// How far each of them looks ahead.
    #[must_use]
    pub fn right(&self) -> Vec<usize> {
        if self.right.is_empty() { self.decoder_dilations() } else { self.right.clone() }
    }

    fn check(&self) -> Result<()> {
        let range = |key: &str, value: usize, max: usize| {
            if (1..=max).contains(&value) {
                return Ok(());
            }
            Err(ErrorKind::Option { key: key.into(), value: value.to_string(), expected: format!("1 to {max}") })
        };
        range("width", self.width, MAX_EXTENT)?;
        range("encoder_width", self.encoder_width, MAX_EXTENT)?;
        range("code_dim", self.code_dim, MAX_EXTENT)?;
        range("codes", self.codes, MAX_EXTENT)?;
        range("quantizers", self.quantizers, 64)?;
        range("depth", self.depth, MAX_DEPTH)?;
        range("down_t", self.down_t, MAX_DOWN)?;
        range("features", self.features, MAX_EXTENT)?;
        for &d in &self.dilations {
            range("dilations", d, MAX_DILATION)?;
        }
        if self.dilations.len() != self.depth {
            return Err(ErrorKind::Option {
                key: "dilations".into(),
                value: format!("{:?}", self.dilations),
                expected: format!("{} numbers (depth)", self.depth),
            });
        }
        range("depth of the encoder", self.encoder_dilations().len(), MAX_DEPTH)?;
        for &d in self.encoder_dilations() {
            range("encoder_dilations", d, MAX_DILATION)?;
        }
        let (right, most) = (self.right(), self.decoder_dilations());
        if right.len() != most.len() || right.iter().zip(&most).any(|(right, most)| right > most) {
            return Err(ErrorKind::Option {
                key: "right".into(),
                value: format!("{right:?}"),
                expected: format!("{} numbers, each at most the dilation: {most:?}", most.len()),
            });
        }
        if !(self.fps.is_finite() && self.fps > 0.0) {
            return Err(ErrorKind::Option {
                key: "fps".into(),
                value: self.fps.to_string(),
                expected: "a positive number".into(),
            });
        }
        Ok(())
    }
}
