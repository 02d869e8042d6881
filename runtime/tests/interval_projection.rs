//! The interval basis and the routed projection against a dense least-squares oracle in `f64`.
// Oracles run on the host only, where it does not matter how zeros are signed.
#![allow(clippy::disallowed_methods)]

mod mock;

use mock::Random;
use motionette::refining::basis::{IntervalBasis, MAX_INTERVALS, RIDGE_FLOOR, most_coefficients, values_len};
use motionette::refining::{Basis, TokenGrid};
use motionette::request::conditions::{Anchor, AnchorSet};

const BASES: [Basis; 5] = [Basis::Transport, Basis::Slope, Basis::Affine, Basis::Quadratic, Basis::Cubic];

fn anchors_at(frames: &[u16], end: usize) -> AnchorSet {
    let list: Vec<_> = frames.iter().map(|&frame| Anchor::root(frame, [0.0, 0.9, 0.1 * f32::from(frame)])).collect();
    AnchorSet::new(&list, end).expect("valid anchors")
}

/// Columns of `B [tokens][columns]` and the interval (among those with tokens) of each column, from the definition.
fn dense_basis(frames: &[u16], grid: TokenGrid, basis: Basis) -> (Vec<Vec<f64>>, Vec<usize>) {
    let (tokens, each) = (grid.tokens, grid.frames_per_token as f64);
    let end = each * tokens as f64 - 1.0;
    let middle = |l: usize| each * l as f64 + (each - 1.0) / 2.0;
    let mut cuts: Vec<f64> = frames.iter().map(|&f| f64::from(f)).collect();
    cuts.push(0.0);
    cuts.push(end);
    cuts.sort_by(f64::total_cmp);
    cuts.dedup();
    let powers: &[usize] = match basis {
        Basis::Plain => &[],
        Basis::Transport => &[0],
        Basis::Slope => &[1],
        Basis::Affine => &[0, 1],
        Basis::Quadratic => &[0, 1, 2],
        Basis::Cubic => &[0, 1, 2, 3],
    };
    let runs: Vec<(f64, f64, Vec<usize>)> = cuts
        .windows(2)
        .map(|cut| {
            let held = |l: &usize| middle(*l) >= cut[0] && middle(*l) < cut[1];
            (cut[0], cut[1], (0..tokens).filter(held).collect::<Vec<_>>())
        })
        .filter(|(_, _, held)| !held.is_empty())
        .collect();
    assert_eq!(runs.iter().map(|run| run.2.len()).sum::<usize>(), tokens, "every token has one interval");
    let (mut columns, mut owners) = (Vec::new(), Vec::new());
    let direct = runs.len() * powers.len() > tokens;
    for (index, (left, right, held)) in runs.iter().enumerate() {
        if direct {
            for &l in held {
                columns.push((0..tokens).map(|k| if k == l { 1.0 } else { 0.0 }).collect());
                owners.push(index);
            }
            continue;
        }
        for &power in powers.iter().take(held.len()) {
            let mut column = vec![0.0; tokens];
            for &l in held {
                let x = 2.0 * (middle(l) - left) / (right - left) - 1.0;
                column[l] = match power {
                    0 => 1.0,
                    1 => x,
                    2 => (3.0 * x * x - 1.0) / 2.0,
                    _ => (5.0 * x * x * x - 3.0 * x) / 2.0,
                };
            }
            columns.push(column);
            owners.push(index);
        }
    }
    (columns, owners)
}

/// Gauss elimination with partial pivoting.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for i in 0..n {
        let pivot = (i..n).max_by(|&p, &q| a[p][i].abs().total_cmp(&a[q][i].abs())).unwrap();
        a.swap(i, pivot);
        b.swap(i, pivot);
        for row in i + 1..n {
            let factor = a[row][i] / a[i][i];
            for k in i..n {
                a[row][k] -= factor * a[i][k];
            }
            b[row] -= factor * b[i];
        }
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|k| a[i][k] * b[k]).sum();
        b[i] = (b[i] - known) / a[i][i];
    }
    b
}

/// `B argmin ||delta - B alpha||^2 + sum ridge_i ||alpha_i||^2`, one channel.
fn oracle(columns: &[Vec<f64>], ridges: &[f64], delta: &[f64]) -> Vec<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let normal = (0..columns.len())
        .map(|i| {
            let mut row: Vec<f64> = columns.iter().map(|other| dot(&columns[i], other)).collect();
            row[i] += ridges[i];
            row
        })
        .collect();
    let alpha = solve(normal, columns.iter().map(|column| dot(column, delta)).collect());
    (0..delta.len()).map(|l| columns.iter().zip(&alpha).map(|(column, a)| column[l] * a).sum()).collect()
}

