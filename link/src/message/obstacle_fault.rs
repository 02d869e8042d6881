//! Why obstacles are refused, on the wire.

use core::fmt;

use motionette::ObstacleError;
use serde::{Deserialize, Serialize};

use super::failure::number;

/// [`motionette::ObstacleError`] on the wire: why obstacles were refused. Indices count in the request's list, from 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum ObstacleFault {
    /// More obstacles than a request may have.
    TooMany {
        /// Obstacles given.
        obstacles: u32,
        /// Most obstacles allowed.
        limit: u32,
    },
    /// A size that is not above 0 and at most 100 m, or a plane without a direction.
    Size {
        /// Obstacle at fault.
        index: u32,
    },
    /// A margin that is not between 0 and 1 m.
    Margin {
        /// Obstacle at fault.
        index: u32,
        /// Its margin, metres.
        margin: f32,
    },
    /// A place or velocity that is not finite or too large.
    Place {
        /// Obstacle at fault.
        index: u32,
    },
    /// It moves too fast.
    TooFast {
        /// Obstacle at fault.
        index: u32,
        /// Its speed, metres a second.
        speed: f32,
        /// Most of it.
        limit: f32,
    },
    /// No keyframes, or one that does not come after the one before it.
    Keyframes {
        /// Obstacle at fault.
        index: u32,
        /// The keyframe.
        keyframe: u32,
    },
    /// No joint keeps clear of it, or one that there is not.
    Joints {
        /// Obstacle at fault.
        index: u32,
    },
    /// An anchor lies inside it.
    AnchorInside {
        /// Obstacle at fault.
        index: u32,
        /// The anchor.
        anchor: u32,
    },
    /// A track passes through it.
    TrackInside {
        /// Obstacle at fault.
        index: u32,
        /// The track.
        track: u32,
        /// The first frame at which it is inside.
        frame: u32,
    },
}

impl From<ObstacleError> for ObstacleFault {
    fn from(error: ObstacleError) -> Self {
        match error {
            ObstacleError::TooMany { obstacles, limit } => {
                ObstacleFault::TooMany { obstacles: number(obstacles), limit: number(limit) }
            }
            ObstacleError::Size { index } => ObstacleFault::Size { index: number(index) },
            ObstacleError::Margin { index, margin } => ObstacleFault::Margin { index: number(index), margin },
            ObstacleError::Place { index } => ObstacleFault::Place { index: number(index) },
            ObstacleError::TooFast { index, speed, limit } => {
                ObstacleFault::TooFast { index: number(index), speed, limit }
            }
            ObstacleError::Keyframes { index, keyframe } => {
                ObstacleFault::Keyframes { index: number(index), keyframe: number(keyframe) }
            }
            ObstacleError::Joints { index } => ObstacleFault::Joints { index: number(index) },
            ObstacleError::AnchorInside { index, anchor } => {
                ObstacleFault::AnchorInside { index: number(index), anchor: number(anchor) }
            }
            ObstacleError::TrackInside { index, track, frame } => {
                ObstacleFault::TrackInside { index: number(index), track: number(track), frame: number(frame) }
            }
        }
    }
}

impl From<ObstacleFault> for ObstacleError {
    fn from(fault: ObstacleFault) -> Self {
        match fault {
            ObstacleFault::TooMany { obstacles, limit } => {
                ObstacleError::TooMany { obstacles: obstacles as usize, limit: limit as usize }
            }
            ObstacleFault::Size { index } => ObstacleError::Size { index: index as usize },
            ObstacleFault::Margin { index, margin } => ObstacleError::Margin { index: index as usize, margin },
            ObstacleFault::Place { index } => ObstacleError::Place { index: index as usize },
            ObstacleFault::TooFast { index, speed, limit } => {
                ObstacleError::TooFast { index: index as usize, speed, limit }
            }
            ObstacleFault::Keyframes { index, keyframe } => {
                ObstacleError::Keyframes { index: index as usize, keyframe: keyframe as usize }
            }
            ObstacleFault::Joints { index } => ObstacleError::Joints { index: index as usize },
            ObstacleFault::AnchorInside { index, anchor } => {
                ObstacleError::AnchorInside { index: index as usize, anchor: anchor as usize }
            }
            ObstacleFault::TrackInside { index, track, frame } => {
                ObstacleError::TrackInside { index: index as usize, track: track as usize, frame: frame as usize }
            }
        }
    }
}

impl fmt::Display for ObstacleFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // In the runtime's words; they are printed on the host's side.
        ObstacleError::from(*self).fmt(f)
    }
}

impl core::error::Error for ObstacleFault {}
