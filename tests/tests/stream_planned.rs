//! A motion planned piece by piece: each segment is what a request with its context given would make, seams are no rougher
//! than the rest, and the observer may stop it anywhere.

use motionette::codec::Decode;
use motionette::generation::tokens::{self as planning, PlanningError};
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::representation::humanml3d::{POSITION_CHANNELS, Path, channels};
use motionette::representation::{Features, Recover};
use motionette::{
    Error, Fixed, Frame, Generator, JOINTS, Length, Limits, Model, MotionStream, Observer, Plan, Planning, Progress,
    ROWS, Request, Segment, Stage, Stop, StreamError, StreamLimits, StreamPlan,
};
use motionette_host::blob::BlobFile;
use motionette_tests::tiny::{PriorShape, Shape, Tiny};
use std::ops::ControlFlow;

const PAINT: u8 = 0xC3;
/// Words of the longest prompt in use.
const WORDS: usize = 5;

fn tiny() -> Tiny {
    Tiny::new(Shape::with_prior(), 31)
}

fn limits(model: &Model<'_>, steps: u16) -> StreamLimits {
    let planning = planning::PlanningLimits { words: WORDS, steps, guided: true, anchors: false, clauses: 1 };
    StreamLimits { tokens: model.max_tokens(), planning: Some(planning), rows: ROWS }
}

/// Memory for streams and whole requests.
fn memory(model: &Model<'_>, steps: u16) -> Vec<u8> {
    let limits = limits(model, steps);
    let whole = Limits {
        tokens: limits.tokens,
        anchors: 0,
        tracked: 0,
        timeline: None,
        refinement: Default::default(),
        planning: limits.planning,
        rows: ROWS,
    };
    let bytes = StreamPlan::new(model, &limits)
        .expect("the limits are legal")
        .arena_bytes
        .max(Plan::for_request(model, &whole).expect("the limits are legal").arena_bytes);
    vec![0; bytes + 16]
}

fn bits(frames: &[Frame]) -> impl Iterator<Item = u32> {
    frames.iter().flatten().flatten().map(|v| v.to_bits())
}

fn drain(stream: &mut MotionStream<'_, '_>) -> Vec<u32> {
    let mut joints = Vec::new();
    while let Some(frames) = stream.frames(&mut ()).expect("nobody interrupts") {
        joints.extend(bits(frames));
    }
    joints
}

/// The segments of a motion: prompt and length.
const SEGMENTS: [(&str, u16); 6] =
    [("a person waves", 4), ("run", 1), ("left hand", 7), ("a person waves", 13), ("run run run", 2), ("a hand", 5)];

