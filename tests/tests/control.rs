//! Anchors inside the planner, on small random models: their features against dense curves, what they tell the planner against an
//! f64 oracle, and what a request notices of them.

use motionette::blob::{ControlConfig, Corruption, Error as BlobError, Norm, TransformerConfig};
use motionette::conditioning::scaffold::{self, Scaffold, Statistics};
use motionette::generation::tokens::{PlanningLimits, Session};
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::refining::Config;
use motionette::request::conditions::{AnchorSet, FAMILIES, MAX_ANCHORS};
use motionette::{
    Anchor, Error, Generator, Length, Model, Observer, Planning, Progress, Prompt, ROWS, Request, Stage, Stop, Target,
};
use motionette_host::reference;
use motionette_tests::naive_prior::{self, Rows, Scene};
use motionette_tests::naive_scaffold;
use motionette_tests::tiny::{PriorShape, Shape, Tiny};
use std::ops::ControlFlow;

const PROMPT: &str = "a person waves the left hand";
/// Its ids in the default vocabulary.
const IDS: [u16; 6] = [2, 3, 4, 1, 6, 7];

fn coordinate(random: &mut Stream) -> f32 {
    3.0 * random.unit() - 1.5
}

/// `count` anchors at distinct frames and joints, of the families of `families` with equal chance.
fn draw(random: &mut Stream, count: usize, frames: u32, families: &[u32]) -> Vec<Anchor> {
    let mut anchors: Vec<Anchor> = Vec::new();
    while anchors.len() < count {
        let frame = random.below(frames) as u16;
        let [x, y, z] = [0; 3].map(|_| coordinate(random));
        let anchor = match families[random.below(families.len() as u32) as usize] {
            0 => Anchor::root(frame, [x, y, z]),
            1 => Anchor::planar_root(frame, [x, z]),
            // Few joints, so that they have curves.
            _ => Anchor::joint(frame, [0, 4, 15, 20, 21][random.below(5) as usize], [x, y, z]),
        };
        let place = |a: &Anchor| (a.frame, if let Target::Joint { joint, .. } = a.target { joint } else { 0 });
        if anchors.iter().all(|other| place(other) != place(&anchor)) {
            anchors.push(anchor);
        }
    }
    anchors
}

/// The runtime's features `[frames][244]`.
fn features(anchors: &[Anchor], families: u8, frames: usize, mean: &[f32], std: &[f32]) -> Vec<Vec<f32>> {
    let set = AnchorSet::new(anchors, frames).expect("the anchors are valid");
    let mut bends = vec![f32::NAN; Scaffold::NUMBERS];
    let scaffold = Scaffold::new(&set, families, Statistics { mean, std }, 20.0, &mut bends);
    let row = |frame| {
        let mut c = vec![f32::NAN; scaffold::WIDTH];
        scaffold.features(frame, &mut c);
        c
    };
    (0..frames).map(row).collect()
}

fn of_reference(anchor: &Anchor) -> reference::anchors::Anchor {
    use reference::anchors::Target as Wanted;
    let wide = |p: [f32; 3]| p.map(f64::from);
    let target = match anchor.target {
        Target::Root(p) => Wanted::Root(wide(p)),
        Target::PlanarRoot([x, z]) => Wanted::PlanarRoot([f64::from(x), f64::from(z)]),
        Target::Joint { joint, position } => Wanted::Joint { joint: usize::from(joint), position: wide(position) },
    };
    reference::anchors::Anchor { frame: usize::from(anchor.frame), target }
}

