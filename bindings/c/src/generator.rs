//! Making motions and watching them being made.

use core::ffi::{c_char, c_void};
use core::fmt::{self, Write};
use core::ops::ControlFlow;

use motionette::refining::{Clearance, ControlError, TrackingError};
use motionette::{Generator, Guess, LINKED_SPANS, Model, Motion, Observer, Progress, Request, Stage, Stop, Understood};

use crate::conditions::with_conditions;
use crate::error::{mtn_error, mtn_result, report};
use crate::model::{self, mtn_model};
use crate::pointer::{Slot, place, slice, slice_mut};
use crate::request::{Anchors, MTN_JOINTS, mtn_request};
use crate::timeline::mtn_heard;

/// Words of `mtn_generator`'s storage.
pub const MTN_GENERATOR_WORDS: usize = 640;

/// Makes motions of one model in one arena. Opaque: give it zeroed storage (a `static` is), call
/// `mtn_generator_open`, and do not copy it.
#[repr(C)]
#[derive(Debug)]
pub struct mtn_generator {
    /// Not for use: makes the alignment that of 64-bit numbers.
    pub reserved: u64,
    /// Not for use.
    pub opaque: [usize; MTN_GENERATOR_WORDS],
}

/// What lies in the storage.
struct Maker {
    generator: Generator<'static>,
    /// What was understood of the spans of the last motion that had some.
    heard: [mtn_heard; LINKED_SPANS],
}

type Opened = Slot<Maker>;

const _: () = assert!(
    size_of::<mtn_generator>() >= size_of::<Opened>() && align_of::<mtn_generator>() >= align_of::<Opened>(),
    "a generator does not fit its storage: raise MTN_GENERATOR_WORDS"
);

/// What a progress callback wants: one of `MTN_FLOW_*`.
pub type mtn_flow = u32;
/// Go on.
pub const MTN_FLOW_CONTINUE: mtn_flow = 0;
/// Finish with the best so far: refinement ends, the motion is decoded and returned; planning ends with its last
/// proposals.
pub const MTN_FLOW_FINISH: mtn_flow = 1;
/// Stop at once, no motion. Any other number counts as this.
pub const MTN_FLOW_ABORT: mtn_flow = 2;

/// A stage of the work.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum mtn_stage {
    /// Reading the prompt.
    Reading,
    /// Planning tokens.
    Planning,
    /// Bending the motion onto its anchors.
    Refining,
    /// Decoding the final motion.
    Decoding,
}

/// How far the work is.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct mtn_progress {
    /// The stage.
    pub stage: mtn_stage,
    /// Decoder evaluations begun in this stage; when planning, steps.
    pub evaluation: u16,
    /// Decoder evaluations, or steps, this stage may take.
    pub evaluations: u16,
    /// Mean distance from the anchors of the evaluation that has just been completed, metres; negative in all other
    /// calls.
    pub control_error: f32,
}

/// Called at every layer boundary, hundreds of times a motion. `context` is what `mtn_generate` was given;
/// `progress` is valid during the call only. It may take its time, but neither leave by `longjmp` nor use the same
/// generator.
pub type mtn_progress_fn =
    Option<unsafe extern "C" fn(context: *mut c_void, progress: *const mtn_progress) -> mtn_flow>;

/// Likeliest actions of `mtn_understood`.
pub const MTN_NEAREST: usize = 3;
const _: () = assert!(MTN_NEAREST == motionette::NEAREST);
/// Most clauses of a prompt, done one behind the other ("walk, then wave"), beside the first.
pub const MTN_FURTHER_CLAUSES: usize = 2;
const _: () = assert!(MTN_FURTHER_CLAUSES + 1 == motionette::MAX_CLAUSES);

/// In place of a phrase's number: no phrase.
pub const MTN_NO_PHRASE: u16 = 0xFFFF;
const _: () = assert!(MTN_NO_PHRASE == Guess::NONE.phrase);

