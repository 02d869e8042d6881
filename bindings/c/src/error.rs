//! Results: an error code, the numbers that explain it, and a sentence for each.

use core::ffi::{CStr, c_char};

use motionette::AnchorError;
use motionette::PlanningError;
use motionette::PromptError;
use motionette::refining::SolverError;
use motionette::{Error, FARTHEST, LEAST_SPAN, ObstacleError, TimelineError, TrackError, blob};

use crate::pointer::clamped;

/// What went wrong. The numbers of `mtn_result` that a code sets stand beside it; the others are 0.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum mtn_error {
    /// Nothing.
    None = 0,
    /// A pointer is null. `index`: the argument, from 0; pointers inside a request count as it.
    NullPointer = 1,
    /// A pointer is not aligned. `index`: the argument; `found`: its remainder; `limit`: alignment, bytes.
    Misaligned = 2,
    /// A length runs over the end of the address space. `index`: the argument; `found`: the length.
    Length = 3,
    /// Model or generator was never opened, could not be opened, or is a copy. `index`: the argument.
    NotOpened = 4,
    /// The generator is at work: a callback used it. `index`: the argument.
    Busy = 5,

    /// The blob does not begin on a 16-byte boundary. `found`: remainder; `limit`: 16.
    BlobMisaligned = 10,
    /// Too few bytes: the blob was cut short. `found`: bytes there are; `limit`: bytes needed.
    BlobTruncated = 11,
    /// This is no blob. `found`: its first four bytes; `limit`: those of a blob, both read as little-endian numbers.
    NotABlob = 12,
    /// Another format version: `motionette convert OLD.blob -o NEW.blob` lifts an older blob. `found`: its major
    /// version; `limit`: the one that is understood.
    BlobVersion = 13,
    /// Lengths in the header contradict each other.
    BlobHeader = 14,
    /// The blob was damaged. `found`: CRC-32 of its bytes; `limit`: the one it should have.
    BlobChecksum = 15,
    /// The manifest cannot be read.
    BlobManifest = 16,
    /// A configuration value is not supported; `motionette inspect` on the desk says which. `found`: the value (its
    /// bits, where it is no whole number); `limit`: the largest allowed.
    BlobConfig = 17,
    /// A tensor is missing, or has a wrong place, shape or value. `index`: the tensor; `found` and `limit`: its
    /// elements and how many there should be, where the shape is wrong.
    BlobTensor = 18,
    /// The weights could overflow. `index`: the tensor.
    BlobUnbounded = 19,
    /// A section of the manifest is of a kind that came later: the blob needs a newer library; `motionette inspect` on
    /// the desk says which section. `found`: the kind; `limit`: the newest one that is known.
    BlobUnknown = 20,
    /// The blob or the request needs a family that this library was built without, a cargo feature of `bindings/c`;
    /// `motionette inspect` on the desk says which the blob needs.
    BlobNotLinked = 21,

    /// The arena is too small. `found`: bytes from its first 16-byte boundary; `limit`: bytes the request needs.
    ArenaTooSmall = 30,
    /// Floating point is not in its default state: rounding mode, flush-to-zero or default-NaN bits are set.
    FloatingPoint = 31,
    /// A request has either a text, or a stored prompt, or a vector, or tokens. `found`: how many of them are set; `limit`: 1.
    Source = 32,
    /// No tokens, too many, or numbers that are no whole tokens. `found`: how many; `limit`: most tokens of the
    /// model.
    TokenCount = 33,
    /// A token that the codebook does not have. `index`: its place; `found`: the token; `limit`: codes there are.
    TokenOutOfRange = 34,
    /// The progress callback asked to abort.
    Aborted = 35,
    /// A bone of the request's skeleton is no number, or none that a body has. `index`: its joint.
    Bone = 36,

    /// The model has no planner: it makes no motion from text.
    NoPlanner = 40,
    /// The model has no text encoder, only stored prompts. `found`: how many.
    NoTextEncoder = 41,
    /// The prompt is not UTF-8. `index`: the first byte that is wrong.
    PromptNotUtf8 = 42,
    /// The prompt has no words.
    PromptEmpty = 43,
    /// The prompt has too many bytes. `limit`: how many are read.
    PromptTooLong = 44,
    /// The prompt has too many words. `found`: how many; `limit`: most the model takes.
    PromptTooManyWords = 45,
    /// The model knows none of the words. `found`: how many there are.
    PromptUnknownWords = 46,
    /// The model stores no prompt of that name. `found`: prompts it stores.
    PromptNotStored = 47,
    /// The motion is too long. `found`: tokens asked for (4 frames each); `limit`: most the model allows.
    MotionLength = 48,
    /// No planner steps, or too many. `found`: steps; `limit`: most there may be.
    Steps = 49,
    /// Guidance is not a number from 0 to 100.
    Guidance = 50,
    /// The model takes no words: prompts are vectors of another encoder. `found`: prompts it stores; `limit`: numbers of a vector.
    PromptVectors = 51,
    /// The model takes prompts in words, not as vectors.
    PromptNoVectors = 52,
    /// The vector is of another encoder. `found`: its numbers; `limit`: numbers of one that the model takes.
    PromptVectorWidth = 53,
    /// A number of the vector is not finite or too large. `index`: its place.
    PromptVectorValue = 54,
    /// All numbers of the vector are zero.
    PromptVectorZero = 55,
    /// The planner ended the motion before its first token: give a length, or another seed.
    MotionEmpty = 56,

    /// Too many anchors. `found`: how many; `limit`: most there may be.
    TooManyAnchors = 60,
    /// `index`: the anchor; `found`: its family, which is none of `MTN_FAMILY_*`.
    UnknownFamily = 61,
    /// An anchor lies behind the end of the motion. `index`: the anchor; `found`: its frame; `limit`: frames of the
    /// motion.
    AnchorFrame = 62,
    /// There is no such joint. `index`: the anchor; `found`: its joint; `limit`: joints there are.
    AnchorJoint = 63,
    /// A coordinate is NaN or infinite. `index`: the anchor.
    AnchorNotFinite = 64,
    /// A coordinate is too large. `index`: the anchor; `limit`: largest magnitude, metres.
    AnchorTooFar = 65,
    /// Two anchors want one joint in two places at one frame. `index`: the second; `found`: the first.
    AnchorConflict = 66,
    /// Too many tokens to be refined. `found`: tokens; `limit`: most the refinement takes.
    RefinementLength = 67,
    /// The refinement met numbers that are not finite.
    RefinementNotFinite = 68,

    /// This machine computes other bits than the one that wrote the blob.
    SelfTestFailed = 80,
    /// The blob carries no self-test.
    NoSelfTest = 81,

    /// Something that this version has no code for.
    Other = 99,

    /// Too many tracks. `found`: how many; `limit`: most there may be.
    TooManyTracks = 100,
    /// `index`: the track; `found`: its axes, of which some are none of `MTN_AXIS_*`; `limit`: `MTN_AXES_ALL`.
    TrackAxes = 101,
    /// Nothing of a track counts: no positions, a mask without any, or no axis. `index`: the track.
    TrackNothing = 102,
    /// There is no such joint. `index`: the track; `found`: its joint; `limit`: joints there are.
    TrackJoint = 103,
    /// A track goes on behind the end of the motion. `index`: the track; `found`: frame of its last position; `limit`: frames of the
    /// motion.
    TrackFrame = 104,
    /// A coordinate is NaN, infinite or too large. `index`: the track; `found`: frame of the position; `limit`: largest magnitude, metres.
    TrackPosition = 105,
    /// A tolerance that is negative, not a number or too large. `index`: the track; `limit`: the largest, metres.
    TrackTolerance = 106,
    /// Two tracks want one joint in two places at one frame. `index`: the second; `found`: the first; `limit`: the frame.
    TrackConflict = 107,
    /// A track and an anchor want one joint in two places at one frame. `index`: the track; `found`: the anchor; `limit`: the frame.
    TrackAnchorConflict = 108,
    /// Tracks and obstacles are met by the edit behind the decoder alone: set `exact`.
    NotExact = 109,
    /// Limits with more tracked joints than a body has. `found`: how many; `limit`: joints there are.
    TrackedJoints = 110,

    /// Too many obstacles. `found`: how many; `limit`: most there may be.
    TooManyObstacles = 120,
    /// `index`: the obstacle; `found`: its shape, which is none of `MTN_SHAPE_*`.
    UnknownShape = 121,
    /// `index`: the obstacle; `found`: its course, which is none of `MTN_COURSE_*`.
    UnknownCourse = 122,
    /// A size is not above 0 or too large, or a plane has no direction. `index`: the obstacle; `limit`: the largest, metres.
    ObstacleSize = 123,
    /// A margin that is negative, not a number or too large. `index`: the obstacle; `limit`: the largest, metres.
    ObstacleMargin = 124,
    /// A place or velocity is NaN, infinite or too large. `index`: the obstacle; `limit`: largest magnitude, metres.
    ObstaclePlace = 125,
    /// It moves too fast. `index`: the obstacle; `found`: its speed, rounded up; `limit`: the largest; both metres a second.
    ObstacleSpeed = 126,
    /// No keyframes, or one that is not behind the one before it. `index`: the obstacle; `found`: the keyframe.
    ObstacleKeyframes = 127,
    /// Too many keyframes in the obstacles together. `index`: the obstacle that has one too many; `found`: keyframes of all up to it, its
    /// own included; `limit`: most there may be.
    TooManyKeyframes = 128,
    /// No joint keeps clear of it, or one that there is not. `index`: the obstacle.
    ObstacleJoints = 129,
    /// An anchor lies inside it. `index`: the obstacle; `found`: the anchor.
    AnchorInside = 130,
    /// A track passes through it. `index`: the obstacle; `found`: the track; `limit`: the first frame at which it is inside.
    TrackInside = 131,

    /// Too many spans. `found`: how many; `limit`: most there may be.
    TooManySpans = 140,
    /// `index`: the span; `found`: its parts, of which some are none of `MTN_PART_*`, or a trunk without head and arms.
    SpanParts = 141,
    /// A span moves no part of the body. `index`: the span.
    SpanNothing = 142,
    /// A span is too short. `index`: the span; `found`: its frames; `limit`: the fewest there may be.
    SpanFrames = 143,
    /// A span goes on behind the end of the motion. `index`: the span; `found`: the frame behind its last; `limit`: frames of the motion.
    SpanEnd = 144,
    /// Two spans move one part at one frame. `index`: the second; `found`: the first; `limit`: the parts that both move.
    SpanOverlap = 145,
    /// A span has either a text, or a stored prompt, or a vector. `index`: the span; `found`: how many of them are set; `limit`: 1.
    SpanSource = 146,
    /// A span's prompt was refused. `index`: the span; `found`: the code of a request with that prompt, of which `mtn_error_message` says what
    /// it is; `limit`: the `limit` of that code, or the `index` where it has one.
    SpanPrompt = 147,
    /// Limits with spans and without words: spans are planned from prompts. `found`: spans.
    SpanWords = 148,
}

