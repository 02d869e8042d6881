//! Where motion tokens come from.

use super::Reader;
use crate::nn::activation::Activation;
use crate::nn::block::{Norm, TransformerConfig};
use serde::{Serialize, Serializer};

/// What makes motion tokens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Generator {
    /// Nothing: requests bring them along.
    Given {
        /// Longest motion, tokens.
        max_tokens: u16,
    },
    /// Given a text: transition masked diffusion of tokens (EQUATIONS section 4), or all of them at once, the least certain ones again.
    Words(PlannerConfig),
    /// All tokens at once, the least certain ones again (MoMask 3.4, ControlMM 3.1), given a vector.
    Masked(PrefixConfig),
    /// A token at a time until the class that ends the motion (T2M-GPT 3.2), given a vector.
    Autoregressive(PrefixConfig),
}

/// A planner in front of whose tokens one row says what is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PrefixConfig {
    /// Longest motion, tokens.
    pub max_tokens: u16,
    /// Its blocks.
    pub transformer: TransformerConfig,
    /// How rows become logits.
    pub head: HeadConfig,
    /// Guidance that it is made for, 1 for none; two passes, the second given a vector of zeros.
    pub guidance: f32,
    /// What plans the codes of the further quantizers; `None`: they add nothing.
    pub residual: Option<ResidualConfig>,
}

/// What comes behind the last block.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub enum HeadConfig {
    /// A norm with the blocks' epsilon, then logits.
    Norm,
    /// A linear layer, GELU, a norm, then logits.
    Dense {
        /// Added to the variance under the norm's root.
        epsilon: f32,
    },
}

impl Default for HeadConfig {
    /// What stands where a manifest could not be read.
    fn default() -> Self {
        HeadConfig::Norm
    }
}

/// The planner of all quantizers but the first, a pass each (MoMask 3.4).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ResidualConfig {
    /// Its blocks.
    pub transformer: TransformerConfig,
    /// Added to the variance under the root of the norm in front of the logits.
    pub epsilon: f32,
    /// Guidance that it is made for, as [`PrefixConfig::guidance`].
    pub guidance: f32,
}

/// A planner that reads a text, and anchors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlannerConfig {
    /// Longest motion, tokens.
    pub max_tokens: u16,
    /// Its blocks.
    pub transformer: TransformerConfig,
    /// What it makes tokens of.
    pub corruption: Corruption,
    /// How it is guided.
    pub guidance: Guidance,
    /// Anchor control; `None`: anchors only bend what was planned.
    pub control: Option<ControlConfig>,
}

/// What a planner makes tokens of; which one it is says the kind of the generator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Corruption {
    /// Random tokens, which move to near codes (TMD).
    Near {
        /// Factor of the sampler's `beta(t) = c (t / (1 - t))^a`.
        c: f32,
        /// Its exponent.
        a: f32,
    },
    /// Masked ones: token V, behind the codes, which is filled in.
    Masks,
}

/// How a planner is guided towards what is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Guidance {
    /// Two passes, with and without what is asked for: `none + g (conditioned - none)`.
    TwoPass,
    /// One pass, to which the strength is told.
    OnePass,
}

/// How anchors reach the planner: scaffold encoder, AnchorKV, dual context (EQUATIONS section 3).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ControlConfig {
    /// Blocks of the scaffold encoder.
    pub scaffold: TransformerConfig,
    /// Width of a frame's features behind the first layer.
    pub frame_width: u16,
    /// Rank of the projections to keys and values, `r`.
    pub rank: u16,
    /// Whether anchors also join the planner's rows (dual context).
    pub context: bool,
    /// Families of anchors it was trained for, a set of bits: 1 Root-3D, 2 Planar-root, 4 Body-point.
    pub families: u8,
}

impl Generator {
    pub(super) fn read(from: &mut Reader<'_>) -> Self {
        match from.kind("generator", 5) {
            0 => Generator::Given { max_tokens: from.short() },
            1 => Generator::Words(PlannerConfig::read(from, false)),
            2 if cfg!(feature = "masked") => Generator::Masked(PrefixConfig::read(from)),
            3 if cfg!(feature = "autoregressive") => Generator::Autoregressive(PrefixConfig::read(from)),
            3 => from.not_linked("autoregressive"),
            4 if cfg!(feature = "masked") => Generator::Words(PlannerConfig::read(from, true)),
            _ => from.not_linked("masked"),
        }
    }

