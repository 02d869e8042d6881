//! HumanML3D's representation: which channels give joint positions, how, and the gradient back.
//!
//! With `a[t] = sum_{s<t} w[s]`, `th = 2 a` (the stored yaw velocity is a half angle) and `R(th)(x, z) =
//! (x cos th - z sin th, x sin th + z cos th)`:
//! `p_xz[t] = sum_{s<t} R(th[s+1]) v[s]`, `p_y[t] = h[t]`, `joint_j[t] = R(th[t]) local_j[t] + (p_x, 0, p_z)[t]`.

use super::{Features, Recover};
use crate::JOINTS;
use crate::channels::Channels;
use crate::memory::{Arena, ArenaTooSmall};
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

/// What undoes the normalisation of the features, and thereby recovers joints from them.
///
/// Of the features' channels the root's come first.
#[derive(Debug, Clone, Copy)]
pub struct Recovery<'a> {
    /// `[F]`
    pub mean: &'a [f32],
    /// `[F]`
    pub std: &'a [f32],
}

/// A number that is there by construction.
fn at(values: &[f32], index: usize) -> f32 {
    let value = values.get(index);
    invariant!(value.is_some(), "number {index} of {}", values.len());
    value.copied().unwrap_or(0.0)
}

/// The same, to be added to.
fn add(values: &mut [f32], index: usize, d: f32) {
    invariant!(index < values.len(), "number {index} of {}", values.len());
    if let Some(value) = values.get_mut(index) {
        *value += d;
    }
}

fn width(channels: &Channels) -> usize {
    channels.count().max(1)
}

fn row(features: Features<'_>, frame: usize) -> &[f32] {
    features.values.get(frame * width(features.channels)..).unwrap_or(&[])
}

impl Recovery<'_> {
    /// Scale and offset of one channel.
    fn constants(&self, channel: usize) -> (f32, f32) {
        (at(self.std, channel), at(self.mean, channel))
    }

    /// A root channel of a frame.
    fn root(&self, row: &[f32], channel: usize) -> f32 {
        let (std, mean) = self.constants(channel);
        at(row, channel) * std + mean
    }

    /// Integrates the root from `root`, which stands where the first of these frames does, and moves it on to the frame
    /// behind the last: pieces of a motion in turn give the bits of the whole.
    pub fn integrate_from(&self, features: Features<'_>, root: &mut Root, path: &mut Path<'_>) {
        let out = path.cos.iter_mut().zip(path.sin.iter_mut()).zip(path.x.iter_mut().zip(path.z.iter_mut()));
        for (row, ((cos, sin), (x, z))) in features.values.chunks_exact(width(features.channels)).zip(out) {
            (*cos, *sin, *x, *z) = (root.cos, root.sin, root.x, root.z);
            root.step(self.root(row, YAW), self.root(row, VELOCITY_X), self.root(row, VELOCITY_Z));
        }
    }

    /// Positions of all joints, `[T][22][3]`, metres, in the place of the normalised features of all their channels, `values [T][C]`.
    pub fn joints<'v>(&self, values: &'v mut [f32], path: &Path<'_>) -> &'v mut [f32] {
        let all = channels(u32::MAX);
        let width = width(&all);
        let frames = values.len() / width;
        for frame in 0..frames {
            let mut row = [0.0; POSITION_CHANNELS];
            for (to, from) in row.iter_mut().zip(values.iter().skip(frame * width)) {
                *to = *from;
            }
            // A frame's joints are no more numbers than its features, so none is overwritten that is still to be read.
            for (joint, to) in values.chunks_exact_mut(3).skip(frame * JOINTS).take(JOINTS).enumerate() {
                for (to, from) in to.iter_mut().zip(self.placed(&row, &all, path, joint, frame)) {
                    *to = from;
                }
            }
        }
        part_mut!(values, ..frames * 3 * JOINTS)
    }

    /// Local position of `joint >= 1` in the frame of that row, metres, in the root's frame. `None`: its channels were not selected.
    fn local(&self, row: &[f32], channels: &Channels, joint: usize) -> Option<[f32; 3]> {
        let channel = local_channel(joint);
        let column = channels.position(channel)?;
        let values = row.get(column..column + 3)?;
        let mut local = [0.0; 3];
        for (axis, (to, from)) in local.iter_mut().zip(values).enumerate() {
            let (std, mean) = self.constants(channel + axis);
            *to = *from * std + mean;
        }
        Some(local)
    }

    /// Position of a joint with the frame's features in `row`.
    fn placed(&self, row: &[f32], channels: &Channels, path: &Path<'_>, joint: usize, frame: usize) -> [f32; 3] {
        let (Some(&x), Some(&z)) = (path.x.get(frame), path.z.get(frame)) else { return [0.0; 3] };
        if joint == 0 {
            return [x, self.root(row, HEIGHT), z];
        }
        let (cos, sin) = (at(path.cos, frame), at(path.sin, frame));
        let Some([lx, ly, lz]) = self.local(row, channels, joint) else { return [0.0; 3] };
        [lx * cos - lz * sin + x, ly, lx * sin + lz * cos + z]
    }
}

