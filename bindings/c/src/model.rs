//! Opening a blob, and what a request will need of memory and work.

use core::ffi::c_void;

use motionette::PromptError;
use motionette::refining::Config;
use motionette::{BodyParts, Error, Limits, MAX_STEPS, Model, Plan, PlanningError, PlanningLimits, TimelineLimits};
use motionette::{JOINTS, MAX_ANCHORS};

use crate::error::{mtn_error, mtn_result, report};
use crate::pointer::{Slot, clamped, place, slice};
use crate::request::{mtn_request, refinement};
use crate::timeline::MTN_MAX_SPANS;

/// Words of `mtn_model`'s storage.
pub const MTN_MODEL_WORDS: usize = 640;

/// An opened blob. Opaque: give it zeroed storage (a `static` is), call `mtn_model_open`, and do not copy it.
#[repr(C)]
#[derive(Debug)]
pub struct mtn_model {
    /// Not for use: makes the alignment that of 64-bit numbers.
    pub reserved: u64,
    /// Not for use.
    pub opaque: [usize; MTN_MODEL_WORDS],
}

/// What lies in the storage.
pub(crate) type Opened = Slot<Model<'static>>;

const _: () = assert!(
    size_of::<mtn_model>() >= size_of::<Opened>() && align_of::<mtn_model>() >= align_of::<Opened>(),
    "a model does not fit its storage: raise MTN_MODEL_WORDS"
);

/// Rows that pass through a layer at a time unless a generator is told otherwise.
pub const MTN_ROWS: usize = 8;
const _: () = assert!(MTN_ROWS == motionette::ROWS);

/// Largest request that is to be served.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct mtn_limits {
    /// Frames of the motion; 0: the longest motion of the model, as a request of predicted length needs it.
    pub frames: usize,
    /// Words of the prompt, 1 for one that is a vector; 0: the tokens are given.
    pub words: usize,
    /// Anchors, at most `MTN_MAX_ANCHORS`.
    pub anchors: usize,
    /// Planner steps; not looked at without words.
    pub steps: u16,
    /// Decoder evaluations of the refinement; 0: anchors are for the planner only, unless `exact` is set.
    pub evaluations: u16,
    /// As of a request.
    pub exact: u16,
    /// As in a request.
    pub free_feet: u16,
    /// Guidance; 1 is off and saves half of the planner's work. Not looked at without words.
    pub guidance: f32,
    /// Rows that pass through a layer at a time, as `mtn_generator_set_rows` is told; 0: `MTN_ROWS`.
    pub rows: usize,
    /// Joints that have rows at many frames, each counted once: those of tracks; beside tracks or obstacles those of anchors as well;
    /// with obstacles up to six more, which lead the figure out. `MTN_JOINTS` is enough for every request. 0: neither tracks nor
    /// obstacles. With them `exact` must be set.
    pub tracked: usize,
    /// Spans of a timeline, at most `MTN_MAX_SPANS`, each as long as the motion and with a prompt of so many `words`, which must not be 0:
    /// of the larger of prompt and spans where they differ, of the spans where the tokens are given.
    pub spans: usize,
}

/// Memory and work of the largest request inside some limits.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct mtn_plan {
    /// Bytes of arena, from a 16-byte boundary, exactly. An arena that begins elsewhere needs up to 15 more.
    pub arena_bytes: usize,
    /// Multiply-accumulates at most, in all.
    pub macs: u64,
    /// Of these, multiply-accumulates of reading the prompt and planning tokens.
    pub planning_macs: u64,
    /// Of these, multiply-accumulates of the final decoding; what is left is refinement.
    pub decoding_macs: u64,
    /// Decoder evaluations at most, the final one included.
    pub evaluations: u32,
    /// Decoder gradients at most.
    pub gradients: u32,
}

/// Opens a blob: checks header, checksum, manifest and every tensor, once. About one pass over its bytes.
///
/// `blob`: `blob_bytes` bytes from a 16-byte boundary, read in place (flash will do); bytes behind the blob are
/// ignored. They must not change or go away while `model`, or a generator of it, is in use.
///
/// # Safety
/// `model` is storage for one `mtn_model`; `blob` points to `blob_bytes` readable bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_model_open(model: *mut mtn_model, blob: *const c_void, blob_bytes: usize) -> mtn_result {
    report(|| {
        let slot = place(model, 0)?.cast::<Opened>().cast_mut();
        // SAFETY: aligned; the caller promises storage.
        unsafe { Slot::close(slot) };
        place(blob.cast::<u8>(), 1)?;
        // SAFETY: the caller promises readable bytes that stay.
        let bytes = unsafe { slice(blob.cast::<u8>(), blob_bytes, 1) }?;
        let opened = Model::open(bytes)?;
        // SAFETY: aligned; the caller promises storage.
        unsafe { Slot::open(slot, opened) };
        Ok(())
    })
}

/// Sets steps and guidance of a request to what the model's planner is meant for. Other planners than that of
/// `mtn_request_default` need it: MoMask's takes ten steps at guidance 4, T2M-GPT's is not guided.
///
/// # Safety
/// `model` is zeroed storage or one that `mtn_model_open` was called with; `request` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_request_for(model: *const mtn_model, request: *mut mtn_request) -> mtn_result {
    report(|| {
        // SAFETY: aligned; the caller promises storage that stays as it is during this call.
        let model = unsafe { Slot::get(place(model, 0)?.cast::<Opened>(), 0) }?;
        let meant = model.default_planning();
        // SAFETY: aligned; the caller promises a value that is its own.
        let request = unsafe { &mut *place(request, 1)?.cast_mut() };
        (request.steps, request.guidance) = (meant.steps, meant.guidance);
        Ok(())
    })
}

