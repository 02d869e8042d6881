//! `J(u) = L_anc + g_sm L_sm + g_tr ||u - u0||^2 + g_feas L_feas` and its gradient (EQUATIONS section 5).
//!
//! * `L_anc`: sum of squared anchor residuals.
//! * `L_sm`: squared second differences of the controlled trajectories, mean over trajectories and frames. One trajectory a joint with an
//!   anchor; its height counts when one of its anchors fixes the height.
//! * `L_feas`: `max(||p[t+1] - p[t]|| - vmax, 0)^2` of the root in space, mean over steps.

use super::anchors::Anchor;
use super::decode_path::{DecodePath, Pass};
use super::real::Real;
use super::recover::JOINTS;

/// Weights of the terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// `g_sm`.
    pub smoothness: f64,
    /// `g_tr`.
    pub trust: f64,
    /// `g_feas`, 0 = off.
    pub feasibility: f64,
    /// `vmax`, metres a frame.
    pub max_step: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { smoothness: 0.1, trust: 1e-5, feasibility: 0.0, max_step: 0.25 }
    }
}

/// The objective of one request.
#[derive(Debug, Clone)]
pub struct Objective<'a, T> {
    decode_path: &'a DecodePath<T>,
    anchors: &'a [Anchor],
    weights: Weights,
    /// Latent of the tokens, `[L][du]`.
    origin: &'a [T],
}

type Motion<T> = [[[T; 3]; JOINTS]];

impl<'a, T: Real> Objective<'a, T> {
    /// `origin` is `u0`.
    #[must_use]
    pub fn new(decode_path: &'a DecodePath<T>, anchors: &'a [Anchor], weights: Weights, origin: &'a [T]) -> Self {
        Self { decode_path, anchors, weights, origin }
    }

    /// One decoder evaluation: `J(u)` and the pass, for [`Objective::gradient`] and control errors.
    #[must_use]
    pub fn value(&self, u: &[T]) -> (T, Pass<T>) {
        let pass = self.decode_path.forward(u);
        let w = &self.weights;
        let mut j = self.motion_value(&pass.joints);
        let moved = u.iter().zip(self.origin).fold(T::ZERO, |sum, (&u, &o)| sum + (u - o) * (u - o));
        j += T::from_f64(w.trust) * moved;
        (j, pass)
    }

    /// `dJ/du` at the pass of `u`.
    #[must_use]
    pub fn gradient(&self, u: &[T], pass: &Pass<T>) -> Vec<T> {
        let mut d = self.decode_path.backward(pass, &self.motion_gradient(&pass.joints));
        let scale = T::from_f64(2.0 * self.weights.trust);
        for ((d, &u), &o) in d.iter_mut().zip(u).zip(self.origin) {
            *d += scale * (u - o);
        }
        d
    }

    /// The terms that depend on the motion.
    fn motion_value(&self, motion: &Motion<T>) -> T {
        let w = &self.weights;
        let mut anchor = T::ZERO;
        for a in self.anchors {
            for r in a.residual(motion) {
                anchor += r * r;
            }
        }
        let mut smooth = T::ZERO;
        let trajectories = self.trajectories();
        for &(joint, axes) in &trajectories {
            for t in 2..motion.len() {
                for &c in axes {
                    let bend = second_difference(motion, t, joint, c);
                    smooth += bend * bend;
                }
            }
        }
        let mut feasible = T::ZERO;
        for t in 1..motion.len() {
            let excess = (step(motion, t).1 - T::from_f64(w.max_step)).relu();
            feasible += excess * excess;
        }
        anchor
            + T::from_f64(w.smoothness * smooth_scale(&trajectories, motion.len())) * smooth
            + T::from_f64(w.feasibility * step_scale(motion.len())) * feasible
    }

    fn motion_gradient(&self, motion: &Motion<T>) -> Vec<[[T; 3]; JOINTS]> {
        let w = &self.weights;
        let two = T::from_f64(2.0);
        let mut d = vec![[[T::ZERO; 3]; JOINTS]; motion.len()];
        for a in self.anchors {
            for (c, r) in a.residual(motion).into_iter().enumerate() {
                d[a.frame][a.joint()][c] += two * r;
            }
        }
        let trajectories = self.trajectories();
        let scale = T::from_f64(2.0 * w.smoothness * smooth_scale(&trajectories, motion.len()));
        for &(joint, axes) in &trajectories {
            for t in 2..motion.len() {
                for &c in axes {
                    let pull = scale * second_difference(motion, t, joint, c);
                    d[t][joint][c] += pull;
                    d[t - 1][joint][c] -= two * pull;
                    d[t - 2][joint][c] += pull;
                }
            }
        }
        if w.feasibility > 0.0 {
            let scale = T::from_f64(2.0 * w.feasibility * step_scale(motion.len()));
            for t in 1..motion.len() {
                let (direction, length) = step(motion, t);
                let excess = (length - T::from_f64(w.max_step)).relu();
                if excess > T::ZERO && length > T::ZERO {
                    for c in 0..3 {
                        let pull = scale * excess * direction[c] / length;
                        d[t][0][c] += pull;
                        d[t - 1][0][c] -= pull;
                    }
                }
            }
        }
        d
    }

    /// Controlled joints with the axes that count.
    fn trajectories(&self) -> Vec<(usize, &'static [usize])> {
        (0..JOINTS)
            .filter_map(|j| {
                let mut held = self.anchors.iter().filter(|a| a.joint() == j).peekable();
                held.peek()?;
                let axes: &[usize] = if held.any(Anchor::fixes_height) { &[0, 1, 2] } else { &[0, 2] };
                Some((j, axes))
            })
            .collect()
    }
}

fn second_difference<T: Real>(motion: &Motion<T>, t: usize, joint: usize, c: usize) -> T {
    let [a, b, e] = [motion[t - 2][joint][c], motion[t - 1][joint][c], motion[t][joint][c]];
    a - b - b + e
}

/// Root displacement from frame `t - 1` to `t`, and its length.
fn step<T: Real>(motion: &Motion<T>, t: usize) -> ([T; 3], T) {
    let d = [0, 1, 2].map(|c| motion[t][0][c] - motion[t - 1][0][c]);
    (d, (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt())
}

fn smooth_scale(trajectories: &[(usize, &[usize])], frames: usize) -> f64 {
    match trajectories.len() * frames.saturating_sub(2) {
        0 => 0.0,
        n => 1.0 / n as f64,
    }
}

fn step_scale(frames: usize) -> f64 {
    if frames > 1 { 1.0 / (frames - 1) as f64 } else { 0.0 }
}
