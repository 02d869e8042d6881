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

    /// The body in one pose of a motion.
    pub fn pose(&self, pose: &Pose, bones: Bones) -> Posed {
        let pose = metres(pose);
        let (mut places, mut global) = (pose, [q::IDENTITY; JOINTS]);
        for j in 0..JOINTS {
            let parent = skeleton::PARENTS[j];
            if bones == Bones::Rigid && j > 0 {
                places[j] = q::add(places[parent], q::rotate(global[parent], self.rest[j]));
            }
            global[j] = self.orientation(j, global[parent], |child| q::subtract(pose[child], places[j]));
        }
        let locals = std::array::from_fn(|j| {
            if j == 0 {
                return (places[0], global[0]);
            }
            let parent = skeleton::PARENTS[j];
            let back = q::inverse(global[parent]);
            (q::rotate(back, q::subtract(places[j], places[parent])), q::multiply(back, global[j]))
        });
        Posed { places, locals }
    }

    /// Global rotation of a joint that points its bones along `bone`, the vectors from it to its children.
    fn orientation(&self, joint: usize, parent: Quaternion, bone: impl Fn(usize) -> Vector) -> Quaternion {
        let mut below = children(joint);
        match (below.next(), below.next()) {
            (None, _) => parent,
            (Some(child), None) => {
                let direction = q::direction(q::rotate(q::inverse(parent), bone(child)));
                let turn = match (q::direction(self.rest[child]), direction) {
                    (Some(rest), Some(bone)) => q::between(rest, bone),
                    _ => q::IDENTITY,
                };
                q::normalise(q::multiply(parent, turn))
            }
            (Some(_), Some(_)) => best_fit(children(joint).map(|child| (self.rest[child], bone(child)))),
        }
    }
}

/// What an exported body's bones do where the motion's change their length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Bones {
    /// They keep the length they have at rest; each points from where it begins to the motion's joint.
    Rigid,
    /// They follow: every joint is where the motion has it.
    Stretching,
}

/// A body in a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Posed {
    /// Global place of every joint, metres.
    pub places: [Vector; JOINTS],
    /// Place of every joint in its parent's rotated frame, metres, and its rotation there. Applied in turn they give `places`.
    pub locals: [(Vector, Quaternion); JOINTS],
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
