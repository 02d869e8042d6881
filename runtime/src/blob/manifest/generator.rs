//! Where motion tokens come from.

use super::Reader;
use crate::nn::activation::Activation;
use crate::nn::block::{Norm, TransformerConfig};
use serde::Serialize;

/// What makes motion tokens.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub enum Generator {
    /// Nothing: requests bring them along.
    Given {
        /// Longest motion, tokens.
        max_tokens: u16,
    },
    /// Transition masked diffusion of tokens, given a text (EQUATIONS section 4).
    Tmd(PlannerConfig),
}

/// The TMD planner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlannerConfig {
    /// Longest motion, tokens.
    pub max_tokens: u16,
    /// Its blocks.
    pub transformer: TransformerConfig,
    /// Factor of the sampler's `beta(t) = c (t / (1 - t))^a`.
    pub c: f32,
    /// Its exponent.
    pub a: f32,
    /// How it is guided.
    pub guidance: Guidance,
    /// Anchor control; `None`: anchors only bend what was planned.
    pub control: Option<ControlConfig>,
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
        match from.kind("generator", 2) {
            0 => Generator::Given { max_tokens: from.short() },
            _ => Generator::Tmd(PlannerConfig::read(from)),
        }
    }

    /// Longest motion, tokens.
    #[must_use]
    pub const fn max_tokens(&self) -> u16 {
        match self {
            Generator::Given { max_tokens } => *max_tokens,
            Generator::Tmd(planner) => planner.max_tokens,
        }
    }

    /// The planner, if there is one.
    #[must_use]
    pub const fn planner(&self) -> Option<&PlannerConfig> {
        match self {
            Generator::Given { .. } => None,
            Generator::Tmd(planner) => Some(planner),
        }
    }

    /// Anchor control of the planner, if there is one.
    #[must_use]
    pub const fn control(&self) -> Option<&ControlConfig> {
        match self {
            Generator::Given { .. } => None,
            Generator::Tmd(planner) => planner.control.as_ref(),
        }
    }
}

impl PlannerConfig {
    fn read(from: &mut Reader<'_>) -> Self {
        PlannerConfig {
            max_tokens: from.short(),
            transformer: transformer(from),
            c: from.single(),
            a: from.single(),
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
