//! HumanML3D's 263 channels a frame from joint positions.
//!
//! | channels | count | what |
//! |---|---|---|
//! | 0 | 1 | root yaw velocity, HALF the angle, radians a frame |
//! | 1..3 | 2 | root velocity x, z in the facing frame, metres a frame |
//! | 3 | 1 | root height, metres |
//! | 4..67 | 21 x 3 | joint positions relative to the root's ground point, facing frame, metres |
//! | 67..193 | 21 x 6 | joint rotations, first two columns of the matrix |
//! | 193..259 | 22 x 3 | joint velocities in the facing frame, metres a frame |
//! | 259..263 | 4 | ground contact: left ankle, left foot, right ankle, right foot |
//!
//! `T` frames of joints give `T - 1` rows: velocities look one frame ahead.

use std::ops::Range;

use super::quaternion::{self as q, Quaternion, Vector};
use super::{FEATURES, JOINTS, Pose, skeleton, smooth, uniform};

pub use super::mirror::mirror_joints;

/// Channel of the root's yaw velocity.
pub const YAW_VELOCITY: usize = 0;
/// Channels of the root's planar velocity.
pub const PLANAR_VELOCITY: Range<usize> = 1..3;
/// Channel of the root's height.
pub const HEIGHT: usize = 3;
/// Channels of the root-relative joint positions, joint 1 first.
pub const POSITIONS: Range<usize> = 4..67;
/// Channels of the 6-D rotations, joint 1 first.
pub const ROTATIONS: Range<usize> = 67..193;
/// Channels of the joint velocities, pelvis first.
pub const VELOCITIES: Range<usize> = 193..259;
/// Channels of the foot contacts.
pub const CONTACTS: Range<usize> = 259..263;

/// Whether a channel is about a knee, an ankle, a foot or their contact with the ground.
pub fn of_legs(channel: usize) -> bool {
    let joint = if POSITIONS.contains(&channel) {
        1 + (channel - POSITIONS.start) / 3
    } else if ROTATIONS.contains(&channel) {
        1 + (channel - ROTATIONS.start) / 6
    } else if VELOCITIES.contains(&channel) {
        (channel - VELOCITIES.start) / 3
    } else {
        return CONTACTS.contains(&channel);
    };
    skeleton::LEGS.contains(&joint)
}

/// Squared distance a foot may move in a frame and still count as standing, metres squared (HumanML3D's `feet_thre`).
pub const CONTACT_THRESHOLD: f64 = 0.002;
/// Standard deviation of the facing filter, frames.
pub const FACING_SIGMA: f64 = 20.0;

/// What happens to bone lengths before extraction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Bones {
    /// Retarget to HumanML3D's skeleton, [`uniform::BONE_LENGTHS`].
    #[default]
    Uniform,
    /// Keep the motion's own. For motions that are uniform already.
    Keep,
}

/// How to extract.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Bone lengths of the result.
    pub bones: Bones,
    /// Put the lowest joint of the whole motion at y = 0.
    pub floor: bool,
    /// Start with the pelvis at x = z = 0, facing +z.
    pub origin: bool,
    /// [`CONTACT_THRESHOLD`] unless told, metres squared.
    pub contact_threshold: f64,
}

impl Default for Options {
    /// HumanML3D's processing.
    fn default() -> Self {
        Self { bones: Bones::Uniform, floor: true, origin: true, contact_threshold: CONTACT_THRESHOLD }
    }
}

/// A processed motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Processed {
    /// Global joints, `[T-1]` poses: one for each row of features.
    pub joints: Vec<Pose>,
    /// Unnormalised features, `[T-1][263]`, row after row.
    pub features: Vec<f32>,
}

