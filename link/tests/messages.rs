//! Every message there and back, and the bytes of two of them.

mod common;

use common::{Random, Raw};
use motionette::refining::Config;
use motionette::{BodyParts, Error, ObstacleError, PromptError, TimelineError, TrackError};
use motionette_link::frame::{Faults, Receiver, encode, frame_bytes};
use motionette_link::message::{
    ANCHORS, Anchor, Blob, BlobFault, CHUNK_BYTES, Clearance, Command, Condition, ConditionsFault, DeviceLimits, Event,
    FEATURE_BYTES, Failure, Feature, FlashFault, Generate, Header, Hello, JobStage, Length, LossAction, Measure,
    ModelInfo, NAME_BYTES, ObstacleFault, Owner, PHRASE_BYTES, PROTOCOL, PromptFault, REPLY_BYTES, REPLY_FRAME,
    REQUEST_BYTES, REQUEST_FRAME, Refinement, Refusal, RefusedBlob, Reply, Start, StartFault, State, Status, Strain,
    TEXT_BYTES, Target, TimelineFault, TrackFault, Tracking, Transfer, Understood, UpdateFault, Work, name,
};
use serde::{Serialize, de::DeserializeOwned};

const HEADER: Header = Header { version: PROTOCOL, session: u32::MAX, id: u32::MAX };

fn round_trip<T: Serialize + DeserializeOwned + PartialEq + core::fmt::Debug>(message: &T, limit: usize) {
    let mut buffer = [0; REQUEST_FRAME];
    let frame = encode(&(HEADER, message), &mut buffer[..limit]).unwrap();
    let mut receiver = Receiver::<REQUEST_BYTES>::new();
    let mut bytes = frame;
    let received = receiver.next(&mut bytes).unwrap().unwrap();
    let (header, body): (Header, &[u8]) = postcard::take_from_bytes(received).unwrap();
    assert_eq!(header, HEADER);
    let (back, rest) = postcard::take_from_bytes::<T>(body).unwrap();
    assert_eq!((&back, rest), (message, &[][..]));
}

fn largest_request() -> Generate {
    let anchor = Anchor { frame: u16::MAX, target: Target::Joint { joint: 21, position: [-1.5e30, 0.25, f32::MIN] } };
    Generate {
        text: core::iter::repeat_n('x', TEXT_BYTES).collect(),
        length: Length::Frames(u16::MAX),
        seed: u64::MAX,
        steps: u16::MAX,
        guidance: 1.5,
        refinement: Refinement(u8::MAX),
        evaluations: u16::MAX,
        anchors: [anchor; ANCHORS].into_iter().collect(),
        play_when_ready: true,
        conditions: true,
    }
}

#[test]
fn every_command_there_and_back() {
    let commands = [
        Command::Hello { take_over: true },
        Command::Generate(largest_request()),
        Command::Generate(Generate::new("a person bows".try_into().unwrap())),
        Command::Play,
        Command::Stop,
        Command::Hold,
        Command::Resume,
        Command::Neutral,
        Command::Status,
        Command::SelfTest,
        Command::BlobBegin { length: u32::MAX, crc32: u32::MAX },
        Command::BlobChunk { offset: u32::MAX, bytes: (0..CHUNK_BYTES).map(|b| b as u8).collect() },
        Command::BlobCommit,
        Command::BlobAbort,
        Command::KeepAlive,
        Command::Release,
        Command::Close,
        Command::ConditionsBegin { length: u32::MAX, crc32: u32::MAX },
        Command::ConditionsChunk { offset: u32::MAX, bytes: (0..CHUNK_BYTES).map(|b| b as u8).collect() },
    ];
    for (index, command) in commands.iter().enumerate() {
        round_trip(command, REQUEST_FRAME);
        // The variant's number is the wire format: two requests of one kind stand in the list.
        let number = postcard::to_slice(command, &mut [0; REQUEST_BYTES]).unwrap()[0];
        assert_eq!(usize::from(number), if index < 2 { index } else { index - 1 }, "{command:?}");
    }
}

