//! Conditions byte for byte, in the runtime's types, and those that cannot be sent.

mod common;

use common::sent;
use motionette::{
    ALL_JOINTS, BodyParts, Course, Joint, Keyframe, MAX_OBSTACLES, MAX_SPANS, MAX_TRACKS, Obstacle, ObstacleError,
    Prompt, PromptError, Shape, Span, TimelineError, Track, TrackError,
};
use motionette_link::conditions::{Conditions, Given, KEYFRAMES, LEAST_BYTES, Unfit};
use motionette_link::message::{ConditionsFault, TEXT_BYTES};

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|four| u32::from_le_bytes(four.try_into().unwrap())).collect()
}

fn fault(bytes: &[u8]) -> u32 {
    match Conditions::open(&words(bytes)) {
        Err(ConditionsFault::Format { at }) => at,
        other => panic!("{other:?}"),
    }
}

/// The first example of PROTOCOL.md.
#[test]
fn bytes_of_a_track() {
    let tracks = [Track::new(Joint::RightWrist, 10, &[[-0.25, 1.25, 0.5]])];
    #[rustfmt::skip]
    let whole = [
        0x24, 0, 0, 0, // length
        2, 1, 0, 0, // format, tracks, obstacles, spans
        0, 0, 0, 0, // numbers of the vector
        21, 7, 10, 0, // joint, axes, first frame
        1, 0, 0, 0, // positions
        0, 0, 0, 0, // tolerance
        0, 0, 0x80, 0xBE, 0, 0, 0xA0, 0x3F, 0, 0, 0, 0x3F, // -0.25, 1.25, 0.5
    ];
    assert_eq!(sent(&Given { tracks: &tracks, ..Given::default() }), whole);
}

/// The second one.
#[test]
fn bytes_of_a_span() {
    let timeline = [Span::new(BodyParts::RIGHT_ARM, 20, 60, "a person waves")];
    #[rustfmt::skip]
    let whole = [
        0x24, 0, 0, 0, // length
        2, 0, 0, 1, // format, tracks, obstacles, spans
        0, 0, 0, 0, // numbers of the vector
        4, 0, 14, 0, // parts, text, its bytes
        20, 0, 60, 0, // first frame, frames
        b'a', b' ', b'p', b'e', b'r', b's', b'o', b'n', b' ', b'w', b'a', b'v', b'e', b's', 0, 0,
    ];
    assert_eq!(sent(&Given { timeline: &timeline, ..Given::default() }), whole);
}

