//! One step of controlled training: corrupted tokens with anchors, cross-entropy of the clean tokens, distance of the decoded motion
//! around the anchors, an update of the control alone.
//!
//! In the first steps the planner stays out of it: the scaffold encoder learns which tokens anchors alone suggest, `token local(H)` being
//! their logits. It is then ready to be listened to, and its suggestions lie where the planner's own token embeddings do.
//!
//! Some motions are given anchors that they do not meet: places of another motion, or of their own with a longer or shorter path. Of these
//! the decoded motion is to come near the anchors and the tokens count little. Where the prior is guided in one pass, half of the others
//! are planned with a strength above 1; their tokens are then to be what two passes of strength 1 make of them, with text and anchors
//! and without both.

use std::path::Path;

use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::motion::Pose;
use motionette_host::reference::Anchor;
use motionette_host::reference::recover::CHANNELS;
use motionette_host::reference::scaffold::{self, Statistics};

use super::config::{Config, Decoded, SCALES};
use super::curves::Point;
use super::frozen::{Frozen, FrozenNetworks};
use super::loss::anchor_loss;
use super::model::{Anchored, Scaffold};
use super::state::{State, layout};
use super::validation::{self, Report};
use super::{anchors, checkpoint};
use crate::harness::{self, Error, Evaluation, Training, Update};
use crate::prior;
use crate::prior::captions::UNCONDITIONAL;
use crate::prior::corpus::{Corpus, Labelled};
use crate::prior::corruption::Metric;
use crate::prior::model::{self, Example};
use crate::prior::training::{Score, Targets, cross_entropy, guide, soft_cross_entropy, strength, values};
use crate::random::Random;
use crate::tokenizer::config::{FPS, FRAMES_PER_TOKEN};
use crate::tokenizer::model::{Masks, Network};
use crate::transformer::{Dropout, Layout, Weights};

/// Streams of dropout and of anchors lie beside those of the batches.
const DROPOUT_STREAM: u64 = 1 << 41;
const ANCHOR_STREAM: u64 = 1 << 42;

/// What remains of the local context when the planner begins to listen: at full size it would drown the tokens.
const HANDED_OVER: f32 = 0.25;

/// Motions that do not meet their anchors are corrupted as late as this: what is left of their own tokens says the opposite.
const FAR_LATEST: f32 = 0.5;

/// A motion with its anchors.
#[derive(Clone, Debug)]
pub struct Anchors {
    /// Joints of the motion that the anchors are places of, [`FRAMES_PER_TOKEN`] frames a token.
    pub real: Vec<Pose>,
    /// Where it is to pass.
    pub anchors: Vec<Anchor>,
}

/// What a motion's tokens are to be.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wanted {
    /// The clean ones.
    Clean,
    /// What two passes say.
    Guided,
    /// The clean ones, but the anchors come first.
    Far,
}

impl Anchors {
    /// The scaffold features of a motion of so many frames, `[frames][WIDTH]`.
    pub fn features(&self, statistics: &Statistics, frames: usize) -> Vec<f32> {
        scaffold::features(&self.anchors, frames, FPS as f64, statistics)
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
    /// What the optimiser did.
    pub update: Update,
}

/// Sums over the steps since the last point.
#[derive(Debug, Default)]
pub struct Means {
    tokens: Score,
    distance: Distance,
    update: Update,
}

impl harness::Means<Step, Point> for Means {
    fn add(&mut self, step: &Step) {
        self.tokens.add(step.tokens);
        self.distance.add(step.distance);
        self.update = step.update;
    }

    fn point(&self, step: u64) -> Point {
        let Self { tokens, distance, update } = self;
        Point {
            step,
            rate: update.rate,
            loss: tokens.loss / tokens.count.max(1.0),
            accuracy: tokens.right / tokens.count.max(1.0),
            anchor: distance.loss / distance.motions.max(1.0),
            error: distance.error / distance.anchors.max(1.0),
            gradient_norm: update.gradient_norm,
        }
    }
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

/// Data and networks of a run.
pub struct Trainer<'d> {
    frozen: &'d Frozen,
    corpora: Corpora<'d>,
    shown: prior::config::Config,
    metric: Metric,
    networks: FrozenNetworks,
    /// The prior without the framework's record of what was computed.
    teacher: Option<Weights>,
    layout: Layout,
    decayed: Vec<bool>,
    device: Device,
}

/// What a run learns from and what it is measured on.
pub struct Corpora<'d> {
    /// The training split.
    pub training: Corpus<'d>,
    /// The validation split, where there is one.
    pub held_out: Option<Corpus<'d>>,
    /// Motions of it that are measured, spread evenly.
    pub measured: usize,
}