#[test]
fn every_reply_there_and_back() {
    let full = name(&"é".repeat(NAME_BYTES));
    assert_eq!(full.len(), NAME_BYTES);
    let blob = Blob { slot: 1, sequence: u32::MAX, length: u32::MAX, crc32: u32::MAX };
    let ready = Event::Ready {
        job: u32::MAX,
        frames: u16::MAX,
        control_error: Some(0.5),
        understood: Some(Understood { phrase: core::iter::repeat_n('x', PHRASE_BYTES).collect(), score: 0.5 }),
        strain: Some(Strain { measure: Measure(u8::MAX), value: 1.5, anchor: u16::MAX }),
        tracking: Some(Tracking { mean: 0.5, worst: 1.5, track: u16::MAX, frame: u16::MAX, hurried: u16::MAX }),
        clearance: Some(Clearance { least: -0.5, missing: 0.5, obstacle: u16::MAX, joint: u8::MAX, frame: u16::MAX }),
    };
    let events =
        [ready.clone(), Event::Finished, Event::SelfTest { job: 3, passed: None }, Event::HostLost(LossAction::Abort)];
    let failures = [
        Failure::Memory { needed: u32::MAX, available: u32::MAX },
        Failure::FloatingPoint,
        Failure::Tokens { found: u32::MAX, limit: u32::MAX },
        Failure::NoPlanner,
        Failure::Prompt(PromptFault::VectorWidth { found: u32::MAX, width: u32::MAX }),
        Failure::Steps { found: 0, limit: 1000 },
        Failure::Guidance { found: -1.0 },
        Failure::Anchors { found: 33, limit: 32 },
        Failure::AnchorFrame { index: u32::MAX, frame: u16::MAX, frames: u32::MAX },
        Failure::AnchorJoint { index: 1, joint: 22 },
        Failure::AnchorPosition { index: 1 },
        Failure::AnchorConflict { first: u32::MAX, second: u32::MAX },
        Failure::Aborted,
        Failure::Solver,
        Failure::Unknown,
        Failure::NotLinked { feature: Feature::new("refining") },
        Failure::Tracks(TrackFault::AnchorConflict { track: u32::MAX, anchor: u32::MAX, frame: u32::MAX }),
        Failure::Obstacles(ObstacleFault::TrackInside { index: u32::MAX, track: u32::MAX, frame: u32::MAX }),
        Failure::Timeline(TimelineFault::OutOfRange { index: u8::MAX, end: u32::MAX, frames: u32::MAX }),
        Failure::Timeline(TimelineFault::Prompt {
            index: u8::MAX,
            error: PromptFault::TooLong { found: u32::MAX, limit: u32::MAX },
        }),
    ];
    let updates = [
        UpdateFault::Length { length: u32::MAX, limit: u32::MAX },
        UpdateFault::NoTransfer,
        UpdateFault::Incomplete { next: 1, length: 2 },
        UpdateFault::Checksum { computed: u32::MAX, announced: 0 },
        UpdateFault::Model(BlobFault::Version { found: u16::MAX, supported: 3 }),
        UpdateFault::Memory { needed: u32::MAX, available: u32::MAX },
        UpdateFault::Flash(FlashFault::ReadBack),
        UpdateFault::Layout,
        UpdateFault::Model(BlobFault::Unknown { major: u16::MAX, minor: u16::MAX }),
        UpdateFault::Model(BlobFault::NotLinked { feature: Feature::new(&"x".repeat(FEATURE_BYTES)) }),
    ];
    let refused = Some(RefusedBlob { blob, why: updates[9] });
    let faults = Faults { encoding: u32::MAX, too_long: u32::MAX, checksum: u32::MAX, unfit: u32::MAX };
    let out_of_range = StartFault::OutOfRange { decidegrees: i16::MIN };
    let device = Condition {
        start: Start::Refused { channel: u8::MAX, why: out_of_range },
        state: State::Stopped,
        work: Some(Work { job: u32::MAX, stage: JobStage::Testing, step: u16::MAX, steps: u16::MAX }),
        frames_queued: u16::MAX,
        ticks: u32::MAX,
        missed_ticks: u32::MAX,
        starved_ticks: u32::MAX,
        limited_ticks: u32::MAX,
        bus_faults: u32::MAX,
    };
    let status = Status {
        owner: Owner::Nobody,
        device,
        outcome: Some(ready),
        refused,
        transfer: Some(Transfer { next: u32::MAX, length: u32::MAX }),
        staged: Some(Transfer { next: u32::MAX, length: u32::MAX }),
        host_lost: Some(LossAction::Hold),
        skipped: faults,
        unsent: u32::MAX,
    };
    let hello = Hello {
        version: full.clone(),
        preset: full.clone(),
        model: Some(ModelInfo { name: full, frame_rate: u16::MAX, frames: u16::MAX }),
        blob: Some(blob),
        refused,
        limits: DeviceLimits {
            text_bytes: u16::MAX,
            anchors: u8::MAX,
            chunk_bytes: u16::MAX,
            blob_bytes: u32::MAX,
            condition_bytes: u32::MAX,
            spans: u8::MAX,
            silence_ms: u32::MAX,
            on_silence: LossAction::Finish,
        },
    };
    let refusals = [
        Refusal::Version { supported: 255 },
        Refusal::Session,
        Refusal::Stale { last: u32::MAX },
        Refusal::Malformed,
        Refusal::Busy { job: u32::MAX },
        Refusal::Moving,
        Refusal::Stopped,
        Refusal::NothingToPlay,
        Refusal::NotPlaying,
        Refusal::Transferring { next: u32::MAX, length: u32::MAX },
        Refusal::NoModel,
        Refusal::NoStorage,
    ];
    let later = [
        Refusal::Occupied { free_in_ms: Some(u32::MAX) },
        Refusal::NotReady(Start::Refused { channel: 0, why: StartFault::Silent }),
        Refusal::NotWaiting,
        Refusal::Refinement { found: u8::MAX },
        Refusal::Unusable(updates[4]),
        Refusal::Conditions(ConditionsFault::NoArea),
        Refusal::Conditions(ConditionsFault::Length { length: u32::MAX, limit: u32::MAX }),
        Refusal::Conditions(ConditionsFault::NotSent),
        Refusal::Conditions(ConditionsFault::Incomplete { next: u32::MAX, length: u32::MAX }),
        Refusal::Conditions(ConditionsFault::Checksum { computed: u32::MAX, announced: u32::MAX }),
        Refusal::Conditions(ConditionsFault::Format { at: u32::MAX }),
    ];
    let starts = [Start::Reading, Start::Waiting, Start::Creeping, Start::Ready];
    let mut replies = vec![
        Reply::Hello(hello),
        Reply::Accepted,
        Reply::Status(status),
        Reply::Chunk { next: u32::MAX },
        Reply::Committed(blob),
    ];
    let failed = failures.map(|why| Event::Failed { job: u32::MAX, why });
    replies.extend(events.into_iter().chain(failed).map(Reply::Event));
    let refusals = refusals.into_iter().chain(updates.map(Refusal::Update)).chain(later).collect::<Vec<_>>();
    replies.extend(refusals.iter().copied().map(Reply::Refused));
    replies.extend(starts.map(|start| Reply::Refused(Refusal::NotReady(start))));
    for reply in &replies {
        round_trip(reply, REPLY_FRAME);
    }
    for words in failures.iter().map(ToString::to_string).chain(refusals.iter().map(ToString::to_string)) {
        assert!(!words.is_empty());
    }
}