/// An error and the numbers that explain it.
#[repr(C)]
#[must_use]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct mtn_result {
    /// What went wrong; 0: nothing.
    pub error: mtn_error,
    /// Which one, counted from 0.
    pub index: u32,
    /// What was found.
    pub found: u32,
    /// What is allowed or needed.
    pub limit: u32,
}

/// One sentence about an error code, in English, static, zero-terminated. Any number is allowed.
#[unsafe(no_mangle)]
pub extern "C" fn mtn_error_message(error: i32) -> *const c_char {
    message(error).as_ptr()
}

fn message(error: i32) -> &'static CStr {
    use mtn_error as E;
    const fn is(error: i32, code: E) -> bool {
        error == code as i32
    }
    MESSAGES.iter().find(|(code, _)| is(error, *code)).map_or(c"unknown error", |(_, text)| text)
}

static MESSAGES: &[(mtn_error, &CStr)] = &[
    (mtn_error::None, c"no error"),
    (mtn_error::NullPointer, c"a pointer is null"),
    (mtn_error::Misaligned, c"a pointer is not aligned"),
    (mtn_error::Length, c"a length runs over the end of the address space"),
    (mtn_error::NotOpened, c"the model or generator was not opened, or is a copy of one that was"),
    (mtn_error::Busy, c"the generator is at work: its callback must not use it"),
    (mtn_error::BlobMisaligned, c"the blob does not begin on a 16-byte boundary: align it in flash"),
    (mtn_error::BlobTruncated, c"the blob was cut short"),
    (mtn_error::NotABlob, c"this is no motionette blob"),
    (mtn_error::BlobVersion, c"the blob has another format version: lift or convert it with `motionette convert`"),
    (mtn_error::BlobHeader, c"lengths in the blob's header contradict each other"),
    (mtn_error::BlobChecksum, c"the blob was damaged: its checksum does not match"),
    (mtn_error::BlobManifest, c"the blob's manifest cannot be read"),
    (mtn_error::BlobConfig, c"the blob has a configuration value that is not supported"),
    (mtn_error::BlobTensor, c"the blob has a tensor of wrong place, shape or value"),
    (mtn_error::BlobUnbounded, c"the blob's weights could overflow"),
    (mtn_error::BlobUnknown, c"the blob needs a newer library: a section of its manifest is of an unknown kind"),
    (mtn_error::BlobNotLinked, c"the blob or the request needs a family that this library was built without"),
    (mtn_error::ArenaTooSmall, c"the arena is too small for the request"),
    (mtn_error::FloatingPoint, c"floating point is not in its default state"),
    (mtn_error::Source, c"a request has either a text, or a stored prompt, or a vector, or tokens"),
    (mtn_error::TokenCount, c"the request has no tokens, too many, or numbers that are no whole tokens"),
    (mtn_error::TokenOutOfRange, c"the codebook has no such token"),
    (mtn_error::Aborted, c"the progress callback aborted the request"),
    (mtn_error::Bone, c"a bone of the skeleton is not as long as bones are"),
    (mtn_error::NoPlanner, c"the model has no planner: it cannot make tokens from text"),
    (mtn_error::NoTextEncoder, c"the model has no text encoder, only stored prompts"),
    (mtn_error::PromptNotUtf8, c"the prompt is not UTF-8"),
    (mtn_error::PromptEmpty, c"the prompt has no words"),
    (mtn_error::PromptTooLong, c"the prompt has too many bytes"),
    (mtn_error::PromptTooManyWords, c"the prompt has too many words"),
    (mtn_error::PromptUnknownWords, c"the model knows none of the prompt's words"),
    (mtn_error::PromptNotStored, c"the model stores no prompt of that name"),
    (mtn_error::MotionLength, c"the motion is too long"),
    (mtn_error::Steps, c"the planner takes 1 to 1000 steps"),
    (mtn_error::Guidance, c"guidance must be a number from 0 to 100"),
    (mtn_error::PromptVectors, c"the model takes no words: give the prompt as a vector, or one that it stores"),
    (mtn_error::PromptNoVectors, c"the model takes prompts in words, not as vectors"),
    (
        mtn_error::PromptVectorWidth,
        c"the prompt is a vector of another encoder: it has not as many numbers as the model takes",
    ),
    (mtn_error::PromptVectorValue, c"a number of the prompt's vector is not finite or too large"),
    (mtn_error::PromptVectorZero, c"the prompt's vector is all zeros"),
    (mtn_error::MotionEmpty, c"the planner ended the motion before its first token"),
    (mtn_error::TooManyAnchors, c"too many anchors"),
    (mtn_error::UnknownFamily, c"an anchor has an unknown family"),
    (mtn_error::AnchorFrame, c"an anchor lies behind the end of the motion"),
    (mtn_error::AnchorJoint, c"an anchor has an unknown joint"),
    (mtn_error::AnchorNotFinite, c"an anchor's coordinate is NaN or infinite"),
    (mtn_error::AnchorTooFar, c"an anchor's coordinate is too large"),
    (mtn_error::AnchorConflict, c"two anchors want one joint in two places at one frame"),
    (mtn_error::RefinementLength, c"the motion is too long to be refined"),
    (mtn_error::RefinementNotFinite, c"the refinement met numbers that are not finite"),
    (mtn_error::SelfTestFailed, c"the self-test failed: this machine computes other bits"),
    (mtn_error::NoSelfTest, c"the blob carries no self-test"),
    (mtn_error::Other, c"an error that the C library has no code for"),
    (mtn_error::TooManyTracks, c"too many tracks"),
    (mtn_error::TrackAxes, c"a track has unknown axes"),
    (mtn_error::TrackNothing, c"nothing of a track counts: give positions, a mask with some of them, and an axis"),
    (mtn_error::TrackJoint, c"a track has an unknown joint"),
    (mtn_error::TrackFrame, c"a track goes on behind the end of the motion"),
    (mtn_error::TrackPosition, c"a track's coordinate is NaN, infinite or too large"),
    (mtn_error::TrackTolerance, c"a track's tolerance must be 0 to 1 m"),
    (mtn_error::TrackConflict, c"two tracks want one joint in two places at one frame"),
    (mtn_error::TrackAnchorConflict, c"a track and an anchor want one joint in two places at one frame"),
    (mtn_error::NotExact, c"tracks and obstacles are met by the edit behind the decoder alone: set exact"),
    (mtn_error::TrackedJoints, c"the limits have more tracked joints than a body has"),
    (mtn_error::TooManyObstacles, c"too many obstacles"),
    (mtn_error::UnknownShape, c"an obstacle has an unknown shape"),
    (mtn_error::UnknownCourse, c"an obstacle has an unknown course"),
    (mtn_error::ObstacleSize, c"an obstacle's sizes must be above 0 and at most 100 m, a plane needs a direction"),
    (mtn_error::ObstacleMargin, c"an obstacle's margin must be 0 to 1 m"),
    (mtn_error::ObstaclePlace, c"a place or velocity of an obstacle is NaN, infinite or too large"),
    (mtn_error::ObstacleSpeed, c"an obstacle moves too fast"),
    (mtn_error::ObstacleKeyframes, c"an obstacle has no keyframes, or one that is not behind the one before it"),
    (mtn_error::TooManyKeyframes, c"the obstacles have too many keyframes together"),
    (mtn_error::ObstacleJoints, c"no joint keeps clear of an obstacle, or one that does not exist"),
    (mtn_error::AnchorInside, c"an anchor lies inside an obstacle"),
    (mtn_error::TrackInside, c"a track passes through an obstacle"),
    (mtn_error::TooManySpans, c"too many spans of a timeline"),
    (mtn_error::SpanParts, c"a span has unknown parts of the body, or a trunk without head and arms"),
    (mtn_error::SpanNothing, c"a span moves no part of the body"),
    (mtn_error::SpanFrames, c"a span has less than 8 frames"),
    (mtn_error::SpanEnd, c"a span goes on behind the end of the motion"),
    (mtn_error::SpanOverlap, c"two spans move one part of the body at the same time"),
    (mtn_error::SpanSource, c"a span has either a text, or a stored prompt, or a vector"),
    (mtn_error::SpanPrompt, c"a span's prompt was refused: the number that was found is the code that says why"),
    (mtn_error::SpanWords, c"the limits have spans and no words: spans are planned from prompts"),
];

