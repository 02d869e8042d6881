//! The course of a run as JSON and as a picture.

use std::path::Path;

use motionette_host::output::write_atomic;
use serde::{Deserialize, Serialize};

use super::Error;
use super::validation::{Report, TIMES};
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
    /// Cross-entropy of the length, nats.
    pub length: f64,
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
        write_atomic(checkpoint.with_extension("curves.json"), |w| w.write_all(&json))
            .map_err(tensor_file::Error::from)?;
        let svg = self.svg();
        write_atomic(checkpoint.with_extension("curves.svg"), |w| w.write_all(svg.as_bytes()))
            .map_err(tensor_file::Error::from)?;
        Ok(())
    }

    /// Cross-entropy of training batches and of validation motions at every time, over steps.
    pub fn svg(&self) -> String {
        let last = self.points.last().map_or(1, |p| p.step).max(self.evaluations.last().map_or(1, |e| e.0));
        let training = vec![("training".to_owned(), self.points.iter().map(|p| (p.step, p.loss)).collect())];
        let of = |index: usize| -> Vec<(u64, f64)> {
            self.evaluations.iter().filter_map(|(step, r)| Some((*step, *r.loss.get(index)?))).collect()
        };
        let validation = TIMES.iter().enumerate().map(|(i, t)| (format!("val, t = {t}"), of(i))).collect();
        let panels =
            [("cross-entropy of clean tokens, nats", training), ("the same on validation motions", validation)];
        chart::document(last.max(1), &panels)
    }
}