/// Anchor frames that meet the corner cases: none, both ends, neighbours inside one token, more intervals than tokens.
fn layouts(random: &mut Random, grid: TokenGrid) -> Vec<Vec<u16>> {
    let end = (grid.frames() - 1) as u16;
    let near = [1, 2, 3, end.saturating_sub(1)].map(|frame| frame.min(end));
    let many = (0..32).map(|i| (i * usize::from(end) / 32) as u16).collect();
    let mut list = vec![vec![end / 2], vec![0, end], near.to_vec(), many];
    for count in [1, 2, 3, 5, 8, 13, 21] {
        list.push((0..count).map(|_| random.below(usize::from(end) + 1) as u16).collect());
    }
    for frames in &mut list {
        frames.sort_unstable();
        frames.dedup();
    }
    list
}

#[test]
fn projection_is_the_ridge_least_squares_solution() {
    let mut random = Random::new(11);
    let width = 3;
    let (mut compared, mut direct, mut dropped) = (0, 0, 0);
    let sizes =
        [(1, 4), (2, 4), (7, 4), (25, 4), (49, 4), (1, 2), (13, 2), (40, 2), (5, 8), (24, 8), (256, 4), (9, 32)];
    for (tokens, frames_per_token) in sizes {
        let grid = TokenGrid { tokens, frames_per_token };
        for frames in layouts(&mut random, grid) {
            let anchors = anchors_at(&frames, grid.frames());
            for basis in BASES {
                for lambda in [0.0f32, 0.3, 20.0] {
                    let mut values = vec![0.0; values_len(tokens, basis)];
                    let routed = IntervalBasis::new(&anchors, grid, basis, &mut values);
                    let mut activities = [0.0; MAX_INTERVALS];
                    activities.iter_mut().for_each(|a| *a = (1.6 * random.uniform() - 0.3).clamp(0.0, 1.0) as f32);
                    let delta: Vec<f32> = (0..tokens * width).map(|_| random.normal() as f32).collect();
                    let mut projected = delta.clone();
                    routed.project(&mut projected, width, &activities, lambda);

                    let (columns, owners) = dense_basis(&frames, grid, basis);
                    assert_eq!(routed.coefficients(), columns.len());
                    assert!(columns.len() <= most_coefficients(tokens, anchors.len(), basis));
                    direct += usize::from(routed.is_direct());
                    dropped += usize::from(routed.intervals().len() < frames.len());
                    let ridges: Vec<f64> = owners
                        .iter()
                        .map(|&i| f64::from(lambda) * (1.0 - f64::from(activities[i])) + f64::from(RIDGE_FLOOR))
                        .collect();
                    for channel in 0..width {
                        let line: Vec<f64> = (0..tokens).map(|l| f64::from(delta[l * width + channel])).collect();
                        for (l, expected) in oracle(&columns, &ridges, &line).into_iter().enumerate() {
                            let got = f64::from(projected[l * width + channel]);
                            assert!(
                                (got - expected).abs() < 2e-5 * (1.0 + expected.abs()),
                                "{basis:?}, {grid:?}, anchors {frames:?}, lambda {lambda}: token {l} {got} {expected}"
                            );
                            compared += 1;
                        }
                    }
                }
            }
        }
    }
    assert!(compared > 10_000 && direct > 20 && dropped > 20, "{compared} {direct} {dropped}");
}

#[test]
fn tokens_go_to_the_interval_that_holds_their_middle() {
    // Middles 1.5, 5.5, 9.5, 13.5: frame 5 cuts before the second token, frame 6 behind it.
    let owned_of = |frames_per_token: usize, frames: &[u16]| {
        let grid = TokenGrid { tokens: 4, frames_per_token };
        let anchors = anchors_at(frames, grid.frames());
        let mut values = vec![0.0; values_len(4, Basis::Transport)];
        let basis = IntervalBasis::new(&anchors, grid, Basis::Transport, &mut values);
        basis.intervals().iter().map(|i| (i.left, i.right, i.tokens)).collect::<Vec<_>>()
    };
    let owned = |frames: &[u16]| owned_of(4, frames);
    assert_eq!(owned(&[5]), [(0, 5, 1), (5, 15, 3)]);
    assert_eq!(owned(&[6]), [(0, 6, 2), (6, 15, 2)]);
    assert_eq!(owned(&[0]), [(0, 15, 4)]);
    assert_eq!(owned(&[15]), [(0, 15, 4)]);
    // No middle between 7 and 9: that interval is dropped.
    assert_eq!(owned(&[7, 9]), [(0, 7, 2), (9, 15, 2)]);
    // Two frames a token, middles 0.5, 2.5, 4.5, 6.5; eight, middles 3.5, 11.5, 19.5, 27.5.
    assert_eq!(owned_of(2, &[2]), [(0, 2, 1), (2, 7, 3)]);
    assert_eq!(owned_of(2, &[5]), [(0, 5, 3), (5, 7, 1)]);
    assert_eq!(owned_of(8, &[3]), [(3, 31, 4)]);
    assert_eq!(owned_of(8, &[4, 20]), [(0, 4, 1), (4, 20, 2), (20, 31, 1)]);
}

