//! The course of a run as JSON and as a picture.

use std::fmt;
use std::path::Path;

use motionette_host::output::write_atomic;
use serde::{Deserialize, Serialize};

use super::{Configuration, Error, Figures};
use crate::chart::{self, Panel};
use crate::tensor_file;

/// All points of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curves<P, E> {
    /// Of the training batches.
    pub points: Vec<P>,
    /// Of the averaged weights on clips that were not trained on.
    pub evaluations: Vec<E>,
}

impl<P, E> Default for Curves<P, E> {
    fn default() -> Self {
        Self { points: Vec::new(), evaluations: Vec::new() }
    }
}

impl<P: Figures, E: Figures> Curves<P, E> {
    /// Adds an evaluation in place of those that are not older: a resumed run measures a step anew.
    pub fn evaluated(&mut self, evaluation: E) {
        self.evaluations.retain(|earlier| earlier.step() < evaluation.step());
        self.evaluations.push(evaluation);
    }

    /// A line of a diagram: `value` of every point.
    pub fn line(&self, name: &str, value: impl Fn(&P) -> f64) -> chart::Line {
        chart::Line { name: name.to_owned(), points: self.points.iter().map(|p| (p.step(), value(p))).collect() }
    }

    /// A line of a diagram: `value` of every evaluation that has it.
    pub fn evaluation_line(&self, name: &str, value: impl Fn(&E) -> Option<f64>) -> chart::Line {
        let points = self.evaluations.iter().filter_map(|e| Some((e.step(), value(e)?))).collect();
        chart::Line { name: name.to_owned(), points }
    }

    /// The diagrams over all steps.
    pub fn svg(&self, panels: &[Panel]) -> String {
        let (point, evaluation) = (self.points.last().map(P::step), self.evaluations.last().map(E::step));
        chart::document(point.max(evaluation).unwrap_or(1).max(1), panels)
    }

    /// Writes `<stem>.curves.json` and `<stem>.curves.svg` beside `checkpoint`, for a configuration that has diagrams.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn save<C: Configuration<Point = P, Evaluation = E>>(&self, checkpoint: &Path) -> Result<(), Error> {
        let panels = C::panels(self);
        if panels.is_empty() {
            return Ok(());
        }
        let json = serde_json::to_vec(self).unwrap_or_default();
        for (extension, bytes) in [("curves.json", json), ("curves.svg", self.svg(&panels).into_bytes())] {
            write_atomic(checkpoint.with_extension(extension), |w| w.write_all(&bytes))
                .map_err(tensor_file::Error::from)?;
        }
        Ok(())
    }
}

/// An evaluation of one report; stored as a pair of step and report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "(u64, R)", from = "(u64, R)", bound = "R: Clone + Serialize + serde::de::DeserializeOwned")]
pub struct Evaluation<R> {
    /// Steps done.
    pub step: u64,
    /// Figures of the averaged weights.
    pub report: R,
}

impl<R> From<(u64, R)> for Evaluation<R> {
    fn from((step, report): (u64, R)) -> Self {
        Self { step, report }
    }
}

impl<R> From<Evaluation<R>> for (u64, R) {
    fn from(evaluation: Evaluation<R>) -> Self {
        (evaluation.step, evaluation.report)
    }
}

impl<R: fmt::Display> fmt::Display for Evaluation<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.report.fmt(f)
    }
}

impl<R> Figures for Evaluation<R>
where
    R: Clone + fmt::Debug + PartialEq + Serialize + serde::de::DeserializeOwned + fmt::Display,
{
    fn step(&self) -> u64 {
        self.step
    }
}
