//! Body motion: the skeleton, and features to joints with the gradient back (EQUATIONS section 1).

pub mod humanml3d;
pub mod rotations;
pub mod skeleton;