/// The example of PROTOCOL.md.
#[test]
fn bytes_of_a_request_and_its_reply() {
    let mut buffer = [0; REQUEST_FRAME];
    let header = Header::new(0x1234, 2);
    let begin = Command::BlobBegin { length: 1000, crc32: 0xCAFE_F00D };
    let frame = encode(&(header, begin), &mut buffer).unwrap();
    #[rustfmt::skip]
    let whole = [
        0x00, // delimiter
        0x11, // COBS: no zero in the next 16 bytes
        0x04, // version
        0xB4, 0x24, // session 0x1234
        0x02, // id
        0x09, // BlobBegin
        0xE8, 0x07, // length 1000
        0x8D, 0xE0, 0xFB, 0xD7, 0x0C, // crc32 0xCAFEF00D
        0x07, 0x0E, 0x93, 0x2C, // CRC-32 of the twelve bytes above, as zlib has it
        0x00, // delimiter
    ];
    assert_eq!(frame, whole);

    let header = Header::reply(0x1234, 2);
    let frame = encode(&(header, Reply::Chunk { next: 0 }), &mut buffer).unwrap();
    #[rustfmt::skip]
    let whole = [
        0x00, // delimiter
        0x06, // COBS: the next zero stands 6 bytes on
        0x84, 0xB4, 0x24, 0x02, // version with the device's bit, session, id
        0x04, // Chunk
        0x05, // next 0: a zero of the message; the next one stands 5 bytes on
        0xBA, 0x70, 0x1C, 0x99, // CRC-32
        0x00, // delimiter
    ];
    assert_eq!(frame, whole);
}

