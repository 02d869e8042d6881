//! Plans are bounds of what is measured: arena bytes by painting, multiply-accumulates by counting kernels. One test counts, since
//! the counter is one for all threads.

use std::path::Path;

use motionette::codec::vq::decoder::ChunkShape;
use motionette::kernels::count;
use motionette::numerics::hash::Stream;
use motionette::refining::{Activity, Basis, Config, Method, Prior};
use motionette::representation::humanml3d::POSITION_CHANNELS;
use motionette::{
    Anchor, Bones, Fixed, Generator, Length, Limits, Model, Plan, Planning, Prompt, ROWS, Request, Sampling, Schedule,
    Source, StreamLimits, StreamPlan, generation::tokens as planning,
};
use motionette_host::blob::BlobFile;
use motionette_tests::fuzz;
use motionette_tests::standard_request;
use motionette_tests::tiny::{PriorShape, Shape, Tiny};

/// What memory holds before.
const PAINT: u8 = 0xC3;
/// Requests on small models and on the bundled one.
const REQUESTS: (usize, usize) = (192, 8);
/// Streams on each.
const STREAMS: (usize, usize) = (60, 2);

/// Memory behind which nothing is touched.
struct Painted {
    words: Vec<u128>,
}

impl Painted {
    fn new(bytes: usize) -> Self {
        let paint = u128::from_ne_bytes([PAINT; 16]);
        Painted { words: vec![paint; bytes.div_ceil(16) + 64] }
    }

    fn bytes(&mut self) -> &mut [u8] {
        bytemuck::cast_slice_mut(&mut self.words)
    }

    /// Bytes up to the last one that is no longer as it was, to the next 16.
    fn high_water(&mut self) -> usize {
        let last = self.bytes().iter().rposition(|&byte| byte != PAINT);
        last.map_or(0, |at| (at + 1).next_multiple_of(16))
    }
}

fn pick<T: Copy>(random: &mut Stream, list: &[T]) -> T {
    list[random.below(list.len() as u32) as usize]
}

fn words(random: &mut Stream, model: &Model<'_>) -> String {
    let most = model.text().map_or(1, |text| text.max_words()).min(12) as u32;
    let words: Vec<&str> = (0..1 + random.below(most))
        .map(|i| if i == 0 { "a" } else { pick(random, &["person", "waves", "run", "left", "hand", "walks", "the"]) })
        .collect();
    words.join(" ")
}

fn planning<'f>(random: &mut Stream, model: &Model<'_>, fixed: &'f [Fixed]) -> Planning<'f> {
    let tokens = 1 + random.below(model.max_tokens() as u32) as u16;
    let frames = u32::from(tokens) * model.frames_per_token() as u32;
    let whole = Length::Tokens(model.max_tokens() as u16);
    Planning {
        length: if fixed.is_empty() {
            pick(random, &[Length::Predicted, Length::Tokens(tokens), Length::Frames(frames as u16), whole])
        } else {
            whole
        },
        seed: u64::from(random.next_u32()),
        steps: 1 + random.below(5) as u16,
        schedule: pick(random, &[Schedule::Uniform, Schedule::Cosine]),
        guidance: pick(random, &[0.0, 1.0, 2.0]),
        sampling: pick(
            random,
            &[
                Sampling::Greedy,
                Sampling::Gumbel { temperature: 0.7 },
                Sampling::Sample { temperature: 1.2, top_k: 3, top_p: 0.9 },
            ],
        ),
        fixed,
        start_open: random.below(2) == 0,
        end_open: random.below(2) == 0,
        conditioned: random.below(4) > 0,
    }
}

fn config(random: &mut Stream) -> Config {
    Config {
        method: pick(random, &[Method::QuasiNewton, Method::Published]),
        evaluations: random.below(8) as u16,
        stop_error: pick(random, &[0.0, 0.001, 0.3]),
        feasibility: pick(random, &[0.0, 0.5]),
        ridge: pick(random, &[0.0, 0.3]),
        basis: pick(
            random,
            &[Basis::Plain, Basis::Transport, Basis::Slope, Basis::Affine, Basis::Quadratic, Basis::Cubic],
        ),
        activity: pick(random, &[Activity::Residual, Activity::Uniform, Activity::Shuffled]),
        prior: pick(random, &[None, Some(Prior::NANO)]),
        memory: pick(random, &[1, 3, 5, 255]),
        seed: random.next_u32(),
        ..Config::default()
    }
}

