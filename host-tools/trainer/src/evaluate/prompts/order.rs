//! What comes first? "walks, then waves" is two things in an order.

use std::collections::BTreeSet;

use motionette_host::detect::actions::does;
use motionette_host::detect::{self, Seen};
use motionette_host::motion::{FPS, Pose};

/// A motion is cut at most so far from its middle, as a share of its length.
const REACH: f64 = 0.25;
/// From one cut to the next, frames.
const STRIDE: usize = 4;

/// In which order a motion shows two actions, by the detectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// Some cut has the first before it and the second behind it.
    pub asked: bool,
    /// Some cut has them the other way round: how often chance, or a motion that does both at once, looks right.
    pub other: bool,
}

/// The order of the actions `first` and `second`, any of each, in a motion of joints in metres.
pub fn of(joints: &[Pose], first: &BTreeSet<&str>, second: &BTreeSet<&str>) -> Order {
    let middle = 0.5 * joints.len() as f64;
    let ends = [middle * (1.0 - 2.0 * REACH), middle * (1.0 + 2.0 * REACH)].map(|end| end.round() as usize);
    let shows = |seen: &[Seen], actions: &BTreeSet<&str>| actions.iter().any(|action| does(seen, action) == Some(true));
    let mut order = Order { asked: false, other: false };
    for cut in (ends[0]..=ends[1].min(joints.len())).step_by(STRIDE) {
        let (before, behind) = joints.split_at(cut);
        let (before, behind) = (detect::detect(before, FPS), detect::detect(behind, FPS));
        order.asked |= shows(&before, first) && shows(&behind, second);
        order.other |= shows(&before, second) && shows(&behind, first);
    }
    order
}
