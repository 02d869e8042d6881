//! A motion that goes on: tokens come in segments, planned or given; frames come out as they become final.

use super::observer::{Stage, Watch};
use super::plan_tokens::{PlanningTask, plan_tokens};
use super::{Error, Generator, Observer, StreamError, bones};
use crate::JOINTS;
use crate::codec::codebook::Codebooks;
use crate::codec::vq::stream::{self, CHUNK};
use crate::generation::tokens::session::Modules;
use crate::generation::tokens::{self as planning, Fixed, Length, Planning, PlanningError, SEED_STEP};
use crate::log;
use crate::memory::{Arena, ArenaTooSmall, bytes_of};
use crate::model::{MAX_TOKENS, Model};
use crate::pipeline::plan::{StreamLimits, StreamPlan};
use crate::representation::Features;
use crate::representation::humanml3d::{POSITION_CHANNELS, Path, Root, channels};
use crate::representation::rigid::Body;
use crate::request::prompt::PromptStats;
use crate::request::{Bones, Request, Source};
use core::ops::ControlFlow;
use heapless::Vec;

/// A frame: the position of each joint, metres.
pub type Frame = [[f32; 3]; JOINTS];

/// What a call of [`MotionStream::plan`] added.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Tokens.
    pub tokens: usize,
    /// What was understood of the prompt.
    pub heard: PromptStats,
}

/// A running motion of any length, in the generator's arena.
///
/// [`MotionStream::plan`] plans how the motion goes on, [`MotionStream::push`] is told; both queue tokens.
/// [`MotionStream::frames`] takes queued tokens through the decoder, a few at a time, and hands out the frames
/// that have become final: the same bits, in the same frame of reference, as [`Generator::generate`] gives for all tokens at
/// once. The output lags behind the tokens by the decoder's radius ([`StreamPlan::latency_frames`]), so tokens must be
/// queued that far ahead of playback; the rest of the motion comes after [`MotionStream::finish`].
///
/// ```no_run
/// # use motionette::{Generator, Length, Request, StreamError, StreamLimits, PlanningLimits};
/// # fn run(generator: &mut Generator<'_>, mut play: impl FnMut(&motionette::Frame)) -> Result<(), StreamError> {
/// let planning = PlanningLimits { words: 32, steps: 5, guided: true, anchors: false, clauses: 1 };
/// let mut stream = generator.stream(&StreamLimits { tokens: 49, planning: Some(planning), rows: 8 })?;
/// for prompt in ["a person walks", "a person walks", "a person waves the right hand"] {
///     stream.plan(&Request::text(prompt).length(Length::Tokens(12)), &mut ())?;
///     while let Some(frames) = stream.frames(&mut ())? {
///         frames.iter().for_each(&mut play);
///     }
/// }
/// stream.finish();
/// while let Some(frames) = stream.frames(&mut ())? {
///     frames.iter().for_each(&mut play);
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct MotionStream<'g, 'a> {
    model: &'g Model<'a>,
    decoder: stream::Stream<'g>,
    memory: Memory<'g>,
    path: Path<'g>,
    root: Root,
    /// Tokens of the chunk in work, the first of the queued ones.
    chunk: usize,
    /// Frames of decoded tokens that have not become final.
    held: usize,
    /// Segments planned so far; begins anew after the last number.
    segment: u64,
    finished: bool,
    /// Of the planner, that pass through a layer at a time.
    rows: usize,
    /// The body that moves; `None` for joints as they were decoded.
    body: Option<Body>,
    /// What planning may use while it lasts.
    spare: Arena<'g>,
}

/// The last tokens of the motion, `[n][Q]`, oldest first; the last `queued` of them have not been decoded yet.
#[derive(Debug)]
struct Memory<'g> {
    tokens: &'g mut [u16],
    quantizers: usize,
    /// Positions that have come.
    known: usize,
    /// Those that have not been decoded.
    queued: usize,
    /// The motion began before the first of them.
    forgotten: bool,
}

impl Memory<'_> {
    fn capacity(&self) -> usize {
        self.tokens.len() / self.quantizers.max(1)
    }

    fn room(&self) -> usize {
        self.capacity().saturating_sub(self.queued)
    }

    /// `count` positions from `first` on.
    fn get(&self, first: usize, count: usize) -> &[u16] {
        part!(self.tokens, first * self.quantizers..(first + count) * self.quantizers)
    }

    /// Queues tokens for which there is room. The oldest make way.
    fn push(&mut self, new: &[u16]) {
        let known = self.known * self.quantizers;
        let forget = (known + new.len()).saturating_sub(self.tokens.len());
        let kept = known.saturating_sub(forget);
        for at in 0..kept {
            if let Some(&token) = self.tokens.get(at + forget)
                && let Some(to) = self.tokens.get_mut(at)
            {
                *to = token;
            }
        }
        for (to, from) in self.tokens.iter_mut().skip(kept).zip(new) {
            *to = *from;
        }
        self.forgotten |= forget > 0;
        self.known = (kept + new.len()) / self.quantizers.max(1);
        self.queued += new.len() / self.quantizers.max(1);
    }
}