/// Up to seven anchors of all families in the first `frames` frames, no two at one.
fn anchors(random: &mut Stream, frames: usize) -> Vec<Anchor> {
    let count = random.below(8).min(frames as u32);
    let place = |random: &mut Stream| random.unit() - 0.5;
    (0..count)
        .map(|i| {
            let frame = (i * frames as u32 / count.max(1)) as u16;
            let at = [place(random), 1.0 + place(random), place(random)];
            match random.below(3) {
                0 => Anchor::root(frame, at),
                1 => Anchor::planar_root(frame, [at[0], at[2]]),
                _ => Anchor::joint(frame, 1 + random.below(21) as u8, at),
            }
        })
        .collect()
}

/// Multiply-accumulates of decoding so many tokens to joints, counted by hand: taps outside the sequence are none.
fn decoding(shape: &Shape, tokens: usize) -> u64 {
    let (width, code_width) = (usize::from(shape.width), usize::from(shape.code_width));
    let mut convolutions = shape.convolutions().into_iter();
    let mut padding =
        || convolutions.next().map(|(dilation, right)| (usize::from(dilation), usize::from(right))).expect("all");
    // Of hidden layers with 16 bits both planes are multiplied.
    let planes = if shape.prefix.is_some_and(|prefix| prefix.wide) { 2 } else { 1 };
    // Each tap loses the rows that it reaches outside.
    let conv = |rows: usize, (dilation, right): (usize, usize), weights: usize| {
        let outside = [2 * dilation - right, dilation - right, right].map(|reach| rows.min(reach));
        (3 * rows - outside.iter().sum::<usize>()) * weights
    };
    let mut rows = tokens;
    let mut macs = conv(rows, padding(), planes * code_width * width);
    for _ in 0..shape.stages {
        for _ in &shape.dilations {
            macs += conv(rows, padding(), planes * width * width) + planes * rows * width * width;
        }
        // Each row's products serve both its copies. Where the first tap looks back two rows, it has no use for the last.
        let (_, right) = padding();
        macs += planes * (3 * rows - (1 - right)) * width * width;
        rows *= 2;
    }
    let outputs = POSITION_CHANNELS + POSITION_CHANNELS.min(usize::from(shape.wide));
    (macs + conv(rows, padding(), planes * width * width) + conv(rows, padding(), width * outputs)) as u64
}

/// What a run of requests saw.
#[derive(Debug, Default)]
struct Seen {
    requests: usize,
    planned: usize,
    refined: usize,
    conditioned: usize,
    streams: usize,
    segments: usize,
    /// Largest share of a plan that was used.
    largest: f64,
}

impl Seen {
    /// Counts made in a part of a plan, which is their bound.
    fn note(&mut self, what: &str, counted: u64, planned: u64) {
        assert!(counted <= planned, "{what}: {counted} multiply-accumulates, planned {planned}");
        self.largest = self.largest.max(counted as f64 / planned as f64);
    }

    fn request(&mut self, name: &str, model: &Model<'_>, random: &mut Stream) {
        let codes = model.codebooks().codes() as u32;
        let positions = 1 + random.below(model.max_tokens() as u32) as usize;
        let numbers = positions * model.codebooks().quantizers();
        let tokens: Vec<u16> = (0..numbers).map(|_| random.below(codes) as u16).collect();
        let limit = model.embedding_limit();
        let u: Vec<f32> =
            (0..positions * model.decoder().code_width()).map(|_| 0.4 * limit * (random.unit() - 0.5)).collect();
        let fixed: Vec<Fixed> = (0..random.below(3).min(model.max_tokens() as u32))
            .map(|i| Fixed { position: i as u16, token: random.below(codes) as u16 })
            .collect();
        let text = words(random, model);
        let bank = model.text().and_then(|text| text.bank().names().last());
        let encoder = model.text().is_some_and(|text| text.encoder().is_some());
        let source = match (random.below(6), model.planning(), bank) {
            (0..4, Some(_), _) if encoder => Source::Text(Prompt::Text(&text)),
            (0..5, Some(_), Some(bank)) => Source::Text(Prompt::Bank(bank)),
            (3 | 5, ..) => Source::Embeddings(&u),
            _ => Source::Tokens(&tokens),
        };
        let planning = planning(random, model, &fixed);
        let positions = match (source, planning.length) {
            (Source::Text(_), Length::Tokens(tokens)) => usize::from(tokens),
            (Source::Text(_), Length::Frames(frames)) => usize::from(frames) / model.frames_per_token(),
            (Source::Text(_), Length::Predicted) => model.max_tokens(),
            _ => positions,
        };
        let anchors = anchors(random, positions * model.frames_per_token());
        let refinement = Some(config(random)).filter(|_| random.below(4) > 0);
        let request = Request {
            refinement,
            source,
            ..Request::tokens(&[]).planned(planning).anchors(&anchors).bones(Bones::Model)
        };

        let rows = random.below(30) as usize;
        let mut empty = Generator::new(model.clone(), &mut []).expect("default floating point");
        empty.set_rows(rows);
        let plan = empty.plan(&request).unwrap_or_else(|e| panic!("{name}: {e}: {request:?}"));
        let mut memory = Painted::new(plan.arena_bytes);
        let mut generator = Generator::new(model.clone(), memory.bytes()).expect("default floating point");
        generator.set_rows(rows);
        count::reset();
        let motion = generator.generate(&request, &mut ()).unwrap_or_else(|e| panic!("{name}: {e}: {request:?}"));
        let counted = count::total();
        assert_eq!(motion.arena_used, plan.arena_bytes, "{name}: {request:?}");
        let conditioned = !anchors.is_empty() && usize::from(motion.unconditioned_anchors()) < anchors.len();
        let (mut evaluations, mut gradients) = (0, 0);
        let edited = motion.refinement.is_some_and(|report| report.edited.is_some());
        if let Some(report) = motion.refinement {
            (evaluations, gradients) = (u32::from(report.evaluations), u32::from(report.gradients));
            assert!(evaluations < plan.evaluations && gradients <= plan.gradients, "{name}: {report:?}");
            self.refined += 1;
        }
        drop(generator);
        // A motion of predicted length may be shorter than there is room for: then its edit does not touch all of that.
        let shorter = matches!((source, planning.length), (Source::Text(_), Length::Predicted)) && edited;
        let touched = memory.high_water();
        assert!(touched == plan.arena_bytes || shorter && touched < plan.arena_bytes, "{touched}, {name}: {request:?}");
        assert!(plan.macs_of(evaluations, gradients) <= plan.macs);
        self.note(name, counted, plan.macs_of(evaluations, gradients));
        self.requests += 1;
        self.planned += usize::from(matches!(source, Source::Text(_)));
        self.conditioned += usize::from(conditioned);
    }

