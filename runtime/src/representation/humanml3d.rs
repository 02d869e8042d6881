//! HumanML3D's representation: which channels give joint positions, how, and the gradient back.
//!
//! With `a[t] = sum_{s<t} w[s]`, `th = 2 a` (the stored yaw velocity is a half angle) and `R(th)(x, z) =
//! (x cos th - z sin th, x sin th + z cos th)`:
//! `p_xz[t] = sum_{s<t} R(th[s+1]) v[s]`, `p_y[t] = h[t]`, `joint_j[t] = R(th[t]) local_j[t] + (p_x, 0, p_z)[t]`.

use crate::JOINTS;
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::output::Channels;
use crate::numerics::angle::sin_cos;
use core::f32::consts::PI;

/// Channels of the representation.
pub const FEATURES: usize = 263;
/// Yaw velocity, planar velocity x and z, height.
pub const ROOT_CHANNELS: usize = 4;
/// Channels that joint positions depend on.
pub const POSITION_CHANNELS: usize = ROOT_CHANNELS + 3 * (JOINTS - 1);

const YAW: usize = 0;
const VELOCITY_X: usize = 1;
const VELOCITY_Z: usize = 2;
const HEIGHT: usize = 3;

/// First of the three channels of a joint's local position; joint 0 is the root and has none.
#[must_use]
pub const fn local_channel(joint: usize) -> usize {
    ROOT_CHANNELS + 3 * joint.saturating_sub(1)
}

/// The channels needed for the positions of the joints whose bit is set in `joints`.
#[must_use]
pub fn channels(joints: u32) -> Channels {
    let mut channels = Channels::new();
    // 22 joints make at most 12 ranges, half of what fits.
    channels.push(0, ROOT_CHANNELS);
    for joint in 1..JOINTS {
        if (joints >> joint) & 1 == 1 {
            channels.push(local_channel(joint), 3);
        }
    }
    channels
}

/// Root path of a motion and the buffers of its gradient, one value a frame each.
#[derive(Debug)]
pub struct Path<'a> {
    /// `cos th`
    pub cos: &'a mut [f32],
    /// `sin th`
    pub sin: &'a mut [f32],
    /// Root x, metres.
    pub x: &'a mut [f32],
    /// Root z, metres.
    pub z: &'a mut [f32],
    /// dJ/dth
    pub d_angle: &'a mut [f32],
    /// dJ/dx of the root
    pub d_x: &'a mut [f32],
    /// dJ/dz of the root
    pub d_z: &'a mut [f32],
}

impl<'a> Path<'a> {
    /// Takes the buffers for so many frames, those of the gradient only if it is wanted.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn take(arena: &mut Arena<'a>, frames: usize, gradient: bool) -> Result<Self, ArenaTooSmall> {
        let (cos, sin, x, z) = (arena.take(frames)?, arena.take(frames)?, arena.take(frames)?, arena.take(frames)?);
        let frames = if gradient { frames } else { 0 };
        let (d_angle, d_x, d_z) = (arena.take(frames)?, arena.take(frames)?, arena.take(frames)?);
        Ok(Path { cos, sin, x, z, d_angle, d_x, d_z })
    }
}

/// Where the root stands and faces: what the integration carries from one frame to the next.
///
/// The half angle is kept within a turn, `|a| <= pi`: beyond it `pi` is taken off, which is exact but for the 9e-8 rad by
/// which the constant misses pi. Left to grow, an f32 would swallow slow turns within hours; this way the rounding of
/// each step is that of the first turn (at most 1.2e-7 rad), however long the motion runs. The position has no such
/// period: its resolution is 0.06 mm within 1 km of the origin and doubles with the distance, see [`Root::rebase`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Root {
    /// `a`, half the heading, radians.
    angle: f32,
    /// `cos 2 a`
    cos: f32,
    /// `sin 2 a`
    sin: f32,
    /// Metres.
    x: f32,
    /// Metres.
    z: f32,
}

impl Default for Root {
    /// At the origin, facing +z.
    fn default() -> Self {
        Root { angle: 0.0, cos: 1.0, sin: 0.0, x: 0.0, z: 0.0 }
    }
}

impl Root {
    /// Moves the origin below the root, leaving the axes as they are. Returns where the new origin lies in the old
    /// frame, `[x, z]`, metres.
    pub const fn rebase(&mut self) -> [f32; 2] {
        let origin = [self.x, self.z];
        (self.x, self.z) = (0.0, 0.0);
        origin
    }

