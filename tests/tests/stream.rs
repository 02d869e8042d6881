//! A motion decoded in segments against the same motion decoded whole: every bit equal, however it is cut; exactly the
//! arena that is planned; interrupted anywhere.

use motionette::codec::Decode;
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::representation::humanml3d::{POSITION_CHANNELS, Path, channels};
use motionette::representation::rigid::Body;
use motionette::representation::{Features, Pose, Recover};
use motionette::{
    Error, Generator, JOINTS, Limits, Model, MotionStream, Observer, Plan, Progress, ROWS, Request, Stop, StreamError,
    StreamLimits, StreamPlan,
};
use motionette_host::blob::BlobFile;
use motionette_tests::tiny::{Shape, Tiny};
use std::ops::ControlFlow;

const PAINT: u8 = 0xC3;

fn shapes() -> Vec<Shape> {
    let base = Shape::default();
    vec![
        base.clone(),
        Shape { width: 36, code_width: 48, dilations: vec![9, 3, 1], ..base.clone() },
        Shape { width: 70, code_width: 5, wide: 0, dilations: vec![1], ..base.clone() },
        Shape { quantizers: 3, stages: 1, dilations: vec![2, 1, 1, 5], ..base.clone() },
        Shape { width: 3, code_width: 1, stages: 3, wide: 263, max_tokens: 49, ..base.clone() },
        // A reach beyond anything that passes at once.
        Shape { dilations: vec![1, 40], ..base.clone() },
        // Decoders that look less far ahead than back: nowhere, one token, here and there.
        base.clone().causal(),
        Shape { dilations: vec![9, 3, 1], right: vec![1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0], ..base.clone() },
        Shape { dilations: vec![9, 3, 1], right: vec![1, 4, 3, 1, 0, 0, 2, 0, 1, 0, 1], ..base.clone() },
        Shape { stages: 3, dilations: vec![2], right: vec![0, 1, 1, 0, 0, 2, 1, 1, 0], ..base.clone() },
        Shape { dilations: vec![1, 40], stages: 1, right: vec![0, 0, 7, 1, 0, 1], ..base },
    ]
}

/// Frames before and behind a frame that a decoder depends on, counted by hand.
fn reach(shape: &Shape) -> (usize, usize) {
    let blocks = shape.dilations.len();
    let (mut behind, mut ahead) = (0, 0);
    for (place, (dilation, right)) in shape.convolutions().into_iter().enumerate() {
        // The last of each stage runs on rows twice as many.
        if place > 0 && place.is_multiple_of(blocks + 1) && place / (blocks + 1) <= usize::from(shape.stages) {
            (behind, ahead) = (2 * behind, 2 * ahead);
        }
        behind += usize::from(2 * dilation - right);
        ahead += usize::from(right);
    }
    (behind, ahead)
}

fn nano() -> BlobFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/nano.blob");
    BlobFile::open(path.as_ref()).expect("the bundled model opens")
}

fn random_tokens(model: &Model<'_>, length: usize, random: &mut Stream) -> Vec<u16> {
    let codes = model.codebooks().codes() as u32;
    (0..length * model.codebooks().quantizers()).map(|_| random.below(codes) as u16).collect()
}

/// Bits of all joints of the motion of `tokens`, decoded whole.
fn whole(model: &Model<'_>, tokens: &[u16]) -> Vec<u32> {
    let limits = Limits {
        tokens: model.max_tokens(),
        anchors: 0,
        tracked: 0,
        timeline: None,
        refinement: Default::default(),
        planning: None,
        rows: ROWS,
    };
    let mut arena = vec![0u8; Plan::for_request(model, &limits).expect("the limits are legal").arena_bytes + 16];
    let mut generator = Generator::new(model.clone(), &mut arena).expect("default floating point");
    let motion = generator.generate(&Request::tokens(tokens).unrefined(), &mut ()).expect("request is valid");
    motion.joints().iter().map(|v| v.to_bits()).collect()
}

