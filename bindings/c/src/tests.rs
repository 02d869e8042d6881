//! What C may get wrong, and what it then is told.

mod conditions;
mod timeline;

use core::ffi::{CStr, c_void};
use core::{mem, ptr};
use std::{boxed::Box, fs, string::String, string::ToString as _, sync::LazyLock, vec, vec::Vec};

use motionette::{
    BodyParts, Course, Generator, JOINTS, Joint, Keyframe, Length, Model, Obstacle, Prompt, Request, Shape, Span,
    Track, blob::Aligned,
};

use conditions::{Tracks, pillar};

use crate::conditions::{
    MTN_ALL_JOINTS, MTN_AXES_ALL, MTN_AXIS_X, MTN_AXIS_Z, MTN_COURSE_KEYFRAMES, MTN_COURSE_MOVING, MTN_COURSE_STILL,
    MTN_MAX_KEYFRAMES, MTN_MAX_OBSTACLES, MTN_MAX_TRACKS, MTN_SHAPE_BOX, MTN_SHAPE_CAPSULE, MTN_SHAPE_CYLINDER,
    MTN_SHAPE_PLANE, MTN_SHAPE_SPHERE, mtn_keyframe, mtn_obstacle, mtn_track,
};
use crate::error::{mtn_error, mtn_error_message, mtn_result};
use crate::generator::{
    MTN_FLOW_ABORT, MTN_FLOW_CONTINUE, MTN_FLOW_FINISH, MTN_NO_OBSTACLE, MTN_NO_PHRASE, mtn_clearance, mtn_flow,
    mtn_generate, mtn_generator, mtn_generator_open, mtn_generator_set_rows, mtn_guess, mtn_motion, mtn_motion_hash,
    mtn_motion_understood, mtn_progress, mtn_self_test, mtn_stage, mtn_tracking, mtn_understood,
    mtn_understood_in_words,
};
use crate::model::{mtn_limits, mtn_model, mtn_model_open, mtn_model_plan, mtn_plan};
use crate::request::{
    MTN_FAMILY_JOINT, MTN_FAMILY_PLANAR, MTN_FAMILY_ROOT3D, MTN_MAX_ANCHORS, mtn_anchor, mtn_request,
    mtn_request_default,
};
use crate::timeline::{
    MTN_MAX_SPANS, MTN_PART_ARMS, MTN_PART_HEAD, MTN_PART_LEFT_ARM, MTN_PART_LEFT_LEG, MTN_PART_LEGS,
    MTN_PART_RIGHT_ARM, MTN_PART_RIGHT_LEG, MTN_PART_UPPER_BODY, mtn_heard, mtn_span,
};

/// Blocks that begin on the boundary that blobs need.
type Blocks = Vec<Aligned<[u8; 16]>>;

static BLOB: LazyLock<Blocks> = LazyLock::new(|| {
    let bytes = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/nano.blob")).unwrap();
    bytes
        .chunks(16)
        .map(|chunk| {
            let mut block = Aligned([0; 16]);
            block.0[..chunk.len()].copy_from_slice(chunk);
            block
        })
        .collect()
});

const TOKENS: [u16; 8] = [117, 204, 407, 13, 227, 418, 370, 83];

fn zeroed<T>() -> Box<T> {
    // SAFETY: used with the opaque types and with plain C structs, for which zero bits are a value.
    unsafe { Box::new(mem::zeroed()) }
}

fn result(error: mtn_error, index: u32, found: u32, limit: u32) -> mtn_result {
    mtn_result { error, index, found, limit }
}

const FINE: mtn_result = mtn_result { error: mtn_error::None, index: 0, found: 0, limit: 0 };

fn open(model: &mut mtn_model, blob: &[Aligned<[u8; 16]>]) -> mtn_result {
    // SAFETY: the blocks are contiguous bytes, and outlive every model of these tests.
    unsafe { mtn_model_open(model, blob.as_ptr().cast(), size_of_val(blob)) }
}

/// A generator of the bundled model and everything it works with.
struct Bench {
    generator: Box<mtn_generator>,
    _arena: Blocks,
}

impl Bench {
    fn new(arena_bytes: usize) -> Self {
        let mut model = zeroed();
        assert_eq!(open(&mut model, &BLOB), FINE);
        let mut arena = vec![Aligned([0xA5; 16]); arena_bytes.div_ceil(16)];
        let mut generator = zeroed();
        // SAFETY: everything is valid; the arena lives as long as the generator.
        let opened =
            unsafe { mtn_generator_open(&mut *generator, &*model, arena.as_mut_ptr().cast(), 16 * arena.len()) };
        assert_eq!(opened, FINE);
        Bench { generator, _arena: arena }
    }

