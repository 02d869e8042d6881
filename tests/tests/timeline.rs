//! Body-part timelines: parts do what a motion of their own does, judged in f64 by code that knows nothing of the runtime's; all else stays bit by bit what
//! it is without them.

use std::path::Path;

use motionette::refining::{Config, Exact};
use motionette::{
    BodyParts, Bones, Error, Generator, Joint, Limits, Model, Plan, Prompt, PromptError, Request, Span, TimelineError,
    Track,
};
use motionette_host::blob::BlobFile;
use motionette_host::metrics;
use motionette_host::motion::Pose;
use motionette_tests::tiny::{Shape, Tiny};

const PAINT: u8 = 0xA5;
const SEED_STEP: u64 = 0x9E37_79B9_7F4A_7C15;

fn blob() -> BlobFile {
    BlobFile::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/nano.blob")).expect("bundled")
}

/// Makes a motion in the planned arena, and checks that the plan names all that was touched.
fn made(model: &Model<'_>, request: &Request<'_>) -> Result<(Vec<Pose>, Vec<u16>), Error> {
    let plan = Generator::new(model.clone(), &mut []).expect("default rounding").plan(request)?;
    let mut words = vec![0u128; plan.arena_bytes.div_ceil(16) + 64];
    let arena: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
    arena.fill(PAINT);
    let mut generator = Generator::new(model.clone(), arena).expect("default rounding");
    let motion = generator.generate(request, &mut ())?;
    assert_eq!(motion.arena_used, plan.arena_bytes);
    let said = motion.spans().iter().map(|heard| heard.words).collect();
    let out = (motion.frames().to_vec(), said);
    drop(generator);
    let touched = bytemuck::cast_slice::<u128, u8>(&words).iter().rposition(|byte| *byte != PAINT);
    assert!(touched.is_some_and(|last| last < plan.arena_bytes), "{touched:?} of {}", plan.arena_bytes);
    Ok(out)
}

type V = [f64; 3];

fn minus(a: V, b: V) -> V {
    [0, 1, 2].map(|i| a[i] - b[i])
}

fn dot(a: V, b: V) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

fn normal(a: V) -> V {
    a.map(|v| v / dot(a, a).sqrt())
}

fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A joint as another sees it that three others turn with: `[origin, left, right, above]`.
fn seen(pose: &Pose, [origin, left, right, above]: [usize; 4], joint: usize) -> V {
    let at = |joint: usize| pose[joint].map(f64::from);
    let x = normal(minus(at(left), at(right)));
    let up = minus(at(above), at(origin));
    let y = normal(minus(up, x.map(|v| v * dot(x, up))));
    let way = minus(at(joint), at(origin));
    [dot(x, way), dot(y, way), dot(cross(x, y), way)]
}

const PELVIS: [usize; 4] = [0, 1, 2, 3];
const CHEST: [usize; 4] = [9, 13, 14, 12];

/// Joints of some parts with what carries them.
fn joints(parts: BodyParts) -> Vec<(usize, [usize; 4])> {
    let mut joints = Vec::new();
    for (part, of_part, carrier) in [
        (BodyParts::HEAD, vec![15], CHEST),
        (BodyParts::LEFT_ARM, vec![16, 18, 20], CHEST),
        (BodyParts::RIGHT_ARM, vec![17, 19, 21], CHEST),
        (BodyParts::LEFT_LEG, vec![4, 7, 10], PELVIS),
        (BodyParts::RIGHT_LEG, vec![5, 8, 11], PELVIS),
        (BodyParts::UPPER_BODY, vec![6, 9, 12, 13, 14], PELVIS),
    ] {
        if parts.has(part) {
            joints.extend(of_part.into_iter().map(|joint| (joint, carrier)));
        }
    }
    joints
}

/// The frames of a span at which it counts wholly.
fn whole(span: &Span<'_>, frames: usize) -> std::ops::Range<usize> {
    let lead = usize::from(span.frames / 4).min(10);
    let first = usize::from(span.first) + if span.first > 0 { lead } else { 0 };
    first..span.end() - if span.end() < frames { lead } else { 0 }
}

