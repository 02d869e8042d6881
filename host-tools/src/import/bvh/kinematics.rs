//! Channel values to joint positions.

use super::resample::Frame;
use super::{Bvh, Channel, Joint};
use crate::motion::quaternion::{self as q, Quaternion, Vector};

/// A joint's placement in its parent's frame at one frame of the file: offset with position channels put in, and rotation
/// `R = R_first R_second R_third` over the rotation channels in the order of the file.
pub(super) fn local(joint: &Joint, values: &[f64]) -> (Vector, Quaternion) {
    let mut position = joint.offset;
    let mut rotation = q::IDENTITY;
    for (channel, &value) in joint.channels.iter().zip(&values[joint.first_channel..]) {
        match *channel {
            Channel::Position(axis) => position[axis] = value,
            Channel::Rotation(axis) => {
                let mut direction = [0.0; 3];
                direction[axis] = 1.0;
                rotation = q::multiply(rotation, q::about(direction, value.to_radians()));
            }
        }
    }
    (position, rotation)
}

/// Global positions of all joints, file units.
pub(super) fn positions(bvh: &Bvh, frame: &Frame) -> Vec<Vector> {
    let mut placed: Vec<(Vector, Quaternion)> = Vec::with_capacity(bvh.joints.len());
    for (joint, &(position, rotation)) in bvh.joints.iter().zip(frame) {
        let global = match joint.parent {
            None => (position, rotation),
            Some(parent) => {
                let (origin, turn) = placed[parent];
                (q::add(origin, q::rotate(turn, position)), q::normalise(q::multiply(turn, rotation)))
            }
        };
        placed.push(global);
    }
    placed.into_iter().map(|(position, _)| position).collect()
}
