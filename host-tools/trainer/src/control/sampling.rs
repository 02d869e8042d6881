//! Tokens sampled from the trainer's own networks: any variant, in f32, without a blob. For comparison; what ships is the runtime.

use burn::tensor::Device;
use motionette_host::reference::Anchor;
use motionette_host::reference::scaffold::{self, Statistics};
use motionette_host::reference::tmd::{Settings, Tmd};

use super::config::Config;
use super::model::Anchored;
use super::training::Frozen;
use crate::prior::captions::{NONE, Vocabulary};
use crate::prior::model::{self, Example};
use crate::prior::training::values;
use crate::random::Random;
use crate::tokenizer::config::{FPS, FRAMES_PER_TOKEN};
use crate::transformer::{Guest, Weights};

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
    tmd: Tmd<f32>,
    control: Option<Control>,
}

impl Planner {
    /// Of frozen networks and what [`super::checkpoint::load`] gave.
    pub fn new(frozen: Frozen, vocabulary: Vocabulary, control: Option<(Config, Statistics, Vec<f32>)>) -> Self {
        let device = Device::flex();
        let (prior, _) = frozen.on(&device);
        let a = &frozen.config.architecture;
        let control = control.map(|(config, statistics, values)| {
            let layout = super::model::layout(&config.architecture, &a.planner, a.text.width);
            Control { weights: Weights::new(&layout, &values, false, &device), config, statistics }
        });
        let t = &frozen.tokenizer;
        let (c, a) = (f64::from(frozen.config.c), f64::from(frozen.config.a));
        let tmd = Tmd::new(&t.codebook, t.config.architecture.code_dim, c, a);
        Self { frozen, vocabulary, prior, tmd, control }
    }

    /// Parameters of the control.
    pub fn parameters(&self) -> usize {
        let a = &self.frozen.config.architecture;
        let count = |c: &Control| super::model::layout(&c.config.architecture, &a.planner, a.text.width).len();
        self.control.as_ref().map_or(0, count)
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
        let a = &self.frozen.config.architecture;
        let words = self.vocabulary.encode(text, a.max_words);
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
            };
            let lengths = [z.len()];
            let off = || Random::new(0, 0);
            let control = self.control.as_ref().filter(|_| anchored && !anchors.is_empty());
            let mut anchored = control.map(|control| {
                let architecture = &control.config.architecture;
                Anchored::new(architecture, &a.planner, &control.weights, &features, &lengths, 0.0, off())
            });
            let mut nobody = ();
            let guest: &mut dyn Guest = match &mut anchored {
                Some(anchored) => anchored,
                None => &mut nobody,
            };
            values(&model::forward(a, &self.prior, &[example], guest, 0.0, off()).tokens)
        };
        let said = if words.is_empty() { vec![NONE] } else { words };
        let logits = |z: &[u16], time: f64| {
            let mut logits = pass(&said, z, time, true);
            if guidance != 1.0 {
                let without = pass(&[NONE], z, time, false);
                for (with, without) in logits.iter_mut().zip(without) {
                    *with = without + guidance * (*with - without);
                }
            }
            logits
        };
        self.tmd.sample(tokens, settings, logits).pop().unwrap_or_default()
    }
}
