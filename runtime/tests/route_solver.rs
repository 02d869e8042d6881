//! RouteSolver as published, its ablations and the fast default on a smooth nonlinear decoder.
// Oracles run on the host only, where it does not matter how zeros are signed.
#![allow(clippy::disallowed_methods)]

mod mock;

use mock::{Mock, Random, Scratch};
use motionette::memory::{ALIGNMENT, Arena, ArenaTooSmall};
use motionette::refining::activity::{Random as Shuffler, activities};
use motionette::refining::basis::{IntervalBasis, MAX_INTERVALS, values_len};
use motionette::refining::terms::Point;
use motionette::refining::terms::anchors::Distances;
use motionette::refining::terms::feasibility::Feasibility;
use motionette::refining::terms::smoothness::Smoothness;
use motionette::refining::{
    Activity, Basis, Config, MotionMap, Objective, PerFamily, ProblemShape, Report, SolverError, StopReason, TokenGrid,
    scratch_bytes, solve,
};
use motionette::request::conditions::{Anchor, AnchorSet};

const TOKENS: usize = 25;
const WIDTH: usize = 16;
const GRID: TokenGrid = TokenGrid { tokens: TOKENS, frames_per_token: 4 };

/// Places of anchors spread over the motion: root, planar root, body points, or a mixture with several at one frame.
fn places(kind: usize, count: usize, seed: u64) -> (Vec<(u16, Option<u8>)>, bool) {
    let mut random = Random::new(seed);
    let mut list: Vec<(u16, Option<u8>)> = (0..count)
        .map(|i| {
            let frame = ((i + 1) * (4 * TOKENS - 4) / count + random.below(3)) as u16;
            let joint = if kind < 2 { None } else { Some([20, 21, 15, 7][random.below(4)]) };
            (frame, joint)
        })
        .collect();
    if kind == 3 {
        let frame = list[0].0;
        list.push((frame, None));
        list.push((frame, Some(3)));
    }
    (list, kind == 1)
}

/// Of bytes that nobody has written.
const PAINT: u8 = 0xA5;

fn problem(kind: usize, count: usize, seed: u64) -> (Mock, Vec<f32>, AnchorSet) {
    let mut mock = Mock::new(7, TOKENS, WIDTH);
    let (places, planar) = places(kind, count, seed);
    let (u, anchors) = mock.problem(seed, &places, planar);
    let set = mock.set(&anchors);
    (mock, u, set)
}

fn distances_of(mock: &Mock, set: &AnchorSet) -> Distances {
    Distances::of(set, &|joint, frame| mock.position(joint, frame))
}

fn run(mock: &mut Mock, u: &mut [f32], set: &AnchorSet, config: &Config) -> Report {
    mock::run(mock, u, set, config).expect("solves")
}

/// Mean control error before and after over some problems, metres.
fn average(config: &Config, kind: usize) -> (f32, f32) {
    let (mut before, mut after) = (0.0, 0.0);
    for seed in 1..=4 {
        let (mut mock, mut u, set) = problem(kind, 6, seed);
        let report = run(&mut mock, &mut u, &set, config);
        before += report.before.unwrap().mean / 4.0;
        after += report.after.unwrap().mean / 4.0;
    }
    (before, after)
}

#[test]
fn published_method_reduces_the_error_in_every_family() {
    for kind in 0..4 {
        let (before, after) = average(&Config::published(100), kind);
        assert!(before > 0.2 && after < 0.1 * before, "kind {kind}: {before} -> {after}");
    }
}

#[test]
fn fast_default_needs_far_fewer_evaluations_than_rs200() {
    for kind in 0..4 {
        for seed in 1..=3 {
            let (mut mock, mut u, set) = problem(kind, 6, seed);
            let published = run(&mut mock, &mut u, &set, &Config::published(200));
            let (mut mock, mut u, set) = problem(kind, 6, seed);
            let fast = run(&mut mock, &mut u, &set, &Config { stop_error: 0.01, ..Config::fast(80) });
            assert_eq!(fast.reason, StopReason::Tolerance, "kind {kind}, seed {seed}: {fast:?}");
            assert!(fast.after.unwrap().worst <= 0.01);
            // Evaluations that the published method takes to the same error.
            let (mut mock, mut u, set) = problem(kind, 6, seed);
            let same = run(&mut mock, &mut u, &set, &Config { stop_error: 0.01, ..Config::published(400) });
            assert!(
                2 * fast.evaluations < same.evaluations,
                "kind {kind}, seed {seed}: {} against {}, RS200 {published:?}",
                fast.evaluations,
                same.evaluations
            );
        }
    }
}