/// A phrase that the model was taught, and how likely the prompt means it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_guess {
    /// Number of the phrase, the same for every prompt of one model, or `MTN_NO_PHRASE`.
    pub phrase: u16,
    /// Probability, 0 to 1.
    pub score: f32,
}

/// What a prompt was understood as; `mtn_motion_understood` says it in words.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_understood {
    /// The likeliest actions, the first of them first. All `MTN_NO_PHRASE`: there was no prompt, or the model was not taught what
    /// prompts mean.
    pub actions: [mtn_guess; MTN_NEAREST],
    /// The style, or `MTN_NO_PHRASE`.
    pub style: mtn_guess,
    /// 1: the first action is likely what was meant; 0: the model has hardly learnt what was asked for.
    pub sure: u8,
}

/// How far a motion is from its tracks.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_tracking {
    /// Mean distance over all positions that count, on the axes that do, metres; negative without tracks.
    pub mean: f32,
    /// Largest distance, metres; negative without tracks.
    pub worst: f32,
    /// The track it is from, counted from 0.
    pub track: u16,
    /// Its frame.
    pub frame: u16,
}

/// In place of an obstacle's number: no obstacle.
pub const MTN_NO_OBSTACLE: u16 = 0xFFFF;

/// How far a motion keeps clear of its obstacles, half frames counted.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_clearance {
    /// Least distance from a surface, metres; negative inside, infinite without obstacles.
    pub least: f32,
    /// By how much it is less than the obstacle's margin, metres; negative where all of the margin is kept, minus infinity without
    /// obstacles. More than 0.005: the figure does not keep clear, since there was no way for it.
    pub missing: f32,
    /// The obstacle it is from, counted from 0, or `MTN_NO_OBSTACLE`.
    pub obstacle: u16,
    /// The frame.
    pub frame: u16,
    /// The joint, or the one at the end of the bone.
    pub joint: u8,
}

/// A finished motion. Its arrays lie in the generator and its arena, until the generator is used again.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct mtn_motion {
    /// Joint positions `[frames][22][3]`, metres: `joints[frame][MTN_JOINT_HEAD][1]` is the head's height.
    pub joints: *const [[f32; 3]; MTN_JOINTS],
    /// Frames.
    pub frames: usize,
    /// Tokens `[L][Q]` the motion was decoded from, before refinement.
    pub tokens: *const u16,
    /// Numbers in `tokens`.
    pub token_count: usize,
    /// Token embeddings `[L][du]` it was decoded from, refinement included.
    pub embeddings: *const f32,
    /// Numbers in `embeddings`.
    pub embedding_count: usize,
    /// Bytes of arena that were taken.
    pub arena_used: usize,
    /// Mean distance from the anchors before refinement, metres; negative when it was not measured.
    pub control_error_before: f32,
    /// The same after it.
    pub control_error: f32,
    /// Largest distance from an anchor after it, metres; negative when it was not measured.
    pub worst_error: f32,
    /// The anchor it is from, counted from 0.
    pub worst_anchor: u16,
    /// Decoder evaluations of the refinement.
    pub evaluations: u16,
    /// Anchors that ask for more speed than the edit of `exact` adds, and were met as far as it allows.
    pub loosened_anchors: u16,
    /// Frames a second.
    pub frame_rate: u16,
    /// Words of the prompt.
    pub words: u16,
    /// Of these, words that the model does not know.
    pub unknown_words: u16,
    /// Anchors that the planner did not see.
    pub unconditioned_anchors: u16,
    /// What the prompt was understood as, or the first of its clauses.
    pub understood: mtn_understood,
    /// The same of its further clauses, in the order in which they are done; behind the last of them all `MTN_NO_PHRASE`.
    pub then: [mtn_understood; MTN_FURTHER_CLAUSES],
    /// How far the generated motion was from the tracks.
    pub tracking_before: mtn_tracking,
    /// How far it is after the edit.
    pub tracking: mtn_tracking,
    /// How near the generated motion came to an obstacle.
    pub clearance_before: mtn_clearance,
    /// How near it comes after the edit.
    pub clearance: mtn_clearance,
    /// Positions of tracks that could not be followed as fast as they ask for.
    pub hurried_positions: u16,
    /// What was understood of the prompts of the timeline's spans, in the request's order; null without a timeline.
    pub spans: *const mtn_heard,
    /// Spans.
    pub span_count: usize,
}

