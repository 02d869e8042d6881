//! Joint positions to a Biovision hierarchy.
//!
//! The file holds the 22 joints under the names Mixamo gives them ([`NAMES`]), which animation programs and
//! [`crate::import::bvh`] recognise, in centimetres, y up. Its rest pose is a T-pose with the motion's own mean bone lengths;
//! [the parent module](super) says how rotations are chosen.
//!
//! Bones of a generated motion change their length by some millimetres. So every joint has position channels, which replace its
//! OFFSET: what they say is the joint's place in its parent's rotated frame, and the file gives the positions back exactly, up to its
//! five decimals (0.1 micrometres, 0.00001 degrees).

use std::io::{self, Write};

use super::euler;
use super::rig::{self, Rig, children};
use crate::motion::quaternion::{self as q, Vector};
use crate::motion::{JOINTS, Pose};

/// Names of the joints in the file, in the order of [`crate::motion::skeleton::NAMES`].
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

/// End Sites of head, toes and hands, centimetres beyond the joint: nothing moves them, they give the last bone a length to draw.
const END_SITES: [(usize, Vector); 5] = [
    (10, [0.0, 0.0, 7.0]),
    (11, [0.0, 0.0, 7.0]),
    (15, [0.0, 18.0, 0.0]),
    (20, [9.0, 0.0, 0.0]),
    (21, [-9.0, 0.0, 0.0]),
];

const CENTIMETRES: f64 = 100.0;
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
    rig::check(joints, frame_time)?;
    let rig = Rig::of(joints);
    let rest = rig.rest.map(|offset| q::scale(offset, CENTIMETRES));
    writeln!(out, "HIERARCHY")?;
    joint(0, 0, &rest, out)?;
    // Seven decimals keep 1/30 s apart from 0.0333 s.
    writeln!(out, "MOTION\nFrames: {}\nFrame Time: {frame_time:.7}", joints.len())?;
    let mut angles = [[0.0; 3]; JOINTS];
    for pose in joints {
        let locals = rig.locals(pose);
        for &j in &FILE_ORDER {
            let (position, rotation) = locals[j];
            angles[j] = euler::zxy(rotation, angles[j]);
            for (i, value) in q::scale(position, CENTIMETRES).into_iter().chain(angles[j]).enumerate() {
                let space = if j == 0 && i == 0 { "" } else { " " };
                write!(out, "{space}{:.5}", unsigned_zero(value))?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// Joints in the order of the hierarchy's text: depth first.
const FILE_ORDER: [usize; JOINTS] = [0, 1, 4, 7, 10, 2, 5, 8, 11, 3, 6, 9, 12, 15, 13, 16, 18, 20, 14, 17, 19, 21];

/// A value that rounds to zero at five decimals as zero without a sign.
fn unsigned_zero(value: f64) -> f64 {
    if value.abs() < 0.5e-5 { 0.0 } else { value }
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

#[cfg(test)]
#[path = "bvh_tests.rs"]
mod tests;