#[test]
fn the_report_describes_the_result() {
    for config in [Config::fast(25), Config::published(30), Config { basis: Basis::Plain, ..Config::published(30) }] {
        let (mut mock, mut u, set) = problem(3, 6, 5);
        let start = u.clone();
        let report = run(&mut mock, &mut u, &set, &config);
        assert_eq!(usize::from(report.evaluations), mock.forwards);
        assert_eq!(usize::from(report.gradients), mock.backwards);
        assert_eq!(report.current, mock.seen.last() == Some(&u));
        let squared: f32 = u.iter().zip(&start).map(|(a, b)| (a - b) * (a - b)).sum();
        assert!((report.distance - squared.sqrt()).abs() < 1e-4 * report.distance);
        // Best of everything that was evaluated, by the objective.
        let objective = Objective::new(&set, &config);
        let mut lowest = f32::INFINITY;
        for seen in mock.seen.clone() {
            assert!(mock.forward(&seen).is_continue());
            let squared: f32 = seen.iter().zip(&start).map(|(a, b)| (a - b) * (a - b)).sum();
            lowest = lowest.min(objective.measure(&mock, squared, None).objective);
        }
        assert!(mock.forward(&u).is_continue());
        let Point { objective: value, distances, .. } = objective.measure(&mock, squared, None);
        assert!((value - lowest).abs() <= 1e-5 * lowest, "{value} {lowest}");
        assert!((report.objective_after - lowest).abs() <= 1e-5 * lowest);
        assert_eq!(report.after, Some(distances.control_error(&set)));
        assert!(mock.forward(&start).is_continue());
        assert_eq!(report.before, Some(distances_of(&mock, &set).control_error(&set)));
    }
}

#[test]
fn one_published_step_is_the_projected_adam_step() {
    // After one step Adam moves every number by rate * g / (|g| + eps); then the projection.
    let config = Config { trust: 0.0, smoothness: 0.0, ..Config::published(1) };
    let (mut mock, start, set) = problem(0, 4, 2);
    assert!(mock.forward(&start).is_continue());
    let distances = distances_of(&mock, &set);
    Objective::new(&set, &config).gather(&mut mock, None);
    let mut delta = vec![0.0; start.len()];
    assert!(mock.backward(&mut delta).is_continue());
    for g in &mut delta {
        *g = -config.learning_rate.root_3d * *g / (g.abs() + 1e-8);
    }
    let mut values = vec![0.0; values_len(TOKENS, Basis::Affine)];
    let basis = IntervalBasis::new(&set, GRID, Basis::Affine, &mut values);
    let activity = activities(Activity::Residual, &basis, &set, &distances, &config.tolerance, &mut Shuffler::new(0));
    basis.project(&mut delta, WIDTH, &activity, config.ridge);

    let mut u = start.clone();
    mock.seen.clear();
    run(&mut mock, &mut u, &set, &config);
    assert_eq!(mock.seen.len(), 2);
    for ((got, x0), d) in mock.seen[1].iter().zip(&start).zip(&delta) {
        assert!((got - (x0 + d)).abs() < 1e-5, "{got} {x0} {d}");
    }
}

