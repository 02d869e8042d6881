//! What a user asks for: joints by name, and the conditions that a motion must meet, checked.
//!
//! This layer knows frames and joints, and neither models nor what is made of its conditions.

pub mod conditions;
pub mod joint;
