//! What a solve did, and why it failed.

use crate::memory::ArenaTooSmall;
use core::fmt;

use super::Stop;
use super::motion_space::Edited;

/// Distance of the motion from its anchors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ControlError {
    /// Mean Euclidean distance over the anchors, metres; planar for Planar-root (EQUATIONS 9).
    pub mean: f32,
    /// Largest distance, metres.
    pub worst: f32,
    /// Anchor with the largest distance, counted in the caller's list.
    pub worst_anchor: u16,
}

/// Why a solve ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StopReason {
    /// No anchor of the result is further off than the configured error.
    Tolerance,
    /// The budget of decoder evaluations is spent.
    Budget,
    /// No step decreases the objective any more.
    Stalled,
    /// The observer asked to finish with the best so far.
    Finished,
    /// There was nothing to meet; the map was not evaluated.
    NoAnchors,
}

/// Outcome of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Report {
    /// Decoder evaluations (forward passes) started, line-search trials included; never more than the budget.
    pub evaluations: u16,
    /// Gradients (backward passes) started.
    pub gradients: u16,
    /// Control error of the motion that was given; `None` when no evaluation completed.
    pub before: Option<ControlError>,
    /// Control error of the motion that is returned; `None` when no evaluation completed.
    pub after: Option<ControlError>,
    /// `J(u0)`, square metres.
    pub objective_before: f32,
    /// `J(u)` of the result.
    pub objective_after: f32,
    /// `||u - u0||_F`, the correction's size in embedding space.
    pub distance: f32,
    /// Why the solve ended.
    pub reason: StopReason,
    /// True when the map's last forward pass was at the result, so that its positions are the result's. When false, the
    /// map must decode the result once more before anything is read from it.
    pub current: bool,
    /// What the edit in motion space did, where the request asks for it; `after` is then the edited motion's.
    pub edited: Option<Edited>,
}

impl Report {
    /// Of an edit in motion space, behind what was refined before.
    pub(crate) fn of_edit(refined: Option<Report>, edited: Edited, stop_error: f32) -> Self {
        let met = edited.after.is_none_or(|after| after.worst <= stop_error);
        let nothing = Report {
            evaluations: 0,
            gradients: 0,
            before: edited.before,
            after: None,
            objective_before: 0.0,
            objective_after: 0.0,
            distance: 0.0,
            reason: StopReason::NoAnchors,
            current: true,
            edited: None,
        };
        let reason = if met { StopReason::Tolerance } else { StopReason::Stalled };
        Report { after: edited.after, reason, edited: Some(edited), ..refined.unwrap_or(nothing) }
    }
}

/// Why a solve gave no result. The caller's `u` holds the best so far in every case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SolverError {
    /// The observer asked to abort.
    Aborted,
    /// The arena is too small: [`scratch_bytes`](super::scratch_bytes) says what is needed.
    Arena(ArenaTooSmall),
    /// `u` does not have `tokens * width` numbers.
    Shape {
        /// Numbers given.
        have: usize,
        /// Numbers expected.
        need: usize,
    },
    /// The map has no token, or so many that its frames cannot be counted in 16 bits.
    Tokens {
        /// Tokens of the map.
        tokens: usize,
        /// Most tokens allowed.
        limit: usize,
    },
    /// An anchor lies behind the last frame: the set was checked against a longer motion.
    FrameOutOfRange {
        /// Frame of the anchor.
        frame: u16,
        /// Frames of the map.
        frames: usize,
    },
    /// The objective is not finite at the starting point.
    NotFinite,
}

impl fmt::Display for SolverError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Aborted => write!(f, "the observer aborted the solve"),
            Self::Arena(ref e) => e.fmt(f),
            Self::Shape { have, need } => write!(f, "u has {have} numbers, the map takes {need}"),
            Self::Tokens { tokens, limit } => write!(f, "the map has {tokens} tokens, 1 to {limit} can be solved"),
            Self::FrameOutOfRange { frame, frames } => {
                write!(f, "an anchor stands at frame {frame}, the motion has {frames} frames")
            }
            Self::NotFinite => write!(f, "the objective is not finite at the starting point"),
        }
    }
}

impl core::error::Error for SolverError {}

/// End of the stepping loop: the reason, or an abort.
pub(crate) type Ended = Result<StopReason, SolverError>;

/// What a stop means for a solve.
pub(crate) fn stopped(stop: Stop) -> Ended {
    match stop {
        Stop::Abort => Err(SolverError::Aborted),
        Stop::Finish => Ok(StopReason::Finished),
    }
}