/// The tokens of [`SEGMENTS`], each made by a request of its own whose beginning is given.
fn by_requests(generator: &mut Generator<'_>, window: usize, base: &Request<'_>) -> Vec<u16> {
    let mut tokens: Vec<u16> = Vec::new();
    for (k, (prompt, count)) in SEGMENTS.iter().enumerate() {
        let context = tokens.len().min(window - usize::from(*count));
        let before = tokens.len() - context;
        let given: Vec<Fixed> =
            tokens[before..].iter().enumerate().map(|(i, &token)| Fixed { position: i as u16, token }).collect();
        let seed = base.planning.seed.wrapping_add((k as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let planning = Planning {
            length: Length::Tokens(context as u16 + count),
            seed,
            fixed: &given,
            start_open: before > 0,
            end_open: k + 1 < SEGMENTS.len(),
            ..base.planning
        };
        let request = Request::text(prompt).planned(planning);
        let motion = generator.generate(&request, &mut ()).expect("the request is valid");
        assert_eq!(motion.tokens()[..context], tokens[before..]);
        tokens.extend(&motion.tokens()[context..]);
    }
    tokens
}

#[test]
fn each_segment_is_what_a_request_with_its_context_given_makes() {
    let tiny = tiny();
    let model = Model::open(tiny.bytes()).unwrap();
    let mut arena = memory(&model, 10);
    let mut generator = Generator::new(model.clone(), &mut arena).unwrap();
    for (seed, guidance) in [(3, 2.0f32), (u64::MAX - 5, 1.0)] {
        let base = Request::text("").seed(seed).guidance(guidance).steps(4);
        let want = by_requests(&mut generator, model.max_tokens(), &base);
        // However late frames are taken, as long as there is room for the next segment.
        for eager in [true, false] {
            let mut stream = generator.stream(&limits(&model, 4)).unwrap();
            let (mut got, mut joints): (Vec<u16>, Vec<u32>) = (Vec::new(), Vec::new());
            for (k, (prompt, count)) in SEGMENTS.iter().enumerate() {
                let request =
                    Request::text(prompt).planned(Planning { length: Length::Tokens(*count), ..base.planning });
                while eager || stream.room() < usize::from(*count) {
                    match stream.frames(&mut ()).unwrap() {
                        Some(frames) => joints.extend(bits(frames)),
                        None => break,
                    }
                }
                let planned = if k + 1 < SEGMENTS.len() {
                    stream.plan(&request, &mut ())
                } else {
                    stream.plan_last(&request, &mut ())
                };
                let Segment { tokens, heard } = planned.unwrap();
                assert_eq!((tokens, usize::from(heard.words)), (usize::from(*count), prompt.split(' ').count()));
                got.extend(&stream.tokens()[stream.tokens().len() - tokens..]);
            }
            assert_eq!(got, want);
            assert_eq!(stream.plan(&Request::text("run"), &mut ()), Err(StreamError::Finished));
            joints.extend(drain(&mut stream));
            // The frames are those of the tokens, as another stream that is given them has them.
            let mut stream = generator.stream(&StreamLimits { tokens: 8, planning: None, rows: ROWS }).unwrap();
            let mut given = Vec::new();
            for tokens in want.chunks(8) {
                stream.push(tokens).unwrap();
                given.extend(drain(&mut stream));
            }
            stream.finish();
            given.extend(drain(&mut stream));
            assert!(joints == given);
        }
    }
}

#[test]
fn a_motion_that_was_pushed_is_continued_and_fixed_tokens_count_from_the_segment() {
    let tiny = tiny();
    let model = Model::open(tiny.bytes()).unwrap();
    let mut arena = memory(&model, 10);
    let mut generator = Generator::new(model.clone(), &mut arena).unwrap();
    let clip = [3u16, 1, 4, 1, 5];
    let mut given: Vec<Fixed> =
        clip.iter().enumerate().map(|(i, &token)| Fixed { position: i as u16, token }).collect();
    given.push(Fixed { position: 7, token: 9 });
    let request = Request::text("run").seed(8).steps(3);
    let whole = Planning { length: Length::Tokens(9), fixed: &given, end_open: true, ..request.planning };
    let want = generator.generate(&request.planned(whole), &mut ()).unwrap().tokens().to_vec();
    assert_eq!(want[7], 9);

    let mut stream = generator.stream(&limits(&model, 3)).unwrap();
    stream.plan(&Request::tokens(&clip), &mut ()).unwrap();
    let fixed = [Fixed { position: 2, token: 9 }];
    stream.plan(&request.fixed(&fixed).length(Length::Frames(13)), &mut ()).unwrap();
    assert_eq!(stream.tokens(), want);

    // Without a length: half of what is remembered, at most what there is room for.
    assert_eq!(stream.plan(&request, &mut ()).map(|s| s.tokens), Ok(4));
    assert_eq!(stream.plan(&request, &mut ()), Err(StreamError::QueueFull { found: 1, room: 0 }));
    drain(&mut stream);
    assert_eq!(stream.plan(&request, &mut ()).map(|s| s.tokens), Ok(7));
}

#[test]
fn the_arena_is_exactly_as_large_as_the_plan_says() {
    let tiny = tiny();
    let model = Model::open(tiny.bytes()).unwrap();
    let limits = limits(&model, 2);
    let planned = StreamPlan::new(&model, &limits).expect("the limits are legal").arena_bytes;
    let mut words = vec![0u128; (planned + 4096) / 16];
    let memory: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
    let request = Request::text("a person waves left hand").length(Length::Tokens(6)).steps(2);
    let run = |memory: &mut [u8]| -> Result<(), StreamError> {
        let mut generator = Generator::new(model.clone(), memory)?;
        let mut stream = generator.stream(&limits)?;
        for _ in 0..4 {
            stream.plan(&request, &mut ())?;
            drain(&mut stream);
        }
        Ok(())
    };
    match run(&mut memory[..planned - 1]) {
        Err(StreamError::Request(Error::Arena(e))) => assert_eq!((e.needed, e.available), (planned, planned - 1)),
        other => panic!("one byte less must be refused, got {other:?}"),
    }
    memory.fill(PAINT);
    assert_eq!(run(memory), Ok(()));
    let high_water = memory.iter().rposition(|&b| b != PAINT).unwrap() + 1;
    assert!(high_water <= planned && high_water + 16 > planned, "high-water {high_water}, planned {planned}");

    // A longer prompt than was planned for.
    let mut generator = Generator::new(model.clone(), &mut memory[..planned]).unwrap();
    let mut stream = generator.stream(&limits).unwrap();
    stream.push(&[1; 6]).unwrap();
    let long = Request::text("a person waves left hand run").length(Length::Tokens(7)).steps(2);
    assert!(
        matches!(stream.plan(&long, &mut ()), Err(StreamError::Request(Error::Arena(e))) if e.needed > planned && e.available == planned)
    );
    assert_eq!(stream.tokens(), [1; 6]);
    assert_eq!(stream.plan(&request, &mut ()).map(|s| s.tokens), Ok(6));
}

/// Wishes for something at call number `at`, and counts.
struct At {
    at: usize,
    wish: ControlFlow<Stop>,
    calls: usize,
    stages: Vec<Stage>,
}

impl Observer for At {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        self.calls += 1;
        if self.stages.last() != Some(&progress.stage) {
            self.stages.push(progress.stage);
        }
        if self.calls == self.at { self.wish } else { ControlFlow::Continue(()) }
    }
}

#[test]
fn stopped_at_any_observer_call_a_segment_can_be_planned_again() {
    let tiny = tiny();
    let model = Model::open(tiny.bytes()).unwrap();
    let mut arena = memory(&model, 10);
    let mut generator = Generator::new(model.clone(), &mut arena).unwrap();
    let request = |prompt| Request::text(prompt).seed(5).steps(3).length(Length::Tokens(4));
    let good = generator.generate(&request("run"), &mut ()).unwrap().hash();
    let run = |generator: &mut Generator<'_>, at: usize, wish: ControlFlow<Stop>| {
        let mut observer = At { at, wish, calls: 0, stages: Vec::new() };
        let mut stream = generator.stream(&limits(&model, 3)).unwrap();
        let mut aborted = 0;
        for prompt in ["a person waves", "run"] {
            loop {
                match stream.plan(&request(prompt), &mut observer) {
                    Ok(segment) => {
                        assert_eq!(segment.tokens, 4);
                        break;
                    }
                    Err(StreamError::Request(Error::Aborted)) => aborted += 1,
                    Err(e) => panic!("{e}"),
                }
            }
        }
        let tokens = stream.tokens().to_vec();
        stream.finish();
        (tokens, drain(&mut stream).len(), aborted, observer)
    };
    let (want, joints, _, whole) = run(&mut generator, usize::MAX, ControlFlow::Break(Stop::Abort));
    assert_eq!(whole.stages, [Stage::Reading, Stage::Planning, Stage::Reading, Stage::Planning]);
    assert!(whole.calls > 20 && want.len() == 8 && joints == 8 * 4 * 3 * JOINTS);
    for at in 1..=whole.calls {
        let (tokens, _, aborted, _) = run(&mut generator, at, ControlFlow::Break(Stop::Abort));
        assert_eq!((tokens, aborted), (want.clone(), 1), "aborted at call {at}");
        let (tokens, all, aborted, observer) = run(&mut generator, at, ControlFlow::Break(Stop::Finish));
        assert!(tokens.iter().all(|&t| t < 11) && observer.calls <= whole.calls);
        assert_eq!((tokens.len(), all, aborted), (8, joints, 0), "finished at call {at}");
        assert_eq!(generator.generate(&request("run"), &mut ()).map(|motion| motion.hash()), Ok(good));
    }
}