#[test]
fn a_basis_reproduces_what_it_spans_and_nothing_else() {
    let (tokens, anchors) = (20, anchors_at(&[38], 80));
    let grid = TokenGrid { tokens, frames_per_token: 4 };
    let shapes: [fn(f32) -> f32; 4] = [|_| 1.0, |x| x, |x| x * x, |x| x * x * x];
    // Slope spans x without a constant; the others span polynomials up to their degree.
    let spans = [
        (Basis::Transport, [true, false, false, false]),
        (Basis::Slope, [false, true, false, false]),
        (Basis::Affine, [true, true, false, false]),
        (Basis::Quadratic, [true, true, true, false]),
        (Basis::Cubic, [true, true, true, true]),
    ];
    for (basis, spanned) in spans {
        for (shape, inside) in shapes.iter().zip(spanned) {
            let mut values = vec![0.0; values_len(tokens, basis)];
            let routed = IntervalBasis::new(&anchors, grid, basis, &mut values);
            // A correction of the first interval (0..38, tokens 0..=9) only.
            let wanted: Vec<f32> = (0..tokens)
                .map(|l| if l < 10 { shape(2.0 * (4.0 * l as f32 + 1.5) / 38.0 - 1.0) } else { 0.0 })
                .collect();
            let mut got = wanted.clone();
            routed.project(&mut got, 1, &[1.0; MAX_INTERVALS], 0.0);
            let worst = got.iter().zip(&wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert_eq!(worst < 2e-3, inside, "{basis:?}: off by {worst}");
            assert!(got[10..].iter().all(|v| *v == 0.0), "the other interval stays");
        }
    }
}

#[test]
fn low_activity_suppresses_an_interval() {
    let (tokens, anchors) = (20, anchors_at(&[38], 80));
    let grid = TokenGrid { tokens, frames_per_token: 4 };
    let mut values = vec![0.0; values_len(tokens, Basis::Affine)];
    let routed = IntervalBasis::new(&anchors, grid, Basis::Affine, &mut values);
    let mut delta = vec![1.0; tokens];
    let mut activities = [0.0; MAX_INTERVALS];
    activities[1] = 1.0;
    routed.project(&mut delta, 1, &activities, 1000.0);
    assert!(delta[..10].iter().all(|v| v.abs() < 0.02), "{delta:?}");
    assert!(delta[10..].iter().all(|v| (v - 1.0).abs() < 1e-3), "{delta:?}");
}

#[test]
fn orthonormal_coefficients_keep_lengths_and_the_span() {
    let mut random = Random::new(3);
    let (tokens, width) = (49, 5);
    let grid = TokenGrid { tokens, frames_per_token: 4 };
    for frames in layouts(&mut random, grid) {
        let anchors = anchors_at(&frames, grid.frames());
        for basis in BASES {
            let mut values = vec![0.0; values_len(tokens, basis)];
            let mut routed = IntervalBasis::new(&anchors, grid, basis, &mut values);
            let delta: Vec<f32> = (0..tokens * width).map(|_| random.normal() as f32).collect();
            let mut projected = delta.clone();
            routed.project(&mut projected, width, &[1.0; MAX_INTERVALS], 0.0);

            routed.orthonormalise();
            let n = routed.coefficients() * width;
            let (mut c, mut back, mut again) = (vec![0.0; n], vec![0.0; delta.len()], vec![0.0; n]);
            routed.analyse(&delta, width, &mut c);
            routed.add_synthesis(&c, 0.0, &c, width, &mut back);
            // B B^T is the projection without a ridge; the floor alone separates the two. It weighs more on a slope that
            // nearly vanishes at an interval's only token.
            let floor = if basis == Basis::Slope { 0.1 } else { 5e-3 };
            for (a, b) in back.iter().zip(&projected) {
                assert!((a - b).abs() < floor, "{basis:?} {frames:?}: {a} {b}");
            }
            let length = |v: &[f32]| v.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
            assert!((length(&c) - length(&back)).abs() < 1e-4 * length(&c));
            routed.analyse(&back, width, &mut again);
            assert!(c.iter().zip(&again).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }
}
