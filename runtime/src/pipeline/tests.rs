//! The seams of codec and representation, each with the smallest second implementation: the solver meets anchors through them, through
//! the same map as through the model's own.

use core::cell::Cell;
use core::ops::ControlFlow;
use std::vec;
use std::vec::Vec;

use super::decode_map::DecoderMap;
use super::observer::{Observer, Progress, Stage, Watch};
use crate::JOINTS;
use crate::channels::Channels;
use crate::codec::Decode;
use crate::memory::{ALIGNMENT, Arena};
use crate::refining::{Config, MotionMap, Objective, ProblemShape, Report, Stop, scratch_bytes, solve};
use crate::representation::humanml3d::{self, Recovery};
use crate::representation::{Features, Recover};
use crate::request::conditions::{Anchor, AnchorSet, Target};
use crate::request::joint::Joint;

const TOKENS: usize = 6;
const FRAMES_PER_TOKEN: usize = 3;
const FRAMES: usize = TOKENS * FRAMES_PER_TOKEN;

/// A token's embedding is the features of each of its frames.
struct Repeat {
    /// Features, all of them.
    features: usize,
    passes: Cell<usize>,
}

fn selected(channels: &Channels) -> impl Iterator<Item = usize> + '_ {
    channels.ranges().flat_map(|range| range.first..range.first + range.count)
}

impl Decode for Repeat {
    type Workspace<'w> = ();

    fn code_width(&self) -> usize {
        self.features
    }

    fn frames_per_token(&self) -> usize {
        FRAMES_PER_TOKEN
    }

    fn forward(
        &self,
        u: &[f32],
        channels: &Channels,
        out: &mut [f32],
        (): &mut (),
        check: crate::stop::Check<'_>,
    ) -> ControlFlow<Stop> {
        check()?;
        self.passes.set(self.passes.get() + 1);
        let frames = u.chunks(self.features).flat_map(|token| [token; FRAMES_PER_TOKEN]);
        for (out, token) in out.chunks_mut(channels.count()).zip(frames) {
            out.iter_mut().zip(selected(channels)).for_each(|(out, channel)| *out = token[channel]);
        }
        ControlFlow::Continue(())
    }

    fn backward(
        &self,
        g: &[f32],
        channels: &Channels,
        du: &mut [f32],
        (): &mut (),
        check: crate::stop::Check<'_>,
    ) -> ControlFlow<Stop> {
        check()?;
        du.fill(0.0);
        for (frame, row) in g.chunks(channels.count()).enumerate() {
            let token = frame / FRAMES_PER_TOKEN * self.features;
            row.iter().zip(selected(channels)).for_each(|(d, channel)| du[token + channel] += d);
        }
        ControlFlow::Continue(())
    }
}

/// The features are the joints' positions.
#[derive(Clone, Copy)]
struct Direct;

impl Recover for Direct {
    type Path<'w> = ();

    fn channels(&self, joints: u32) -> Channels {
        let mut channels = Channels::new();
        (0..JOINTS).filter(|joint| joints >> joint & 1 == 1).for_each(|joint| assert!(channels.push(3 * joint, 3)));
        channels
    }

