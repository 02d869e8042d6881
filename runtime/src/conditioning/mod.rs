//! Conditions as a planner sees them: anchors to a scaffold of frame features, its encoder, and keys and values for the planner's blocks.
//!
//! This layer knows anchors and networks, and of a planner its widths and what its blocks attend to.

pub mod anchor_kv;
pub mod scaffold;
pub mod scaffold_encoder;
