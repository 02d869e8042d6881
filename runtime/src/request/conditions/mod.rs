//! What a motion must meet.
//!
//! - [`anchors`]: a target at a frame.
//! - [`authoring`]: anchors written down in seconds and joint names.
//! - [`set`]: the anchors of a request, checked and sorted.
//! - [`track`]: where a joint is to be at many frames.
//! - [`obstacle`]: bodies that the figure keeps clear of.

pub mod anchors;
pub mod authoring;
pub mod obstacle;
pub mod set;
pub mod track;

pub use anchors::{Anchor, FAMILIES, FARTHEST, Family, MAX_ANCHORS, Target};
pub use authoring::{AnchorList, Anchors, AsAnchors};
pub use obstacle::{ALL_JOINTS, Course, FASTEST_OBSTACLE, Keyframe, MAX_OBSTACLES, Obstacle, ObstacleError, Shape};
pub use set::{AnchorError, AnchorSet, Observed};
pub use track::{MAX_TRACKS, Track, TrackError};
