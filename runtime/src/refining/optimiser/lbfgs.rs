//! Limited-memory BFGS: the two-loop recursion over caller-provided history (Nocedal and Wright, algorithm 7.4).
//!
//! The initial inverse Hessian is `gamma * diag(c)`: `gamma = s.y / y.y` of the newest pair, `c` supplied by the caller for
//! every direction, so that a preconditioner may change from step to step.

use crate::refining::vector::{axpy, broken, dot, rows, rows_mut};

/// Most pairs that can be remembered.
pub const MAX_MEMORY: usize = 8;

/// History of steps and gradient differences.
#[derive(Debug)]
pub struct Lbfgs<'a> {
    /// `[memory][n]`: steps s.
    steps: &'a mut [f32],
    /// `[memory][n]`: gradient differences y.
    changes: &'a mut [f32],
    /// `1 / (s . y)` of every pair.
    inverse_curvature: [f32; MAX_MEMORY],
    memory: usize,
    n: usize,
    /// Pairs held.
    len: usize,
    /// Slot that the next pair takes.
    next: usize,
    gamma: f32,
}

impl<'a> Lbfgs<'a> {
    /// Empty history of `memory` pairs, at most [`MAX_MEMORY`], over `n` variables, in `[memory][n]` numbers each.
    pub fn new(steps: &'a mut [f32], changes: &'a mut [f32], n: usize, memory: usize) -> Self {
        let memory = if memory < MAX_MEMORY { memory } else { MAX_MEMORY };
        invariant!(steps.len() >= n * memory && changes.len() >= n * memory);
        Self { steps, changes, inverse_curvature: [0.0; MAX_MEMORY], memory, n, len: 0, next: 0, gamma: 1.0 }
    }

    /// Forgets every pair.
    pub fn reset(&mut self) {
        self.len = 0;
        self.next = 0;
    }

    /// True without a pair: [`direction`](Self::direction) is then the preconditioned gradient.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Opens a pair with the step `s = scale * direction` taken from a point with `gradient`. The oldest pair gives way
    /// when the history is full.
    pub fn begin(&mut self, direction: &[f32], scale: f32, gradient: &[f32]) {
        if self.len == self.memory {
            self.len = self.len.saturating_sub(1);
        }
        let Some(step) = rows_mut(self.steps, self.n).nth(self.next) else { return broken(()) };
        let Some(change) = rows_mut(self.changes, self.n).nth(self.next) else { return broken(()) };
        for (s, d) in step.iter_mut().zip(direction) {
            *s = scale * d;
        }
        for (y, g) in change.iter_mut().zip(gradient) {
            *y = -g;
        }
    }

    /// Closes the opened pair with the gradient where the step ended. A pair whose curvature is not safely positive is
    /// dropped.
    pub fn complete(&mut self, gradient: &[f32]) {
        let slot = self.next;
        let Some(step) = rows(self.steps, self.n).nth(slot) else { return broken(()) };
        let Some(change) = rows_mut(self.changes, self.n).nth(slot) else { return broken(()) };
        for (y, g) in change.iter_mut().zip(gradient) {
            *y += g;
        }
        let curvature = dot(step, change);
        let (step_square, change_square) = (dot(step, step), dot(change, change));
        // s.y > 1e-4 ||s|| ||y||, squared: rejects noise and negative curvature alike.
        let safe = curvature > 0.0 && curvature * curvature > 1e-8 * (step_square * change_square);
        let (inverse, gamma) = (1.0 / curvature, curvature / change_square);
        if !safe || !inverse.is_finite() || !gamma.is_finite() {
            return;
        }
        if let Some(stored) = self.inverse_curvature.get_mut(slot) {
            *stored = inverse;
        }
        self.gamma = gamma;
        self.next = if slot + 1 < self.memory { slot + 1 } else { 0 };
        if self.len < self.memory {
            self.len += 1;
        }
    }

    /// Slot of the pair remembered `age` pairs ago, 0 = newest.
    fn slot(&self, age: usize) -> usize {
        let back = age + 1;
        if self.next >= back { self.next - back } else { (self.next + self.memory).saturating_sub(back) }
    }

    fn pair(&self, age: usize) -> Option<(&[f32], &[f32], f32)> {
        let slot = self.slot(age);
        let step = rows(self.steps, self.n).nth(slot)?;
        let change = rows(self.changes, self.n).nth(slot)?;
        Some((step, change, *self.inverse_curvature.get(slot)?))
    }

    /// Replaces `gradient` by `-H gradient`. `scale` applies `diag(c)` in place, with the factor it is given.
    pub fn direction(&self, gradient: &mut [f32], scale: impl FnOnce(&mut [f32], f32)) {
        let mut alphas = [0.0; MAX_MEMORY];
        for (age, alpha) in alphas.iter_mut().enumerate().take(self.len) {
            if let Some((step, change, inverse)) = self.pair(age) {
                *alpha = inverse * dot(step, gradient);
                axpy(gradient, -*alpha, change);
            }
        }
        scale(gradient, if self.len > 0 { self.gamma } else { 1.0 });
        for (age, alpha) in alphas.iter().enumerate().take(self.len).rev() {
            if let Some((step, change, inverse)) = self.pair(age) {
                let beta = inverse * dot(change, gradient);
                axpy(gradient, *alpha - beta, step);
            }
        }
        for value in gradient {
            *value = -*value;
        }
    }
}
