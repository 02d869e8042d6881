//! How well a prior recovers the clean tokens of motions it was not trained on.

use std::fmt;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use super::corpus::{Corpus, Labelled};
use super::corruption::Metric;
use super::model;
use super::state::State;
use super::training::{Score, Targets, cross_entropy, values};
use crate::transformer::{Dropout, Weights};

/// Times at which motions are corrupted.
pub const TIMES: [f32; 4] = [0.0, 0.25, 0.5, 0.75];

/// Figures of the averaged weights on one split.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Motions.
    pub motions: usize,
    /// Cross-entropy of the clean tokens at [`TIMES`], nats.
    pub loss: Vec<f64>,
    /// Share of tokens whose most likely code is the clean one, at [`TIMES`].
    pub accuracy: Vec<f64>,
    /// Cross-entropy of the length, nats.
    pub length: f64,
}

/// Measures the averaged weights of `state`.
pub fn measure(state: &State, corpus: &Corpus<'_>, metric: &Metric) -> Report {
    let device = Device::flex();
    let weights = Weights::new(&state.layout(), &state.optimizer.average, false, &device);
    let score = |examples: &[Labelled]| {
        let (mut tokens, mut length) = (Score::default(), Score::default());
        for batch in examples.chunks(32) {
            let inputs: Vec<_> = batch.iter().map(|l| l.example.clone()).collect();
            let output = model::forward(&state.config.architecture, &weights, &inputs, &mut (), Dropout::off());
            let targets = Targets::of(batch);
            tokens.add(cross_entropy(&mut values(&output.tokens), &targets.tokens, 1.0));
            length.add(cross_entropy(&mut values(&output.length), &targets.lengths, 1.0));
        }
        (tokens, length)
    };
    let scores: Vec<(Score, Score)> = TIMES.iter().map(|t| score(&corpus.whole(metric, *t))).collect();
    let mean = |score: &Score| score.loss / score.count.max(1.0);
    Report {
        motions: corpus.motions(),
        loss: scores.iter().map(|(tokens, _)| mean(tokens)).collect(),
        accuracy: scores.iter().map(|(tokens, _)| tokens.right / tokens.count.max(1.0)).collect(),
        length: scores.last().map_or(0.0, |(_, length)| mean(length)),
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |values: &[f64]| values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(" ");
        write!(
            f,
            "validation: {} motions, at t = {}: cross-entropy {}, top-1 {}; length {:.3}",
            self.motions,
            TIMES.map(|t| t.to_string()).join(" "),
            list(&self.loss),
            list(&self.accuracy),
            self.length,
        )
    }
}
