//! The course of a run as JSON and as a picture.

use std::path::Path;

use motionette_host::output::write_atomic;
use serde::{Deserialize, Serialize};

use super::Error;
use super::loss::Terms;
use super::metrics::Report;
use crate::{chart, tensor_file};

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

/// All points of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curves {
    /// Of the training batches.
    pub points: Vec<Point>,
    /// Of whole clips.
    pub evaluations: Vec<Evaluation>,
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

    /// Two panels over steps: the objective's weighted sum, and root-aligned error of every evaluated subset.
    pub fn svg(&self) -> String {
        let steps = self.points.last().map_or(1, |p| p.step).max(self.evaluations.last().map_or(1, |e| e.step)).max(1);
        let loss: Vec<(u64, f64)> = self.points.iter().map(|p| (p.step, f64::from(p.terms.total))).collect();
        let mut names: Vec<String> = Vec::new();
        for report in self.evaluations.iter().flat_map(|e| &e.reports) {
            let name = format!("{} {}", report.split, report.subset);
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let of = |name: &String| -> Vec<(u64, f64)> {
            let reports = self.evaluations.iter().flat_map(|e| e.reports.iter().map(move |r| (e.step, r)));
            reports
                .filter(|(_, r)| format!("{} {}", r.split, r.subset) == *name)
                .map(|(s, r)| (s, r.mpjpe_root_mm))
                .collect()
        };
        let errors: Vec<chart::Line> = names.iter().map(|name| (name.clone(), of(name))).collect();
        let panels = [("objective", vec![("training".to_owned(), loss)]), ("root-aligned MPJPE, mm", errors)];
        chart::document(steps, &panels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_a_line_for_every_subset() {
        let report = |split, subset: &str, error| Report {
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
        let svg = curves.svg();
        assert_eq!(svg.matches("<polyline").count(), 3);
        assert!(svg.contains("test b") && svg.ends_with("</svg>\n") && !svg.contains("NaN") && !svg.contains("inf"));
        assert_eq!(serde_json::from_slice::<Curves>(&serde_json::to_vec(&curves).unwrap()).unwrap(), curves);
    }
}
