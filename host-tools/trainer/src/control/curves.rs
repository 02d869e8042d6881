//! The course of a run as JSON and as a picture.

use std::path::Path;

use motionette_host::output::write_atomic;
use serde::{Deserialize, Serialize};

use super::Error;
use super::validation::Report;
use crate::{chart, tensor_file};

/// Means over the steps since the point before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Steps done.
    pub step: u64,
    /// Learning rate of the last of them.
    pub rate: f32,
    /// Cross-entropy of the tokens, nats.
    pub loss: f64,
    /// Share of tokens whose most likely code is the clean one.
    pub accuracy: f64,
    /// Anchor loss a motion, square metres.
    pub anchor: f64,
    /// Control error of the decoded expectation, metres.
    pub error: f64,
    /// Global norm of the gradient.
    pub gradient_norm: f32,
}

/// All points of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curves {
    /// Of the training batches.
    pub points: Vec<Point>,
    /// Of the averaged weights on the validation split, with the steps done.
    pub evaluations: Vec<(u64, Report)>,
}

impl Curves {
    /// Writes `<stem>.curves.json` and `<stem>.curves.svg` beside `checkpoint`.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn save(&self, checkpoint: &Path) -> Result<(), Error> {
        let json = serde_json::to_vec(self).unwrap_or_default();
        let svg = self.svg();
        for (extension, bytes) in [("curves.json", json), ("curves.svg", svg.into_bytes())] {
            write_atomic(checkpoint.with_extension(extension), |w| w.write_all(&bytes))
                .map_err(tensor_file::Error::from)?;
        }
        Ok(())
    }

    /// Cross-entropy and control error over steps.
    pub fn svg(&self) -> String {
        let last = self.points.last().map_or(1, |p| p.step).max(self.evaluations.last().map_or(1, |e| e.0));
        let training = vec![("training".to_owned(), self.points.iter().map(|p| (p.step, p.loss)).collect())];
        let error = vec![("training".to_owned(), self.points.iter().map(|p| (p.step, p.error)).collect())];
        let families = self.evaluations.last().map_or(0, |(_, report)| report.families.len());
        let validation = (0..families)
            .map(|i| {
                let name = format!("{:?}", self.evaluations[0].1.families[i].family).to_lowercase();
                let value = |report: &Report| report.families.get(i)?.error.last().copied();
                (name, self.evaluations.iter().filter_map(|(step, report)| Some((*step, value(report)?))).collect())
            })
            .collect();
        let panels = [
            ("cross-entropy of clean tokens, nats", training),
            ("control error of the decoded expectation, m", error),
            ("control error on validation motions, 8 anchors, t = 0.5, m", validation),
        ];
        chart::document(last.max(1), &panels)
    }
}