/// Runs `work` and says how it went.
pub(crate) fn report(work: impl FnOnce() -> Result<(), mtn_result>) -> mtn_result {
    match work() {
        Ok(()) => mtn_error::None.into(),
        Err(result) => result,
    }
}

/// Largest tolerance of a track and largest margin of an obstacle, metres; largest size of an obstacle, metres.
const LOOSEST: usize = 1;
const LARGEST: usize = 100;

/// A code with the two numbers that most have.
fn numbers(error: mtn_error, found: usize, limit: usize) -> mtn_result {
    mtn_result { found: clamped(found), limit: clamped(limit), ..error.into() }
}

/// The same of one thing in a list.
fn at(error: mtn_error, index: usize, found: usize, limit: usize) -> mtn_result {
    mtn_result { index: clamped(index), ..numbers(error, found, limit) }
}

impl From<mtn_error> for mtn_result {
    fn from(error: mtn_error) -> Self {
        mtn_result { error, index: 0, found: 0, limit: 0 }
    }
}

impl From<blob::Error> for mtn_result {
    fn from(error: blob::Error) -> Self {
        use blob::Error as E;
        let tensor = |index: u16| mtn_result { index: u32::from(index), ..mtn_error::BlobTensor.into() };
        match error {
            E::Misaligned { remainder } => numbers(mtn_error::BlobMisaligned, usize::from(remainder), blob::ALIGNMENT),
            E::Truncated { needed, available } => {
                mtn_result { found: available, limit: needed, ..mtn_error::BlobTruncated.into() }
            }
            E::NotABlob { found } => {
                let (found, limit) = (u32::from_le_bytes(found), u32::from_le_bytes(blob::MAGIC));
                mtn_result { found, limit, ..mtn_error::NotABlob.into() }
            }
            E::Version { found, supported } => {
                numbers(mtn_error::BlobVersion, usize::from(found), usize::from(supported))
            }
            E::Header => mtn_error::BlobHeader.into(),
            E::Checksum { computed, stored } => {
                mtn_result { found: computed, limit: stored, ..mtn_error::BlobChecksum.into() }
            }
            E::Manifest => mtn_error::BlobManifest.into(),
            E::Unknown { found, known, .. } => {
                numbers(mtn_error::BlobUnknown, usize::from(found), usize::from(known.saturating_sub(1)))
            }
            E::NotLinked { .. } => mtn_error::BlobNotLinked.into(),
            E::Config { found, limit, .. } => mtn_result { found, limit, ..mtn_error::BlobConfig.into() },
            E::Number { bits, .. } => mtn_result { found: bits, ..mtn_error::BlobConfig.into() },
            E::TensorRange { index } | E::TensorMissing { index } | E::TensorValue { index, .. } => tensor(index),
            E::TensorShape { index, found, expected } => mtn_result { found, limit: expected, ..tensor(index) },
            E::Unbounded { index } => mtn_result { index: u32::from(index), ..mtn_error::BlobUnbounded.into() },
            _ => mtn_error::Other.into(),
        }
    }
}

