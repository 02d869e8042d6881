//! `L_feas = mean_t max(||p[t+1] - p[t]|| - vmax, 0)^2`: the root does not move faster than a body can.

use crate::kernels::sqrt;

use super::super::MotionMap;
use super::super::vector::{bit, difference, larger, scaled, squared_length};

/// The pelvis, whose speed is limited.
const ROOT: u8 = 0;

/// The term with its weight.
#[derive(Clone, Copy, Debug)]
pub struct Feasibility {
    weight: f32,
    max_step: f32,
}

impl Feasibility {
    /// Joints that it reads.
    pub const JOINTS: u32 = bit(ROOT);

    /// With weight `g_feas` and `vmax`, metres a frame.
    #[must_use]
    pub const fn new(weight: f32, max_step: f32) -> Self {
        Self { weight, max_step }
    }

    fn mean(frames: usize) -> f32 {
        if frames > 1 { 1.0 / (frames - 1) as f32 } else { 0.0 }
    }

    /// `g_feas L_feas`.
    pub fn value(&self, map: &impl MotionMap) -> f32 {
        let frames = map.grid().frames();
        let mut sum = 0.0;
        let mut old = map.position(ROOT, 0);
        for frame in 1..frames {
            let new = map.position(ROOT, frame);
            let excess = larger(sqrt(squared_length(difference(new, old))) - self.max_step, 0.0);
            sum += excess * excess;
            old = new;
        }
        self.weight * (sum * Self::mean(frames))
    }

    pub(super) fn gather(&self, map: &mut impl MotionMap) {
        let frames = map.grid().frames();
        let scale = 2.0 * self.weight * Self::mean(frames);
        let mut old = map.position(ROOT, 0);
        for frame in 1..frames {
            let new = map.position(ROOT, frame);
            let step = difference(new, old);
            let length = sqrt(squared_length(step));
            if length > self.max_step && length > 0.0 {
                let pull = scale * (length - self.max_step) / length;
                map.add_gradient(ROOT, frame, scaled(step, pull));
                map.add_gradient(ROOT, frame - 1, scaled(step, -pull));
            }
            old = new;
        }
    }
}
