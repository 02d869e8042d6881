//! One step of controlled training: corrupted tokens with anchors, cross-entropy of the clean tokens, distance of the decoded motion
//! around the anchors, an update of the control alone.
//!
//! In the first steps the planner stays out of it: the scaffold encoder learns which tokens anchors alone suggest, `token local(H)` being
//! their logits. It is then ready to be listened to, and its suggestions lie where the planner's own token embeddings do.

use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::motion::Pose;
use motionette_host::reference::Anchor;
use motionette_host::reference::recover::{self, CHANNELS};
use motionette_host::reference::scaffold::{self, Statistics};

use super::Error;
use super::anchors;
use super::config::{Config, Decoded};
use super::loss::anchor_loss;
use super::model::Anchored;
use super::state::State;
use crate::optimizer::Settings;
use crate::prior::corpus::{Corpus, Labelled};
use crate::prior::corruption::Metric;
use crate::prior::training::{Score, cross_entropy, targets, values};
use crate::prior::{config::Config as PriorConfig, model};
use crate::random::Random;
use crate::schedule;
use crate::tokenizer;
use crate::tokenizer::config::{FPS, FRAMES_PER_TOKEN};
use crate::tokenizer::model::{Masks, Network};
use crate::transformer::{Layout, Weights};

/// Streams of dropout and of anchors lie beside those of the batches.
const DROPOUT_STREAM: u64 = 1 << 41;
const ANCHOR_STREAM: u64 = 1 << 42;

/// What remains of the local context when the planner begins to listen: at full size it would drown the tokens.
const HANDED_OVER: f32 = 0.25;

/// The networks that stay as they are.
pub struct Frozen {
    /// The prior's configuration.
    pub config: PriorConfig,
    /// The prior's parameters.
    pub layout: Layout,
    /// Their values.
    pub values: Vec<f32>,
    /// The tokenizer.
    pub tokenizer: tokenizer::checkpoint::Checkpoint,
}

impl Frozen {
    /// Both networks on a device.
    pub fn on(&self, device: &Device) -> (Weights, Network) {
        let weights = Weights::new(&self.layout, &self.values, false, device);
        let architecture = &self.tokenizer.config.architecture;
        (weights, Network::frozen_decoder(architecture, &self.tokenizer.parameters, CHANNELS, device))
    }

    /// What the corpus draws for a run of control: whole motions, pieces and joined ones, nothing fixed.
    pub fn examples(&self, config: &Config) -> PriorConfig {
        PriorConfig {
            seed: config.seed,
            batch: config.batch,
            text_dropout: config.text_dropout,
            crops: config.crops,
            joins: config.joins,
            fixed: 0.0,
            ..self.config.clone()
        }
    }

    /// Normalised features `[T][CHANNELS]` to joints, and `dJ/djoints` back to them.
    pub fn joints(&self, y: &[f32]) -> (Vec<f32>, Vec<Pose>) {
        let n = &self.tokenizer.normalization;
        let restored = |(i, y): (usize, &f32)| y * n.std[i % CHANNELS] + n.mean[i % CHANNELS];
        let features: Vec<f32> = y.iter().enumerate().map(restored).collect();
        let joints = recover::joints(&features, CHANNELS);
        (features, joints)
    }

    fn joints_backward(&self, features: &[f32], gradient: &[Pose]) -> Vec<f32> {
        let std = &self.tokenizer.normalization.std;
        let d = recover::joints_backward(features, CHANNELS, gradient);
        d.into_iter().enumerate().map(|(i, d)| d * std[i % CHANNELS]).collect()
    }
}

/// A motion with its anchors.
#[derive(Clone, Debug)]
pub struct Anchors {
    /// Joints of the real motion, [`FRAMES_PER_TOKEN`] frames a token.
    pub real: Vec<Pose>,
    /// Where it is to pass.
    pub anchors: Vec<Anchor>,
}

impl Anchors {
    /// The scaffold features, `[T][WIDTH]`.
    pub fn features(&self, statistics: &Statistics) -> Vec<f32> {
        scaffold::features(&self.anchors, self.real.len(), FPS as f64, statistics)
    }
}

