//! The same motion by a left-handed twin.

use super::{Pose, skeleton};

/// Mirrors a motion at the plane x = 0: negates x and swaps left and right joints. Applied twice it gives the original bits back.
///
/// Features of the mirrored motion come from extracting again ([`super::features::extract`]), not from permuting channels: contacts,
/// rotations and smoothed facing then belong to the motion that is stored.
pub fn mirror_joints(motion: &[Pose]) -> Vec<Pose> {
    motion
        .iter()
        .map(|pose| {
            std::array::from_fn(|joint| {
                let [x, y, z] = pose[skeleton::MIRROR[joint]];
                [-x, y, z]
            })
        })
        .collect()
}