#[test]
fn features_are_those_of_dense_curves_and_of_the_reference() {
    let mut random = Stream::new(40);
    let mean: Vec<f32> = (0..66).map(|_| coordinate(&mut random)).collect();
    let std: Vec<f32> = (0..66).map(|_| 0.3 + random.unit()).collect();
    let wide = |values: &[f32]| -> Vec<f64> { values.iter().map(|&v| f64::from(v)).collect() };
    let (wide_mean, wide_std) = (wide(&mean), wide(&std));
    let statistics = reference::scaffold::Statistics { mean: mean.clone(), std: std.clone() };
    let mixtures: [&[u32]; 6] = [&[0], &[1], &[2], &[0, 1], &[1, 2], &[0, 1, 2]];
    let (mut worst, mut splines) = (0.0f64, 0);
    for families in mixtures {
        for count in 1..=MAX_ANCHORS {
            let frames = 40 + random.below(157);
            let anchors = draw(&mut random, count, frames, families);
            let frames = frames as usize;
            let got = features(&anchors, FAMILIES, frames, &mean, &std);
            let dense = naive_scaffold::features(&anchors, frames, 20.0, &wide_mean, &wide_std);
            let wanted: Vec<reference::anchors::Anchor> = anchors.iter().map(of_reference).collect();
            let reference: Vec<f64> = reference::scaffold::features(&wanted, frames, 20.0, &statistics);
            for (t, ((got, dense), reference)) in got.iter().zip(&dense).zip(reference.chunks(244)).enumerate() {
                for (k, ((got, dense), reference)) in got.iter().zip(dense).zip(reference).enumerate() {
                    let (got, allowed) = (f64::from(*got), 2e-4 * (1.0 + dense.abs()));
                    worst = worst.max((got - dense).abs() / (1.0 + dense.abs()));
                    let near = (got - dense).abs() < allowed && (got - reference).abs() < allowed;
                    assert!(near, "{anchors:?} frame {t} feature {k}: {got}, dense {dense}, reference {reference}");
                }
            }
            // An anchor's value is its curve's to the bit.
            for anchor in &anchors {
                let c = &got[usize::from(anchor.frame)];
                let (joint, axes): (usize, &[usize]) = match anchor.target {
                    Target::Root(_) => (0, &[0, 1, 2]),
                    Target::PlanarRoot(_) => (0, &[0, 2]),
                    Target::Joint { joint, .. } => (usize::from(joint), &[0, 1, 2]),
                };
                for axis in axes {
                    assert_eq!(c[3 * joint + axis].to_bits(), c[66 + 3 * joint + axis].to_bits());
                }
            }
            splines += usize::from(count > 19);
        }
    }
    assert!(worst > 0.0 && splines > 0, "{worst}");
}

#[test]
fn families_that_are_not_seen_leave_no_features() {
    let mut random = Stream::new(41);
    let (mean, std) = (vec![0.1; 66], vec![0.7; 66]);
    let anchors = draw(&mut random, 30, 60, &[0, 1, 2]);
    for families in 0..=FAMILIES {
        let seen: Vec<Anchor> = anchors.iter().filter(|a| a.target.family().bit() & families != 0).copied().collect();
        assert_eq!(features(&anchors, families, 60, &mean, &std), features(&seen, FAMILIES, 60, &mean, &std));
    }
}

#[test]
fn far_anchors_and_tiny_deviations_stay_within_the_limit() {
    let mut random = Stream::new(42);
    let std: Vec<f32> = (0..66).map(|i| if i % 2 == 0 { f32::MIN_POSITIVE } else { 1e38 }).collect();
    let mean: Vec<f32> = (0..66).map(|i| if i % 3 == 0 { f32::MAX } else { -f32::MAX }).collect();
    for _ in 0..20 {
        let mut anchors = draw(&mut random, 32, 33, &[0, 1, 2]);
        for anchor in &mut anchors {
            if let Target::Joint { position, .. } | Target::Root(position) = &mut anchor.target {
                *position = position.map(|v| if v > 0.0 { 1000.0 } else { -1000.0 });
            }
        }
        for c in features(&anchors, FAMILIES, 33, &mean, &std) {
            assert!(c.iter().all(|v| v.abs() <= scaffold::LIMIT), "{c:?}");
        }
    }
}

fn with(prior: PriorShape) -> Shape {
    Shape { prior: Some(prior), ..Shape::with_prior() }
}

/// Controls that differ in all that is configuration.
fn shapes() -> Vec<Shape> {
    let base = PriorShape::with_control();
    let control = base.control.unwrap();
    let scaffold = control.scaffold;
    let change = |control| with(PriorShape { control: Some(control), ..base.clone() });
    let wide = TransformerConfig { width: 20, heads: 5, layers: 1, hidden: 30, norm: Norm::Post, ..scaffold };
    let large = PriorShape {
        planner: TransformerConfig { width: 24, heads: 3, layers: 3, hidden: 20, ..base.planner },
        ..base.clone()
    };
    vec![
        with(base.clone()),
        change(ControlConfig { context: false, ..control }),
        change(ControlConfig { scaffold: wide, frame_width: 40, rank: 17, ..control }),
        Shape { stages: 1, ..change(ControlConfig { families: 5, ..control }) },
        Shape { stages: 3, dilations: vec![1], ..with(large) },
        with(PriorShape { corruption: Corruption::Masks, ..base.clone() }),
    ]
}

