//! What the user asks for, checked: anchors in metres and frames.
//!
//! This layer knows frames and joints. It does not know tokens, decoders or the solver.

pub mod anchors;