/// The same past the length that the model allows, from the decoder's own interface.
fn whole_of_any_length(model: &Model<'_>, tokens: &[u16]) -> Vec<u32> {
    let decoder = model.decoder();
    let length = tokens.len() / model.codebooks().quantizers();
    let frames = length * decoder.upsampling();
    let all = channels(u32::MAX);
    let mut memory = vec![0u8; decoder.workspace_bytes(length, POSITION_CHANNELS, ROWS) + 16 * frames + 256];
    let mut arena = Arena::new(&mut memory);
    let mut work = decoder.workspace(&mut arena, length, POSITION_CHANNELS, ROWS).unwrap();
    let mut take = |count| arena.take::<f32>(count).unwrap();
    let (cos, sin, x, z) = (take(frames), take(frames), take(frames), take(frames));
    let mut path = Path { cos, sin, x, z, d_angle: &mut [], d_x: &mut [], d_z: &mut [] };
    let mut u = vec![0.0; length * decoder.code_width()];
    model.codebooks().embed(tokens, &mut u).unwrap();
    let mut values = vec![0.0; frames * all.count()];
    assert!(decoder.forward(&u, &all, &mut values, &mut work, &mut || ControlFlow::Continue(())).is_continue());
    let features = Features { values: &values, channels: &all };
    model.recovery().integrate(features, &mut path);
    let body = Body::new(&model.skeleton().offsets());
    let joints = model.recovery().joints(&mut values, &path);
    let poses: &[Pose] = bytemuck::cast_slice(joints);
    poses.iter().flat_map(|pose| body.posed(pose).into_iter().flatten()).map(f32::to_bits).collect()
}

/// Takes all frames that are to be had.
fn drain(stream: &mut MotionStream<'_, '_>, most: usize, joints: &mut Vec<u32>) {
    while let Some(frames) = stream.frames(&mut ()).expect("nobody interrupts") {
        assert!(frames.len() <= most);
        joints.extend(frames.iter().flatten().flatten().map(|v| v.to_bits()));
    }
}

/// Bits of all joints of the motion of `tokens`, pushed in pieces whose lengths `cut` gives. Checks what the stream says about
/// itself on the way.
fn segments(model: &Model<'_>, tokens: &[u16], room: usize, mut cut: impl FnMut() -> usize) -> Vec<u32> {
    let quantizers = model.codebooks().quantizers();
    let limits = StreamLimits { tokens: room, planning: None, rows: ROWS };
    let plan = StreamPlan::new(model, &limits).expect("the limits are legal");
    let mut arena = vec![PAINT; plan.arena_bytes + 16];
    let mut generator = Generator::new(model.clone(), &mut arena).expect("default floating point");
    let mut stream = generator.stream(&limits).expect("the arena is as planned");
    let (mut joints, mut rest, mut pushed) = (Vec::new(), tokens, 0);
    while !rest.is_empty() {
        let count = cut().clamp(1, rest.len() / quantizers);
        let (now, later) = rest.split_at(count * quantizers);
        stream.push(now).expect("there is room");
        (rest, pushed) = (later, pushed + count);
        let ahead = stream.frames_ahead();
        let before = joints.len();
        drain(&mut stream, plan.frames, &mut joints);
        assert_eq!((joints.len() - before) / (3 * JOINTS), ahead);
        let due = (pushed * model.frames_per_token()).saturating_sub(plan.latency_frames);
        assert_eq!(joints.len(), due * 3 * JOINTS, "after {pushed} tokens");
        assert_eq!((stream.room(), stream.frames_ahead()), (room, 0));
    }
    stream.finish();
    assert_eq!(stream.frames_ahead(), (pushed * model.frames_per_token()).min(plan.latency_frames));
    drain(&mut stream, plan.frames, &mut joints);
    assert_eq!((stream.room(), stream.frames_ahead()), (0, 0));
    assert_eq!(stream.frames(&mut ()).map(|frames| frames.map(<[_]>::len)), Ok(None));
    joints
}

#[test]
fn segments_give_the_bits_of_the_whole_for_every_shape() {
    for (seed, shape) in shapes().into_iter().enumerate() {
        let tiny = Tiny::new(shape.clone(), seed as u64 + 1);
        let model = Model::open(tiny.bytes()).expect("blob opens");
        let mut random = Stream::new(7 + seed as u64);
        for length in (1..=9).chain([13, 16, 22, 31, 49]) {
            let tokens = random_tokens(&model, length, &mut random);
            let want = whole(&model, &tokens);
            assert_eq!(segments(&model, &tokens, 1, || 1), want, "{shape:?}: {length} tokens, one at a time");
            assert_eq!(segments(&model, &tokens, 49, || 49), want, "{shape:?}: {length} tokens at once");
            for _ in 0..6 {
                let most = 1 + random.below(12);
                let cut = || 1 + random.below(most) as usize;
                assert_eq!(segments(&model, &tokens, 12, cut), want, "{shape:?}: {length} tokens, up to {most}");
            }
        }
    }
}