#[test]
fn corrections_stay_in_the_span_of_the_basis() {
    let (mut mock, mut u, set) = problem(0, 4, 3);
    let start = u.clone();
    for (basis, inside) in [(Basis::Affine, true), (Basis::Transport, true), (Basis::Plain, false)] {
        u.copy_from_slice(&start);
        run(&mut mock, &mut u, &set, &Config { basis, ..Config::published(20) });
        let moved: Vec<f32> = u.iter().zip(&start).map(|(a, b)| a - b).collect();
        let shape = if basis == Basis::Plain { Basis::Affine } else { basis };
        let mut values = vec![0.0; values_len(TOKENS, shape)];
        let routed = IntervalBasis::new(&set, GRID, shape, &mut values);
        let mut projected = moved.clone();
        routed.project(&mut projected, WIDTH, &[1.0; MAX_INTERVALS], 0.0);
        let off = moved.iter().zip(&projected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let size = moved.iter().fold(0.0, |m: f32, v| m.max(v.abs()));
        assert_eq!(off < 1e-3 * size, inside, "{basis:?}: {off} of {size}");
    }
}

#[test]
fn ablations_rank_by_freedom() {
    let error = |basis| average(&Config { basis, ..Config::published(60) }, 2).1;
    let (slope, transport, affine) = (error(Basis::Slope), error(Basis::Transport), error(Basis::Affine));
    let (quadratic, cubic, plain) = (error(Basis::Quadratic), error(Basis::Cubic), error(Basis::Plain));
    assert!(slope > affine && transport > affine, "slope {slope}, transport {transport}, affine {affine}");
    assert!(plain < affine, "plain {plain}, affine {affine}");
    assert!(quadratic < slope && cubic < slope, "quadratic {quadratic}, cubic {cubic}");
}

#[test]
fn activity_kinds_do_what_they_say() {
    let (mut mock, u, set) = problem(2, 8, 4);
    assert!(mock.forward(&u).is_continue());
    let distances = distances_of(&mock, &set);
    let mut values = vec![0.0; values_len(TOKENS, Basis::Affine)];
    let basis = IntervalBasis::new(&set, GRID, Basis::Affine, &mut values);
    let count = basis.intervals().len();
    let rho = 2.0;
    let mut random = Shuffler::new(5);
    let mut get = |kind| activities(kind, &basis, &set, &distances, &PerFamily::all(rho), &mut random);

    let residual = get(Activity::Residual);
    for (interval, &activity) in basis.intervals().iter().zip(&residual) {
        let error_at = |frame: u16| {
            let here = set.iter().zip(distances.errors).filter(|(anchor, _)| anchor.frame == frame);
            here.map(|(_, error)| error).fold(0.0, f32::max)
        };
        let expected = (error_at(interval.left).max(error_at(interval.right)) / rho).min(1.0);
        assert!((activity - expected).abs() < 1e-6, "{interval:?}");
    }
    assert_eq!(get(Activity::Uniform)[..count], vec![1.0; count]);

    let mut sorted = residual[..count].to_vec();
    sorted.sort_by(f32::total_cmp);
    let orders: Vec<Vec<f32>> = (0..20).map(|_| get(Activity::Shuffled)[..count].to_vec()).collect();
    for order in &orders {
        let mut again = order.clone();
        again.sort_by(f32::total_cmp);
        assert_eq!(again, sorted, "a permutation");
    }
    let distinct = orders.iter().filter(|order| **order != orders[0]).count();
    assert!(distinct > 15, "refreshed at every step: {distinct}");

    // Another family's tolerance counts for that family only.
    let tight = PerFamily { root_3d: 1e-6, planar_root: 1e-6, body_point: rho };
    assert_eq!(activities(Activity::Residual, &basis, &set, &distances, &tight, &mut random), residual);
}

#[test]
fn seeds_decide_the_shuffle_and_nothing_else_is_random() {
    let solve_with = |activity, seed| {
        let (mut mock, mut u, set) = problem(2, 6, 4);
        run(
            &mut mock,
            &mut u,
            &set,
            &Config { activity, seed, tolerance: PerFamily::all(2.0), ..Config::published(12) },
        );
        u
    };
    assert_eq!(solve_with(Activity::Shuffled, 3), solve_with(Activity::Shuffled, 3));
    assert_ne!(solve_with(Activity::Shuffled, 3), solve_with(Activity::Shuffled, 4));
    assert_eq!(solve_with(Activity::Residual, 3), solve_with(Activity::Residual, 4));
    assert_ne!(solve_with(Activity::Residual, 3), solve_with(Activity::Uniform, 3));
}

#[test]
fn terms_trade_control_for_quality() {
    let solve_with = |config: Config| {
        let (mut mock, mut u, set) = problem(0, 6, 6);
        let report = run(&mut mock, &mut u, &set, &config);
        assert!(mock.forward(&u).is_continue());
        (report, Smoothness::new(&set, 1.0).value(&mock), Feasibility::new(1.0, 0.03).value(&mock))
    };
    for base in [Config::fast(40), Config::published(60)] {
        let plain = Config { smoothness: 0.0, trust: 0.0, feasibility: 0.0, stop_error: 0.0, ..base };
        let (free, bends, steps) = solve_with(plain);
        let (near, ..) = solve_with(Config { trust: 0.05, ..plain });
        assert!(near.distance < 0.8 * free.distance, "{near:?} {free:?}");
        let (_, smooth, _) = solve_with(Config { smoothness: 3e4, ..plain });
        assert!(smooth < 0.8 * bends, "{smooth} {bends}");
        let (.., slow) = solve_with(Config { feasibility: 1e4, max_step: 0.03, ..plain });
        assert!(slow < 0.8 * steps, "{slow} {steps}");
    }
}

#[test]
fn unreachable_anchors_are_approached_and_reported() {
    for base in [Config::fast(30), Config::published(30)] {
        for target in [[10.0, 0.9, 0.0], [-900.0, 900.0, 900.0]] {
            let (mut mock, mut u, _) = problem(0, 1, 1);
            // Ten metres away in one frame.
            let set = mock.set(&[Anchor::root(50, [0.0, 0.9, 0.5]), Anchor::root(51, target)]);
            let report = run(&mut mock, &mut u, &set, &base);
            let (before, after) = (report.before.unwrap(), report.after.unwrap());
            assert!(report.objective_after < report.objective_before, "{report:?}");
            assert!(after.worst > 1.0 && before.worst.is_finite() && after.mean.is_finite(), "{report:?}");
            assert_eq!(after.worst_anchor, 1);
            assert!(u.iter().all(|v| v.is_finite()));
        }
    }
}

/// A strong trust region makes points near the anchors worse by `J` than where the solve began.
#[test]
fn tolerance_is_that_of_the_result() {
    let (mut met, mut seen) = (0, 0);
    for base in [Config::fast(30), Config::published(60)] {
        for trust in [0.0, 1e-3, 1e-2, 0.03, 0.1, 0.3, 1.0] {
            for stop_error in [0.02, 0.1, 0.2] {
                let (mut mock, mut u, set) = problem(0, 2, 5);
                let report = run(&mut mock, &mut u, &set, &Config { trust, stop_error, ..base });
                let worst = report.after.unwrap().worst;
                assert_eq!(report.reason == StopReason::Tolerance, worst <= stop_error, "{trust}: {report:?}");
                met += usize::from(worst <= stop_error);
                let evaluated = mock.seen.clone();
                seen += usize::from(evaluated.iter().any(|u| {
                    assert!(mock.forward(u).is_continue());
                    worst > stop_error && distances_of(&mock, &set).control_error(&set).worst <= stop_error
                }));
            }
        }
    }
    assert!(met > 5 && seen > 1, "{met} met, {seen} met at another point than the result");
}

#[test]
fn met_anchors_cost_one_evaluation() {
    let (mut mock, mut u, _) = problem(0, 1, 1);
    assert!(mock.forward(&u).is_continue());
    let set = mock.set(&[Anchor::root(50, mock.position(0, 50))]);
    mock.forwards = 0;
    let start = u.clone();
    let report = run(&mut mock, &mut u, &set, &Config::fast(20));
    assert_eq!((report.evaluations, report.gradients, report.reason), (1, 0, StopReason::Tolerance));
    assert_eq!(u, start);
    assert!(report.current);
}

#[test]
fn without_anchors_nothing_is_done() {
    let (mut mock, mut u, _) = problem(0, 1, 1);
    let start = u.clone();
    let report = run(&mut mock, &mut u, &AnchorSet::EMPTY, &Config::fast(20));
    assert_eq!((report.evaluations, report.reason, report.before), (0, StopReason::NoAnchors, None));
    assert!(!report.current);
    assert_eq!(u, start);
}

#[test]
fn scratch_is_exact_and_checked() {
    for (tokens, width, count) in [(1, 3, 1), (5, 4, 2), (25, 8, 8), (49, 4, 32)] {
        for config in [
            Config::fast(6),
            Config::published(3),
            Config { basis: Basis::Cubic, ..Config::fast(6) },
            Config { basis: Basis::Plain, memory: 8, ..Config::fast(6) },
            Config { basis: Basis::Plain, ..Config::published(3) },
        ] {
            let mut mock = Mock::new(7, tokens, width);
            let list: Vec<_> = (0..count).map(|i| ((i * (4 * tokens - 1) / count) as u16, None)).collect::<Vec<_>>();
            let (mut u, anchors) = mock.problem(3, &list, false);
            let set = mock.set(&anchors);
            let need = scratch_bytes(ProblemShape { tokens, width, anchors: set.len() }, &config);
            let mut scratch = Scratch::new(need + 1, PAINT);
            let objective = Objective::new(&set, &config);
            let short = Arena::new(&mut scratch.bytes()[..need - 1]);
            let error = solve(&mut mock, &mut u, &objective, &config, short).unwrap_err();
            assert_eq!(error, SolverError::Arena(ArenaTooSmall { needed: need, available: need - 1 }));
            assert_eq!(mock.forwards, 0);

            // A guard behind what was asked for stays as it was, and what lies in front is used to its end.
            scratch.bytes().fill(PAINT);
            solve(&mut mock, &mut u, &objective, &config, Arena::new(&mut scratch.bytes()[..])).unwrap();
            assert!(scratch.bytes()[need..].iter().all(|&byte| byte == PAINT));
            assert!(scratch.bytes()[need - ALIGNMENT..need].iter().any(|&byte| byte != PAINT));
        }
    }
}

#[test]
fn any_grid_of_tokens_and_frames_is_solved() {
    for (tokens, frames_per_token) in [(50, 2), (24, 8), (256, 4)] {
        for config in [Config::fast(30), Config::published(60)] {
            let mut mock = Mock::with_frames_per_token(7, tokens, WIDTH, frames_per_token);
            let end = mock.frames() as u16;
            let places = [(end / 4, None), (end / 2 - 1, Some(20)), (3 * end / 4 + 1, None), (end - 2, Some(15))];
            let (mut u, anchors) = mock.problem(3, &places, false);
            let set = mock.set(&anchors);
            let report = run(&mut mock, &mut u, &set, &config);
            let (before, after) = (report.before.unwrap().mean, report.after.unwrap().mean);
            assert!(after < 0.2 * before, "{tokens} tokens of {frames_per_token} frames: {before} -> {after}");
        }
    }
}

#[test]
fn memory_budgets_hold() {
    let kib = |anchors, config: &Config| scratch_bytes(ProblemShape { tokens: 49, width: 32, anchors }, config) / 1024;
    for config in [Config::fast(20), Config::published(200)] {
        assert!(kib(8, &config) < 60, "{} KiB", kib(8, &config));
        assert!(kib(32, &config) < 150, "{} KiB", kib(32, &config));
    }
}

#[test]
fn wrong_shapes_are_refused() {
    let (mut mock, mut u, set) = problem(0, 4, 1);
    let config = Config::fast(5);
    let short = u.len() - 1;
    let error = mock::run(&mut mock, &mut u[..short], &set, &config).unwrap_err();
    assert_eq!(error, SolverError::Shape { have: short, need: short + 1 });

    let far = AnchorSet::new(&[Anchor::root(150, [0.0, 0.9, 0.0])], 196).unwrap();
    let error = mock::run(&mut mock, &mut u, &far, &config).unwrap_err();
    assert_eq!(error, SolverError::FrameOutOfRange { frame: 150, frames: 4 * TOKENS });

    for (tokens, frames_per_token, limit) in [(0, 4, 16_384), (5, 0, 0), (2049, 32, 2048)] {
        let mut mock = Mock::with_frames_per_token(1, tokens, 1, frames_per_token);
        let error = mock::run(&mut mock, &mut [], &AnchorSet::EMPTY, &config).unwrap_err();
        assert_eq!(error, SolverError::Tokens { tokens, limit });
        assert!(!error.to_string().is_empty());
    }
}

#[test]
fn results_do_not_depend_on_what_scratch_held() {
    for config in [Config::fast(15), Config::published(15)] {
        let solve_over = |filler: u8| {
            let (mut mock, mut u, set) = problem(3, 6, 8);
            mock::run_over(filler, &mut mock, &mut u, &set, &config).unwrap();
            u
        };
        assert_eq!(solve_over(0xFF), solve_over(0x4B));
    }
}
