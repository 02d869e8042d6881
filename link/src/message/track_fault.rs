//! Why tracks are refused, on the wire.

use core::fmt;

use motionette::TrackError;
use serde::{Deserialize, Serialize};

use super::failure::number;

/// [`motionette::TrackError`] on the wire: why tracks were refused. Indices count in the request's list, from 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum TrackFault {
    /// More tracks than a request may carry.
    TooMany {
        /// Tracks given.
        tracks: u32,
        /// Most tracks allowed.
        limit: u32,
    },
    /// Nothing of it counts: no positions, a mask without any, or no axis.
    Nothing {
        /// Track at fault.
        index: u32,
    },
    /// The mask has another length than the positions.
    Mask {
        /// Track at fault.
        index: u32,
        /// Length of its mask.
        found: u32,
        /// Its positions.
        positions: u32,
    },
    /// There is no such joint.
    JointOutOfRange {
        /// Track at fault.
        index: u32,
        /// Its joint.
        joint: u8,
        /// Joints of the skeleton.
        joints: u32,
    },
    /// A position lies behind the end of the motion.
    FrameOutOfRange {
        /// Track at fault.
        index: u32,
        /// Frame of its last position.
        frame: u32,
        /// Frames of the motion.
        frames: u32,
    },
    /// A coordinate is not finite or too large.
    Position {
        /// Track at fault.
        index: u32,
        /// Frame of the position.
        frame: u32,
        /// Largest magnitude allowed, metres.
        limit: f32,
    },
    /// A tolerance that is negative, not a number or more than a metre.
    Tolerance {
        /// Track at fault.
        index: u32,
        /// Its tolerance, metres.
        tolerance: f32,
    },
    /// Two tracks want one joint in two places at one frame.
    Conflict {
        /// The earlier track of the two.
        first: u32,
        /// The later one.
        second: u32,
        /// The first frame at which they do.
        frame: u32,
    },
    /// A track and an anchor want one joint in two places at one frame.
    AnchorConflict {
        /// The track.
        track: u32,
        /// The anchor.
        anchor: u32,
        /// Their frame.
        frame: u32,
    },
    /// The request's refinement leaves the edit out that meets tracks and obstacles.
    NotExact,
}

impl From<TrackError> for TrackFault {
    fn from(error: TrackError) -> Self {
        match error {
            TrackError::TooMany { tracks, limit } => {
                TrackFault::TooMany { tracks: number(tracks), limit: number(limit) }
            }
            TrackError::Nothing { index } => TrackFault::Nothing { index: number(index) },
            TrackError::Mask { index, found, positions } => {
                TrackFault::Mask { index: number(index), found: number(found), positions: number(positions) }
            }
            TrackError::JointOutOfRange { index, joint, joints } => {
                TrackFault::JointOutOfRange { index: number(index), joint, joints: number(joints) }
            }
            TrackError::FrameOutOfRange { index, frame, frames } => {
                TrackFault::FrameOutOfRange { index: number(index), frame: number(frame), frames: number(frames) }
            }
            TrackError::Position { index, frame, limit } => {
                TrackFault::Position { index: number(index), frame: number(frame), limit }
            }
            TrackError::Tolerance { index, tolerance } => TrackFault::Tolerance { index: number(index), tolerance },
            TrackError::Conflict { first, second, frame } => {
                TrackFault::Conflict { first: number(first), second: number(second), frame: number(frame) }
            }
            TrackError::AnchorConflict { track, anchor, frame } => {
                TrackFault::AnchorConflict { track: number(track), anchor: number(anchor), frame: number(frame) }
            }
            TrackError::NotExact => TrackFault::NotExact,
        }
    }
}

impl From<TrackFault> for TrackError {
    fn from(fault: TrackFault) -> Self {
        match fault {
            TrackFault::TooMany { tracks, limit } => {
                TrackError::TooMany { tracks: tracks as usize, limit: limit as usize }
            }
            TrackFault::Nothing { index } => TrackError::Nothing { index: index as usize },
            TrackFault::Mask { index, found, positions } => {
                TrackError::Mask { index: index as usize, found: found as usize, positions: positions as usize }
            }
            TrackFault::JointOutOfRange { index, joint, joints } => {
                TrackError::JointOutOfRange { index: index as usize, joint, joints: joints as usize }
            }
            TrackFault::FrameOutOfRange { index, frame, frames } => {
                TrackError::FrameOutOfRange { index: index as usize, frame: frame as usize, frames: frames as usize }
            }
            TrackFault::Position { index, frame, limit } => {
                TrackError::Position { index: index as usize, frame: frame as usize, limit }
            }
            TrackFault::Tolerance { index, tolerance } => TrackError::Tolerance { index: index as usize, tolerance },
            TrackFault::Conflict { first, second, frame } => {
                TrackError::Conflict { first: first as usize, second: second as usize, frame: frame as usize }
            }
            TrackFault::AnchorConflict { track, anchor, frame } => {
                TrackError::AnchorConflict { track: track as usize, anchor: anchor as usize, frame: frame as usize }
            }
            TrackFault::NotExact => TrackError::NotExact,
        }
    }
}

impl fmt::Display for TrackFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // In the runtime's words; they are printed on the host's side.
        TrackError::from(*self).fmt(f)
    }
}

impl core::error::Error for TrackFault {}