#[test]
fn bytes_of_all_there_is() {
    let tracks = [Track::new(Joint::Pelvis, 258, &[[0.0; 3]; 5]).axes([true, false, true]).masked(&[1, 0, 0, 0, 9])];
    let keys = [Keyframe { frame: 0, position: [0.0; 3] }, Keyframe { frame: 300, position: [2.0, 0.0, 0.0] }];
    let [capsule, cylinder] =
        [Shape::Capsule { half: [0.0, 2.0, 0.0], radius: 0.5 }, Shape::Cylinder { radius: 0.5, half_height: 2.0 }];
    let obstacles = [
        Obstacle::new(Shape::Sphere { radius: 0.5 }, [0.0, 0.0, 2.0]).margin(0.0).joints(1 << 21),
        Obstacle::new(capsule, [0.0; 3]).margin(0.5),
        Obstacle::new(cylinder, [0.0; 3]).margin(0.5).moving(Course::Keyframes(&keys)),
        Obstacle::new(Shape::Box { half: [0.5; 3] }, [0.0; 3]).margin(0.5),
        Obstacle::new(Shape::Plane { normal: [0.0, 0.5, 0.0] }, [0.0; 3])
            .moving(Course::Moving { from: [0.0; 3], velocity: [0.0, 0.0, 0.5] })
            .margin(0.5),
    ];
    let arms = Span::new(BodyParts::ARMS, 258, 300, "waves");
    let timeline = [
        arms,
        Span { parts: BodyParts::UPPER_BODY, prompt: Prompt::Bank("w\u{e4}ve"), ..arms },
        Span { parts: BodyParts::NONE, frames: 0, prompt: Prompt::Vector(&[0.5, 2.0]), ..arms },
    ];
    let vector = Some(&[0.5, -0.5][..]);
    let bytes = sent(&Given { tracks: &tracks, obstacles: &obstacles, timeline: &timeline, vector });
    const HALF: [u8; 4] = [0, 0, 0, 0x3F];
    const TWO: [u8; 4] = [0, 0, 0, 0x40];
    const NONE: [u8; 4] = [0; 4];
    const EVERY: [u8; 4] = [0xFF, 0xFF, 0x3F, 0];
    #[rustfmt::skip]
    let expected: Vec<[u8; 4]> = [
        &[[0x60, 1, 0, 0], [2, 1, 5, 3], [2, 0, 0, 0], HALF, [0, 0, 0, 0xBF]][..],
        // Joint 0, x and z and a mask, from frame 258; the mask is filled up to two words.
        &[[0, 13, 2, 1], [5, 0, 0, 0], NONE], &[NONE; 15], &[[1, 0, 0, 0], [9, 0, 0, 0]],
        &[[0, 0, 0, 0], [0, 0, 0x20, 0], NONE, HALF, NONE, NONE, TWO],
        &[[1, 0, 0, 0], EVERY, HALF, NONE, TWO, NONE, HALF], &[NONE; 3],
        &[[2, 2, 2, 0], EVERY, HALF, HALF, TWO],
        &[NONE, NONE, NONE, NONE, [0x2C, 1, 0, 0], TWO, NONE, NONE],
        &[[3, 0, 0, 0], EVERY, HALF, HALF, HALF, HALF], &[NONE; 3],
        &[[4, 1, 0, 0], EVERY, HALF, NONE, HALF, NONE], &[NONE; 5], &[HALF],
        &[[6, 0, 5, 0], [2, 1, 0x2C, 1], *b"wave", [b's', 0, 0, 0]],
        &[[39, 1, 5, 0], [2, 1, 0x2C, 1], [b'w', 0xC3, 0xA4, b'v'], [b'e', 0, 0, 0]],
        &[[0, 2, 2, 0], [2, 1, 0, 0], HALF, TWO],
    ].concat();
    assert_eq!(bytes, expected.concat());

    let area = [words(&bytes), vec![0xA5A5_A5A5; 9]].concat();
    let conditions = Conditions::open(&area).unwrap();
    let keyframes = conditions.keyframes();
    assert_eq!(conditions.tracks()[..], tracks);
    assert_eq!(keyframes[..], keys);
    assert_eq!(conditions.obstacles(&keyframes)[..], obstacles);
    assert_eq!(conditions.timeline()[..], timeline);
    assert_eq!((conditions.vector(), conditions.bytes()), (Some(&[0.5, -0.5][..]), bytes.len()));
    assert_eq!(ALL_JOINTS, u32::from_le_bytes(EVERY));
    // Positions, masks and prompts stay where they lie.
    assert!(area.as_ptr_range().contains(&conditions.tracks()[0].positions.as_ptr().cast()));
    let Prompt::Vector(numbers) = conditions.timeline()[2].prompt else { panic!() };
    assert!(area.as_ptr_range().contains(&numbers.as_ptr().cast()));

    // Cut off anywhere they are refused, whatever they say of their length.
    for count in (0..bytes.len()).step_by(4) {
        assert_eq!(fault(&bytes[..count]), 0);
        let mut cut = bytes[..count].to_vec();
        if let Some(length) = cut.first_chunk_mut() {
            *length = (count as u32).to_le_bytes();
        }
        assert!(fault(&cut) <= count as u32);
    }
    // So is whatever may get a meaning later, and where that is is said.
    let (track, sphere) = (20, 20 + 12 + 60 + 8);
    let span = bytes.len() - 48;
    for (at, byte, place) in [
        (4, 1, 4),
        (4, 3, 4),
        (6, 17, 4),
        (7, 9, 4),
        (10, 1, 4),
        (track + 1, 29, track),
        (track + 6, 1, track),
        (sphere, 5, sphere),
        (sphere + 1, 3, sphere),
        (sphere + 2, 1, sphere),
        (sphere + 28 + 40 + 20 + 2, 1, sphere + 28 + 40),
        // A part that there is not, and a trunk without head and arms.
        (span, 64, span),
        (span, 32, span),
        (span + 1, 3, span),
        // A text that is too long; one that is cut within a letter, and none at all.
        (span + 2, TEXT_BYTES as u8 + 1, span),
        (span + 16 + 2, 2, span + 16 + 8),
        (span + 16 + 8, 0xFF, span + 16 + 8),
    ] {
        let mut later = bytes.clone();
        later[at] = byte;
        assert_eq!(fault(&later), place as u32, "byte {at}");
    }
}

#[test]
fn nothing_is_the_least() {
    let bytes = sent(&Given::default());
    assert!(Given::default().is_empty());
    assert_eq!(bytes.len(), LEAST_BYTES);
    let area = words(&bytes);
    let conditions = Conditions::open(&area).unwrap();
    assert!(conditions.tracks().is_empty() && conditions.obstacles(&[]).is_empty());
    assert!(conditions.timeline().is_empty() && conditions.vector().is_none());
    // Memory that nobody has written to.
    assert_eq!(
        [&[][..], &[0; 3], &[u32::MAX; 3], &[14, 2, 0, 0]].map(|area| Conditions::open(area).is_err()),
        [true; 4]
    );
}

