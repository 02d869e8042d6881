//! When feet stand, and how they get from one stance to the next.

use std::ops::Range;

use super::{JOINTS, Pose, Vector};

/// When left and right foot stand, frames from and to (behind the last): the stances that an edit of this motion keeps.
#[must_use]
pub fn standing(motion: &[[[f64; 3]; JOINTS]]) -> [Vec<Range<usize>>; 2] {
    let poses: Vec<Pose> = motion.iter().map(|pose| pose.map(Vector::from)).collect();
    [10, 11].map(|toe| stances(&poses, toe).into_iter().map(|(stance, _)| stance).collect())
}

/// The stances of a foot, each held firmly.
pub(super) fn stances(motion: &[Pose], toe: usize) -> Vec<(Range<usize>, f64)> {
    let slow = |t: usize| {
        let (a, b) = (motion[t][toe], motion[t + 1][toe]);
        a.y < 0.05 && b.y < 0.05 && (b.x - a.x).hypot(b.z - a.z) < 0.04
    };
    let mut found: Vec<Range<usize>> = Vec::new();
    for t in (0..motion.len().saturating_sub(1)).filter(|t| slow(*t)) {
        match found.last_mut() {
            Some(last) if t <= last.end + 2 => last.end = t + 2,
            _ => found.push(t..t + 2),
        }
    }
    found.into_iter().filter(|stance| stance.len() >= 3).map(|stance| (stance, 1.0)).collect()
}

/// Offsets between those that are known: cubic with the slopes inside of known stretches, fading over ten frames beyond the outermost.
pub(super) fn fill(offsets: Vec<Vector>, known: &[bool]) -> Vec<Vector> {
    let is = |t: Option<usize>| t.filter(|t| known.get(*t) == Some(&true));
    let value = |t: usize| {
        if known[t] {
            return offsets[t];
        }
        let fade = |offset: Vector, frames: usize| {
            let s = (1.0 - frames as f64 / 10.0).max(0.0);
            offset * (s * s * (3.0 - 2.0 * s))
        };
        let before = (0..t).rev().find(|t| known[*t]);
        let behind = (t..known.len()).find(|t| known[*t]);
        match (before, behind) {
            (None, None) => Vector::zeros(),
            (Some(a), None) => fade(offsets[a], t - a),
            (None, Some(b)) => fade(offsets[b], b - t),
            (Some(a), Some(b)) => {
                let gap = (b - a) as f64;
                let leaving = is(a.checked_sub(1)).map_or(Vector::zeros(), |c| (offsets[a] - offsets[c]) * gap);
                let arriving = is(Some(b + 1)).map_or(Vector::zeros(), |c| (offsets[c] - offsets[b]) * gap);
                let s = (t - a) as f64 / gap;
                offsets[a] * (2.0 * s.powi(3) - 3.0 * s * s + 1.0)
                    + leaving * (s.powi(3) - 2.0 * s * s + s)
                    + offsets[b] * (3.0 * s * s - 2.0 * s.powi(3))
                    + arriving * (s.powi(3) - s * s)
            }
        }
    };
    (0..known.len()).map(value).collect()
}
