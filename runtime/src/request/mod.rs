//! What a user asks for: prompts, joints by name, and the conditions that a motion must meet, checked.
//!
//! This layer knows frames, joints and words, and neither decoders nor what is made of its conditions.

pub mod conditions;
pub mod joint;
pub mod prompt;