/// Why a motion has no features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// Velocities need a next frame.
    #[error("a motion of {frames} frames is too short: features need at least 2")]
    TooShort {
        /// Frames given.
        frames: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("frame {frame}: the position of {} is not finite; repair or cut the recording there", skeleton::NAMES[*joint])]
    NotFinite {
        /// Frame, from 0.
        frame: usize,
        /// Joint index.
        joint: usize,
    },
    /// A joint coincides with its parent, so the bone has no direction.
    #[error("frame {frame}: {} coincides with {}, so the bone has no direction; check the joint mapping",
        skeleton::NAMES[*joint], skeleton::NAMES[skeleton::PARENTS[*joint]])]
    NoBone {
        /// Frame, from 0.
        frame: usize,
        /// Joint index.
        joint: usize,
    },
    /// Hips and shoulders give no horizontal facing direction.
    #[error("frame {frame}: hips and shoulders give no facing direction; check the joint mapping and that y points up")]
    NoFacing {
        /// Frame, from 0.
        frame: usize,
    },
}

/// Features only; see [`process`].
///
/// # Errors
/// As [`process`].
pub fn extract(motion: &[Pose], options: &Options) -> Result<Vec<f32>, Error> {
    process(motion, options).map(|processed| processed.features)
}

/// Brings a motion into HumanML3D's frame of reference and extracts its features.
///
/// In order: bone lengths, floor, pelvis of the first frame to x = z = 0, first frame turned to face +z, then the channels of the
/// module's table. All arithmetic is f64, results are rounded once.
///
/// # Errors
/// [`Error`], naming the frame and the joint.
pub fn process(motion: &[Pose], options: &Options) -> Result<Processed, Error> {
    let frames = motion.len();
    if frames < 2 {
        return Err(Error::TooShort { frames });
    }
    for (frame, pose) in motion.iter().enumerate() {
        if let Some(joint) = pose.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(Error::NotFinite { frame, joint });
        }
    }
    let mut motion: Vec<[Vector; JOINTS]> = super::widened(motion);
    if options.bones == Bones::Uniform {
        uniform::retarget(&mut motion, &uniform::BONE_LENGTHS)
            .map_err(|(frame, joint)| Error::NoBone { frame, joint })?;
    }
    if options.floor {
        let lowest = motion.iter().flatten().map(|p| p[1]).fold(f64::INFINITY, |a, b| if b < a { b } else { a });
        motion.iter_mut().flatten().for_each(|p| p[1] -= lowest);
    }
    if options.origin {
        to_origin(&mut motion)?;
    }
    let facing = facing(&motion)?;
    let mut features = Vec::with_capacity((frames - 1) * FEATURES);
    for frame in 0..frames - 1 {
        row(&motion[frame], &motion[frame + 1], facing[frame], facing[frame + 1], options, &mut features)
            .map_err(|joint| Error::NoBone { frame, joint })?;
    }
    let joints = motion[..frames - 1].iter().map(|pose| pose.map(|p| p.map(|x| x as f32))).collect();
    Ok(Processed { joints, features })
}

/// Moves the first pelvis to x = z = 0 and turns the first frame's facing (hips + shoulders) to +z.
fn to_origin(motion: &mut [[Vector; JOINTS]]) -> Result<(), Error> {
    let first = motion[0];
    let hips = q::subtract(first[skeleton::RIGHT_HIP], first[skeleton::LEFT_HIP]);
    let shoulders = q::subtract(first[skeleton::RIGHT_SHOULDER], first[skeleton::LEFT_SHOULDER]);
    let forward = q::cross([0.0, 1.0, 0.0], q::add(hips, shoulders));
    let forward = q::direction(forward).ok_or(Error::NoFacing { frame: 0 })?;
    let turn = q::between(forward, [0.0, 0.0, 1.0]);
    for p in motion.iter_mut().flatten() {
        *p = q::rotate(turn, [p[0] - first[0][0], p[1], p[2] - first[0][2]]);
    }
    Ok(())
}

