//! One step of training, and what a finished run is made into.

use std::path::Path;

use burn::tensor::Device;
use motionette_host::dataset::{Dataset, Split};
use serde_json::json;

use super::Error;
use super::config::Config;
use super::corpus::Corpus;
use super::judge::Judge;
use super::model::{self, Dropout, Network};
use super::objective::{Objective, Terms, objective};
use super::state::{Metrics, Point, State};
use crate::convolution::{Shape, decay_mask};
use crate::evaluate::prompt::prompts;
use crate::evaluate::real;
use crate::harness::configuration::DatasetHash;
use crate::harness::{self, Evaluation, Training, Update};
use crate::random::Random;

/// Figures of one step.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Terms of the objective.
    pub terms: Terms,
    /// What the optimiser did.
    pub update: Update,
}

/// Sums over the steps since the last point.
#[derive(Debug, Default)]
pub struct Means {
    steps: f32,
    terms: Terms,
    update: Update,
}

impl harness::Means<Step, Point> for Means {
    fn add(&mut self, step: &Step) {
        self.steps += 1.0;
        self.terms.contrastive += step.terms.contrastive;
        self.terms.content += step.terms.content;
        self.terms.style += step.terms.style;
        self.terms.total += step.terms.total;
        self.update = step.update;
    }

    fn point(&self, step: u64) -> Point {
        let n = self.steps.max(1.0);
        let terms = Terms {
            contrastive: self.terms.contrastive / n,
            content: self.terms.content / n,
            style: self.terms.style / n,
            total: self.terms.total / n,
        };
        Point { step, rate: self.update.rate, terms, gradient_norm: self.update.gradient_norm }
    }
}

/// Data and networks of a run.
pub struct Trainer<'d> {
    dataset: &'d Dataset,
    corpus: Corpus,
    shapes: Vec<Shape>,
    decayed: Vec<bool>,
    device: Device,
}

impl<'d> Trainer<'d> {
    /// A trainer on the training split of `dataset`.
    ///
    /// # Errors
    /// [`Error::NoMotion`], [`Error::Features`].
    pub fn new(config: &Config, dataset: &'d Dataset) -> Result<Self, Error> {
        let corpus = Corpus::new(dataset, config.max_words)?;
        let shapes = model::shapes(config, corpus.labels());
        let decayed = decay_mask(&shapes);
        Ok(Self { dataset, corpus, shapes, decayed, device: Device::flex() })
    }

    /// The training examples.
    pub fn corpus(&self) -> &Corpus {
        &self.corpus
    }

    /// A run of this configuration that has not begun.
    pub fn begin(&self, config: &Config) -> State {
        let sources = DatasetHash { data_hash: self.dataset.hash.clone() };
        State::new(config.clone(), sources, model::initial_parameters(&self.shapes, config.seed), ())
    }

    /// The averaged weights.
    pub fn judge(&self, state: &State) -> Judge {
        Judge::new(
            state.config.clone(),
            self.corpus.labels().clone(),
            self.corpus.normalization().clone(),
            state.optimizer.average.clone(),
            state.step,
            state.sources.data_hash.clone(),
        )
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
        let config = &state.config;
        let mut random = Random::new(config.seed, state.step);
        let batch = self.corpus.batch(config, &mut random)?;
        let device = self.device.clone().autodiff();
        let network = Network::new(&self.shapes, &state.optimizer.values, true, &device);
        let mut dropout = Dropout { share: config.dropout, random: &mut random };
        let motion = network.motion(batch.features.clone(), &batch.lengths, Some(&mut dropout), &device);
        let text = network.text(&batch.sentences, Some(&mut dropout), &device);
        let Objective { total, terms } = objective(motion, text, &batch, config, &device);
        state.check_finite(f64::from(terms.total))?;
        let mut flat = vec![0.0; state.optimizer.values.len()];
        network.collect_gradients(&total.backward(), &mut flat);
        let update = state.update(&flat, &self.decayed)?;
        Ok(Step { terms, update })
    }

    fn evaluate(&self, state: &State, _finished: bool) -> Result<Option<Evaluation<Metrics>>, Error> {
        let report = figures(&self.judge(state), self.dataset, &[Split::Val])?;
        Ok(Some(Evaluation { step: state.step, report }))
    }

    fn save(&self, state: &State, evaluation: &Evaluation<Metrics>, path: &Path) -> Result<(), Error> {
        Ok(self.judge(state).save(path, &json!(evaluation.report))?)
    }
}

/// Figures of real motion, of the `splits` that have labels.
///
/// # Errors
/// [`Error::Features`] when a clip has no features.
pub fn figures(judge: &Judge, dataset: &Dataset, splits: &[Split]) -> Result<Metrics, Error> {
    let labelled = splits.iter().filter(|split| !prompts(dataset, **split).is_empty());
    let measured =
        labelled.map(|split| -> Result<_, Error> { Ok((split.to_string(), real::measure(judge, dataset, *split)?)) });
    Ok(Metrics(measured.collect::<Result<_, _>>()?))
}
