//! The anchor control of a prior in memory, put together from named tensors: scaffold encoder, keys and values for every layer of the
//! planner, dual context (EQUATIONS section 3).
//!
//! A control belongs to one prior, whose weights it leaves as they are; it names that prior and its tokenizer by hash. The order in which
//! [`ControlCheckpoint::parts`] lists the parts is that of a blob.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::anchors::{Family, Statistics, VALUES, WIDTH};
use super::config::parse;
use super::error::{Error, ErrorKind, Result};
use super::prior::config::{MAX_EXTENT, MAX_LAYERS, MAX_LENGTH, check_extent, check_positive};
use super::prior::{
    Activation, Block, Builder, Embedding, Form, LayerNorm, Linear, NormOrder, Part, PartMut, PriorCheckpoint, Sizes,
};
use super::tensors::TensorMap;
use super::tokenizer::TokenizerCheckpoint;
use crate::input;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-control";
/// Value of `version` in the metadata.
pub const VERSION: &str = "1";
/// Frames that are merged into a row of the scaffold: those of a token.
pub const FRAMES: usize = 4;

/// Sizes and provenance of a control.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ControlConfig {
    /// Longest motion, tokens.
    pub max_tokens: usize,
    /// Width of a frame before frames are merged.
    pub frame_width: usize,
    /// The scaffold encoder.
    pub scaffold: Sizes,
    /// Rank of the projections to keys and values.
    pub rank: usize,
    /// Width of the planner.
    pub planner_width: usize,
    /// Layers of the planner.
    pub planner_layers: usize,
    /// What norms add to the variance.
    pub epsilon: f64,
    /// Where the norms stand.
    pub norm: NormOrder,
    /// Nonlinearity of the feed-forward sublayers.
    pub activation: Activation,
    /// Whether there is a dual context: anchors that speak to the planner's rows as well.
    pub context: bool,
    /// Control families it was trained with; anchors of others do not enter the scaffold.
    pub families: Vec<Family>,
    /// SHA-256, hex, of the tokenizer's codebook, as in [`super::PriorConfig`].
    pub tokenizer: String,
    /// [`PriorCheckpoint::weights_hash`] of the prior it was trained on.
    pub prior: String,
}

impl ControlConfig {
    /// Reads the `config` entry of a checkpoint; entries of other names are ignored.
    ///
    /// # Errors
    /// [`ErrorKind::Option`] when the JSON is broken or a value is out of range.
    pub fn from_json(text: &str) -> Result<Self> {
        let config: Self = parse(text)?;
        config.check()?;
        Ok(config)
    }

    /// What the blocks of the scaffold encoder have in common.
    #[must_use]
    pub fn form(&self) -> Form {
        Form { epsilon: self.epsilon, norm: self.norm, activation: self.activation }
    }

    /// Refuses sizes that no control has.
    ///
    /// # Errors
    /// [`ErrorKind::Option`], naming the first of them.
    pub fn check(&self) -> Result<()> {
        check_extent("max_tokens", self.max_tokens, MAX_LENGTH)?;
        check_extent("frame_width", self.frame_width, MAX_EXTENT)?;
        self.scaffold.check("scaffold")?;
        check_extent("rank", self.rank, MAX_EXTENT)?;
        check_extent("planner_width", self.planner_width, MAX_EXTENT)?;
        check_extent("planner_layers", self.planner_layers, MAX_LAYERS)?;
        check_positive("epsilon", self.epsilon)?;
        let twice = |i: usize, family: &Family| self.families[..i].contains(family);
        if self.families.is_empty() || self.families.iter().enumerate().any(|(i, family)| twice(i, family)) {
            let expected = "one or more of root3d, planar and body, each once".into();
            let value = format!("{:?}", self.families);
            return Err(ErrorKind::Option { key: "families".into(), value, expected });
        }
        Ok(())
    }
}

/// Rows of the scaffold to keys and values of one layer of the planner.
#[derive(Debug, Clone, PartialEq)]
pub struct AnchorKeyValue {
    /// Width of the scaffold to rank.
    pub down: Linear,
    /// Rank to 2 d: keys, then values.
    pub key_value: Linear,
}

/// What anchors add to the rows of the planner.
#[derive(Debug, Clone, PartialEq)]
pub struct DualContext {
    /// Mean row of the scaffold to the hidden row of the global context.
    pub expand: Linear,
    /// The hidden row, behind GELU, to d: added to row 0.
    pub contract: Linear,
    /// A row of the scaffold to d: added to the row of its token.
    pub local: Linear,
}

/// A control read from a checkpoint, checked: every tensor present, of the shape the configuration says, finite.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlCheckpoint {
    /// Sizes and provenance.
    pub config: ControlConfig,
    /// Scale of the anchors' coordinates.
    pub statistics: Statistics,
    /// Features of a frame to the width of a frame.
    pub frame: Linear,
    /// [`FRAMES`] frames to a row of the scaffold.
    pub merge: Linear,
    /// A row a place from the start.
    pub position: Embedding,
    /// In order of execution.
    pub layers: Vec<Block>,
    /// Behind the last layer.
    pub norm: LayerNorm,
    /// One a layer of the planner.
    pub anchors: Vec<AnchorKeyValue>,
    /// Dual context, where there is one.
    pub context: Option<DualContext>,
}

/// Reads a control checkpoint (`nano.control.safetensors`).
///
/// # Errors
/// [`Error`] with the path and what is wrong.
pub fn load(path: &Path) -> core::result::Result<ControlCheckpoint, Error> {
    let read = || of_bytes(&input::read(path, input::ANY)?);
    read().map_err(|kind| Error { path: path.to_owned(), kind })
}

