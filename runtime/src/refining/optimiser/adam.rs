//! Adam (Kingma and Ba 2015), the OptStep of RouteSolver as published here.
//!
//! ```text
//! m <- b1 m + (1 - b1) g      v <- b2 v + (1 - b2) g^2
//! step = -rate * (m / (1 - b1^t)) / (sqrt(v / (1 - b2^t)) + eps)
//! ```

use crate::kernels::sqrt;

use crate::refining::vector::clear;

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const EPSILON: f32 = 1e-8;

/// Moments of Adam over caller-provided slices.
#[derive(Debug)]
pub struct Adam<'a> {
    first: &'a mut [f32],
    second: &'a mut [f32],
    beta1_power: f32,
    beta2_power: f32,
}

impl<'a> Adam<'a> {
    /// Starts with zero moments; both slices have the length of the variable.
    pub fn new(first: &'a mut [f32], second: &'a mut [f32]) -> Self {
        clear(first);
        clear(second);
        Self { first, second, beta1_power: 1.0, beta2_power: 1.0 }
    }

    /// Replaces `gradient` by the step of learning rate `rate`.
    pub fn step(&mut self, gradient: &mut [f32], rate: f32) {
        self.beta1_power *= BETA1;
        self.beta2_power *= BETA2;
        let first_scale = 1.0 / (1.0 - self.beta1_power);
        let second_scale = 1.0 / (1.0 - self.beta2_power);
        for ((g, m), v) in gradient.iter_mut().zip(self.first.iter_mut()).zip(self.second.iter_mut()) {
            *m = BETA1 * *m + (1.0 - BETA1) * *g;
            *v = BETA2 * *v + (1.0 - BETA2) * (*g * *g);
            *g = -rate * (*m * first_scale) / (sqrt(*v * second_scale) + EPSILON);
        }
    }
}
