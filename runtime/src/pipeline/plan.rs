//! What a request will need, known before it runs: arena bytes by purpose, and multiply-accumulates.

use crate::JOINTS;
use crate::codec::vq::stream::CHUNK;
use crate::generation::tokens as planning;
use crate::generation::tokens::request::MAX_STEPS;
use crate::generation::tokens::session::Modules;
use crate::memory::Arena;
use crate::model::Model;
use crate::pipeline::buffers::{self, Decoding};
use crate::pipeline::{stream, timeline};
use crate::refining::motion_space::Exact;
use crate::refining::{self, Config};
use crate::representation::humanml3d::channels;
use crate::request::conditions::MAX_ANCHORS;

/// The largest request that is to be served.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Tokens.
    pub tokens: usize,
    /// Distinct anchors.
    pub anchors: usize,
    /// Joints with rows at many frames: those of tracks, beside tracks or obstacles those of anchors, and with obstacles those that lead the
    /// figure out, six at most; a head without another joint of the trunk counts twice, for trunk and neck. 22 is enough for whatever is asked for, 0 without tracks and obstacles.
    pub tracked: usize,
    /// Spans of a timeline; `None` without any.
    pub timeline: Option<TimelineLimits>,
    /// How anchors and the others are met, and whether feet stay where they stand.
    pub refinement: Config,
    /// Planning from text; `None` for tokens and embeddings.
    pub planning: Option<planning::PlanningLimits>,
    /// How much passes through a layer at a time: so many rows of the planner, [`LEAST_ROWS`](crate::LEAST_ROWS) to
    /// [`MOST_ROWS`](crate::MOST_ROWS) (other numbers count as the nearest of these), and of
    /// the decoder half as many tokens more. Weights are read once for so much, and it takes room: the motion is the same, memory
    /// and speed are not.
    pub rows: usize,
}

/// The largest timeline that is to be served.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimelineLimits {
    /// Directions of bones that its spans keep in all: for each of their frames [`BodyParts::directions`](crate::BodyParts::directions). 17 a
    /// frame of the motion is enough for whatever is asked for.
    pub directions: u32,
    /// Tokens of the longest span.
    pub tokens: u16,
    /// Words of the longest prompt of a span, or rows of a stored one.
    pub words: u16,
    /// Steps of the sampler.
    pub steps: u16,
    /// Spans.
    pub spans: u8,
    /// Whether guidance is on.
    pub guided: bool,
}

impl TimelineLimits {
    /// No span.
    pub(crate) const NONE: Self =
        TimelineLimits { directions: 0, tokens: 0, words: 0, steps: 0, spans: 0, guided: false };
}

/// [`Limits::rows`] where nobody says otherwise.
pub const ROWS: usize = 8;

/// Bytes and work of the largest request inside some [`Limits`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plan {
    /// Arena bytes in all, from a 16-byte boundary: exactly what [`crate::Generator`] takes.
    ///
    /// Tokens lie below everything. Planning comes first and leaves nothing else behind: decoding and refinement take its
    /// place, so the larger of the two counts. In the same way the edit in motion space takes the solver's place.
    pub arena_bytes: usize,
    /// Of these, bytes of the tokens.
    pub token_bytes: usize,
    /// Bytes of what a timeline's spans keep.
    pub timeline_bytes: usize,
    /// Bytes of planning by purpose, in the place of what follows; the spans' motions, where they need more, come before it in the same place.
    pub planning: planning::PlanningBytes,
    /// Bytes of the decoder's layers that grow with the motion: a bit for each ReLU.
    pub gate_bytes: usize,
    /// Bytes of the decoder's layers that do not grow with a motion of more than a chunk.
    pub decoder_bytes: usize,
    /// Bytes of the features and their gradient (the finished joints lie there too).
    pub feature_bytes: usize,
    /// Bytes of the root path and its gradient.
    pub path_bytes: usize,
    /// Bytes of the token embeddings.
    pub embedding_bytes: usize,
    /// Bytes of the solver.
    pub solver_bytes: usize,
    /// Bytes of the edit in motion space, in the place of the solver's.
    pub edit_bytes: usize,
    /// Decoder evaluations at most, the final one included.
    pub evaluations: u32,
    /// Decoder gradients at most.
    pub gradients: u32,
    /// Multiply-accumulates of planning at most: text read, all steps with all their passes; the motions of all spans.
    pub planning_macs: u64,
    /// Multiply-accumulates of the final decoding.
    pub decoding_macs: u64,
    /// Multiply-accumulates of one of the solver's evaluations at most; a gradient costs as many.
    pub evaluation_macs: u64,
    /// Multiply-accumulates at most, in all: [`Plan::macs_of`] all evaluations and gradients.
    pub macs: u64,
    /// Tokens behind its own that a frame depends on.
    pub radius_tokens: usize,
    /// Frames by which a stream's output lags behind its tokens; the request itself has no such lag.
    pub latency_frames: usize,
}

