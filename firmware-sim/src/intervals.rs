//! The intervals between anchors on the token grid, and how active they are at finished motions: asked of the runtime's solver.

use motionette::Anchor;
use motionette::refining::activity::{Random, activities};
use motionette::refining::basis::{self, IntervalBasis};
use motionette::refining::terms::anchors::Distances;
use motionette::refining::{Activity, Basis, PerFamily, TokenGrid};
use motionette::request::conditions::{AnchorError, AnchorSet};
use motionette_host::motion::Pose;
use serde::Serialize;

/// A stretch of the motion between two cuts: anchors or the motion's ends (EQUATIONS section 5).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Interval {
    /// Frame of its left end.
    pub left: u16,
    /// Frame of its right end.
    pub right: u16,
    /// First token that it owns.
    pub token: u16,
    /// Tokens that it owns.
    pub tokens: u16,
    /// Activity at each motion, `clip(larger endpoint error / rho, 0, 1)`.
    pub activity: Vec<f32>,
}

/// Intervals of a motion of `tokens` tokens that own tokens, in order of time, with their activities at each of `motions`, which are of
/// that length. `tolerance` is rho, metres.
///
/// # Errors
/// [`AnchorError`], as the runtime refuses such anchors.
pub fn of(
    anchors: &[Anchor],
    tokens: usize,
    motions: &[&[Pose]],
    tolerance: &PerFamily,
) -> Result<Vec<Interval>, AnchorError> {
    let frames = motions.first().map_or(0, |motion| motion.len());
    let set = AnchorSet::new(anchors, frames)?;
    if set.is_empty() {
        return Ok(Vec::new());
    }
    // Every basis has the same intervals; this one needs no memory.
    let grid = TokenGrid { tokens, frames_per_token: frames / tokens.max(1) };
    let cut = IntervalBasis::new(&set, grid, Basis::Plain, &mut []);
    let mut token = 0;
    let place = |interval: &basis::Interval| {
        let basis::Interval { left, right, tokens, .. } = *interval;
        token += tokens;
        Interval { left, right, token: token - tokens, tokens, activity: Vec::new() }
    };
    let mut intervals: Vec<Interval> = cut.intervals().iter().map(place).collect();
    for motion in motions {
        let distances = Distances::of(&set, &|joint, frame| motion[frame][usize::from(joint)]);
        let mut random = Random::new(0);
        let found = activities(Activity::Residual, &cut, &set, &distances, tolerance, &mut random);
        intervals.iter_mut().zip(found).for_each(|(interval, activity)| interval.activity.push(activity));
    }
    Ok(intervals)
}

#[cfg(test)]
mod tests {
    use super::*;
    use motionette_host::reference::bridge::reference_anchor;
    use motionette_host::reference::interval_basis as reference;

    #[test]
    fn intervals_are_those_of_the_reference_and_activity_is_the_larger_endpoint_error() {
        let (tokens, frames) = (13, 52);
        let still: Vec<Pose> = vec![[[0.0, 1.0, 0.0]; 22]; frames];
        let mut moved = still.clone();
        moved[40] = [[0.0, 1.0, 0.02]; 22];
        let anchors = [
            Anchor::root(40, [0.0, 1.0, 0.0]),
            Anchor::joint(10, 20, [0.0, 1.03, 0.0]),
            Anchor::planar_root(10, [0.0, 0.01]),
            Anchor::planar_root(11, [9.0, 0.0]),
        ];
        let found = of(&anchors, tokens, &[&still, &moved], &PerFamily::all(0.05)).expect("good anchors");
        let given: Vec<_> = anchors.iter().map(reference_anchor).collect();
        let expected = reference::IntervalBasis::new(&given, tokens, 4, reference::Basis::Affine);
        let owned = |i: &Interval| (usize::from(i.token)..usize::from(i.token + i.tokens)).collect::<Vec<_>>();
        assert_eq!(found.len(), expected.intervals.len());
        for (a, b) in found.iter().zip(&expected.intervals) {
            assert_eq!((usize::from(a.left), usize::from(a.right), owned(a)), (b.left, b.right, b.tokens.clone()));
        }
        // No token lies between frames 10 and 11. Ends without an anchor are met.
        let activity: Vec<Vec<f32>> = found.into_iter().map(|i| i.activity).collect();
        let near = |a: f32, b: f32| (a - b).abs() < 1e-5;
        assert!(near(activity[0][0], 0.6) && near(activity[0][1], 0.6), "{activity:?}");
        assert!(near(activity[1][0], 1.0) && near(activity[1][1], 1.0), "{activity:?}");
        assert!(near(activity[2][0], 0.0) && near(activity[2][1], 0.4), "{activity:?}");
        assert!(of(&[], tokens, &[&still], &PerFamily::all(0.05)).expect("no anchors").is_empty());
        assert!(of(&[Anchor::root(52, [0.0; 3])], tokens, &[&still], &PerFamily::all(0.05)).is_err());
    }
}
