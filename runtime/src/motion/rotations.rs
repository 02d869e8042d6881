//! HumanML3D's joint rotations: what they say about where the bones point.
//!
//! Channels 67 to 192 are the first two columns of a rotation a joint, relative to the joint before it in its chain. Accumulated from
//! the root's, they take a bone's direction in the rest pose to its direction in the motion. They come from positions by the shortest
//! arc, so they say nothing about twist; a model predicts them beside the positions, and the two need not agree.

use super::humanml3d::POSITION_CHANNELS;
use crate::JOINTS;
use crate::nn::conv1d::Rows;
use crate::nn::output::{Channels, Output, Scratch};
use crate::playback::body::Pose;
use crate::playback::rotation::{Vector, add, cross, dot, scale, subtract, unit};

/// Channels of the rotations.
const CHANNELS: usize = 6 * (JOINTS - 1);

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

/// What a motion's rotations are computed from: the last layer's input, as it was left in the arena.
#[derive(Debug, Clone, Copy)]
pub struct Rotations<'a> {
    /// The last layer.
    pub output: &'a Output<'a>,
    /// Its input `[T][K]`, quantised.
    pub rows: Rows<'a>,
    /// Means and standard deviations of all channels.
    pub mean: &'a [f32],
    /// See [`Rotations::mean`].
    pub std: &'a [f32],
    /// Cosine and sine of the heading, one a frame.
    pub cos: &'a [f32],
    /// See [`Rotations::cos`].
    pub sin: &'a [f32],
}

/// Columns of a rotation matrix.
type Matrix = [Vector; 3];

fn apply([x, y, z]: &Matrix, [a, b, c]: Vector) -> Vector {
    add(add(scale(*x, a), scale(*y, b)), scale(*z, c))
}

impl Rotations<'_> {
    /// `pose`, the positions of a frame, with its bones turned as that frame's rotations say. `None`: the model has no such channels,
    /// or the motion no such frame.
    #[inline(never)]
    pub fn pose(&self, frame: usize, pose: &Pose) -> Option<Pose> {
        let mut channels = Channels::new();
        channels.push(POSITION_CHANNELS, CHANNELS);
        if self.output.outputs() < POSITION_CHANNELS + CHANNELS {
            return None;
        }
        let (&cos, &sin) = (self.cos.get(frame)?, self.sin.get(frame)?);
        let (mut values, mut acc, mut acc_low) = ([0.0; CHANNELS], [0; CHANNELS], [0; CHANNELS]);
        let mut scratch = Scratch { row: &mut [], q: &mut [], acc: &mut acc, acc_low: &mut acc_low };
        self.output.forward(self.rows, frame, &channels, &mut values, &mut scratch);
        let constants = self.std.iter().zip(self.mean).skip(POSITION_CHANNELS);
        for (value, (std, mean)) in values.iter_mut().zip(constants) {
            *value = *value * *std + *mean;
        }
        // The root's rotation is the one that turns the heading to +z.
        let root: Matrix = [[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]];
        let mut out = *pose;
        for chain in CHAINS {
            let mut turned = root;
            for bone in chain.windows(2) {
                let [parent, joint] = *bone else { continue };
                let (Some(from), Some(to)) = (pose.get(parent), pose.get(joint)) else { continue };
                let six = values.get(6 * joint.saturating_sub(1)..).and_then(|values| values.first_chunk::<6>());
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
        Some(out)
    }
}
