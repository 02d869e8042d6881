//! Budgets, aborts, early finishes and broken maps: at every call, the result is consistent.

mod mock;

use mock::{Mock, StopAt, run};
use motionette::refining::{Config, MotionMap, Objective, SolverError, Stop, StopReason};
use motionette::request::conditions::AnchorSet;

const TOKENS: usize = 12;
const WIDTH: usize = 8;

fn problem() -> (Mock, Vec<f32>, AnchorSet) {
    let mut mock = Mock::new(3, TOKENS, WIDTH);
    let (u, anchors) = mock.problem(2, &[(9, None), (21, Some(20)), (21, None), (40, Some(15))], false);
    let set = mock.set(&anchors);
    (mock, u, set)
}

fn methods() -> [Config; 2] {
    [Config { stop_error: 0.0, ..Config::fast(15) }, Config::published(14)]
}

/// `J` at `u`, and that `u` is one of the points evaluated.
fn objective(mock: &Mock, u: &[f32], start: &[f32], set: &AnchorSet, config: &Config) -> f32 {
    let mut fresh = Mock::new(3, TOKENS, WIDTH);
    assert!(fresh.forward(u).is_continue());
    assert!(mock.seen.iter().any(|seen| seen == u), "the result was evaluated");
    let squared: f32 = u.iter().zip(start).map(|(a, b)| (a - b) * (a - b)).sum();
    Objective::new(set, config).measure(&fresh, squared, None).objective
}

#[test]
fn the_budget_is_a_hard_limit_and_more_of_it_never_hurts() {
    for base in methods() {
        let mut last = f32::INFINITY;
        for evaluations in 0..=40 {
            let config = Config { evaluations, ..base };
            let (mut mock, mut u, set) = problem();
            let report = run(&mut mock, &mut u, &set, &config).unwrap();
            assert!(report.evaluations <= evaluations);
            assert_eq!(usize::from(report.evaluations), mock.forwards);
            assert_eq!(usize::from(report.gradients), mock.backwards);
            assert!(mock.backwards <= mock.forwards);
            if report.reason == StopReason::Budget {
                assert_eq!(report.evaluations, evaluations);
            }
            if evaluations > 0 {
                assert!(report.objective_after <= last, "{evaluations}: {report:?}");
                last = report.objective_after;
            } else {
                assert_eq!(report.after, None);
            }
        }
    }
}

#[test]
fn finish_and_abort_at_every_call_leave_the_best_so_far() {
    for config in methods() {
        let (mut free, mut u, set) = problem();
        run(&mut free, &mut u, &set, &config).unwrap();
        let calls = free.forwards + free.backwards;
        assert!(calls > 20);
        let mut last = f32::INFINITY;
        for at in 0..calls {
            let (mut finished, mut aborted) = (Vec::new(), Vec::new());
            for stop in [Stop::Finish, Stop::Abort] {
                let (mut mock, start, set) = problem();
                let mut u = start.clone();
                mock.stop_at = Some(StopAt { calls: at, stop });
                let result = run(&mut mock, &mut u, &set, &config);
                assert_eq!(mock.forwards + mock.backwards, at + 1, "nothing is called after a stop");
                if stop == Stop::Abort {
                    assert_eq!(result.unwrap_err(), SolverError::Aborted);
                    aborted = u;
                    continue;
                }
                let report = result.unwrap();
                assert_eq!(report.reason, StopReason::Finished);
                if at == 0 {
                    assert_eq!((report.before, report.after, &u), (None, None, &start));
                    assert!(!report.current);
                } else {
                    let value = objective(&mock, &u, &start, &set, &config);
                    assert!((value - report.objective_after).abs() <= 1e-5 * value, "{value} {report:?}");
                    assert!(report.objective_after <= last);
                    last = report.objective_after;
                    // The map holds the result's motion exactly when it says so; a stopped forward pass left none.
                    assert_eq!(report.current, mock.whole && mock.seen.last() == Some(&u), "call {at}");
                }
                finished = u;
            }
            assert_eq!(finished, aborted, "call {at}");
        }
    }
}

#[test]
fn a_map_that_breaks_is_refused_or_survived() {
    for config in methods() {
        let (mut mock, mut u, set) = problem();
        let start = u.clone();
        mock.poisoned = vec![0];
        assert_eq!(run(&mut mock, &mut u, &set, &config).unwrap_err(), SolverError::NotFinite);
        assert_eq!(u, start);
        for broken in 1..8 {
            let (mut mock, mut u, set) = problem();
            mock.poisoned = vec![broken];
            let report = run(&mut mock, &mut u, &set, &config).unwrap();
            assert!(u.iter().all(|v| v.is_finite()));
            assert!(report.objective_after.is_finite() && report.objective_after <= report.objective_before);
        }
        let (mut mock, mut u, set) = problem();
        mock.poisoned = (1..100).collect();
        let report = run(&mut mock, &mut u, &set, &config).unwrap();
        assert_eq!(u, start);
        assert_eq!(report.after, report.before);
        assert!(!report.current);
    }
}

#[test]
fn a_solver_can_run_again_at_once() {
    for config in methods() {
        let (mut mock, start, set) = problem();
        let mut expected = start.clone();
        run(&mut mock, &mut expected, &set, &config).unwrap();
        for at in [0, 3, 8] {
            let mut u = start.clone();
            (mock.forwards, mock.backwards) = (0, 0);
            mock.stop_at = Some(StopAt { calls: at, stop: Stop::Abort });
            run(&mut mock, &mut u, &set, &config).unwrap_err();
            mock.stop_at = None;
            u.copy_from_slice(&start);
            run(&mut mock, &mut u, &set, &config).unwrap();
            assert_eq!(u, expected);
        }
    }
}
