//! One step of training: a corrupted batch, cross-entropy of its clean tokens, an update.

use burn::tensor::{Device, Tensor, TensorData};

use super::Error;
use super::corpus::{Corpus, Labelled};
use super::corruption::Metric;
use super::model;
use super::state::State;
use crate::optimizer::Settings;
use crate::random::Random;
use crate::schedule;
use crate::transformer::Weights;

/// Streams of dropout lie beside those of the batches.
const DROPOUT_STREAM: u64 = 1 << 41;

/// Cross-entropy over some tokens.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Sum of `-ln p(clean token)`.
    pub loss: f64,
    /// Tokens whose most likely code is the clean one.
    pub right: f64,
    /// Tokens.
    pub count: f64,
}

impl Score {
    /// Adds another one.
    pub fn add(&mut self, other: Self) {
        self.loss += other.loss;
        self.right += other.right;
        self.count += other.count;
    }
}

/// Figures of one step.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Of the tokens that were to be planned.
    pub tokens: Score,
    /// Of the lengths.
    pub length: Score,
    /// Learning rate.
    pub rate: f32,
    /// Global norm of the gradient.
    pub gradient_norm: f32,
}

/// Scores rows of logits against targets (`None` rows do not count) and turns them into `weight * dloss/dlogits`.
pub fn cross_entropy(logits: &mut [f32], targets: &[Option<usize>], weight: f32) -> Score {
    let classes = logits.len() / targets.len().max(1);
    let mut score = Score::default();
    for (row, target) in logits.chunks_exact_mut(classes.max(1)).zip(targets) {
        let Some(target) = *target else {
            row.fill(0.0);
            continue;
        };
        let largest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        score.right += f64::from(u8::from(row[target] >= largest));
        let total: f32 = row.iter().map(|x| (x - largest).exp()).sum();
        score.loss += f64::from(total.ln() + largest - row[target]);
        score.count += 1.0;
        for x in row.iter_mut() {
            *x = weight * (*x - largest).exp() / total;
        }
        row[target] -= weight;
    }
    score
}

/// Targets of a padded batch: clean tokens that are not fixed, and lengths.
pub fn targets(batch: &[Labelled]) -> (Vec<Option<usize>>, Vec<Option<usize>>) {
    let window = batch.iter().map(|l| l.clean.len()).max().unwrap_or(1);
    let token = |l: &Labelled, i: usize| match l.example.fixed.get(i) {
        Some(false) => l.clean.get(i).map(|c| usize::from(*c)),
        _ => None,
    };
    let tokens = batch.iter().flat_map(|l| (0..window).map(|i| token(l, i)).collect::<Vec<_>>()).collect();
    (tokens, batch.iter().map(|l| l.length.map(|n| n - 1)).collect())
}

/// Values of a tensor.
pub fn values(tensor: &Tensor<3>) -> Vec<f32> {
    tensor.to_data().try_into_vec().expect("networks compute in f32")
}

/// A run in memory.
pub struct Trainer<'d> {
    /// What is stored.
    pub state: State,
    corpus: Corpus<'d>,
    metric: Metric,
    decayed: Vec<bool>,
}

impl<'d> Trainer<'d> {
    /// A trainer that goes on from `state`.
    pub fn new(state: State, corpus: Corpus<'d>, metric: Metric) -> Self {
        let decayed = state.layout().decayed();
        Self { state, corpus, metric, decayed }
    }

    /// Draws the step's batch and updates the weights.
    ///
    /// # Errors
    /// [`Error::Diverged`] when the objective or its gradient is not finite; the state is then as before the step.
    pub fn step(&mut self) -> Result<Step, Error> {
        let (step, config) = (self.state.step, &self.state.config);
        let batch = self.corpus.batch(config, &self.metric, step);
        let device = Device::flex().autodiff();
        let layout = self.state.layout();
        let weights = Weights::new(&layout, &self.state.optimizer.values, true, &device);
        let examples: Vec<_> = batch.iter().map(|l| l.example.clone()).collect();
        let random = Random::new(config.seed, DROPOUT_STREAM + step);
        let output = model::forward(&config.architecture, &weights, &examples, &mut (), config.dropout, random);
        let (token_targets, length_targets) = targets(&batch);
        let share = |targets: &[Option<usize>]| 1.0 / targets.iter().flatten().count().max(1) as f32;

        let mut by_tokens = values(&output.tokens);
        let tokens = cross_entropy(&mut by_tokens, &token_targets, share(&token_targets));
        let mut by_length = values(&output.length);
        let length = cross_entropy(&mut by_length, &length_targets, config.length * share(&length_targets));
        if !(tokens.loss + length.loss).is_finite() {
            return Err(Error::Diverged { step });
        }
        let leaf =
            |values: Vec<f32>, like: &Tensor<3>| Tensor::<3>::from_data(TensorData::new(values, like.dims()), &device);
        let (by_tokens, by_length) = (leaf(by_tokens, &output.tokens), leaf(by_length, &output.length));
        let total = (output.tokens * by_tokens).sum() + (output.length * by_length).sum();
        let mut flat = vec![0.0; self.state.optimizer.values.len()];
        weights.collect_gradients(&total.backward(), &mut flat);

        let settings = Settings::new(config.weight_decay, config.clip, config.average_decay);
        let rate = schedule::rate(&config.schedule, self.state.plan, step);
        let gradient_norm = self.state.optimizer.update(&settings, rate, &flat, &self.decayed);
        if !gradient_norm.is_finite() {
            return Err(Error::Diverged { step });
        }
        self.state.step += 1;
        Ok(Step { tokens, length, rate, gradient_norm })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cross_entropy_and_its_gradient() {
        let logits = [0.5f32, -1.0, 2.0, 0.1, 0.2, 0.3, 9.0, 9.0, 9.0];
        let targets = [Some(2), Some(0), None];
        let loss = |logits: &[f32]| cross_entropy(&mut logits.to_vec(), &targets, 1.0).loss;
        let mut gradient = logits.to_vec();
        let score = cross_entropy(&mut gradient, &targets, 1.0);
        assert_eq!((score.count, score.right), (2.0, 1.0));
        for i in 0..logits.len() {
            let mut moved = logits;
            moved[i] += 1e-3;
            let above = loss(&moved);
            moved[i] -= 2e-3;
            let slope = (above - loss(&moved)) / 2e-3;
            assert!((slope - f64::from(gradient[i])).abs() < 1e-3, "{i}: {slope} {}", gradient[i]);
        }
    }
}
