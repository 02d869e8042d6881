//! The timeline of a request, checked: what its spans need, and how they are planned. [`super::spans`] makes them.

use super::error::Error;
use crate::generation::tokens::{Length, Planning, PlanningError, PlanningLimits, SEED_STEP};
use crate::memory::{Arena, ArenaTooSmall};
use crate::model::Model;
use crate::pipeline::plan::{Limits, TimelineLimits};
use crate::refining::Config;
use crate::representation::posture;
use crate::request::Request;
use crate::request::timeline::{self, Span, TimelineError};

/// Checks the spans of a request whose motion has at most `tokens` tokens.
#[inline(never)]
pub(super) fn check(model: &Model<'_>, request: &Request<'_>, tokens: usize) -> Result<Option<TimelineLimits>, Error> {
    if request.timeline.is_empty() {
        return Ok(None);
    }
    if !cfg!(feature = "timeline") {
        return Err(Error::NotLinked { feature: "timeline" });
    }
    timeline::check(request.timeline, tokens * model.frames_per_token()).map_err(Error::Timeline)?;
    let modules = model.planning().ok_or(PlanningError::NoPlanner)?;
    let plan = &request.planning;
    let mut limits = TimelineLimits { steps: plan.steps, guided: plan.guided(), ..TimelineLimits::NONE };
    for (index, span) in (0u8..).zip(request.timeline) {
        let own = planned(request, index, span);
        let words = modules.text.rows(&span.prompt);
        let words = words.map_err(|error| Error::Timeline(TimelineError::Prompt { index, error }))?;
        let tokens = own.check(model.max_tokens(), modules.planner.codes(), model.frames_per_token())?;
        limits.spans += 1;
        limits.directions += directions_of(span) as u32;
        limits.tokens = limits.tokens.max(tokens as u16);
        limits.words = limits.words.max(words as u16);
    }
    Ok(Some(limits))
}

/// How a span is planned.
pub(super) fn planned<'r>(request: &Request<'r>, index: u8, span: &Span<'_>) -> Planning<'r> {
    Planning {
        length: Length::Frames(span.frames),
        seed: request.planning.seed.wrapping_add((u64::from(index) + 1).wrapping_mul(SEED_STEP)),
        fixed: &[],
        start_open: false,
        end_open: false,
        conditioned: false,
        ..request.planning
    }
}

impl TimelineLimits {
    /// Of the motion of a span.
    pub(super) fn of_span(&self, rows: usize) -> Limits {
        let (tokens, words) = (usize::from(self.tokens), usize::from(self.words));
        let (steps, guided) = (self.steps, self.guided);
        let planning = Some(PlanningLimits { words, steps, guided, anchors: false, clauses: 1 });
        Limits { tokens, anchors: 0, tracked: 0, timeline: None, refinement: Config::NONE, planning, rows }
    }
}

/// Where directions of all spans lie, three numbers each.
pub(super) fn directions<'a>(limits: &Limits, arena: &mut Arena<'a>) -> Result<&'a mut [i16], ArenaTooSmall> {
    arena.take(limits.timeline.map_or(0, |timeline| 3 * timeline.directions as usize))
}

/// Directions that are kept of a span.
pub(super) fn directions_of(span: &Span<'_>) -> usize {
    usize::from(span.frames) * posture::count(span.parts)
}