/// Fields stand in the order of PROTOCOL.md, and every number is the variant that stands there.
#[test]
fn bytes_of_what_protocols_2_to_4_brought() {
    fn bytes(message: &impl Serialize) -> Vec<u8> {
        postcard::to_slice(message, &mut [0; REQUEST_BYTES]).unwrap().to_vec()
    }
    assert_eq!(bytes(&Command::Hello { take_over: true }), [0, 1]);
    assert_eq!(bytes(&Command::Release), [14]);
    assert_eq!(bytes(&Command::Close), [15]);
    assert_eq!(bytes(&Command::ConditionsBegin { length: 300, crc32: 1 }), [16, 0xAC, 0x02, 1]);
    let chunk = Command::ConditionsChunk { offset: 240, bytes: [7, 0].into_iter().collect() };
    assert_eq!(bytes(&chunk), [17, 0xF0, 0x01, 2, 7, 0]);
    let request =
        Generate { refinement: Refinement::PUBLISHED, evaluations: 7, ..Generate::new("hi".try_into().unwrap()) };
    #[rustfmt::skip]
    let expected = [
        1, // Generate
        2, b'h', b'i',
        1, // length: predicted
        0, 5, // seed, steps
        0, 0, 0, 0x40, // guidance 2
        3, // refinement
        7, // evaluations
        0, // anchors
        0, // play_when_ready
        0, // conditions
    ];
    assert_eq!(bytes(&Command::Generate(request)), expected);
    let ready = Event::Ready {
        job: 300,
        frames: 40,
        control_error: Some(0.5),
        understood: Some(Understood { phrase: "bows".try_into().unwrap(), score: 0.25 }),
        strain: Some(Strain { measure: Measure::DISTANCE, value: 1.0, anchor: 31 }),
        tracking: Some(Tracking { mean: 0.5, worst: 1.0, track: 3, frame: 300, hurried: 2 }),
        clearance: Some(Clearance { least: -0.5, missing: 0.25, obstacle: 4, joint: 21, frame: 300 }),
    };
    #[rustfmt::skip]
    let expected = [
        6, 0, // Event, Ready
        0xAC, 0x02, 40, // job 300, frames
        1, 0, 0, 0, 0x3F, // control_error 0.5
        1, 4, b'b', b'o', b'w', b's', 0, 0, 0x80, 0x3E, // understood, score 0.25
        1, 0, 0, 0, 0x80, 0x3F, 31, // strain: distance, 1 m, anchor
        1, 0, 0, 0, 0x3F, 0, 0, 0x80, 0x3F, 3, 0xAC, 0x02, 2, // tracking: mean, worst, track, frame, hurried
        1, 0, 0, 0, 0xBF, 0, 0, 0x80, 0x3E, 4, 21, 0xAC, 0x02, // clearance: least, missing, obstacle, joint, frame
    ];
    assert_eq!(bytes(&Reply::Event(ready)), expected);
    assert_eq!(bytes(&Reply::Event(Event::Start(Start::Creeping))), [6, 5, 2]);
    let refused = |refusal| bytes(&Reply::Refused(refusal));
    assert_eq!(refused(Refusal::Occupied { free_in_ms: Some(500) }), [2, 13, 1, 0xF4, 0x03]);
    let why = StartFault::OutOfRange { decidegrees: -3 };
    // Signed numbers are zigzag: -3 is 5.
    assert_eq!(refused(Refusal::NotReady(Start::Refused { channel: 9, why })), [2, 14, 4, 9, 1, 5]);
    assert_eq!(refused(Refusal::NotWaiting), [2, 15]);
    assert_eq!(refused(Refusal::Refinement { found: 200 }), [2, 16, 200]);
    assert_eq!(refused(Refusal::Conditions(ConditionsFault::NoArea)), [2, 18, 0]);
    assert_eq!(refused(Refusal::Conditions(ConditionsFault::Length { length: 5, limit: 300 })), [2, 18, 1, 5, 0xAC, 2]);
    assert_eq!(refused(Refusal::Conditions(ConditionsFault::NotSent)), [2, 18, 2]);
    assert_eq!(refused(Refusal::Conditions(ConditionsFault::Incomplete { next: 1, length: 8 })), [2, 18, 3, 1, 8]);
    let checksum = ConditionsFault::Checksum { computed: 1, announced: 2 };
    assert_eq!(refused(Refusal::Conditions(checksum)), [2, 18, 4, 1, 2]);
    assert_eq!(refused(Refusal::Conditions(ConditionsFault::Format { at: 12 })), [2, 18, 5, 12]);
    let failed = |why| bytes(&Reply::Event(Event::Failed { job: 1, why }));
    let track = TrackFault::Position { index: 1, frame: 2, limit: 1000.0 };
    assert_eq!(failed(Failure::Tracks(track)), [6, 2, 1, 16, 5, 1, 2, 0, 0, 0x7A, 0x44]);
    let obstacle = ObstacleFault::TrackInside { index: 3, track: 4, frame: 300 };
    assert_eq!(failed(Failure::Obstacles(obstacle)), [6, 2, 1, 17, 8, 3, 4, 0xAC, 2]);
    let width = PromptFault::VectorWidth { found: 3, width: 512 };
    assert_eq!(failed(Failure::Prompt(width)), [6, 2, 1, 4, 3, 3, 0x80, 4]);
    let overlap = TimelineFault::Overlap { first: 1, second: 2, parts: 39 };
    assert_eq!(failed(Failure::Timeline(overlap)), [6, 2, 1, 18, 4, 1, 2, 39]);
    let beyond = TimelineFault::OutOfRange { index: 1, end: 300, frames: 40 };
    assert_eq!(failed(Failure::Timeline(beyond)), [6, 2, 1, 18, 3, 1, 0xAC, 2, 40]);
    let prompt = TimelineFault::Prompt { index: 7, error: width };
    assert_eq!(failed(Failure::Timeline(prompt)), [6, 2, 1, 18, 5, 7, 3, 3, 0x80, 4]);
    let limits = DeviceLimits {
        text_bytes: 192,
        anchors: 32,
        chunk_bytes: 240,
        blob_bytes: 0,
        condition_bytes: 300,
        spans: 8,
        silence_ms: 5,
        on_silence: LossAction::Hold,
    };
    assert_eq!(bytes(&limits), [0xC0, 1, 32, 0xF0, 1, 0, 0xAC, 2, 8, 5, 1]);
    let version = UpdateFault::Model(BlobFault::Version { found: 3, supported: 4 });
    assert_eq!(refused(Refusal::Unusable(version)), [2, 17, 4, 3, 3, 4]);
    // Numbers of a blob's faults stay what they are: later ones go to the end.
    let update = |fault| refused(Refusal::Update(UpdateFault::Model(fault)));
    assert_eq!(update(BlobFault::Structure), [2, 12, 4, 7]);
    assert_eq!(update(BlobFault::Unknown { major: 4, minor: 3 }), [2, 12, 4, 8, 4, 3]);
    let feature = Feature::new("tmd");
    assert_eq!(update(BlobFault::NotLinked { feature }), [2, 12, 4, 9, 3, b't', b'm', b'd']);
}