/// Logits `[L][V]` of a session in exactly the planned memory.
fn logits(tiny: &Tiny, scene: &Scene, planning: &Planning<'_>, anchors: bool) -> Rows {
    let model = Model::open(tiny.bytes()).expect("the blob opens");
    let modules = model.planning().expect("the blob plans");
    let tokens = scene.tokens.len();
    let limits = PlanningLimits { words: IDS.len(), steps: 1, guided: planning.guided(), anchors, clauses: 1 };
    let bytes = modules.bytes(tokens, &limits, ROWS).all();
    let mut words = vec![0u128; bytes / 16];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut words));
    let mut session = Session::new(modules, &mut arena, tokens, &limits, ROWS).expect("the planned bytes suffice");
    assert_eq!(arena.used(), bytes, "planned bytes are what a session takes");
    let _ = session.read(&Prompt::Text(PROMPT), &mut || ControlFlow::Continue(())).unwrap().continue_value().unwrap();
    let set = AnchorSet::new(&scene.anchors, tokens * model.frames_per_token()).expect("the anchors are valid");
    assert!(session.anchor(&set, tokens, &mut || ControlFlow::Continue(())).is_continue());
    assert!(session.pass(&scene.tokens, scene.time as f32, planning, &mut || ControlFlow::Continue(())).is_continue());
    (0..tokens).map(|i| session.logits(i).iter().map(|&v| f64::from(v)).collect()).collect()
}

fn oracle(tiny: &Tiny, scene: &Scene, guidance: f64) -> Rows {
    let (memory, pooled) = naive_prior::encode(tiny, &IDS);
    let text = naive_prior::logits(tiny, scene, &memory, &pooled);
    let (memory, pooled) = naive_prior::encode(tiny, &[0]);
    // What guides is text and anchors together.
    let free = Scene { anchors: Vec::new(), ..scene.clone() };
    let none = naive_prior::logits(tiny, &free, &memory, &pooled);
    let mix = |(t, n): (&Vec<f64>, &Vec<f64>)| t.iter().zip(n).map(|(t, n)| n + guidance * (t - n)).collect();
    text.iter().zip(&none).map(mix).collect()
}

/// Root mean square difference of two sets of logits.
fn difference(got: &Rows, want: &Rows) -> f64 {
    let pairs: Vec<f64> = got.iter().flatten().zip(want.iter().flatten()).map(|(a, b)| (a - b).powi(2)).collect();
    (pairs.iter().sum::<f64>() / pairs.len() as f64).sqrt()
}

fn spread(rows: &Rows) -> f64 {
    let all: Vec<f64> = rows.iter().flatten().copied().collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    (all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / all.len() as f64).sqrt()
}

