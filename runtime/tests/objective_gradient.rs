//! `J` and its gradient against the formulas written out in `f64` and their finite differences, through a smooth
//! nonlinear map whose own gradient is checked the same way.

mod mock;

use mock::{JOINTS, Mock, Random};
use motionette::refining::terms::anchors::Distances;
use motionette::refining::{Config, MotionMap, Objective};
use motionette::request::conditions::{Anchor, Target};

/// `J` without the trust region from the definition (AnchorRoute eq. 26-28).
fn oracle(mock: &mut Mock, u: &[f64], anchors: &[Anchor], config: &Config) -> f64 {
    mock.decode(u);
    let frames = mock.frames();
    let at = |joint: usize, frame: usize| mock.joints[frame * JOINTS + joint];
    let mut total = 0.0;
    // Controlled trajectories: joint and whether its height is controlled.
    let mut controlled: Vec<(usize, bool)> = Vec::new();
    for anchor in anchors {
        let (joint, target, height) = match anchor.target {
            Target::Root(p) => (0, p, true),
            Target::PlanarRoot([x, z]) => (0, [x, 0.0, z], false),
            Target::Joint { joint, position } => (usize::from(joint), position, true),
        };
        let p = at(joint, usize::from(anchor.frame));
        for axis in 0..3 {
            if axis != 1 || height {
                total += (p[axis] - f64::from(target[axis])).powi(2);
            }
        }
        match controlled.iter_mut().find(|entry| entry.0 == joint) {
            Some(entry) => entry.1 |= height,
            None => controlled.push((joint, height)),
        }
    }
    let mut bend = 0.0;
    for &(joint, height) in &controlled {
        for t in 0..frames - 2 {
            let (a, b, c) = (at(joint, t), at(joint, t + 1), at(joint, t + 2));
            for axis in 0..3 {
                if axis != 1 || height {
                    bend += (c[axis] - 2.0 * b[axis] + a[axis]).powi(2) / (frames - 2) as f64;
                }
            }
        }
    }
    total += f64::from(config.smoothness) * bend / controlled.len() as f64;
    for t in 0..frames - 1 {
        let (a, b) = (at(0, t), at(0, t + 1));
        let length = (0..3).map(|axis| (b[axis] - a[axis]).powi(2)).sum::<f64>().sqrt();
        let excess = (length - f64::from(config.max_step)).max(0.0);
        total += f64::from(config.feasibility) * excess * excess / (frames - 1) as f64;
    }
    total
}

fn cases() -> Vec<Vec<Anchor>> {
    let wrist = |frame, joint| Anchor::joint(frame, joint, [0.4, 1.2, 0.3]);
    vec![
        vec![Anchor::root(11, [0.3, 1.0, 0.5]), Anchor::root(27, [0.1, 0.8, 1.0])],
        vec![Anchor::planar_root(0, [0.1, 0.0]), Anchor::planar_root(27, [0.6, 1.1])],
        vec![wrist(3, 20), wrist(3, 21), wrist(19, 15), wrist(27, 20)],
        vec![Anchor::planar_root(9, [0.2, 0.1]), Anchor::root(20, [0.0, 1.0, 0.2]), wrist(20, 21), wrist(9, 7)],
    ]
}

fn weights() -> Vec<Config> {
    let base = Config { smoothness: 0.0, feasibility: 0.0, trust: 0.0, ..Config::default() };
    vec![
        base,
        Config { smoothness: 30.0, ..base },
        Config { feasibility: 200.0, max_step: 0.005, ..base },
        Config { smoothness: 7.0, feasibility: 90.0, max_step: 0.01, ..base },
    ]
}

#[test]
fn value_and_gradient_match_the_definition() {
    let mut mock = Mock::new(2, 7, 5);
    let start = mock.embeddings(4);
    let wide: Vec<f64> = start.iter().map(|&v| f64::from(v)).collect();
    for anchors in cases() {
        let set = mock.set(&anchors);
        for config in weights() {
            let objective = Objective::new(&set, &config);
            assert!(mock.forward(&start).is_continue());
            let value = f64::from(objective.measure(&mock, 0.0, None).objective);
            objective.gather(&mut mock, None);
            let mut gradient = vec![0.0; start.len()];
            assert!(mock.backward(&mut gradient).is_continue());

            let expected = oracle(&mut mock, &wide, &anchors, &config);
            assert!((value - expected).abs() < 1e-5 * expected, "{value} {expected}");
            let largest = gradient.iter().fold(0.0f64, |m, g| m.max(f64::from(g.abs())));
            let mut random = Random::new(9);
            for _ in 0..40 {
                let (index, h) = (random.below(start.len()), 1e-5);
                let mut shifted = wide.clone();
                shifted[index] += h;
                let above = oracle(&mut mock, &shifted, &anchors, &config);
                shifted[index] -= 2.0 * h;
                let below = oracle(&mut mock, &shifted, &anchors, &config);
                let slope = (above - below) / (2.0 * h);
                let got = f64::from(gradient[index]);
                assert!((got - slope).abs() < 2e-4 * largest, "{index}: {got} {slope}, largest {largest}");
            }
        }
    }
}

#[test]
fn every_term_moves_the_value() {
    let mut mock = Mock::new(2, 7, 5);
    let start = mock.embeddings(4);
    let set = mock.set(&cases()[3]);
    assert!(mock.forward(&start).is_continue());
    let values: Vec<f32> =
        weights().iter().map(|config| Objective::new(&set, config).measure(&mock, 0.0, None).objective).collect();
    assert!(values[1] > 1.01 * values[0] && values[2] > 1.01 * values[0], "{values:?}");
}

#[test]
fn errors_are_distances_in_the_controlled_subspace() {
    let mut mock = Mock::new(2, 7, 5);
    let start = mock.embeddings(4);
    assert!(mock.forward(&start).is_continue());
    let [x, y, z] = mock.position(0, 12);
    let [wx, wy, wz] = mock.position(20, 5);
    let anchors = [
        Anchor::planar_root(12, [x + 0.03, z - 0.04]),
        Anchor::joint(5, 20, [wx, wy + 0.12, wz]),
        Anchor::root(20, mock.position(0, 20)),
    ];
    assert!(y > 0.0, "height is not zero, so a planar error that counted it would show");
    let set = mock.set(&anchors);
    let error = Distances::of(&set, &|joint, frame| mock.position(joint, frame)).control_error(&set);
    assert!((error.mean - (0.05 + 0.12) / 3.0).abs() < 1e-6, "{error:?}");
    assert!((error.worst - 0.12).abs() < 1e-6);
    assert_eq!(error.worst_anchor, 1);
}
