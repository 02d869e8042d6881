//! The residual metric against dense linear algebra in `f64`, and what it buys.

mod mock;

use mock::{Mock, Random, run};
use motionette::refining::metric::{Prior, ResidualMetric, Residuals, factor_len};
use motionette::refining::{Config, MotionMap, Prior as Exported};
use motionette::request::conditions::{Anchor, AnchorSet, Family};

const PRIOR: Prior = Prior { root: 1.3, yaw: 0.7, body: 0.9, height: 0.2, range: 1.25, floor: 0.02 };

/// Covariance of the residuals `[3 K][3 K]` from the definition; rows of heights that do not count are zero.
fn covariance(set: &AnchorSet, mock: &Mock) -> Vec<Vec<f64>> {
    let at = |joint: usize, frame: usize| mock.joints[frame * mock::JOINTS + joint];
    let list: Vec<_> = set.iter().copied().collect();
    let each = mock.frames_per_token as f64;
    let root = |family: Family, joint: u8| family != Family::BodyPoint || joint == 0;
    let mut a = vec![vec![0.0; 3 * list.len()]; 3 * list.len()];
    for (n, p) in list.iter().enumerate() {
        for (m, q) in list.iter().enumerate() {
            let until = usize::from(p.frame.min(q.frame));
            let local = (-(f64::from(p.frame) - f64::from(q.frame)).abs() / each / f64::from(PRIOR.range)).exp();
            let same = p.joint == q.joint;
            for axis in [0, 2] {
                a[3 * n + axis][3 * m + axis] += f64::from(PRIOR.root) * until as f64 / each / 25.0;
                if same && !root(p.family, p.joint) {
                    a[3 * n + axis][3 * m + axis] += f64::from(PRIOR.body) * local;
                }
            }
            if same && p.has_height() && q.has_height() {
                let strength = if root(p.family, p.joint) { PRIOR.height } else { PRIOR.body };
                a[3 * n + 1][3 * m + 1] += f64::from(strength) * local;
            }
            // A turn by a small angle at frame s moves a point p by (p_z - c_z, c_x - p_x) times the angle.
            for s in (mock.frames_per_token / 2..until).step_by(mock.frames_per_token) {
                let lever = |joint: u8, frame: u16| {
                    let (p, c) = (at(usize::from(joint), usize::from(frame)), at(0, s));
                    [p[2] - c[2], c[0] - p[0]]
                };
                let (u, v) = (lever(p.joint, p.frame), lever(q.joint, q.frame));
                for i in 0..2 {
                    for j in 0..2 {
                        a[3 * n + 2 * i][3 * m + 2 * j] += f64::from(PRIOR.yaw) / 25.0 * u[i] * v[j];
                    }
                }
            }
        }
    }
    a
}

fn solve_dense(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for i in 0..n {
        let pivot = (i..n).max_by(|&p, &q| a[p][i].abs().total_cmp(&a[q][i].abs())).unwrap();
        a.swap(i, pivot);
        b.swap(i, pivot);
        for row in 0..n {
            if row != i {
                let factor = a[row][i] / a[i][i];
                for k in i..n {
                    a[row][k] -= factor * a[i][k];
                }
                b[row] -= factor * b[i];
            }
        }
    }
    (0..n).map(|i| b[i] / a[i][i]).collect()
}

fn places(seed: u64, count: usize, frames: usize) -> Vec<Anchor> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|i| {
            let frame = (i * frames / count) as u16;
            let mut p = || random.normal() as f32;
            let target = [p(), p(), p()];
            match i % 4 {
                0 => Anchor::root(frame, target),
                1 => Anchor::planar_root(frame, [target[0], target[2]]),
                2 => Anchor::joint(frame, 20, target),
                _ => Anchor::joint(frame, if i % 8 == 3 { 0 } else { 15 }, target),
            }
        })
        .collect()
}

