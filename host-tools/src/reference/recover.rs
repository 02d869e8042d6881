//! HumanML3D features to joint positions, and the gradient (EQUATIONS section 1).
//!
//! With `a[t] = sum_{s<t} w[s]` (a half angle) and `R(a)` the turn `(x, z) -> (x cos 2a - z sin 2a, x sin 2a + z cos 2a)`:
//! root velocity in the world `g[s] = R(a[s+1]) v[s]`, root `p[t] = sum_{s<t} g[s]`, joints `R(a[t]) l_j[t] + p[t]`, heights as stored.

use super::real::Real;

/// Joints of the body, pelvis first.
pub const JOINTS: usize = 22;
/// Feature channels that joint positions depend on: yaw velocity, planar velocity, height, 21 local positions.
pub const CHANNELS: usize = 4 + 3 * (JOINTS - 1);

/// Turns `(x, z)` by the half angle whose doubled sine and cosine are given.
fn turn<T: Real>((sin, cos): (T, T), x: T, z: T) -> (T, T) {
    (x * cos - z * sin, x * sin + z * cos)
}

/// Sine and cosine of `2 a[t]` for `t` in `0..=frames`.
fn yaw<T: Real>(features: &[T], channels: usize) -> Vec<(T, T)> {
    let mut a = T::ZERO;
    let mut turns = vec![(T::ZERO, T::ONE)];
    for row in features.chunks_exact(channels) {
        a += row[0];
        turns.push((a + a).sin_cos());
    }
    turns
}

/// Unnormalised features `[T][channels]` (`channels >= 67`, only the first 67 are read) to joints `[T]` in metres.
///
/// # Panics
/// When `channels` is below 67: the caller's mistake, no property of any file ([`super::DecodePath`] checks those).
#[must_use]
pub fn joints<T: Real>(features: &[T], channels: usize) -> Vec<[[T; 3]; JOINTS]> {
    assert!(channels >= CHANNELS, "{channels} feature channels, at least {CHANNELS} are needed");
    let turns = yaw(features, channels);
    let (mut px, mut pz) = (T::ZERO, T::ZERO);
    let mut motion = Vec::with_capacity(features.len() / channels);
    for (t, row) in features.chunks_exact(channels).enumerate() {
        let mut pose = [[T::ZERO; 3]; JOINTS];
        pose[0] = [px, row[3], pz];
        for (joint, l) in pose[1..].iter_mut().zip(row[4..].chunks_exact(3)) {
            let (x, z) = turn(turns[t], l[0], l[2]);
            *joint = [x + px, l[1], z + pz];
        }
        motion.push(pose);
        let (x, z) = turn(turns[t + 1], row[1], row[2]);
        px += x;
        pz += z;
    }
    motion
}

/// `dJ/djoints` `[T]` to `dJ/dfeatures` `[T][channels]`, zero beyond channel 66.
///
/// Local positions by the inverse turn; root velocity by the sum of position gradients over later frames; yaw velocity by the sum of
/// torques over later frames, where the torque of a turned vector `q` under the gradient `d` is `2 (q_x d_z - q_z d_x)`.
#[must_use]
pub fn joints_backward<T: Real>(features: &[T], channels: usize, gradient: &[[[T; 3]; JOINTS]]) -> Vec<T> {
    let turns = yaw(features, channels);
    let frames = gradient.len();
    let two = T::from_f64(2.0);
    let mut d = vec![T::ZERO; frames * channels];
    // Gradients with respect to p[t + 1] and a[t + 1], summed over later frames.
    let (mut dpx, mut dpz, mut da) = (T::ZERO, T::ZERO, T::ZERO);
    for t in (0..frames).rev() {
        let row = &features[t * channels..][..channels];
        let out = &mut d[t * channels..][..channels];
        // Velocity of frame t: p[t + 1] = p[t] + R(a[t + 1]) v[t]; it moves everything later and turns with a[t + 1].
        let (sin, cos) = turns[t + 1];
        let (gx, gz) = turn((sin, cos), row[1], row[2]);
        da += two * (gx * dpz - gz * dpx);
        (out[1], out[2]) = turn((-sin, cos), dpx, dpz);
        // a[t + 1] = a[t] + w[t].
        out[0] = da;
        // Pose of frame t: joints turn with a[t] and move with p[t].
        let (sin, cos) = turns[t];
        let [rx, ry, rz] = gradient[t][0];
        out[3] = ry;
        dpx += rx;
        dpz += rz;
        for (j, &[dx, dy, dz]) in gradient[t][1..].iter().enumerate() {
            let l = &row[4 + 3 * j..][..3];
            let (qx, qz) = turn((sin, cos), l[0], l[2]);
            da += two * (qx * dz - qz * dx);
            let (lx, lz) = turn((-sin, cos), dx, dz);
            out[4 + 3 * j] = lx;
            out[5 + 3 * j] = dy;
            out[6 + 3 * j] = lz;
            dpx += dx;
            dpz += dz;
        }
    }
    d
}
