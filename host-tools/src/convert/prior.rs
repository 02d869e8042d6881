//! The prior and its anchor control in integers: linears and tables in int8 with one scale per row, norms in f32 as they are; the linears
//! of the planner's blocks in 4 bits where the options say so.

use std::collections::HashMap;

use motionette::kernels::GROUP;
use motionette::numerics::hash::Stream;

use crate::blob::QuantisedConv1d;
use crate::checkpoint::prior::{Embedding, LayerNorm, Part, PartMut, TIMES};
use crate::checkpoint::{ControlCheckpoint, Conv1d, PriorCheckpoint, TokenizerCheckpoint};
use crate::dataset::captioned::CaptionedMotion;
use crate::reference::Prior;

use super::conv1d::Options;
use super::moments::Moments;

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

/// Rows that a linear reads, one behind another, by its name.
pub type Inputs = HashMap<String, Vec<f32>>;

/// What the linears of the planner's blocks read when `cases` are planned, at one time each.
#[must_use]
pub fn inputs(checkpoint: &PriorCheckpoint, tokenizer: &TokenizerCheckpoint, cases: &[CaptionedMotion]) -> Inputs {
    let prior = Prior::<f32>::new(checkpoint, tokenizer);
    let numbered: Vec<(usize, &CaptionedMotion)> = cases.iter().enumerate().collect();
    let seen = crate::parallel::map(&numbered, |&(i, case)| {
        let time = (i % TIMES) as f64 / TIMES as f64;
        let tokens = prior.sampler.corrupt(&case.tokens, time, &mut Stream::new(i as u64));
        let mut seen = Vec::new();
        prior.observe(&case.words, &tokens, time, &mut |name, rows| seen.push((name, rows.to_vec())));
        seen
    });
    let mut all = Inputs::new();
    for (name, rows) in seen.into_iter().flatten() {
        all.entry(name).or_default().extend(rows);
    }
    all
}

/// Rounds every linear and every table to nearest, 4-bit ones as `options` say, with what is known of their `inputs`.
#[must_use]
pub fn quantise(
    checkpoint: &PriorCheckpoint,
    control: Option<&ControlCheckpoint>,
    options: &Options,
    inputs: &Inputs,
) -> QuantisedPrior {
    let all = |parts: Vec<Part<'_>>| crate::parallel::map(&parts, |part| quantised(*part, options, inputs));
    QuantisedPrior {
        text: all(checkpoint.text_parts()),
        planner: all(checkpoint.planner_parts()),
        control: all(control.map(ControlCheckpoint::parts).unwrap_or_default()),
    }
}

pub(super) fn quantised(part: Part<'_>, options: &Options, inputs: &Inputs) -> QuantisedPart {
    let plain = |source: &Conv1d| QuantisedConv1d::new(source, (0, 8), &Options::PLAIN, None);
    match part {
        Part::Linear(linear) => {
            let source = linear.as_convolution();
            let bits = if linear.inputs.is_multiple_of(GROUP) { options.four_bits.of(&linear.name) } else { 8 };
            QuantisedPart::Linear(if bits < 8 {
                // What the layers before it lost is not known here.
                let options = Options { refit: false, ..*options };
                let moments = inputs.get(&linear.name).map(|rows| moments(&source, rows));
                QuantisedConv1d::new(&source, (0, bits), &options, moments.as_ref())
            } else {
                plain(&source)
            })
        }
        Part::Embedding(table) => QuantisedPart::Table(plain(&table.as_convolution())),
        Part::Norm(norm) => QuantisedPart::Norm(norm.clone()),
    }
}

/// Moments of a linear's input and of its output.
fn moments(source: &Conv1d, rows: &[f32]) -> Moments {
    let mut moments = Moments::new(source.inputs, source.outputs);
    for row in rows.chunks_exact(source.inputs) {
        let x: Vec<f64> = row.iter().map(|&v| f64::from(v)).collect();
        let weights = source.weight.chunks_exact(source.inputs).zip(&source.bias);
        let y = weights.map(|(w, &b)| w.iter().zip(&x).map(|(&w, x)| f64::from(w) * x).sum::<f64>() + f64::from(b));
        moments.add(&x, &y.collect::<Vec<_>>());
    }
    moments
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
