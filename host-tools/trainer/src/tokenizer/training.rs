//! One step of training, and what a finished part of a run is made into.
//!
//! The graph is cut at the codes: the decoder is differentiated down to the code vectors, the straight-through estimator hands
//! that gradient to the latents, the commitment term is added there, and the encoder is differentiated from the latents.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::dataset::{Dataset, Split};

use super::batch::{Batch, Corpus};
use super::checkpoint::Checkpoint;
use super::config::{Config, FEATURES, FRAMES_PER_TOKEN};
use super::curves::{Evaluation, Point};
use super::loss::{Objective, Terms};
use super::model::{self, Masks, Network};
use super::quantizer::{Codebook, Usage};
use super::state::State;
use super::{Error, metrics};
use crate::convolution::decay_mask;
use crate::harness::{self, Training, Update};
use crate::random::Random;

/// Batches whose latents the codebook starts from.
const KMEANS_BATCHES: u64 = 16;
/// Streams of random numbers beside those of the steps.
const KMEANS_STREAM: u64 = 1 << 40;

/// Figures of one step.
#[derive(Clone, Debug)]
pub struct Step {
    /// Terms of the objective.
    pub terms: Terms,
    /// Mean squared distance of latents to their codes; 0 before quantisation.
    pub commitment: f32,
    /// Code of every valid token; empty before quantisation.
    pub ids: Vec<u16>,
    /// Dead codes that were moved.
    pub moved: usize,
    /// What the optimiser did.
    pub update: Update,
}

/// Sums over the steps since the last point.
#[derive(Debug, Default)]
pub struct Means {
    steps: f32,
    terms: Terms,
    commitment: f32,
    gradient_norm: f32,
    rate: f32,
    moved: usize,
    counts: Vec<u64>,
}

impl harness::Means<Step, Point> for Means {
    fn add(&mut self, step: &Step) {
        self.steps += 1.0;
        let (sum, terms) = (&mut self.terms, &step.terms);
        sum.features += terms.features;
        sum.position += terms.position;
        sum.square += terms.square;
        sum.velocity += terms.velocity;
        sum.bones += terms.bones;
        sum.legs += terms.legs;
        sum.root += terms.root;
        sum.heading += terms.heading;
        sum.total += terms.total;
        self.commitment += step.commitment;
        self.gradient_norm += step.update.gradient_norm;
        self.rate = step.update.rate;
        self.moved += step.moved;
        for id in &step.ids {
            let id = usize::from(*id);
            if id >= self.counts.len() {
                self.counts.resize(id + 1, 0);
            }
            self.counts[id] += 1;
        }
    }

    fn point(&self, step: u64) -> Point {
        let n = self.steps.max(1.0);
        Point {
            step,
            rate: self.rate,
            terms: Terms {
                features: self.terms.features / n,
                position: self.terms.position / n,
                square: self.terms.square / n,
                velocity: self.terms.velocity / n,
                bones: self.terms.bones / n,
                legs: self.terms.legs / n,
                root: self.terms.root / n,
                heading: self.terms.heading / n,
                total: self.terms.total / n,
            },
            commitment: self.commitment / n,
            perplexity: Usage::of(&self.counts).perplexity,
            moved: self.moved,
            gradient_norm: self.gradient_norm / n,
        }
    }
}

/// Data and objective of a run.
pub struct Trainer<'d> {
    dataset: &'d Dataset,
    corpus: Corpus,
    objective: Objective,
    device: Device,
    decayed: Vec<bool>,
}

impl<'d> Trainer<'d> {
    /// A trainer on the training split of `dataset`.
    ///
    /// # Errors
    /// [`Error::NoMotion`], [`Error::Mirror`].
    pub fn new(config: &Config, dataset: &'d Dataset) -> Result<Self, Error> {
        let corpus = Corpus::new(dataset)?.balanced(dataset, config.balance);
        let objective = Objective::new(&config.loss, corpus.normalization());
        let decayed = decay_mask(&model::shapes(&config.architecture));
        Ok(Self { dataset, corpus, objective, device: Device::flex(), decayed })
    }