    fn generate(&mut self, request: &mtn_request) -> Result<mtn_motion, mtn_result> {
        let mut motion = zeroed();
        // SAFETY: everything is valid.
        let made = unsafe { mtn_generate(&mut *self.generator, request, None, ptr::null_mut(), &mut *motion) };
        if made == FINE { Ok(*motion) } else { Err(made) }
    }

    fn refused(&mut self, request: &mtn_request) -> mtn_result {
        self.generate(request).expect_err("the request is bad")
    }
}

fn tokens() -> mtn_request {
    mtn_request { tokens: TOKENS.as_ptr(), token_count: TOKENS.len(), ..mtn_request_default() }
}

fn text(text: &CStr) -> mtn_request {
    mtn_request { text: text.as_ptr(), steps: 1, frames: 8, ..mtn_request_default() }
}

/// The same bent through the decoder, 20 evaluations, not edited behind it.
fn bent(anchors: &[mtn_anchor]) -> mtn_request {
    mtn_request { evaluations: 20, exact: 0, ..through(anchors) }
}

fn through(anchors: &[mtn_anchor]) -> mtn_request {
    mtn_request { anchors: anchors.as_ptr(), anchor_count: anchors.len(), ..tokens() }
}

const ROOT: mtn_anchor = mtn_anchor { position: [0.1, 0.9, 0.5], frame: 28, family: MTN_FAMILY_ROOT3D, joint: 0 };
const WRIST: mtn_anchor = mtn_anchor { position: [-0.3, 1.4, 0.4], frame: 16, family: MTN_FAMILY_JOINT, joint: 21 };

#[test]
fn null_and_misaligned_pointers_are_named() {
    let mut bench = Bench::new(1 << 18);
    let (mut model, mut motion, mut hash) = (zeroed::<mtn_model>(), zeroed::<mtn_motion>(), 0u64);
    let null = |index| result(mtn_error::NullPointer, index, 0, 0);
    let blob = BLOB.as_ptr().cast::<c_void>();
    let generator: *mut mtn_generator = &mut *bench.generator;
    let (request, off) = (tokens(), tokens());
    // SAFETY: all pointers are valid or refused before they are followed.
    unsafe {
        assert_eq!(mtn_model_open(ptr::null_mut(), blob, 16), null(0));
        assert_eq!(mtn_model_open(&mut *model, ptr::null(), 16), null(1));
        let misaligned = ptr::from_mut(&mut *model).wrapping_byte_add(4);
        assert_eq!(mtn_model_open(misaligned, blob, 16), result(mtn_error::Misaligned, 0, 4, 8));
        assert_eq!(mtn_model_plan(&*model, ptr::null(), ptr::null_mut()), result(mtn_error::NotOpened, 0, 0, 0));
        assert_eq!(open(&mut model, &BLOB), FINE);
        assert_eq!(mtn_model_plan(&*model, ptr::null(), ptr::null_mut()), null(1));
        assert_eq!(mtn_generator_open(&mut *zeroed(), &*model, ptr::null_mut(), 1024), null(2));
        assert_eq!(mtn_generate(ptr::null_mut(), &request, None, ptr::null_mut(), &mut *motion), null(0));
        assert_eq!(mtn_generate(generator, ptr::null(), None, ptr::null_mut(), &mut *motion), null(1));
        assert_eq!(mtn_generate(generator, &request, None, ptr::null_mut(), ptr::null_mut()), null(4));
        assert_eq!(mtn_self_test(ptr::null_mut()), null(0));
        assert_eq!(mtn_motion_hash(ptr::null(), &mut hash), null(0));
        assert_eq!(mtn_motion_hash(&*motion, ptr::null_mut()), null(1));
    }
    assert_eq!(bench.refused(&mtn_request { anchor_count: 2, ..tokens() }), null(1));
    let off_tokens = mtn_request { tokens: TOKENS.as_ptr().wrapping_byte_add(1), ..off };
    assert_eq!(bench.refused(&off_tokens), result(mtn_error::Misaligned, 1, 1, 2));
    let endless = mtn_request { token_count: usize::MAX / 2, ..tokens() };
    assert_eq!(bench.refused(&endless), result(mtn_error::Length, 1, u32::MAX, 0));
}