impl From<Error> for mtn_result {
    fn from(error: Error) -> Self {
        match error {
            Error::Arena(e) => numbers(mtn_error::ArenaTooSmall, e.available, e.needed),
            Error::FloatingPoint => mtn_error::FloatingPoint.into(),
            Error::Tokens { found, limit } => numbers(mtn_error::TokenCount, found, limit),
            Error::TokenOutOfRange { index, token, codes } => mtn_result {
                index: clamped(index),
                ..numbers(mtn_error::TokenOutOfRange, usize::from(token), usize::from(codes))
            },
            Error::Prompt(e) => e.into(),
            Error::Planning(e) => e.into(),
            Error::Anchors(e) => e.into(),
            Error::Tracks(e) => e.into(),
            Error::Obstacles(e) => e.into(),
            Error::Timeline(e) => e.into(),
            Error::Solver(SolverError::Tokens { tokens, limit }) => numbers(mtn_error::RefinementLength, tokens, limit),
            Error::Solver(SolverError::NotFinite) => mtn_error::RefinementNotFinite.into(),
            Error::NotLinked { .. } => mtn_error::BlobNotLinked.into(),
            Error::Aborted => mtn_error::Aborted.into(),
            Error::Bone { joint } => mtn_result { index: u32::from(joint), ..mtn_error::Bone.into() },
            // Embeddings and streams have no way in from C.
            _ => mtn_error::Other.into(),
        }
    }
}

