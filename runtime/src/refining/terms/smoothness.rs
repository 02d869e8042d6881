//! `L_sm = mean_b mean_t ||q_b[t+2] - 2 q_b[t+1] + q_b[t]||^2`: the anchored joints move smoothly.
//!
//! `q_b` are the distinct controlled trajectories: one for each joint that carries an anchor, over x and z, and over y when an anchor
//! of that joint fixes its height.

use super::super::MotionMap;
use super::super::vector::{bit, scaled, squared_length};
use crate::JOINTS;
use crate::request::conditions::AnchorSet;

/// The term with its weight.
#[derive(Clone, Copy, Debug)]
pub struct Smoothness {
    weight: f32,
    /// Bit j: joint j is controlled.
    controlled: u32,
    /// Bit j: the height of joint j is controlled.
    heights: u32,
}

impl Smoothness {
    /// Of the joints that carry `anchors`, with weight `g_sm`.
    #[must_use]
    pub fn new(anchors: &AnchorSet, weight: f32) -> Self {
        let (mut controlled, mut heights) = (0, 0);
        for anchor in anchors.iter() {
            let bit = bit(anchor.joint);
            controlled |= bit;
            if anchor.has_height() {
                heights |= bit;
            }
        }
        Self { weight, controlled, heights }
    }

    /// The controlled joints, bit j for joint j.
    #[must_use]
    pub const fn joints(&self) -> u32 {
        self.controlled
    }

    /// `1 / (trajectories * second differences)`, 0 when there are none.
    fn mean(&self, frames: usize) -> f32 {
        let terms = self.controlled.count_ones() as usize * frames.saturating_sub(2);
        if terms > 0 { 1.0 / terms as f32 } else { 0.0 }
    }

    fn controlled_joints(&self) -> impl Iterator<Item = u8> + use<> {
        let controlled = self.controlled;
        (0..JOINTS as u8).filter(move |&joint| controlled & bit(joint) != 0)
    }

    /// Second difference ending at `frame`, of the controlled axes only.
    fn bend(&self, history: &[[f32; 3]; 3], joint: u8) -> [f32; 3] {
        let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = *history;
        let y = if self.heights & bit(joint) != 0 { cy - 2.0 * by + ay } else { 0.0 };
        [cx - 2.0 * bx + ax, y, cz - 2.0 * bz + az]
    }

    /// `g_sm L_sm`.
    pub fn value(&self, map: &impl MotionMap) -> f32 {
        let frames = map.grid().frames();
        let mut sum = 0.0;
        for joint in self.controlled_joints() {
            let mut history = [[0.0; 3]; 3];
            for frame in 0..frames {
                let [_, b, c] = history;
                history = [b, c, map.position(joint, frame)];
                if frame >= 2 {
                    sum += squared_length(self.bend(&history, joint));
                }
            }
        }
        self.weight * (sum * self.mean(frames))
    }

    /// `dL_sm/dq[t] = 2 mean (D[t] - 2 D[t+1] + D[t+2])`, `D[t]` being the second difference that ends at t.
    pub(super) fn gather(&self, map: &mut impl MotionMap) {
        let frames = map.grid().frames();
        let scale = 2.0 * self.weight * self.mean(frames);
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
}
