//! How far two motions are apart, in the figures of DESIGN section 6.

use serde::Serialize;

use crate::metrics;
use crate::motion::Pose;

/// Frames of 5 s at 20 frames a second.
pub const DRIFT_FRAMES: usize = 100;
const MILLIMETRES: f64 = 1000.0;

/// One clip's figures, millimetres.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClipAgreement {
    /// Its name.
    pub id: String,
    /// Frames compared.
    pub frames: usize,
    /// Mean distance of the joints once both pelvises are laid over one another.
    pub mean_mm: f64,
    /// 99th percentile of those distances.
    pub p99_mm: f64,
    /// Largest of them.
    pub max_mm: f64,
    /// Distance of the pelvises in the last of the first 100 frames; `None` for shorter clips.
    pub drift_mm: Option<f64>,
    /// Distance of the pelvises in the last frame.
    pub end_drift_mm: f64,
}

/// Figures over many clips, millimetres.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Agreement {
    /// Mean root-aligned joint distance over all frames of all clips.
    pub mean_mm: f64,
    /// 99th percentile of it.
    pub p99_mm: f64,
    /// Largest.
    pub max_mm: f64,
    /// Mean root drift at the end of 5 s.
    pub drift_mean_mm: f64,
    /// 95th percentile of it.
    pub drift_p95_mm: f64,
    /// Largest.
    pub drift_max_mm: f64,
    /// Clips that last 5 s.
    pub drift_clips: usize,
    /// Figures of each clip, in the order they came.
    pub clips: Vec<ClipAgreement>,
    #[serde(skip)]
    errors: Vec<f64>,
}

impl Agreement {
    /// Compares two motions frame by frame and adds the clip. The longer one is cut.
    pub fn add(&mut self, id: &str, a: &[Pose], b: &[Pose]) {
        let start = self.errors.len();
        let frames = a.len().min(b.len());
        for (a, b) in a.iter().zip(b) {
            self.errors.extend(metrics::root_aligned_distances(a, b).map(|d| MILLIMETRES * d));
        }
        let drift = |frames: usize| MILLIMETRES * metrics::root_drift_end(&a[..frames], &b[..frames]);
        let mut sorted = self.errors[start..].to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        self.clips.push(ClipAgreement {
            id: id.to_owned(),
            frames,
            mean_mm: mean(&sorted),
            p99_mm: percentile(&sorted, 0.99),
            max_mm: sorted.last().copied().unwrap_or_default(),
            drift_mm: (frames >= DRIFT_FRAMES).then(|| drift(DRIFT_FRAMES)),
            end_drift_mm: drift(frames),
        });
    }

    /// Computes the figures over all clips added so far.
    pub fn finish(&mut self) {
        self.errors.sort_unstable_by(f64::total_cmp);
        self.mean_mm = mean(&self.errors);
        self.p99_mm = percentile(&self.errors, 0.99);
        self.max_mm = self.errors.last().copied().unwrap_or_default();
        let mut drifts: Vec<f64> = self.clips.iter().filter_map(|c| c.drift_mm).collect();
        drifts.sort_unstable_by(f64::total_cmp);
        self.drift_mean_mm = mean(&drifts);
        self.drift_p95_mm = percentile(&drifts, 0.95);
        self.drift_max_mm = drifts.last().copied().unwrap_or_default();
        self.drift_clips = drifts.len();
    }

    /// The `count` clips with the largest mean distance, worst first.
    #[must_use]
    pub fn worst(&self, count: usize) -> Vec<&ClipAgreement> {
        let mut order: Vec<&ClipAgreement> = self.clips.iter().collect();
        order.sort_by(|a, b| b.mean_mm.total_cmp(&a.mean_mm));
        order.truncate(count);
        order
    }

    /// The `count` clips with the largest drift at the end of 5 s, worst first.
    #[must_use]
    pub fn worst_drift(&self, count: usize) -> Vec<&ClipAgreement> {
        let mut order: Vec<&ClipAgreement> = self.clips.iter().filter(|c| c.drift_mm.is_some()).collect();
        order.sort_by(|a, b| b.drift_mm.unwrap_or_default().total_cmp(&a.drift_mm.unwrap_or_default()));
        order.truncate(count);
        order
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Nearest-rank percentile of sorted values; 0 of none.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shift_is_drift_and_a_bent_arm_is_error() {
        let rest: Vec<Pose> = vec![core::array::from_fn(|j| [j as f32 * 0.1, 1.0, 0.0]); 120];
        let mut moved = rest.clone();
        for pose in &mut moved {
            pose.iter_mut().for_each(|p| p[2] += 0.003);
            pose[20][1] += 0.021;
        }
        let mut agreement = Agreement::default();
        agreement.add("shifted", &rest, &moved);
        agreement.add("short", &rest[..50], &rest[..50]);
        agreement.finish();
        let first = &agreement.clips[0];
        assert!((first.mean_mm - 1.0).abs() < 1e-3 && (first.max_mm - 21.0).abs() < 1e-3);
        assert!((first.drift_mm.expect("long enough") - 3.0).abs() < 1e-3);
        assert_eq!(agreement.clips[1].drift_mm, None);
        assert_eq!((agreement.drift_clips, agreement.worst(1)[0].id.as_str()), (1, "shifted"));
        assert!((agreement.mean_mm - 120.0 / 170.0).abs() < 1e-3);
        assert!((agreement.p99_mm - 21.0).abs() < 1e-3, "one joint of 21 is off in most frames");
    }

    #[test]
    fn percentiles_are_nearest_rank() {
        let values: Vec<f64> = (1..=100).map(f64::from).collect();
        assert_eq!(
            (percentile(&values, 0.99), percentile(&values, 0.95), percentile(&values[..1], 0.5)),
            (99.0, 95.0, 1.0)
        );
        assert_eq!(percentile(&[], 0.5), 0.0);
    }
}