#[test]
fn blobs_are_refused_with_their_numbers() {
    let mut model = zeroed();
    let mut damaged = BLOB.clone();
    // SAFETY: the bytes lie inside the blob.
    let off = unsafe { mtn_model_open(&mut *model, BLOB.as_ptr().wrapping_byte_add(4).cast(), 4096) };
    assert_eq!(off, result(mtn_error::BlobMisaligned, 0, 4, 16));
    let cut = open(&mut model, &BLOB[..1000]);
    assert_eq!((cut.error, cut.found), (mtn_error::BlobTruncated, 16000));
    assert!(cut.limit as usize > 1_000_000 && cut.limit as usize <= 16 * BLOB.len(), "{cut:?}");
    damaged[5000].0[3] ^= 1;
    assert_eq!(open(&mut model, &damaged).error, mtn_error::BlobChecksum);
    damaged[0].0[0] = b'?';
    let magic = u32::from_le_bytes(motionette::blob::MAGIC);
    assert_eq!(open(&mut model, &damaged), result(mtn_error::NotABlob, 0, magic & !0xFF | u32::from(b'?'), magic));
}

/// Blobs of another format, and of a kind that came later: the first byte of the manifest's first section behind the card.
#[test]
fn blobs_of_other_formats_are_refused_with_their_numbers() {
    let mut model = zeroed();
    let mut old = BLOB.clone();
    old[0].0[4] = 3;
    assert_eq!(open(&mut model, &old), result(mtn_error::BlobVersion, 0, 3, 4));
    let mut later: Vec<u8> = BLOB.iter().flat_map(|block| block.0).collect();
    let card: usize = (0..4).fold(32, |at, _| at + varint(&later[at..]));
    assert_eq!(later[card], 0, "the representation's kind");
    later[card] = 2;
    let total = u32::from_le_bytes([later[8], later[9], later[10], later[11]]) as usize;
    let crc = motionette::blob::Header::checksum(&later[..total]);
    later[24..28].copy_from_slice(&crc.to_le_bytes());
    let later: Blocks = later.as_chunks::<16>().0.iter().map(|&chunk| Aligned(chunk)).collect();
    assert_eq!(open(&mut model, &later), result(mtn_error::BlobUnknown, 0, 2, 0));
    let missing = motionette::blob::Error::NotLinked { feature: "tmd" };
    assert_eq!(mtn_result::from(missing), result(mtn_error::BlobNotLinked, 0, 0, 0));
}

/// Bytes of a string on the wire: its length of one or two bytes, and its content.
fn varint(bytes: &[u8]) -> usize {
    let (low, high) = (usize::from(bytes[0]), usize::from(bytes[1]));
    if low < 128 { 1 + low } else { 2 + (low & 127) + 128 * high }
}

/// Programs in C were compiled with these numbers: none of them may ever mean something else.
#[test]
fn numbers_of_errors_stay_what_they_were() {
    use mtn_error as E;
    let numbers = [
        (E::None, 0),
        (E::NullPointer, 1),
        (E::Misaligned, 2),
        (E::Length, 3),
        (E::NotOpened, 4),
        (E::Busy, 5),
        (E::BlobMisaligned, 10),
        (E::BlobTruncated, 11),
        (E::NotABlob, 12),
        (E::BlobVersion, 13),
        (E::BlobHeader, 14),
        (E::BlobChecksum, 15),
        (E::BlobManifest, 16),
        (E::BlobConfig, 17),
        (E::BlobTensor, 18),
        (E::BlobUnbounded, 19),
        (E::BlobUnknown, 20),
        (E::BlobNotLinked, 21),
        (E::ArenaTooSmall, 30),
        (E::FloatingPoint, 31),
        (E::Source, 32),
        (E::TokenCount, 33),
        (E::TokenOutOfRange, 34),
        (E::Aborted, 35),
        (E::Bone, 36),
        (E::NoPlanner, 40),
        (E::NoTextEncoder, 41),
        (E::PromptNotUtf8, 42),
        (E::PromptEmpty, 43),
        (E::PromptTooLong, 44),
        (E::PromptTooManyWords, 45),
        (E::PromptUnknownWords, 46),
        (E::PromptNotStored, 47),
        (E::MotionLength, 48),
        (E::Steps, 49),
        (E::Guidance, 50),
        (E::PromptVectors, 51),
        (E::PromptNoVectors, 52),
        (E::PromptVectorWidth, 53),
        (E::PromptVectorValue, 54),
        (E::PromptVectorZero, 55),
        (E::MotionEmpty, 56),
        (E::TooManyAnchors, 60),
        (E::UnknownFamily, 61),
        (E::AnchorFrame, 62),
        (E::AnchorJoint, 63),
        (E::AnchorNotFinite, 64),
        (E::AnchorTooFar, 65),
        (E::AnchorConflict, 66),
        (E::RefinementLength, 67),
        (E::RefinementNotFinite, 68),
        (E::SelfTestFailed, 80),
        (E::NoSelfTest, 81),
        (E::Other, 99),
        (E::TooManyTracks, 100),
        (E::TrackAxes, 101),
        (E::TrackNothing, 102),
        (E::TrackJoint, 103),
        (E::TrackFrame, 104),
        (E::TrackPosition, 105),
        (E::TrackTolerance, 106),
        (E::TrackConflict, 107),
        (E::TrackAnchorConflict, 108),
        (E::NotExact, 109),
        (E::TrackedJoints, 110),
        (E::TooManyObstacles, 120),
        (E::UnknownShape, 121),
        (E::UnknownCourse, 122),
        (E::ObstacleSize, 123),
        (E::ObstacleMargin, 124),
        (E::ObstaclePlace, 125),
        (E::ObstacleSpeed, 126),
        (E::ObstacleKeyframes, 127),
        (E::TooManyKeyframes, 128),
        (E::ObstacleJoints, 129),
        (E::AnchorInside, 130),
        (E::TrackInside, 131),
        (E::TooManySpans, 140),
        (E::SpanParts, 141),
        (E::SpanNothing, 142),
        (E::SpanFrames, 143),
        (E::SpanEnd, 144),
        (E::SpanOverlap, 145),
        (E::SpanSource, 146),
        (E::SpanPrompt, 147),
        (E::SpanWords, 148),
    ];
    for (error, number) in numbers {
        assert_eq!(error as i32, number, "{error:?}");
    }
}

