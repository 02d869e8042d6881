//! Timelines.

use super::*;

/// Both arms first by a text, later the right one by a stored prompt, the legs all along.
fn spans() -> [mtn_span; 3] {
    let span = mtn_span {
        text: ptr::null(),
        stored: ptr::null(),
        vector: ptr::null(),
        vector_count: 0,
        first: 0,
        frames: 12,
        parts: MTN_PART_ARMS,
    };
    [
        mtn_span { text: c"a person zorbs and claps".as_ptr(), ..span },
        mtn_span { stored: c"wave".as_ptr(), first: 12, frames: 16, parts: MTN_PART_RIGHT_ARM, ..span },
        mtn_span { text: c"a person kicks".as_ptr(), frames: 32, parts: MTN_PART_LEGS, ..span },
    ]
}

fn under(timeline: &[mtn_span]) -> mtn_request {
    mtn_request { timeline: timeline.as_ptr(), span_count: timeline.len(), ..tokens() }
}

fn heard(motion: &mtn_motion) -> Vec<mtn_heard> {
    // SAFETY: the motion is the last one of its generator, and has so many.
    unsafe { core::slice::from_raw_parts(motion.spans, motion.span_count) }.to_vec()
}

#[test]
fn parts_are_those_of_the_rust_library() {
    let parts = [
        ("head", MTN_PART_HEAD),
        ("left_arm", MTN_PART_LEFT_ARM),
        ("right_arm", MTN_PART_RIGHT_ARM),
        ("left_leg", MTN_PART_LEFT_LEG),
        ("right_leg", MTN_PART_RIGHT_LEG),
        ("arms", MTN_PART_ARMS),
        ("legs", MTN_PART_LEGS),
        ("upper_body", MTN_PART_UPPER_BODY),
    ];
    assert_eq!(parts, BodyParts::NAMED.map(|(name, parts)| (name, parts.bits())));
}

#[test]
fn a_timeline_has_the_bits_of_the_rust_library() {
    let mut bench = Bench::new(1 << 19);
    let motion = bench.generate(&under(&spans())).unwrap();
    let mut hash = 0;
    // SAFETY: the motion is the last one of its generator.
    assert_eq!(unsafe { mtn_motion_hash(&motion, &mut hash) }, FINE);

    // SAFETY: the blocks are contiguous bytes.
    let (_, blob, _) = unsafe { BLOB.align_to::<u8>() };
    let mut arena = vec![0; 1 << 19];
    let mut generator = Generator::new(Model::open(blob).unwrap(), &mut arena).unwrap();
    let same = [
        Span::new(BodyParts::ARMS, 0, 12, "a person zorbs and claps"),
        Span { prompt: Prompt::Bank("wave"), ..Span::new(BodyParts::RIGHT_ARM, 12, 16, "") },
        Span::new(BodyParts::LEGS, 0, 32, "a person kicks"),
    ];
    let expected = generator.generate(&Request::tokens(&TOKENS).timeline(&same), &mut ()).unwrap();
    assert_eq!((hash, motion.arena_used), (expected.hash(), expected.arena_used));
    let all: Vec<mtn_heard> = expected.spans()[..3].iter().map(|&said| said.into()).collect();
    assert_eq!(heard(&motion), all);
    assert_eq!((all[0].words, all[0].unknown_words, all[2].words), (5, 1, 3));
    let kicks = expected.spans()[2].understood.unwrap();
    let kicks = generator.model().in_words(kicks).to_string();
    assert!(kicks.contains("kick"), "{kicks}");

    // In words, with room and without.
    let said = &all[2].understood;
    for bytes in [256, kicks.len() + 1, kicks.len(), 2, 1] {
        let mut text = vec![0x7F_u8; bytes + 1];
        let room = text.as_mut_ptr().cast();
        // SAFETY: everything is valid.
        assert_eq!(unsafe { mtn_understood_in_words(&mut *bench.generator, said, room, bytes) }, FINE);
        assert_eq!(text[bytes], 0x7F, "nothing is written beyond the room");
        let words = CStr::from_bytes_until_nul(&text).unwrap().to_str().unwrap();
        assert_eq!(words, &kicks[..kicks.len().min(bytes - 1)]);
    }
    let null = |index| result(mtn_error::NullPointer, index, 0, 0);
    // SAFETY: null pointers are refused before they are followed.
    unsafe {
        let generator: *mut mtn_generator = &mut *bench.generator;
        let mut text = [0];
        assert_eq!(mtn_understood_in_words(ptr::null_mut(), said, text.as_mut_ptr(), 1), null(0));
        assert_eq!(mtn_understood_in_words(generator, ptr::null(), text.as_mut_ptr(), 1), null(1));
        assert_eq!(mtn_understood_in_words(generator, said, ptr::null_mut(), 1), null(2));
        let none = mtn_understood_in_words(generator, said, text.as_mut_ptr(), 0);
        assert_eq!(none, result(mtn_error::Length, 3, 0, 1));
    }

    // A motion without a timeline is another, and says nothing of spans.
    let plain = bench.generate(&tokens()).unwrap();
    assert!(plain.spans.is_null() && plain.span_count == 0);
    let mut other = 0;
    // SAFETY: the motion is the last one of its generator.
    assert_eq!(unsafe { mtn_motion_hash(&plain, &mut other) }, FINE);
    assert_ne!(hash, other);
}