    fn stream(&mut self, name: &str, model: &Model<'_>, random: &mut Stream) {
        let most = model.max_tokens() as u32;
        let capacity = 1 + random.below(most) as usize;
        let encoder = model.text().is_some_and(|text| text.encoder().is_some());
        let text = words(random, model);
        let steps = 1 + random.below(4) as u16;
        let guided = random.below(2) == 0;
        let (words, rows) = (text.split(' ').count(), random.below(30) as usize);
        let planned = model.planning().is_some() && encoder && random.below(4) > 0;
        let planning = planned.then_some(planning::PlanningLimits { words, steps, guided, anchors: false, clauses: 1 });
        let limits = StreamLimits { tokens: capacity, planning, rows };
        let plan = StreamPlan::new(model, &limits).expect("the limits are legal");
        let mut memory = Painted::new(plan.arena_bytes);
        let mut generator = Generator::new(model.clone(), memory.bytes()).expect("default floating point");
        let mut stream = generator.stream(&limits).expect(name);
        let mut whole = !planned;
        for _ in 0..1 + random.below(3) {
            let room = stream.room();
            if room == 0 {
                break;
            }
            let count = if random.below(2) == 0 { room } else { 1 + random.below(room as u32) as usize };
            count::reset();
            if planned {
                let request = Request::text(&text).length(Length::Tokens(count as u16)).steps(steps);
                let known = stream.tokens().len();
                let request = request.guidance(if guided { 2.0 } else { 1.0 }).seed(u64::from(random.next_u32()));
                stream.plan(&request, &mut ()).expect(name);
                // The planner sees what is remembered and the new tokens: all that the stream was planned for, or less.
                whole |= known + count >= capacity;
                self.note(name, count::total(), plan.planning_macs);
                self.segments += 1;
            } else {
                let tokens = vec![0; count * model.codebooks().quantizers()];
                stream.push(&tokens).expect(name);
                assert_eq!(count::total(), 0);
            }
            while self.frames(name, &plan, &mut stream) {}
        }
        stream.finish();
        while self.frames(name, &plan, &mut stream) {}
        drop(generator);
        let used = memory.high_water();
        assert!(used <= plan.arena_bytes, "{name}: {used} bytes touched, planned {}", plan.arena_bytes);
        assert!(!whole || used == plan.arena_bytes, "{name}: {used} bytes touched, planned {}", plan.arena_bytes);
        self.streams += 1;
    }

    fn frames(&mut self, name: &str, plan: &StreamPlan, stream: &mut motionette::MotionStream<'_, '_>) -> bool {
        count::reset();
        let frames = stream.frames(&mut ()).expect(name).map(<[_]>::len);
        self.note(name, count::total(), plan.frames_macs);
        assert!(frames.is_none_or(|frames| frames <= plan.frames), "{name}");
        frames.is_some()
    }
}

