//! Motion out, in the formats other programs read.
//!
//! | module | format |
//! |---|---|
//! | [`bvh`] | Biovision hierarchy, text: Blender, MotionBuilder, Unity and most other animation programs |
//! | [`glb`] | binary glTF: web viewers, game engines, Blender |
//! | [`servo`] | servo timelines: CSV, ROS `JointTrajectory` as JSON, a Rust array |
//!
//! Positions do not determine rotations; those of animations are chosen so that a T-pose with the motion's own mean bone lengths moves
//! like a body: a joint with one child turns by the smallest rotation, relative to its parent, that points the bone at the child; a joint
//! with several (pelvis, upper spine) by the rotation that fits all its children best; a joint without children not at all.

mod best_fit;
pub mod bvh;
mod euler;
pub mod glb;
mod rig;
pub mod servo;

pub use bvh::write_bvh;
pub use glb::write_glb;
