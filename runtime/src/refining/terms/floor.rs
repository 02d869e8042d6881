//! The smallest second term there is, to show what one takes: `L_floor = mean_t max(h - y[t], 0)^2` of one joint.

use super::super::MotionMap;
use super::super::vector::{bit, larger};

/// Keeps a joint above a height.
#[derive(Clone, Copy, Debug)]
pub struct Floor {
    /// Weight of the term.
    pub weight: f32,
    /// The joint.
    pub joint: u8,
    /// Metres.
    pub height: f32,
}

impl Floor {
    pub(super) const fn joints(&self) -> u32 {
        bit(self.joint)
    }

    fn below(&self, map: &impl MotionMap, frame: usize) -> f32 {
        let [_, y, _] = map.position(self.joint, frame);
        larger(self.height - y, 0.0)
    }

    pub(super) fn value(&self, map: &impl MotionMap) -> f32 {
        let frames = map.grid().frames();
        let sum: f32 = (0..frames).map(|frame| self.below(map, frame)).map(|below| below * below).sum();
        self.weight * sum / frames as f32
    }

    pub(super) fn gather(&self, map: &mut impl MotionMap) {
        let frames = map.grid().frames();
        for frame in 0..frames {
            let below = self.below(map, frame);
            map.add_gradient(self.joint, frame, [0.0, -2.0 * self.weight * below / frames as f32, 0.0]);
        }
    }
}