impl From<PromptError> for mtn_result {
    fn from(error: PromptError) -> Self {
        match error {
            PromptError::NoEncoder { stored } => numbers(mtn_error::NoTextEncoder, stored, 0),
            PromptError::Empty => mtn_error::PromptEmpty.into(),
            PromptError::TooLong { found, limit } => numbers(mtn_error::PromptTooLong, found, limit),
            PromptError::TooManyWords { found, limit } => numbers(mtn_error::PromptTooManyWords, found, limit),
            PromptError::OnlyUnknownWords { words } => numbers(mtn_error::PromptUnknownWords, words, 0),
            PromptError::Vectors { width, stored } => numbers(mtn_error::PromptVectors, stored, width),
            PromptError::NoVectors => mtn_error::PromptNoVectors.into(),
            PromptError::VectorWidth { found, width } => numbers(mtn_error::PromptVectorWidth, found, width),
            PromptError::VectorValue { index } => {
                mtn_result { index: clamped(index), ..mtn_error::PromptVectorValue.into() }
            }
            PromptError::ZeroVector => mtn_error::PromptVectorZero.into(),
            PromptError::NotStored { stored } => numbers(mtn_error::PromptNotStored, stored, 0),
        }
    }
}

impl From<PlanningError> for mtn_result {
    fn from(error: PlanningError) -> Self {
        match error {
            PlanningError::NoPlanner => mtn_error::NoPlanner.into(),
            PlanningError::Nothing => mtn_error::MotionEmpty.into(),
            PlanningError::Length { found, limit } => numbers(mtn_error::MotionLength, found, limit),
            PlanningError::Steps { found, limit } => numbers(mtn_error::Steps, usize::from(found), usize::from(limit)),
            PlanningError::Guidance { .. } => mtn_error::Guidance.into(),
            // Samplings and given tokens have no way in from C.
            _ => mtn_error::Other.into(),
        }
    }
}