impl Plan {
    /// The plan for requests inside `limits`.
    ///
    /// # Errors
    /// [`PlanError`] when the model makes no such motions.
    // Its own frame: what is measured is not to lie on the stack while motions are made.
    #[inline(never)]
    pub fn for_request(model: &Model<'_>, limits: &Limits) -> Result<Plan, PlanError> {
        limits.check(model)?;
        let decoder = model.decoder();
        let token_bytes = Arena::measure(|arena| buffers::tokens(model, limits, arena));
        let solver_bytes = Arena::measure(|arena| buffers::solver(model, limits, arena));
        let edit_bytes = Arena::measure(|arena| buffers::edit(model, limits, arena));
        let mut arena = Arena::measuring();
        let taken = Decoding::take(model, limits, &mut arena);
        invariant!(taken.is_ok(), "an arena that measures refuses nothing");
        let decoding = taken.map_or(buffers::DecodingBytes::default(), |taken| taken.bytes);
        let (mut planning, mut planning_macs) = (planning::PlanningBytes::default(), 0);
        if let (Some(planned), Some(modules)) = (&limits.planning, model.planning()) {
            planning = modules.bytes(limits.tokens, planned, limits.rows);
            planning_macs = modules.macs(limits.tokens, planned);
        }
        let behind = arena.used().saturating_add(if solver_bytes > edit_bytes { solver_bytes } else { edit_bytes });
        let most = if planning.all() > behind { planning.all() } else { behind };
        let mut arena_bytes = token_bytes.saturating_add(most);
        let mut timeline_bytes = 0;
        if let (true, Some(timeline)) = (cfg!(feature = "timeline"), &limits.timeline) {
            timeline_bytes = Arena::measure(|arena| timeline::directions(limits, arena));
            let span = Plan::for_request(model, &timeline.of_span(limits.rows))?;
            let of_span = token_bytes.saturating_add(span.arena_bytes);
            arena_bytes = timeline_bytes.saturating_add(if of_span > arena_bytes { of_span } else { arena_bytes });
            planning_macs += u64::from(timeline.spans) * span.macs;
        }
        if arena_bytes == usize::MAX {
            return Err(PlanError::TooLarge);
        }
        let steps = if limits.anchors > 0 { u32::from(limits.refinement.evaluations) } else { 0 };
        // The most expensive choice of joints: as many as the objective may read, from the first on.
        let mask = (1u64 << (1 + refining::most_joints(limits.anchors))) - 1;
        let plan = Plan {
            arena_bytes,
            token_bytes,
            timeline_bytes,
            planning,
            gate_bytes: decoding.gates,
            decoder_bytes: decoding.decoder,
            feature_bytes: decoding.features,
            path_bytes: decoding.path,
            embedding_bytes: decoding.embeddings,
            solver_bytes,
            edit_bytes,
            evaluations: steps + 1,
            gradients: steps,
            planning_macs,
            decoding_macs: decoder.macs(limits.tokens, &channels(u32::MAX), limits.rows),
            evaluation_macs: decoder.macs(limits.tokens, &channels(mask as u32), limits.rows),
            macs: 0,
            radius_tokens: decoder.radius_tokens(),
            latency_frames: decoder.radius_frames(),
        };
        Ok(Plan { macs: plan.macs_of(steps, steps), ..plan })
    }

    /// Multiply-accumulates at most of a request whose solver makes so many evaluations and gradients, as its
    /// [`refining::Report`] counts them.
    #[must_use]
    pub const fn macs_of(&self, evaluations: u32, gradients: u32) -> u64 {
        let passes = evaluations as u64 + gradients as u64;
        self.planning_macs + self.decoding_macs + passes * self.evaluation_macs
    }
}

