//! What is stored of a run: points and figures.
//!
//! Labels, vocabulary and normalisation follow from the dataset.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::config::Config;
use super::objective::Terms;
use crate::evaluate::real;
use crate::harness::{self, Figures};

/// A run between two steps.
pub type State = harness::State<Config>;

/// Means over the steps since the point before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Steps done.
    pub step: u64,
    /// Learning rate of the last of them.
    pub rate: f32,
    /// Terms of the objective.
    pub terms: Terms,
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
        let Self { rate, terms: Terms { contrastive, content, style, total }, gradient_norm, .. } = self;
        write!(f, "rate {rate:.1e} loss {total:.4} contrastive {contrastive:.4} content {content:.4} ")?;
        write!(f, "style {style:.4} norm {gradient_norm:.2}")
    }
}

/// Figures of real motion by split, of the splits that have labels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Metrics(pub BTreeMap<String, real::Report>);

impl fmt::Display for Metrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.0.iter().map(|(split, report)| format!("{split}: {report}")).collect();
        f.write_str(if lines.is_empty() { "no clip has labels to measure" } else { "" })?;
        f.write_str(&lines.join("\n"))
    }
}