impl From<AnchorError> for mtn_result {
    fn from(error: AnchorError) -> Self {
        match error {
            AnchorError::TooMany { anchors, limit } => numbers(mtn_error::TooManyAnchors, anchors, limit),
            AnchorError::FrameOutOfRange { index, frame, frames } => {
                at(mtn_error::AnchorFrame, index, usize::from(frame), frames)
            }
            AnchorError::JointOutOfRange { index, joint, joints } => {
                at(mtn_error::AnchorJoint, index, usize::from(joint), joints)
            }
            AnchorError::NotFinite { index } => at(mtn_error::AnchorNotFinite, index, 0, 0),
            AnchorError::TooFar { index, limit } => at(mtn_error::AnchorTooFar, index, 0, limit as usize),
            AnchorError::Conflict { first, second } => at(mtn_error::AnchorConflict, second, first, 0),
            // Times have no way in from C.
            AnchorError::Time { .. } => mtn_error::Other.into(),
        }
    }
}

impl From<TrackError> for mtn_result {
    fn from(error: TrackError) -> Self {
        use TrackError as E;
        match error {
            E::TooMany { tracks, limit } => numbers(mtn_error::TooManyTracks, tracks, limit),
            E::Nothing { index } => at(mtn_error::TrackNothing, index, 0, 0),
            E::JointOutOfRange { index, joint, joints } => at(mtn_error::TrackJoint, index, usize::from(joint), joints),
            E::FrameOutOfRange { index, frame, frames } => at(mtn_error::TrackFrame, index, frame, frames),
            E::Position { index, frame, limit } => at(mtn_error::TrackPosition, index, frame, limit as usize),
            E::Tolerance { index, .. } => at(mtn_error::TrackTolerance, index, 0, LOOSEST),
            E::Conflict { first, second, frame } => at(mtn_error::TrackConflict, second, first, frame),
            E::AnchorConflict { track, anchor, frame } => at(mtn_error::TrackAnchorConflict, track, anchor, frame),
            E::NotExact => mtn_error::NotExact.into(),
            // A mask from C is as long as its track.
            E::Mask { .. } => mtn_error::Other.into(),
        }
    }
}