/// Compares the motion of a request and its timeline with the request's own and the spans' own motions: how far told joints are at most from where they were
/// told to be, and how far they would be without the timeline, metres.
fn judged(model: &Model<'_>, plain: &Request<'_>, spans: &[Span<'_>]) -> (f64, f64) {
    let (was, none) = made(model, plain).expect("it runs");
    assert!(none.iter().all(|words| *words == 0));
    let (frames, said) = made(model, &plain.timeline(spans)).expect("it runs");
    assert_eq!(frames.len(), was.len());
    let own = model.skeleton().offsets();
    let (offsets, factor) = match plain.bones {
        Bones::Given(offsets) => (*offsets, offsets[4][1] / own[4][1]),
        _ => (own, 1.0),
    };
    assert!(metrics::bone_error(&frames, offsets) < 1e-3);
    let (mut worst, mut moved) = (0.0f64, 0.0f64);
    for (index, span) in spans.iter().enumerate() {
        let Prompt::Text(text) = span.prompt else { panic!("all are") };
        assert_eq!(usize::from(said[index]), text.split(' ').count());
        let seed = plain.planning.seed.wrapping_add((index as u64 + 1).wrapping_mul(SEED_STEP));
        let own = Request::text(text).frames(span.frames).seed(seed).unrefined();
        let (own, _) = made(model, &own).expect("it runs");
        for t in whole(span, frames.len()) {
            for (joint, carrier) in joints(span.parts) {
                let wanted = seen(&own[t - usize::from(span.first)], carrier, joint).map(|v| v * f64::from(factor));
                let (now, before) = (seen(&frames[t], carrier, joint), seen(&was[t], carrier, joint));
                let off = |a: V| dot(minus(a, wanted), minus(a, wanted)).sqrt();
                (worst, moved) = (worst.max(off(now)), moved.max(off(before)));
            }
        }
    }
    for (t, (now, before)) in frames.iter().zip(&was).enumerate() {
        let parts = spans.iter().filter(|span| (usize::from(span.first)..span.end()).contains(&t));
        let told = parts.fold(BodyParts::NONE, |parts, span| parts.and(span.parts));
        let told: Vec<usize> = joints(told).into_iter().map(|(joint, _)| joint).collect();
        for joint in (0..22).filter(|joint| !told.contains(joint)) {
            assert_eq!(now[joint], before[joint], "frame {t}, joint {joint}");
        }
    }
    (worst, moved)
}

#[test]
fn parts_do_what_they_are_told_and_all_else_stays() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let free = Request::text("a person walks forward").frames(120).seed(5).unrefined();
    let large = model.skeleton().offsets().map(|bone| bone.map(|value| 1.3 * value));
    let cases: [&[Span<'_>]; 4] = [
        &[Span::new(BodyParts::RIGHT_ARM, 20, 60, "a person waves the right hand")],
        &[
            Span::new(BodyParts::RIGHT_ARM, 0, 40, "a person throws with the right hand"),
            Span::new(BodyParts::LEFT_ARM.and(BodyParts::HEAD), 10, 33, "a person claps"),
            Span::new(BodyParts::RIGHT_ARM, 40, 80, "a person waves both hands"),
        ],
        &[Span::new(BodyParts::UPPER_BODY, 30, 50, "a person punches")],
        &[Span::new(BodyParts::LEGS, 60, 60, "a person kicks with the right leg")],
    ];
    for (case, spans) in cases.iter().enumerate() {
        let bones = if case == 1 { Bones::Given(&large) } else { Bones::Model };
        let (worst, moved) = judged(&model, &free.bones(bones), spans);
        println!("case {case}: worst {worst:.6} m, they were {moved:.3} m off");
        assert!(worst < 3e-4, "case {case}: {worst}");
        assert!(moved > 0.1, "case {case}: {moved}");
    }
}

/// Timelines of two parts and of three spans, drawn by seed: what parts, when, and what for.
#[test]
fn so_do_timelines_drawn_by_seed() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let whole =
        ["a person walks forward", "a person runs", "a person stands", "a person turns left", "a person sits down"];
    let arms =
        ["a person waves the right hand", "a person claps", "a person punches", "a person throws", "a person boxes"];
    let legs = ["a person walks", "a person kicks", "a person runs in place", "a person squats", "a person jumps"];
    let mut random = motionette::numerics::hash::Stream::new(2026);
    for case in 0..26 {
        let frames = 80 + 4 * random.below(30) as u16;
        let mut pick = |list: &[&'static str; 5]| list[random.below(5) as usize];
        let (first, second, third, base) = (pick(&arms), pick(&arms), pick(&legs), pick(&whole));
        let (a, b) = (1 + random.below(30) as u16, 31 + random.below(40) as u16);
        let upper = [BodyParts::RIGHT_ARM, BodyParts::ARMS, BodyParts::UPPER_BODY][random.below(3) as usize];
        let spans = [
            Span::new(upper, a, b - a + 8, first),
            Span::new(BodyParts::LEGS, a, frames - a, third),
            Span::new(BodyParts::LEFT_ARM.and(BodyParts::HEAD), b + 8, frames - b - 8, second),
        ];
        let count = if case < 20 { 2 } else { 3 };
        let plain = Request::text(base).frames(frames).seed(u64::from(random.next_u32())).unrefined();
        let (worst, moved) = judged(&model, &plain, &spans[..count]);
        assert!(worst < 3e-4 && moved > 0.05, "case {case}: {worst} {moved}");
    }
}

/// Nothing jumps where a span begins and ends.
#[test]
fn spans_come_and_go_smoothly() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let free = Request::text("a person stands").frames(100).seed(1);
    let span = [Span::new(BodyParts::ARMS, 30, 40, "a person raises both arms")];
    let (frames, _) = made(&model, &free.timeline(&span)).expect("it runs");
    let speed = |t: usize, joint: usize| {
        let way = minus(frames[t][joint].map(f64::from), frames[t - 1][joint].map(f64::from));
        20.0 * dot(way, way).sqrt()
    };
    let fastest = (1..100).flat_map(|t| [20, 21].map(|joint| speed(t, joint))).fold(0.0, f64::max);
    println!("hands are at most {fastest:.2} m/s fast");
    assert!(fastest < 5.0, "{fastest}");
}

