//! Motion out, in the formats other programs read.
//!
//! | module | format |
//! |---|---|
//! | [`bvh`] | Biovision hierarchy, text: Blender, MotionBuilder, Unity and most other animation programs |

mod best_fit;
pub mod bvh;
mod euler;

pub use bvh::write_bvh;
