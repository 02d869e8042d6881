//! Why a job failed.

use core::fmt;

use super::{Feature, ObstacleFault, PromptFault, TimelineFault, TrackFault};
use motionette::AnchorError;
use motionette::Error;
use motionette::PlanningError;
use serde::{Deserialize, Serialize};

/// [`motionette::Error`] on the wire: why a job gave no motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Failure {
    /// The device has too little memory for this request.
    Memory {
        /// Bytes the request needs.
        needed: u32,
        /// Bytes there are.
        available: u32,
    },
    /// The processor's floating point is not in its default state.
    FloatingPoint,
    /// The motion is empty or longer than the model allows.
    Tokens {
        /// Tokens of the motion.
        found: u32,
        /// Most tokens allowed.
        limit: u32,
    },
    /// The model cannot read text, or cannot plan.
    NoPlanner,
    /// The prompt was refused.
    Prompt(PromptFault),
    /// Planner steps out of range.
    Steps {
        /// Steps asked for.
        found: u16,
        /// Most there may be.
        limit: u16,
    },
    /// Guidance out of range.
    Guidance {
        /// What was asked for.
        found: f32,
    },
    /// Too many distinct anchors.
    Anchors {
        /// Anchors given.
        found: u32,
        /// Most distinct ones allowed.
        limit: u32,
    },
    /// An anchor behind the motion's end.
    AnchorFrame {
        /// Anchor at fault, from 0.
        index: u32,
        /// Its frame.
        frame: u16,
        /// Frames of the motion.
        frames: u32,
    },
    /// An anchor of a joint that does not exist.
    AnchorJoint {
        /// Anchor at fault, from 0.
        index: u32,
        /// Its joint.
        joint: u8,
    },
    /// An anchor's coordinate is not finite or too large.
    AnchorPosition {
        /// Anchor at fault, from 0.
        index: u32,
    },
    /// Two anchors contradict each other.
    AnchorConflict {
        /// The earlier one, from 0.
        first: u32,
        /// The later one.
        second: u32,
    },
    /// The work was given up: stopped, or a later request came.
    Aborted,
    /// The refinement failed.
    Solver,
    /// A failure that this version of the protocol has no word for.
    Unknown,
    /// The request needs a family that the firmware was built without: a cargo feature of the runtime.
    NotLinked {
        /// The feature.
        feature: Feature,
    },
    /// A track was refused.
    Tracks(TrackFault),
    /// An obstacle was refused.
    Obstacles(ObstacleFault),
    /// A span of the timeline was refused.
    Timeline(TimelineFault),
}

pub(super) fn number(value: usize) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Arena(e) => Failure::Memory { needed: number(e.needed), available: number(e.available) },
            Error::FloatingPoint => Failure::FloatingPoint,
            Error::Tokens { found, limit } => Failure::Tokens { found: number(found), limit: number(limit) },
            Error::Prompt(e) => Failure::Prompt(e.into()),
            Error::Planning(e) => e.into(),
            Error::Anchors(e) => e.into(),
            Error::Tracks(e) => Failure::Tracks(e.into()),
            Error::Obstacles(e) => Failure::Obstacles(e.into()),
            Error::Timeline(e) => Failure::Timeline(e.into()),
            Error::Solver(_) => Failure::Solver,
            Error::NotLinked { feature } => Failure::NotLinked { feature: Feature::new(feature) },
            Error::Aborted => Failure::Aborted,
            _ => Failure::Unknown,
        }
    }
}

impl From<PlanningError> for Failure {
    fn from(error: PlanningError) -> Self {
        match error {
            PlanningError::NoPlanner => Failure::NoPlanner,
            PlanningError::Length { found, limit } => Failure::Tokens { found: number(found), limit: number(limit) },
            PlanningError::Steps { found, limit } => Failure::Steps { found, limit },
            PlanningError::Guidance { found } => Failure::Guidance { found },
            _ => Failure::Unknown,
        }
    }
}

impl From<AnchorError> for Failure {
    fn from(error: AnchorError) -> Self {
        match error {
            AnchorError::TooMany { anchors, limit } => {
                Failure::Anchors { found: number(anchors), limit: number(limit) }
            }
            AnchorError::FrameOutOfRange { index, frame, frames } => {
                Failure::AnchorFrame { index: number(index), frame, frames: number(frames) }
            }
            AnchorError::JointOutOfRange { index, joint, .. } => Failure::AnchorJoint { index: number(index), joint },
            AnchorError::NotFinite { index } | AnchorError::TooFar { index, .. } => {
                Failure::AnchorPosition { index: number(index) }
            }
            AnchorError::Conflict { first, second } => {
                Failure::AnchorConflict { first: number(first), second: number(second) }
            }
            // Times are not sent.
            AnchorError::Time { .. } => Failure::Unknown,
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Failure::Memory { needed, available } => {
                write!(f, "the request needs {needed} bytes of memory, the device has {available}")
            }
            Failure::FloatingPoint => write!(f, "the device's floating point is not in its default state"),
            Failure::Tokens { found, limit } => write!(f, "the motion has {found} tokens, allowed are 1 to {limit}"),
            Failure::NoPlanner => write!(f, "the device's model cannot make motion from text"),
            Failure::Prompt(fault) => fault.fmt(f),
            Failure::Steps { found, limit } => write!(f, "{found} planner steps, allowed are 1 to {limit}"),
            // Numbers in floating point cost kilobytes of flash to print; this text is on the host's side as well.
            Failure::Guidance { .. } => write!(f, "guidance must be a number from 0 to 100"),
            Failure::Anchors { found, limit } => write!(f, "{found} anchors, at most {limit} distinct ones are taken"),
            Failure::AnchorFrame { index, frame, frames } => {
                write!(f, "anchor {index}: frame {frame} is outside the motion of {frames} frames")
            }
            Failure::AnchorJoint { index, joint } => write!(f, "anchor {index}: there is no joint {joint}"),
            Failure::AnchorPosition { index } => {
                write!(f, "anchor {index}: a coordinate is not finite or beyond 1000 m")
            }
            Failure::AnchorConflict { first, second } => {
                write!(f, "anchors {first} and {second} want one joint in two places at one frame")
            }
            Failure::Aborted => write!(f, "the work was given up"),
            Failure::Solver => write!(f, "the refinement failed"),
            Failure::NotLinked { feature } => {
                write!(
                    f,
                    "the request needs cargo feature {feature} of the runtime, which the firmware was built without"
                )
            }
            Failure::Tracks(fault) => fault.fmt(f),
            Failure::Obstacles(fault) => fault.fmt(f),
            Failure::Timeline(fault) => fault.fmt(f),
            Failure::Unknown => write!(f, "the runtime failed for a reason this protocol has no word for"),
        }
    }
}

impl core::error::Error for Failure {}
