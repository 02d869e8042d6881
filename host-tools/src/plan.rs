//! What a blob and a request need, before anything is flashed: arena, flash, work.

use motionette::blob::{DType, HEADER_LEN};
use motionette::generation::tokens as planning;
use motionette::playback::queue::queue_bytes;
use motionette::playback::robot::MAX_CHANNELS;
use motionette::playback::{Feeder, Player, Robot};
use motionette::refining::Config;
use motionette::representation::posture::DIRECTIONS;
use motionette::{Generator, Limits, Model, MotionStream, Plan, PlanError, StreamLimits, StreamPlan, TimelineLimits};
use motionette::{LEAST_ROWS, MOST_ROWS};
use serde::Serialize;

use crate::blob::{self, BlobFile};
use crate::inspect::{layer_macs, rows_of_layers};

/// Why there is no plan.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The blob was refused.
    #[error(transparent)]
    Blob(#[from] blob::Error),
    /// The model makes no such motions.
    #[error(transparent)]
    Plan(#[from] PlanError),
}

/// A named number of bytes or multiply-accumulates.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Share {
    /// What it is for.
    pub name: String,
    /// How much.
    pub amount: u64,
}

/// The planning stage of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Planning {
    /// Words of the prompt.
    pub words: usize,
    /// Steps of the sampler.
    pub steps: u16,
    /// Whether guidance is on, which doubles the passes.
    pub guided: bool,
    /// Whether the planner sees anchors.
    pub conditioned: bool,
    /// How often the weights of the planner's layers are read from flash: once for so many rows of a pass, of the motion's and of its spans'.
    pub reads: usize,
    /// Arena bytes; decoding and refinement take the same place afterwards.
    pub bytes: usize,
    /// These by purpose; the sum is `bytes`.
    pub arena: Vec<Share>,
    /// Multiply-accumulates at most, with the motions of a timeline's spans.
    pub macs: u64,
}

/// A stream that remembers as many tokens as the largest request has.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stream {
    /// Tokens behind its own that a frame depends on.
    pub radius_tokens: usize,
    /// Frames by which the output lags behind the tokens.
    pub latency_frames: usize,
    /// The same in seconds of motion.
    pub latency_seconds: f64,
    /// Whether feet stay where they stand: never, since the end of a stance would have to be known before its beginning is played.
    pub planted_feet: bool,
    /// Arena bytes, exactly, however long the motion runs; the object comes on top.
    pub arena_bytes: usize,
    /// The arena by purpose; the sum is `arena_bytes`.
    pub arena: Vec<Share>,
    /// Bytes of the stream object on a 64-bit machine; a 32-bit one needs less.
    pub object_bytes: usize,
    /// Multiply-accumulates of decoding a token.
    pub token_macs: u64,
    /// Multiply-accumulates of planning a segment, at most.
    pub planning_macs: u64,
}

/// A robot that plays the motions. Bytes are those of a 64-bit machine; a 32-bit one needs less.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Playback {
    /// Name of the robot.
    pub robot: String,
    /// Its servo channels, `C`.
    pub channels: usize,
    /// Frames of the longest motion; the line's `N` is three more.
    pub frames: usize,
    /// Bytes of `MotionQueue<C, N>`, which holds a whole motion.
    pub queue_bytes: usize,
    /// Bytes of `Feeder<C>`.
    pub feeder_bytes: usize,
    /// Bytes of `Player<C>`.
    pub player_bytes: usize,
}

/// Memory that playing motions of up to `frames` frames on `robot` takes, beside the robot itself.
#[must_use]
pub fn playback(robot: &Robot, frames: usize) -> Playback {
    let channels = robot.channels.len();
    let [feeder_bytes, player_bytes] = ends_bytes(channels);
    let queue_bytes = queue_bytes(channels, frames);
    Playback { robot: robot.name.to_string(), channels, frames, queue_bytes, feeder_bytes, player_bytes }
}

/// Sizes of the ends of a line of so many channels, at most [`MAX_CHANNELS`].
fn ends_bytes(channels: usize) -> [usize; 2] {
    macro_rules! ends_of {
        ($($c:literal)*) => {
            [$([size_of::<Feeder<'_, $c>>(), size_of::<Player<'_, $c>>()]),*]
        };
    }
    let sizes: [[usize; 2]; MAX_CHANNELS + 1] =
        ends_of!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32);
    sizes[channels.min(MAX_CHANNELS)]
}