impl From<ObstacleError> for mtn_result {
    fn from(error: ObstacleError) -> Self {
        use ObstacleError as E;
        match error {
            E::TooMany { obstacles, limit } => numbers(mtn_error::TooManyObstacles, obstacles, limit),
            E::Size { index } => at(mtn_error::ObstacleSize, index, 0, LARGEST),
            E::Margin { index, .. } => at(mtn_error::ObstacleMargin, index, 0, LOOSEST),
            E::Place { index } => at(mtn_error::ObstaclePlace, index, 0, FARTHEST as usize),
            E::TooFast { index, speed, limit } => {
                let whole = speed as usize;
                let found = whole.saturating_add(usize::from(speed > whole as f32));
                at(mtn_error::ObstacleSpeed, index, found, limit as usize)
            }
            E::Keyframes { index, keyframe } => at(mtn_error::ObstacleKeyframes, index, keyframe, 0),
            E::Joints { index } => at(mtn_error::ObstacleJoints, index, 0, 0),
            E::AnchorInside { index, anchor } => at(mtn_error::AnchorInside, index, anchor, 0),
            E::TrackInside { index, track, frame } => at(mtn_error::TrackInside, index, track, frame),
        }
    }
}

impl From<TimelineError> for mtn_result {
    fn from(error: TimelineError) -> Self {
        use TimelineError as E;
        let at = |error, index: u8, found, limit| at(error, usize::from(index), found, limit);
        match error {
            E::TooMany { spans, limit } => numbers(mtn_error::TooManySpans, spans, limit),
            E::NoParts { index } => at(mtn_error::SpanNothing, index, 0, 0),
            E::TooShort { index, frames } => {
                at(mtn_error::SpanFrames, index, usize::from(frames), usize::from(LEAST_SPAN))
            }
            E::OutOfRange { index, end, frames } => at(mtn_error::SpanEnd, index, end, frames),
            E::Overlap { first, second, parts } => {
                at(mtn_error::SpanOverlap, second, usize::from(first), usize::from(parts.bits()))
            }
            E::Prompt { index, error } => of_span(usize::from(index), error.into()),
        }
    }
}

/// What is refused of a prompt, as that of a span. Pointers stay those of the request.
pub(crate) fn of_span(index: usize, refused: mtn_result) -> mtn_result {
    match refused.error {
        mtn_error::NullPointer | mtn_error::Misaligned | mtn_error::Length => refused,
        error => {
            let limit = if refused.limit > 0 { refused.limit } else { refused.index };
            mtn_result { index: clamped(index), found: error as u32, limit, ..mtn_error::SpanPrompt.into() }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every variant has a message of its own: the compiler makes sure that the list of codes below is complete.
    #[test]
    fn every_code_has_a_message() {
        let source = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/src/error.rs")).unwrap();
        let codes: std::vec::Vec<i32> = source
            .lines()
            .filter_map(|line| line.strip_prefix("    ")?.strip_suffix(',')?.split_once(" = ")?.1.parse().ok())
            .collect();
        assert_eq!(codes.len(), MESSAGES.len(), "a code without a message, or the other way round");
        let mut seen = std::collections::BTreeSet::new();
        for code in codes {
            assert_ne!(message(code), c"unknown error", "code {code}");
            assert!(seen.insert(message(code)), "{:?} says two things", message(code));
        }
        assert_eq!(message(-7), c"unknown error");
    }
}