#[test]
fn bad_segments_are_typed_errors_and_the_motion_goes_on() {
    let tiny = tiny();
    let model = Model::open(tiny.bytes()).unwrap();
    let mut arena = memory(&model, 10);
    let mut generator = Generator::new(model.clone(), &mut arena).unwrap();
    let mut stream = generator.stream(&limits(&model, 2)).unwrap();
    stream.push(&[1, 2, 3, 4]).unwrap();
    let request = Request::text("run").steps(2).length(Length::Tokens(3));
    let anchors = [motionette::Anchor::root(3, [0.0; 3])];
    let behind = [Fixed { position: 3, token: 1 }];
    let unknown = [Fixed { position: 0, token: 11 }];
    let refused = [
        (Request::embeddings(&[0.0; 6]), StreamError::NotInParts),
        (request.through(&anchors), StreamError::NotInParts),
        (request.length(Length::Tokens(0)), PlanningError::Length { found: 0, limit: 13 }.into()),
        (request.length(Length::Tokens(14)), PlanningError::Length { found: 14, limit: 13 }.into()),
        (request.length(Length::Tokens(10)), StreamError::QueueFull { found: 10, room: 9 }),
        (request.steps(0), PlanningError::Steps { found: 0, limit: 1000 }.into()),
        (request.fixed(&behind), PlanningError::FixedPosition { index: 0, position: 3, tokens: 3 }.into()),
        (request.fixed(&unknown), PlanningError::FixedToken { index: 0, token: 11, codes: 11 }.into()),
        (Request::tokens(&[11]), Error::TokenOutOfRange { index: 0, token: 11, codes: 11 }.into()),
    ];
    for (request, error) in refused {
        assert_eq!(stream.plan(&request, &mut ()), Err(error));
        assert_eq!(stream.plan_last(&request, &mut ()), Err(error));
    }
    for request in [Request::text(""), Request::text("jump"), Request::bank("jump"), request.guidance(f32::NAN)] {
        assert!(matches!(
            stream.plan(&request, &mut ()),
            Err(StreamError::Request(Error::Prompt(_) | Error::Planning(_)))
        ));
    }
    assert_eq!((stream.tokens(), stream.room()), (&[1u16, 2, 3, 4][..], 9));
    assert!(stream.plan_last(&request, &mut ()).is_ok());
    assert_eq!(drain(&mut stream).len(), 7 * 4 * 3 * JOINTS);

    // A token that adds nothing is no code that the planner could see.
    let mut stream = generator.stream(&limits(&model, 2)).unwrap();
    stream.push(&[1, u16::MAX]).unwrap();
    let error = PlanningError::FixedToken { index: 1, token: u16::MAX, codes: 11 };
    assert_eq!(stream.plan(&request, &mut ()), Err(error.into()));

    let silent =
        Tiny::new(Shape { prior: Some(PriorShape { planned: false, ..PriorShape::default() }), ..Shape::default() }, 1);
    let model = Model::open(silent.bytes()).unwrap();
    let mut arena = vec![0; 1 << 20];
    let mut generator = Generator::new(model.clone(), &mut arena).unwrap();
    assert_eq!(generator.stream(&limits(&model, 2)).map(|_| ()), Err(PlanningError::NoPlanner.into()));
    let mut stream = generator.stream(&StreamLimits { tokens: 9, planning: None, rows: ROWS }).unwrap();
    assert_eq!(stream.plan(&request, &mut ()), Err(PlanningError::NoPlanner.into()));
}

