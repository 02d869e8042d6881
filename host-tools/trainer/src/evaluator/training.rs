//! One step of training, and what a finished run is made into.

use burn::tensor::Device;
use motionette_host::dataset::Dataset;

use super::Error;
use super::corpus::Corpus;
use super::judge::Judge;
use super::model::{self, Dropout, Network};
use super::objective::{Terms, objective};
use super::state::State;
use crate::convolution::{Shape, decay_mask};
use crate::optimizer::Settings;
use crate::random::Random;
use crate::schedule::{self, Plan};

/// Figures of one step.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Terms of the objective.
    pub terms: Terms,
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
    shapes: Vec<Shape>,
    decayed: Vec<bool>,
    device: Device,
}

impl Trainer {
    /// A trainer that goes on from `state` with the training split of `dataset`; with new weights when the state has none.
    ///
    /// # Errors
    /// [`Error::Setting`], [`Error::NoMotion`], [`Error::Features`].
    pub fn new(mut state: State, dataset: &Dataset) -> Result<Self, Error> {
        state.config.check()?;
        let corpus = Corpus::new(dataset, state.config.max_words)?;
        let shapes = model::shapes(&state.config, corpus.labels());
        state.begin(&shapes);
        let decayed = decay_mask(&shapes);
        let parameters = state.optimizer.values.len();
        if parameters != decayed.len() {
            let allowed = "the number that configuration and dataset give";
            return Err(Error::Setting { field: "parameters", value: parameters.to_string(), allowed });
        }
        Ok(Self { state, corpus, shapes, decayed, device: Device::flex() })
    }

    /// The training examples.
    pub fn corpus(&self) -> &Corpus {
        &self.corpus
    }

    /// Draws the step's batch and updates the weights.
    ///
    /// # Errors
    /// [`Error::Diverged`] when the objective or its gradient is not finite; the state is then as before the step.
    pub fn step(&mut self) -> Result<Step, Error> {
        let step = self.state.step;
        let config = &self.state.config;
        let mut random = Random::new(config.seed, step);
        let batch = self.corpus.batch(config, &mut random)?;
        let device = self.device.clone().autodiff();
        let network = Network::new(&self.shapes, &self.state.optimizer.values, true, &device);
        let mut dropout = Dropout { share: config.dropout, random: &mut random };
        let motion = network.motion(batch.features.clone(), &batch.lengths, Some(&mut dropout), &device);
        let text = network.text(&batch.sentences, Some(&mut dropout), &device);
        let (total, terms) = objective(motion, text, &batch, config, &device);
        if !terms.total.is_finite() {
            return Err(Error::Diverged { step });
        }
        let mut flat = vec![0.0; self.state.optimizer.values.len()];
        network.collect_gradients(&total.backward(), &mut flat);
        let settings = Settings::new(config.weight_decay, config.clip, config.average_decay);
        let plan = Plan::of_steps(config.steps, config.schedule.decay);
        let rate = schedule::rate(&config.schedule, Some(plan), step);
        let gradient_norm = self.state.optimizer.update(&settings, rate, &flat, &self.decayed);
        if !gradient_norm.is_finite() {
            return Err(Error::Diverged { step });
        }
        self.state.step += 1;
        Ok(Step { terms, rate, gradient_norm })
    }

    /// The averaged weights.
    pub fn judge(&self) -> Judge {
        Judge::new(
            self.state.config.clone(),
            self.corpus.labels().clone(),
            self.corpus.normalization().clone(),
            self.state.optimizer.average.clone(),
            self.state.step,
            self.state.data_hash.clone(),
        )
    }
}