#[test]
fn a_blob_that_needs_other_firmware_is_no_damaged_one() {
    let of = |error: motionette::blob::Error| BlobFault::from(error);
    assert_eq!(of(motionette::blob::Error::Manifest), BlobFault::Structure);
    let unknown = motionette::blob::Error::Unknown { section: "codec", found: 1, known: 1, minor: 3 };
    let (unknown, major) = (of(unknown), motionette::blob::MAJOR);
    assert_eq!(unknown, BlobFault::Unknown { major, minor: 3 });
    assert!(unknown.to_string().contains(&format!("firmware that reads format {major}.3")), "{unknown}");
    let left_out = of(motionette::blob::Error::NotLinked { feature: "tmd" });
    assert_eq!(left_out, BlobFault::NotLinked { feature: Feature::new("tmd") });
    assert!(left_out.to_string().contains("`tmd`") && left_out.to_string().contains("cargo feature"), "{left_out}");
}

/// What the runtime says of prompts, tracks, obstacles and timelines a host says in the same words. Their numbers on the wire are those of
/// the order here.
#[test]
fn failures_keep_the_runtime_s_words() {
    let prompts = [
        PromptError::NoEncoder { stored: 3 },
        PromptError::Vectors { width: 512, stored: 3 },
        PromptError::NoVectors,
        PromptError::VectorWidth { found: 3, width: 512 },
        PromptError::VectorValue { index: 9 },
        PromptError::ZeroVector,
        PromptError::Empty,
        PromptError::TooLong { found: 200, limit: 192 },
        PromptError::TooManyWords { found: 40, limit: 32 },
        PromptError::OnlyUnknownWords { words: 2 },
        PromptError::NotStored { stored: 3 },
    ];
    let tracks = [
        TrackError::TooMany { tracks: 25, limit: 24 },
        TrackError::Nothing { index: 1 },
        TrackError::Mask { index: 1, found: 2, positions: 3 },
        TrackError::JointOutOfRange { index: 1, joint: 22, joints: 22 },
        TrackError::FrameOutOfRange { index: 1, frame: 40, frames: 40 },
        TrackError::Position { index: 1, frame: 2, limit: 1000.0 },
        TrackError::Tolerance { index: 1, tolerance: -0.5 },
        TrackError::Conflict { first: 1, second: 2, frame: 3 },
        TrackError::AnchorConflict { track: 1, anchor: 2, frame: 3 },
        TrackError::NotExact,
    ];
    let obstacles = [
        ObstacleError::TooMany { obstacles: 17, limit: 16 },
        ObstacleError::Size { index: 1 },
        ObstacleError::Margin { index: 1, margin: 1.5 },
        ObstacleError::Place { index: 1 },
        ObstacleError::TooFast { index: 1, speed: 30.5, limit: 20.0 },
        ObstacleError::Keyframes { index: 1, keyframe: 2 },
        ObstacleError::Joints { index: 1 },
        ObstacleError::AnchorInside { index: 1, anchor: 2 },
        ObstacleError::TrackInside { index: 1, track: 2, frame: 3 },
    ];
    let timelines = [
        TimelineError::TooMany { spans: 9, limit: 8 },
        TimelineError::NoParts { index: 1 },
        TimelineError::TooShort { index: 1, frames: 7 },
        TimelineError::OutOfRange { index: 1, end: 48, frames: 40 },
        TimelineError::Overlap { first: 1, second: 2, parts: BodyParts::LEFT_ARM.and(BodyParts::HEAD) },
        TimelineError::Prompt { index: 1, error: PromptError::Empty },
    ];
    let errors = [
        (4, prompts.map(Error::Prompt).to_vec()),
        (16, tracks.map(Error::Tracks).to_vec()),
        (17, obstacles.map(Error::Obstacles).to_vec()),
        (18, timelines.map(Error::Timeline).to_vec()),
    ];
    for (variant, errors) in errors {
        for (number, error) in (0..).zip(errors) {
            let failure = Failure::from(error);
            round_trip(&Event::Failed { job: 1, why: failure }, REPLY_FRAME);
            assert_eq!(failure.to_string(), error.to_string());
            let sent = postcard::to_slice(&failure, &mut [0; 32]).unwrap()[..2].to_vec();
            assert_eq!(sent, [variant, number], "{error}");
        }
    }
    for error in prompts {
        let error = TimelineError::Prompt { index: 5, error };
        assert_eq!(TimelineError::from(TimelineFault::from(error)), error);
    }
    // Parts that no device sends are none.
    let unheard = TimelineFault::Overlap { first: 0, second: 1, parts: 200 };
    assert_eq!(TimelineError::from(unheard), TimelineError::Overlap { first: 0, second: 1, parts: BodyParts::NONE });
    for feature in ["obstacles", "timeline"] {
        let left_out = Failure::from(Error::NotLinked { feature });
        assert_eq!(left_out, Failure::NotLinked { feature: Feature::new(feature) });
        assert!(left_out.to_string().contains(feature), "{left_out}");
    }
}