#[test]
fn segments_give_the_bits_of_the_whole_on_the_bundled_model() {
    let file = nano();
    let model = file.model().expect("opened before");
    let mut random = Stream::new(3);
    for length in [1usize, 2, 5, 21, 22, 23, 24, 37, 49] {
        let tokens = random_tokens(&model, length, &mut random);
        let want = whole(&model, &tokens);
        assert_eq!(segments(&model, &tokens, 1, || 1), want, "{length} tokens, one at a time");
        for _ in 0..3 {
            let most = 1 + random.below(25);
            let cut = || 1 + random.below(most) as usize;
            assert_eq!(segments(&model, &tokens, 25, cut), want, "{length} tokens, up to {most}");
        }
    }
}

#[test]
fn a_motion_longer_than_any_request_has_the_bits_of_the_whole() {
    let tiny = Tiny::new(Shape { dilations: vec![9, 3, 1], ..Shape::default() }, 12);
    let (file, mut random) = (nano(), Stream::new(8));
    for (model, length) in [(Model::open(tiny.bytes()).unwrap(), 3000), (file.model().unwrap(), 300)] {
        let tokens = random_tokens(&model, length, &mut random);
        let cut = || 1 + random.below(12) as usize;
        let (got, want) = (segments(&model, &tokens, 12, cut), whole_of_any_length(&model, &tokens));
        assert!(got == want, "{}: {length} tokens", model.card().name);
    }
}

#[test]
fn the_radius_is_how_far_a_token_reaches() {
    for (seed, shape) in shapes().into_iter().enumerate() {
        let tiny = Tiny::new(shape.clone(), 20 + seed as u64);
        let model = Model::open(tiny.bytes()).expect("blob opens");
        let mut random = Stream::new(7 + seed as u64);
        let radius = model.decoder().radius_frames();
        assert_eq!(radius, reach(&shape).1, "{shape:?}");
        let (up, quantizers) = (model.frames_per_token(), model.codebooks().quantizers());
        let length = 2 * model.decoder().radius_tokens() + 2;
        // The earliest frame that a change of the last token changes, over several motions: a ReLU may stand in the way.
        let mut reached = 0;
        for _ in 0..8 {
            let mut tokens = random_tokens(&model, length, &mut random);
            let before = whole_of_any_length(&model, &tokens);
            let last = tokens.len() - quantizers;
            tokens[last] = (tokens[last] + 1) % model.codebooks().codes() as u16;
            let after = whole_of_any_length(&model, &tokens);
            let first = before.iter().zip(&after).position(|(a, b)| a != b).expect("the token matters") / (3 * JOINTS);
            reached = reached.max((length - 1) * up - first);
        }
        assert_eq!(reached, radius, "{shape:?}");
        assert_eq!(model.decoder().radius_tokens(), radius.div_ceil(up), "{shape:?}");
        let plan = Plan::for_request(
            &model,
            &Limits {
                tokens: 3,
                anchors: 0,
                tracked: 0,
                timeline: None,
                refinement: Default::default(),
                planning: None,
                rows: ROWS,
            },
        )
        .expect("the limits are legal");
        assert_eq!((plan.radius_tokens, plan.latency_frames), (radius.div_ceil(up), radius));
    }
    assert_eq!(nano().model().unwrap().decoder().radius_tokens(), 3);
}

/// What a decoder makes of a change of its first token ends where the padding on the left says, which no interface tells.
#[test]
fn a_token_reaches_back_as_far_as_the_padding_on_the_left() {
    for (seed, shape) in shapes().into_iter().enumerate() {
        let tiny = Tiny::new(shape.clone(), 20 + seed as u64);
        let model = Model::open(tiny.bytes()).expect("blob opens");
        let mut random = Stream::new(7 + seed as u64);
        let decoder = model.decoder();
        let (up, behind) = (model.frames_per_token(), reach(&shape).0);
        let length = behind.div_ceil(up) + 3;
        let all = channels(u32::MAX);
        let decode = |u: &[f32]| {
            let mut memory = vec![0u8; decoder.workspace_bytes(length, POSITION_CHANNELS, ROWS)];
            let mut work = decoder.workspace(&mut Arena::new(&mut memory), length, POSITION_CHANNELS, ROWS).unwrap();
            let mut values = vec![0.0; length * up * all.count()];
            assert!(decoder.forward(u, &all, &mut values, &mut work, &mut || ControlFlow::Continue(())).is_continue());
            values
        };
        // Over several motions: a ReLU may stand in the way.
        let mut reached = 0;
        for _ in 0..64 {
            let mut u: Vec<f32> = (0..length * decoder.code_width()).map(|_| 2.0 * random.unit() - 1.0).collect();
            let before = decode(&u);
            u[..decoder.code_width()].iter_mut().for_each(|v| *v *= -1.5);
            let after = decode(&u);
            let last = before.iter().zip(&after).rposition(|(a, b)| a != b).expect("the token matters") / all.count();
            reached = reached.max(last);
        }
        assert_eq!(reached, up - 1 + behind, "{shape:?}");
    }
}