    fn integrate(&self, _: Features<'_>, (): &mut ()) {}

    fn position(&self, features: Features<'_>, (): &(), joint: usize, frame: usize) -> [f32; 3] {
        let Some(column) = features.channels.position(3 * joint) else { return [0.0; 3] };
        let at = frame * features.channels.count() + column;
        [features.values[at], features.values[at + 1], features.values[at + 2]]
    }

    fn clear_gradient(&self, (): &mut ()) {}

    fn add_gradient(&self, features: Features<'_>, (): &mut (), g: &mut [f32], place: (usize, usize), d: [f32; 3]) {
        let (joint, frame) = place;
        let Some(column) = features.channels.position(3 * joint) else { return };
        let at = frame * features.channels.count() + column;
        g[at..at + 3].iter_mut().zip(d).for_each(|(g, d)| *g += d);
    }

    fn integrate_gradient(&self, _: Features<'_>, (): &(), _: &mut [f32]) {}
}

struct Solved {
    report: Report,
    /// Distance of each anchor's joint from it, metres.
    errors: Vec<f32>,
    /// Largest difference of the gradient from central differences, over the largest of its numbers.
    gradient_error: f64,
}

/// Bends a motion at rest onto `anchors` through `decoder` and `recovery`.
fn bend<R: Recover + Copy>(decoder: &Repeat, recovery: R, path: &mut R::Path<'_>, anchors: &[Anchor]) -> Solved {
    let mut set = AnchorSet::EMPTY;
    set.fill(crate::AnchorList::Frames(anchors), 20, FRAMES).unwrap();
    let config = Config { evaluations: 60, ..Config::default() };
    let objective = Objective::new(&set, &config);
    let channels = recovery.channels(objective.joints());
    let mut values = vec![0.0; FRAMES * channels.count()];
    let mut gradient = values.clone();
    let mut map = DecoderMap {
        decoder,
        recovery,
        channels: &channels,
        values: &mut values,
        gradient: &mut gradient,
        path,
        work: &mut (),
        watch: Watch { observer: &mut (), stage: Stage::Refining, evaluation: 0, evaluations: config.evaluations },
        tokens: TOKENS,
        limit: 100.0,
        in_range: true,
    };
    let mut u: Vec<f32> = (0..TOKENS * decoder.features).map(|i| 0.02 * (i as f32 * 0.7).sin()).collect();
    let gradient_error = gradient_error(&mut map, &u, anchors);
    let shape = ProblemShape { tokens: TOKENS, width: decoder.features, anchors: set.len() };
    let mut scratch = vec![0u8; scratch_bytes(shape, &config) + ALIGNMENT];
    let report = solve(&mut map, &mut u, &objective, &config, Arena::new(&mut scratch)).unwrap();
    assert!(map.forward(&u).is_continue());
    let distance = |anchor: &Anchor| {
        let (joint, wanted) = wanted(anchor);
        let at = map.position(joint, usize::from(anchor.frame));
        at.iter().zip(wanted).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
    };
    Solved { report, errors: anchors.iter().map(distance).collect(), gradient_error }
}

/// The joint of an anchor and where it is to be.
fn wanted(anchor: &Anchor) -> (u8, [f32; 3]) {
    match anchor.target {
        Target::Root(position) => (0, position),
        Target::PlanarRoot([x, z]) => (0, [x, f32::NAN, z]),
        Target::Joint { joint, position } => (joint, position),
    }
}

/// The gradient of the sum of `c . position` over the anchors' joints, beside central differences.
fn gradient_error(map: &mut impl MotionMap, u: &[f32], anchors: &[Anchor]) -> f64 {
    let weights = [0.3f32, -0.7, 0.5];
    let places: Vec<(u8, usize)> = anchors.iter().map(|a| (wanted(a).0, usize::from(a.frame))).collect();
    let value = |u: &[f32], map: &mut dyn FnMut(&[f32]) -> Vec<[f32; 3]>| -> f64 {
        let dot = |p: &[f32; 3]| p.iter().zip(weights).map(|(p, w)| f64::from(*p) * f64::from(w)).sum::<f64>();
        map(u).iter().map(dot).sum()
    };
    let mut du = vec![0.0; u.len()];
    assert!(map.forward(u).is_continue());
    map.clear_gradient();
    places.iter().for_each(|&(joint, frame)| map.add_gradient(joint, frame, weights));
    assert!(map.backward(&mut du).is_continue());
    let mut positions = |u: &[f32]| {
        assert!(map.forward(u).is_continue());
        places.iter().map(|&(joint, frame)| map.position(joint, frame)).collect::<Vec<_>>()
    };
    let step = 1e-2f32;
    let (mut worst, mut largest) = (0.0f64, 0.0f64);
    for i in 0..u.len() {
        let mut shifted = u.to_vec();
        shifted[i] = u[i] + step;
        let above = value(&shifted, &mut positions);
        shifted[i] = u[i] - step;
        let below = value(&shifted, &mut positions);
        worst = worst.max(((above - below) / (2.0 * f64::from(step)) - f64::from(du[i])).abs());
        largest = largest.max(f64::from(du[i]).abs());
    }
    worst / largest
}

fn anchors() -> [Anchor; 2] {
    [Anchor::joint(7, Joint::RightWrist.index() as u8, [0.3, 1.2, 0.5]), Anchor::root(16, [0.4, 0.9, 0.2])]
}

fn met(solved: &Solved) {
    let Solved { report, errors, gradient_error } = solved;
    assert!(report.before.unwrap().mean > 0.3, "{report:?}");
    assert!(errors.iter().all(|&error| error < 0.02), "{errors:?} {report:?}");
    assert!(*gradient_error < 2e-3, "{gradient_error}");
}

#[test]
fn another_codec_and_another_representation_meet_anchors() {
    let decoder = Repeat { features: 3 * JOINTS, passes: Cell::new(0) };
    let solved = bend(&decoder, Direct, &mut (), &anchors());
    met(&solved);
    assert!(decoder.passes.get() > usize::from(solved.report.evaluations), "{}", decoder.passes.get());
}

#[test]
fn another_codec_makes_humanml3ds_features() {
    let decoder = Repeat { features: humanml3d::FEATURES, passes: Cell::new(0) };
    let (mean, std) = (vec![0.0; humanml3d::FEATURES], vec![1.0; humanml3d::FEATURES]);
    let mut memory = vec![0u8; 7 * 4 * (FRAMES + 4) + 64];
    let mut path = humanml3d::Path::take(&mut Arena::new(&mut memory), FRAMES, true).unwrap();
    met(&bend(&decoder, Recovery { mean: &mean, std: &std }, &mut path, &anchors()));
}

#[test]
fn an_observer_stops_another_codec() {
    struct After(u16);
    impl Observer for After {
        fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
            if progress.evaluation > self.0 { ControlFlow::Break(Stop::Abort) } else { ControlFlow::Continue(()) }
        }
    }
    let decoder = Repeat { features: 3 * JOINTS, passes: Cell::new(0) };
    let channels = Direct.channels(1);
    let (mut values, mut gradient) = (vec![0.0; 3 * FRAMES], vec![0.0; 3 * FRAMES]);
    let mut observer = After(2);
    let mut map = DecoderMap {
        decoder: &decoder,
        recovery: Direct,
        channels: &channels,
        values: &mut values,
        gradient: &mut gradient,
        path: &mut (),
        work: &mut (),
        watch: Watch { observer: &mut observer, stage: Stage::Refining, evaluation: 0, evaluations: 9 },
        tokens: TOKENS,
        limit: 1.0,
        in_range: true,
    };
    let u = vec![0.5; TOKENS * decoder.features];
    assert!(map.forward(&u).is_continue() && map.forward(&u).is_continue());
    assert_eq!(map.forward(&u), ControlFlow::Break(Stop::Abort));
    assert_eq!(decoder.passes.get(), 2);
}
