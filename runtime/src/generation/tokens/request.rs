//! What is asked of the planner, and why it is refused.

use super::length::Length;
use super::sampling::{Sampling, SamplingError};
use super::schedule::Schedule;

/// Most steps of a sampler.
pub const MAX_STEPS: u16 = 1000;
/// Largest guidance.
pub const MAX_GUIDANCE: f32 = 100.0;

/// A token that is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fixed {
    /// Where it stands.
    pub position: u16,
    /// The token.
    pub token: u16,
}

/// How tokens are planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Planning<'r> {
    /// How long the motion becomes.
    pub length: Length,
    /// Seed of all draws.
    pub seed: u64,
    /// Steps of the sampler, 1 to [`MAX_STEPS`]; a step costs a pass of the planner, with guidance two.
    pub steps: u16,
    /// Times of the steps.
    pub schedule: Schedule,
    /// `none + guidance (conditioned - none)`, conditioned by text and anchors, 0 to [`MAX_GUIDANCE`]; 1 is off.
    pub guidance: f32,
    /// How proposals are drawn.
    pub sampling: Sampling,
    /// Tokens that are given: the beginning of a motion to continue, both ends of a gap to fill.
    pub fixed: &'r [Fixed],
    /// The motion begins in the middle of another.
    pub start_open: bool,
    /// The motion goes on behind its end.
    pub end_open: bool,
    /// Whether the request's anchors condition the planner, where the blob has anchor control; otherwise they only refine.
    pub conditioned: bool,
}

impl Default for Planning<'_> {
    /// Five uniform steps, guidance 2, sampled proposals, predicted length, seed 0, a whole motion, conditioned by anchors.
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Why a plan was refused.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PlanningError {
    /// The model has no planner, or knows no text: it cannot make tokens.
    NoPlanner,
    /// The planner ended the motion before its first token.
    Nothing,
    /// The motion is to be empty, or longer than the model allows.
    Length {
        /// Tokens asked for.
        found: usize,
        /// Most the model allows.
        limit: usize,
    },
    /// Steps are 0 or above the limit.
    Steps {
        /// Steps asked for.
        found: u16,
        /// Most there may be.
        limit: u16,
    },
    /// Guidance is not a number from 0 to [`MAX_GUIDANCE`].
    Guidance {
        /// What was asked for.
        found: f32,
    },
    /// A sampling option is out of its range.
    Sampling(SamplingError),
    /// More fixed tokens than the longest motion has.
    TooManyFixed {
        /// How many.
        found: usize,
        /// Most the model allows.
        limit: usize,
    },
    /// A fixed token stands behind the motion's end.
    FixedPosition {
        /// Place in the list.
        index: usize,
        /// Its position.
        position: u16,
        /// Tokens of the motion.
        tokens: usize,
    },
    /// A fixed token that the codebook does not have.
    FixedToken {
        /// Place in the list.
        index: usize,
        /// The token.
        token: u16,
        /// Codes there are.
        codes: usize,
    },
    /// Two fixed tokens at one position differ.
    FixedConflict {
        /// Place of the first in the list.
        first: usize,
        /// Place of the second.
        second: usize,
    },
}

impl core::fmt::Display for PlanningError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            PlanningError::NoPlanner => write!(f, "the model has no planner: it cannot make tokens from text"),
            // Nobody makes it: nothing is said of it.
            PlanningError::Nothing if !cfg!(feature = "autoregressive") => Ok(()),
            PlanningError::Nothing => {
                write!(f, "the planner ended the motion before its first token: give its length, or another seed")
            }
            PlanningError::Length { found, limit } => {
                write!(f, "the motion is to have {found} tokens, allowed are 1 to {limit}")
            }
            PlanningError::Steps { found, limit } => {
                write!(f, "the sampler is to take {found} steps, allowed are 1 to {limit}")
            }
            PlanningError::Guidance { .. } => write!(f, "guidance must be a number from 0 to 100"),
            PlanningError::Sampling(e) => e.fmt(f),
            PlanningError::TooManyFixed { found, limit } => {
                write!(f, "{found} tokens are fixed, the longest motion has {limit}")
            }
            PlanningError::FixedPosition { index, position, tokens } => {
                write!(f, "fixed token {index} stands at position {position} of a motion of {tokens} tokens")
            }
            PlanningError::FixedToken { index, token, codes } => {
                write!(f, "fixed token {index} is {token}: the codebook has codes 0 to {}", codes.saturating_sub(1))
            }
            PlanningError::FixedConflict { first, second } => {
                write!(f, "fixed tokens {first} and {second} differ at one position")
            }
        }
    }
}

impl core::error::Error for PlanningError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            PlanningError::Sampling(e) => Some(e),
            _ => None,
        }
    }
}

impl Planning<'_> {
    /// What [`Planning::default`] gives.
    pub const DEFAULT: Self = Planning {
        length: Length::Predicted,
        seed: 0,
        steps: 5,
        schedule: Schedule::Uniform,
        guidance: 2.0,
        sampling: Sampling::Sample { temperature: 1.0, top_k: 0, top_p: 1.0 },
        fixed: &[],
        start_open: false,
        end_open: false,
        conditioned: true,
    };

    /// Whether the planner runs with and without text and anchors.
    #[must_use]
    pub fn guided(&self) -> bool {
        self.guidance != 1.0
    }

    /// The given token at a position.
    #[must_use]
    pub fn fixed_at(&self, position: usize) -> Option<u16> {
        self.fixed.iter().find(|f| usize::from(f.position) == position).map(|f| f.token)
    }

    /// Checks everything against a model's limits. The motion's tokens come back, the most there may be when the length
    /// is predicted.
    ///
    /// # Errors
    /// [`PlanningError`].
    pub fn check(&self, limit: usize, codes: usize, frames_per_token: usize) -> Result<usize, PlanningError> {
        let tokens = match self.length {
            Length::Predicted => limit,
            Length::Tokens(tokens) => usize::from(tokens),
            Length::Frames(frames) => usize::from(frames).div_ceil(frames_per_token.max(1)),
        };
        if tokens == 0 || tokens > limit {
            return Err(PlanningError::Length { found: tokens, limit });
        }
        if self.steps == 0 || self.steps > MAX_STEPS {
            return Err(PlanningError::Steps { found: self.steps, limit: MAX_STEPS });
        }
        if !(self.guidance >= 0.0 && self.guidance <= MAX_GUIDANCE) {
            return Err(PlanningError::Guidance { found: self.guidance });
        }
        self.sampling.check().map_err(PlanningError::Sampling)?;
        if self.fixed.len() > limit {
            return Err(PlanningError::TooManyFixed { found: self.fixed.len(), limit });
        }
        for (index, &Fixed { position, token }) in self.fixed.iter().enumerate() {
            if usize::from(position) >= tokens {
                return Err(PlanningError::FixedPosition { index, position, tokens });
            }
            if usize::from(token) >= codes {
                return Err(PlanningError::FixedToken { index, token, codes });
            }
            let earlier = self.fixed.iter().take(index);
            let differs = |f: &Fixed| f.position == position && f.token != token;
            if let Some(first) = earlier.enumerate().find(|(_, f)| differs(f)).map(|(first, _)| first) {
                return Err(PlanningError::FixedConflict { first, second: index });
            }
        }
        Ok(tokens)
    }

    /// The least length that fixed tokens allow, tokens.
    #[must_use]
    pub fn shortest(&self) -> usize {
        let mut shortest = 1;
        for f in self.fixed {
            let end = usize::from(f.position) + 1;
            if end > shortest {
                shortest = end;
            }
        }
        shortest
    }
}