#[test]
fn storage_must_be_opened_and_not_copied() {
    let mut model: Box<mtn_model> = zeroed();
    assert_eq!(open(&mut model, &BLOB), FINE);
    let limits = mtn_limits {
        frames: 60,
        words: 8,
        anchors: 2,
        steps: 5,
        evaluations: 20,
        exact: 0,
        free_feet: 0,
        guidance: 2.0,
        rows: 0,
        tracked: 0,
        spans: 0,
    };
    let mut plan: Box<mtn_plan> = zeroed();
    // SAFETY: everything is valid, `copy` holds the bits of an opened model.
    unsafe {
        assert_eq!(mtn_model_plan(&*model, &limits, &mut *plan), FINE);
        let copy = Box::new(ptr::read(&*model));
        assert_eq!(mtn_model_plan(&*copy, &limits, &mut *plan), result(mtn_error::NotOpened, 0, 0, 0));
        assert_eq!(mtn_self_test(&mut *zeroed()), result(mtn_error::NotOpened, 0, 0, 0));
    }
    // A refused blob closes what was open.
    assert_eq!(open(&mut model, &BLOB[..1000]).error, mtn_error::BlobTruncated);
    // SAFETY: as above.
    let closed = unsafe { mtn_model_plan(&*model, &limits, &mut *plan) };
    assert_eq!(closed, result(mtn_error::NotOpened, 0, 0, 0));
}

