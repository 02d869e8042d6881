//! The side of a clip: from its label, or measured from its joints.

use serde_json::Value;

use crate::dataset::Side;
use crate::import::actions::SideRule;
use crate::metrics::distance;
use crate::motion::{Pose, skeleton};

const PELVIS: usize = 0;
const ANKLES: [usize; 2] = [7, 8];
const WRISTS: [usize; 2] = [20, 21];

/// The side that `rule` finds.
pub(super) fn of(rule: SideRule, label: &str, labels: &Value, motion: &[Pose]) -> Side {
    let named = |key: &str| labels.get(key).and_then(Value::as_str);
    let stated = |key: &str| match named(key) {
        Some("left") => Some(Side::Left),
        Some("right") => Some(Side::Right),
        _ => None,
    };
    match rule {
        SideRule::Left => Side::Left,
        SideRule::Right => Side::Right,
        SideRule::Both => Side::Both,
        SideRule::None => Side::None,
        SideRule::Name => {
            let side = in_name(label);
            if side == Side::None { named("name").map_or(Side::None, in_name) } else { side }
        }
        SideRule::Hand => stated("hand").unwrap_or_else(|| measured(rule, motion)),
        SideRule::Leg => stated("leg").unwrap_or_else(|| measured(rule, motion)),
        SideRule::Turn => measured(rule, motion),
    }
}

/// The side that joints alone show: hand and leg = the wrist, ankle with the longer path relative to the pelvis; turn = the way the
/// heading (of hips and shoulders) turns in all, left when it does not. `None` for rules that measure nothing.
pub fn measured(rule: SideRule, motion: &[Pose]) -> Side {
    let left = match rule {
        SideRule::Hand => longer_left(motion, WRISTS),
        SideRule::Leg => longer_left(motion, ANKLES),
        SideRule::Turn => turn(motion) >= 0.0,
        SideRule::Left | SideRule::Right | SideRule::Both | SideRule::None | SideRule::Name => return Side::None,
    };
    if left { Side::Left } else { Side::Right }
}

/// Left or Right in a name, when not both.
fn in_name(name: &str) -> Side {
    let name = name.to_lowercase();
    match (name.contains("left"), name.contains("right")) {
        (true, false) => Side::Left,
        (false, true) => Side::Right,
        _ => Side::None,
    }
}

fn longer_left(motion: &[Pose], [left, right]: [usize; 2]) -> bool {
    let place = |pose: &Pose, joint: usize| -> [f32; 3] { std::array::from_fn(|c| pose[joint][c] - pose[PELVIS][c]) };
    let path = |joint: usize| -> f64 {
        motion.windows(2).map(|pair| distance(place(&pair[0], joint), place(&pair[1], joint))).sum()
    };
    path(left) >= path(right)
}

/// Turn of the heading over the motion, radians, positive to the left.
fn turn(motion: &[Pose]) -> f64 {
    let heading = |pose: &Pose| {
        let across = |c: usize| {
            f64::from(pose[skeleton::LEFT_HIP][c] - pose[skeleton::RIGHT_HIP][c])
                + f64::from(pose[skeleton::LEFT_SHOULDER][c] - pose[skeleton::RIGHT_SHOULDER][c])
        };
        // Left is +x when the body faces +z, so the body faces (-z, x) of what points to its left.
        (-across(2)).atan2(across(0))
    };
    let step = |pair: &[Pose]| {
        let change = heading(&pair[1]) - heading(&pair[0]);
        change.sin().atan2(change.cos())
    };
    motion.windows(2).map(step).sum()
}
