//! Motion as joints and as HumanML3D features.
//!
//! Axes: y up, metres, 20 frames a second; a processed motion starts with the pelvis at x = z = 0, facing +z, the subject's left at +x.

pub mod features;
pub mod mirror;
pub mod quaternion;
pub mod recover;
pub mod side;
pub mod skeleton;
pub mod smooth;
pub mod uniform;

/// Frames a second of every processed motion.
pub const FPS: f64 = 20.0;
/// Joints of the SMPL body without hands.
pub const JOINTS: usize = 22;
/// Channels a frame of HumanML3D's representation (EQUATIONS section 1).
pub const FEATURES: usize = 263;

/// Global positions of the 22 joints in one frame, `[joint][x, y, z]`, metres.
pub type Pose = [[f32; 3]; JOINTS];

/// The same for those who compute in f64.
pub type WidePose = [[f64; 3]; JOINTS];

/// A motion in f64.
#[must_use]
pub fn widened(motion: &[Pose]) -> Vec<WidePose> {
    motion.iter().map(|pose| pose.map(|at| at.map(f64::from))).collect()
}

/// A motion in f32, each number to the nearest.
#[must_use]
pub fn narrowed(motion: &[WidePose]) -> Vec<Pose> {
    motion.iter().map(|pose| pose.map(|at| at.map(|value| value as f32))).collect()
}