/// The largest stream that is to be served.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamLimits {
    /// Tokens that the stream remembers: as many can be queued at once, and as many the planner sees, those that the
    /// motion goes on from and the new ones together.
    pub tokens: usize,
    /// Planning of segments; `None` when all tokens are given.
    pub planning: Option<planning::PlanningLimits>,
    /// Rows of the planner that pass through a layer at a time, as [`Limits::rows`]; the decoder takes what it gets.
    pub rows: usize,
}

/// Bytes and work of a stream, however long its motion runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamPlan {
    /// Arena bytes in all, from a 16-byte boundary: exactly what a [`crate::MotionStream`] takes.
    pub arena_bytes: usize,
    /// Of these, bytes that the decoder keeps from one chunk to the next.
    pub state_bytes: usize,
    /// Bytes of the decoder's other buffers.
    pub decoder_bytes: usize,
    /// Bytes of the root path of the frames that are handed out.
    pub path_bytes: usize,
    /// Bytes of the tokens.
    pub token_bytes: usize,
    /// Bytes of planning a segment, in use only while it is planned.
    pub planning_bytes: usize,
    /// Frames handed out at once, at most.
    pub frames: usize,
    /// Tokens behind its own that a frame depends on.
    pub radius_tokens: usize,
    /// Frames by which the output lags behind the tokens.
    pub latency_frames: usize,
    /// Multiply-accumulates of planning a segment, at most.
    pub planning_macs: u64,
    /// Multiply-accumulates of one call of [`crate::MotionStream::frames`], at most, whatever it is called for.
    pub frames_macs: u64,
    /// Multiply-accumulates of decoding a token, when they come in full chunks.
    pub token_macs: u64,
}

impl StreamPlan {
    /// The plan for streams inside `limits`.
    ///
    /// # Errors
    /// [`PlanError`] when the model makes no such streams.
    #[inline(never)]
    pub fn new(model: &Model<'_>, limits: &StreamLimits) -> Result<StreamPlan, PlanError> {
        check_tokens(model, limits.tokens)?;
        let decoder = model.decoder();
        let (mut token_bytes, mut path_bytes, mut arena) = (0, 0, Arena::measuring());
        if let Ok(taken) = stream::Buffers::take(model, limits, &mut arena) {
            (token_bytes, path_bytes) = (taken.token_bytes, taken.path_bytes);
        }
        let state_bytes = decoder.tail_bytes();
        let decoder_bytes = arena.used() - token_bytes - path_bytes - state_bytes;
        let (mut planning_bytes, mut planning_macs) = (0, 0);
        if let Some(planning) = &limits.planning {
            let modules = check_planning(model, planning)?;
            planning_bytes = stream::planning_bytes(&modules, limits.tokens, limits.tokens, planning, limits.rows);
            planning_macs = modules.macs(limits.tokens, planning);
        }
        let arena_bytes = arena.used().saturating_add(planning_bytes);
        if arena_bytes == usize::MAX {
            return Err(PlanError::TooLarge);
        }
        let token_macs = decoder.stream_macs(CHUNK, &channels(u32::MAX));
        Ok(StreamPlan {
            arena_bytes,
            state_bytes,
            decoder_bytes,
            path_bytes,
            token_bytes,
            planning_bytes,
            frames: CHUNK * model.frames_per_token(),
            radius_tokens: decoder.radius_tokens(),
            latency_frames: decoder.radius_frames(),
            planning_macs,
            frames_macs: CHUNK as u64 * token_macs,
            token_macs,
        })
    }
}