/// Segments of a motion.
const SEAMS_OF: usize = 20;
/// Tokens of a segment.
const LENGTH: usize = 8;
/// Tokens the planner sees at once.
const WINDOW: usize = 24;
/// What is measured at a token boundary.
const MEASURES: [&str; 4] = ["root (m/frame^2)", "heading (rad/frame^2)", "joints (m/frame^2)", "codes"];
/// Chance below which a difference is real: one in a hundred, for all measures together.
const LEVEL: f64 = 0.01 / MEASURES.len() as f64;

/// How rough a motion is at each of its token boundaries: the largest second difference, within a token on either side, of
/// root position, of heading and of joints relative to the root (mean over joints); and the distance of the two tokens'
/// codes. Boundary `i` lies before token `i + 1`.
fn roughness(model: &Model<'_>, frames: &[Frame], tokens: &[u16]) -> Vec<[f64; 4]> {
    let per_token = model.frames_per_token();
    let heading = |f: &Frame| {
        let (left, right) = (f[1], f[2]);
        f64::from(left[2] - right[2]).atan2(f64::from(left[0] - right[0]))
    };
    let turn = |a: f64, b: f64| (b - a).sin().atan2((b - a).cos());
    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let second: Vec<[f64; 3]> = frames
        .windows(3)
        .map(|w| {
            let at = |j: usize| -> [f64; 3] {
                std::array::from_fn(|axis| w.iter().zip([1.0, -2.0, 1.0]).map(|(f, c)| c * f64::from(f[j][axis])).sum())
            };
            let root = at(0);
            let relative = |j: usize| norm(&std::array::from_fn::<f64, 3, _>(|axis| at(j)[axis] - root[axis]));
            let angles: Vec<f64> = w.iter().map(heading).collect();
            let bend = turn(turn(angles[0], angles[1]), turn(angles[1], angles[2])).abs();
            [norm(&root), bend, (1..JOINTS).map(relative).sum::<f64>() / (JOINTS - 1) as f64]
        })
        .collect();
    let width = model.decoder().code_width();
    let mut u = vec![0.0; tokens.len() * width];
    model.codebooks().embed(tokens, &mut u).unwrap();
    (1..tokens.len())
        .map(|token| {
            // Second difference i is that of frames i to i + 2.
            let near = (token - 1) * per_token..((token + 1) * per_token - 1).min(second.len());
            let rough = |k: usize| second[near.clone()].iter().map(|s| s[k]).fold(0.0, f64::max);
            let (before, after) = (&u[(token - 1) * width..token * width], &u[token * width..(token + 1) * width]);
            let step: Vec<f64> = before.iter().zip(after).map(|(a, b)| f64::from(b - a)).collect();
            [rough(0), rough(1), rough(2), norm(&step)]
        })
        .collect()
}

