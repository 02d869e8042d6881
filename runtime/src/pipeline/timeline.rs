//! The timeline of a request: each span is planned and decoded as a motion of its own, of which is kept how it holds the span's parts; the
//! request's motion then holds them so.
//!
//! Spans come before the motion itself and leave behind nothing but directions of bones, so that there is one motion in memory at a time.

use super::buffers::{self, Decoding};
use super::error::Error;
use super::observer::{Observer, Stage, Watch};
use super::plan_tokens::{Planned, PlanningTask, plan_tokens};
use super::{bones, decode};
use crate::JOINTS;
use crate::generation::tokens::{Length, Planning, PlanningError, PlanningLimits, SEED_STEP};
use crate::memory::{Arena, ArenaTooSmall};
use crate::model::Model;
use crate::pipeline::plan::{Limits, TimelineLimits};
use crate::refining::Config;
use crate::representation::{Pose, posture};
use crate::request::prompt::PromptStats;
use crate::request::timeline::{self, MAX_SPANS, Span, TimelineError};
use crate::request::{Bones, Request};

/// Of a span that begins or ends within the motion, so many frames lead over; a quarter of a short span.
const LEAD: u16 = 10;

/// What was understood of each span's prompt.
#[cfg(feature = "timeline")]
pub(super) type Heard = [PromptStats; MAX_SPANS];

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
fn planned<'r>(request: &Request<'r>, index: u8, span: &Span<'_>) -> Planning<'r> {
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

/// Makes the motion of each span and keeps how it holds the span's parts, in `directions`; what was understood of the spans comes back, `peak` becomes the bytes
/// used at most.
#[cfg(feature = "timeline")]
#[inline(never)]
pub(super) fn read(
    model: &Model<'_>,
    (request, limits): (&Request<'_>, &Limits),
    directions: &mut [i16],
    (arena, peak): (&mut Arena<'_>, &mut usize),
    observer: &mut dyn Observer,
) -> Result<Heard, Error> {
    let mut heard = Heard::default();
    let Some(timeline) = &limits.timeline else { return Ok(heard) };
    let mut rest = directions;
    for (index, span) in (0u8..).zip(request.timeline) {
        let (own, others) = rest.split_at_mut_checked(3 * directions_of(span)).unwrap_or_default();
        rest = others;
        let mut overlay = arena.overlay();
        let of_span = timeline.of_span(limits.rows);
        let read = read_span(model, (request, &of_span), (index, span), own, &mut overlay, observer);
        let (said, used) = read.map_err(|error| match error {
            // That no word is known shows when they are read.
            Error::Prompt(error) => Error::Timeline(TimelineError::Prompt { index, error }),
            other => other,
        })?;
        *peak = if *peak > used { *peak } else { used };
        if let Some(heard) = heard.get_mut(usize::from(index)) {
            *heard = said;
        }
    }
    Ok(heard)
}

/// Directions that are kept of a span.
fn directions_of(span: &Span<'_>) -> usize {
    usize::from(span.frames) * posture::count(span.parts)
}

#[cfg(feature = "timeline")]
fn read_span(
    model: &Model<'_>,
    (request, limits): (&Request<'_>, &Limits),
    (index, span): (u8, &Span<'_>),
    directions: &mut [i16],
    arena: &mut Arena<'_>,
    observer: &mut dyn Observer,
) -> Result<(PromptStats, usize), Error> {
    let (Some(modules), Some(planning)) = (model.planning(), &limits.planning) else {
        return Err(Error::Planning(PlanningError::NoPlanner));
    };
    let own = planned(request, index, span);
    let tokens = buffers::tokens(model, limits, arena).map_err(Error::Arena)?;
    let each = model.frames_per_token();
    let window = usize::from(span.frames).div_ceil(each.max(1));
    let tokens = part_mut!(tokens, ..window * model.codebooks().quantizers());
    let task = PlanningTask {
        limits: planning,
        rows: limits.rows,
        prompt: &span.prompt,
        planning: &own,
        shortest: 1,
        capacity: limits.tokens,
        context: 0,
        clause: (0, 1),
        anchors: None,
    };
    let mut overlay = arena.overlay();
    let Planned { tokens: made, heard, .. } = plan_tokens(modules, task, &mut overlay, tokens, observer)?;
    let planned = overlay.used();
    let mut decoding = Decoding::take(model, limits, arena).map_err(Error::Arena)?;
    let u = part_mut!(decoding.u, ..made * model.decoder().code_width());
    model.codebooks().embed(part!(tokens, ..made * model.codebooks().quantizers()), u)?;
    let mut watch = Watch { observer, stage: Stage::Decoding, evaluation: 1, evaluations: 1 };
    let buffers = (&*u, &mut *decoding.features, &mut decoding.path, &mut decoding.work);
    let joints = decode(model, made * each, buffers, &mut watch)?;
    bones::pose(model, Bones::Model, joints);
    let each = 3 * posture::count(span.parts);
    for (pose, out) in poses(joints).iter().zip(directions.chunks_exact_mut(each.max(1))) {
        posture::write(pose, span.parts, out);
    }
    Ok((heard, if planned > arena.used() { planned } else { arena.used() }))
}

#[cfg(feature = "timeline")]
fn poses(joints: &mut [f32]) -> &mut [Pose] {
    let (points, _) = joints.as_chunks_mut::<3>();
    points.as_chunks_mut::<JOINTS>().0
}

/// Has the parts of a motion, `[T][22][3]` metres, do what the spans do.
#[cfg(feature = "timeline")]
#[inline(never)]
pub(super) fn hold(spans: &[Span<'_>], directions: &[i16], joints: &mut [f32]) {
    let poses = poses(joints);
    let last = poses.len();
    let mut rest = directions;
    for span in spans {
        let (own, others) = rest.split_at_checked(3 * directions_of(span)).unwrap_or_default();
        rest = others;
        let each = 3 * posture::count(span.parts);
        let of_span = poses.iter_mut().skip(usize::from(span.first)).zip(own.chunks_exact(each.max(1)));
        for (frame, (pose, directions)) in (0..).zip(of_span) {
            posture::hold(pose, span.parts, directions, share(span, frame, last));
        }
    }
}

/// How far a span counts at one of its frames, in a motion of so many: it comes and goes smoothly, but for its ends at those of the motion.
#[cfg(feature = "timeline")]
fn share(span: &Span<'_>, frame: u16, frames: usize) -> f32 {
    let quarter = span.frames / 4;
    let lead = f32::from(if quarter < LEAD { quarter } else { LEAD });
    let along = |frames: u16, open: bool| {
        let way = (f32::from(frames) + 1.0) / (lead + 1.0);
        if open && way < 1.0 { way * way * (3.0 - 2.0 * way) } else { 1.0 }
    };
    let behind = span.frames.saturating_sub(frame + 1);
    along(frame, span.first > 0) * along(behind, span.end() < frames)
}