/// Numbers of a vector that the model takes as a prompt into `width`; 0 for models that take words.
///
/// # Safety
/// `model` is zeroed storage or one that `mtn_model_open` was called with; `width` is valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_model_vector_width(model: *const mtn_model, width: *mut usize) -> mtn_result {
    report(|| {
        // SAFETY: aligned; the caller promises storage that stays as it is during this call.
        let model = unsafe { Slot::get(place(model, 0)?.cast::<Opened>(), 0) }?;
        let out = place(width, 1)?.cast_mut();
        // SAFETY: aligned; the caller promises room for a number.
        unsafe { out.write(model.vector_width().unwrap_or(0)) };
        Ok(())
    })
}

/// Says what the largest request inside `limits` will need: bytes of arena, exactly, and multiply-accumulates at
/// most.
///
/// # Safety
/// `model` is zeroed storage or one that `mtn_model_open` was called with; `limits` and `plan` are valid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_model_plan(
    model: *const mtn_model,
    limits: *const mtn_limits,
    plan: *mut mtn_plan,
) -> mtn_result {
    report(|| {
        // SAFETY: aligned; the caller promises storage that stays as it is during this call.
        let model = unsafe { Slot::get(place(model, 0)?.cast::<Opened>(), 0) }?;
        // SAFETY: aligned; the caller promises a value.
        let limits = unsafe { place(limits, 1)?.read() };
        let out = place(plan, 2)?.cast_mut();
        let plan = Plan::for_request(model, &limits.checked(model)?).map_err(Error::from)?;
        let plan = mtn_plan {
            arena_bytes: plan.arena_bytes,
            macs: plan.macs,
            planning_macs: plan.planning_macs,
            decoding_macs: plan.decoding_macs,
            evaluations: plan.evaluations,
            gradients: plan.gradients,
        };
        // SAFETY: aligned; the caller promises room for a plan.
        unsafe { out.write(plan) };
        Ok(())
    })
}

impl mtn_limits {
    /// The runtime's limits, if a request of `model` can be as large.
    fn checked(&self, model: &Model<'_>) -> Result<Limits, mtn_result> {
        let (found, limit) = (self.frames.div_ceil(model.frames_per_token().max(1)), model.max_tokens());
        let tokens = if self.frames == 0 { limit } else { found };
        if tokens > limit {
            return Err(PlanningError::Length { found, limit }.into());
        }
        if self.anchors > MAX_ANCHORS {
            let found = clamped(self.anchors);
            return Err(mtn_result { found, limit: clamped(MAX_ANCHORS), ..mtn_error::TooManyAnchors.into() });
        }
        if self.tracked > JOINTS {
            let found = clamped(self.tracked);
            return Err(mtn_result { found, limit: clamped(JOINTS), ..mtn_error::TrackedJoints.into() });
        }
        if self.tracked > 0 && self.exact == 0 {
            return Err(mtn_error::NotExact.into());
        }
        let mut planning = None;
        if self.words > 0 {
            let limit = model.max_words().ok_or(PlanningError::NoPlanner)?;
            if self.words > limit {
                return Err(PromptError::TooManyWords { found: self.words, limit }.into());
            }
            if self.steps == 0 || self.steps > MAX_STEPS {
                return Err(PlanningError::Steps { found: self.steps, limit: MAX_STEPS }.into());
            }
            let words = if model.vector_width().is_some() { 0 } else { self.words };
            let steps = self.steps;
            // The planner sees places of tracks as anchors.
            let (guided, anchors) = (self.guidance != 1.0, self.anchors > 0 || self.tracked > 0);
            planning = Some(PlanningLimits { words, steps, guided, anchors, clauses: 1 });
        }
        let timeline = self.timeline(model, tokens, planning.as_ref())?;
        let refinement = refinement(self.evaluations, self.exact, self.free_feet);
        let anchors = if refinement.is_some() { self.anchors } else { 0 };
        let rows = if self.rows == 0 { MTN_ROWS } else { self.rows };
        let (tracked, refinement) = (self.tracked, refinement.unwrap_or(Config::fast(0)));
        Ok(Limits { tokens, anchors, tracked, timeline, refinement, planning, rows })
    }

    /// Spans that are as long as a motion of so many tokens, and planned as it is.
    fn timeline(
        &self,
        model: &Model<'_>,
        tokens: usize,
        planning: Option<&PlanningLimits>,
    ) -> Result<Option<TimelineLimits>, mtn_result> {
        let found = clamped(self.spans);
        match planning {
            _ if self.spans == 0 => Ok(None),
            _ if self.spans > MTN_MAX_SPANS => {
                Err(mtn_result { found, limit: clamped(MTN_MAX_SPANS), ..mtn_error::TooManySpans.into() })
            }
            None => Err(mtn_result { found, ..mtn_error::SpanWords.into() }),
            Some(&PlanningLimits { words, steps, guided, .. }) => {
                // Parts of two spans may not be the same at the same time.
                let whole = BodyParts::UPPER_BODY.and(BodyParts::LEGS).directions();
                let directions = clamped(tokens * model.frames_per_token() * whole);
                let (tokens, words, spans) = (tokens as u16, words as u16, self.spans as u8);
                Ok(Some(TimelineLimits { directions, tokens, words, steps, spans, guided }))
            }
        }
    }
}
