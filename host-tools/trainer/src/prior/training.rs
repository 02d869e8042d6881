//! One step of training: a corrupted batch, cross-entropy of its clean tokens, an update.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};

use super::captions::UNCONDITIONAL;
use super::config::{Architecture, Config};
use super::corpus::{Corpus, Labelled};
use super::corruption::Metric;
use super::curves::Point;
use super::model::Example;
use super::state::State;
use super::validation::{self, Report};
use super::{checkpoint, model};
use crate::harness::{self, Error, Evaluation, Training, Update};
use crate::random::Random;
use crate::transformer::{Dropout, Layout, Weights};

/// Streams of dropout lie beside those of the batches.
const DROPOUT_STREAM: u64 = 1 << 41;
/// Streams of the strengths of guidance.
const STRENGTH_STREAM: u64 = 1 << 43;
/// Guidance is distilled from strength 1 to 4.
const WEAKEST_TO_STRONGEST: f32 = 3.0;

/// A strength of guidance to learn.
pub fn strength(random: &mut Random) -> f32 {
    1.0 + WEAKEST_TO_STRONGEST * random.unit() as f32
}

/// `with` becomes the logits of two passes guided by `strength`.
pub fn guide(with: &mut [f32], without: &[f32], strength: f32) {
    for (with, without) in with.iter_mut().zip(without) {
        *with = without + strength * (*with - without);
    }
}

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
    /// Of what the sentences mean.
    pub meaning: Score,
    /// What the optimiser did.
    pub update: Update,
}

/// Sums over the steps since the last point.
#[derive(Debug, Default)]
pub struct Means {
    tokens: Score,
    length: Score,
    meaning: Score,
    update: Update,
}

