//! The timeline of a request: each span is planned and decoded as a motion of its own, of which is kept how it holds the span's parts; the
//! request's motion then holds them so.
//!
//! Spans come before the motion itself and leave behind nothing but directions of bones, so that there is one motion in memory at a time.

use super::buffers::{self, Decoding};
use super::error::Error;
use super::observer::{Observer, Stage, Watch};
use super::plan_tokens::{Planned, PlanningTask, plan_tokens};
use super::timeline::{directions_of, planned};
use super::{bones, decode};
use crate::JOINTS;
use crate::generation::tokens::PlanningError;
use crate::memory::Arena;
use crate::model::Model;
use crate::pipeline::plan::Limits;
use crate::representation::{Pose, posture};
use crate::request::prompt::PromptStats;
use crate::request::timeline::{MAX_SPANS, Span, TimelineError};
use crate::request::{Bones, Request};

/// Of a span that begins or ends within the motion, so many frames lead over; a quarter of a short span.
const LEAD: u16 = 10;

/// What was understood of each span's prompt.
pub(super) type Heard = [PromptStats; MAX_SPANS];

/// Makes the motion of each span and keeps how it holds the span's parts, in `directions`; what was understood of the spans comes back, `peak` becomes the bytes
/// used at most.
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

fn poses(joints: &mut [f32]) -> &mut [Pose] {
    let (points, _) = joints.as_chunks_mut::<3>();
    points.as_chunks_mut::<JOINTS>().0
}

/// Has the parts of a motion, `[T][22][3]` metres, do what the spans do.
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