/// Everything `motionette plan` shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Name of the model.
    pub model: String,
    /// Tokens of the largest request.
    pub tokens: usize,
    /// Frames of the largest request.
    pub frames: usize,
    /// Anchors of the largest request.
    pub anchors: usize,
    /// Joints of the largest request that have rows at many frames, for tracks and obstacles.
    pub tracked: usize,
    /// Spans of the largest request's timeline, each as long as the motion.
    pub spans: usize,
    /// Rows that pass through a layer at a time.
    pub rows: usize,
    /// Planning of the largest request; `None` for requests that bring their tokens, or without a planner.
    pub planning: Option<Planning>,
    /// Decoder evaluations of the solver at most.
    pub solver_evaluations: u16,
    /// Arena bytes, exactly.
    pub arena_bytes: usize,
    /// Arena and generator object: all that the runtime owns beside its code. The object is that of a 64-bit machine; a 32-bit one
    /// needs less.
    pub ram_bytes: usize,
    /// The arena by purpose; the sum is `arena_bytes`.
    pub arena: Vec<Share>,
    /// Bytes of what the spans of a timeline keep while the motion is made.
    pub timeline_bytes: usize,
    /// Bytes of the edit behind the decoder, in the place of the solver's.
    pub edit_bytes: usize,
    /// Bytes of the blob.
    pub flash_bytes: usize,
    /// The blob by section; the sum is `flash_bytes`.
    pub flash: Vec<Share>,
    /// Decoder evaluations at most, the final one included.
    pub evaluations: u32,
    /// Decoder gradients at most.
    pub gradients: u32,
    /// Multiply-accumulates at most.
    pub macs: u64,
    /// One forward pass over all channels by stage.
    pub decoder_macs: Vec<Share>,
    /// The same tokens, and no end of further ones, as a stream.
    pub stream: Stream,
    /// Motion hash of the blob's self-test.
    pub self_test: String,
}