#[test]
fn the_plan_is_what_a_request_takes() {
    let mut model: Box<mtn_model> = zeroed();
    assert_eq!(open(&mut model, &BLOB), FINE);
    let plan_of = |limits: mtn_limits| {
        let mut plan: Box<mtn_plan> = zeroed();
        // SAFETY: everything is valid.
        let planned = unsafe { mtn_model_plan(&*model, &limits, &mut *plan) };
        if planned == FINE { Ok(*plan) } else { Err(planned) }
    };
    let limits = mtn_limits {
        frames: 32,
        words: 0,
        anchors: 2,
        steps: 0,
        evaluations: 20,
        exact: 0,
        free_feet: 0,
        guidance: 0.0,
        rows: 0,
        tracked: 0,
        spans: 0,
    };
    let plan = plan_of(limits).unwrap();
    assert_eq!(plan.planning_macs, 0);
    let anchors = [ROOT, WRIST];
    assert_eq!(Bench::new(plan.arena_bytes).generate(&bent(&anchors)).unwrap().arena_used, plan.arena_bytes);
    let needed = u32::try_from(plan.arena_bytes).unwrap();
    let refused = Bench::new(plan.arena_bytes - 16).refused(&bent(&anchors));
    assert_eq!(refused, result(mtn_error::ArenaTooSmall, 0, needed - 16, needed));

    let words = mtn_limits { words: 4, steps: 1, guidance: 2.0, ..limits };
    let plan = plan_of(words).unwrap();
    let request = mtn_request { frames: 32, ..text(c"a person walks forward") };
    let (count, evaluations) = (anchors.len(), 20);
    let request = mtn_request { anchors: anchors.as_ptr(), anchor_count: count, evaluations, exact: 0, ..request };
    assert_eq!(Bench::new(plan.arena_bytes).generate(&request).unwrap().arena_used, plan.arena_bytes);
    // Edited behind the decoder: less memory, and nothing but the planner's and the last decoding's work.
    let exact = plan_of(mtn_limits { evaluations: 0, exact: 1, ..words }).unwrap();
    assert!(exact.arena_bytes <= plan.arena_bytes && exact.evaluations == 1 && exact.gradients == 0, "{exact:?}");
    let edited = mtn_request { evaluations: 0, exact: 1, ..request };
    let motion = Bench::new(exact.arena_bytes).generate(&edited).unwrap();
    assert_eq!((motion.arena_used, motion.evaluations), (exact.arena_bytes, 0));
    assert!(motion.worst_error < 0.002 && motion.control_error_before > 0.05, "{motion:?}");
    let roomy = plan_of(mtn_limits { rows: 24, ..words }).unwrap();
    assert!(roomy.arena_bytes > plan.arena_bytes && roomy.macs == plan.macs);
    let mut bench = Bench::new(roomy.arena_bytes);
    let before = bench.generate(&request).unwrap().arena_used;
    // SAFETY: an opened generator.
    assert_eq!(unsafe { mtn_generator_set_rows(&mut *bench.generator, 24) }, FINE);
    assert_eq!([before, bench.generate(&request).unwrap().arena_used], [plan.arena_bytes, roomy.arena_bytes]);
    assert_eq!(
        plan_of(mtn_limits { frames: 0, ..words }).unwrap(),
        plan_of(mtn_limits { frames: 196, ..words }).unwrap()
    );

    let refused = |limits| plan_of(limits).unwrap_err();
    assert_eq!(refused(mtn_limits { frames: 197, ..limits }), result(mtn_error::MotionLength, 0, 50, 49));
    assert_eq!(refused(mtn_limits { frames: usize::MAX, ..limits }).error, mtn_error::MotionLength);
    assert_eq!(refused(mtn_limits { anchors: 33, ..limits }), result(mtn_error::TooManyAnchors, 0, 33, 32));
    assert_eq!(refused(mtn_limits { steps: 0, ..words }), result(mtn_error::Steps, 0, 0, 1000));
    assert_eq!(refused(mtn_limits { words: 1000, ..words }).error, mtn_error::PromptTooManyWords);

    // With tracks and obstacles: the pelvis, the right wrist, an anchored head, and what leads the figure out.
    let limits = mtn_limits { evaluations: 0, exact: 1, ..limits };
    let (tracks, obstacles) = (Tracks::new(), [pillar()]);
    let head = mtn_anchor { position: [0.0, 1.5, 0.3], frame: 2, family: MTN_FAMILY_JOINT, joint: 15 };
    let anchors = [head];
    let request = mtn_request {
        tracks: tracks.0.as_ptr(),
        track_count: 2,
        anchors: anchors.as_ptr(),
        anchor_count: 1,
        ..tokens()
    };
    // Of the head there are two: trunk and neck.
    let plan = plan_of(mtn_limits { anchors: 1, tracked: 4, ..limits }).unwrap();
    assert_eq!(Bench::new(plan.arena_bytes).generate(&request).unwrap().arena_used, plan.arena_bytes);
    assert!(plan.arena_bytes > plan_of(mtn_limits { anchors: 1, ..limits }).unwrap().arena_bytes);
    let small = Bench::new(plan.arena_bytes - 16).refused(&request);
    assert_eq!((small.error, small.limit as usize), (mtn_error::ArenaTooSmall, plan.arena_bytes));
    let both = mtn_request { obstacles: obstacles.as_ptr(), obstacle_count: 1, ..request };
    let most = plan_of(mtn_limits { anchors: 1, tracked: JOINTS, ..limits }).unwrap();
    assert!(Bench::new(most.arena_bytes).generate(&both).unwrap().arena_used <= most.arena_bytes);
    let said = mtn_request { frames: 32, anchors: ptr::null(), anchor_count: 0, ..text(c"a person walks forward") };
    let said = mtn_request { tracks: request.tracks, track_count: 2, ..said };
    let plan = plan_of(mtn_limits { words: 4, steps: 1, guidance: 2.0, anchors: 0, tracked: 2, ..limits }).unwrap();
    assert_eq!(Bench::new(plan.arena_bytes).generate(&said).unwrap().arena_used, plan.arena_bytes);
    assert_eq!(refused(mtn_limits { tracked: 23, ..limits }), result(mtn_error::TrackedJoints, 0, 23, 22));
    assert_eq!(refused(mtn_limits { tracked: 1, exact: 0, ..limits }), result(mtn_error::NotExact, 0, 0, 0));
}

