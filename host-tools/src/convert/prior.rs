//! The prior and its anchor control in integers: linears and tables int8 with one scale a row, norms as they are.

use crate::checkpoint::prior::{Embedding, LayerNorm, Part, PartMut};
use crate::checkpoint::{ControlCheckpoint, PriorCheckpoint};

use super::conv1d::{Options, QuantisedConv1d};

/// One part as the blob stores it.
#[derive(Debug, Clone, PartialEq)]
pub enum QuantisedPart {
    /// A linear: a convolution of one tap.
    Linear(QuantisedConv1d),
    /// A table: its rows are outputs of a convolution of one tap whose bias says nothing.
    Table(QuantisedConv1d),
    /// A norm.
    Norm(LayerNorm),
}

/// Text encoder, planner and anchor control in integers.
#[derive(Debug, Clone, PartialEq)]
pub struct QuantisedPrior {
    /// Parts of the text encoder, in the order of a blob; the last one is the length head.
    pub text: Vec<QuantisedPart>,
    /// Parts of the planner, in the order of a blob.
    pub planner: Vec<QuantisedPart>,
    /// Parts of the anchor control, in the order of a blob; empty without one.
    pub control: Vec<QuantisedPart>,
}

/// Rounds every linear and every table to nearest.
#[must_use]
pub fn quantise(checkpoint: &PriorCheckpoint, control: Option<&ControlCheckpoint>) -> QuantisedPrior {
    let all = |parts: Vec<Part<'_>>| parts.into_iter().map(part).collect();
    QuantisedPrior {
        text: all(checkpoint.text_parts()),
        planner: all(checkpoint.planner_parts()),
        control: all(control.map(ControlCheckpoint::parts).unwrap_or_default()),
    }
}

fn part(part: Part<'_>) -> QuantisedPart {
    match part {
        Part::Linear(linear) => {
            QuantisedPart::Linear(QuantisedConv1d::new(&linear.as_convolution(), 0, &Options::PLAIN, None))
        }
        Part::Embedding(table) => {
            QuantisedPart::Table(QuantisedConv1d::new(&table.as_convolution(), 0, &Options::PLAIN, None))
        }
        Part::Norm(norm) => QuantisedPart::Norm(norm.clone()),
    }
}

/// The prior that the integers stand for, to run in the reference.
#[must_use]
pub fn dequantised(checkpoint: &PriorCheckpoint, quantised: &QuantisedPrior) -> PriorCheckpoint {
    let mut result = checkpoint.clone();
    for (to, from) in result.parts_mut().into_iter().zip(quantised.text.iter().chain(&quantised.planner)) {
        match (to, from) {
            (PartMut::Linear(to), QuantisedPart::Linear(from)) => {
                let back = from.dequantised();
                (to.weight, to.bias) = (back.weight, back.bias);
            }
            (PartMut::Embedding(Embedding { weight, .. }), QuantisedPart::Table(from)) => {
                *weight = from.dequantised().weight;
            }
            (PartMut::Norm(to), QuantisedPart::Norm(from)) => to.clone_from(from),
            // Both lists come from the same walk over the parts.
            _ => {}
        }
    }
    result
}