impl<'d> Trainer<'d> {
    /// A trainer of a control of these networks.
    pub fn new(config: &Config, frozen: &'d Frozen, corpora: Corpora<'d>) -> Self {
        let device = Device::flex().autodiff();
        let layout = layout(config, frozen);
        let (prior, tokenizer) = (&frozen.prior.config, &frozen.tokenizer);
        Self {
            metric: Metric::new(&tokenizer.codebook, tokenizer.config.architecture.code_dim, prior),
            networks: frozen.on(&device),
            teacher: frozen.prior.sources.guidance.then(|| frozen.on(&Device::flex()).prior),
            shown: frozen.examples(config),
            decayed: layout.decayed(),
            layout,
            frozen,
            corpora,
            device,
        }
    }
}

impl Trainer<'_> {
    /// What two passes of strength 1 say of the motions that learn to be guided, `[L, V]` each in their order: one with text and anchors,
    /// one without both.
    fn taught(&self, state: &State, examples: &[Example], features: &[Vec<f32>], wanted: &[Wanted]) -> Vec<Vec<f32>> {
        let Some(prior) = &self.teacher else { return Vec::new() };
        let guided = || wanted.iter().enumerate().filter(|(_, wanted)| **wanted == Wanted::Guided).map(|(i, _)| i);
        let with: Vec<Example> = guided().map(|i| Example { strength: 1.0, ..examples[i].clone() }).collect();
        if with.is_empty() {
            return Vec::new();
        }
        let without: Vec<Example> =
            with.iter().map(|example| Example { words: vec![UNCONDITIONAL], ..example.clone() }).collect();
        let features: Vec<Vec<f32>> = guided().map(|i| features[i].clone()).collect();
        let lengths: Vec<usize> = with.iter().map(|example| example.z.len()).collect();
        let weights = Weights::new(&self.layout, &state.optimizer.values, false, &Device::flex());
        let architecture = &self.frozen.prior.config.architecture;
        let scaffold = Scaffold { features: &features, lengths: &lengths };
        let own = &state.config.architecture;
        let mut guest = Anchored::new(own, &architecture.planner, &weights, scaffold, Dropout::off());
        let logits = model::forward(architecture, prior, &with, &mut guest, Dropout::off()).tokens;
        let [_, window, codes] = logits.dims();
        let mut logits = values(&logits);
        let free = values(&model::forward(architecture, prior, &without, &mut (), Dropout::off()).tokens);
        let each = window * codes;
        let pairs = logits.chunks_exact_mut(each).zip(free.chunks_exact(each));
        pairs.zip(guided()).for_each(|((with, without), i)| guide(with, without, examples[i].strength));
        logits.chunks_exact(each).map(<[f32]>::to_vec).collect()
    }
}

