//! What a training does.

use std::path::Path;

use super::{Configuration, State};

/// Data, networks and objective of a training; what a run changes is in its [`State`].
///
/// Steps depend on configuration, sources, state and number alone, never on what ran before in the same process.
pub trait Training {
    /// What decides a run.
    type Config: Configuration;
    /// Figures of one step.
    type Step;
    /// Their means between two points of the curves.
    type Means: Means<Self::Step, <Self::Config as Configuration>::Point>;
    /// Why a step, an evaluation or a checkpoint fails.
    type Error: std::error::Error + Send + Sync + 'static;

    /// For every parameter whether weight decay applies to it.
    fn decayed(&self) -> &[bool];

    /// Draws the batch of step `state.step`, computes the gradient and hands it to [`State::update`]. The harness counts the step.
    ///
    /// # Errors
    /// [`super::Error::Diverged`] when the objective or its gradient is not finite, before anything has changed.
    fn step(&mut self, state: &mut State<Self::Config>) -> Result<Self::Step, Self::Error>;

    /// Figures of the averaged weights, on every split that is measured once the run is `finished`; none while there is nothing yet
    /// that could be a checkpoint.
    ///
    /// # Errors
    /// When the data cannot be measured.
    fn evaluate(&self, state: &State<Self::Config>, finished: bool) -> Result<Option<EvaluationOf<Self>>, Self::Error>;

    /// Writes the averaged weights as a checkpoint, whole or not at all, with their figures inside.
    ///
    /// # Errors
    /// When the file cannot be written.
    fn save(
        &self,
        state: &State<Self::Config>,
        evaluation: &EvaluationOf<Self>,
        path: &Path,
    ) -> Result<(), Self::Error>;
}

/// Figures of an evaluation of a training.
pub type EvaluationOf<T> = <<T as Training>::Config as Configuration>::Evaluation;

/// Sums over the steps since the last point of the curves.
pub trait Means<Step, Point>: Default {
    /// Adds a step.
    fn add(&mut self, step: &Step);

    /// The means as a point at `step` steps done.
    fn point(&self, step: u64) -> Point;
}
