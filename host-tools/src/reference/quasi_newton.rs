//! L-BFGS in orthonormal coefficients of the interval basis: `u = u0 + Q alpha` (DESIGN section 5).
//!
//! The textbook two-loop recursion with backtracking, in f64 whatever the decode path computes in. It answers how far a quasi-Newton
//! method in this space can get, independently of the runtime's own.

use super::anchors::{Anchor, control_error};
use super::decode_path::{DecodePath, Pass};
use super::interval_basis::IntervalBasis;
use super::objective::Objective;
use super::real::Real;
use super::route_solver::{Settings, Solution};

/// Pairs remembered.
const MEMORY: usize = 5;
/// Share of the predicted decrease a step must reach.
const ARMIJO: f64 = 1e-4;
/// Trials before a line is given up.
const TRIALS: usize = 8;

/// A step and the change of gradient along it.
struct Pair {
    s: Vec<f64>,
    y: Vec<f64>,
}

/// Spends at most `evaluations` decoder passes; `settings.steps`, `learning_rate`, `ridge` and `tolerance` are of no consequence here.
#[must_use]
pub fn solve<T: Real>(
    decode_path: &DecodePath<T>,
    anchors: &[Anchor],
    u0: &[T],
    settings: &Settings,
    evaluations: usize,
) -> Solution<T> {
    let width = decode_path.decoder.width();
    let tokens = u0.len() / width;
    let basis = IntervalBasis::new(anchors, tokens, decode_path.decoder.frames_per_token(), settings.basis);
    let columns = basis.orthonormal(tokens);
    let objective = Objective::new(decode_path, anchors, settings.weights, u0);
    let place = |alpha: &[f64]| -> Vec<T> {
        let mut u = u0.to_vec();
        for (column, a) in columns.iter().zip(alpha.chunks_exact(width)) {
            for (l, &q) in column.iter().enumerate().filter(|(_, q)| **q != 0.0) {
                for (u, a) in u[l * width..].iter_mut().zip(a) {
                    *u += T::from_f64(q * a);
                }
            }
        }
        u
    };
    let pull = |u: &[T], pass: &Pass<T>| -> Vec<f64> {
        let d = objective.gradient(u, pass);
        let along = |column: &Vec<f64>, c: usize| -> f64 {
            column.iter().enumerate().map(|(l, q)| q * d[l * width + c].to_f64()).sum()
        };
        columns
            .iter()
            .flat_map(|column| (0..width).map(move |c| (column, c)))
            .map(|(column, c)| along(column, c))
            .collect()
    };

    let mut alpha = vec![0.0; columns.len() * width];
    let (j, mut pass) = objective.value(u0);
    let mut j = j.to_f64();
    let error_before = control_error(anchors, &pass.joints);
    let mut u = u0.to_vec();
    let (mut spent, mut gradients) = (1, 0);
    let mut pairs: Vec<Pair> = Vec::new();
    let mut gradient = Vec::new();
    while spent < evaluations {
        if gradient.is_empty() {
            gradient = pull(&u, &pass);
            gradients += 1;
        }
        let norm2 = dot(&gradient, &gradient);
        if norm2 == 0.0 {
            break;
        }
        let mut direction = descent(&pairs, &gradient);
        let mut slope = dot(&direction, &gradient);
        if slope >= 0.0 {
            pairs.clear();
            direction = gradient.iter().map(|g| -g).collect();
            slope = -norm2;
        }
        // Without curvature yet: Polyak's step towards J = 0.
        let mut length = if pairs.is_empty() { j / norm2 } else { 1.0 };
        let mut accepted = None;
        for _ in 0..TRIALS {
            if spent == evaluations {
                break;
            }
            let trial: Vec<f64> = alpha.iter().zip(&direction).map(|(a, d)| a + length * d).collect();
            let point = place(&trial);
            let (value, kept) = objective.value(&point);
            spent += 1;
            if value.to_f64() <= j + ARMIJO * length * slope {
                accepted = Some((trial, point, value.to_f64(), kept));
                break;
            }
            // Minimum of the parabola through value, slope and trial, within bounds.
            let parabola = -slope * length / (2.0 * (value.to_f64() - j - slope * length));
            length *= if parabola.is_finite() { parabola.clamp(0.1, 0.5) } else { 0.1 };
        }
        let Some((trial, point, value, kept)) = accepted else {
            if pairs.is_empty() || spent == evaluations {
                break;
            }
            pairs.clear();
            continue;
        };
        (u, j, pass) = (point, value, kept);
        let s: Vec<f64> = trial.iter().zip(&alpha).map(|(a, b)| a - b).collect();
        alpha = trial;
        if spent == evaluations {
            break;
        }
        let next = pull(&u, &pass);
        gradients += 1;
        let y: Vec<f64> = next.iter().zip(&gradient).map(|(a, b)| a - b).collect();
        if dot(&s, &y) > 1e-10 * dot(&y, &y) {
            pairs.push(Pair { s, y });
            if pairs.len() > MEMORY {
                pairs.remove(0);
            }
        }
        gradient = next;
    }
    let error_after = control_error(anchors, &pass.joints);
    Solution { u, joints: pass.joints, objective: j, error_before, error_after, evaluations: spent, gradients }
}

/// Two-loop recursion: minus the inverse Hessian estimate times the gradient.
fn descent(pairs: &[Pair], gradient: &[f64]) -> Vec<f64> {
    let mut q = gradient.to_vec();
    let mut weights = Vec::new();
    for p in pairs.iter().rev() {
        let w = dot(&p.s, &q) / dot(&p.s, &p.y);
        add(&mut q, -w, &p.y);
        weights.push(w);
    }
    if let Some(p) = pairs.last() {
        let scale = dot(&p.s, &p.y) / dot(&p.y, &p.y);
        q.iter_mut().for_each(|q| *q *= scale);
    }
    for (p, w) in pairs.iter().zip(weights.into_iter().rev()) {
        let b = dot(&p.y, &q) / dot(&p.s, &p.y);
        add(&mut q, w - b, &p.s);
    }
    q.iter_mut().for_each(|q| *q = -*q);
    q
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn add(y: &mut [f64], factor: f64, x: &[f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += factor * x);
}
