//! The objective of refinement and its gradient with respect to joint positions (AnchorRoute eq. 26-28, EQUATIONS 5).
//!
//! ```text
//! J(u)   = L_anc + g_sm L_sm + g_tr ||u - u0||^2 + g_feas L_feas
//! L_anc  = sum_n ||r_n||^2                       r_n = O_f(x)[tau_n] - y_n
//! L_sm   = mean_b mean_t ||q_b[t+2] - 2 q_b[t+1] + q_b[t]||^2
//! L_feas = mean_t max(||p[t+1] - p[t]|| - vmax, 0)^2
//! ```
//! `q_b` are the distinct controlled trajectories: one for each joint that carries an anchor, over x and z, and over y
//! when an anchor of that joint fixes its height. `p` is the root.

use libm::sqrtf;

use super::MotionMap;
use super::config::Config;
use super::report::ControlError;
use super::residual_metric::Residuals;
use super::vector::larger;
use crate::JOINTS;
use crate::perception::anchors::{AnchorSet, MAX_ANCHORS};

/// The pelvis, whose speed the feasibility term limits.
const ROOT: u8 = 0;

/// Terms of `J` that depend on the motion, measured at one point, and the distance of every anchor.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// `L_anc`, square metres.
    pub anchors: f32,
    /// `L_sm`.
    pub smoothness: f32,
    /// `L_feas`.
    pub feasibility: f32,
    /// `||r_n||` in the order of the set, metres; unused entries are 0.
    pub errors: [f32; MAX_ANCHORS],
}

impl Measured {
    /// Mean and largest control error over `anchors`.
    pub fn control_error(&self, anchors: &AnchorSet) -> ControlError {
        let (mut sum, mut count) = (0.0, 0.0);
        let (mut worst, mut worst_anchor) = (0.0, 0);
        for (index, (anchor, &error)) in anchors.iter().zip(&self.errors).enumerate() {
            sum += error;
            count += 1.0;
            if index == 0 || error > worst {
                (worst, worst_anchor) = (error, anchor.index);
            }
        }
        ControlError { mean: if count > 0.0 { sum / count } else { 0.0 }, worst, worst_anchor }
    }
}

/// `J` for one set of anchors.
#[derive(Clone, Copy, Debug)]
pub struct Objective<'a> {
    /// Anchors to meet.
    pub anchors: &'a AnchorSet,
    smoothness: f32,
    feasibility: f32,
    max_step: f32,
    /// Bit j: joint j is controlled.
    controlled: u32,
    /// Bit j: the height of joint j is controlled.
    heights: u32,
}

impl<'a> Objective<'a> {
    /// Objective of `anchors` with the weights of `config`. The trust-region term belongs to the solver, which holds `u`.
    pub fn new(anchors: &'a AnchorSet, config: &Config) -> Self {
        let (mut controlled, mut heights) = (0, 0);
        for anchor in anchors.iter() {
            let bit = bit(anchor.joint);
            controlled |= bit;
            if anchor.has_height() {
                heights |= bit;
            }
        }
        let Config { smoothness, feasibility, max_step, .. } = *config;
        Self { anchors, smoothness, feasibility, max_step, controlled, heights }
    }

    /// Measures the motion of the last forward pass.
    pub fn measure(&self, map: &impl MotionMap) -> Measured {
        let mut errors = [0.0; MAX_ANCHORS];
        let mut sum = 0.0;
        for (anchor, slot) in self.anchors.iter().zip(&mut errors) {
            let squared = squared_length(anchor.residual(map.position(anchor.joint, anchor.frame as usize)));
            sum += squared;
            *slot = sqrtf(squared);
        }
        let smoothness = if self.smoothness > 0.0 { self.smoothness_term(map) } else { 0.0 };
        let feasibility = if self.feasibility > 0.0 { self.feasibility_term(map) } else { 0.0 };
        Measured { anchors: sum, smoothness, feasibility, errors }
    }

    /// `L_anc + g_sm L_sm + g_feas L_feas`.
    pub fn weighted(&self, measured: &Measured) -> f32 {
        measured.anchors + self.smoothness * measured.smoothness + self.feasibility * measured.feasibility
    }

    /// Clears the map's gradient and gathers that of [`weighted`](Self::weighted) at the motion of the last forward pass.
    pub fn gather(&self, map: &mut impl MotionMap) {
        let residuals = Residuals::of(self.anchors, map);
        self.gather_dual(map, &residuals);
    }

    /// As [`gather`](Self::gather) with `W r` in the place of the residuals r: the gradient with `r^T W r` for `L_anc`.
    pub fn gather_dual(&self, map: &mut impl MotionMap, dual: &Residuals) {
        map.clear_gradient();
        for (anchor, vector) in self.anchors.iter().zip(dual.vectors()) {
            map.add_gradient(anchor.joint, anchor.frame as usize, scaled(vector, 2.0));
        }
        if self.smoothness > 0.0 {
            self.gather_smoothness(map);
        }
        if self.feasibility > 0.0 {
            self.gather_feasibility(map);
        }
    }