/// How far decoded motion is from anchors and their surroundings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distance {
    /// Sum of the anchor losses, square metres.
    pub loss: f64,
    /// Sum of control errors, metres.
    pub error: f64,
    /// Anchors.
    pub anchors: f64,
    /// Motions.
    pub motions: f64,
}

impl Distance {
    /// Adds another one.
    pub fn add(&mut self, other: Self) {
        self.loss += other.loss;
        self.error += other.error;
        self.anchors += other.anchors;
        self.motions += other.motions;
    }
}

/// Figures of one step.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Of the tokens.
    pub tokens: Score,
    /// Of the decoded motions.
    pub distance: Distance,
    /// Learning rate.
    pub rate: f32,
    /// Global norm of the gradient.
    pub gradient_norm: f32,
}

/// Code vectors `[B, L, du]` that stand for logits `[B, L, V]`, zero behind `lengths`.
pub fn embedded(logits: &Tensor<3>, codebook: &Tensor<2>, lengths: &[usize], decoded: Decoded) -> Tensor<3> {
    let [size, window, codes] = logits.dims();
    let width = codebook.dims()[1];
    let shares = softmax(logits.clone(), 2).reshape([size * window, codes]);
    let soft = shares.clone().matmul(codebook.clone());
    let u = match decoded {
        Decoded::Expected => soft,
        Decoded::Straight => {
            let best: Tensor<2> = codebook.clone().select(0, shares.argmax(1).reshape([size * window]));
            soft.clone() + (best - soft).detach()
        }
    };
    let there: Vec<f32> =
        lengths.iter().flat_map(|n| (0..window).map(move |i| if i < *n { 1.0 } else { 0.0 })).collect();
    let there = Tensor::from_data(TensorData::new(there, [size, window, 1]), &u.device());
    u.reshape([size, window, width]) * there
}

/// A run in memory.
pub struct Trainer<'d> {
    /// What is stored.
    pub state: State,
    /// What stays as it is.
    pub frozen: &'d Frozen,
    corpus: &'d Corpus<'d>,
    shown: PriorConfig,
    metric: Metric,
    prior: Weights,
    decoder: Network,
    codebook: Tensor<2>,
    device: Device,
    decayed: Vec<bool>,
}

impl<'d> Trainer<'d> {
    /// A trainer that goes on from `state`.
    pub fn new(state: State, frozen: &'d Frozen, corpus: &'d Corpus<'d>, metric: Metric) -> Self {
        let device = Device::flex().autodiff();
        let (prior, decoder) = frozen.on(&device);
        let a = &frozen.tokenizer.config.architecture;
        let codebook = TensorData::new(frozen.tokenizer.codebook.clone(), [a.codes, a.code_dim]);
        Self {
            decayed: state.layout(frozen).decayed(),
            shown: frozen.examples(&state.config),
            codebook: Tensor::from_data(codebook, &device),
            state,
            frozen,
            corpus,
            metric,
            prior,
            decoder,
            device,
        }
    }