/// Tracks are followed by what comes of the timeline, and both lists are read.
#[test]
fn a_timeline_beside_tracks_and_obstacles() {
    let mut bench = Bench::new(1 << 20);
    // Beside the legs that kick there is no room for a pillar.
    let (tracks, obstacles) = (Tracks::new(), [mtn_obstacle { position: [1.5, 1.0, 0.6], ..pillar() }]);
    let request = mtn_request {
        tracks: tracks.0.as_ptr(),
        track_count: 2,
        obstacles: obstacles.as_ptr(),
        obstacle_count: 1,
        ..under(&spans())
    };
    let motion = bench.generate(&request).unwrap();
    assert!(motion.tracking.mean < 0.02 && motion.clearance.missing < 0.0, "{motion:?}");
    assert_eq!(heard(&motion).len(), 3);
    let without = bench.generate(&mtn_request { span_count: 0, ..request }).unwrap();
    assert_ne!(without.tracking_before, motion.tracking_before);
}

#[test]
fn spans_are_refused_by_place() {
    let mut bench = Bench::new(1 << 19);
    let good = spans();
    let before = bench.generate(&under(&good)).map(|motion| joints_of(&motion)).unwrap();
    let third = good[2];
    let mut refused = |span: mtn_span| bench.refused(&under(&[good[0], good[1], span]));
    // Bits of no part, and a trunk without what it carries.
    for parts in [64, 128 | MTN_PART_LEGS, 32, 32 | MTN_PART_ARMS] {
        assert_eq!(refused(mtn_span { parts, ..third }), result(mtn_error::SpanParts, 2, parts.into(), 0));
    }
    assert_eq!(refused(mtn_span { parts: 0, ..third }), result(mtn_error::SpanNothing, 2, 0, 0));
    assert_eq!(refused(mtn_span { frames: 7, ..third }), result(mtn_error::SpanFrames, 2, 7, 8));
    assert_eq!(refused(mtn_span { first: 1, ..third }), result(mtn_error::SpanEnd, 2, 33, 32));
    let both = mtn_span { parts: MTN_PART_UPPER_BODY, ..third };
    assert_eq!(refused(both), result(mtn_error::SpanOverlap, 2, 0, u32::from(MTN_PART_ARMS)));
    assert_eq!(refused(mtn_span { text: ptr::null(), ..third }), result(mtn_error::SpanSource, 2, 0, 1));
    assert_eq!(refused(mtn_span { stored: c"walk".as_ptr(), ..third }), result(mtn_error::SpanSource, 2, 2, 1));

    // Prompts: what a request with that prompt is told, as a number.
    let said = |error: mtn_error, limit| result(mtn_error::SpanPrompt, 2, error as u32, limit);
    let mut told = |text: &CStr| refused(mtn_span { text: text.as_ptr(), ..third });
    assert_eq!(told(c" ."), said(mtn_error::PromptEmpty, 0));
    assert_eq!(told(c"walk \xFF"), said(mtn_error::PromptNotUtf8, 5));
    assert_eq!(told(c"zorb frumious"), said(mtn_error::PromptUnknownWords, 0));
    let mut long = vec![b'a'; 5000];
    long.push(0);
    assert_eq!(told(CStr::from_bytes_with_nul(&long).unwrap()), said(mtn_error::PromptTooLong, 4096));
    let mut many = b"walk ".repeat(40);
    many.push(0);
    let many = told(CStr::from_bytes_with_nul(&many).unwrap());
    assert_eq!((many.error, many.found), (mtn_error::SpanPrompt, mtn_error::PromptTooManyWords as u32));
    assert!(many.limit > 8 && many.limit < 40, "{many:?}");
    let unknown = refused(mtn_span { text: ptr::null(), stored: c"zorb".as_ptr(), ..third });
    assert_eq!(unknown, said(mtn_error::PromptNotStored, 0));
    let vector = [0.5; 16];
    let vector = mtn_span { text: ptr::null(), vector: vector.as_ptr(), vector_count: 16, ..third };
    assert_eq!(refused(vector), said(mtn_error::PromptNoVectors, 0));
    let off = mtn_span { vector: vector.vector.wrapping_byte_add(2), ..vector };
    assert_eq!(refused(off), result(mtn_error::Misaligned, 1, 2, 4));
    let endless = mtn_span { vector_count: usize::MAX / 4, ..vector };
    assert_eq!(refused(endless), result(mtn_error::Length, 1, u32::MAX, 0));

    let many = [third; MTN_MAX_SPANS + 1];
    assert_eq!(bench.refused(&under(&many)), result(mtn_error::TooManySpans, 0, 9, 8));
    let null = mtn_request { timeline: ptr::null(), ..under(&good) };
    assert_eq!(bench.refused(&null), result(mtn_error::NullPointer, 1, 0, 0));
    assert_eq!(bench.generate(&under(&good)).map(|motion| joints_of(&motion)), Ok(before));
}

