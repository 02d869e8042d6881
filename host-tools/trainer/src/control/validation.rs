//! How much anchors help to recover clean tokens of motions that were not trained on, and how near the anchors their decoding is.

use std::fmt;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use super::anchors::{self, EXTREMITIES, FAMILIES, Kind};
use super::config::Decoded;
use super::frozen::{Frozen, FrozenNetworks};
use super::model::{Anchored, Scaffold};
use super::state::State;
use super::training::{Anchors, Distance, decode, embedded};
use crate::prior::corpus::{Corpus, Labelled};
use crate::prior::corruption::Metric;
use crate::prior::model;
use crate::prior::training::{Score, Targets, cross_entropy, values};
use crate::random::Random;
use crate::tokenizer::config::FRAMES_PER_TOKEN;
use crate::transformer::{Dropout, Guest, Weights};
use motionette_host::reference::recover::CHANNELS;

/// Times at which motions are corrupted.
pub const TIMES: [f32; 2] = [0.0, 0.5];
/// Anchors of a motion.
pub const COUNT: usize = 8;

/// Figures of one family with [`COUNT`] anchors, at [`TIMES`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Family {
    /// Its name.
    pub family: Kind,
    /// Cross-entropy of the clean tokens, nats, with anchors.
    pub loss: Vec<f64>,
    /// Mean control error of the most probable tokens' motion, metres, with anchors.
    pub error: Vec<f64>,
    /// The same of the frozen prior, without anchors.
    pub free: Vec<f64>,
    /// Mean control error at the first of [`TIMES`], metres, with anchors that are places of another motion.
    #[serde(default)]
    pub foreign: f64,
    /// The same of the frozen prior, without anchors.
    #[serde(default)]
    pub foreign_free: f64,
}

/// Figures of the averaged weights on one split.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Motions.
    pub motions: usize,
    /// Cross-entropy of the frozen prior without anchors, nats, at [`TIMES`].
    pub free: Vec<f64>,
    /// With anchors.
    pub families: Vec<Family>,
}

/// Measures the averaged weights of `state` on at most `limit` motions of `corpus`, spread evenly.
pub fn measure(state: &State, frozen: &Frozen, corpus: &Corpus<'_>, metric: &Metric, limit: usize) -> Report {
    let device = Device::flex();
    let FrozenNetworks { prior, decoder, codebook } = frozen.on(&device);
    let weights = Weights::new(&state.layout(frozen), &state.optimizer.average, false, &device);
    let architecture = &frozen.prior.config.architecture;
    let score = |examples: &[Labelled], kind: Kind, foreign: bool, guided: bool| -> (Score, Distance) {
        let (mut tokens, mut distance) = (Score::default(), Distance::default());
        for (index, batch) in examples.chunks(32).enumerate() {
            let mut random = Random::new(state.config.seed, index as u64);
            let mut anchored = |labelled: &Labelled| {
                let mut real = corpus.joints(labelled);
                if foreign {
                    real = corpus.foreign(real.len(), &mut random);
                }
                let anchors = anchors::draw(kind, COUNT, &real, &EXTREMITIES, &mut random);
                Anchors { real, anchors }
            };
            let anchors: Vec<Anchors> = batch.iter().map(&mut anchored).collect();
            let lengths: Vec<usize> = batch.iter().map(|l| l.clean.len()).collect();
            let inputs: Vec<_> = batch.iter().map(|l| l.example.clone()).collect();
            let features: Vec<Vec<f32>> =
                anchors.iter().zip(&lengths).map(|(a, n)| a.features(&state.extra, FRAMES_PER_TOKEN * n)).collect();
            let scaffold = Scaffold { features: &features, lengths: &lengths };
            let a = &state.config.architecture;
            let mut guest = Anchored::new(a, &architecture.planner, &weights, scaffold, Dropout::off());
            let guest: &mut dyn Guest = if guided { &mut guest } else { &mut () };
            let output = model::forward(architecture, &prior, &inputs, guest, Dropout::off());
            tokens.add(cross_entropy(&mut values(&output.tokens), &Targets::of(batch).tokens, 1.0));
            let u = embedded(&output.tokens, &codebook, &lengths, Decoded::Straight);
            let y = decode(&decoder, u, &lengths, &device);
            let window = y.dims()[1] * CHANNELS;
            for ((y, Anchors { anchors, .. }), tokens) in values(&y).chunks_exact(window).zip(&anchors).zip(&lengths) {
                let joints = frozen.recovered(&y[..FRAMES_PER_TOKEN * tokens * CHANNELS]).joints;
                let error = anchors.iter().map(|a| a.error(&joints)).sum();
                distance.add(Distance { loss: 0.0, error, anchors: anchors.len() as f64, motions: 1.0 });
            }
        }
        (tokens, distance)
    };
    let examples: Vec<Vec<Labelled>> = TIMES
        .iter()
        .map(|t| {
            let all = corpus.whole(metric, architecture.max_words, *t);
            let step = all.len().div_ceil(limit.max(1)).max(1);
            all.into_iter().step_by(step).collect()
        })
        .collect();
    let nats = |score: &Score| score.loss / score.count.max(1.0);
    let metres = |distance: &Distance| distance.error / distance.anchors.max(1.0);
    let mut report = Report { motions: examples[0].len(), ..Report::default() };
    for family in FAMILIES {
        let with: Vec<_> = examples.iter().map(|examples| score(examples, family, false, true)).collect();
        let without: Vec<_> = examples.iter().map(|examples| score(examples, family, false, false)).collect();
        report.free = without.iter().map(|(tokens, _)| nats(tokens)).collect();
        report.families.push(Family {
            family,
            loss: with.iter().map(|(tokens, _)| nats(tokens)).collect(),
            error: with.iter().map(|(_, distance)| metres(distance)).collect(),
            free: without.iter().map(|(_, distance)| metres(distance)).collect(),
            foreign: metres(&score(&examples[0], family, true, true).1),
            foreign_free: metres(&score(&examples[0], family, true, false).1),
        });
    }
    report
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |values: &[f64]| values.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(" ");
        write!(
            f,
            "validation: {} motions, at t = {}: cross-entropy {} without anchors",
            self.motions,
            TIMES.map(|t| t.to_string()).join(" "),
            list(&self.free)
        )?;
        for family in &self.families {
            let Family { family, loss, error, free, foreign, foreign_free } = family;
            write!(f, "; {family:?} {}, control error {} m (free {}), ", list(loss), list(error), list(free))?;
            write!(f, "foreign {foreign:.3} m (free {foreign_free:.3})")?;
        }
        Ok(())
    }
}