/// Reads one that is in memory; errors call it `name`.
///
/// # Errors
/// As [`load`].
pub fn from_bytes(bytes: &[u8], name: &str) -> core::result::Result<ControlCheckpoint, Error> {
    of_bytes(bytes).map_err(|kind| Error { path: name.into(), kind })
}

fn of_bytes(bytes: &[u8]) -> Result<ControlCheckpoint> {
    let (map, config) = super::of_format(bytes, FORMAT, VERSION)?;
    ControlCheckpoint::build(&map, ControlConfig::from_json(&config)?)
}

impl ControlCheckpoint {
    /// Puts a control together and checks every tensor against `config`.
    ///
    /// # Errors
    /// The first tensor that is missing, misshapen or not finite, by name; [`ErrorKind::Std`] for a deviation that is not positive;
    /// [`ErrorKind::Option`] for a configuration out of range.
    pub fn build(map: &TensorMap, config: ControlConfig) -> Result<Self> {
        config.check()?;
        let builder = Builder { map };
        let (width, frame, rank, d) = (config.scaffold.width, config.frame_width, config.rank, config.planner_width);
        let statistics = Statistics {
            mean: builder.tensor("control.mean", &[VALUES])?,
            std: builder.tensor("control.std", &[VALUES])?,
        };
        if let Some(index) = statistics.std.iter().position(|s| !(s.is_normal() && *s > 0.0)) {
            let value = statistics.std[index];
            return Err(ErrorKind::Std { tensor: "control.std".into(), index, value });
        }
        let anchors = |m: usize| -> Result<AnchorKeyValue> {
            Ok(AnchorKeyValue {
                down: builder.linear(format!("control.anchor.{m}.down"), rank, width)?,
                key_value: builder.linear(format!("control.anchor.{m}.kv"), 2 * d, rank)?,
            })
        };
        let context = || -> Result<DualContext> {
            Ok(DualContext {
                expand: builder.linear("control.global.in".into(), width, width)?,
                contract: builder.linear("control.global.out".into(), d, width)?,
                local: builder.linear("control.local".into(), d, width)?,
            })
        };
        Ok(Self {
            statistics,
            frame: builder.linear("control.frame".into(), frame, WIDTH)?,
            merge: builder.linear("control.merge".into(), width, FRAMES * frame)?,
            position: builder.embedding("control.position", config.max_tokens, width)?,
            layers: builder.layers("control", config.scaffold, None)?,
            norm: builder.norm("control.norm".into(), width)?,
            anchors: (0..config.planner_layers).map(anchors).collect::<Result<_>>()?,
            context: config.context.then(context).transpose()?,
            config,
        })
    }

    /// Refuses a prior and a tokenizer other than those it was trained on.
    ///
    /// # Errors
    /// [`ErrorKind::Option`] when the sizes differ, [`ErrorKind::OtherTokenizer`], [`ErrorKind::OtherPrior`] when the weights do.
    pub fn check_prior(&self, prior: &PriorCheckpoint, tokenizer: &TokenizerCheckpoint) -> Result<()> {
        let (c, p) = (&self.config, &prior.config);
        let sizes = [
            ("planner_width", c.planner_width, p.planner.width, "prior"),
            ("planner_layers", c.planner_layers, p.planner.layers, "prior"),
            ("max_tokens", c.max_tokens, p.max_tokens, "prior"),
            ("frames a token", FRAMES, tokenizer.config.frames_per_token(), "tokenizer"),
        ];
        for (key, value, expected, of) in sizes {
            if value != expected {
                let expected = format!("{expected}, as the {of} has");
                return Err(ErrorKind::Option { key: key.into(), value: value.to_string(), expected });
            }
        }
        if c.tokenizer != p.tokenizer {
            return Err(ErrorKind::OtherTokenizer { expected: c.tokenizer.clone(), actual: p.tokenizer.clone() });
        }
        let actual = prior.weights_hash();
        if c.prior != actual {
            return Err(ErrorKind::OtherPrior { expected: c.prior.clone(), actual });
        }
        Ok(())
    }

    /// All parts but the statistics, in the order of a blob.
    #[must_use]
    pub fn parts(&self) -> Vec<Part<'_>> {
        let mut parts = vec![Part::Linear(&self.frame), Part::Linear(&self.merge), Part::Embedding(&self.position)];
        self.layers.iter().for_each(|b| b.parts(&mut parts));
        parts.push(Part::Norm(&self.norm));
        parts.extend(self.anchors.iter().flat_map(|a| [&a.down, &a.key_value]).map(Part::Linear));
        parts.extend(self.context.iter().flat_map(|c| [&c.expand, &c.contract, &c.local]).map(Part::Linear));
        parts
    }

    /// The same parts, to change them.
    #[must_use]
    pub fn parts_mut(&mut self) -> Vec<PartMut<'_>> {
        let mut parts = vec![
            PartMut::Linear(&mut self.frame),
            PartMut::Linear(&mut self.merge),
            PartMut::Embedding(&mut self.position),
        ];
        self.layers.iter_mut().for_each(|b| b.parts_mut(&mut parts));
        parts.push(PartMut::Norm(&mut self.norm));
        let anchors = self.anchors.iter_mut().flat_map(|a| [&mut a.down, &mut a.key_value]);
        parts.extend(anchors.map(PartMut::Linear));
        let context = self.context.iter_mut().flat_map(|c| [&mut c.expand, &mut c.contract, &mut c.local]);
        parts.extend(context.map(PartMut::Linear));
        parts
    }
}
