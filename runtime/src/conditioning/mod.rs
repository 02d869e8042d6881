//! Conditions as the planner sees them: anchors to a scaffold of frame features, and its encoder.
//!
//! This layer knows anchors and networks. It does not know planners.

pub mod scaffold;
pub mod scaffold_encoder;