    /// Draws the step's batch and updates the control.
    ///
    /// # Errors
    /// [`Error::Diverged`] when the objective or its gradient is not finite; the state is then as before the step.
    pub fn step(&mut self) -> Result<Step, Error> {
        let (step, config) = (self.state.step, &self.state.config);
        let layout = self.state.layout(self.frozen);
        if step == config.alone {
            self.state.optimizer.scale(&layout.named(|name| name.starts_with("control.local.")), HANDED_OVER);
        }
        let batch = self.corpus.batch(&self.shown, &self.metric, step);
        let mut random = Random::new(config.seed, ANCHOR_STREAM + step);
        let mut anchored = |labelled: &Labelled| {
            let real = self.corpus.joints(labelled);
            let anchors = anchors::example(&config.anchors, &real, &mut random);
            Anchors { real, anchors }
        };
        let anchors: Vec<Anchors> = batch.iter().map(&mut anchored).collect();
        let features: Vec<Vec<f32>> = anchors.iter().map(|a| a.features(&self.state.statistics)).collect();
        let lengths: Vec<usize> = batch.iter().map(|l| l.clean.len()).collect();
        let examples: Vec<_> = batch.iter().map(|l| l.example.clone()).collect();

        let weights = Weights::new(&layout, &self.state.optimizer.values, true, &self.device);
        let architecture = &self.frozen.config.architecture;
        let random = Random::new(config.seed, DROPOUT_STREAM + step);
        let (a, planner) = (&config.architecture, &architecture.planner);
        let mut guest = Anchored::new(a, planner, &weights, &features, &lengths, config.dropout, random);
        let alone = step < config.alone;
        let logits = if alone {
            self.prior.linear("planner.token", guest.suggested())
        } else {
            let off = Random::new(0, 0);
            model::forward(architecture, &self.prior, &examples, &mut guest, 0.0, off).tokens
        };

        let (by, _) = targets(&batch);
        let mut gradient = values(&logits);
        let tokens = cross_entropy(&mut gradient, &by, 1.0 / by.iter().flatten().count().max(1) as f32);
        let leaf = |values: Vec<f32>, like: &Tensor<3>| {
            Tensor::<3>::from_data(TensorData::new(values, like.dims()), &self.device)
        };
        let mut total = (logits.clone() * leaf(gradient, &logits)).sum();
        let mut distance = Distance::default();
        if config.anchor_loss > 0.0 && !alone {
            let u = embedded(&logits, &self.codebook, &lengths, config.decoded);
            let y = decode(&self.decoder, u, &lengths, &self.device);
            let mut gradient = vec![0.0; y.dims().iter().product()];
            let window = y.dims()[1] * CHANNELS;
            // Cross-entropy is a sum over tokens that is divided by their number: so is this.
            let weight = config.anchor_loss / lengths.iter().sum::<usize>().max(1) as f32;
            let y_values = values(&y);
            let rows = y_values.chunks_exact(window).zip(gradient.chunks_exact_mut(window));
            for ((y, gradient), anchors) in rows.zip(&anchors) {
                let valid = anchors.real.len() * CHANNELS;
                let (features, joints) = self.frozen.joints(&y[..valid]);
                let mut by_joints = vec![[[0.0; 3]; 22]; joints.len()];
                let Anchors { real, anchors } = anchors;
                let (loss, _) = anchor_loss(&joints, real, anchors, config.support, weight, &mut by_joints);
                let error = anchors.iter().map(|a| a.error(&joints)).sum();
                distance.add(Distance { loss, error, anchors: anchors.len() as f64, motions: 1.0 });
                gradient[..valid].copy_from_slice(&self.frozen.joints_backward(&features, &by_joints));
            }
            total = total + (y.clone() * leaf(gradient, &y)).sum();
        }
        if !(tokens.loss + distance.loss).is_finite() {
            return Err(Error::Diverged { step });
        }
        let mut flat = vec![0.0; self.state.optimizer.values.len()];
        weights.collect_gradients(&total.backward(), &mut flat);

        let settings = Settings::new(config.weight_decay, config.clip, config.average_decay);
        let rate = schedule::rate(&config.schedule, self.state.plan, step);
        let gradient_norm = self.state.optimizer.update(&settings, rate, &flat, &self.decayed);
        if !gradient_norm.is_finite() {
            return Err(Error::Diverged { step });
        }
        self.state.step += 1;
        Ok(Step { tokens, distance, rate, gradient_norm })
    }
}

/// Normalised features `[B, 4 L, CHANNELS]` of code vectors.
pub fn decode(decoder: &Network, u: Tensor<3>, lengths: &[usize], device: &Device) -> Tensor<3> {
    let frames: Vec<usize> = lengths.iter().map(|n| FRAMES_PER_TOKEN * n).collect();
    let window = FRAMES_PER_TOKEN * u.dims()[1];
    decoder.decode(u, Masks::new(&frames, window, device).as_ref())
}