impl harness::Means<Step, Point> for Means {
    fn add(&mut self, step: &Step) {
        self.tokens.add(step.tokens);
        self.length.add(step.length);
        self.meaning.add(step.meaning);
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
            meaning: mean(self.meaning.loss, &self.meaning),
            understood: mean(self.meaning.right, &self.meaning),
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

/// Scores rows of logits, one of each meaning, against the meanings that sentences have (`None` rows do not count) by the cross-entropy of
/// each and turns them into `weight * dloss/dlogits`. A row is right when the likeliest meaning is one that it has, or none is likely and
/// it has none.
pub fn binary_cross_entropy(logits: &mut [f32], targets: &[Option<&[usize]>], weight: f32) -> Score {
    let classes = (logits.len() / targets.len().max(1)).max(1);
    let mut score = Score::default();
    for (row, target) in logits.chunks_exact_mut(classes).zip(targets) {
        let Some(target) = *target else {
            row.fill(0.0);
            continue;
        };
        let likeliest = (0..row.len()).max_by(|a, b| row[*a].total_cmp(&row[*b])).unwrap_or_default();
        let right = if target.is_empty() { row[likeliest] < 0.0 } else { target.contains(&likeliest) };
        score.right += f64::from(u8::from(right));
        score.count += 1.0;
        for (class, x) in row.iter_mut().enumerate() {
            let wanted = if target.contains(&class) { 1.0 } else { 0.0 };
            // ln(1 + e^x) - wanted x, without overflow.
            score.loss += f64::from(x.max(0.0) - wanted * *x + (-x.abs()).exp().ln_1p());
            *x = weight * (1.0 / (1.0 + (-*x).exp()) - wanted);
        }
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
    teacher: Option<Teacher>,
}

/// A prior whose two passes another learns to make in one.
pub struct Teacher {
    architecture: Architecture,
    weights: Weights,
}

impl Teacher {
    /// A prior that was trained.
    pub fn new(checkpoint: &checkpoint::Checkpoint) -> Self {
        let layout = checkpoint.sources.layout(&checkpoint.config);
        let weights = Weights::new(&layout, &checkpoint.parameters, false, &Device::flex());
        Self { architecture: checkpoint.config.architecture.clone(), weights }
    }

    /// Guided logits `[B][L][V]` of a batch: `unconditional + strength (conditional - unconditional)`.
    fn logits(&self, batch: &[Example]) -> Vec<f32> {
        let pass = |batch: &[Example]| {
            values(&model::forward(&self.architecture, &self.weights, batch, &mut (), Dropout::off()).tokens)
        };
        let unconditional: Vec<Example> =
            batch.iter().map(|e| Example { words: vec![UNCONDITIONAL], ..e.clone() }).collect();
        let (mut with, without) = (pass(batch), pass(&unconditional));
        let each = with.len() / batch.len().max(1);
        for ((with, without), example) in
            with.chunks_exact_mut(each.max(1)).zip(without.chunks_exact(each.max(1))).zip(batch)
        {
            guide(with, without, example.strength);
        }
        with
    }
}

/// Scores rows of logits against the distributions of a teacher's, where there is a target, by the cross-entropy of these, and turns them
/// into `weight * dloss/dlogits`. A row is right when both find the same class likeliest.
pub fn soft_cross_entropy(logits: &mut [f32], teacher: &[f32], targets: &[Option<usize>], weight: f32) -> Score {
    let classes = (logits.len() / targets.len().max(1)).max(1);
    let mut score = Score::default();
    let softmax = |row: &[f32]| -> (Vec<f32>, f32) {
        let largest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let total: f32 = row.iter().map(|x| (x - largest).exp()).sum();
        (row.iter().map(|x| (x - largest).exp() / total).collect(), total.ln() + largest)
    };
    let likeliest = |row: &[f32]| (0..row.len()).max_by(|a, b| row[*a].total_cmp(&row[*b]));
    for ((row, taught), target) in logits.chunks_exact_mut(classes).zip(teacher.chunks_exact(classes)).zip(targets) {
        if target.is_none() {
            row.fill(0.0);
            continue;
        }
        let ((p, normal), (q, _)) = (softmax(row), softmax(taught));
        score.right += f64::from(u8::from(likeliest(row) == likeliest(taught)));
        score.loss += row.iter().zip(&q).map(|(x, q)| f64::from(q * (normal - x))).sum::<f64>();
        score.count += 1.0;
        for ((x, p), q) in row.iter_mut().zip(p).zip(q) {
            *x = weight * (p - q);
        }
    }
    score
}

impl<'d> Trainer<'d> {
    /// A trainer of networks of this layout on `corpus`, which is measured on `held_out` where there is any.
    pub fn new(layout: Layout, corpus: Corpus<'d>, held_out: Option<Corpus<'d>>, metric: Metric) -> Self {
        let decayed = layout.decayed();
        Self { corpus, held_out, metric, layout, decayed, teacher: None }
    }

    /// One that learns what a teacher says of the batches with guidance, not their tokens.
    #[must_use]
    pub fn taught(self, teacher: Teacher) -> Self {
        Self { teacher: Some(teacher), ..self }
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
        let mut examples: Vec<Example> = batch.iter().map(|l| l.example.clone()).collect();
        if self.teacher.is_some() {
            let mut random = Random::new(config.seed, STRENGTH_STREAM + step);
            examples.iter_mut().for_each(|e| e.strength = strength(&mut random));
        }
        let dropout = Dropout::new(config.dropout, Random::new(config.seed, DROPOUT_STREAM + step));
        let output = model::forward(&config.architecture, &weights, &examples, &mut (), dropout);
        let nonsense = self.corpus.nonsense(config, step, config.nonsense);
        let targets = Targets::of(&batch);
        let share = |targets: &[Option<usize>]| 1.0 / targets.iter().flatten().count().max(1) as f32;

        let mut by_tokens = values(&output.tokens);
        let tokens = match &self.teacher {
            None => cross_entropy(&mut by_tokens, &targets.tokens, share(&targets.tokens)),
            Some(teacher) => {
                let taught = teacher.logits(&examples);
                soft_cross_entropy(&mut by_tokens, &taught, &targets.tokens, share(&targets.tokens))
            }
        };
        let mut by_length = values(&output.length);
        let length = cross_entropy(&mut by_length, &targets.lengths, config.length * share(&targets.lengths));
        let mut meaning = Score::default();
        let mut understood = Vec::new();
        // The meanings of the batch's sentences, and that others have none.
        if let Some(own) = output.meaning {
            let mut off = Dropout::off();
            let sentences: Vec<&[usize]> = nonsense.iter().map(|said| said.words.as_slice()).collect();
            let others = (!sentences.is_empty())
                .then(|| model::encode(&config.architecture, &weights, &sentences, &mut off).meaning(&weights));
            let own_targets = batch.iter().map(|l| l.meanings.as_deref()).collect::<Vec<_>>();
            let other_targets = nonsense.iter().map(|said| said.meanings.as_deref()).collect::<Vec<_>>();
            let count = own_targets.iter().chain(&other_targets).flatten().count().max(1);
            let weight = config.meaning / count as f32;
            for (logits, targets) in
                std::iter::once((own, own_targets)).chain(others.flatten().zip(Some(other_targets)))
            {
                let mut by_logits = values(&logits);
                meaning.add(binary_cross_entropy(&mut by_logits, &targets, weight));
                understood.push((logits, by_logits));
            }
        }
        state.check_finite(tokens.loss + length.loss + meaning.loss)?;
        let leaf =
            |values: Vec<f32>, like: &Tensor<3>| Tensor::<3>::from_data(TensorData::new(values, like.dims()), &device);
        let (by_tokens, by_length) = (leaf(by_tokens, &output.tokens), leaf(by_length, &output.length));
        let mut total = (output.tokens * by_tokens).sum() + (output.length * by_length).sum();
        for (logits, by_logits) in understood {
            let by_logits = leaf(by_logits, &logits);
            total = total + (logits * by_logits).sum();
        }
        let mut flat = vec![0.0; state.optimizer.values.len()];
        weights.collect_gradients(&total.backward(), &mut flat);
        let update = state.update(&flat, &self.decayed)?;
        Ok(Step { tokens, length, meaning, update })
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
    fn binary_cross_entropy_and_its_gradient() {
        let logits = [0.5f32, -1.0, 2.0, 0.1, -0.2, -0.3, -40.0, -1.0, -2.0];
        let targets: [Option<&[usize]>; 3] = [Some(&[0, 2]), None, Some(&[])];
        let loss = |logits: &[f32]| binary_cross_entropy(&mut logits.to_vec(), &targets, 1.0).loss;
        let mut gradient = logits.to_vec();
        let score = binary_cross_entropy(&mut gradient, &targets, 1.0);
        assert_eq!((score.count, score.right), (2.0, 2.0));
        let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
        let wanted = [sigmoid(0.5), 1.0 - sigmoid(-1.0), sigmoid(2.0), 1.0 - sigmoid(-1.0), 1.0 - sigmoid(-2.0)];
        assert!((score.loss + wanted.map(f64::ln).iter().sum::<f64>()).abs() < 1e-5);
        for i in 0..logits.len() {
            let slope = crate::testing::slope(loss, &logits, i, 1e-3);
            assert!((slope - f64::from(gradient[i])).abs() < 1e-3, "{i}: {slope} {}", gradient[i]);
        }
    }

    #[test]
    fn soft_cross_entropy_and_its_gradient() {
        let logits = [0.5f32, -1.0, 2.0, 0.1, 0.2, 0.3];
        let teacher = [1.0f32, 0.0, 3.0, 9.0, 9.0, 9.0];
        let targets = [Some(0), None];
        let loss = |logits: &[f32]| soft_cross_entropy(&mut logits.to_vec(), &teacher, &targets, 1.0).loss;
        let mut gradient = logits.to_vec();
        let score = soft_cross_entropy(&mut gradient, &teacher, &targets, 1.0);
        assert_eq!((score.count, score.right), (1.0, 1.0));
        for i in 0..logits.len() {
            let slope = crate::testing::slope(loss, &logits, i, 1e-3);
            assert!((slope - f64::from(gradient[i])).abs() < 1e-3, "{i}: {slope} {}", gradient[i]);
        }
        // The teacher's own logits cannot be bettered.
        let mut own = teacher;
        soft_cross_entropy(&mut own, &teacher, &targets, 1.0);
        assert!(own.iter().all(|g| g.abs() < 1e-6), "{own:?}");
    }

    #[test]
    fn cross_entropy_and_its_gradient() {
        let logits = [0.5f32, -1.0, 2.0, 0.1, 0.2, 0.3, 9.0, 9.0, 9.0];
        let targets = [Some(2), Some(0), None];
        let loss = |logits: &[f32]| cross_entropy(&mut logits.to_vec(), &targets, 1.0).loss;
        let mut gradient = logits.to_vec();
        let score = cross_entropy(&mut gradient, &targets, 1.0);
        assert_eq!((score.count, score.right), (2.0, 1.0));
        for i in 0..logits.len() {
            let slope = crate::testing::slope(loss, &logits, i, 1e-3);
            assert!((slope - f64::from(gradient[i])).abs() < 1e-3, "{i}: {slope} {}", gradient[i]);
        }
    }
}
