//! How well a prior recovers the clean tokens of motions it was not trained on.

use std::fmt;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use super::corpus::{Corpus, Labelled};
use super::corruption::Metric;
use super::model;
use super::sentences::Said;
use super::state::State;
use super::training::{Score, Targets, cross_entropy, values};
use crate::random::Random;
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
    /// How prompts are understood, where the prior learns it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub understanding: Option<Understanding>,
}

/// How prompts are understood.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Understanding {
    /// Sentences about the motions: phrases and captions.
    pub sentences: usize,
    /// Share of them whose likeliest action is theirs.
    pub right: f64,
    /// Probability of the likeliest action that all but [`WARNED`] of them reach.
    pub threshold: f32,
    /// Share of sentences that mean nothing whose likeliest action stays below it.
    pub caught: f64,
}

/// Share of sentences about motions that may be taken for hardly understood.
pub const WARNED: f64 = 0.05;
/// Sentences that mean nothing.
const NONSENSE: usize = 1000;
/// Sentences that go through the text encoder together.
const TOGETHER: usize = 64;
/// Stream of random numbers of the sentences.
const STREAM: u64 = 1 << 44;

/// Says sentences about the motions, and nonsense, and looks what is understood.
fn understanding(state: &State, corpus: &Corpus<'_>, weights: &Weights) -> Option<Understanding> {
    let actions = state.sources.meanings.iter().filter(|meaning| !meaning.style).count();
    if actions == 0 {
        return None;
    }
    let known: Vec<Said> = corpus.sentences(&state.config, &mut Random::new(state.config.seed, STREAM));
    let (guesses, nonsense) =
        (likeliest(state, weights, &known, actions), corpus.nonsense(&state.config, STREAM, NONSENSE));
    let right =
        guesses.iter().zip(&known).filter(|((place, _), said)| said.meanings.iter().flatten().any(|m| m == place));
    let right = right.count() as f64 / known.len().max(1) as f64;
    let mut scores: Vec<f32> = guesses.iter().map(|(_, score)| *score).collect();
    scores.sort_by(f32::total_cmp);
    let threshold = scores.get((WARNED * scores.len() as f64) as usize).copied().unwrap_or(0.5).clamp(0.02, 0.98);
    let caught = likeliest(state, weights, &nonsense, actions).iter().filter(|(_, score)| *score < threshold).count();
    let caught = caught as f64 / nonsense.len().max(1) as f64;
    Some(Understanding { sentences: known.len(), right, threshold, caught })
}

/// The likeliest action of every sentence, and its probability.
fn likeliest(state: &State, weights: &Weights, sentences: &[Said], actions: usize) -> Vec<(usize, f32)> {
    let mut guesses = Vec::with_capacity(sentences.len());
    for batch in sentences.chunks(TOGETHER) {
        let words: Vec<&[usize]> = batch.iter().map(|said| said.words.as_slice()).collect();
        let encoded = model::encode(&state.config.architecture, weights, &words, &mut Dropout::off());
        let logits = encoded.meaning(weights).map(|logits| values(&logits)).unwrap_or_default();
        for row in logits.chunks_exact(state.sources.meanings.len()) {
            let best = (0..actions).max_by(|a, b| row[*a].total_cmp(&row[*b])).unwrap_or_default();
            guesses.push((best, 1.0 / (1.0 + (-row[best]).exp())));
        }
    }
    guesses
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
    let scores: Vec<(Score, Score)> =
        TIMES.iter().map(|t| score(&corpus.whole(metric, state.config.architecture.max_words, *t))).collect();
    let mean = |score: &Score| score.loss / score.count.max(1.0);
    Report {
        motions: corpus.motions(),
        loss: scores.iter().map(|(tokens, _)| mean(tokens)).collect(),
        accuracy: scores.iter().map(|(tokens, _)| tokens.right / tokens.count.max(1.0)).collect(),
        length: scores.last().map_or(0.0, |(_, length)| mean(length)),
        understanding: understanding(state, corpus, &weights),
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
        )?;
        let Some(Understanding { sentences, right, threshold, caught }) = self.understanding else { return Ok(()) };
        write!(
            f,
            "; {sentences} sentences, {right:.3} understood, threshold {threshold:.3}, nonsense caught {caught:.3}"
        )
    }
}