/// Names are cut between characters, and what comes over the line is a name or no message.
#[test]
fn names_of_features() {
    let name = format!("{}\u{e4}b", "x".repeat(FEATURE_BYTES - 1));
    assert_eq!(Feature::new(&name).as_str(), &name[..FEATURE_BYTES - 1]);
    assert_eq!(Feature::new("").as_str(), "");
    let read = |bytes: &[u8]| postcard::from_bytes::<Feature>(bytes).ok();
    assert_eq!(read(&[2, b'o', b'k']), Some(Feature::new("ok")));
    assert_eq!((read(&[1, 0xFF]), read(&[3, b'o', b'k'])), (None, None));
    assert_eq!(read(&[&[FEATURE_BYTES as u8 + 1][..], &[b'x'; FEATURE_BYTES + 1]].concat()), None);
}

#[test]
fn anchors_keep_their_meaning() {
    for anchor in [
        motionette::Anchor::root(3, [1.0, 2.0, 3.0]),
        motionette::Anchor::planar_root(4, [5.0, 6.0]),
        motionette::Anchor::joint(7, 21, [8.0, 9.0, 10.0]),
    ] {
        assert_eq!(motionette::Anchor::from(Anchor::from(anchor)), anchor);
    }
    let mut request = largest_request();
    let anchors = request.anchors();
    let made = request.request(&anchors);
    assert_eq!((made.anchors.len(), made.planning.steps, made.planning.seed), (ANCHORS, u16::MAX, u64::MAX));
    assert_eq!(made.planning.length, motionette::Length::Frames(u16::MAX));
    assert_eq!(made.refinement.map(|r| r.evaluations), Some(u16::MAX));
    request.refinement = Refinement::NONE;
    let made = request.request(&anchors);
    assert_eq!((made.anchors.len(), made.refinement), (ANCHORS, None));
    request.refinement = Refinement::PUBLISHED;
    let published = Config { evaluations: u16::MAX, ..Config::published(1) };
    assert_eq!(request.request(&anchors).refinement, Some(published));
    request.refinement = Refinement::EXACT;
    assert_eq!(request.request(&anchors).refinement, Some(Config::fast(u16::MAX).exactly()));
    request.refinement = Refinement::FAST;
    assert_eq!(request.request(&anchors).refinement, Some(Config::fast(u16::MAX)));
    request.refinement = Refinement::DEVICE;
    request.evaluations = 0;
    assert_eq!(request.request(&anchors).refinement, Some(Config::DEFAULT));
    // Feet stand without anchors as well, unless they are not to.
    request.anchors.clear();
    assert_eq!(request.request(&[]).refinement, Some(Config::DEFAULT));
    request.refinement = Refinement::EXACT_FREE_FEET;
    assert_eq!(request.request(&[]).refinement.and_then(|config| config.exact).map(|exact| exact.planted), Some(false));
}