impl Training for Trainer<'_> {
    type Config = Config;
    type Step = Step;
    type Means = Means;
    type Error = Error;

    fn decayed(&self) -> &[bool] {
        &self.decayed
    }

    fn step(&mut self, state: &mut State) -> Result<Step, Error> {
        let (step, config) = (state.step, &state.config);
        if step == config.alone {
            state.optimizer.scale(&self.layout.named(|name| name.starts_with("control.local.")), HANDED_OVER);
        }
        let mut batch = self.corpora.training.batch(&self.shown, &self.metric, step);
        let alone = step < config.alone;
        let mut random = Random::new(config.seed, ANCHOR_STREAM + step);
        let mut wanted = vec![Wanted::Clean; batch.len()];
        let mut anchors: Vec<Anchors> = Vec::with_capacity(batch.len());
        for (labelled, wanted) in batch.iter_mut().zip(&mut wanted) {
            let mut real = self.corpora.training.joints(labelled);
            if !alone {
                let draw = random.unit();
                if draw < config.foreign {
                    real = self.corpora.training.foreign(real.len(), &mut random);
                    *wanted = Wanted::Far;
                } else if draw < config.foreign + config.scaled {
                    real = anchors::scaled(&real, SCALES[0] + (SCALES[1] - SCALES[0]) * random.unit() as f32);
                    *wanted = Wanted::Far;
                } else if self.teacher.is_some() && random.unit() < config.guided {
                    *wanted = Wanted::Guided;
                }
                if *wanted == Wanted::Far {
                    labelled.example.t *= FAR_LATEST;
                    let Labelled { example, clean, .. } = labelled;
                    example.z = self.metric.corrupt(clean, &example.fixed, example.t, &mut random);
                }
                if config.guided > 0.0 && self.teacher.is_some() && *wanted != Wanted::Clean {
                    labelled.example.strength = strength(&mut random);
                }
            }
            let anchored = anchors::example(&config.anchors, &real, &mut random);
            anchors.push(Anchors { real, anchors: anchored });
        }
        let lengths: Vec<usize> = batch.iter().map(|l| l.clean.len()).collect();
        let features: Vec<Vec<f32>> =
            anchors.iter().zip(&lengths).map(|(a, n)| a.features(&state.extra, FRAMES_PER_TOKEN * n)).collect();
        let examples: Vec<_> = batch.iter().map(|l| l.example.clone()).collect();

        let weights = Weights::new(&self.layout, &state.optimizer.values, true, &self.device);
        let architecture = &self.frozen.prior.config.architecture;
        let FrozenNetworks { prior, decoder, codebook } = &self.networks;
        let dropout = Dropout::new(config.dropout, Random::new(config.seed, DROPOUT_STREAM + step));
        let scaffold = Scaffold { features: &features, lengths: &lengths };
        let mut guest = Anchored::new(&config.architecture, &architecture.planner, &weights, scaffold, dropout);
        let logits = if alone {
            prior.linear("planner.token", guest.suggested())
        } else {
            model::forward(architecture, prior, &examples, &mut guest, Dropout::off()).tokens
        };

        let by = Targets::of(&batch).tokens;
        let [_, window, codes] = logits.dims();
        let share = 1.0 / by.iter().flatten().count().max(1) as f32;
        let mut taught = self.taught(state, &examples, &features, &wanted).into_iter();
        let mut gradient = values(&logits);
        let mut tokens = Score::default();
        for ((rows, by), wanted) in gradient.chunks_exact_mut(window * codes).zip(by.chunks_exact(window)).zip(&wanted)
        {
            match wanted {
                Wanted::Clean => tokens.add(cross_entropy(rows, by, share)),
                Wanted::Far => drop(cross_entropy(rows, by, config.far_tokens * share)),
                Wanted::Guided => {
                    let mut logits = taught.next().unwrap_or_default();
                    logits.resize(rows.len(), 0.0);
                    soft_cross_entropy(rows, &logits, by, share);
                }
            }
        }
        let leaf = |values: Vec<f32>, like: &Tensor<3>| {
            Tensor::<3>::from_data(TensorData::new(values, like.dims()), &self.device)
        };
        let mut total = (logits.clone() * leaf(gradient, &logits)).sum();
        let mut distance = Distance::default();
        if config.anchor_loss > 0.0 && !alone {
            let u = embedded(&logits, codebook, &lengths, config.decoded);
            let y = decode(decoder, u, &lengths, &self.device);
            let mut gradient = vec![0.0; y.dims().iter().product()];
            let window = y.dims()[1] * CHANNELS;
            // Cross-entropy is a sum over tokens that is divided by their number: so is this.
            let weight = config.anchor_loss / lengths.iter().sum::<usize>().max(1) as f32;
            let y_values = values(&y);
            let rows = y_values.chunks_exact(window).zip(gradient.chunks_exact_mut(window));
            for (((y, gradient), anchors), tokens) in rows.zip(&anchors).zip(&lengths) {
                let valid = FRAMES_PER_TOKEN * tokens * CHANNELS;
                let recovered = self.frozen.recovered(&y[..valid]);
                let joints = &recovered.joints;
                let mut by_joints = vec![[[0.0; 3]; 22]; joints.len()];
                let Anchors { real, anchors } = anchors;
                let loss = anchor_loss(joints, real, anchors, config.support, weight, &mut by_joints).loss;
                let error = anchors.iter().map(|a| a.error(joints)).sum();
                distance.add(Distance { loss, error, anchors: anchors.len() as f64, motions: 1.0 });
                gradient[..valid].copy_from_slice(&self.frozen.recovered_backward(&recovered, &by_joints));
            }
            total = total + (y.clone() * leaf(gradient, &y)).sum();
        }
        state.check_finite(tokens.loss + distance.loss)?;
        let mut flat = vec![0.0; state.optimizer.values.len()];
        weights.collect_gradients(&total.backward(), &mut flat);
        let update = state.update(&flat, &self.decayed)?;
        Ok(Step { tokens, distance, update })
    }

    fn evaluate(&self, state: &State, _finished: bool) -> Result<Option<Evaluation<Report>>, Error> {
        let Corpora { held_out, measured, .. } = &self.corpora;
        let measure = |corpus| validation::measure(state, self.frozen, corpus, &self.metric, *measured);
        Ok(Some(Evaluation { step: state.step, report: held_out.as_ref().map(measure).unwrap_or_default() }))
    }

    fn save(&self, state: &State, evaluation: &Evaluation<Report>, path: &Path) -> Result<(), Error> {
        checkpoint::save(state, self.frozen, path, &evaluation.report)
    }
}

/// Normalised features `[B, 4 L, CHANNELS]` of code vectors.
pub fn decode(decoder: &Network, u: Tensor<3>, lengths: &[usize], device: &Device) -> Tensor<3> {
    let frames: Vec<usize> = lengths.iter().map(|n| FRAMES_PER_TOKEN * n).collect();
    let window = FRAMES_PER_TOKEN * u.dims()[1];
    decoder.decode(u, Masks::new(&frames, window, device).as_ref())
}