/// Makes a generator of `model` that works in `arena` and nowhere else.
///
/// The generator has its own copy of the model's state: `model` may be used for something else afterwards, the blob
/// may not. `arena`: `arena_bytes` bytes with any content, for this generator alone; how many, `mtn_model_plan` says.
///
/// # Safety
/// `generator` is storage for one `mtn_generator`; `model` is zeroed storage or one that `mtn_model_open` was called
/// with; `arena` points to `arena_bytes` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_generator_open(
    generator: *mut mtn_generator,
    model: *const mtn_model,
    arena: *mut c_void,
    arena_bytes: usize,
) -> mtn_result {
    report(|| {
        let slot = place(generator, 0)?.cast::<Opened>().cast_mut();
        // SAFETY: aligned; the caller promises storage.
        unsafe { Slot::close(slot) };
        // SAFETY: aligned; the caller promises storage that stays as it is during this call.
        let model: &Model<'static> = unsafe { Slot::get(place(model, 1)?.cast::<model::Opened>(), 1) }?;
        place(arena.cast::<u8>(), 2)?;
        // SAFETY: the caller promises bytes that nobody else uses.
        let arena = unsafe { slice_mut(arena.cast::<u8>(), arena_bytes, 2) }?;
        let opened =
            Maker { generator: Generator::new(model.clone(), arena)?, heard: [mtn_heard::NOTHING; LINKED_SPANS] };
        // SAFETY: aligned; the caller promises storage.
        unsafe { Slot::open(slot, opened) };
        Ok(())
    })
}

/// Has `rows` rows of the planner pass through a layer at a time, and of the decoder half as many tokens more, from now on, instead of
/// `MTN_ROWS`: 4 to 24, other numbers count as the nearest of these. Weights are read once for so many, so more are faster, most of
/// all where the blob lies in slow flash; each takes room, which `mtn_model_plan` says for the same `rows` in its limits. The motion
/// is the same.
///
/// # Safety
/// As of `mtn_generate`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_generator_set_rows(generator: *mut mtn_generator, rows: usize) -> mtn_result {
    report(|| {
        let slot = place(generator, 0)?.cast::<Opened>().cast_mut();
        let work = |maker: &mut Maker| {
            maker.generator.set_rows(rows);
            Ok(())
        };
        // SAFETY: aligned; the caller promises storage and one thread at a time.
        unsafe { Slot::with(slot, 0, work) }
    })
}

/// Makes the motion of `request`. `progress` may be null; `context` is handed to it. On an error `motion` is left
/// alone and the generator can be used again at once.
///
/// # Safety
/// `generator` is zeroed storage or one that `mtn_generator_open` was called with, used by one thread at a time;
/// `request` and all it points to are readable; `motion` is room for one `mtn_motion`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_generate(
    generator: *mut mtn_generator,
    request: *const mtn_request,
    progress: mtn_progress_fn,
    context: *mut c_void,
    motion: *mut mtn_motion,
) -> mtn_result {
    report(|| {
        let slot = place(generator, 0)?.cast::<Opened>().cast_mut();
        let out = place(motion, 4)?.cast_mut();
        // SAFETY: aligned; the caller promises a value.
        let request = unsafe { place(request, 1)?.read() };
        // SAFETY: the caller promises that what the request points to is readable.
        let anchors = unsafe { Anchors::new(&request) }?;
        // SAFETY: as above, for as long as this call lasts.
        let resolved = unsafe { request.resolved(&anchors) }?;
        let mut watch = Watch { progress, context };
        let mut make = |request: Request<'_>| {
            let work = |Maker { generator, heard }: &mut Maker| {
                // C says nothing of how proposals are drawn: as the planner is meant to.
                let request = request.sampling(generator.model().default_planning().sampling);
                let motion = generator.generate(&request, &mut watch)?;
                let spans = heard.get_mut(..request.timeline.len()).unwrap_or_default();
                for (to, from) in spans.iter_mut().zip(motion.spans()) {
                    *to = (*from).into();
                }
                Ok(mtn_motion::new(&motion, spans))
            };
            // SAFETY: aligned; the caller promises storage and one thread at a time.
            unsafe { Slot::with(slot, 0, work) }
        };
        let made = match (request.track_count, request.obstacle_count, request.span_count) {
            (0, 0, 0) => make(resolved),
            // SAFETY: as above.
            _ => unsafe { with_conditions(&request, resolved, &mut make) },
        }?;
        // SAFETY: aligned; the caller promises room for a motion.
        unsafe { out.write(made) };
        Ok(())
    })
}