/// The buffers of a stream, declared once; a segment's planning takes what lies behind them.
#[derive(Debug)]
pub(crate) struct Buffers<'g> {
    tokens: &'g mut [u16],
    path: Path<'g>,
    decoder: stream::Stream<'g>,
    /// Of these, bytes of the tokens, and of the path.
    pub token_bytes: usize,
    pub path_bytes: usize,
}

impl<'g> Buffers<'g> {
    pub fn take(model: &Model<'_>, limits: &StreamLimits, arena: &mut Arena<'g>) -> Result<Self, ArenaTooSmall> {
        let begin = arena.used();
        let tokens = arena.take(limits.tokens * model.codebooks().quantizers())?;
        let token_bytes = arena.used() - begin;
        let path = Path::take(arena, CHUNK * model.frames_per_token(), false)?;
        let path_bytes = arena.used() - begin - token_bytes;
        let decoder = model.decoder().stream(arena, POSITION_CHANNELS)?;
        Ok(Buffers { tokens, path, decoder, token_bytes, path_bytes })
    }
}

/// What planning a segment takes: the window of up to `capacity` tokens, and the session behind it.
pub(crate) fn planning_bytes(
    modules: &Modules<'_, '_>,
    capacity: usize,
    tokens: usize,
    limits: &planning::PlanningLimits,
    rows: usize,
) -> usize {
    bytes_of::<u16>(capacity * modules.quantizers()).saturating_add(modules.bytes(tokens, limits, rows).all())
}

impl<'a> Generator<'a> {
    /// Begins a motion that is made piece by piece. It starts at the origin facing +z, as any other does.
    ///
    /// # Errors
    /// [`Error::Arena`], [`Error::Tokens`] when `limits` remember no token or more than the model allows, and
    /// [`PlanningError::NoPlanner`] when they plan without a planner.
    pub fn stream(&mut self, limits: &StreamLimits) -> Result<MotionStream<'_, 'a>, StreamError> {
        let model = &self.model;
        let mut arena = Arena::new(self.arena);
        let (needed, available) = (StreamPlan::new(model, limits)?.arena_bytes, arena.available());
        let too_small = |_| Error::Arena(ArenaTooSmall { needed, available });
        if needed > available {
            return Err(Error::Arena(ArenaTooSmall { needed, available }).into());
        }
        let Buffers { tokens, path, decoder, .. } = Buffers::take(model, limits, &mut arena).map_err(too_small)?;
        Ok(MotionStream {
            model,
            decoder,
            memory: Memory {
                tokens,
                quantizers: model.codebooks().quantizers(),
                known: 0,
                queued: 0,
                forgotten: false,
            },
            path,
            root: Root::default(),
            chunk: 0,
            held: 0,
            segment: 0,
            finished: false,
            rows: limits.rows,
            body: bones::body(model, Bones::Model),
            spare: arena,
        })
    }
}

impl MotionStream<'_, '_> {
    /// Has another body move from the next frame on; best said before the first.
    ///
    /// # Errors
    /// [`Error::Bone`]; the body stays what it was.
    pub fn set_bones(&mut self, bones: Bones<'_>) -> Result<(), StreamError> {
        bones::check(bones)?;
        self.body = bones::body(self.model, bones);
        Ok(())
    }

    /// Tokens that can be queued now.
    #[must_use]
    pub fn room(&self) -> usize {
        if self.finished { 0 } else { self.memory.room() }
    }

    /// The last tokens of the motion, `[n][Q]`, as many as the stream remembers.
    #[must_use]
    pub fn tokens(&self) -> &[u16] {
        self.memory.get(0, self.memory.known)
    }

    /// Frames that [`MotionStream::frames`] can hand out before it needs more tokens.
    #[must_use]
    pub fn frames_ahead(&self) -> usize {
        let frames = self.memory.queued * self.model.frames_per_token() + self.held;
        if self.finished { frames } else { frames.saturating_sub(self.model.decoder().radius_frames()) }
    }

    /// Moves the origin below the root of the next frame, leaving the axes as they are: far from the origin an f32
    /// resolves less (0.06 mm at 1 km), so a motion that walks for hours should do this now and then. Returns where the
    /// new origin lies in the old frame, `[x, z]`, metres.
    pub fn rebase(&mut self) -> [f32; 2] {
        let scale = self.body.as_ref().map_or(1.0, Body::scale);
        self.root.rebase().map(|way| way * scale)
    }

