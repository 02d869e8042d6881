//! Body motion: the skeleton, features to joints with the gradient back (EQUATIONS section 1), and what rotations say.

pub mod humanml3d;
pub(crate) mod rotation;
pub mod rotations;
pub mod skeleton;

/// Joint positions of one frame, metres.
pub type Pose = [[f32; 3]; crate::JOINTS];