#[test]
fn anchors_are_refused_by_place() {
    let mut bench = Bench::new(1 << 18);
    let mut refused = |second: mtn_anchor| bench.refused(&through(&[ROOT, second]));
    assert_eq!(refused(mtn_anchor { family: 3, ..WRIST }), result(mtn_error::UnknownFamily, 1, 3, 0));
    assert_eq!(refused(mtn_anchor { joint: 22, ..WRIST }), result(mtn_error::AnchorJoint, 1, 22, 22));
    assert_eq!(refused(mtn_anchor { frame: 32, ..WRIST }), result(mtn_error::AnchorFrame, 1, 32, 32));
    let nan = mtn_anchor { position: [0.0, f32::NAN, 0.0], ..WRIST };
    assert_eq!(refused(nan), result(mtn_error::AnchorNotFinite, 1, 0, 0));
    let far = mtn_anchor { position: [0.0, 2000.0, 0.0], ..WRIST };
    assert_eq!(refused(far), result(mtn_error::AnchorTooFar, 1, 0, 1000));
    let elsewhere = mtn_anchor { position: [9.0, 0.9, 0.5], ..ROOT };
    assert_eq!(refused(elsewhere), result(mtn_error::AnchorConflict, 1, 0, 0));
    let many = [ROOT; MTN_MAX_ANCHORS + 1];
    assert_eq!(bench.refused(&through(&many)), result(mtn_error::TooManyAnchors, 0, 33, 32));
    // The height of a planar anchor and the joint of a root anchor are not looked at.
    let planar = mtn_anchor { position: [0.0, f32::NAN, 0.4], family: MTN_FAMILY_PLANAR, joint: 99, ..WRIST };
    assert!(bench.generate(&through(&[ROOT, planar])).is_ok());
}

#[test]
fn requests_are_refused_with_their_numbers() {
    let mut bench = Bench::new(1 << 18);
    let mut refused = |request: mtn_request| bench.refused(&request);
    assert_eq!(refused(mtn_request_default()), result(mtn_error::Source, 0, 0, 1));
    assert_eq!(refused(mtn_request { text: c"wave".as_ptr(), ..tokens() }), result(mtn_error::Source, 0, 2, 1));
    assert_eq!(refused(mtn_request { token_count: 0, ..tokens() }), result(mtn_error::TokenCount, 0, 0, 49));
    let unknown = [3, 60000];
    let request = mtn_request { tokens: unknown.as_ptr(), token_count: 2, ..tokens() };
    assert_eq!(refused(request), result(mtn_error::TokenOutOfRange, 1, 60000, 512));
    assert_eq!(refused(text(c" .")), result(mtn_error::PromptEmpty, 0, 0, 0));
    assert_eq!(refused(text(c"walk \xFF")), result(mtn_error::PromptNotUtf8, 5, 0, 0));
    assert_eq!(refused(text(c"zorb frumious")), result(mtn_error::PromptUnknownWords, 0, 2, 0));
    let mut long = vec![b'a'; 5000];
    long.push(0);
    let long = CStr::from_bytes_with_nul(&long).unwrap();
    assert_eq!(refused(text(long)), result(mtn_error::PromptTooLong, 0, 4097, 4096));
    assert_eq!(refused(mtn_request { steps: 0, ..text(c"walk") }), result(mtn_error::Steps, 0, 0, 1000));
    assert_eq!(refused(mtn_request { guidance: f32::NAN, ..text(c"walk") }).error, mtn_error::Guidance);
    assert_eq!(refused(mtn_request { frames: 200, ..text(c"walk") }), result(mtn_error::MotionLength, 0, 50, 49));
    let name = mtn_request { stored: c"no such prompt".as_ptr(), ..mtn_request_default() };
    assert_eq!(refused(name).error, mtn_error::PromptNotStored);
    let vector = [0.5; 512];
    let vector = mtn_request { vector: vector.as_ptr(), vector_count: 512, ..mtn_request_default() };
    assert_eq!(refused(vector), result(mtn_error::PromptNoVectors, 0, 0, 0));
    assert_eq!(refused(mtn_request { text: c"wave".as_ptr(), ..vector }), result(mtn_error::Source, 0, 2, 1));
    let motion = bench.generate(&text(c"a person zorbs forward")).unwrap();
    assert_eq!((motion.words, motion.unknown_words, motion.frames), (4, 1, 8));
}