/// For every frame the rotation that turns the smoothed facing direction to +z: the root quaternion of HumanML3D's inverse kinematics.
///
/// The published features take the shoulders MINUS the hips here (their function names its hip arguments in the other order than its
/// caller passes them), where the first frame's facing takes the sum. Features must be interchangeable with published ones, so this
/// does the same; the golden vectors tell the two apart. As there, the first frame's rotation is the identity whatever the filter says:
/// joints recovered from the features are then the processed joints themselves, not a turned copy.
fn facing(motion: &[[Vector; JOINTS]]) -> Result<Vec<Quaternion>, Error> {
    let mut forwards = Vec::with_capacity(motion.len());
    for (frame, pose) in motion.iter().enumerate() {
        let hips = q::subtract(pose[skeleton::LEFT_HIP], pose[skeleton::RIGHT_HIP]);
        let shoulders = q::subtract(pose[skeleton::RIGHT_SHOULDER], pose[skeleton::LEFT_SHOULDER]);
        let across = q::direction(q::add(hips, shoulders)).ok_or(Error::NoFacing { frame })?;
        forwards.push(q::cross([0.0, 1.0, 0.0], across));
    }
    let turn = |(frame, forward)| match frame {
        0 => Ok(q::IDENTITY),
        _ => Ok(q::between(q::direction(forward).ok_or(Error::NoFacing { frame })?, [0.0, 0.0, 1.0])),
    };
    smooth::gaussian(&forwards, FACING_SIGMA).into_iter().enumerate().map(turn).collect()
}

/// Appends one row of features. Fails with the joint whose bone has no direction.
fn row(
    pose: &[Vector; JOINTS],
    next: &[Vector; JOINTS],
    facing: Quaternion,
    next_facing: Quaternion,
    options: &Options,
    features: &mut Vec<f32>,
) -> Result<(), usize> {
    let root = pose[0];
    // Both signs of a quaternion are one rotation; the half angle below is the turn's only for the one with w >= 0. HumanML3D does not
    // choose, so its yaw velocity has the wrong sign in the frame in which the body passes a half turn from where it started.
    let turn = q::multiply(next_facing, q::inverse(facing));
    let turn = if turn[0] < 0.0 { turn.map(|x| -x) } else { turn };
    let root_velocity = q::rotate(next_facing, q::subtract(next[0], root));
    features.extend([turn[2].asin() as f32, root_velocity[0] as f32, root_velocity[2] as f32, root[1] as f32]);
    for p in &pose[1..] {
        let local = q::rotate(facing, [p[0] - root[0], p[1], p[2] - root[2]]);
        features.extend(local.map(|x| x as f32));
    }
    for rotation in &rotations(pose, facing)?[1..] {
        features.extend(q::to_6d(*rotation).map(|x| x as f32));
    }
    for (p, n) in pose.iter().zip(next) {
        let velocity = q::rotate(facing, q::subtract(*n, *p));
        features.extend(velocity.map(|x| x as f32));
    }
    for foot in skeleton::FEET {
        let step = q::subtract(next[foot], pose[foot]);
        features.push(if q::dot(step, step) < options.contact_threshold { 1.0 } else { 0.0 });
    }
    Ok(())
}

/// Inverse kinematics of one pose: each joint's rotation relative to the one before it in its chain, such that the accumulated rotation
/// takes the bone's rest direction to its actual direction along the shortest arc. Chains accumulate from the root's rotation, those of
/// the arms as well. Fails with the joint whose bone has no direction.
fn rotations(pose: &[Vector; JOINTS], root: Quaternion) -> Result<[Quaternion; JOINTS], usize> {
    let mut rotations = [q::IDENTITY; JOINTS];
    rotations[0] = root;
    for chain in skeleton::CHAINS {
        let mut accumulated = root;
        for bone in chain.windows(2) {
            let (parent, joint) = (bone[0], bone[1]);
            let actual = q::direction(q::subtract(pose[joint], pose[parent])).ok_or(joint)?;
            let turn = q::between(skeleton::REST_DIRECTIONS[joint], actual);
            rotations[joint] = q::multiply(q::inverse(accumulated), turn);
            accumulated = turn;
        }
    }
    Ok(rotations)
}
