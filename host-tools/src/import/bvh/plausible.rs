//! Whether a recording can be that of a body: what cannot is refused before anything is made of it.

use super::Problem;
use crate::motion::quaternion::{self as q, Vector};
use crate::motion::{FPS, JOINTS, Pose, skeleton};

/// Bones shorter than this share of the body have no length.
const NO_LENGTH: f64 = 1e-5;
/// Bones without length that still make a body: toes, wrists and parts of the spine are missing in some.
const MOST_MISSING: usize = 10;
/// Distance of a joint between two frames at most, metres: 200 m/s.
const LONGEST_STEP: f64 = 10.0;
/// Distance from the origin at most, metres: beyond it f32 has not the last millimetre.
const FARTHEST: f64 = 1e4;

/// A body in one frame has bones. `height` is its own, in the same unit.
pub(super) fn has_size(body: &[Vector; JOINTS], height: f64) -> Result<(), Problem> {
    let bones = missing(body, height);
    if bones > MOST_MISSING { Err(Problem::Collapsed { frame: 0, bones }) } else { Ok(()) }
}

fn missing(body: &[Vector; JOINTS], height: f64) -> usize {
    let length = |j: usize| q::length(q::subtract(body[j], body[skeleton::PARENTS[j]]));
    (1..JOINTS).filter(|&j| !(length(j) > NO_LENGTH * height)).count()
}

/// A whole motion, metres.
pub(super) fn check(motion: &[Pose]) -> Result<(), Problem> {
    let mut before: Option<[Vector; JOINTS]> = None;
    for (frame, pose) in motion.iter().enumerate() {
        let body = pose.map(|p| p.map(f64::from));
        for (joint, place) in body.iter().enumerate() {
            let joint = skeleton::NAMES[joint];
            let metres = q::length(*place);
            if !(metres <= FARTHEST) {
                return Err(Problem::TooFar { frame, joint, metres, limit: FARTHEST });
            }
        }
        if let Some(before) = &before {
            for (joint, (place, before)) in body.iter().zip(before).enumerate() {
                let (joint, metres) = (skeleton::NAMES[joint], q::length(q::subtract(*place, *before)));
                if metres > LONGEST_STEP {
                    return Err(Problem::Jump { frame, seconds: frame as f64 / FPS, joint, metres });
                }
            }
        }
        // A metre: whatever the unit was, the body is of a person's size by now.
        let bones = missing(&body, 1.0);
        if bones > MOST_MISSING {
            return Err(Problem::Collapsed { frame, bones });
        }
        before = Some(body);
    }
    Ok(())
}
