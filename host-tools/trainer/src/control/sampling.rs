//! Tokens sampled from the trainer's own networks: any variant, in f32, without a blob. For comparison; what ships is the runtime.

use burn::tensor::Device;
use motionette_host::reference::Anchor;
use motionette_host::reference::Sampler;
use motionette_host::reference::scaffold::{self, Statistics};
use motionette_host::reference::tmd::Settings;

use super::checkpoint::Checkpoint;
use super::config::Config;
use super::frozen::Frozen;
use super::model::{Anchored, Scaffold};
use super::state::layout;
use crate::prior::captions::{UNCONDITIONAL, Vocabulary};
use crate::prior::model::{self, Example};
use crate::prior::training::values;
use crate::tokenizer::config::{FPS, FRAMES_PER_TOKEN};
use crate::transformer::{Dropout, Guest, Weights};

/// A control on a device.
struct Control {
    config: Config,
    statistics: Statistics,
    weights: Weights,
}

/// A planner with or without control, ready to sample.
pub struct Planner {
    frozen: Frozen,
    vocabulary: Vocabulary,
    prior: Weights,
    sampler: Sampler<f32>,
    control: Option<Control>,
}

impl Planner {
    /// Of frozen networks and a control of them.
    pub fn new(frozen: Frozen, control: Option<Checkpoint>) -> Self {
        let device = Device::flex();
        let prior = frozen.on(&device).prior;
        let control = control.map(|Checkpoint { config, statistics, parameters }| {
            let layout = layout(&config, &frozen);
            Control { weights: Weights::new(&layout, &parameters, false, &device), config, statistics }
        });
        let vocabulary = frozen.prior.sources.vocabulary();
        let t = &frozen.tokenizer;
        let config = &frozen.prior.config;
        let (codebook, beta) =
            ((&t.codebook[..], t.config.architecture.code_dim), (f64::from(config.c), f64::from(config.a)));
        let sampler = Sampler::new(config.corruption, codebook, beta);
        Self { frozen, vocabulary, prior, sampler, control }
    }

    /// Parameters of the control.
    pub fn parameters(&self) -> usize {
        self.control.as_ref().map_or(0, |control| layout(&control.config, &self.frozen).len())
    }

    /// `tokens` tokens of a whole motion for a sentence and anchors.
    pub fn sample(
        &self,
        text: &str,
        tokens: usize,
        anchors: &[Anchor],
        guidance: f32,
        settings: &Settings,
    ) -> Vec<u16> {
        let a = &self.frozen.prior.config.architecture;
        let words = self.vocabulary.read(text, a.max_words);
        let features: Vec<Vec<f32>> = self
            .control
            .iter()
            .map(|control| scaffold::features(anchors, FRAMES_PER_TOKEN * tokens, FPS as f64, &control.statistics))
            .collect();
        let pass = |words: &[usize], z: &[u16], time: f64, anchored: bool| -> Vec<f32> {
            let example = Example {
                words: words.to_vec(),
                z: z.to_vec(),
                fixed: vec![false; z.len()],
                t: time as f32,
                start_open: false,
                end_open: false,
                strength: guidance,
            };
            let scaffold = Scaffold { features: &features, lengths: &[z.len()] };
            let control = self.control.as_ref().filter(|_| anchored && !anchors.is_empty());
            let mut anchored = control.map(|control| {
                let architecture = &control.config.architecture;
                Anchored::new(architecture, &a.planner, &control.weights, scaffold, Dropout::off())
            });
            let mut nobody = ();
            let guest: &mut dyn Guest = match &mut anchored {
                Some(anchored) => anchored,
                None => &mut nobody,
            };
            values(&model::forward(a, &self.prior, &[example], guest, Dropout::off()).tokens)
        };
        let said = if words.is_empty() { vec![UNCONDITIONAL] } else { words };
        let logits = |z: &[u16], time: f64| {
            let mut logits = pass(&said, z, time, true);
            if guidance != 1.0 && !self.frozen.prior.sources.guidance {
                let without = pass(&[UNCONDITIONAL], z, time, false);
                for (with, without) in logits.iter_mut().zip(without) {
                    *with = without + guidance * (*with - without);
                }
            }
            logits
        };
        self.sampler.sample(tokens, settings, logits).pop().unwrap_or_default()
    }
}