#[test]
fn a_motion_has_the_bits_of_the_rust_library() {
    let mut bench = Bench::new(1 << 18);
    let anchors = [ROOT, WRIST];
    let motion = bench.generate(&mtn_request { evaluations: 5, ..bent(&anchors) }).unwrap();
    let mut hash = 0;
    // SAFETY: the motion is the last one of its generator.
    assert_eq!(unsafe { mtn_motion_hash(&motion, &mut hash) }, FINE);
    // SAFETY: as above.
    let joints = unsafe { core::slice::from_raw_parts(motion.joints, motion.frames) };

    // SAFETY: the blocks are contiguous bytes.
    let (_, blob, _) = unsafe { BLOB.align_to::<u8>() };
    let mut arena = vec![0; 1 << 18];
    let mut generator = Generator::new(Model::open(blob).unwrap(), &mut arena).unwrap();
    let anchors = [motionette::Anchor::root(28, [0.1, 0.9, 0.5]), motionette::Anchor::joint(16, 21, [-0.3, 1.4, 0.4])];
    let request = Request::tokens(&TOKENS).through(&anchors).refined(motionette::refining::Config::fast(5));
    let expected = generator.generate(&request, &mut ()).unwrap();
    assert_eq!(hash, expected.hash());
    assert_eq!(joints, expected.frames());
    let after = expected.refinement.unwrap().after.unwrap();
    assert_eq!((motion.control_error, motion.worst_error), (after.mean, after.worst));
    assert_eq!((motion.frame_rate, motion.token_count), (20, 8));
    // SAFETY: everything is valid.
    assert_eq!(unsafe { mtn_self_test(&mut *bench.generator) }, FINE);
}

/// Joint positions of a motion.
fn joints_of(motion: &mtn_motion) -> Vec<[f32; 3]> {
    // SAFETY: the motion has so many numbers, and its generator was not used since.
    unsafe { core::slice::from_raw_parts(motion.joints.cast::<[f32; 3]>(), motion.frames * JOINTS) }.to_vec()
}

#[test]
fn a_skeleton_of_one_s_own_moves_and_feet_stand_if_they_are_to() {
    let mut bench = Bench::new(1 << 18);
    // SAFETY: the blocks are contiguous bytes.
    let (_, blob, _) = unsafe { BLOB.align_to::<u8>() };
    let own = Model::open(blob).unwrap().skeleton().offsets();
    let mut moved = |bones: &[[f32; 3]; JOINTS], free_feet| {
        let request = mtn_request { bones, free_feet, ..tokens() };
        bench.generate(&request).map(|motion| joints_of(&motion))
    };
    let larger = own.map(|offset| offset.map(|value| 1.5 * value));
    let [same, large, free] = [(&own, 0), (&larger, 0), (&own, 1)].map(|(bones, free)| moved(bones, free).unwrap());
    let shin = |joints: &[[f32; 3]]| {
        let [a, b] = [joints[4], joints[7]];
        a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt()
    };
    assert!((shin(&large) / shin(&same) - 1.5).abs() < 1e-3);
    assert_ne!(same, free);
    let mut broken = own;
    broken[5] = [0.0, f32::NAN, 0.0];
    assert_eq!(moved(&broken, 0), Err(result(mtn_error::Bone, 5, 0, 0)));
    assert_eq!(joints_of(&bench.generate(&tokens()).unwrap()), same);
}

/// What a motion says was understood of its prompt, in so many bytes.
fn in_words(bench: &mut Bench, motion: &mtn_motion, bytes: usize) -> Result<String, mtn_result> {
    let mut text = vec![0x7F_u8; bytes + 1];
    // SAFETY: everything is valid.
    let said = unsafe { mtn_motion_understood(&mut *bench.generator, motion, text.as_mut_ptr().cast(), bytes) };
    assert_eq!(text[bytes], 0x7F, "nothing is written beyond the room");
    if said == FINE { Ok(CStr::from_bytes_until_nul(&text).unwrap().to_str().unwrap().into()) } else { Err(said) }
}

