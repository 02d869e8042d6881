//! Two independent RouteSolvers, the runtime's and the reference's, on the same weights and anchors.
//!
//! The reference runs with the blob's own (dequantised) weights in f64, so that what is left between the two is the runtime's int16
//! activations and f32 arithmetic. As both are chaotic in the long run (Adam divides by gradients), short runs are compared step for
//! step and long ones by what they reach.

use std::path::{Path, PathBuf};

use motionette::refining::{Basis as RuntimeBasis, Config, PerFamily};
use motionette::{Bones, Request};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::{self, TokenizerCheckpoint};
use motionette_host::convert::{self, CardText, Options};
use motionette_host::reference::bridge::runtime_anchor;
use motionette_host::reference::interval_basis::Basis;
use motionette_host::reference::objective::{Objective, Weights};
use motionette_host::reference::route_solver::{self, Settings};
use motionette_host::reference::{Anchor, DecodePath, Target, anchors, quasi_newton};
use motionette_host::verify;

struct Bench {
    blob: BlobFile,
    decode_path: DecodePath<f64>,
    tokens: Vec<u16>,
    anchors: Vec<Anchor>,
    u0: Vec<f64>,
}

/// The published RVQ decoder, a token sequence, and anchors of every family 10 cm beside its motion.
fn bench() -> Option<Bench> {
    let shared = std::env::var_os("MOTIONETTE_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let path = shared.join("published/rvq.safetensors");
    if !path.is_file() {
        eprintln!("skipped: ../shared/published not found");
        return None;
    }
    let checkpoint = checkpoint::load(&path).unwrap_or_else(|e| panic!("{e}"));
    let conversion =
        convert::convert(&checkpoint, &Options::PLAIN, &[], &CardText::default(), |_| ()).expect("a conversion");
    let blob = BlobFile::new(conversion.blob, &path).expect("accepted");
    let decoder = blob.dequantised(&checkpoint.decoder).expect("whole");
    let decode_path = DecodePath::new(&TokenizerCheckpoint { decoder, ..checkpoint }).expect("statistics");
    let tokens: Vec<u16> = (0..20 * 3).map(|i| (i * 29 % 64) as u16).collect();
    let plain =
        verify::run(&blob, "bench", &Request::tokens(&tokens).bones(Bones::Decoded).unrefined()).expect("a motion");
    let beside = |frame: usize, joint: usize, by: [f64; 3]| -> [f64; 3] {
        let p = plain.joints[frame][joint];
        [0, 1, 2].map(|c| f64::from((f64::from(p[c]) + by[c]) as f32))
    };
    let [x, _, z] = beside(40, 0, [0.08, 0.0, -0.06]);
    let anchors = vec![
        Anchor { frame: 22, target: Target::Root(beside(22, 0, [0.06, 0.0, 0.08])) },
        Anchor { frame: 40, target: Target::PlanarRoot([f64::from(x as f32), f64::from(z as f32)]) },
        Anchor { frame: 63, target: Target::Joint { joint: 20, position: beside(63, 20, [0.0, 0.1, 0.0]) } },
        Anchor { frame: 63, target: Target::Joint { joint: 15, position: beside(63, 15, [-0.1, 0.0, 0.0]) } },
    ];
    let u0 = plain.u.iter().map(|&v| f64::from(v)).collect();
    Some(Bench { blob, decode_path, tokens, anchors, u0 })
}

const WEIGHTS: Weights = Weights { smoothness: 0.5, trust: 1e-3, feasibility: 0.3, max_step: 0.02 };

fn config(steps: u16, basis: RuntimeBasis) -> Config {
    Config {
        smoothness: WEIGHTS.smoothness as f32,
        trust: WEIGHTS.trust as f32,
        feasibility: WEIGHTS.feasibility as f32,
        max_step: WEIGHTS.max_step as f32,
        ridge: 1.5,
        tolerance: PerFamily { root_3d: 0.2, planar_root: 0.05, body_point: 0.15 },
        learning_rate: PerFamily::all(0.01),
        basis,
        ..Config::published(steps)
    }
}

fn settings(steps: usize, basis: Basis) -> Settings {
    Settings { steps, learning_rate: 0.01, ridge: 1.5, tolerance: [0.2, 0.05, 0.15], basis, weights: WEIGHTS }
}

fn length(v: impl Iterator<Item = f64>) -> f64 {
    v.map(|x| x * x).sum::<f64>().sqrt()
}

#[test]
fn objective_is_the_same() {
    let Some(b) = bench() else { return };
    let given: Vec<_> = b.anchors.iter().map(runtime_anchor).collect();
    let request = Request::tokens(&b.tokens).through(&given).refined(config(3, RuntimeBasis::Affine));
    let bent = verify::run(&b.blob, "bench", &request.bones(Bones::Decoded)).expect("a motion");
    let report = bent.refinement.expect("anchors");
    let objective = Objective::new(&b.decode_path, &b.anchors, WEIGHTS, &b.u0);
    let after: Vec<f64> = bent.u.iter().map(|&v| f64::from(v)).collect();
    for (name, runtime, u) in [("before", report.objective_before, &b.u0), ("after", report.objective_after, &after)] {
        let exact = objective.value(u).0;
        let share = (f64::from(runtime) - exact).abs() / exact;
        eprintln!("J {name}: runtime {runtime}, reference {exact}");
        assert!(share < 2e-3, "J {name}: runtime {runtime}, reference {exact}");
    }
    assert!(report.objective_after < report.objective_before);
}

#[test]
fn published_method_takes_the_same_steps_in_every_basis() {
    let Some(b) = bench() else { return };
    let given: Vec<_> = b.anchors.iter().map(runtime_anchor).collect();
    for (runtime, reference) in [
        (RuntimeBasis::Affine, Basis::Affine),
        (RuntimeBasis::Transport, Basis::Transport),
        (RuntimeBasis::Slope, Basis::Slope),
        (RuntimeBasis::Quadratic, Basis::Quadratic),
        (RuntimeBasis::Cubic, Basis::Cubic),
        (RuntimeBasis::Plain, Basis::Plain),
    ] {
        let request = Request::tokens(&b.tokens).through(&given).refined(config(8, runtime));
        let bent = verify::run(&b.blob, "bench", &request.bones(Bones::Decoded)).expect("a motion");
        let own = route_solver::solve(&b.decode_path, &b.anchors, &b.u0, &settings(8, reference));
        let moved = length(own.u.iter().zip(&b.u0).map(|(a, b)| a - b));
        let apart = length(own.u.iter().zip(&bent.u).map(|(a, &b)| a - f64::from(b)));
        eprintln!("{reference:?}: moved {moved:.4}, {:.2} % of it apart", 100.0 * apart / moved);
        assert!(moved > 0.01, "{reference:?}: nothing moved");
        assert!(apart < 0.1 * moved, "{reference:?}: {apart} apart after moving {moved}");
    }
}

#[test]
fn long_runs_reach_the_same_control_error() {
    let Some(b) = bench() else { return };
    let given: Vec<_> = b.anchors.iter().map(runtime_anchor).collect();
    let request = Request::tokens(&b.tokens).through(&given).refined(config(120, RuntimeBasis::Affine));
    let bent = verify::run(&b.blob, "bench", &request.bones(Bones::Decoded)).expect("a motion");
    let own = route_solver::solve(&b.decode_path, &b.anchors, &b.u0, &settings(120, Basis::Affine));
    let reached = anchors::control_error(&b.anchors, &bent.joints);
    eprintln!("before {:.4} m, runtime {reached:.4} m, reference {:.4} m", own.error_before, own.error_after);
    assert!(own.error_after < 0.8 * own.error_before);
    assert!((reached - own.error_after).abs() < 0.02 * own.error_before);
}

#[test]
fn quasi_newton_beats_the_published_method_at_equal_cost() {
    let Some(b) = bench() else { return };
    let adam = route_solver::solve(&b.decode_path, &b.anchors, &b.u0, &settings(24, Basis::Affine));
    let newton = quasi_newton::solve(&b.decode_path, &b.anchors, &b.u0, &settings(0, Basis::Affine), 25);
    assert_eq!(adam.evaluations, 25);
    assert!(newton.evaluations <= 25 && newton.gradients <= newton.evaluations);
    eprintln!("J: quasi-Newton {:.5}, published {:.5}", newton.objective, adam.objective);
    assert!(newton.objective < adam.objective);
}
