//! Points and diagrams of a run.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::loss::Terms;
use super::metrics::{self, Report};
use crate::chart::Panel;
use crate::harness::{Curves, Figures};

/// Means over the steps since the point before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Steps done.
    pub step: u64,
    /// Learning rate of the last of them.
    pub rate: f32,
    /// Terms of the objective.
    pub terms: Terms,
    /// Mean squared distance of latents to their codes.
    pub commitment: f32,
    /// Perplexity of the code frequencies.
    pub perplexity: f64,
    /// Dead codes that were moved.
    pub moved: usize,
    /// Global norm of the gradient.
    pub gradient_norm: f32,
}

/// Figures of the averaged weights at one step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Steps done.
    pub step: u64,
    /// Reports of every split and subset measured.
    pub reports: Vec<Report>,
}

impl Figures for Point {
    fn step(&self) -> u64 {
        self.step
    }
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rate, terms, commitment, perplexity, moved, gradient_norm, .. } = self;
        let Terms { features, position, bones, root, heading, total, .. } = terms;
        let (position, bones, root) = (1e3 * position, 1e3 * bones, 1e3 * root);
        write!(
            f,
            "rate {rate:.1e} loss {total:.4} features {features:.4} position {position:.1} mm bones {bones:.1} mm root {root:.0} mm "
        )?;
        write!(f, "heading {heading:.3} commitment {commitment:.4} perplexity {perplexity:.0} moved {moved} ")?;
        write!(f, "norm {gradient_norm:.2}")
    }
}

impl Figures for Evaluation {
    fn step(&self) -> u64 {
        self.step
    }
}

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(metrics::table(&self.reports).trim_end())
    }
}

/// The objective's weighted sum, and the root-aligned error of every evaluated subset.
pub fn panels(curves: &Curves<Point, Evaluation>) -> Vec<Panel> {
    let name = |report: &Report| format!("{} {}", report.split, report.subset);
    let mut names: Vec<String> = Vec::new();
    for report in curves.evaluations.iter().flat_map(|evaluation| &evaluation.reports) {
        if !names.contains(&name(report)) {
            names.push(name(report));
        }
    }
    let error = |subset: &String| {
        curves.evaluation_line(subset, |evaluation| {
            evaluation.reports.iter().find(|report| name(report) == *subset).map(|report| report.mpjpe_root_mm)
        })
    };
    vec![
        Panel { title: "objective", lines: vec![curves.line("training", |point| f64::from(point.terms.total))] },
        Panel { title: "root-aligned MPJPE, mm", lines: names.iter().map(error).collect() },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_a_line_for_every_subset() {
        let report = |split, subset: &str, error| Report {
            known_actor: None,
            bones_p99_mm: None,
            jerk: None,
            skating: None,
            split,
            subset: subset.into(),
            clips: 1,
            frames: 4,
            mpjpe_root_mm: error,
            mpjpe_local_mm: 1.0,
            mpjpe_global_mm: 1.0,
            drift_end_mm: 1.0,
            drift_5s_mm: None,
            heading_end_deg: 1.0,
            codes_used: 1,
            codes_used_share: 1.0,
            perplexity: 1.0,
        };
        use motionette_host::dataset::Split::{Test, Val};
        let evaluation = |step, error| Evaluation {
            step,
            reports: vec![report(Val, "a", error), report(Test, "a", error), report(Test, "b", error)],
        };
        let curves = Curves { points: Vec::new(), evaluations: vec![evaluation(10, 80.0), evaluation(20, 40.0)] };
        let svg = curves.svg(&panels(&curves));
        assert_eq!(svg.matches("<polyline").count(), 3);
        assert!(svg.contains("test b") && svg.ends_with("</svg>\n") && !svg.contains("NaN") && !svg.contains("inf"));
        assert_eq!(
            serde_json::from_slice::<Curves<Point, Evaluation>>(&serde_json::to_vec(&curves).unwrap()).unwrap(),
            curves
        );
    }
}