    /// Queues tokens, `[n][Q]` for `Q` quantizers. All of them or, with an error, none.
    ///
    /// # Errors
    /// [`StreamError::Finished`], [`StreamError::QueueFull`], [`Error::Tokens`] for an incomplete position,
    /// [`Error::TokenOutOfRange`].
    pub fn push(&mut self, tokens: &[u16]) -> Result<(), StreamError> {
        let codebooks = self.model.codebooks();
        let count = tokens.len() / self.memory.quantizers.max(1);
        if self.finished {
            return Err(StreamError::Finished);
        }
        if count * self.memory.quantizers != tokens.len() {
            return Err(Error::Tokens { found: tokens.len(), limit: self.model.max_tokens() }.into());
        }
        if count > self.room() {
            return Err(StreamError::QueueFull { found: count, room: self.room() });
        }
        let known = |&token: &u16| usize::from(token) < codebooks.codes() || token == Codebooks::NONE;
        if let Some((index, &token)) = tokens.iter().enumerate().find(|(_, token)| !known(token)) {
            return Err(Error::TokenOutOfRange { index, token, codes: codebooks.codes() as u16 }.into());
        }
        self.memory.push(tokens);
        Ok(())
    }

    /// Plans how the motion goes on, and queues those tokens.
    ///
    /// The planner sees the last tokens as given ones and the new ones behind them, as many as the stream remembers in all:
    /// a window whose beginning is open unless it is the motion's own, and whose end is open. The request says
    /// what it always says, but:
    /// - its length is that of the new segment; a predicted length means half of what the stream remembers, at most what
    ///   there is room for,
    /// - positions of its fixed tokens count from the segment's beginning,
    /// - segment `k`, counted from 0, draws from the seed plus `k * 0x9E3779B97F4A7C15`, wrapping,
    /// - it has no anchors,
    /// - its prompt is one clause, whatever it says: a segment each for what is to be done one behind the other,
    /// - its body is the stream's ([`MotionStream::set_bones`]).
    ///
    /// With tokens instead of a text it is [`MotionStream::push`].
    ///
    /// # Errors
    /// Any [`Error`] of the request, [`Error::Arena`] when it needs more than the stream was planned for,
    /// [`StreamError::QueueFull`], [`StreamError::Finished`], [`StreamError::NotInParts`], and [`Error::Aborted`] when the observer says so.
    /// The motion so far and its place in the sequence of seeds stay what they were.
    pub fn plan(&mut self, request: &Request<'_>, observer: &mut impl Observer) -> Result<Segment, StreamError> {
        self.plan_segment(request, true, observer)
    }

    /// The same for the motion's last segment, planned to end there, and [`MotionStream::finish`].
    ///
    /// # Errors
    /// Those of [`MotionStream::plan`].
    pub fn plan_last(&mut self, request: &Request<'_>, observer: &mut impl Observer) -> Result<Segment, StreamError> {
        let segment = self.plan_segment(request, false, observer)?;
        self.finish();
        Ok(segment)
    }