/// Obstacles with keyframes and without, one between the other: each gets its own.
#[test]
fn keyframes_go_to_their_obstacles() {
    let keys: Vec<Keyframe> = (0..KEYFRAMES as u16).map(|frame| Keyframe { frame, position: [1.0; 3] }).collect();
    let still = Obstacle::new(Shape::Sphere { radius: 1.0 }, [0.0; 3]);
    let along = |range: std::ops::Range<usize>| still.moving(Course::Keyframes(&keys[range]));
    let obstacles = [along(0..1), still, along(1..1), along(1..KEYFRAMES), still];
    let area = words(&sent(&Given { obstacles: &obstacles, ..Given::default() }));
    let conditions = Conditions::open(&area).unwrap();
    let keyframes = conditions.keyframes();
    assert_eq!(conditions.obstacles(&keyframes)[..], obstacles);
}

#[test]
fn what_cannot_be_sent_is_said() {
    let unfit = |given: Given<'_>| {
        let mut bytes = vec![7];
        let unfit = given.write(&mut bytes).unwrap_err();
        assert_eq!((given.bytes(), &bytes[..]), (Err(unfit), &[7][..]));
        assert!(!unfit.to_string().is_empty());
        unfit
    };
    let (track, most) = (Track::new(Joint::Head, 0, &[[0.0; 3]]), usize::from(u16::MAX));
    let obstacle = Obstacle::new(Shape::Sphere { radius: 1.0 }, [0.0; 3]);
    let tracks = |tracks: &[Track<'_>]| unfit(Given { tracks, ..Given::default() });
    let many = TrackError::TooMany { tracks: MAX_TRACKS + 1, limit: MAX_TRACKS };
    assert_eq!(tracks(&[track; MAX_TRACKS + 1]), Unfit::Track(many));
    let mask = TrackError::Mask { index: 1, found: 2, positions: 1 };
    assert_eq!(tracks(&[track, track.masked(&[1, 1])]), Unfit::Track(mask));
    let long = TrackError::FrameOutOfRange { index: 0, frame: most + 5, frames: most };
    assert_eq!(tracks(&[Track::new(Joint::Head, 5, &vec![[0.0; 3]; most + 1])]), Unfit::Track(long));
    let many = ObstacleError::TooMany { obstacles: MAX_OBSTACLES + 1, limit: MAX_OBSTACLES };
    let given = Given { obstacles: &[obstacle; MAX_OBSTACLES + 1], ..Given::default() };
    assert_eq!(unfit(given), Unfit::Obstacle(many));
    let keys = [Keyframe { frame: 0, position: [0.0; 3] }; KEYFRAMES];
    let obstacles = [obstacle.moving(Course::Keyframes(&keys)), obstacle.moving(Course::Keyframes(&keys[..1]))];
    let keyframes = Unfit::Keyframes { found: KEYFRAMES + 1, limit: KEYFRAMES };
    assert_eq!(unfit(Given { obstacles: &obstacles, ..Given::default() }), keyframes);
    let vector = |vector: &[f32]| unfit(Given { vector: Some(vector), ..Given::default() });
    assert_eq!(vector(&[]), Unfit::Vector { found: 0, limit: most });
    assert_eq!(vector(&vec![0.0; most + 1]), Unfit::Vector { found: most + 1, limit: most });
    let span = Span::new(BodyParts::HEAD, 0, 8, "nods");
    let timeline = |timeline: &[Span<'_>]| unfit(Given { timeline, ..Given::default() });
    let many = TimelineError::TooMany { spans: MAX_SPANS + 1, limit: MAX_SPANS };
    assert_eq!(timeline(&[span; MAX_SPANS + 1]), Unfit::Timeline(many));
    let (fits, long) = ("x".repeat(TEXT_BYTES), "x".repeat(TEXT_BYTES + 1));
    let error = PromptError::TooLong { found: TEXT_BYTES + 1, limit: TEXT_BYTES };
    for prompt in [Prompt::Text(&long), Prompt::Bank(&long)] {
        let of_the_second = TimelineError::Prompt { index: 1, error };
        assert_eq!(timeline(&[span, Span { prompt, ..span }]), Unfit::Timeline(of_the_second));
    }
    let fits = [Span { prompt: Prompt::Text(&fits), ..span }; MAX_SPANS];
    assert_eq!(sent(&Given { timeline: &fits, ..Given::default() }).len(), LEAST_BYTES + MAX_SPANS * (8 + TEXT_BYTES));
    let numbers = vec![0.0; most + 1];
    let wide = Span { prompt: Prompt::Vector(&numbers), ..span };
    assert_eq!(timeline(&[wide]), Unfit::SpanVector { index: 0, found: most + 1, limit: most });
}
