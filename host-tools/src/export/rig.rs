//! Rotations for joint positions, as animation formats want them: those that [`super`] describes.

use std::io;

use super::best_fit::best_fit;
use crate::motion::quaternion::{self as q, Quaternion, Vector};
use crate::motion::{JOINTS, Pose, skeleton};

/// Unit direction of the bone that ends at each joint in the T-pose, and where a fit of several children starts.
pub(super) const T_POSE: [Vector; JOINTS] = [
    [0.0, 0.0, 0.0],
    [0.6, -0.8, 0.0],
    [-0.6, -0.8, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, 1.0],
    [0.0, 1.0, 0.0],
    [0.6, 0.8, 0.0],
    [-0.6, 0.8, 0.0],
    [0.0, 1.0, 0.0],
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
];

/// Rounds that refine the rest offsets of joints with several children.
const REST_ROUNDS: usize = 3;

/// A body at rest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rig {
    /// Where each joint is from its parent, metres; zero for the pelvis.
    pub rest: [Vector; JOINTS],
}

impl Rig {
    /// The body of a motion.
    pub fn of(joints: &[Pose]) -> Self {
        Rig { rest: rest_offsets(joints) }
    }

    /// Place of every joint in its parent's rotated frame, metres, and its rotation there. Applied in turn they give the positions back
    /// exactly.
    pub fn locals(&self, pose: &Pose) -> [(Vector, Quaternion); JOINTS] {
        let pose = metres(pose);
        let global = orientations(&pose, &self.rest);
        std::array::from_fn(|j| {
            if j == 0 {
                return (pose[0], global[0]);
            }
            let parent = skeleton::PARENTS[j];
            let back = q::inverse(global[parent]);
            (q::rotate(back, q::subtract(pose[j], pose[parent])), q::multiply(back, global[j]))
        })
    }
}

/// Refuses what cannot be exported, [`io::ErrorKind::InvalidInput`].
pub(super) fn check(joints: &[Pose], frame_time: f64) -> io::Result<()> {
    let refuse = |what: String| Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    if joints.is_empty() {
        return refuse("nothing to export: the motion has no frames".into());
    }
    if !(frame_time.is_finite() && frame_time > 0.0) {
        return refuse(format!("a frame time of {frame_time} s cannot be exported; it must be positive"));
    }
    for (frame, pose) in joints.iter().enumerate() {
        if let Some(j) = pose.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return refuse(format!("frame {frame}: the position of {} is not finite", skeleton::NAMES[j]));
        }
    }
    Ok(())
}

pub(super) fn children(joint: usize) -> impl Iterator<Item = usize> {
    (joint + 1..JOINTS).filter(move |&j| skeleton::PARENTS[j] == joint)
}

fn metres(pose: &Pose) -> [Vector; JOINTS] {
    pose.map(|p| p.map(f64::from))
}

/// Offsets of the rest pose, metres: bones of mean length along [`T_POSE`], and for joints with several children the mean place
/// of each child in the joint's best-fitting frame, so that a rigid body keeps its offsets exactly.
fn rest_offsets(joints: &[Pose]) -> [Vector; JOINTS] {
    let frames = joints.len() as f64;
    let mut lengths = [0.0; JOINTS];
    for pose in joints.iter().map(metres) {
        for j in 1..JOINTS {
            lengths[j] += q::length(q::subtract(pose[j], pose[skeleton::PARENTS[j]])) / frames;
        }
    }
    let mut rest: [Vector; JOINTS] = std::array::from_fn(|j| q::scale(T_POSE[j], lengths[j]));
    for parent in (0..JOINTS).filter(|&j| children(j).count() > 1) {
        for _ in 0..REST_ROUNDS {
            let mut sums = [[0.0; 3]; JOINTS];
            for pose in joints.iter().map(metres) {
                let back = q::inverse(fit(parent, &pose, &rest));
                for j in children(parent) {
                    let place = q::rotate(back, q::subtract(pose[j], pose[parent]));
                    sums[j] = q::add(sums[j], q::scale(place, 1.0 / frames));
                }
            }
            children(parent).for_each(|j| rest[j] = sums[j]);
        }
    }
    rest
}

/// Rotation of a joint that takes the rest offsets of its children closest to where they are.
fn fit(parent: usize, pose: &[Vector; JOINTS], rest: &[Vector; JOINTS]) -> Quaternion {
    best_fit(children(parent).map(|j| (rest[j], q::subtract(pose[j], pose[parent]))))
}

/// Global rotation of every joint in one frame.
fn orientations(pose: &[Vector; JOINTS], rest: &[Vector; JOINTS]) -> [Quaternion; JOINTS] {
    let mut global = [q::IDENTITY; JOINTS];
    for j in 0..JOINTS {
        let parent = global[skeleton::PARENTS[j]];
        let mut below = children(j);
        global[j] = match (below.next(), below.next()) {
            (None, _) => parent,
            (Some(child), None) => {
                let bone = q::direction(q::rotate(q::inverse(parent), q::subtract(pose[child], pose[j])));
                let turn = match (q::direction(rest[child]), bone) {
                    (Some(rest), Some(bone)) => q::between(rest, bone),
                    _ => q::IDENTITY,
                };
                q::normalise(q::multiply(parent, turn))
            }
            (Some(_), Some(_)) => fit(j, pose, rest),
        };
    }
    global
}
