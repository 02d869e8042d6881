//! What a request will need, known before it runs: arena bytes by purpose, and multiply-accumulates.

use crate::JOINTS;
use crate::decoding::stream::CHUNK;
use crate::memory::bytes_of;
use crate::model::Model;
use crate::motion::humanml3d::{POSITION_CHANNELS, ROOT_CHANNELS, channels};
use crate::motion::rotations;
use crate::nn::output::Output;
use crate::planning;
use crate::refining::{self, Config};

/// The largest request that is to be served.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Tokens (4 frames each).
    pub tokens: usize,
    /// Anchors; 0 = no refinement.
    pub anchors: usize,
    /// Refinement.
    pub refinement: Config,
    /// Planning from text; `None` for tokens and embeddings.
    pub planning: Option<planning::Limits>,
    /// How much passes through a layer at a time: so many rows of the planner, [`LEAST_ROWS`](crate::LEAST_ROWS) to
    /// [`MOST_ROWS`](crate::MOST_ROWS) (other numbers count as the nearest of these), and of
    /// the decoder half as many tokens more. Weights are read once for so much, and it takes room: the motion is the same, memory
    /// and speed are not.
    pub rows: usize,
}

/// [`Limits::rows`] where nobody says otherwise.
pub const ROWS: usize = 8;

/// Bytes and work of the largest request inside some [`Limits`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plan {
    /// Arena bytes in all, from a 16-byte boundary: exactly what [`crate::Generator`] takes.
    ///
    /// Tokens lie below everything. Planning comes first and leaves nothing else behind: decoding and refinement take its
    /// place, so the larger of the two counts. In the same way what rotations come from takes the solver's place.
    pub arena_bytes: usize,
    /// Of these, bytes of the tokens.
    pub token_bytes: usize,
    /// Bytes of planning by purpose, in the place of what follows.
    pub planning: planning::Bytes,
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
    /// Bytes of what rotations come from, in the place of the solver's.
    pub rotation_bytes: usize,
    /// Decoder evaluations at most, the final one included.
    pub evaluations: u32,
    /// Decoder gradients at most.
    pub gradients: u32,
    /// Multiply-accumulates of planning at most: text read, all steps with all their passes.
    pub planning_macs: u64,
    /// Multiply-accumulates of the final decoding.
    pub decoding_macs: u64,
    /// Multiply-accumulates of one of the solver's evaluations at most; a gradient costs as many.
    pub evaluation_macs: u64,
    /// Multiply-accumulates at most, in all: [`Plan::macs_of`] all evaluations and gradients.
    pub macs: u64,
    /// Tokens on either side that a frame depends on.
    pub radius_tokens: usize,
    /// Frames by which a stream's output lags behind its tokens; the request itself has no such lag.
    pub latency_frames: usize,
}

/// Feature channels that the solver may have to decode for so many anchors.
pub(crate) const fn solver_channels(anchors: usize) -> usize {
    let joints = if anchors < JOINTS - 1 { anchors } else { JOINTS - 1 };
    ROOT_CHANNELS + 3 * joints
}

/// Elements of the buffer for features and their gradient, `frames` times this many.
pub(crate) const fn feature_columns(anchors: usize) -> usize {
    let solver = if anchors == 0 { 0 } else { 2 * solver_channels(anchors) };
    if solver > POSITION_CHANNELS { solver } else { POSITION_CHANNELS }
}

/// Numbers of a frame that rotations are computed from: none if the model's last layer has no such channels.
pub(crate) fn rotation_columns(output: &Output<'_>) -> usize {
    if output.outputs() < rotations::FIRST + rotations::CHANNELS { 0 } else { output.inputs() }
}