#[test]
fn the_arena_is_exactly_as_large_as_the_plan_says_however_long_the_motion() {
    let tiny = Tiny::new(Shape::default(), 6);
    let file = nano();
    for model in [Model::open(tiny.bytes()).unwrap(), file.model().unwrap()] {
        let limits = StreamLimits { tokens: 9, planning: None, rows: ROWS };
        let plan = StreamPlan::new(&model, &limits).expect("the limits are legal");
        let planned = plan.arena_bytes;
        let mut words = vec![0u128; (planned + 4096) / 16];
        let memory: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
        match Generator::new(model.clone(), &mut memory[..planned - 1]).unwrap().stream(&limits).map(|_| ()) {
            Err(StreamError::Request(Error::Arena(e))) => assert_eq!((e.needed, e.available), (planned, planned - 1)),
            other => panic!("one byte less must be refused, got {other:?}"),
        }
        memory.fill(PAINT);
        let mut generator = Generator::new(model.clone(), &mut *memory).unwrap();
        let mut stream = generator.stream(&limits).unwrap();
        let mut random = Stream::new(4);
        for _ in 0..20 {
            stream.push(&random_tokens(&model, 9, &mut random)).unwrap();
            drain(&mut stream, plan.frames, &mut Vec::new());
        }
        stream.finish();
        drain(&mut stream, plan.frames, &mut Vec::new());
        drop(generator);
        let high_water = memory.iter().rposition(|&b| b != PAINT).unwrap() + 1;
        assert!(high_water <= planned && high_water + 16 > planned, "high-water {high_water}, planned {planned}");
        println!("{}: {plan:?}, {} bytes of object", model.card().name, size_of::<MotionStream<'_, '_>>());
    }
}

/// Aborts call number `at`, and counts.
struct StopAt {
    at: usize,
    calls: usize,
}

impl Observer for StopAt {
    fn progress(&mut self, _: Progress) -> ControlFlow<Stop> {
        self.calls += 1;
        if self.calls == self.at { ControlFlow::Break(Stop::Abort) } else { ControlFlow::Continue(()) }
    }
}

#[test]
fn stopped_at_any_observer_call_the_motion_goes_on_there_and_the_generator_is_usable() {
    let tiny = Tiny::new(Shape::default(), 9);
    let model = Model::open(tiny.bytes()).unwrap();
    let mut random = Stream::new(5);
    let tokens = random_tokens(&model, 7, &mut random);
    let want = whole(&model, &tokens);
    let limits = StreamLimits { tokens: 7, planning: None, rows: ROWS };
    let request = Limits {
        tokens: 7,
        anchors: 0,
        tracked: 0,
        timeline: None,
        refinement: Default::default(),
        planning: None,
        rows: ROWS,
    };
    let bytes = StreamPlan::new(&model, &limits)
        .expect("the limits are legal")
        .arena_bytes
        .max(Plan::for_request(&model, &request).expect("the limits are legal").arena_bytes);
    let mut arena = vec![0u8; bytes + 16];
    let mut generator = Generator::new(model.clone(), &mut arena).unwrap();
    let good = generator.generate(&Request::tokens(&tokens), &mut ()).unwrap().hash();
    let run = |generator: &mut Generator<'_>, at: usize, leave: bool| {
        let mut observer = StopAt { at, calls: 0 };
        let mut stream = generator.stream(&limits).unwrap();
        let (mut joints, mut stops) = (Vec::new(), 0);
        stream.push(&tokens).unwrap();
        stream.finish();
        loop {
            match stream.frames(&mut observer) {
                Ok(Some(frames)) => joints.extend(frames.iter().flatten().flatten().map(|v| v.to_bits())),
                Ok(None) => break,
                Err(StreamError::Request(Error::Aborted)) if leave => return (Vec::new(), 0, observer.calls),
                Err(StreamError::Request(Error::Aborted)) => stops += 1,
                Err(e) => panic!("{e}"),
            }
        }
        (joints, stops, observer.calls)
    };
    let (joints, stops, calls) = run(&mut generator, usize::MAX, false);
    assert!(joints == want && stops == 0 && calls > 20);
    for at in 1..=calls {
        let (joints, stops, asked) = run(&mut generator, at, false);
        assert!(joints == want, "stopped at call {at}");
        // The layer it stopped before is asked about again.
        assert_eq!((stops, asked), (1, calls + 1));
        run(&mut generator, at, true);
        assert_eq!(generator.generate(&Request::tokens(&tokens), &mut ()).map(|motion| motion.hash()), Ok(good));
    }
}