/// Plans the largest request of `tokens` tokens, `anchors` anchors, `tracked` joints with rows at many frames and `spans` spans of a timeline. `tokens`, and
/// the words of `planning`, are cut to what the model allows; a model without a planner plans nothing.
///
/// # Errors
/// [`Error`].
pub fn plan(
    blob: &BlobFile,
    tokens: usize,
    (anchors, tracked, spans): (usize, usize, usize),
    refinement: Config,
    planning: Option<planning::PlanningLimits>,
    rows: usize,
) -> Result<Report, Error> {
    let model = blob.model()?;
    let (tokens, rows) = (tokens.clamp(1, model.max_tokens()), rows.clamp(LEAST_ROWS, MOST_ROWS));
    let planning = planning.filter(|_| model.planning().is_some()).map(|limits| {
        let most = model.text().map_or(1, |t| t.max_words());
        let anchors = limits.anchors && anchors + tracked > 0 && model.control().is_some();
        let words = if model.vector_width().is_some() { 0 } else { limits.words.clamp(1, most) };
        planning::PlanningLimits { words, anchors, ..limits }
    });
    // A model without a planner makes none.
    let spans = if planning.is_some() { spans } else { 0 };
    let timeline = planning.filter(|_| spans > 0).map(|limits| TimelineLimits {
        directions: (DIRECTIONS * tokens * model.frames_per_token()) as u32,
        tokens: tokens as u16,
        words: limits.words as u16,
        steps: limits.steps,
        spans: spans as u8,
        guided: limits.guided,
    });
    let plan = Plan::for_request(&model, &Limits { tokens, anchors, tracked, timeline, refinement, planning, rows })?;
    let share = |name: &str, amount: usize| Share { name: name.to_owned(), amount: amount as u64 };
    let mut arena = vec![
        share("tokens", plan.token_bytes),
        share("decoder layers", plan.decoder_bytes),
        share("decoder, bits for the gradient", plan.gate_bytes),
        share("features and gradient, joints", plan.feature_bytes),
        share("root path and gradient", plan.path_bytes),
        share("token embeddings", plan.embedding_bytes),
        share("solver, or edit", plan.solver_bytes.max(plan.edit_bytes)),
    ];
    if plan.timeline_bytes > 0 {
        arena.push(share("timeline", plan.timeline_bytes));
    }
    // Planning comes first and leaves its place to everything but the tokens.
    let rest: u64 = arena.iter().map(|s| s.amount).sum();
    if planning.is_some() {
        arena.push(share("planning, beyond the others", plan.arena_bytes - rest as usize));
    }
    Ok(Report {
        model: model.card().name.to_owned(),
        tokens,
        frames: tokens * model.frames_per_token(),
        anchors,
        tracked,
        spans,
        rows,
        planning: planning.map(|limits| Planning {
            words: limits.words,
            steps: limits.steps,
            guided: limits.guided,
            conditioned: limits.anchors,
            reads: (1 + spans)
                * match model.planner() {
                    Some(planner) if planner.in_turn() => 1 + tokens,
                    _ => usize::from(limits.steps) * (1 + usize::from(limits.guided)) * (1 + tokens).div_ceil(rows),
                },
            bytes: plan.planning.all(),
            arena: vec![
                share("text, keys and values", plan.planning.text),
                share("anchors, keys and values", plan.planning.anchors),
                share("rows and proposals", plan.planning.rows),
                share("a pass, then drawing tokens", plan.planning.working()),
            ],
            macs: plan.planning_macs,
        }),
        solver_evaluations: if anchors > 0 { refinement.evaluations } else { 0 },
        arena_bytes: plan.arena_bytes,
        ram_bytes: plan.arena_bytes + size_of::<Generator<'_>>(),
        arena,
        timeline_bytes: plan.timeline_bytes,
        edit_bytes: plan.edit_bytes,
        flash_bytes: blob.bytes().len(),
        flash: flash(blob)?,
        evaluations: plan.evaluations,
        gradients: plan.gradients,
        macs: plan.macs,
        decoder_macs: stages(blob, tokens)?,
        // A stream has no anchors.
        stream: stream(
            &model,
            &StreamLimits {
                tokens,
                planning: planning.map(|p| planning::PlanningLimits { anchors: false, ..p }),
                rows,
            },
        )?,
        self_test: format!("{:016x}", model.self_test().hash),
    })
}

/// Tensors of words with vectors.
const WORDS: [&str; 3] = ["text.words", "text.vectors", "text.scales"];

fn stream(model: &Model<'_>, limits: &StreamLimits) -> Result<Stream, Error> {
    let plan = StreamPlan::new(model, limits)?;
    let share = |name: &str, amount: usize| Share { name: name.to_owned(), amount: amount as u64 };
    Ok(Stream {
        radius_tokens: plan.radius_tokens,
        latency_frames: plan.latency_frames,
        latency_seconds: plan.latency_frames as f64 / f64::from(model.frame_rate()),
        planted_feet: false,
        arena_bytes: plan.arena_bytes,
        arena: vec![
            share("tokens", plan.token_bytes),
            share("decoder state", plan.state_bytes),
            share("decoder layers", plan.decoder_bytes),
            share("root path", plan.path_bytes),
            share("planning", plan.planning_bytes),
        ],
        object_bytes: size_of::<MotionStream<'_, '_>>(),
        token_macs: plan.token_macs,
        planning_macs: plan.planning_macs,
    })
}

fn flash(blob: &BlobFile) -> Result<Vec<Share>, Error> {
    let header = blob.parts()?.header;
    let names = [
        "header",
        "manifest",
        "mean and std",
        "codebooks",
        "int8 weights",
        "int16 weights",
        "scales and biases",
        "text encoder",
        "stored prompts",
        "planner",
        "anchor control",
        "planner, 4-bit weights",
        "words with their vectors",
        "residual planner",
    ];
    let mut amounts = [0; 14];
    amounts[..2].copy_from_slice(&[HEADER_LEN, header.manifest_len as usize]);
    for (index, t) in blob.table()?.into_iter().enumerate() {
        let section = match t.dtype {
            _ if WORDS.contains(&t.name.as_str()) => 12,
            _ if t.name.starts_with("text.") => 7,
            _ if t.name.starts_with("bank.") => 8,
            DType::I4 => 11,
            _ if t.name.starts_with("residual.") => 13,
            _ if t.name.starts_with("planner.") => 9,
            _ if t.name.starts_with("control.") => 10,
            DType::F32 if index < 2 => 2,
            DType::F16 => 3,
            DType::I8 => 4,
            DType::I16Planes => 5,
            DType::F32 | DType::U32 => 6,
        };
        amounts[section] += t.bytes;
    }
    let padding = blob.bytes().len() - amounts.iter().sum::<usize>();
    let mut shares: Vec<Share> = names
        .iter()
        .zip(amounts)
        .filter(|(_, amount)| *amount > 0)
        .map(|(n, a)| Share { name: (*n).to_owned(), amount: a as u64 })
        .collect();
    shares.push(Share { name: "alignment".to_owned(), amount: padding as u64 });
    Ok(shares)
}