    /// The training motions.
    pub fn corpus(&self) -> &Corpus {
        &self.corpus
    }

    /// The averaged weights with the codebook; none before quantisation.
    pub fn checkpoint(&self, state: &State) -> Option<Checkpoint> {
        let book = state.extra.as_ref()?;
        Some(Checkpoint {
            config: state.config.clone(),
            parameters: state.optimizer.average.clone(),
            codebook: book.rows.clone(),
            normalization: self.corpus.normalization().clone(),
            steps: state.step,
            data_hash: state.sources.data_hash.clone(),
        })
    }

    fn features(&self, batch: &Batch, config: &Config, device: &Device) -> Tensor<3> {
        let shape = [batch.lengths.len(), config.window, FEATURES];
        Tensor::from_data(TensorData::new(batch.features.clone(), shape), device)
    }

    /// k-means over latents of fresh batches.
    fn first_codebook(&self, state: &State) -> Codebook {
        let config = &state.config;
        let dim = config.architecture.code_dim;
        let network = Network::new(&config.architecture, &state.optimizer.values, false, &self.device);
        let mut latents = Vec::new();
        for index in 0..KMEANS_BATCHES {
            let mut random = Random::new(config.seed, KMEANS_STREAM + 1 + index);
            let batch = self.corpus.batch(config.batch, config.window, &mut random);
            let masks = Masks::new(&batch.lengths, config.window, &self.device);
            let z = network.encode(self.features(&batch, config, &self.device), masks.as_ref());
            let z = z.into_data().try_into_vec::<f32>().expect("latents are f32");
            let tokens = valid_tokens(&batch.lengths, config.window);
            latents.extend(tokens.iter().flat_map(|token| z[token * dim..][..dim].iter().copied()));
        }
        Codebook::from_latents(&latents, config.architecture.codes, dim, &mut Random::new(config.seed, KMEANS_STREAM))
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
        let config = state.config.clone();
        let dim = config.architecture.code_dim;
        if state.extra.is_none() && state.step >= config.quantize_from {
            state.extra = Some(self.first_codebook(state));
        }
        let mut random = Random::new(config.seed, state.step);
        let batch = self.corpus.batch(config.batch, config.window, &mut random);
        let device = self.device.clone().autodiff();
        let masks = Masks::new(&batch.lengths, config.window, &device);
        let network = Network::new(&config.architecture, &state.optimizer.values, true, &device);

        let latents = network.encode(self.features(&batch, &config, &device), masks.as_ref());
        let z = latents.to_data().try_into_vec::<f32>().expect("latents are f32");
        let tokens = valid_tokens(&batch.lengths, config.window);
        let valid: Vec<f32> = tokens.iter().flat_map(|token| z[token * dim..][..dim].iter().copied()).collect();
        let (codes, ids) = match &state.extra {
            Some(book) => {
                let ids = book.nearest(&valid);
                (ids.iter().flat_map(|id| book.rows[usize::from(*id) * dim..][..dim].iter().copied()).collect(), ids)
            }
            None => (valid.clone(), Vec::new()),
        };

        let mut u = vec![0.0; z.len()];
        for (token, code) in tokens.iter().zip(codes.chunks_exact(dim)) {
            u[token * dim..][..dim].copy_from_slice(code);
        }
        let shape = latents.dims();
        let u = Tensor::<3>::from_data(TensorData::new(u, shape), &device).require_grad();
        let output = network.decode(u.clone(), masks.as_ref());
        let y = output.to_data().try_into_vec::<f32>().expect("outputs are f32");
        let mut by_output = vec![0.0; y.len()];
        let terms = self.objective.evaluate(&y, &batch, config.window, &mut by_output);
        state.check_finite(f64::from(terms.total))?;

        let mut flat = vec![0.0; state.optimizer.values.len()];
        let by_output = Tensor::<3>::from_data(TensorData::new(by_output, output.dims()), &device);
        let gradients = (output * by_output).sum().backward();
        network.collect_gradients(&gradients, &mut flat);
        let by_code = u.grad(&gradients).expect("the codes are a leaf").into_data();
        let by_code = by_code.try_into_vec::<f32>().expect("gradients are f32");
        let coded = Coded { tokens: &tokens, latents: &valid, codes: &codes, dim };
        let Through { by_latent, commitment } = through(&by_code, &coded, config.loss.commitment);
        let by_latent = Tensor::<3>::from_data(TensorData::new(by_latent, shape), &device);
        let gradients = (latents * by_latent).sum().backward();
        network.collect_gradients(&gradients, &mut flat);

        let update = state.update(&flat, &self.decayed)?;
        let dead_below = if settling(state) { 0.0 } else { config.dead_below };
        let moved = match &mut state.extra {
            Some(book) => book.update(&valid, &ids, config.codebook_decay, dead_below, &mut random),
            None => 0,
        };
        Ok(Step { terms, commitment, ids, moved, update })
    }

