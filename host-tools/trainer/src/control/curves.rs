//! Points and diagrams of a run.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::validation::Report;
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
    /// Anchor loss per motion, square metres.
    pub anchor: f64,
    /// Control error of the decoded expectation, metres.
    pub error: f64,
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
        let Self { rate, loss, accuracy, anchor, error, gradient_norm, .. } = self;
        write!(f, "rate {rate:.1e} cross-entropy {loss:.4} top-1 {accuracy:.3} anchor loss {anchor:.3} ")?;
        write!(f, "control error {error:.3} m norm {gradient_norm:.2}")
    }
}

/// Cross-entropy and control error of training batches, and control error on validation motions by family.
pub fn panels(curves: &Curves<Point, Evaluation<Report>>) -> Vec<Panel> {
    let families = curves.evaluations.last().map_or(0, |evaluation| evaluation.report.families.len());
    let validation = (0..families).map(|i| {
        let name = format!("{:?}", curves.evaluations[0].report.families[i].family).to_lowercase();
        curves.evaluation_line(&name, |evaluation| evaluation.report.families.get(i)?.error.last().copied())
    });
    vec![
        Panel {
            title: "cross-entropy of clean tokens, nats",
            lines: vec![curves.line("training", |point| point.loss)],
        },
        Panel {
            title: "control error of the decoded expectation, m",
            lines: vec![curves.line("training", |point| point.error)],
        },
        Panel { title: "control error on validation motions, 8 anchors, t = 0.5, m", lines: validation.collect() },
    ]
}