/// Multiply-accumulates of a forward pass by stage of the decoder ("decoder.model.2", ...).
fn stages(blob: &BlobFile, tokens: usize) -> Result<Vec<Share>, Error> {
    let manifest = blob.parts()?.manifest;
    let d = manifest.codec.decoder();
    let rows = rows_of_layers(tokens, usize::from(d.stages), d.dilations.len());
    let mut shares: Vec<Share> = Vec::new();
    for (layer, rows) in blob.layers()?.iter().zip(rows) {
        let name: Vec<&str> = layer.name.split('.').take(3).collect();
        let (name, amount) = (name.join("."), layer_macs(layer, rows));
        match shares.last_mut().filter(|s| s.name == name) {
            Some(last) => last.amount += amount,
            None => shares.push(Share { name, amount }),
        }
    }
    Ok(shares)
}

/// Rust constants for a firmware that embeds the blob: sizes that the compiler checks, and a place in flash that is aligned.
#[must_use]
pub fn model_rs(report: &Report, blob_path: &str) -> String {
    let Report {
        model,
        tokens,
        frames,
        anchors,
        tracked,
        spans,
        rows,
        solver_evaluations,
        arena_bytes,
        flash_bytes,
        macs,
        self_test,
        ..
    } = report;
    let planning = report.planning.as_ref().map_or_else(String::new, |p| {
        let Planning { words, steps, guided, conditioned, .. } = p;
        format!(
            r#"/// Largest request: words of the prompt.
pub const WORDS: usize = {words};
/// Largest request: steps of the planner.
pub const STEPS: u16 = {steps};
/// Largest request: whether guidance may be on.
pub const GUIDED: bool = {guided};
/// Largest request: whether anchors may condition the planner.
pub const CONDITIONED: bool = {conditioned};
"#
        )
    });
    let path = blob_path.replace('\\', "/");
    format!(
        r#"// Generated by `motionette plan`; generate it again when the blob changes.

/// Name of the model.
pub const MODEL_NAME: &str = {model:?};
/// Bytes of the blob.
pub const BLOB_BYTES: usize = {flash_bytes};
/// Hash of the blob's self-test motion.
pub const SELF_TEST_HASH: u64 = 0x{self_test};
/// Largest request these figures hold for: tokens.
pub const TOKENS: usize = {tokens};
/// Largest request: frames.
pub const FRAMES: usize = {frames};
/// Largest request: anchors.
pub const ANCHORS: usize = {anchors};
/// Largest request: joints with rows at many frames, for tracks and obstacles.
pub const TRACKED: usize = {tracked};
/// Largest request: spans of a timeline, each as long as the motion.
pub const SPANS: usize = {spans};
/// Largest request: decoder evaluations of the solver.
pub const EVALUATIONS: u16 = {solver_evaluations};
/// Rows at a time, which the generator is to be told where they are not 8: `generator.set_rows(ROWS)`.
pub const ROWS: usize = {rows};
{planning}/// Arena bytes that such a request takes, exactly.
pub const ARENA_BYTES: usize = {arena_bytes};
/// Multiply-accumulates that it takes at most.
pub const MACS: u64 = {macs};

/// Bytes on the boundary that the runtime asks for.
#[repr(C, align(16))]
pub struct Aligned<const N: usize>(pub [u8; N]);

/// The blob, in flash.
pub static BLOB: Aligned<BLOB_BYTES> = Aligned(*include_bytes!({path:?}));
"#
    )
}