/// What edits the motion sees what the parts do: a hand on a track while it is told to wave, feet that stay where they stand.
#[test]
fn anchors_and_tracks_are_met_by_what_comes_of_it() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let spans = [Span::new(BodyParts::RIGHT_ARM, 10, 60, "a person waves the right hand")];
    let path = [[0.2f32, 1.1, 0.9]; 20];
    let tracks = [Track::new(Joint::LeftWrist, 50, &path)];
    let request = Request::text("a person stands").frames(80).seed(3).timeline(&spans).tracks(&tracks);
    let (frames, _) = made(&model, &request).expect("it runs");
    for (frame, goal) in frames[50..70].iter().zip(&path) {
        let off = minus(frame[20].map(f64::from), goal.map(f64::from));
        assert!(dot(off, off).sqrt() < 0.02, "{off:?}");
    }
    let planted = Config { exact: Some(Exact { planted: true, ..Exact::DEFAULT }), ..Config::fast(0) };
    made(&model, &request.tracks(&[]).refined(planted)).expect("feet alone");
}

#[test]
fn what_is_at_fault_is_named_and_the_next_request_runs() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let mut words = vec![0u128; (1 << 20) / 16];
    let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut words)).expect("default rounding");
    let request = Request::text("a person stands").frames(80);
    let arm = Span::new(BodyParts::RIGHT_ARM, 10, 60, "a person waves");
    let timeline = |error| Err::<(), _>(Error::Timeline(error));
    for (spans, wanted) in [
        (&[arm, Span { first: 60, ..arm }][..], timeline(TimelineError::OutOfRange { index: 1, end: 120, frames: 80 })),
        (&[arm, arm], timeline(TimelineError::Overlap { first: 0, second: 1, parts: BodyParts::RIGHT_ARM })),
        (
            &[Span { prompt: Prompt::Text(" "), ..arm }],
            timeline(TimelineError::Prompt { index: 0, error: PromptError::Empty }),
        ),
        (&[Span { frames: 3, ..arm }], timeline(TimelineError::TooShort { index: 0, frames: 3 })),
        (
            &[arm, Span { prompt: Prompt::Text("zebra quagga"), parts: BodyParts::HEAD, ..arm }],
            timeline(TimelineError::Prompt { index: 1, error: PromptError::OnlyUnknownWords { words: 2 } }),
        ),
    ] {
        assert_eq!(generator.generate(&request.timeline(spans), &mut ()).map(|_| ()), wanted);
        // Whether words are known shows when they are read.
        let unread = matches!(
            wanted,
            Err(Error::Timeline(TimelineError::Prompt { error: PromptError::OnlyUnknownWords { .. }, .. }))
        );
        assert_eq!(generator.plan(&request.timeline(spans)).map(|_| ()), if unread { Ok(()) } else { wanted });
        generator.generate(&request.timeline(&[arm]), &mut ()).expect("it goes on");
    }
    // Of a length that the text says, no less than the spans.
    let long = Span { first: 100, ..arm };
    let motion = generator.generate(&Request::text("a person stands").timeline(&[long]), &mut ()).expect("it runs");
    assert!(motion.frames().len() >= long.end());
    // Tokens are no text, and yet parts of what they say may do something else; without a planner nothing can be told.
    let tokens = [1u16; 20];
    generator.generate(&Request::tokens(&tokens).timeline(&[arm]), &mut ()).expect("it runs");
    drop(generator);
    let plain = Tiny::new(Shape::default(), 3);
    let model = Model::open(plain.bytes()).expect("made here");
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut words)).expect("default rounding");
    let refused =
        generator.generate(&Request::tokens(&[1, 2, 0]).timeline(&[Span { first: 0, frames: 8, ..arm }]), &mut ());
    assert!(matches!(refused, Err(Error::Planning(_))), "{:?}", refused.map(|_| ()));
}

/// A plan for the largest timeline serves each.
#[test]
fn a_plan_by_limits_is_that_of_the_request() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let spans = [
        Span::new(BodyParts::UPPER_BODY, 0, 196, "a person waves the right hand"),
        Span::new(BodyParts::LEGS, 0, 196, "a person walks"),
    ];
    let request = Request::text("a person stands").frames(196).timeline(&spans);
    let generator = Generator::new(model.clone(), &mut []).expect("default rounding");
    let plan = generator.plan(&request).expect("it is sound");
    let alone = generator.plan(&request.timeline(&[])).expect("it is sound");
    assert_eq!(plan.timeline_bytes, (2 * 3 * 17 * 196usize).next_multiple_of(16));
    assert_eq!(plan.arena_bytes, alone.arena_bytes + plan.timeline_bytes);
    assert!(plan.planning_macs > 2 * alone.planning_macs);
    let limits = Limits {
        tokens: 49,
        anchors: 0,
        tracked: 0,
        timeline: None,
        refinement: Config::fast(0),
        planning: None,
        rows: 8,
    };
    assert!(Plan::for_request(&model, &limits).is_ok());
}