#[test]
fn plans_bound_bytes_and_multiply_accumulates() {
    let mut models = fuzz::corpus();
    let controlled = Shape { prior: Some(PriorShape::with_control()), ..Shape::with_prior() };
    let shapes = [("default", Shape::default()), ("with prior", Shape::with_prior()), ("with control", controlled)];
    let mixed = Shape { right: vec![1, 2, 1, 0, 0, 1, 1, 0, 1], ..Shape::with_prior() };
    let shapes = shapes.into_iter().chain([("causal", Shape::default().causal()), ("mixed padding", mixed)]);
    models.extend(shapes.into_iter().map(|(name, shape)| (name, Tiny::new(shape, 9))));
    let mut seen = Seen::default();
    let mut random = Stream::new(7);
    let opened: Vec<_> =
        models.iter().map(|(name, tiny)| (*name, Model::open(tiny.bytes()).expect("it opens"))).collect();
    for at in 0..REQUESTS.0 {
        let (name, model) = &opened[at % opened.len()];
        seen.request(name, model, &mut random);
    }
    // Nothing is left out and nothing done in vain, whatever the number of rows: decoding makes the products that there are, and
    // those of one row by one tap again where one chunk follows another through an upsampling.
    for ((name, tiny), (_, model)) in models.iter().zip(&opened) {
        for length in 1..=model.max_tokens().min(19) {
            let tokens = vec![0; length * model.codebooks().quantizers()];
            let mut arena = vec![0u8; 1 << 19];
            let mut generator = Generator::new(model.clone(), &mut arena).expect("default floating point");
            count::reset();
            generator.generate(&Request::tokens(&tokens), &mut ()).expect(name);
            let products = decoding(&tiny.shape, length);
            let follow = (length + model.decoder().radius_tokens()).div_ceil(ChunkShape::new(length, ROWS).tokens) - 1;
            let planes = if tiny.shape.prefix.is_some_and(|prefix| prefix.wide) { 2 } else { 1 };
            let again = planes * u64::from(tiny.shape.stages) * u64::from(tiny.shape.width).pow(2);
            let bounds = products..=products + follow as u64 * again;
            assert!(bounds.contains(&count::total()), "{name}: {length} tokens, {} in {bounds:?}", count::total());
        }
    }
    for at in 0..STREAMS.0 {
        let (name, model) = &opened[at % opened.len()];
        seen.stream(name, model, &mut random);
    }

    let blob = BlobFile::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/nano.blob")).expect("bundled");
    let nano = blob.model().expect("nano opens");
    for _ in 0..REQUESTS.1 {
        seen.request("nano", &nano, &mut random);
    }
    for _ in 0..STREAMS.1 {
        seen.stream("nano", &nano, &mut random);
    }
    println!("{seen:?}");
    assert_eq!(seen.requests, 200);
    assert!(seen.planned > 50 && seen.refined > 50 && seen.conditioned > 5 && seen.segments > 20, "{seen:?}");

    let counted = standard_request::count(&nano).expect("the standard request");
    let ratio = counted.planned() as f64 / counted.macs as f64;
    println!("standard request: {} planned, {} counted: {ratio:.4}", counted.planned(), counted.macs);
    assert!((1.0..=1.1).contains(&ratio), "{counted:?}");
}

/// Of the decoder's layers only a bit for each ReLU grows with the motion; the rest of a request does with its tokens and frames.
#[test]
fn layers_take_no_more_for_longer_motions() {
    let blob = BlobFile::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/nano.blob")).expect("bundled");
    let nano = blob.model().expect("nano opens");
    let plan = |tokens| {
        Plan::for_request(
            &nano,
            &Limits {
                tokens,
                anchors: 8,
                tracked: 0,
                timeline: None,
                refinement: Config::default(),
                planning: None,
                rows: ROWS,
            },
        )
        .expect("the limits are legal")
    };
    let chunk = ChunkShape::new(usize::MAX, ROWS).tokens;
    let (short, long) = (plan(chunk), plan(nano.max_tokens()));
    assert_eq!(short.decoder_bytes, long.decoder_bytes);
    assert!(plan(chunk / 2).decoder_bytes < short.decoder_bytes);
    // Stages of three residual blocks, twelve ReLUs a token and pair of frames; input and middle convolution: 96 channels each.
    let gates = |tokens: usize| 96 / 8 * (tokens * (1 + 6) + 2 * tokens * 6 + 4 * tokens);
    assert!(long.gate_bytes.abs_diff(gates(nano.max_tokens())) < 16, "{long:?}");
    assert!(short.gate_bytes.abs_diff(gates(chunk)) < 16, "{short:?}");
}
