//! RouteSolver as published: Adam on the tokens, every step projected onto the interval basis (EQUATIONS section 5).

use super::anchors::{Anchor, Family, control_error};
use super::decode_path::DecodePath;
use super::interval_basis::{Basis, IntervalBasis};
use super::objective::{Objective, Weights};
use super::real::Real;
use super::recover::JOINTS;

/// Adam's constants.
const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// How to solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Steps: RS200 = 200.
    pub steps: usize,
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// `lambda`.
    pub ridge: f64,
    /// `rho_f` for Root-3D, Planar-root, Body-point, metres.
    pub tolerance: [f64; 3],
    /// Interval basis.
    pub basis: Basis,
    /// Weights of the objective.
    pub weights: Weights,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            steps: 200,
            learning_rate: 0.02,
            ridge: 1.0,
            tolerance: [0.05; 3],
            basis: Basis::Affine,
            weights: Weights::default(),
        }
    }
}

/// The best iterate of a solve.
#[derive(Debug, Clone)]
pub struct Solution<T> {
    /// Latent `[L][du]`.
    pub u: Vec<T>,
    /// Its joints, metres.
    pub joints: Vec<[[T; 3]; JOINTS]>,
    /// Its `J`.
    pub objective: f64,
    /// Mean control error before, metres.
    pub error_before: f64,
    /// Mean control error after, metres.
    pub error_after: f64,
    /// Decoder passes forward.
    pub evaluations: usize,
    /// Decoder passes backward.
    pub gradients: usize,
}

/// Runs `settings.steps` steps from `u0` `[L][du]` and returns the iterate with the smallest `J`.
#[must_use]
pub fn solve<T: Real>(decode_path: &DecodePath<T>, anchors: &[Anchor], u0: &[T], settings: &Settings) -> Solution<T> {
    let width = decode_path.decoder.width();
    let basis = IntervalBasis::new(anchors, u0.len() / width, decode_path.decoder.frames_per_token(), settings.basis);
    let objective = Objective::new(decode_path, anchors, settings.weights, u0);
    let (mut j, mut pass) = objective.value(u0);
    let error_before = control_error(anchors, &pass.joints);
    let mut u = u0.to_vec();
    let mut best = (j.to_f64(), u.clone(), pass.joints.clone());
    let (mut first, mut second) = (vec![0.0; u.len()], vec![0.0; u.len()]);
    for step in 1..=settings.steps {
        let gradient = objective.gradient(&u, &pass);
        let (c1, c2) = (1.0 - BETA1.powi(step as i32), 1.0 - BETA2.powi(step as i32));
        let mut delta: Vec<T> = Vec::with_capacity(u.len());
        for ((m, v), g) in first.iter_mut().zip(&mut second).zip(&gradient) {
            let g = g.to_f64();
            *m = BETA1 * *m + (1.0 - BETA1) * g;
            *v = BETA2 * *v + (1.0 - BETA2) * g * g;
            delta.push(T::from_f64(-settings.learning_rate * (*m / c1) / ((*v / c2).sqrt() + EPSILON)));
        }
        if settings.basis != Basis::Plain {
            let activity: Vec<f64> = basis
                .intervals
                .iter()
                .map(|i| activity(anchors, &pass.joints, &settings.tolerance, [i.left, i.right]))
                .collect();
            basis.project(&mut delta, width, settings.ridge, &activity);
        }
        for (u, &d) in u.iter_mut().zip(&delta) {
            *u += d;
        }
        (j, pass) = objective.value(&u);
        if j.to_f64() < best.0 {
            best = (j.to_f64(), u.clone(), pass.joints.clone());
        }
    }
    let (objective, u, joints) = best;
    let error_after = control_error(anchors, &joints);
    Solution {
        u,
        joints,
        objective,
        error_before,
        error_after,
        evaluations: settings.steps + 1,
        gradients: settings.steps,
    }
}

/// `clip(max(e_left, e_right) / rho_f, 0, 1)`; an end without an anchor counts 0, several anchors at one frame the largest.
fn activity<T: Real>(anchors: &[Anchor], motion: &[[[T; 3]; JOINTS]], tolerance: &[f64; 3], ends: [usize; 2]) -> f64 {
    anchors
        .iter()
        .filter(|a| ends.contains(&a.frame))
        .map(|a| {
            let rho = match a.family() {
                Family::Root3d => tolerance[0],
                Family::PlanarRoot => tolerance[1],
                Family::BodyPoint => tolerance[2],
            };
            (a.error(motion) / rho).min(1.0)
        })
        .fold(0.0, f64::max)
}