/// A measure at the seams of some motions, and at the other boundaries that no seam's own measure reaches.
fn split(motions: &[Vec<[f64; 4]>], measure: usize) -> (Vec<f64>, Vec<f64>) {
    let (mut seams, mut inside) = (Vec::new(), Vec::new());
    for boundaries in motions {
        for (i, measures) in boundaries.iter().enumerate() {
            match (i + 1) % LENGTH {
                0 => seams.push(measures[measure]),
                1 => {}
                last if last + 1 == LENGTH => {}
                _ => inside.push(measures[measure]),
            }
        }
    }
    assert_eq!(seams.len(), motions.len() * (SEAMS_OF - 1));
    (seams, inside)
}

/// For each measure the share of random choices among `others`, as many as there are `seams`, whose mean is at least that of
/// `seams`: small where they are rougher.
fn chance(name: &str, random: &mut Stream, samples: impl Fn(usize) -> (Vec<f64>, Vec<f64>)) -> [f64; 4] {
    std::array::from_fn(|k| {
        let (seams, others) = samples(k);
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let draws = 4000;
        let choices = (0..draws).map(|_| {
            let sum: f64 = seams.iter().map(|_| others[random.below(others.len() as u32) as usize]).sum();
            sum / seams.len() as f64
        });
        let share = choices.filter(|choice| *choice >= mean(&seams)).count() as f64 / f64::from(draws);
        let (seams, others) = (mean(&seams), mean(&others));
        println!("{name}, {}: {seams:.5} against {others:.5}, chance {share}", MEASURES[k]);
        share
    })
}

/// The motion of `tokens` decoded piece by piece with nothing kept but the root: what the stream must not be.
fn forgetful(model: &Model<'_>, tokens: &[u16]) -> Vec<Frame> {
    let decoder = model.decoder();
    let per_token = model.frames_per_token();
    let all = channels(u32::MAX);
    let mut values: Vec<f32> = Vec::new();
    for tokens in tokens.chunks(LENGTH) {
        let mut memory = vec![0u8; decoder.workspace_bytes(tokens.len(), POSITION_CHANNELS, ROWS) + 16];
        let mut work = decoder.workspace(&mut Arena::new(&mut memory), tokens.len(), POSITION_CHANNELS, ROWS).unwrap();
        let mut u = vec![0.0; tokens.len() * decoder.code_width()];
        model.codebooks().embed(tokens, &mut u).unwrap();
        let mut piece = vec![0.0; tokens.len() * per_token * all.count()];
        assert!(decoder.forward(&u, &all, &mut piece, &mut work, &mut || ControlFlow::Continue(())).is_continue());
        values.extend(piece);
    }
    let features = Features { values: &values, channels: &all };
    let mut buffers: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; tokens.len() * per_token]);
    let [cos, sin, x, z] = &mut buffers;
    let mut path = Path { cos, sin, x, z, d_angle: &mut [], d_x: &mut [], d_z: &mut [] };
    model.recovery().integrate(features, &mut path);
    bytemuck::cast_slice(model.recovery().joints(&mut values, &path)).to_vec()
}

