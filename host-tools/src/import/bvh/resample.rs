//! Any frame rate to 20 frames a second.

use super::{Bvh, kinematics};
use crate::motion::FPS;
use crate::motion::quaternion::{self as q, Quaternion, Vector};

/// Placement of every joint in its parent's frame.
pub(super) type Frame = Vec<(Vector, Quaternion)>;

/// Output frame k is the file at time k / 20 s after frame `first`: an original frame where one lies there, else the neighbours' local
/// positions interpolated linearly and their local rotations on the shorter arc. `floor((n - 1) 20 / fps) + 1` frames from n.
pub(super) fn to_20_fps(bvh: &Bvh, first: usize) -> impl Iterator<Item = Frame> {
    let step = bvh.fps() / FPS;
    let count = match (bvh.frames() - first).checked_sub(1) {
        // The small term keeps a last frame that rounding would put just past the end.
        Some(last) => (last as f64 / step + 1e-9).floor() as usize + 1,
        None => 0,
    };
    (0..count).map(move |k| {
        let place = k as f64 * step;
        let nearest = place.round();
        if (place - nearest).abs() < 1e-6 {
            return original(bvh, first + nearest as usize);
        }
        let (before, after) = (original(bvh, first + place as usize), original(bvh, first + place as usize + 1));
        let t = place.fract();
        let blend = |(a, b): (&(Vector, Quaternion), &(Vector, Quaternion))| {
            (q::add(q::scale(a.0, 1.0 - t), q::scale(b.0, t)), q::slerp(a.1, b.1, t))
        };
        before.iter().zip(&after).map(blend).collect()
    })
}

/// A frame as the file has it.
pub(super) fn original(bvh: &Bvh, frame: usize) -> Frame {
    let values = &bvh.values[frame * bvh.channels..(frame + 1) * bvh.channels];
    bvh.joints.iter().map(|joint| kinematics::local(joint, values)).collect()
}