/// Runs the self-test that the blob carries: decodes a motion and compares its hash, to prove that this machine
/// computes the same bits as the one that wrote the blob. `MTN_ERROR_SELF_TEST_FAILED` when not,
/// `MTN_ERROR_NO_SELF_TEST` without one.
///
/// # Safety
/// As of `mtn_generate`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_self_test(generator: *mut mtn_generator) -> mtn_result {
    report(|| {
        let slot = place(generator, 0)?.cast::<Opened>().cast_mut();
        let work = |maker: &mut Maker| match maker.generator.self_test()? {
            Some(true) => Ok(()),
            Some(false) => Err(mtn_error::SelfTestFailed.into()),
            None => Err(mtn_error::NoSelfTest.into()),
        };
        // SAFETY: aligned; the caller promises storage and one thread at a time.
        unsafe { Slot::with(slot, 0, work) }
    })
}

/// Hash over every bit of embeddings and joints, into `hash`: equal on every machine for the same request and blob.
///
/// # Safety
/// `motion` came from `mtn_generate` and its generator has not been used since; `hash` is room for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_motion_hash(motion: *const mtn_motion, hash: *mut u64) -> mtn_result {
    report(|| {
        // SAFETY: aligned; the caller promises a value.
        let motion = unsafe { place(motion, 0)?.read() };
        let out = place(hash, 1)?.cast_mut();
        // SAFETY: the caller promises a motion whose arrays are still there.
        let embeddings = unsafe { slice(motion.embeddings, motion.embedding_count, 0) }?;
        // SAFETY: as above.
        let joints = unsafe { slice(motion.joints, motion.frames, 0) }?;
        let hash = motionette::motion_hash(embeddings, joints.as_flattened().as_flattened());
        // SAFETY: aligned; the caller promises room for a number.
        unsafe { out.write(hash) };
        Ok(())
    })
}

/// What the prompt was understood as, in English, zero-terminated, into `text`: `a person waves the right hand, angrily (0.86)`, or
/// `hardly anything; nearest: ...` and up to three phrases, `, then ` between clauses; empty where there is nothing to say. What does not fit
/// into `bytes` is left out; 256 hold everything that the bundled models say of a clause.
///
/// # Safety
/// As of `mtn_generate`; `motion` came from this generator; `text` points to `bytes` bytes, at least 1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_motion_understood(
    generator: *mut mtn_generator,
    motion: *const mtn_motion,
    text: *mut c_char,
    bytes: usize,
) -> mtn_result {
    report(|| {
        place(generator, 0)?;
        // SAFETY: aligned; the caller promises a value.
        let mtn_motion { understood, then: [second, third], .. } = unsafe { &*place(motion, 1)? };
        // SAFETY: the caller's promises are the same.
        unsafe { write_words(generator, &[understood, second, third], (text, bytes)) }
    })
}