    /// Turns by the half angle `yaw`, then walks by `(vx, vz)` in the new heading, metres.
    fn step(&mut self, yaw: f32, vx: f32, vz: f32) {
        self.angle = within_a_turn(self.angle + yaw);
        (self.sin, self.cos) = sin_cos(2.0 * self.angle);
        self.x += vx * self.cos - vz * self.sin;
        self.z += vx * self.sin + vz * self.cos;
    }
}

/// The same half angle with `|a| <= pi`.
fn within_a_turn(angle: f32) -> f32 {
    // Never in doubt for a body: a whole turn between two frames would be needed to leave a remainder beyond pi.
    if angle.abs() > PI { libm::fmodf(angle, PI) } else { angle }
}

/// Normalised features of some channels and what undoes the normalisation.
#[derive(Debug, Clone, Copy)]
pub struct Features<'a> {
    /// `[T][C]`
    pub values: &'a [f32],
    /// The `C` channels; the root's come first.
    pub channels: &'a Channels,
    /// `[F]`
    pub mean: &'a [f32],
    /// `[F]`
    pub std: &'a [f32],
}

/// Positions of all joints, `[T][22][3]`, metres, in the place of the normalised features of all their channels, `values [T][C]`.
pub fn joints<'v>(values: &'v mut [f32], path: &Path<'_>, mean: &[f32], std: &[f32]) -> &'v mut [f32] {
    let all = channels(u32::MAX);
    let features = Features { values: &[], channels: &all, mean, std };
    let frames = values.len() / features.width();
    for frame in 0..frames {
        let mut row = [0.0; POSITION_CHANNELS];
        for (to, from) in row.iter_mut().zip(values.iter().skip(frame * features.width())) {
            *to = *from;
        }
        // A frame's joints are no more numbers than its features, so none is overwritten that is still to be read.
        for (joint, to) in values.chunks_exact_mut(3).skip(frame * JOINTS).take(JOINTS).enumerate() {
            for (to, from) in to.iter_mut().zip(features.placed(&row, path, joint, frame)) {
                *to = from;
            }
        }
    }
    values.get_mut(..frames * 3 * JOINTS).unwrap_or(&mut [])
}

/// Scale and offset of one channel.
fn constants(mean: &[f32], std: &[f32], channel: usize) -> (f32, f32) {
    (std.get(channel).copied().unwrap_or(0.0), mean.get(channel).copied().unwrap_or(0.0))
}

