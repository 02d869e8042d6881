//! Why an operation fails, an error each: a request ([`Error`]), a stream ([`StreamError`]); plans have [`PlanError`].

use crate::codec::codebook::TokenOutOfRange;
use crate::generation::tokens::PlanningError;
use crate::memory::ArenaTooSmall;
use crate::pipeline::plan::PlanError;
use crate::refining::SolverError;
use crate::request::conditions::{AnchorError, ObstacleError, TrackError};
use crate::request::prompt::PromptError;
use crate::request::timeline::TimelineError;

/// Why a request gave no motion. The generator is usable afterwards.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Error {
    /// The arena is too small for this request; [`Plan::for_request`](crate::Plan::for_request) says beforehand what is needed.
    Arena(ArenaTooSmall),
    /// The processor's floating-point environment would give other bits: rounding to nearest even, subnormal numbers
    /// and NaN payloads must be on (on Cortex-M: FPSCR's RMode, FZ and DN bits zero).
    FloatingPoint,
    /// A motion needs at least one token and at most `limit`.
    Tokens {
        /// Tokens (or numbers of the embeddings, when they are no whole tokens) in the request.
        found: usize,
        /// Most tokens the model allows.
        limit: usize,
    },
    /// A token that no codebook has.
    TokenOutOfRange {
        /// Position in the request's tokens.
        index: usize,
        /// The token.
        token: u16,
        /// Codes there are.
        codes: u16,
    },
    /// An embedding is not finite or further from zero than the model guarantees to handle.
    Embedding {
        /// Position in `u`.
        index: usize,
    },
    /// The prompt was refused.
    Prompt(PromptError),
    /// The plan was refused.
    Planning(PlanningError),
    /// An anchor was refused.
    Anchors(AnchorError),
    /// A track was refused.
    Tracks(TrackError),
    /// An obstacle was refused.
    Obstacles(ObstacleError),
    /// A span of the timeline was refused.
    Timeline(TimelineError),
    /// A bone of the request's skeleton is not between 1 mm and 3 m long.
    Bone {
        /// The joint at its end.
        joint: u8,
    },
    /// The refinement failed.
    Solver(SolverError),
    /// The request needs a family that was left out of this firmware: build it with the cargo feature.
    NotLinked {
        /// The feature of this crate.
        feature: &'static str,
    },
    /// The observer asked to abort.
    Aborted,
}

impl core::fmt::Display for Error {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Error::Arena(e) => e.fmt(f),
            Error::FloatingPoint => write!(
                f,
                "floating point is not in its default state: clear flush-to-zero, default-NaN and rounding mode bits"
            ),
            Error::Tokens { found, limit } => {
                write!(
                    f,
                    "the request has {found} tokens (or numbers that are no whole tokens), allowed are 1 to {limit}"
                )
            }
            Error::TokenOutOfRange { index, token, codes } => {
                write!(f, "token {token} at position {index}: the codebook has codes 0 to {}", codes.saturating_sub(1))
            }
            Error::Embedding { index } => write!(f, "number {index} of the embeddings is not finite or too large"),
            Error::Prompt(e) => e.fmt(f),
            Error::Planning(e) => e.fmt(f),
            Error::Anchors(e) => e.fmt(f),
            Error::Tracks(e) => e.fmt(f),
            Error::Obstacles(e) => e.fmt(f),
            Error::Timeline(e) => e.fmt(f),
            Error::Bone { joint } => {
                write!(f, "the bone to joint {joint} of the request's skeleton is not between 0.001 and 3 m long")
            }
            Error::Solver(e) => e.fmt(f),
            Error::NotLinked { feature } => PlanError::NotLinked { feature }.fmt(f),
            Error::Aborted => write!(f, "the observer aborted the request"),
        }
    }
}

impl core::error::Error for Error {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Error::Arena(e) => Some(e),
            Error::Prompt(e) => Some(e),
            Error::Planning(e) => Some(e),
            Error::Anchors(e) => Some(e),
            Error::Tracks(e) => Some(e),
            Error::Obstacles(e) => Some(e),
            Error::Timeline(e) => Some(e),
            Error::Solver(e) => Some(e),
            _ => None,
        }
    }
}