impl Recover for Recovery<'_> {
    type Path<'w> = Path<'w>;

    fn channels(&self, joints: u32) -> Channels {
        channels(joints)
    }

    /// Integrates the root from the start of a motion: fills `path`'s angle and position of every frame.
    fn integrate(&self, features: Features<'_>, path: &mut Path<'_>) {
        self.integrate_from(features, &mut Root::default(), path);
    }

    fn position(&self, features: Features<'_>, path: &Path<'_>, joint: usize, frame: usize) -> [f32; 3] {
        self.placed(row(features, frame), features.channels, path, joint, frame)
    }

    fn clear_gradient(&self, path: &mut Path<'_>) {
        path.d_angle.fill(0.0);
        path.d_x.fill(0.0);
        path.d_z.fill(0.0);
    }

    /// Local channels go into `g` at once (normalised), the root's share into `path`.
    fn add_gradient(
        &self,
        features: Features<'_>,
        path: &mut Path<'_>,
        g: &mut [f32],
        (joint, frame): (usize, usize),
        d: [f32; 3],
    ) {
        let [dx, dy, dz] = d;
        add(path.d_x, frame, dx);
        add(path.d_z, frame, dz);
        let first = frame * width(features.channels);
        if joint == 0 {
            add(g, first + HEIGHT, dy * self.constants(HEIGHT).0);
            return;
        }
        let channel = local_channel(joint);
        let Some(column) = features.channels.position(channel) else { return };
        let Some([lx, _, lz]) = self.local(row(features, frame), features.channels, joint) else { return };
        let (cos, sin) = (at(path.cos, frame), at(path.sin, frame));
        let local = [dx * cos + dz * sin, dy, dz * cos - dx * sin];
        for (axis, d) in local.into_iter().enumerate() {
            add(g, first + column + axis, d * self.constants(channel + axis).0);
        }
        let (rx, rz) = (lx * cos - lz * sin, lx * sin + lz * cos);
        add(path.d_angle, frame, dz * rx - dx * rz);
    }

    /// Suffix sums over the root channels.
    fn integrate_gradient(&self, features: Features<'_>, path: &Path<'_>, g: &mut [f32]) {
        let width = width(features.channels);
        // Gradients with respect to position and half angle of all later frames.
        let (mut sum_x, mut sum_z, mut sum_angle) = (0.0f32, 0.0f32, 0.0f32);
        let frames = features.values.len() / width;
        for (s, row) in features.values.chunks_exact(width).enumerate().rev() {
            let next = s + 1;
            if next >= frames {
                continue;
            }
            sum_x += at(path.d_x, next);
            sum_z += at(path.d_z, next);
            let (cos, sin) = (at(path.cos, next), at(path.sin, next));
            let (vx, vz) = (self.root(row, VELOCITY_X), self.root(row, VELOCITY_Z));
            let (rx, rz) = (vx * cos - vz * sin, vx * sin + vz * cos);
            sum_angle += 2.0 * (at(path.d_angle, next) + sum_z * rx - sum_x * rz);
            let d =
                [(YAW, sum_angle), (VELOCITY_X, sum_x * cos + sum_z * sin), (VELOCITY_Z, sum_z * cos - sum_x * sin)];
            for (channel, d) in d {
                add(g, s * width + channel, d * self.constants(channel).0);
            }
        }
    }
}
