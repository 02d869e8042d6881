//! Everything a run needs to go on, as one file: configuration, sources, parameters, moments, averages, step, plan, curves.

use std::path::Path;

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::{Configuration, Curves, Error, Extra, Sources};
use crate::optimizer::AdamW;
use crate::schedule::{self, Plan};

/// A run between two steps.
#[derive(Clone, Debug, PartialEq)]
pub struct State<C: Configuration> {
    /// Configuration of the run.
    pub config: C,
    /// What it belongs to.
    pub sources: C::Sources,
    /// Steps done.
    pub step: u64,
    /// Seconds spent in steps, over all parts of the run.
    pub seconds: f64,
    /// The end, once it is known.
    pub plan: Option<Plan>,
    /// Parameters, moments, average.
    pub optimizer: AdamW,
    /// What the training keeps beside them.
    pub extra: C::Extra,
    /// The course so far.
    pub curves: Curves<C::Point, C::Evaluation>,
}

/// What an update of the parameters did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Update {
    /// Learning rate.
    pub rate: f32,
    /// Global norm of the gradient, before clipping.
    pub gradient_norm: f32,
}

impl<C: Configuration> State<C> {
    /// A run that has not begun, with its first parameters.
    pub fn new(config: C, sources: C::Sources, parameters: Vec<f32>, extra: C::Extra) -> Self {
        Self {
            config,
            sources,
            step: 0,
            seconds: 0.0,
            plan: None,
            optimizer: AdamW::new(parameters),
            extra,
            curves: Curves::default(),
        }
    }

    /// Changes the parameters along their gradient, at the learning rate of this step. `decayed` says to which of them weight decay
    /// applies.
    ///
    /// # Errors
    /// [`Error::Diverged`] when the gradient is not finite; nothing has changed then.
    pub fn update(&mut self, gradient: &[f32], decayed: &[bool]) -> Result<Update, Error> {
        let rate = schedule::rate(&self.config.schedule(), self.plan, self.step);
        let gradient_norm = self.optimizer.update(&self.config.optimizer(), rate, gradient, decayed);
        self.check_finite(f64::from(gradient_norm))?;
        Ok(Update { rate, gradient_norm })
    }

    /// Checks that the objective of this step is a number.
    ///
    /// # Errors
    /// [`Error::Diverged`].
    pub fn check_finite(&self, objective: f64) -> Result<(), Error> {
        if objective.is_finite() { Ok(()) } else { Err(Error::Diverged { step: self.step }) }
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        let mut file = C::STATE.file();
        let mut run = Map::new();
        for (entry, value) in [
            ("config", json!(self.config)),
            ("step", json!(self.step)),
            ("seconds", json!(self.seconds)),
            ("plan", json!(self.plan)),
            ("updates", json!(self.optimizer.updates)),
            ("parameters", json!(self.optimizer.values.len())),
        ] {
            run.insert(entry.to_owned(), value);
        }
        match json!(self.sources) {
            Value::Object(entries) if !C::Sources::NESTED => run.extend(entries),
            sources => drop(run.insert("sources".to_owned(), sources)),
        }
        self.extra.store(&mut run, &mut file);
        file.metadata.insert("run".to_owned(), Value::Object(run).to_string());
        file.metadata.insert("curves".to_owned(), json!(self.curves).to_string());
        self.optimizer.store(&mut file);
        Ok(file.save(path)?)
    }

    /// Reads a file that [`Self::save`] wrote.
    ///
    /// # Errors
    /// [`Error::File`] naming the entry or tensor that does not fit, [`Error::Setting`] for a configuration out of range.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let file = C::STATE.load(path)?;
        let Facts { config, step, seconds, plan, updates } = file.parsed::<Facts<C>>("run")?;
        let config = config.checked()?;
        let sources =
            if C::Sources::NESTED { file.parsed::<Nested<C::Sources>>("run")?.sources } else { file.parsed("run")? };
        // The evaluator's states had no curves at first.
        let curves = if file.metadata.contains_key("curves") { file.parsed("curves")? } else { Curves::default() };
        let optimizer = AdamW::restore(&file, updates)?;
        let extra = C::Extra::restore(&config, &file)?;
        Ok(Self { config, sources, step, seconds, plan, optimizer, extra, curves })
    }

    /// Reads the state of a run of this configuration and these sources, to go on with it.
    ///
    /// # Errors
    /// Those of [`Self::load`], and [`Error::OtherRun`] when configuration or sources differ.
    pub fn resume(path: &Path, config: &C, sources: &C::Sources) -> Result<Self, Error> {
        let state = Self::load(path)?;
        let what = if state.config == *config { state.sources.difference(sources) } else { Some("configuration") };
        match what {
            Some(what) => Err(Error::OtherRun { path: path.to_path_buf(), what }),
            None => Ok(state),
        }
    }
}

/// Metadata entry `run`, without the sources.
#[derive(Deserialize)]
struct Facts<C> {
    config: C,
    step: u64,
    seconds: f64,
    // The evaluator's states had no plan at first: theirs follows from the configuration.
    #[serde(default)]
    plan: Option<Plan>,
    updates: u64,
}

/// Sources in an entry of their own.
#[derive(Deserialize)]
struct Nested<S> {
    sources: S,
}