fn all_frames(stream: &mut MotionStream<'_, '_>, frames: &mut Vec<Frame>) {
    while let Some(more) = stream.frames(&mut ()).unwrap() {
        frames.extend_from_slice(more);
    }
}

#[test]
fn no_seam_shows_across_twenty_segments() {
    let path = std::env::var_os("MOTIONETTE_BLOB")
        .unwrap_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/../models/nano.blob").into());
    let file = BlobFile::open(path.as_ref()).expect("the model opens");
    let model = file.model().expect("opened before");
    if model.planning().is_none() {
        eprintln!("skipped: the bundled model has no planner");
        return;
    }
    let planning = planning::PlanningLimits { words: 8, steps: 10, guided: true, anchors: false, clauses: 1 };
    let limits = StreamLimits { tokens: WINDOW, planning: Some(planning), rows: ROWS };
    let mut arena = vec![0u8; 1 << 20];
    let mut generator = Generator::new(model.clone(), &mut arena).unwrap();
    let prompts = ["a person walks", "a person dances", "a person waves the right hand", "a person runs"];
    let (mut streamed, mut apart, mut cut) = (Vec::new(), Vec::new(), Vec::new());
    for (seed, prompt) in prompts.iter().enumerate() {
        let request = Request::text(prompt).length(Length::Tokens(LENGTH as u16)).seed(100 + seed as u64);
        let (mut tokens, mut frames) = (Vec::new(), Vec::new());
        let mut stream = generator.stream(&limits).unwrap();
        for _ in 0..SEAMS_OF {
            stream.plan(&request, &mut ()).unwrap();
            tokens.extend(&stream.tokens()[stream.tokens().len() - LENGTH..]);
            all_frames(&mut stream, &mut frames);
        }
        stream.finish();
        all_frames(&mut stream, &mut frames);
        assert_eq!(frames.len(), tokens.len() * model.frames_per_token());
        streamed.push(roughness(&model, &frames, &tokens));
        // What the test must notice: pieces decoded apart,
        cut.push(roughness(&model, &forgetful(&model, &tokens), &tokens));
        // and pieces planned apart.
        let mut tokens = Vec::new();
        for k in 0..SEAMS_OF as u64 {
            let planning =
                Planning { start_open: true, end_open: true, ..request.seed(1000 * seed as u64 + k).planning };
            tokens.extend(generator.generate(&request.planned(planning), &mut ()).unwrap().tokens());
        }
        let mut stream = generator.stream(&StreamLimits { tokens: LENGTH, planning: None, rows: ROWS }).unwrap();
        let mut frames = Vec::new();
        for tokens in tokens.chunks(LENGTH) {
            stream.push(tokens).unwrap();
            all_frames(&mut stream, &mut frames);
        }
        stream.finish();
        all_frames(&mut stream, &mut frames);
        apart.push(roughness(&model, &frames, &tokens));
    }
    let mut random = Stream::new(9);
    let seams = chance("streamed", &mut random, |k| split(&streamed, k));
    assert!(seams.iter().all(|p| *p > LEVEL), "seams are rougher than what lies between them: {seams:?}");
    let cut = chance("decoded apart", &mut random, |k| split(&cut, k));
    assert!(cut[..3].iter().all(|p| *p < LEVEL), "pieces decoded apart are not noticed: {cut:?}");
    // A decoder that looks further than a segment is long spreads a seam over all of it: such a motion is rougher everywhere.
    let apart = chance("planned apart", &mut random, |k| (split(&apart, k).0, split(&streamed, k).0));
    assert!(apart.iter().any(|p| *p < LEVEL), "pieces planned apart are not noticed: {apart:?}");
}
