//! The loop around the steps of a training.

use std::time::Instant;

use anyhow::Context;
use motionette_host::console::say;
use serde_json::{Value, json};

use super::progress::Progress;
use super::{Configuration, Error, EvaluationOf, Length, Means, Options, State, Training};
use crate::schedule::Plan;

/// A training and the state of its run.
pub struct Run<T: Training> {
    /// What is stored.
    pub state: State<T::Config>,
    /// What the steps are made with.
    pub training: T,
}

impl<T: Training> Run<T> {
    /// A run that goes on from `state`.
    ///
    /// # Errors
    /// [`Error::Parameters`] when the state is not of these networks.
    pub fn new(training: T, state: State<T::Config>) -> Result<Self, Error> {
        let (found, expected) = (state.optimizer.values.len(), training.decayed().len());
        if found != expected {
            return Err(Error::Parameters { found, expected });
        }
        Ok(Self { state, training })
    }

    /// Makes one step.
    ///
    /// # Errors
    /// Those of [`Training::step`]; the state is then as before.
    pub fn step(&mut self) -> Result<T::Step, T::Error> {
        let step = self.training.step(&mut self.state)?;
        self.state.step += 1;
        Ok(step)
    }

    /// Trains to the end, with points, checkpoints and progress on the way, and stores checkpoint, state and curves. Returns the last
    /// evaluation, and prints it.
    ///
    /// # Errors
    /// Those of the steps, of evaluations and of files that cannot be written; [`Error::NoEnd`]; [`Error::TooShort`].
    pub fn train(&mut self, options: &Options, length: Length) -> anyhow::Result<EvaluationOf<T>> {
        length.check()?;
        if let Some(steps) = length.steps {
            self.state.plan = Some(Plan::of_steps(steps, self.state.config.schedule().decay));
        }
        // A path that cannot be written should fail now and not after an hour.
        self.state.save(&options.state_file()).context("the state of the run cannot be stored")?;
        let progress = Progress::new();
        self.advance(options, length.seconds(), &progress)?;
        progress.finish();
        let steps = self.state.step;
        let evaluation = self.keep(options, true)?.ok_or(Error::TooShort { steps })?;
        say(&evaluation.to_string());
        Ok(evaluation)
    }

    /// Steps until the end of the plan, which is made on the way when the clock decides.
    fn advance(&mut self, options: &Options, limit: f64, progress: &Progress) -> anyhow::Result<()> {
        let mut clock = Instant::now();
        let mut means = T::Means::default();
        while !self.ended(limit) {
            let step = self.step()?;
            let state = &mut self.state;
            state.seconds += clock.elapsed().as_secs_f64();
            clock = Instant::now();
            means.add(&step);
            progress.show(state.step, || {
                let by_clock = (state.step as f64 * limit / state.seconds.max(1e-9)) as u64;
                state.plan.map_or(by_clock, |plan| plan.steps)
            });
            if !state.step.is_multiple_of(options.log_every) {
                continue;
            }
            let point = std::mem::take(&mut means).point(state.step);
            progress.line(&format!("step {:>6} {:>6.0} s {point}", state.step, state.seconds));
            state.curves.points.push(point);
            if state.step.is_multiple_of(options.log_every.saturating_mul(options.save_every)) {
                if let Some(evaluation) = self.keep(options, false)? {
                    progress.line(&evaluation.to_string());
                }
                // Only steps count as training.
                clock = Instant::now();
            }
        }
        Ok(())
    }

    /// Whether the last step is done; decides where the learning rate begins to fall when only the share of the time that belongs to
    /// the fall is left of `limit` seconds.
    fn ended(&mut self, limit: f64) -> bool {
        let state = &mut self.state;
        let decay = state.config.schedule().decay;
        if state.plan.is_none() && state.seconds >= limit * (1.0 - decay) {
            state.plan = Some(Plan::falling_from(state.step, decay));
        }
        state.plan.is_some_and(|plan| state.step >= plan.steps)
    }

    /// Stores the state, and with it checkpoint and curves once there is something to evaluate.
    fn keep(&mut self, options: &Options, finished: bool) -> anyhow::Result<Option<EvaluationOf<T>>> {
        let (checkpoint, state_file) = (options.checkpoint(), options.state_file());
        let evaluation = self.training.evaluate(&self.state, finished)?;
        if let Some(evaluation) = &evaluation {
            self.training.save(&self.state, evaluation, &checkpoint)?;
            self.state.curves.evaluated(evaluation.clone());
        }
        self.state.save(&state_file)?;
        if evaluation.is_some() {
            self.state.curves.save::<T::Config>(&checkpoint)?;
        }
        Ok(evaluation)
    }

    /// What `--json` prints of every run: files, steps, seconds, number of parameters, and the training's own entries.
    pub fn facts(&self, options: &Options, own: Value) -> Value {
        let mut facts = json!({
            "checkpoint": options.checkpoint(),
            "state": options.state_file(),
            "steps": self.state.step,
            "seconds": self.state.seconds,
            "parameters": self.state.optimizer.values.len(),
        });
        if let (Some(facts), Value::Object(own)) = (facts.as_object_mut(), own) {
            facts.extend(own);
        }
        facts
    }
}