#[test]
fn bad_tokens_are_typed_errors_and_the_motion_goes_on() {
    let tiny = Tiny::new(Shape { quantizers: 2, ..Shape::default() }, 7);
    let model = Model::open(tiny.bytes()).unwrap();
    let mut arena = vec![0u8; 1 << 18];
    let mut generator = Generator::new(model.clone(), &mut arena).unwrap();
    let refused = |limit| Err(Error::Tokens { found: limit, limit: 49 }.into());
    for tokens in [0, 50] {
        assert_eq!(generator.stream(&StreamLimits { tokens, planning: None, rows: ROWS }).map(|_| ()), refused(tokens));
    }
    let mut stream = generator.stream(&StreamLimits { tokens: 3, planning: None, rows: ROWS }).unwrap();
    stream.push(&[1, 2]).unwrap();
    assert_eq!(stream.push(&[1, 2, 3]), refused(3));
    assert_eq!(stream.push(&[1, 2, 3, 11]), Err(Error::TokenOutOfRange { index: 3, token: 11, codes: 11 }.into()));
    assert_eq!(stream.push(&[0; 6]), Err(StreamError::QueueFull { found: 3, room: 2 }));
    stream.push(&[]).unwrap();
    stream.push(&[3, u16::MAX]).unwrap();
    stream.finish();
    assert_eq!(stream.push(&[0, 0]), Err(StreamError::Finished));
    let mut joints = Vec::new();
    drain(&mut stream, 16, &mut joints);
    assert!(joints == whole(&model, &[1, 2, 3, u16::MAX]));

    // No tokens, no frames.
    let mut stream = generator.stream(&StreamLimits { tokens: 3, planning: None, rows: ROWS }).unwrap();
    assert_eq!(stream.frames(&mut ()).map(|frames| frames.is_none()), Ok(true));
    stream.finish();
    let mut joints = Vec::new();
    drain(&mut stream, 16, &mut joints);
    assert!(joints.is_empty());
}

#[test]
fn a_moved_origin_moves_the_frames_and_nothing_else() {
    let tiny = Tiny::new(Shape::default(), 15);
    let model = Model::open(tiny.bytes()).unwrap();
    let tokens = random_tokens(&model, 40, &mut Stream::new(5));
    let want: Vec<f64> = whole(&model, &tokens).into_iter().map(|bits| f64::from(f32::from_bits(bits))).collect();
    let mut arena = vec![0u8; 1 << 18];
    let mut generator = Generator::new(model, &mut arena).unwrap();
    let mut stream = generator.stream(&StreamLimits { tokens: 40, planning: None, rows: ROWS }).unwrap();
    stream.push(&tokens).unwrap();
    stream.finish();
    let (mut got, mut origin) = (Vec::new(), [0.0f64; 2]);
    while let Some(frames) = stream.frames(&mut ()).unwrap() {
        got.extend(
            frames
                .iter()
                .flatten()
                .flat_map(|&[x, y, z]| [f64::from(x) + origin[0], f64::from(y), f64::from(z) + origin[1]]),
        );
        let [x, z] = stream.rebase();
        origin = [origin[0] + f64::from(x), origin[1] + f64::from(z)];
    }
    assert_eq!(got.len(), want.len());
    let worst = got.iter().zip(&want).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // A rounding of the position, of the size of a few metres, a frame.
    assert!(worst < 160.0 * 5e-7, "{worst}");
    assert!(origin[0].abs() + origin[1].abs() > 0.1, "{origin:?}");
}