#[test]
fn conditioned_logits_agree_with_the_oracle() {
    let mut random = Stream::new(43);
    let (mut cases, mut noticed) = (0, 0);
    for (seed, shape) in shapes().into_iter().enumerate() {
        let tiny = Tiny::new(shape.clone(), 170 + seed as u64);
        // The last is a masked one, where the model knows it.
        let masks = shape.prior.as_ref().is_some_and(|prior| prior.corruption == Corruption::Masks);
        for (length, count) in [(1u16, 1), (7, 3), (13, 8), (9, 15)] {
            let tokens: Vec<u16> = (0..length).map(|_| random.below(11 + u32::from(masks)) as u16).collect();
            let frames = u32::from(length) << shape.stages;
            let mut anchors = draw(&mut random, count.min(frames as usize), frames, &[0, 1, 2]);
            // Seen by every one of these shapes.
            anchors[0] = Anchor { target: Target::Root([0.4, 0.9, -0.7]), ..anchors[0] };
            anchors.retain({
                let first = anchors[0];
                move |a| a == &first || a.frame != first.frame
            });
            anchors.sort_by_key(|a| a.frame);
            let scene = Scene { tokens, time: 0.4, anchors, ..Scene::default() };
            for guidance in [1.0f32, 2.5] {
                let planning = Planning { guidance, ..Planning::DEFAULT };
                let got = logits(&tiny, &scene, &planning, true);
                let want = oracle(&tiny, &scene, f64::from(guidance));
                let unit = spread(&want) * f64::from(1.0 + guidance);
                let apart = difference(&got, &want);
                assert!(apart < 0.02 * unit, "{shape:?} {scene:?} {guidance}: {apart} of {unit}");
                // What the test would notice: no anchors, and others.
                let without = Scene { anchors: vec![], ..scene.clone() };
                let free = oracle(&tiny, &without, f64::from(guidance));
                let other = Scene { anchors: vec![Anchor::root(0, [-2.0, 0.3, 2.0])], ..scene.clone() };
                let other = oracle(&tiny, &other, f64::from(guidance));
                for wrong in [&free, &other] {
                    cases += 1;
                    noticed += usize::from(difference(&got, wrong) > 4.0 * apart);
                }
                // Without room, or without anchors, they are not there to the bit.
                let plain = logits(&tiny, &without, &planning, false);
                assert_eq!(logits(&tiny, &scene, &planning, false), plain);
                assert_eq!(logits(&tiny, &without, &planning, true), plain);
            }
        }
    }
    assert!(10 * noticed > 9 * cases, "the test would notice {noticed} of {cases} mistakes");
}

fn tiny() -> Tiny {
    Tiny::new(with(PriorShape::with_control()), 31)
}

fn base() -> Request<'static> {
    Request::text(PROMPT).length(Length::Tokens(6)).seed(5).steps(4).unrefined()
}

const ANCHORS: [Anchor; 4] = [
    Anchor::root(10, [0.2, 0.9, 0.3]),
    Anchor::joint(20, 20, [0.2, 1.2, 0.3]),
    Anchor::planar_root(3, [0.1, -0.6]),
    Anchor::joint(22, 20, [0.9, 1.2, -0.3]),
];

/// Hash and tokens of a motion, and how many anchors its planner did not see.
fn made(tiny: &Tiny, request: &Request<'_>) -> (u64, Vec<u16>, u16) {
    let mut words = vec![0u128; 1 << 16];
    let model = Model::open(tiny.bytes()).expect("the blob opens");
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut words)).expect("default floating point");
    let motion = generator.generate(request, &mut ()).expect("the request is valid");
    (motion.hash(), motion.tokens().to_vec(), motion.unconditioned_anchors())
}

#[test]
fn anchors_change_what_is_planned_unless_they_are_not_to() {
    let (controlled, plain) = (tiny(), Tiny::new(Shape::with_prior(), 31));
    let refined = base().through(&ANCHORS).refined(Config::fast(3));
    let alone = Request { refinement: None, ..refined };
    let mut moved = 0;
    for seed in 0..10 {
        let free = made(&controlled, &base().seed(seed));
        assert_eq!(free, made(&plain, &base().seed(seed)), "without anchors control is not there");
        for request in [refined.seed(seed), alone.seed(seed)] {
            let unseen = made(&plain, &request);
            assert_eq!(unseen.2, 4);
            assert_eq!(unseen, made(&plain, &request.unconditioned()));
            assert_eq!(unseen, made(&controlled, &request.unconditioned()));
            let (_, tokens, count) = made(&controlled, &request);
            assert_eq!(count, 0);
            moved += usize::from(tokens != free.1);
        }
        let other = [Anchor::root(10, [-0.9, 0.4, 1.3])];
        let one = made(&controlled, &alone.anchors(&other).seed(seed));
        moved += usize::from(one.1 != made(&controlled, &alone.seed(seed)).1);
    }
    assert!(moved > 25, "anchors mean little to this planner: {moved} of 30");
    // Tokens and embeddings are not planned.
    let tokens = made(&controlled, &Request::tokens(&[1, 2, 3, 4, 5, 6]).through(&ANCHORS).refined(Config::fast(1)));
    assert_eq!(tokens.2, 4);
}