/// The same of one clause: of the prompt of a span, `motion.spans[i].understood`.
///
/// # Safety
/// As of `mtn_generate`; `understood` came from a motion of this generator; `text` points to `bytes` bytes, at least 1.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn mtn_understood_in_words(
    generator: *mut mtn_generator,
    understood: *const mtn_understood,
    text: *mut c_char,
    bytes: usize,
) -> mtn_result {
    report(|| {
        place(generator, 0)?;
        // What lies in the generator is read before the generator is used.
        // SAFETY: aligned; the caller promises a value.
        let understood = unsafe { place(understood, 1)?.read() };
        // SAFETY: the caller's promises are the same.
        unsafe { write_words(generator, &[&understood], (text, bytes)) }
    })
}

/// Writes what clauses were understood as, one behind the other, and a zero.
///
/// # Safety
/// As of [`mtn_motion_understood`].
unsafe fn write_words(
    generator: *mut mtn_generator,
    clauses: &[&mtn_understood],
    (text, bytes): (*mut c_char, usize),
) -> Result<(), mtn_result> {
    let slot = generator.cast::<Opened>();
    place(text, 2)?;
    if bytes == 0 {
        return Err(mtn_result { index: 3, limit: 1, ..mtn_error::Length.into() });
    }
    // SAFETY: the caller promises bytes that nobody else uses.
    let room = unsafe { slice_mut(text.cast::<u8>(), bytes, 2) }?;
    let work = |maker: &mut Maker| {
        let mut text = Text { room, len: 0 };
        for (k, clause) in clauses.iter().filter_map(|clause| clause.understood()).enumerate() {
            let separator = if k > 0 { ", then " } else { "" };
            // Too little room is no error: what is there can be read.
            let _ = write!(text, "{separator}{}", maker.generator.model().in_words(clause));
        }
        let end = text.len;
        if let Some(zero) = text.room.get_mut(end) {
            *zero = 0;
        }
        Ok(())
    };
    // SAFETY: aligned; the caller promises storage and one thread at a time.
    unsafe { Slot::with(slot, 0, work) }
}

impl mtn_motion {
    fn new(motion: &Motion<'_>, spans: &[mtn_heard]) -> Self {
        let report = motion.refinement;
        let before = report.and_then(|report| report.before);
        let after = report.and_then(|report| report.after);
        let mean = |error: Option<ControlError>| error.map_or(-1.0, |error| error.mean);
        let edited = report.and_then(|report| report.edited);
        let followed = edited.and_then(|edited| edited.followed);
        let frames = motion.frames();
        let mut then = [mtn_understood::NOTHING; MTN_FURTHER_CLAUSES];
        for (to, clause) in then.iter_mut().zip(motion.then()) {
            *to = clause.into();
        }
        mtn_motion {
            joints: frames.as_ptr(),
            frames: frames.len(),
            tokens: motion.tokens().as_ptr(),
            token_count: motion.tokens().len(),
            embeddings: motion.u().as_ptr(),
            embedding_count: motion.u().len(),
            arena_used: motion.arena_used,
            control_error_before: mean(before),
            control_error: mean(after),
            worst_error: after.map_or(-1.0, |error| error.worst),
            worst_anchor: after.map_or(0, |error| error.worst_anchor),
            evaluations: report.map_or(0, |report| report.evaluations),
            loosened_anchors: edited.map_or(0, |edited| edited.loosened),
            frame_rate: motion.frame_rate(),
            words: motion.words(),
            unknown_words: motion.unknown_words(),
            unconditioned_anchors: motion.unconditioned_anchors(),
            understood: motion.understood().map_or(mtn_understood::NOTHING, mtn_understood::from),
            then,
            tracking_before: followed.and_then(|followed| followed.before).into(),
            tracking: followed.and_then(|followed| followed.after).into(),
            clearance_before: followed.and_then(|followed| followed.clearance_before).into(),
            clearance: followed.and_then(|followed| followed.clearance).into(),
            hurried_positions: followed.map_or(0, |followed| followed.hurried),
            spans: if spans.is_empty() { core::ptr::null() } else { spans.as_ptr() },
            span_count: spans.len(),
        }
    }
}