impl Features<'_> {
    fn width(&self) -> usize {
        self.channels.count().max(1)
    }

    fn root(&self, row: &[f32], channel: usize) -> f32 {
        let (std, mean) = constants(self.mean, self.std, channel);
        row.get(channel).copied().unwrap_or(0.0) * std + mean
    }

    /// Integrates the root from the start of a motion: fills `path`'s angle and position of every frame.
    pub fn integrate(&self, path: &mut Path<'_>) {
        self.integrate_from(&mut Root::default(), path);
    }

    /// Integrates the root from `root`, which stands where the first of these frames does, and moves it on to the frame
    /// behind the last: pieces of a motion in turn give the bits of the whole.
    pub fn integrate_from(&self, root: &mut Root, path: &mut Path<'_>) {
        let out = path.cos.iter_mut().zip(path.sin.iter_mut()).zip(path.x.iter_mut().zip(path.z.iter_mut()));
        for (row, ((cos, sin), (x, z))) in self.values.chunks_exact(self.width()).zip(out) {
            (*cos, *sin, *x, *z) = (root.cos, root.sin, root.x, root.z);
            root.step(self.root(row, YAW), self.root(row, VELOCITY_X), self.root(row, VELOCITY_Z));
        }
    }

    fn row(&self, frame: usize) -> &[f32] {
        self.values.get(frame * self.width()..).unwrap_or(&[])
    }

    /// Local position of `joint >= 1` in the frame of that row, metres, in the root's frame.
    fn local(&self, row: &[f32], joint: usize) -> Option<[f32; 3]> {
        let channel = local_channel(joint);
        let column = self.channels.position(channel)?;
        let values = row.get(column..column + 3)?;
        let mut local = [0.0; 3];
        for (axis, (to, from)) in local.iter_mut().zip(values).enumerate() {
            let (std, mean) = constants(self.mean, self.std, channel + axis);
            *to = *from * std + mean;
        }
        Some(local)
    }

    /// Position of a joint, metres. A joint whose channels were not selected, or a frame out of range, gives zeros.
    #[must_use]
    pub fn position(&self, path: &Path<'_>, joint: usize, frame: usize) -> [f32; 3] {
        self.placed(self.row(frame), path, joint, frame)
    }

    /// The same with the frame's features in `row`.
    fn placed(&self, row: &[f32], path: &Path<'_>, joint: usize, frame: usize) -> [f32; 3] {
        let (Some(&x), Some(&z)) = (path.x.get(frame), path.z.get(frame)) else { return [0.0; 3] };
        if joint == 0 {
            return [x, self.root(row, HEIGHT), z];
        }
        let (Some(&cos), Some(&sin)) = (path.cos.get(frame), path.sin.get(frame)) else { return [0.0; 3] };
        let Some([lx, ly, lz]) = self.local(row, joint) else { return [0.0; 3] };
        [lx * cos - lz * sin + x, ly, lx * sin + lz * cos + z]
    }

    /// Adds `d = dJ/dposition` of a joint: local channels go into `g [T][C]` at once (normalised), the root's share
    /// into `path` until [`Features::integrate_gradient`].
    pub fn add_gradient(&self, path: &mut Path<'_>, g: &mut [f32], joint: usize, frame: usize, d: [f32; 3]) {
        let [dx, dy, dz] = d;
        let (Some(sum_x), Some(sum_z)) = (path.d_x.get_mut(frame), path.d_z.get_mut(frame)) else { return };
        *sum_x += dx;
        *sum_z += dz;
        let row = frame * self.width();
        if joint == 0 {
            if let Some(g) = g.get_mut(row + HEIGHT) {
                *g += dy * constants(self.mean, self.std, HEIGHT).0;
            }
            return;
        }
        let channel = local_channel(joint);
        let Some(column) = self.channels.position(channel) else { return };
        let (Some(&cos), Some(&sin)) = (path.cos.get(frame), path.sin.get(frame)) else { return };
        let Some([lx, _, lz]) = self.local(self.row(frame), joint) else { return };
        let local = [dx * cos + dz * sin, dy, dz * cos - dx * sin];
        for (axis, d) in local.into_iter().enumerate() {
            if let Some(g) = g.get_mut(row + column + axis) {
                *g += d * constants(self.mean, self.std, channel + axis).0;
            }
        }
        if let Some(angle) = path.d_angle.get_mut(frame) {
            let (rx, rz) = (lx * cos - lz * sin, lx * sin + lz * cos);
            *angle += dz * rx - dx * rz;
        }
    }

    /// Carries the root's gradient back through time into the root channels of `g [T][C]` (suffix sums).
    pub fn integrate_gradient(&self, path: &Path<'_>, g: &mut [f32]) {
        let width = self.width();
        // Gradients with respect to position and half angle of all later frames.
        let (mut sum_x, mut sum_z, mut sum_angle) = (0.0f32, 0.0f32, 0.0f32);
        let frames = self.values.len() / width;
        for s in (0..frames).rev() {
            let Some(row) = self.values.get(s * width..(s + 1) * width) else { continue };
            let next = s + 1;
            if let (Some(dx), Some(dz), Some(da)) = (path.d_x.get(next), path.d_z.get(next), path.d_angle.get(next))
                && next < frames
            {
                sum_x += *dx;
                sum_z += *dz;
                let (cos, sin) =
                    (path.cos.get(next).copied().unwrap_or(1.0), path.sin.get(next).copied().unwrap_or(0.0));
                let (vx, vz) = (self.root(row, VELOCITY_X), self.root(row, VELOCITY_Z));
                let (rx, rz) = (vx * cos - vz * sin, vx * sin + vz * cos);
                sum_angle += 2.0 * (*da + sum_z * rx - sum_x * rz);
                let d = [
                    (YAW, sum_angle),
                    (VELOCITY_X, sum_x * cos + sum_z * sin),
                    (VELOCITY_Z, sum_z * cos - sum_x * sin),
                ];
                for (channel, d) in d {
                    if let Some(g) = g.get_mut(s * width + channel) {
                        *g += d * constants(self.mean, self.std, channel).0;
                    }
                }
            }
        }
    }
}