impl From<ArenaTooSmall> for Error {
    fn from(e: ArenaTooSmall) -> Self {
        Error::Arena(e)
    }
}

impl From<PlanError> for Error {
    fn from(e: PlanError) -> Self {
        match e {
            PlanError::Tokens { found, limit } => Error::Tokens { found, limit },
            PlanError::Anchors { found, limit } => Error::Anchors(AnchorError::TooMany { anchors: found, limit }),
            PlanError::Tracked { found, limit } => Error::Tracks(TrackError::TooMany { tracks: found, limit }),
            PlanError::Words { found: 0, .. } => Error::Prompt(PromptError::Empty),
            PlanError::Words { found, limit } => Error::Prompt(PromptError::TooManyWords { found, limit }),
            PlanError::Steps { found, limit } => Error::Planning(PlanningError::Steps { found, limit }),
            PlanError::NotLinked { feature } => Error::NotLinked { feature },
            PlanError::NoPlanner => Error::Planning(PlanningError::NoPlanner),
            PlanError::TooLarge => Error::Arena(ArenaTooSmall { needed: usize::MAX, available: 0 }),
        }
    }
}

impl From<AnchorError> for Error {
    fn from(e: AnchorError) -> Self {
        Error::Anchors(e)
    }
}

impl From<TrackError> for Error {
    fn from(e: TrackError) -> Self {
        Error::Tracks(e)
    }
}

impl From<ObstacleError> for Error {
    fn from(e: ObstacleError) -> Self {
        Error::Obstacles(e)
    }
}

impl From<PromptError> for Error {
    fn from(e: PromptError) -> Self {
        Error::Prompt(e)
    }
}

impl From<PlanningError> for Error {
    fn from(e: PlanningError) -> Self {
        Error::Planning(e)
    }
}

impl From<TokenOutOfRange> for Error {
    fn from(e: TokenOutOfRange) -> Self {
        Error::TokenOutOfRange { index: e.index, token: e.token, codes: e.codes }
    }
}

/// Why a stream did not go on. It is usable afterwards, and what it made so far stays what it was.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StreamError {
    /// What a request for a whole motion fails for as well.
    Request(Error),
    /// More tokens than can be queued at present.
    QueueFull {
        /// Tokens that were to be queued.
        found: usize,
        /// Tokens there is room for.
        room: usize,
    },
    /// The motion has been finished: no more tokens.
    Finished,
    /// A stream takes text and tokens, without anchors, tracks, obstacles and timelines.
    NotInParts,
}

impl core::fmt::Display for StreamError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            StreamError::Request(e) => e.fmt(f),
            StreamError::QueueFull { found, room } => {
                write!(f, "{found} tokens do not fit the stream's queue, which has room for {room}: take frames first")
            }
            StreamError::Finished => write!(f, "the stream's motion has been finished"),
            StreamError::NotInParts => {
                write!(f, "a stream takes text and tokens, neither embeddings nor anchors, tracks and obstacles")
            }
        }
    }
}

impl core::error::Error for StreamError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            StreamError::Request(e) => e.source(),
            _ => None,
        }
    }
}

impl From<Error> for StreamError {
    fn from(e: Error) -> Self {
        StreamError::Request(e)
    }
}

impl From<PlanError> for StreamError {
    fn from(e: PlanError) -> Self {
        StreamError::Request(e.into())
    }
}

impl From<PromptError> for StreamError {
    fn from(e: PromptError) -> Self {
        StreamError::Request(e.into())
    }
}

impl From<PlanningError> for StreamError {
    fn from(e: PlanningError) -> Self {
        StreamError::Request(e.into())
    }
}

impl From<TokenOutOfRange> for StreamError {
    fn from(e: TokenOutOfRange) -> Self {
        StreamError::Request(e.into())
    }
}