#[test]
fn what_was_understood_is_what_the_rust_library_says() {
    let mut bench = Bench::new(1 << 18);
    let motion = bench.generate(&text(c"a person waves")).unwrap();
    // SAFETY: the blocks are contiguous bytes.
    let (_, blob, _) = unsafe { BLOB.align_to::<u8>() };
    let mut arena = vec![0; 1 << 18];
    let mut generator = Generator::new(Model::open(blob).unwrap(), &mut arena).unwrap();
    let request = Request::text("a person waves").length(Length::Tokens(2)).steps(1);
    let expected = generator.generate(&request, &mut ()).unwrap().understood();
    assert_eq!(motion.understood, expected.map_or(mtn_understood::NOTHING, mtn_understood::from));
    let model = generator.model();
    let expected = expected.map_or(String::new(), |understood| model.in_words(understood).to_string());
    assert_eq!(in_words(&mut bench, &motion, 256), Ok(expected));

    // Whatever a motion says: of a style, of nothing sure, in too little room.
    let guess = |phrase, score| mtn_guess { phrase, score };
    let actions = [guess(0, 0.861), guess(1, 0.25), guess(MTN_NO_PHRASE, 0.0)];
    let none = guess(MTN_NO_PHRASE, 0.0);
    for (style, sure) in [(none, 1), (guess(1, 0.7), 1), (none, 0), (guess(2, 0.9), 200)] {
        let understood = mtn_understood { actions, style, sure };
        let expected = generator.model().in_words(understood.understood().unwrap()).to_string();
        let motion = mtn_motion { understood, ..motion };
        assert_eq!(in_words(&mut bench, &motion, 256), Ok(expected.clone()));
        for bytes in 1..=expected.len() {
            assert_eq!(in_words(&mut bench, &motion, bytes).unwrap(), expected[..bytes - 1]);
        }
    }
    // One thing behind the other, in as much room as there is.
    let first = mtn_understood { actions, style: none, sure: 1 };
    let second = mtn_understood { style: guess(1, 0.7), ..first };
    let both = mtn_motion { understood: first, then: [second, mtn_understood::NOTHING], ..motion };
    let words = |understood: mtn_understood| generator.model().in_words(understood.understood().unwrap()).to_string();
    let expected = std::format!("{}, then {}", words(first), words(second));
    for bytes in [1, words(first).len() + 1, words(first).len() + 5, expected.len(), 256] {
        assert_eq!(in_words(&mut bench, &both, bytes).unwrap(), expected[..expected.len().min(bytes - 1)]);
    }
    let silent = mtn_motion { understood: mtn_understood::NOTHING, ..motion };
    assert_eq!(in_words(&mut bench, &silent, 1), Ok(String::new()));
    assert_eq!(in_words(&mut bench, &silent, 0), Err(result(mtn_error::Length, 3, 0, 1)));
}

/// What a callback is to answer, and what it saw.
struct Watched {
    generator: *mut mtn_generator,
    answer: mtn_flow,
    calls: usize,
    measured: usize,
    inside: mtn_result,
}

unsafe extern "C" fn watch(context: *mut c_void, progress: *const mtn_progress) -> mtn_flow {
    // SAFETY: the test passes a `Watched`.
    let watched = unsafe { &mut *context.cast::<Watched>() };
    // SAFETY: valid during the call.
    let progress = unsafe { &*progress };
    watched.calls += 1;
    watched.measured += usize::from(progress.control_error >= 0.0);
    // SAFETY: refused, because the generator is at work.
    watched.inside = unsafe { mtn_self_test(watched.generator) };
    if progress.stage == mtn_stage::Refining && watched.measured >= 2 { watched.answer } else { MTN_FLOW_CONTINUE }
}

#[test]
fn callbacks_finish_abort_and_cannot_use_the_generator() {
    let mut bench = Bench::new(1 << 18);
    let (anchors, mut motion) = ([ROOT, WRIST], zeroed::<mtn_motion>());
    let mut run = |answer| {
        let generator: *mut mtn_generator = &mut *bench.generator;
        let mut watched = Watched { generator, answer, calls: 0, measured: 0, inside: FINE };
        let context = ptr::from_mut(&mut watched).cast();
        // SAFETY: everything is valid.
        let made = unsafe { mtn_generate(generator, &bent(&anchors), Some(watch), context, &mut *motion) };
        assert_eq!(watched.inside, result(mtn_error::Busy, 0, 0, 0));
        (made, watched.calls, motion.evaluations)
    };
    let (made, all, evaluations) = run(MTN_FLOW_CONTINUE);
    assert!(made == FINE && evaluations > 3, "{evaluations}");
    let (made, some, evaluations) = run(MTN_FLOW_FINISH);
    assert!(made == FINE && some < all && evaluations == 2, "{evaluations}");
    for answer in [MTN_FLOW_ABORT, 77] {
        let (made, fewer, _) = run(answer);
        assert_eq!(made, result(mtn_error::Aborted, 0, 0, 0));
        assert!(fewer < some);
    }
    assert_eq!(run(MTN_FLOW_CONTINUE), (FINE, all, run(MTN_FLOW_CONTINUE).2));
}

#[test]
fn messages_are_c_strings() {
    // SAFETY: the library returns a zero-terminated string.
    let message = unsafe { CStr::from_ptr(mtn_error_message(mtn_error::ArenaTooSmall as i32)) };
    assert_eq!(message, c"the arena is too small for the request");
}