/// Why there is no plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PlanError {
    /// A motion needs at least one token and at most `limit`.
    Tokens {
        /// Tokens of the limits.
        found: usize,
        /// Most tokens that the model allows.
        limit: usize,
    },
    /// More anchors than a request may have.
    Anchors {
        /// Anchors of the limits.
        found: usize,
        /// Most of them.
        limit: usize,
    },
    /// More joints with rows than a body has.
    Tracked {
        /// Joints of the limits.
        found: usize,
        /// Joints of the body.
        limit: usize,
    },
    /// A prompt needs at least one word and at most `limit`.
    Words {
        /// Words of the limits.
        found: usize,
        /// Most words that the model reads.
        limit: usize,
    },
    /// A sampler needs at least one step and at most `limit`.
    Steps {
        /// Steps of the limits.
        found: u16,
        /// Most of them.
        limit: u16,
    },
    /// Tokens are to be planned by a model without a planner.
    NoPlanner,
    /// The request needs a family that was left out of this firmware: build it with the cargo feature.
    NotLinked {
        /// The feature of this crate.
        feature: &'static str,
    },
    /// More bytes than this machine has addresses.
    TooLarge,
}

impl core::fmt::Display for PlanError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            PlanError::Tokens { found, limit } => write!(f, "a plan for {found} tokens: the model makes 1 to {limit}"),
            PlanError::Anchors { found, limit } => {
                write!(f, "a plan for {found} anchors: a request has at most {limit}")
            }
            PlanError::Tracked { found, limit } => {
                write!(f, "a plan for {found} joints with tracks: a body has {limit}")
            }
            PlanError::Words { found, limit } => write!(f, "a plan for {found} words: the model reads 1 to {limit}"),
            PlanError::Steps { found, limit } => write!(f, "a plan for {found} steps: a sampler takes 1 to {limit}"),
            PlanError::NotLinked { feature } => {
                write!(f, "the request needs cargo feature {feature}, which this firmware was built without")
            }
            PlanError::NoPlanner => write!(f, "the model has no planner: it cannot make tokens from text"),
            PlanError::TooLarge => write!(f, "the plan needs more bytes than this machine can address"),
        }
    }
}

impl core::error::Error for PlanError {}

fn check_tokens(model: &Model<'_>, found: usize) -> Result<(), PlanError> {
    let limit = model.max_tokens();
    if found == 0 || found > limit { Err(PlanError::Tokens { found, limit }) } else { Ok(()) }
}

fn check_planning<'m, 'b>(
    model: &'m Model<'b>,
    planning: &planning::PlanningLimits,
) -> Result<Modules<'m, 'b>, PlanError> {
    let modules = model.planning().ok_or(PlanError::NoPlanner)?;
    let (words, steps) = (planning.words, planning.steps);
    let limit = modules.text.max_words();
    if (words == 0 && !modules.text.takes_vectors()) || words > limit {
        return Err(PlanError::Words { found: words, limit });
    }
    if steps == 0 || steps > MAX_STEPS {
        return Err(PlanError::Steps { found: steps, limit: MAX_STEPS });
    }
    Ok(modules)
}

impl Limits {
    /// Whether token embeddings are bent onto anchors.
    pub(crate) const fn bends(&self) -> bool {
        self.anchors > 0 && self.refinement.bends()
    }

    /// How decoded motions are edited: onto anchors, or for the feet alone.
    pub(crate) fn edits(&self) -> Option<Exact> {
        let asked = self.anchors > 0 || self.tracked > 0;
        let exact = self.refinement.exact.filter(|exact| asked || exact.planted);
        exact.filter(|_| cfg!(feature = "editing"))
    }

    fn check(&self, model: &Model<'_>) -> Result<(), PlanError> {
        check_tokens(model, self.tokens)?;
        if self.anchors > 0 && !cfg!(feature = "editing") {
            return Err(PlanError::NotLinked { feature: "editing" });
        }
        if self.bends() && !cfg!(feature = "refining") {
            return Err(PlanError::NotLinked { feature: "refining" });
        }
        if self.tracked > 0 && !cfg!(feature = "tracks") {
            return Err(PlanError::NotLinked { feature: "tracks" });
        }
        if self.timeline.is_some() && !cfg!(feature = "timeline") {
            return Err(PlanError::NotLinked { feature: "timeline" });
        }
        if self.tracked > JOINTS {
            return Err(PlanError::Tracked { found: self.tracked, limit: JOINTS });
        }
        if self.anchors > MAX_ANCHORS {
            return Err(PlanError::Anchors { found: self.anchors, limit: MAX_ANCHORS });
        }
        self.planning.as_ref().map_or(Ok(()), |planning| check_planning(model, planning).map(|_| ()))
    }
}
