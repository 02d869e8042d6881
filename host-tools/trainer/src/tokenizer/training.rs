//! One step of training, and what a finished part of a run is made into.
//!
//! The graph is cut at the codes: the decoder is differentiated down to the code vectors, the straight-through estimator hands
//! that gradient to the latents, the commitment term is added there, and the encoder is differentiated from the latents.

use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::dataset::Dataset;

use super::Error;
use super::batch::{Batch, Corpus};
use super::checkpoint::Checkpoint;
use super::config::{Config, FEATURES, FRAMES_PER_TOKEN};
use super::loss::{Objective, Terms};
use super::model::{self, Masks, Network};
use super::quantizer::Codebook;
use super::state::State;
use crate::convolution::decay_mask;
use crate::optimizer::Settings;
use crate::random::Random;
use crate::schedule;

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
    /// Learning rate.
    pub rate: f32,
    /// Global norm of the gradient.
    pub gradient_norm: f32,
}

/// A run in memory.
pub struct Trainer {
    /// What is stored.
    pub state: State,
    corpus: Corpus,
    objective: Objective,
    device: Device,
    decayed: Vec<bool>,
}

impl Trainer {
    /// A trainer that goes on from `state` with the training split of `dataset`.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::NoMotion`], [`Error::Mirror`].
    pub fn new(state: State, dataset: &Dataset) -> Result<Self, Error> {
        state.config.check()?;
        let corpus = Corpus::new(dataset)?;
        let objective = Objective::new(&state.config.loss, corpus.normalization());
        let decayed = decay_mask(&model::shapes(&state.config.architecture));
        Ok(Self { state, corpus, objective, device: Device::flex(), decayed })
    }

    /// The training motions.
    pub fn corpus(&self) -> &Corpus {
        &self.corpus
    }

    /// Draws the step's batch, updates weights and codebook.
    ///
    /// # Errors
    /// [`Error::Diverged`] when the objective or its gradient is not finite; the state is then as before the step.
    pub fn step(&mut self) -> Result<Step, Error> {
        let step = self.state.step;
        let config = self.state.config.clone();
        let dim = config.architecture.code_dim;
        if self.state.codebook.is_none() && step >= config.quantize_from {
            self.state.codebook = Some(self.first_codebook(&config));
        }
        let mut random = Random::new(config.seed, step);
        let batch = self.corpus.batch(config.batch, config.window, &mut random);
        let device = self.device.clone().autodiff();
        let masks = Masks::new(&batch.lengths, config.window, &device);
        let network = Network::new(&config.architecture, &self.state.optimizer.values, true, &device);

        let latents = network.encode(self.features(&batch, &config, &device), masks.as_ref());
        let z = latents.to_data().try_into_vec::<f32>().expect("latents are f32");
        let tokens = valid_tokens(&batch.lengths, config.window);
        let valid: Vec<f32> = tokens.iter().flat_map(|token| z[token * dim..][..dim].iter().copied()).collect();
        let (codes, ids) = match &self.state.codebook {
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
        let terms = self.objective.evaluate(&y, &batch.features, &batch.lengths, config.window, &mut by_output);
        if !terms.total.is_finite() {
            return Err(Error::Diverged { step });
        }

        let mut flat = vec![0.0; self.state.optimizer.values.len()];
        let by_output = Tensor::<3>::from_data(TensorData::new(by_output, output.dims()), &device);
        let gradients = (output * by_output).sum().backward();
        network.collect_gradients(&gradients, &mut flat);
        let by_code = u.grad(&gradients).expect("the codes are a leaf").into_data();
        let by_code = by_code.try_into_vec::<f32>().expect("gradients are f32");
        let (by_latent, commitment) = through(&by_code, &tokens, &valid, &codes, dim, config.loss.commitment);
        let by_latent = Tensor::<3>::from_data(TensorData::new(by_latent, shape), &device);
        let gradients = (latents * by_latent).sum().backward();
        network.collect_gradients(&gradients, &mut flat);

        let settings = Settings::new(config.weight_decay, config.clip, config.average_decay);
        let rate = schedule::rate(&config.schedule(), self.state.plan, step);
        let gradient_norm = self.state.optimizer.update(&settings, rate, &flat, &self.decayed);
        if !gradient_norm.is_finite() {
            return Err(Error::Diverged { step });
        }
        let dead_below = if self.settling() { 0.0 } else { config.dead_below };
        let moved = match &mut self.state.codebook {
            Some(book) => book.update(&valid, &ids, config.codebook_decay, dead_below, &mut random),
            None => 0,
        };
        self.state.step += 1;
        Ok(Step { terms, commitment, ids, moved, rate, gradient_norm })
    }

    /// The averaged weights with the codebook; None before quantisation.
    pub fn checkpoint(&self) -> Option<Checkpoint> {
        let book = self.state.codebook.as_ref()?;
        Some(Checkpoint {
            config: self.state.config.clone(),
            parameters: self.state.optimizer.average.clone(),
            codebook: book.rows.clone(),
            normalization: self.corpus.normalization().clone(),
            steps: self.state.step,
            data_hash: self.state.data_hash.clone(),
        })
    }

    /// Whether the learning rate has fallen so far that codes should no longer jump: the second half of the fall.
    fn settling(&self) -> bool {
        self.state.plan.is_some_and(|plan| self.state.step >= plan.fall_from + (plan.steps - plan.fall_from) / 2)
    }

    fn features(&self, batch: &Batch, config: &Config, device: &Device) -> Tensor<3> {
        let shape = [batch.lengths.len(), config.window, FEATURES];
        Tensor::from_data(TensorData::new(batch.features.clone(), shape), device)
    }

    /// k-means over latents of fresh batches.
    fn first_codebook(&self, config: &Config) -> Codebook {
        let dim = config.architecture.code_dim;
        let network = Network::new(&config.architecture, &self.state.optimizer.values, false, &self.device);
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

/// Indices `b * window / 4 + t` of the tokens inside their crops.
fn valid_tokens(lengths: &[usize], window: usize) -> Vec<usize> {
    let row = window / FRAMES_PER_TOKEN;
    lengths
        .iter()
        .enumerate()
        .flat_map(|(b, length)| (0..length / FRAMES_PER_TOKEN).map(move |t| b * row + t))
        .collect()
}

/// Gradient with respect to the latents: the codes' own (straight-through) plus that of `weight` times the commitment, the mean
/// squared difference of latents and codes over valid tokens and channels. Zero where padded. Returns it with the commitment.
fn through(
    by_code: &[f32],
    tokens: &[usize],
    latents: &[f32],
    codes: &[f32],
    dim: usize,
    weight: f32,
) -> (Vec<f32>, f32) {
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
    (by_latent, commitment)
}
