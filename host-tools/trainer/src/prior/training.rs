//! One step of training: a corrupted batch, cross-entropy of its clean tokens, an update.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};

use super::config::Config;
use super::corpus::{Corpus, Labelled};
use super::corruption::Metric;
use super::curves::Point;
use super::state::State;
use super::validation::{self, Report};
use super::{checkpoint, model};
use crate::harness::{self, Error, Evaluation, Training, Update};
use crate::random::Random;
use crate::transformer::{Dropout, Layout, Weights};

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
    /// What the optimiser did.
    pub update: Update,
}

/// Sums over the steps since the last point.
#[derive(Debug, Default)]
pub struct Means {
    tokens: Score,
    length: Score,
    update: Update,
}

impl harness::Means<Step, Point> for Means {
    fn add(&mut self, step: &Step) {
        self.tokens.add(step.tokens);
        self.length.add(step.length);
        self.update = step.update;
    }

    fn point(&self, step: u64) -> Point {
        let mean = |sum: f64, of: &Score| sum / of.count.max(1.0);
        Point {
            step,
            rate: self.update.rate,
            loss: mean(self.tokens.loss, &self.tokens),
            accuracy: mean(self.tokens.right, &self.tokens),
            length: mean(self.length.loss, &self.length),
            gradient_norm: self.update.gradient_norm,
        }
    }
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

/// What the networks should say of a padded batch; none where nothing is asked.
pub struct Targets {
    /// Clean tokens that are not fixed, `[B][L]`.
    pub tokens: Vec<Option<usize>>,
    /// Classes of the lengths, one less than the tokens, `[B]`.
    pub lengths: Vec<Option<usize>>,
}

impl Targets {
    /// Of a batch.
    pub fn of(batch: &[Labelled]) -> Self {
        let window = batch.iter().map(|l| l.clean.len()).max().unwrap_or(1);
        let token = |l: &Labelled, i: usize| match l.example.fixed.get(i) {
            Some(false) => l.clean.get(i).map(|c| usize::from(*c)),
            _ => None,
        };
        let tokens = batch.iter().flat_map(|l| (0..window).map(|i| token(l, i)).collect::<Vec<_>>()).collect();
        Self { tokens, lengths: batch.iter().map(|l| l.length.map(|n| n - 1)).collect() }
    }
}

/// Values of a tensor.
pub fn values(tensor: &Tensor<3>) -> Vec<f32> {
    tensor.to_data().try_into_vec().expect("networks compute in f32")
}

/// Data and networks of a run.
pub struct Trainer<'d> {
    corpus: Corpus<'d>,
    held_out: Option<Corpus<'d>>,
    metric: Metric,
    layout: Layout,
    decayed: Vec<bool>,
}

impl<'d> Trainer<'d> {
    /// A trainer of networks of this layout on `corpus`, which is measured on `held_out` where there is any.
    pub fn new(layout: Layout, corpus: Corpus<'d>, held_out: Option<Corpus<'d>>, metric: Metric) -> Self {
        let decayed = layout.decayed();
        Self { corpus, held_out, metric, layout, decayed }
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
        let batch = self.corpus.batch(config, &self.metric, step);
        let device = Device::flex().autodiff();
        let weights = Weights::new(&self.layout, &state.optimizer.values, true, &device);
        let examples: Vec<_> = batch.iter().map(|l| l.example.clone()).collect();
        let dropout = Dropout::new(config.dropout, Random::new(config.seed, DROPOUT_STREAM + step));
        let output = model::forward(&config.architecture, &weights, &examples, &mut (), dropout);
        let targets = Targets::of(&batch);
        let share = |targets: &[Option<usize>]| 1.0 / targets.iter().flatten().count().max(1) as f32;

        let mut by_tokens = values(&output.tokens);
        let tokens = cross_entropy(&mut by_tokens, &targets.tokens, share(&targets.tokens));
        let mut by_length = values(&output.length);
        let length = cross_entropy(&mut by_length, &targets.lengths, config.length * share(&targets.lengths));
        state.check_finite(tokens.loss + length.loss)?;
        let leaf =
            |values: Vec<f32>, like: &Tensor<3>| Tensor::<3>::from_data(TensorData::new(values, like.dims()), &device);
        let (by_tokens, by_length) = (leaf(by_tokens, &output.tokens), leaf(by_length, &output.length));
        let total = (output.tokens * by_tokens).sum() + (output.length * by_length).sum();
        let mut flat = vec![0.0; state.optimizer.values.len()];
        weights.collect_gradients(&total.backward(), &mut flat);
        let update = state.update(&flat, &self.decayed)?;
        Ok(Step { tokens, length, update })
    }

    fn evaluate(&self, state: &State, _finished: bool) -> Result<Option<Evaluation<Report>>, Error> {
        let report = self.held_out.as_ref().map(|corpus| validation::measure(state, corpus, &self.metric));
        Ok(Some(Evaluation { step: state.step, report: report.unwrap_or_default() }))
    }

    fn save(&self, state: &State, evaluation: &Evaluation<Report>, path: &Path) -> Result<(), Error> {
        checkpoint::save(state, path, &evaluation.report)
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