#[test]
fn families_that_the_model_was_not_trained_for_only_refine() {
    let counts = [(1u8, 3), (2, 3), (4, 2), (3, 2), (5, 1), (6, 1), (7, 0)];
    for (families, unseen) in counts {
        let prior = PriorShape::with_control();
        let control = prior.control.map(|control| ControlConfig { families, ..control });
        let tiny = Tiny::new(with(PriorShape { control, ..prior }), 31);
        let seen: Vec<Anchor> = ANCHORS.into_iter().filter(|a| a.target.family().bit() & families != 0).collect();
        let rest: Vec<Anchor> = ANCHORS.into_iter().filter(|a| !seen.contains(a)).collect();
        let all = made(&tiny, &base().anchors(&ANCHORS));
        let (hash, tokens, none) = made(&tiny, &base().anchors(&seen));
        assert_eq!((all, none), ((hash, tokens, unseen), 0));
        let (hash, tokens, _) = made(&tiny, &base().anchors(&rest));
        let free = made(&tiny, &base());
        assert_eq!((hash, tokens), (free.0, free.1));
    }
}

#[test]
fn painted_memory_is_what_the_plan_says() {
    let mut planned_more = 0;
    let mut prior = PriorShape::with_control();
    prior.planner = TransformerConfig { width: 128, heads: 4, layers: 5, hidden: 300, ..prior.planner };
    for shape in shapes().into_iter().chain([with(prior)]) {
        let tiny = Tiny::new(shape, 33);
        let model = Model::open(tiny.bytes()).unwrap();
        let alone = base().anchors(&ANCHORS);
        let requests = [
            alone,
            alone.guidance(1.0),
            alone.length(Length::Predicted),
            alone.through(&ANCHORS).refined(Config::fast(3)),
            alone.unconditioned(),
            Request { source: Request::bank("wave").source, ..alone }.length(Length::Tokens(13)),
        ];
        for request in requests {
            // Short tokens make fewer frames.
            let last = 6 * model.frames_per_token() as u16 - 1;
            let anchors = ANCHORS.map(|a| Anchor { frame: a.frame.min(last), ..a });
            let request = request.anchors(&anchors[..3]);
            let mut words = vec![0u128; 1 << 16];
            let memory: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
            let used = |memory: &mut [u8]| {
                let mut generator = Generator::new(model.clone(), memory).unwrap();
                generator.generate(&request, &mut ()).map(|motion| motion.arena_used)
            };
            let plan_of =
                |request: &Request<'_>| Generator::new(model.clone(), &mut []).unwrap().plan(request).unwrap();
            let (plan, free) = (plan_of(&request), plan_of(&request.unconditioned()));
            assert_eq!(plan.planning.all() > free.planning.all(), request.planning.conditioned);
            assert_eq!(plan.planning_macs > free.planning_macs, request.planning.conditioned);
            planned_more += usize::from(plan.arena_bytes > free.arena_bytes);
            let planned = plan.arena_bytes;
            assert_eq!(used(&mut memory[..planned]), Ok(planned));
            match used(&mut memory[..planned - 1]) {
                Err(Error::Arena(e)) => assert_eq!((e.needed, e.available), (planned, planned - 1)),
                other => panic!("one byte less must be refused, got {other:?}"),
            }
            memory.fill(0xC3);
            assert_eq!(used(memory), Ok(planned));
            let high_water = memory.iter().rposition(|&b| b != 0xC3).unwrap() + 1;
            assert!(high_water <= planned && high_water + 16 > planned, "high-water {high_water}, planned {planned}");
        }
    }
    assert!(planned_more > 3, "planning is the larger stage too seldom: {planned_more}");
}

#[test]
fn planned_work_is_that_of_the_layers() {
    let tiny = tiny();
    let model = Model::open(tiny.bytes()).unwrap();
    let modules = model.planning().unwrap();
    let (l, d, layers, steps) = (6u64, 8u64, 2u64, 4u64);
    let (ds, hs, blocks, fw, r) = (6u64, 9u64, 2u64, 5u64, 3u64);
    let limits = PlanningLimits { words: 5, steps: 4, guided: true, anchors: false, clauses: 1 };
    let without = modules.macs(6, &limits);
    let scaffold = l * (4 * 244 * fw + 4 * fw * ds + blocks * (4 * ds * ds + 2 * l * ds + 2 * ds * hs));
    let once = scaffold + layers * l * (ds * r + r * 2 * d) + ds * ds + ds * d + l * ds * d;
    let each_pass = layers * (1 + l) * 2 * l * d;
    // The pass that guidance compares with knows no anchors.
    let want = without + once + steps * each_pass;
    assert_eq!(modules.macs(6, &PlanningLimits { anchors: true, ..limits }), want);
}