    /// On the validation split, and at the end on the test split as well; on those of them that the dataset has.
    fn evaluate(&self, state: &State, finished: bool) -> Result<Option<Evaluation>, Error> {
        let Some(checkpoint) = self.checkpoint(state) else { return Ok(None) };
        let splits = measured(self.dataset).into_iter().take(if finished { 2 } else { 1 });
        let reports = metrics::evaluate(&checkpoint, self.dataset, &splits.collect::<Vec<_>>())?;
        Ok(Some(Evaluation { step: state.step, reports }))
    }

    fn save(&self, state: &State, evaluation: &Evaluation, path: &Path) -> Result<(), Error> {
        match self.checkpoint(state) {
            Some(checkpoint) => Ok(checkpoint.save(path, &evaluation.reports)?),
            None => Ok(()),
        }
    }
}

/// Validation and test split where the dataset has them.
pub fn measured(dataset: &Dataset) -> Vec<Split> {
    let has = |split: &Split| dataset.split(*split).next().is_some();
    [Split::Val, Split::Test].into_iter().filter(has).collect()
}

/// Whether the learning rate has fallen so far that codes should no longer jump: the second half of the fall.
fn settling(state: &State) -> bool {
    state.plan.is_some_and(|plan| state.step >= plan.fall_from + (plan.steps - plan.fall_from) / 2)
}

/// Indices `b * window / 4 + t` of the tokens inside their crops.
fn valid_tokens(lengths: &[usize], window: usize) -> Vec<usize> {
    let row = window / FRAMES_PER_TOKEN;
    lengths
        .iter()
        .enumerate()
        .flat_map(|(b, length)| (0..length / FRAMES_PER_TOKEN).map(move |t| b * row + t))
        .collect()
}

/// Valid tokens of a batch, their latents and the codes that stand for them.
struct Coded<'b> {
    /// Where they are among all tokens.
    tokens: &'b [usize],
    /// `[tokens][dim]`.
    latents: &'b [f32],
    /// `[tokens][dim]`.
    codes: &'b [f32],
    /// Width of a code.
    dim: usize,
}

/// What the latents are told.
struct Through {
    /// Gradient with respect to them, zero where padded.
    by_latent: Vec<f32>,
    /// Mean squared difference of latents and codes over valid tokens and channels.
    commitment: f32,
}

/// The codes' own gradient (straight-through) plus that of `weight` times the commitment.
fn through(by_code: &[f32], coded: &Coded<'_>, weight: f32) -> Through {
    let Coded { tokens, latents, codes, dim } = *coded;
    let mut by_latent = vec![0.0; by_code.len()];
    let share = 1.0 / latents.len().max(1) as f32;
    let mut commitment = 0.0;
    let pairs = latents.chunks_exact(dim).zip(codes.chunks_exact(dim));
    for (token, (z, code)) in tokens.iter().zip(pairs) {
        for c in 0..dim {
            let difference = z[c] - code[c];
            commitment += share * difference * difference;
            by_latent[token * dim + c] = by_code[token * dim + c] + 2.0 * weight * share * difference;
        }
    }
    Through { by_latent, commitment }
}