    /// `1 / (trajectories * second differences)`, 0 when there are none.
    fn smoothness_mean(&self, frames: usize) -> f32 {
        let terms = self.controlled.count_ones() as usize * frames.saturating_sub(2);
        if terms > 0 { 1.0 / terms as f32 } else { 0.0 }
    }

    fn controlled_joints(&self) -> impl Iterator<Item = u8> {
        let controlled = self.controlled;
        (0..JOINTS as u8).filter(move |&joint| controlled & bit(joint) != 0)
    }

    /// Second difference ending at `frame`, of the controlled axes only.
    fn bend(&self, history: &[[f32; 3]; 3], joint: u8) -> [f32; 3] {
        let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = *history;
        let y = if self.heights & bit(joint) != 0 { cy - 2.0 * by + ay } else { 0.0 };
        [cx - 2.0 * bx + ax, y, cz - 2.0 * bz + az]
    }

    fn smoothness_term(&self, map: &impl MotionMap) -> f32 {
        let mut sum = 0.0;
        for joint in self.controlled_joints() {
            let mut history = [[0.0; 3]; 3];
            for frame in 0..map.grid().frames() {
                let [_, b, c] = history;
                history = [b, c, map.position(joint, frame)];
                if frame >= 2 {
                    sum += squared_length(self.bend(&history, joint));
                }
            }
        }
        sum * self.smoothness_mean(map.grid().frames())
    }

    /// `dL_sm/dq[t] = 2 mean (D[t] - 2 D[t+1] + D[t+2])`, `D[t]` being the second difference that ends at t.
    fn gather_smoothness(&self, map: &mut impl MotionMap) {
        let frames = map.grid().frames();
        let scale = 2.0 * self.smoothness * self.smoothness_mean(frames);
        for joint in self.controlled_joints() {
            let mut history = [[0.0; 3]; 3];
            // Second differences ending at t, t - 1 and t - 2; the gradient of frame t - 2 is complete then.
            let (mut last, mut before) = ([0.0; 3], [0.0; 3]);
            for end in 0..frames + 2 {
                let mut bend = [0.0; 3];
                if end < frames {
                    let [_, b, c] = history;
                    history = [b, c, map.position(joint, end)];
                    if end >= 2 {
                        bend = self.bend(&history, joint);
                    }
                }
                if end >= 2 {
                    let ([ax, ay, az], [bx, by, bz], [cx, cy, cz]) = (before, last, bend);
                    let d = [ax - 2.0 * bx + cx, ay - 2.0 * by + cy, az - 2.0 * bz + cz];
                    map.add_gradient(joint, end - 2, scaled(d, scale));
                }
                (before, last) = (last, bend);
            }
        }
    }

    fn step_mean(frames: usize) -> f32 {
        if frames > 1 { 1.0 / (frames - 1) as f32 } else { 0.0 }
    }

    fn feasibility_term(&self, map: &impl MotionMap) -> f32 {
        let mut sum = 0.0;
        let mut old = map.position(ROOT, 0);
        for frame in 1..map.grid().frames() {
            let new = map.position(ROOT, frame);
            let excess = larger(sqrtf(squared_length(difference(new, old))) - self.max_step, 0.0);
            sum += excess * excess;
            old = new;
        }
        sum * Self::step_mean(map.grid().frames())
    }

    fn gather_feasibility(&self, map: &mut impl MotionMap) {
        let scale = 2.0 * self.feasibility * Self::step_mean(map.grid().frames());
        let mut old = map.position(ROOT, 0);
        for frame in 1..map.grid().frames() {
            let new = map.position(ROOT, frame);
            let step = difference(new, old);
            let length = sqrtf(squared_length(step));
            if length > self.max_step && length > 0.0 {
                let pull = scale * (length - self.max_step) / length;
                map.add_gradient(ROOT, frame, scaled(step, pull));
                map.add_gradient(ROOT, frame - 1, scaled(step, -pull));
            }
            old = new;
        }
    }
}

const fn bit(joint: u8) -> u32 {
    1u32.wrapping_shl(joint as u32)
}

fn squared_length([x, y, z]: [f32; 3]) -> f32 {
    x * x + y * y + z * z
}

fn difference([ax, ay, az]: [f32; 3], [bx, by, bz]: [f32; 3]) -> [f32; 3] {
    [ax - bx, ay - by, az - bz]
}

fn scaled([x, y, z]: [f32; 3], scale: f32) -> [f32; 3] {
    [scale * x, scale * y, scale * z]
}