impl Plan {
    /// The plan for requests inside `limits`.
    #[must_use]
    pub fn for_request(model: &Model<'_>, limits: &Limits) -> Plan {
        let decoder = model.decoder();
        let tokens = limits.tokens;
        let frames = tokens * decoder.upsampling();
        let gate_bytes = decoder.gate_bytes(tokens);
        let decoder_bytes = decoder.workspace_bytes(tokens, POSITION_CHANNELS, limits.rows) - gate_bytes;
        let columns = rotation_columns(decoder.output());
        let rotation_bytes = bytes_of::<i16>(frames * columns) + bytes_of::<f32>(if columns > 0 { frames } else { 0 });
        let feature_bytes = bytes_of::<f32>(frames * feature_columns(limits.anchors));
        let path_bytes = 7 * bytes_of::<f32>(frames);
        let embedding_bytes = bytes_of::<f32>(tokens * decoder.code_width());
        let (mut solver_bytes, mut steps) = (0, 0);
        if limits.anchors > 0 {
            let scratch = refining::scratch_len(tokens, decoder.code_width(), limits.anchors, &limits.refinement);
            solver_bytes = bytes_of::<f32>(scratch);
            steps = u32::from(limits.refinement.evaluations);
        }
        let token_bytes = bytes_of::<u16>(tokens * model.codebooks().quantizers());
        let (mut planning, mut planning_macs) = (planning::Bytes::default(), 0);
        if let (Some(planned), Some(modules)) = (&limits.planning, model.planning()) {
            planning = modules.bytes(tokens, planned, limits.rows);
            planning_macs = modules.macs(tokens, planned);
        }
        let refining = if solver_bytes > rotation_bytes { solver_bytes } else { rotation_bytes };
        let rest = gate_bytes + decoder_bytes + feature_bytes + path_bytes + embedding_bytes + refining;
        let whole = decoder.macs(tokens, &channels(u32::MAX), limits.rows);
        // The most expensive choice of joints: as many as there are anchors, from the first on.
        let mask = (1u64 << (1 + if limits.anchors < JOINTS { limits.anchors } else { JOINTS })) - 1;
        let partial = decoder.macs(tokens, &channels(mask as u32), limits.rows);
        let plan = Plan {
            arena_bytes: token_bytes + if planning.all() > rest { planning.all() } else { rest },
            token_bytes,
            planning,
            gate_bytes,
            decoder_bytes,
            feature_bytes,
            path_bytes,
            embedding_bytes,
            solver_bytes,
            rotation_bytes,
            evaluations: steps + 1,
            gradients: steps,
            planning_macs,
            decoding_macs: whole,
            evaluation_macs: partial,
            macs: 0,
            radius_tokens: decoder.radius_tokens(),
            latency_frames: decoder.radius_frames(),
        };
        Plan { macs: plan.macs_of(steps, steps), ..plan }
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
    pub planning: Option<planning::Limits>,
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
    /// Tokens on either side that a frame depends on.
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
    #[must_use]
    pub fn new(model: &Model<'_>, limits: &StreamLimits) -> StreamPlan {
        let decoder = model.decoder();
        let frames = CHUNK * model.frames_per_token();
        let state_bytes = decoder.tail_bytes();
        let decoder_bytes = decoder.stream_bytes(POSITION_CHANNELS).saturating_sub(state_bytes);
        let path_bytes = 4 * bytes_of::<f32>(frames);
        let token_bytes = bytes_of::<u16>(limits.tokens * model.codebooks().quantizers());
        let (mut planning_bytes, mut planning_macs) = (0, 0);
        if let (Some(planning), Some(modules)) = (&limits.planning, model.planning()) {
            planning_bytes = bytes_of::<u16>(limits.tokens) + modules.bytes(limits.tokens, planning, limits.rows).all();
            planning_macs = modules.macs(limits.tokens, planning);
        }
        let token_macs = decoder.stream_macs(CHUNK, &channels(u32::MAX));
        StreamPlan {
            arena_bytes: state_bytes + decoder_bytes + path_bytes + token_bytes + planning_bytes,
            state_bytes,
            decoder_bytes,
            path_bytes,
            token_bytes,
            planning_bytes,
            frames,
            radius_tokens: decoder.radius_tokens(),
            latency_frames: decoder.radius_frames(),
            planning_macs,
            frames_macs: CHUNK as u64 * token_macs,
            token_macs,
        }
    }
}
