//! HumanML3D's uniform-skeleton step: everybody gets the same bone lengths.

use super::quaternion::{self as q, Vector};
use super::{JOINTS, skeleton};

/// Length in metres of the bone that ends at each joint of HumanML3D's target skeleton; zero for the pelvis.
///
/// Twenty-one measured numbers: the distances between neighbouring joints in processed motions of the public HumanML3D repository,
/// where every motion has the same ones (over the frames of the two example clips they vary by at most 2e-6 m, their means agree to 1e-7 m). Left and right differ a
/// little because the target skeleton is a real person's.
pub const BONE_LENGTHS: [f64; JOINTS] = [
    0.0, 0.103074, 0.1098834, 0.1315682, 0.3936232, 0.3901882, 0.1431902, 0.432433, 0.4256434, 0.0573647, 0.1433818,
    0.1494191, 0.21936, 0.1374868, 0.1433828, 0.1030392, 0.131614, 0.1229844, 0.2568399, 0.2630919, 0.2660118,
    0.2698763,
];

/// Offset of each joint from its parent in HumanML3D's rest pose, metres, of a body with [`BONE_LENGTHS`]; zero for the pelvis.
#[must_use]
pub fn rest_offsets() -> [Vector; JOINTS] {
    std::array::from_fn(|joint| q::scale(skeleton::REST_DIRECTIONS[joint], BONE_LENGTHS[joint]))
}

/// Where bones of pelvis and chest point at rest, by the joints at their ends: means of the training motions, left and right alike.
/// HumanML3D has them flat, as no body is: hips level with the pelvis, shoulders 13 cm lower.
const MEASURED: [(usize, [f64; 3]); 6] = [
    (1, [0.88, -0.40, 0.0]),
    (2, [-0.88, -0.40, 0.0]),
    (3, [0.0, 1.0, 0.0]),
    (12, [0.0, 1.0, 0.0]),
    (13, [0.57, 0.79, -0.03]),
    (14, [-0.57, 0.79, -0.03]),
];

/// Offset of each joint from its parent at rest, metres, of the body that our models move: HumanML3D's bones, to whose lengths every motion was
/// brought before training, with pelvis and chest as they were measured.
#[must_use]
pub fn body() -> [Vector; JOINTS] {
    let mut offsets = rest_offsets();
    for (joint, way) in MEASURED {
        offsets[joint] = q::scale(way, q::length(offsets[joint]) / q::length(way));
    }
    offsets
}

/// Gives `[T][22][3]` motion (metres, f64) the target's bone lengths.
///
/// The root path is scaled by the ratio of leg lengths (thigh + shank, source measured in the first frame), every bone keeps its direction.
/// This equals inverse kinematics followed by forward kinematics with the target's offsets, which is how HumanML3D writes it, because
/// a bone's accumulated rotation there is the one that takes its rest direction to its actual direction.
///
/// # Errors
/// The `(frame, joint)` of a bone without length, which has no direction to keep.
pub fn retarget(motion: &mut [[Vector; JOINTS]], lengths: &[f64; JOINTS]) -> Result<(), (usize, usize)> {
    let Some(first) = motion.first() else { return Ok(()) };
    let source = bone_lengths(first);
    // HumanML3D takes one thigh and one shank: the right knee (5) and the right ankle (8).
    let (knee, ankle) = (5, 8);
    let ratio = (lengths[knee] + lengths[ankle]) / (source[knee] + source[ankle]);
    if !ratio.is_finite() {
        return Err((0, knee));
    }
    for (frame, pose) in motion.iter_mut().enumerate() {
        let original = *pose;
        pose[0] = q::scale(original[0], ratio);
        for joint in 1..JOINTS {
            let parent = skeleton::PARENTS[joint];
            let bone = q::subtract(original[joint], original[parent]);
            let direction = q::direction(bone).ok_or((frame, joint))?;
            pose[joint] = q::add(pose[parent], q::scale(direction, lengths[joint]));
        }
    }
    Ok(())
}

/// Distance of every joint from its parent, metres.
pub fn bone_lengths(pose: &[Vector; JOINTS]) -> [f64; JOINTS] {
    std::array::from_fn(|joint| q::length(q::subtract(pose[joint], pose[skeleton::PARENTS[joint]])))
}