#[test]
fn applies_the_inverse_covariance() {
    for (count, tokens, frames_per_token) in
        [(1, 20, 4), (2, 20, 4), (5, 20, 4), (9, 20, 4), (32, 20, 4), (7, 40, 2), (7, 10, 8)]
    {
        let mut mock = Mock::with_frames_per_token(5, tokens, 6, frames_per_token);
        assert!(mock.forward(&mock.embeddings(3)).is_continue());
        let set = mock.set(&places(count as u64, count, 80));
        let mut numbers = vec![f32::NAN; factor_len(count)];
        let metric = ResidualMetric::new(&set, &mock, &PRIOR, &mut numbers).expect("positive definite");
        let mut dual = Residuals::of(&set, &mock);
        let residuals: Vec<f64> = dual.vectors().take(count).flatten().map(f64::from).collect();
        let square = f64::from(metric.apply(&mut dual));

        let mut a = covariance(&set, &mock);
        let counted: Vec<bool> = set.iter().flat_map(|anchor| [true, anchor.has_height(), true]).collect();
        let rows = counted.iter().filter(|counts| **counts).count() as f64;
        let scale = (0..3 * count).filter(|&i| counted[i]).map(|i| a[i][i]).sum::<f64>() / rows;
        for (i, row) in a.iter_mut().enumerate() {
            row.iter_mut().for_each(|v| *v /= scale);
            row[i] += f64::from(PRIOR.floor);
        }
        let expected = solve_dense(a, residuals.clone());
        let size = expected.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for (got, expected) in dual.vectors().take(count).flatten().zip(&expected) {
            assert!((f64::from(got) - expected).abs() < 2e-3 * size, "{count}: {got} {expected} of {size}");
        }
        let product: f64 = residuals.iter().zip(&expected).map(|(r, w)| r * w).sum();
        assert!((square - product).abs() < 2e-3 * product, "{square} {product}");
    }
}

/// What is paid once a request: each position costs a decoded joint.
#[test]
fn the_metric_asks_for_a_position_an_anchor_and_one_a_token() {
    let mut mock = Mock::new(5, 49, 6);
    assert!(mock.forward(&mock.embeddings(3)).is_continue());
    let set = mock.set(&places(1, 32, 196));
    mock.asked.set(0);
    ResidualMetric::new(&set, &mock, &PRIOR, &mut vec![0.0; factor_len(32)]).expect("positive definite");
    assert!(mock.asked.get() <= 32 + 49, "{} positions", mock.asked.get());
}

#[test]
fn a_prior_without_variance_is_no_metric() {
    let mut mock = Mock::new(5, 20, 6);
    assert!(mock.forward(&mock.embeddings(3)).is_continue());
    let set = mock.set(&places(1, 4, 80));
    let nothing = Prior { root: 0.0, yaw: 0.0, body: 0.0, height: 0.0, ..PRIOR };
    let wrong = Prior { root: f32::NAN, ..PRIOR };
    let mut numbers = vec![0.0; factor_len(4)];
    assert!(ResidualMetric::new(&set, &mock, &nothing, &mut numbers).is_none());
    assert!(ResidualMetric::new(&set, &mock, &wrong, &mut numbers).is_none());

    // The solver then descends J itself.
    for prior in [Some(nothing), Some(wrong), None] {
        let config = Config { prior, ..Config::fast(12) };
        let (mut u, anchors) = mock.problem(2, &[(30, None), (60, Some(20))], false);
        let set = mock.set(&anchors);
        let report = run(&mut mock, &mut u, &set, &config).unwrap();
        assert!(report.objective_after < 0.2 * report.objective_before);
    }
}

#[test]
fn root_anchors_need_fewer_evaluations_under_the_metric() {
    let mut evaluations = [0; 2];
    for seed in 1..=6 {
        for (total, prior) in evaluations.iter_mut().zip([Some(Exported::NANO), None]) {
            let mut mock = Mock::new(7, 25, 16);
            let places: Vec<_> = (1..=8).map(|i| (12 * i - 1, None)).collect();
            let (mut u, anchors) = mock.problem(seed, &places, true);
            let set = mock.set(&anchors);
            let config = Config { prior, stop_error: 0.01, ..Config::fast(100) };
            let report = run(&mut mock, &mut u, &set, &config).unwrap();
            *total += u32::from(report.evaluations);
        }
    }
    let [with, without] = evaluations;
    assert!(4 * with < 3 * without, "{with} with the metric, {without} without");
}