/// Answers `wish` at call number `at`.
struct Stopper {
    calls: usize,
    at: usize,
    wish: ControlFlow<Stop>,
    stages: Vec<Stage>,
}

impl Observer for Stopper {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        self.calls += 1;
        self.stages.push(progress.stage);
        if self.calls == self.at { self.wish } else { ControlFlow::Continue(()) }
    }
}

#[test]
fn reading_anchors_can_be_stopped_at_every_layer() {
    let tiny = tiny();
    let mut words = vec![0u128; 1 << 16];
    let model = Model::open(tiny.bytes()).unwrap();
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut words)).unwrap();
    let request = base().anchors(&ANCHORS);
    let mut reads = |request: &Request<'_>| {
        let mut all = Stopper { calls: 0, at: 0, wish: ControlFlow::Continue(()), stages: vec![] };
        let hash = generator.generate(request, &mut all).unwrap().hash();
        (hash, all.stages.iter().filter(|stage| **stage == Stage::Reading).count())
    };
    let (hash, reading) = reads(&request);
    let (_, free) = reads(&request.unconditioned());
    assert_eq!(reading, free + 2 + 2, "the scaffold's two blocks, and keys and values of the planner's two");
    for at in free + 1..=reading {
        let mut stopper = Stopper { calls: 0, at, wish: ControlFlow::Break(Stop::Abort), stages: vec![] };
        assert_eq!(generator.generate(&request, &mut stopper).map(|m| m.hash()), Err(Error::Aborted));
        assert_eq!(stopper.calls, at);
        let mut stopper = Stopper { calls: 0, at, wish: ControlFlow::Break(Stop::Finish), stages: vec![] };
        let tokens = generator.generate(&request, &mut stopper).unwrap().tokens().to_vec();
        assert_eq!(tokens, generator.generate(&request.steps(1), &mut ()).unwrap().tokens());
        assert_eq!(generator.generate(&request, &mut ()).unwrap().hash(), hash);
    }
}

#[test]
fn refused_requests_and_blobs_say_why() {
    let tiny = tiny();
    let mut words = vec![0u128; 1 << 16];
    let model = Model::open(tiny.bytes()).unwrap();
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut words)).unwrap();
    let good = generator.generate(&base().anchors(&ANCHORS), &mut ()).unwrap().hash();
    let bad = [
        Anchor::root(24, [0.0; 3]),
        Anchor::root(0, [f32::NAN, 0.0, 0.0]),
        Anchor::joint(0, 22, [0.0; 3]),
        Anchor::planar_root(0, [0.0, 1001.0]),
    ];
    for anchor in bad {
        for anchors in [vec![anchor], [ANCHORS.as_slice(), &[anchor]].concat()] {
            let request = base().anchors(&anchors);
            let refused = generator.generate(&request, &mut ()).map(|m| m.hash());
            assert!(matches!(refused, Err(Error::Anchors(_))), "{anchor:?}: {refused:?}");
        }
    }
    assert_eq!(generator.generate(&base().anchors(&ANCHORS), &mut ()).unwrap().hash(), good);

    let refused = |change: &dyn Fn(&mut ControlConfig)| {
        let mut prior = PriorShape::with_control();
        change(prior.control.as_mut().unwrap());
        let tiny = Tiny::new(with(prior), 1);
        Model::open(tiny.bytes()).map(|_| ()).unwrap_err()
    };
    let config = |error| match error {
        BlobError::Config { what, found, limit } => (what, found, limit),
        other => panic!("{other:?}"),
    };
    assert_eq!(config(refused(&|c| c.families = 0)), ("generator.control.families", 0, 7));
    assert_eq!(config(refused(&|c| c.families = 8)), ("generator.control.families", 8, 7));
    assert_eq!(config(refused(&|c| c.rank = 0)), ("generator.control.rank", 0, 1024));
    assert_eq!(config(refused(&|c| c.frame_width = 1025)), ("generator.control.frame_width", 1025, 1024));
    assert_eq!(config(refused(&|c| c.scaffold.heads = 4)), ("transformer.heads that do not divide the width", 4, 6));
}
