//! Joint positions to a Biovision hierarchy.
//!
//! The file holds the 22 joints under the names Mixamo gives them ([`NAMES`]), which animation programs and
//! [`crate::import::bvh`] recognise, in centimetres, y up. Its rest pose is a T-pose with the motion's own mean bone lengths.
//!
//! Positions do not determine rotations; these are chosen so that the rest pose moves like a body: a joint with one child turns by
//! the smallest rotation, relative to its parent, that points the bone at the child; a joint with several (pelvis, upper spine) by
//! the rotation that fits all its children best; a joint without children not at all.
//!
//! Bones of a generated motion change their length by some millimetres. So every joint has position channels, which replace its
//! OFFSET: what they say is the joint's place in its parent's rotated frame, and the file gives the positions back exactly, up to its
//! five decimals (0.1 micrometres, 0.00001 degrees).

use std::io::{self, Write};

use super::best_fit::best_fit;
use super::euler;
use crate::motion::quaternion::{self as q, Quaternion, Vector};
use crate::motion::{JOINTS, Pose, skeleton};

/// Names of the joints in the file, in the order of [`skeleton::NAMES`].
pub const NAMES: [&str; JOINTS] = [
    "Hips",
    "LeftUpLeg",
    "RightUpLeg",
    "Spine",
    "LeftLeg",
    "RightLeg",
    "Spine1",
    "LeftFoot",
    "RightFoot",
    "Spine2",
    "LeftToeBase",
    "RightToeBase",
    "Neck",
    "LeftShoulder",
    "RightShoulder",
    "Head",
    "LeftArm",
    "RightArm",
    "LeftForeArm",
    "RightForeArm",
    "LeftHand",
    "RightHand",
];

/// Unit direction of the bone that ends at each joint in the T-pose, and where a fit of several children starts.
const T_POSE: [Vector; JOINTS] = [
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

/// End Sites of head, toes and hands, centimetres beyond the joint: nothing moves them, they give the last bone a length to draw.
const END_SITES: [(usize, Vector); 5] = [
    (10, [0.0, 0.0, 7.0]),
    (11, [0.0, 0.0, 7.0]),
    (15, [0.0, 18.0, 0.0]),
    (20, [9.0, 0.0, 0.0]),
    (21, [-9.0, 0.0, 0.0]),
];

const CENTIMETRES: f64 = 100.0;
/// Rounds that refine the rest offsets of joints with several children.
const REST_ROUNDS: usize = 3;

/// Writes a motion as BVH text.
///
/// `joints` are global positions, metres, y up; `frame_time` is in seconds (0.05 for 20 frames a second). Memory does not grow with
/// the number of frames; each row is written as soon as it is known. Give it a buffered writer, as
/// [`crate::output::write_atomic`] does.
///
/// # Errors
/// [`io::ErrorKind::InvalidInput`] before anything is written when there are no frames, `frame_time` is not a positive number, or a
/// position is not finite (named by frame and joint); else what `out` fails with.
pub fn write_bvh(joints: &[Pose], frame_time: f64, out: &mut dyn Write) -> io::Result<()> {
    check(joints, frame_time)?;
    let rest = rest_offsets(joints);
    writeln!(out, "HIERARCHY")?;
    joint(0, 0, &rest, out)?;
    // Seven decimals keep 1/30 s apart from 0.0333 s.
    writeln!(out, "MOTION\nFrames: {}\nFrame Time: {frame_time:.7}", joints.len())?;
    let mut angles = [[0.0; 3]; JOINTS];
    for pose in joints {
        let pose = centimetres(pose);
        let global = orientations(&pose, &rest);
        for &j in &FILE_ORDER {
            let (position, rotation) = if j == 0 {
                (pose[0], global[0])
            } else {
                let parent = skeleton::PARENTS[j];
                let back = q::inverse(global[parent]);
                (q::rotate(back, q::subtract(pose[j], pose[parent])), q::multiply(back, global[j]))
            };
            angles[j] = euler::zxy(rotation, angles[j]);
            for (i, value) in position.into_iter().chain(angles[j]).enumerate() {
                let space = if j == 0 && i == 0 { "" } else { " " };
                write!(out, "{space}{:.5}", unsigned_zero(value))?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

fn check(joints: &[Pose], frame_time: f64) -> io::Result<()> {
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

/// Joints in the order of the hierarchy's text: depth first.
const FILE_ORDER: [usize; JOINTS] = [0, 1, 4, 7, 10, 2, 5, 8, 11, 3, 6, 9, 12, 15, 13, 16, 18, 20, 14, 17, 19, 21];

fn children(joint: usize) -> impl Iterator<Item = usize> {
    (joint + 1..JOINTS).filter(move |&j| skeleton::PARENTS[j] == joint)
}

/// A value that rounds to zero at five decimals as zero without a sign.
fn unsigned_zero(value: f64) -> f64 {
    if value.abs() < 0.5e-5 { 0.0 } else { value }
}

fn centimetres(pose: &Pose) -> [Vector; JOINTS] {
    pose.map(|p| p.map(|x| CENTIMETRES * f64::from(x)))
}

/// The block of a joint and all below it. The recursion is as deep as the body: nine joints.
fn joint(j: usize, depth: usize, rest: &[Vector; JOINTS], out: &mut dyn Write) -> io::Result<()> {
    let indent = "\t".repeat(depth);
    let [x, y, z] = rest[j].map(unsigned_zero);
    writeln!(out, "{indent}{} {}", if j == 0 { "ROOT" } else { "JOINT" }, NAMES[j])?;
    writeln!(out, "{indent}{{\n{indent}\tOFFSET {x:.5} {y:.5} {z:.5}")?;
    writeln!(out, "{indent}\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation")?;
    for child in children(j) {
        joint(child, depth + 1, rest, out)?;
    }
    if let Some((_, [x, y, z])) = END_SITES.iter().find(|(leaf, _)| *leaf == j) {
        writeln!(out, "{indent}\tEnd Site\n{indent}\t{{\n{indent}\t\tOFFSET {x:.5} {y:.5} {z:.5}\n{indent}\t}}")?;
    }
    writeln!(out, "{indent}}}")
}

/// Offsets of the rest pose, centimetres: bones of mean length along [`T_POSE`], and for joints with several children the mean place
/// of each child in the joint's best-fitting frame, so that a rigid body keeps its offsets exactly.
fn rest_offsets(joints: &[Pose]) -> [Vector; JOINTS] {
    let frames = joints.len() as f64;
    let mut lengths = [0.0; JOINTS];
    for pose in joints.iter().map(centimetres) {
        for j in 1..JOINTS {
            lengths[j] += q::length(q::subtract(pose[j], pose[skeleton::PARENTS[j]])) / frames;
        }
    }
    let mut rest: [Vector; JOINTS] = std::array::from_fn(|j| q::scale(T_POSE[j], lengths[j]));
    for parent in (0..JOINTS).filter(|&j| children(j).count() > 1) {
        for _ in 0..REST_ROUNDS {
            let mut sums = [[0.0; 3]; JOINTS];
            for pose in joints.iter().map(centimetres) {
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

#[cfg(test)]
#[path = "bvh_tests.rs"]
mod tests;