    /// Longest motion, tokens.
    #[must_use]
    pub const fn max_tokens(&self) -> u16 {
        match self {
            Generator::Given { max_tokens } => *max_tokens,
            Generator::Words(planner) => planner.max_tokens,
            Generator::Masked(planner) | Generator::Autoregressive(planner) => planner.max_tokens,
        }
    }

    /// The planner that reads a text, if it is one.
    #[must_use]
    pub const fn planner(&self) -> Option<&PlannerConfig> {
        if let Generator::Words(planner) = self { Some(planner) } else { None }
    }

    /// The planner that is given a vector, if it is one.
    #[must_use]
    pub const fn prefix(&self) -> Option<&PrefixConfig> {
        if let Generator::Masked(planner) | Generator::Autoregressive(planner) = self { Some(planner) } else { None }
    }

    /// Anchor control of the planner, if there is one.
    #[must_use]
    pub const fn control(&self) -> Option<&ControlConfig> {
        if let Generator::Words(planner) = self { planner.control.as_ref() } else { None }
    }
}

// Masked tokens came behind the kinds of other planners, so that a text's planner has two of them.
impl Serialize for Generator {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let name = "Generator";
        match self {
            Generator::Given { max_tokens } => to.serialize_newtype_variant(name, 0, "Given", max_tokens),
            Generator::Words(planner) => match planner.corruption {
                Corruption::Near { .. } => to.serialize_newtype_variant(name, 1, "Words", planner),
                Corruption::Masks => to.serialize_newtype_variant(name, 4, "Words", planner),
            },
            Generator::Masked(planner) => to.serialize_newtype_variant(name, 2, "Masked", planner),
            Generator::Autoregressive(planner) => to.serialize_newtype_variant(name, 3, "Autoregressive", planner),
        }
    }
}

impl Default for Generator {
    /// Nothing, of no length: what stands where a manifest could not be read.
    fn default() -> Self {
        Generator::Given { max_tokens: 0 }
    }
}

impl PrefixConfig {
    fn read(from: &mut Reader<'_>) -> Self {
        PrefixConfig {
            max_tokens: from.short(),
            transformer: transformer(from),
            head: match from.kind("generator.head", 2) {
                0 => HeadConfig::Norm,
                _ if cfg!(feature = "masked") => HeadConfig::Dense { epsilon: from.single() },
                _ => from.not_linked("masked"),
            },
            guidance: from.single(),
            residual: ResidualConfig::read(from),
        }
    }
}

impl ResidualConfig {
    fn read(from: &mut Reader<'_>) -> Option<Self> {
        if from.kind("generator.residual", 2) == 0 {
            return None;
        }
        if !cfg!(feature = "residual") {
            return from.not_linked("residual");
        }
        Some(ResidualConfig { transformer: transformer(from), epsilon: from.single(), guidance: from.single() })
    }
}

impl PlannerConfig {
    fn read(from: &mut Reader<'_>, masks: bool) -> Self {
        PlannerConfig {
            max_tokens: from.short(),
            transformer: transformer(from),
            corruption: match masks {
                false => Corruption::Near { c: from.single(), a: from.single() },
                true => Corruption::Masks,
            },
            guidance: Guidance::read(from),
            control: ControlConfig::read(from),
        }
    }
}

impl Guidance {
    fn read(from: &mut Reader<'_>) -> Self {
        match from.kind("generator.guidance", 2) {
            0 => Guidance::TwoPass,
            _ => Guidance::OnePass,
        }
    }
}

impl ControlConfig {
    fn read(from: &mut Reader<'_>) -> Option<Self> {
        if from.kind("generator.control", 2) == 0 {
            return None;
        }
        Some(ControlConfig {
            scaffold: transformer(from),
            frame_width: from.short(),
            rank: from.short(),
            context: from.take(),
            families: from.byte(),
        })
    }
}

/// Shape of a stack of transformer blocks.
#[inline(never)]
pub(super) fn transformer(from: &mut Reader<'_>) -> TransformerConfig {
    TransformerConfig {
        width: from.short(),
        heads: from.byte(),
        layers: from.byte(),
        hidden: from.short(),
        norm: match from.kind("transformer.norm", 2) {
            0 => Norm::Pre,
            _ => Norm::Post,
        },
        activation: match from.kind("transformer.activation", 2) {
            0 => Activation::Relu,
            _ => Activation::Gelu,
        },
        epsilon: from.single(),
    }
}
