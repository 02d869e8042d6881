//! What a motion must meet.
//!
//! - [`anchors`]: a target at a frame.
//! - [`authoring`]: anchors written down in seconds and joint names.
//! - [`set`]: the anchors of a request, checked and sorted.

pub mod anchors;
pub mod authoring;
pub mod set;

pub use anchors::{Anchor, FAMILIES, FARTHEST, Family, MAX_ANCHORS, Target};
pub use authoring::{AnchorList, Anchors, AsAnchors};
pub use set::{AnchorError, AnchorSet, Observed};
