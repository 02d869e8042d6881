//! Refinement on models of other shapes than the shipped one: any number of frames a token, any length that a model allows, any
//! frame rate.

use motionette::refining::{Config, Report};
use motionette::{Anchor, Anchors, Error, Generator, Joint, Model, Request};
use motionette_host::reference::bridge::reference_anchor;
use motionette_host::reference::interval_basis::{Basis, IntervalBasis};
use motionette_tests::fuzz;
use motionette_tests::tiny::{Shape, Tiny};

/// What a request gave.
struct Made {
    u: Vec<f32>,
    hash: u64,
    refinement: Option<Report>,
}

fn made(model: &Model<'_>, request: &Request<'_>) -> Result<Made, Error> {
    let plan = Generator::new(model.clone(), &mut [])?.plan(request)?;
    let mut arena = vec![0u128; plan.arena_bytes / 16 + 1];
    let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut arena))?;
    let motion = generator.generate(request, &mut ())?;
    Ok(Made { u: motion.u().to_vec(), hash: motion.hash(), refinement: motion.refinement })
}

fn tokens(model: &Model<'_>, count: usize) -> Vec<u16> {
    let codes = model.codebooks().codes();
    (0..count * model.codebooks().quantizers()).map(|i| (i * 7 % codes) as u16).collect()
}

/// A correction of the published method is an affine function of time in every interval. The reference cuts the intervals anew.
#[test]
fn corrections_are_affine_in_the_reference_s_intervals_whatever_a_token_s_frames() {
    let corpus = fuzz::corpus();
    for (name, stages) in [("one-stage", 1), ("narrow", 2), ("three-stages", 3)] {
        let (_, tiny) = corpus.iter().find(|(other, _)| *other == name).expect(name);
        let model = Model::open(tiny.bytes()).expect("it opens");
        let (frames_per_token, count) = (model.frames_per_token(), 24);
        assert_eq!(frames_per_token, 1 << stages);
        let end = (count * frames_per_token - 1) as u16;
        let anchors = [
            Anchor::root(end / 4 + 1, [0.3, 0.9, 0.2]),
            Anchor::joint(2 * end / 3, 20, [0.2, 1.2, 0.4]),
            Anchor::planar_root(end - 3, [0.1, 0.5]),
        ];
        let tokens = tokens(&model, count);
        let plain = Request::tokens(&tokens);
        let start = made(&model, &plain).expect("a motion");
        let bent = made(&model, &plain.through(&anchors).refined(Config::published(6))).expect("a motion");

        let moved: Vec<f64> = bent.u.iter().zip(&start.u).map(|(a, b)| f64::from(a - b)).collect();
        let mut projected = moved.clone();
        let given: Vec<_> = anchors.iter().map(reference_anchor).collect();
        let basis = IntervalBasis::new(&given, count, frames_per_token, Basis::Affine);
        assert!(basis.intervals.len() >= 3 && !basis.direct, "{name}");
        basis.project(&mut projected, model.decoder().code_width(), 0.0, &vec![1.0; basis.intervals.len()]);
        let size = moved.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let off = moved.iter().zip(&projected).fold(0.0f64, |most, (a, b)| most.max((a - b).abs()));
        assert!(size > 1e-3, "{name}: nothing moved");
        assert!(off < 2e-3 * size, "{name}: {off} of {size} is outside the intervals' span");
    }
}

#[test]
fn whatever_a_model_plans_it_refines() {
    let tiny = Tiny::new(Shape { max_tokens: 256, ..Shape::default() }, 3);
    let model = Model::open(tiny.bytes()).expect("it opens");
    for count in [49, 50, 256] {
        let end = (count * model.frames_per_token() - 1) as u16;
        let anchors = [Anchor::root(end / 2, [0.3, 0.9, 0.2]), Anchor::joint(end, 20, [0.2, 1.2, 0.4])];
        let tokens = tokens(&model, count);
        for config in [Config::fast(3), Config::published(2)] {
            let request = Request::tokens(&tokens).through(&anchors).refined(config);
            let made = made(&model, &request).unwrap_or_else(|e| panic!("{count} tokens: {e}"));
            assert!(made.refinement.is_some_and(|report| report.evaluations > 0), "{count} tokens");
        }
    }
}

/// Seconds become frames of the model that makes the motion.
#[test]
fn anchors_in_seconds_are_at_the_model_s_frames() {
    for frame_rate in [20, 30] {
        let tiny = Tiny::new(Shape { frame_rate, ..Shape::default() }, 3);
        let model = Model::open(tiny.bytes()).expect("it opens");
        let tokens = tokens(&model, 16);
        let timed = Anchors::new().root_at(1.1, [0.3, 0.9, 0.2]).joint_at(2.1, Joint::RightWrist, [0.2, 1.2, 0.4]);
        let frame = |seconds: f64| (seconds * f64::from(frame_rate)).round() as u16;
        let framed = [Anchor::root(frame(1.1), [0.3, 0.9, 0.2]), Anchor::joint(frame(2.1), 21, [0.2, 1.2, 0.4])];
        assert_eq!(timed.by_frame(model.frame_rate()).as_deref(), Ok(&framed[..]));
        let request = Request::tokens(&tokens);
        let by_time = made(&model, &request.through(&timed)).expect("a motion");
        let by_frame = made(&model, &request.through(&framed)).expect("a motion");
        assert_eq!((by_time.hash, by_time.refinement), (by_frame.hash, by_frame.refinement));
        assert_ne!(by_time.hash, made(&model, &request).expect("a motion").hash);
        // 2.1 s are inside 64 frames at either rate, 3.1 s at 20 only.
        let late = Anchors::new().root_at(3.1, [0.3, 0.9, 0.2]);
        assert_eq!(made(&model, &request.through(&late)).is_ok(), frame_rate == 20);
        let never = Anchors::new().root_at(-1.0, [0.3, 0.9, 0.2]);
        assert!(matches!(made(&model, &request.through(&never)), Err(Error::Anchors(_))));
    }
}

/// Equal anchors count once, in the plan as in the motion, and the plan refuses what the motion would.
#[test]
fn duplicates_take_no_memory_and_plans_check_anchors() {
    let tiny = Tiny::new(Shape::default(), 3);
    let model = Model::open(tiny.bytes()).expect("it opens");
    let tokens = tokens(&model, 16);
    let anchor = Anchor::root(40, [0.3, 0.9, 0.2]);
    let request = Request::tokens(&tokens);
    let plan = |anchors: &[Anchor]| {
        Generator::new(model.clone(), &mut []).expect("default floating point").plan(&request.through(anchors))
    };
    let many = vec![anchor; 100_000];
    let once = plan(&[anchor]).expect("a plan");
    assert_eq!(plan(&many).expect("a plan"), once);
    assert_ne!(plan(&[anchor, Anchor::root(41, [0.3, 0.9, 0.2])]).expect("a plan"), once);
    let (one, all) = ([anchor], made(&model, &request.through(&many)).expect("a motion"));
    assert_eq!(made(&model, &request.through(&one)).expect("a motion").hash, all.hash);
    for bad in [Anchor::root(40, [0.3, 0.9, 0.3]), Anchor::root(64, [0.0; 3]), Anchor::joint(1, 22, [0.0; 3])] {
        assert!(matches!(plan(&[anchor, bad]), Err(Error::Anchors(_))), "{bad:?}");
    }
}
