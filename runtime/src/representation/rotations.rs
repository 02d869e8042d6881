//! HumanML3D's joint rotations: what they say about where the bones point.
//!
//! Channels 67 to 192 are the first two columns of a rotation a joint, relative to the joint before it in its chain. Accumulated from
//! the root's, they take a bone's direction in the rest pose to its direction in the motion. They come from positions by the shortest
//! arc, so they say nothing about twist; a model predicts them beside the positions, and the two need not agree.

use super::Pose;
use super::humanml3d::POSITION_CHANNELS;
use crate::JOINTS;
use crate::numerics::vector::{Vector, add, cross, dot, scale, subtract, unit};

/// First channel of the rotations.
pub const FIRST: usize = POSITION_CHANNELS;
/// Channels of the rotations.
pub const CHANNELS: usize = 6 * (JOINTS - 1);

/// Chains of joints along which rotations accumulate; those of the arms begin with the root's rotation, too.
const CHAINS: [&[usize]; 5] =
    [&[0, 2, 5, 8, 11], &[0, 1, 4, 7, 10], &[0, 3, 6, 9, 12, 15], &[9, 14, 17, 19, 21], &[9, 13, 16, 18, 20]];

/// Where the bone that ends at a joint points in the rest pose.
const fn rest(joint: usize) -> Vector {
    match joint {
        1 | 13 => [1.0, 0.0, 0.0],
        2 | 14 => [-1.0, 0.0, 0.0],
        3 | 6 | 9 | 12 => [0.0, 1.0, 0.0],
        10 | 11 | 15 => [0.0, 0.0, 1.0],
        _ => [0.0, -1.0, 0.0],
    }
}

/// Columns of a rotation matrix.
type Matrix = [Vector; 3];

fn apply([x, y, z]: &Matrix, [a, b, c]: Vector) -> Vector {
    add(add(scale(*x, a), scale(*y, b)), scale(*z, c))
}

/// `pose` with its bones turned as `rotations` say, a frame's channels, unnormalised; its heading has this cosine and sine.
#[must_use]
pub fn turned(rotations: &[f32; CHANNELS], (cos, sin): (f32, f32), pose: &Pose) -> Pose {
    // The root's rotation is the one that turns the heading to +z.
    let root: Matrix = [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]];
    let mut out = *pose;
    for chain in CHAINS {
        let mut turned = root;
        for bone in chain.windows(2) {
            let [parent, joint] = *bone else { continue };
            let (Some(from), Some(to)) = (pose.get(parent), pose.get(joint)) else { continue };
            let six = rotations.get(6 * joint.saturating_sub(1)..).and_then(|values| values.first_chunk::<6>());
            let Some(&[ax, ay, az, bx, by, bz]) = six else { continue };
            let (a, b) = ([ax, ay, az], [bx, by, bz]);
            let x = unit(a, [1.0, 0.0, 0.0]);
            let y = unit(subtract(b, scale(x, dot(x, b))), [0.0, 1.0, 0.0]);
            let own = [x, y, cross(x, y)];
            turned = own.map(|column| apply(&turned, column));
            let along = subtract(*to, *from);
            let bone = scale(apply(&turned, rest(joint)), libm::sqrtf(dot(along, along)));
            let Some(at) = out.get(parent).map(|parent| add(*parent, bone)) else { continue };
            if let Some(slot) = out.get_mut(joint) {
                *slot = at;
            }
        }
    }
    out
}
