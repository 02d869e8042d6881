//! Joint positions from HumanML3D features (`recover_from_ric`).
//!
//! EQUATIONS section 1, with `w` the stored half-angle yaw velocity, `v` planar velocity, `h` height and `l_j` local positions:
//! `a[t] = sum_{s<t} w[s]`; `p_xz[t] = sum_{s<t} R_y(-2 a[s+1]) v[s]`; `p_y[t] = h[t]`; `joint_j[t] = R_y(-2 a[t]) l_j[t] + (p_x, 0, p_z)[t]`.
//! Only channels 0..67 are read.

use super::features::{HEIGHT, PLANAR_VELOCITY, POSITIONS, YAW_VELOCITY};
use super::{FEATURES, JOINTS, Pose};

/// Features that do not form whole rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{values} feature values are not whole rows of {columns}")]
pub struct NotRows {
    /// Values given.
    pub values: usize,
    /// Channels a row.
    pub columns: usize,
}

/// Global joints in f64, `[T][22][3]` metres, from unnormalised features `[T][263]`.
///
/// # Errors
/// [`NotRows`] when the number of values is not a multiple of 263.
pub fn joints_f64(features: &[f64]) -> Result<Vec<[[f64; 3]; JOINTS]>, NotRows> {
    if !features.len().is_multiple_of(FEATURES) {
        return Err(NotRows { values: features.len(), columns: FEATURES });
    }
    let mut motion = Vec::with_capacity(features.len() / FEATURES);
    let (mut angle, mut x, mut z) = (0.0f64, 0.0f64, 0.0f64);
    for row in features.chunks_exact(FEATURES) {
        let (sin, cos) = (-2.0 * angle).sin_cos();
        let mut pose = [[0.0; 3]; JOINTS];
        pose[0] = [x, row[HEIGHT], z];
        for (joint, local) in pose[1..].iter_mut().zip(row[POSITIONS].chunks_exact(3)) {
            *joint = [cos * local[0] + sin * local[2] + x, local[1], cos * local[2] - sin * local[0] + z];
        }
        motion.push(pose);
        angle += row[YAW_VELOCITY];
        let (sin, cos) = (-2.0 * angle).sin_cos();
        let [vx, vz] = [row[PLANAR_VELOCITY.start], row[PLANAR_VELOCITY.start + 1]];
        x += cos * vx + sin * vz;
        z += cos * vz - sin * vx;
    }
    Ok(motion)
}

/// Global joints, `[T]` poses in metres, from unnormalised f32 features `[T][263]`. Sums run in f64.
///
/// # Errors
/// [`NotRows`] when the number of values is not a multiple of 263.
pub fn joints(features: &[f32]) -> Result<Vec<Pose>, NotRows> {
    let wide: Vec<f64> = features.iter().map(|&x| f64::from(x)).collect();
    Ok(joints_f64(&wide)?.into_iter().map(|pose| pose.map(|p| p.map(|x| x as f32))).collect())
}