#[test]
fn a_buffer_that_is_too_small_is_an_error() {
    let message = (HEADER, Command::Generate(largest_request()));
    let mut buffer = [0; REQUEST_FRAME];
    let length = encode(&message, &mut buffer).unwrap().len();
    for room in 0..length {
        assert_eq!(encode(&message, &mut buffer[..room]).unwrap_err().room, room);
    }
    assert_eq!(frame_bytes(REPLY_BYTES), REPLY_FRAME);
}

/// Frames of random messages of every length survive, also around COBS's blocks of 254.
#[test]
fn frames_of_any_length_and_content() {
    let mut random = Random::new(1);
    for length in 0..=REQUEST_BYTES - 4 {
        let message: Vec<u8> = match length % 3 {
            0 => vec![0; length],
            1 => (0..length).map(|_| random.bits() as u8 | 1).collect(),
            _ => random.bytes(length),
        };
        // A tuple of bytes, without a length in front.
        let mut buffer = vec![0; frame_bytes(length + 4)];
        let frame = encode(&Raw(&message), &mut buffer).unwrap();
        assert!(frame[1..frame.len() - 1].iter().all(|&byte| byte != 0));
        let mut receiver = Receiver::<REQUEST_BYTES>::new();
        assert_eq!(receiver.next(&mut &*frame), Some(Ok(&message[..])), "{length}");
    }
}
