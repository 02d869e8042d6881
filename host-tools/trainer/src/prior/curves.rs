//! Points and diagrams of a run.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::validation::{Report, TIMES};
use crate::chart::Panel;
use crate::harness::{Curves, Evaluation, Figures};

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
    /// Cross-entropy of what sentences mean, nats, over all that they may mean.
    #[serde(default)]
    pub meaning: f64,
    /// Share of sentences whose likeliest meaning is right.
    #[serde(default)]
    pub understood: f64,
    /// Global norm of the gradient of the last step.
    pub gradient_norm: f32,
}

impl Figures for Point {
    fn step(&self) -> u64 {
        self.step
    }
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rate, loss, accuracy, length, meaning, understood, gradient_norm, .. } = self;
        write!(f, "rate {rate:.1e} cross-entropy {loss:.4} top-1 {accuracy:.3} length {length:.3} ")?;
        write!(f, "meaning {meaning:.2} understood {understood:.3} norm {gradient_norm:.2}")
    }
}

/// Cross-entropy of training batches, and of validation motions at every time.
pub fn panels(curves: &Curves<Point, Evaluation<Report>>) -> Vec<Panel> {
    let validation = TIMES.iter().enumerate().map(|(i, t)| {
        curves.evaluation_line(&format!("val, t = {t}"), |evaluation| evaluation.report.loss.get(i).copied())
    });
    vec![
        Panel {
            title: "cross-entropy of clean tokens, nats",
            lines: vec![curves.line("training", |point| point.loss)],
        },
        Panel { title: "the same on validation motions", lines: validation.collect() },
    ]
}
