//! Joint positions to a Biovision hierarchy.
//!
//! The file holds the 22 joints under the names Mixamo gives them ([`NAMES`]), which animation programs and
//! [`crate::import::bvh`] recognise, in centimetres, y up. Its rest pose is a T-pose with the motion's own mean bone lengths;
//! [the parent module](super) says how rotations are chosen.
//!
//! Readers of BVH disagree about a joint that has both an OFFSET and position channels: some replace the one by the other (Blender,
//! `bvhio`, [`crate::import::bvh`]), some add them (three.js). Both forms written here read alike everywhere:
//!
//! | function | bones | OFFSET | position channels |
//! |---|---|---|---|
//! | [`write_bvh`] | rigid, as animation programs expect | the bones' vectors; zero for the root | the root's |
//! | [`write_positions`] | stretch with the motion's | zero | every joint's: its place in its parent's rotated frame |
//!
//! Bones of a generated motion change their length by some millimetres, so rigid ones leave its joints a little ([`rigid_deviation`]);
//! each points from where it begins to the motion's joint, which keeps hands and feet nearer than the motion's directions would.
//! Positions give the joints back up to the file's five decimals (0.1 micrometres, 0.00001 degrees), but have no rest pose to show.

use std::fmt;
use std::io::{self, Write};

use super::euler;
use super::rig::{self, Bones, Rig, children};
use crate::motion::quaternion::{self as q, Vector};
use crate::motion::{JOINTS, Pose, skeleton};

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

/// How far the joints of a file with rigid bones are from those of the motion, metres.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Deviation {
    /// Mean over all joints and frames.
    pub mean: f64,
    /// The largest.
    pub largest: f64,
    /// Frame of the largest.
    pub frame: usize,
    /// Joint of the largest, index into [`crate::motion::skeleton::NAMES`].
    pub joint: usize,
}

impl fmt::Display for Deviation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [mean, largest] = [self.mean, self.largest].map(|metres| CENTIMETRES * metres);
        let (joint, frame) = (skeleton::NAMES.get(self.joint).unwrap_or(&"?"), self.frame);
        write!(
            f,
            "rigid bones leave the motion's joints by {mean:.2} cm on average, {largest:.2} cm at most ({joint}, frame {frame})"
        )
    }
}

/// Writes a motion as BVH text with rigid bones.
///
/// `joints` are global positions, metres, y up; `frame_time` is in seconds (0.05 for 20 frames a second). Memory does not grow with
/// the number of frames; each row is written as soon as it is known. Give it a buffered writer, as
/// [`crate::output::write_atomic`] does.
///
/// # Errors
/// [`io::ErrorKind::InvalidInput`] before anything is written when there are no frames, `frame_time` is not a positive number, or a
/// position is not finite (named by frame and joint); else what `out` fails with.
pub fn write_bvh(joints: &[Pose], frame_time: f64, out: &mut dyn Write) -> io::Result<()> {
    write(joints, frame_time, Bones::Rigid, out)
}

/// The same with position channels on every joint, which give the motion's joints back exactly.
///
/// # Errors
/// As [`write_bvh`].
pub fn write_positions(joints: &[Pose], frame_time: f64, out: &mut dyn Write) -> io::Result<()> {
    write(joints, frame_time, Bones::Stretching, out)
}

/// What rigid bones cost in a file of [`write_bvh`]. Zeros for a motion without frames.
pub fn rigid_deviation(joints: &[Pose]) -> Deviation {
    let rig = Rig::of(joints);
    let mut deviation = Deviation::default();
    for (frame, pose) in joints.iter().enumerate() {
        let places = rig.pose(pose, Bones::Rigid).places;
        for (joint, (place, wanted)) in places.into_iter().zip(pose).enumerate() {
            let distance = q::length(q::subtract(place, wanted.map(f64::from)));
            deviation.mean += distance / (joints.len() * JOINTS) as f64;
            if distance > deviation.largest {
                deviation = Deviation { largest: distance, frame, joint, ..deviation };
            }
        }
    }
    deviation
}

fn write(joints: &[Pose], frame_time: f64, bones: Bones, out: &mut dyn Write) -> io::Result<()> {
    rig::check(joints, frame_time)?;
    let rig = Rig::of(joints);
    writeln!(out, "HIERARCHY")?;
    joint(0, 0, &rig, bones, out)?;
    // Seven decimals keep 1/30 s apart from 0.0333 s.
    writeln!(out, "MOTION\nFrames: {}\nFrame Time: {frame_time:.7}", joints.len())?;
    let mut angles = [[0.0; 3]; JOINTS];
    for pose in joints {
        let locals = rig.pose(pose, bones).locals;
        for &j in &FILE_ORDER {
            let (place, rotation) = locals[j];
            angles[j] = euler::zxy(rotation, angles[j]);
            let place = has_position(j, bones).then(|| q::scale(place, CENTIMETRES));
            for (i, value) in place.into_iter().flatten().chain(angles[j]).enumerate() {
                let space = if j == 0 && i == 0 { "" } else { " " };
                write!(out, "{space}{:.5}", unsigned_zero(value))?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

fn has_position(joint: usize, bones: Bones) -> bool {
    joint == 0 || bones == Bones::Stretching
}

/// Joints in the order of the hierarchy's text: depth first.
const FILE_ORDER: [usize; JOINTS] = [0, 1, 4, 7, 10, 2, 5, 8, 11, 3, 6, 9, 12, 15, 13, 16, 18, 20, 14, 17, 19, 21];

/// A value that rounds to zero at five decimals as zero without a sign.
fn unsigned_zero(value: f64) -> f64 {
    if value.abs() < 0.5e-5 { 0.0 } else { value }
}

/// The block of a joint and all below it. The recursion is as deep as the body: nine joints.
fn joint(j: usize, depth: usize, rig: &Rig, bones: Bones, out: &mut dyn Write) -> io::Result<()> {
    let indent = "\t".repeat(depth);
    let placed = has_position(j, bones);
    // Where position channels follow, only zero reads alike for those who add and those who replace.
    let offset = if placed { [0.0; 3] } else { q::scale(rig.rest[j], CENTIMETRES) };
    let [x, y, z] = offset.map(unsigned_zero);
    let channels = if placed { "6 Xposition Yposition Zposition" } else { "3" };
    writeln!(out, "{indent}{} {}", if j == 0 { "ROOT" } else { "JOINT" }, NAMES[j])?;
    writeln!(out, "{indent}{{\n{indent}\tOFFSET {x:.5} {y:.5} {z:.5}")?;
    writeln!(out, "{indent}\tCHANNELS {channels} Zrotation Xrotation Yrotation")?;
    for child in children(j) {
        joint(child, depth + 1, rig, bones, out)?;
    }
    if let Some((_, [x, y, z])) = END_SITES.iter().find(|(leaf, _)| *leaf == j) {
        writeln!(out, "{indent}\tEnd Site\n{indent}\t{{\n{indent}\t\tOFFSET {x:.5} {y:.5} {z:.5}\n{indent}\t}}")?;
    }
    writeln!(out, "{indent}}}")
}

#[cfg(test)]
#[path = "bvh_tests.rs"]
mod tests;
