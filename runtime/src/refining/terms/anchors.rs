//! `L_anc = sum_n ||r_n||^2`, `r_n = O_f(x)[tau_n] - y_n`: squared distances from the anchors.

use crate::kernels::sqrt;

use super::super::MotionMap;
use super::super::metric::{ResidualMetric, Residuals};
use super::super::report::ControlError;
use super::super::vector::{bit, scaled, squared_length};
use crate::request::conditions::{AnchorSet, MAX_ANCHORS};

/// How far a motion is from its anchors.
#[derive(Clone, Copy, Debug)]
pub struct Distances {
    /// `L_anc`, square metres.
    pub squares: f32,
    /// `||r_n||` in the order of the set, metres; unused entries are 0.
    pub errors: [f32; MAX_ANCHORS],
}

impl Distances {
    /// Those from no anchors.
    pub const NONE: Self = Self { squares: 0.0, errors: [0.0; MAX_ANCHORS] };

    /// Of the motion that has `position(joint, frame)`.
    #[inline(never)]
    pub fn of(anchors: &AnchorSet, position: &dyn Fn(u8, usize) -> [f32; 3]) -> Self {
        let mut this = Self::NONE;
        for (anchor, slot) in anchors.iter().zip(&mut this.errors) {
            let squared = squared_length(anchor.residual(position(anchor.joint, anchor.frame as usize)));
            this.squares += squared;
            *slot = sqrt(squared);
        }
        this
    }

    /// Mean and largest control error over `anchors`.
    #[must_use]
    #[inline(never)]
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

/// The term, of weight 1.
#[derive(Clone, Copy, Debug)]
pub struct AnchorTerm<'a> {
    anchors: &'a AnchorSet,
}

impl<'a> AnchorTerm<'a> {
    /// Of `anchors`.
    #[must_use]
    pub const fn new(anchors: &'a AnchorSet) -> Self {
        Self { anchors }
    }

    /// The anchored joints, bit j for joint j.
    #[must_use]
    pub fn joints(&self) -> u32 {
        self.anchors.iter().fold(0, |joints, anchor| joints | bit(anchor.joint))
    }

    /// The motion of the last forward pass.
    pub fn distances(&self, map: &impl MotionMap) -> Distances {
        Distances::of(self.anchors, &|joint, frame| map.position(joint, frame))
    }

    /// `dL_anc/dp = 2 r`, or `2 W r`.
    pub(super) fn gather(&self, map: &mut impl MotionMap, metric: Option<&ResidualMetric<'_>>) {
        let mut dual = Residuals::of(self.anchors, map);
        if let Some(metric) = metric {
            metric.apply(&mut dual);
        }
        for (anchor, vector) in self.anchors.iter().zip(dual.vectors()) {
            map.add_gradient(anchor.joint, anchor.frame as usize, scaled(vector, 2.0));
        }
    }
}