    fn plan_segment(
        &mut self,
        request: &Request<'_>,
        end_open: bool,
        observer: &mut dyn Observer,
    ) -> Result<Segment, StreamError> {
        if self.finished {
            return Err(StreamError::Finished);
        }
        let prompt = match request.source {
            _ if !request.anchors.is_empty() || !request.tracks.is_empty() || !request.obstacles.is_empty() => {
                return Err(StreamError::NotInParts);
            }
            _ if !request.timeline.is_empty() => return Err(StreamError::NotInParts),
            Source::Embeddings(_) => return Err(StreamError::NotInParts),
            Source::Tokens(tokens) => {
                self.push(tokens)?;
                let tokens = tokens.len() / self.memory.quantizers.max(1);
                return Ok(Segment { tokens, heard: PromptStats::default() });
            }
            Source::Text(prompt) => prompt,
        };
        let modules = self.model.planning().ok_or(PlanningError::NoPlanner)?;
        let words = modules.text.rows(&prompt)?;
        let (capacity, room) = (self.memory.capacity(), self.memory.room());
        let (codes, frames_per_token) = (modules.planner.codes(), self.model.frames_per_token());
        let half = u16::try_from(capacity.div_ceil(2).min(room)).unwrap_or(u16::MAX);
        let length = match request.planning.length {
            // Nothing fits: the error below shall say so, not one about lengths.
            Length::Predicted if room == 0 => Length::Tokens(1),
            Length::Predicted => Length::Tokens(half),
            length => length,
        };
        let own = Planning { length, ..request.planning };
        let count = own.check(capacity, codes, frames_per_token)?;
        if count > room {
            return Err(StreamError::QueueFull { found: count, room });
        }

        // The window: what is remembered and fits before the new tokens.
        let context = self.memory.known.min(capacity.saturating_sub(count));
        let before = self.memory.known.saturating_sub(context);
        let mut fixed: Vec<Fixed, { MAX_TOKENS as usize }> = Vec::new();
        let quantizers = modules.quantizers();
        // Of the first quantizer alone: the others follow from it.
        let given = self.memory.get(before, context).iter().step_by(quantizers).enumerate();
        let given = given.map(|(position, &token)| Fixed { position: position as u16, token });
        let later = |f: &Fixed| Fixed { position: f.position.saturating_add(context as u16), ..*f };
        for f in given.chain(own.fixed.iter().map(later)) {
            if fixed.push(f).is_err() {
                return Err(PlanningError::TooManyFixed { found: own.fixed.len(), limit: count }.into());
            }
        }
        let planning = Planning {
            length: Length::Tokens((context + count) as u16),
            seed: own.seed.wrapping_add(self.segment.wrapping_mul(SEED_STEP)),
            fixed: &fixed,
            start_open: self.memory.forgotten || before > 0,
            end_open,
            ..own
        };
        planning.check(capacity, codes, frames_per_token)?;

        let limits = planning::PlanningLimits {
            words,
            steps: planning.steps,
            guided: planning.guided(),
            anchors: false,
            clauses: 1,
        };
        let needed = self.spare.used() + planning_bytes(&modules, capacity, context + count, &limits, self.rows);
        let available = self.spare.available();
        let too_small = |_| Error::Arena(ArenaTooSmall { needed, available });
        if needed > available {
            return Err(Error::Arena(ArenaTooSmall { needed, available }).into());
        }
        let mut arena = self.spare.overlay();
        let window = arena.take::<u16>(capacity * quantizers).map_err(too_small)?;
        let window = part_mut!(window, ..(context + count) * quantizers);
        let (rows, prompt, planning) = (self.rows, &prompt, &planning);
        let task = PlanningTask {
            limits: &limits,
            rows,
            prompt,
            planning,
            shortest: 1,
            capacity: context + count,
            context,
            clause: (0, 1),
            anchors: None,
        };
        let planned = plan_tokens(modules, task, &mut arena, window, observer)?;
        log::debug!("planned {} tokens behind {}", count, context);
        self.memory.push(part!(window, context * quantizers..));
        self.segment = self.segment.wrapping_add(1);
        Ok(Segment { tokens: count, heard: planned.heard })
    }

    /// Says that the motion ends with the tokens queued so far; [`MotionStream::frames`] hands out the rest of it.
    pub const fn finish(&mut self) {
        self.finished = true;
    }

    /// Takes the next few tokens through the decoder and hands out the frames that have become final, at most
    /// [`StreamPlan::frames`] of them and perhaps none. `None`: all tokens have been decoded; after
    /// [`MotionStream::finish`] also all frames handed out.
    ///
    /// The observer is asked before every layer. [`Stop::Finish`](crate::Stop::Finish) is granted by carrying on, since a
    /// chunk ends soon.
    ///
    /// # Errors
    /// [`Error::Aborted`] when the observer says so. Nothing is lost: the next call carries on where this one stopped.
    pub fn frames(&mut self, observer: &mut impl Observer) -> Result<Option<&[Frame]>, StreamError> {
        let decoder = self.model.decoder();
        let codebooks = self.model.codebooks();
        if !self.decoder.waiting() {
            self.chunk = self.memory.queued.min(CHUNK);
            let first = self.memory.known.saturating_sub(self.memory.queued);
            let rows = self.decoder.begin(decoder, self.chunk);
            codebooks.embed(self.memory.get(first, self.chunk), rows)?;
            if self.chunk == 0 {
                if !self.finished {
                    return Ok(None);
                }
                self.decoder.end();
                if self.decoder.ended() {
                    return Ok(None);
                }
            }
        }
        let mut watch = Watch { observer, stage: Stage::Decoding, evaluation: 1, evaluations: 1 };
        let all = channels(u32::MAX);
        let flow = self.decoder.advance(decoder, &all, &mut || watch.ask_at_the_end());
        let ControlFlow::Continue(values) = flow else { return Err(Error::Aborted.into()) };
        let frames = values.len() / all.count().max(1);
        self.memory.queued = self.memory.queued.saturating_sub(self.chunk);
        self.held = (self.held + self.chunk * self.model.frames_per_token()).saturating_sub(frames);

        let recovery = self.model.recovery();
        recovery.integrate_from(Features { values, channels: &all }, &mut self.root, &mut self.path);
        let joints = recovery.joints(values, &self.path);
        if let Some(body) = &self.body {
            bones::pose_by(body, joints);
        }
        let frames = bytemuck::try_cast_slice(joints);
        invariant!(frames.is_ok(), "the joints are no whole frames");
        Ok(Some(frames.unwrap_or(&[])))
    }
}
