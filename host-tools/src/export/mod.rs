//! Motion out, in the formats other programs read.
//!
//! | module | format |
//! |---|---|
//! | [`bvh`] | Biovision hierarchy, text: Blender, MotionBuilder, Unity and most other animation programs |
//! | [`glb`] | binary glTF: web viewers, game engines, Blender |
//! | [`servo`] | servo timelines: CSV, ROS `JointTrajectory` as JSON, a Rust array |

mod best_fit;
pub mod bvh;
mod euler;
pub mod glb;
mod rig;
pub mod servo;

pub use bvh::write_bvh;
pub use glb::write_glb;