#[test]
fn a_plan_with_spans_is_what_they_take() {
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
        words: 4,
        anchors: 0,
        steps: 1,
        evaluations: 0,
        exact: 1,
        free_feet: 0,
        guidance: 2.0,
        rows: 0,
        tracked: 0,
        spans: 2,
    };
    // All parts all along: as much as there can be.
    let [_, _, legs] = spans();
    let legs = mtn_span { text: c"a person kicks high".as_ptr(), ..legs };
    let all = [legs, mtn_span { parts: MTN_PART_UPPER_BODY, ..legs }];
    let request = mtn_request { frames: 32, ..text(c"a person walks forward") };
    let request = mtn_request { timeline: all.as_ptr(), span_count: 2, ..request };
    let plan = plan_of(limits).unwrap();
    assert_eq!(Bench::new(plan.arena_bytes).generate(&request).unwrap().arena_used, plan.arena_bytes);
    let small = Bench::new(plan.arena_bytes - 16).refused(&request);
    assert_eq!((small.error, small.limit as usize), (mtn_error::ArenaTooSmall, plan.arena_bytes));
    // Less of them fits as well, with given tokens too.
    assert!(Bench::new(plan.arena_bytes).generate(&under(&all)).is_ok());
    let without = plan_of(mtn_limits { spans: 0, ..limits }).unwrap();
    assert!(without.arena_bytes < plan.arena_bytes && 2 * without.planning_macs < plan.planning_macs);

    let refused = |limits| plan_of(limits).unwrap_err();
    assert_eq!(refused(mtn_limits { spans: 9, ..limits }), result(mtn_error::TooManySpans, 0, 9, 8));
    assert_eq!(refused(mtn_limits { words: 0, ..limits }), result(mtn_error::SpanWords, 0, 2, 0));
}