impl From<Option<TrackingError>> for mtn_tracking {
    fn from(error: Option<TrackingError>) -> Self {
        let none = mtn_tracking { mean: -1.0, worst: -1.0, track: 0, frame: 0 };
        error.map_or(none, |TrackingError { mean, worst, worst_track: track, worst_frame: frame }| mtn_tracking {
            mean,
            worst,
            track,
            frame,
        })
    }
}

impl From<Option<Clearance>> for mtn_clearance {
    fn from(clearance: Option<Clearance>) -> Self {
        let (least, missing) = (f32::INFINITY, f32::NEG_INFINITY);
        let none = mtn_clearance { least, missing, obstacle: MTN_NO_OBSTACLE, frame: 0, joint: 0 };
        clearance.map_or(none, |Clearance { least, missing, obstacle, joint, frame }| mtn_clearance {
            least,
            missing,
            obstacle,
            frame,
            joint,
        })
    }
}

impl mtn_guess {
    const NONE: Self = mtn_guess { phrase: MTN_NO_PHRASE, score: 0.0 };

    const fn guess(self) -> Guess {
        Guess { phrase: self.phrase, score: self.score }
    }
}

impl From<Guess> for mtn_guess {
    fn from(Guess { phrase, score }: Guess) -> Self {
        mtn_guess { phrase, score }
    }
}

impl mtn_understood {
    pub(crate) const NOTHING: Self =
        mtn_understood { actions: [mtn_guess::NONE; MTN_NEAREST], style: mtn_guess::NONE, sure: 0 };

    /// As the runtime has it; `None` where there is nothing to say.
    pub(crate) fn understood(&self) -> Option<Understood> {
        if self.actions.iter().all(|guess| guess.phrase == MTN_NO_PHRASE) {
            return None;
        }
        let style = (self.style.phrase != MTN_NO_PHRASE).then(|| self.style.guess());
        Some(Understood { actions: self.actions.map(mtn_guess::guess), style, sure: self.sure != 0 })
    }
}

impl From<Understood> for mtn_understood {
    fn from(Understood { actions, style, sure }: Understood) -> Self {
        let style = style.map_or(mtn_guess::NONE, mtn_guess::from);
        mtn_understood { actions: actions.map(mtn_guess::from), style, sure: u8::from(sure) }
    }
}

/// A string of C that is being written: whole characters, as many as fit before the zero.
struct Text<'a> {
    room: &'a mut [u8],
    len: usize,
}

impl Write for Text<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let free = self.room.len().saturating_sub(self.len + 1);
        let fits = (0..=free.min(text.len())).rev().find_map(|end| text.get(..end)).unwrap_or_default();
        let written = self.room.iter_mut().skip(self.len).zip(fits.as_bytes());
        self.len += written.map(|(to, from)| *to = *from).count();
        // What is full stays full, though a shorter piece would fit.
        if fits.len() < text.len() { Err(fmt::Error) } else { Ok(()) }
    }
}

/// The C callback as an observer.
struct Watch {
    progress: mtn_progress_fn,
    context: *mut c_void,
}

impl Observer for Watch {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        let Some(callback) = self.progress else { return ControlFlow::Continue(()) };
        let progress = mtn_progress {
            stage: match progress.stage {
                Stage::Reading => mtn_stage::Reading,
                Stage::Planning => mtn_stage::Planning,
                Stage::Refining => mtn_stage::Refining,
                Stage::Decoding => mtn_stage::Decoding,
            },
            evaluation: progress.evaluation,
            evaluations: progress.evaluations,
            control_error: progress.control_error.unwrap_or(-1.0),
        };
        // SAFETY: the caller of `mtn_generate` promises a function of this type that takes this context.
        match unsafe { callback(self.context, &raw const progress) } {
            MTN_FLOW_CONTINUE => ControlFlow::Continue(()),
            MTN_FLOW_FINISH => ControlFlow::Break(Stop::Finish),
            _ => ControlFlow::Break(Stop::Abort),
        }
    }
}
