//! Anchors: what must be where, when (EQUATIONS section 2).

use super::real::Real;
use super::recover::JOINTS;
pub use crate::checkpoint::anchors::Family;

/// What an anchor fixes, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// Root-3D: the pelvis.
    Root([f64; 3]),
    /// Planar-root: the pelvis seen from above, `(x, z)`.
    PlanarRoot([f64; 2]),
    /// Body-point: any joint.
    Joint {
        /// Joint in SMPL order.
        joint: usize,
        /// Where it must be.
        position: [f64; 3],
    },
}

/// A target at a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    /// Frame, from 0.
    pub frame: usize,
    /// What is fixed.
    pub target: Target,
}

impl Anchor {
    /// Its control family.
    #[must_use]
    pub fn family(&self) -> Family {
        match self.target {
            Target::Root(_) => Family::Root3d,
            Target::PlanarRoot(_) => Family::PlanarRoot,
            Target::Joint { .. } => Family::BodyPoint,
        }
    }

    /// The joint it holds.
    #[must_use]
    pub fn joint(&self) -> usize {
        match self.target {
            Target::Root(_) | Target::PlanarRoot(_) => 0,
            Target::Joint { joint, .. } => joint,
        }
    }

    /// Where it wants the joint; the height that it leaves free is 0.
    #[must_use]
    pub fn position(&self) -> [f64; 3] {
        match self.target {
            Target::Root(position) | Target::Joint { position, .. } => position,
            Target::PlanarRoot([x, z]) => [x, 0.0, z],
        }
    }

    /// Whether it fixes the height.
    #[must_use]
    pub fn fixes_height(&self) -> bool {
        !matches!(self.target, Target::PlanarRoot(_))
    }

    /// Residual `O(x)[tau] - y`; the component that is not fixed is 0.
    #[must_use]
    pub fn residual<T: Real>(&self, motion: &[[[T; 3]; JOINTS]]) -> [T; 3] {
        let p = motion[self.frame][self.joint()];
        match self.target {
            Target::Root(y) | Target::Joint { position: y, .. } => [0, 1, 2].map(|c| p[c] - T::from_f64(y[c])),
            Target::PlanarRoot([x, z]) => [p[0] - T::from_f64(x), T::ZERO, p[2] - T::from_f64(z)],
        }
    }

    /// Control error: length of the residual, metres.
    #[must_use]
    pub fn error<T: Real>(&self, motion: &[[[T; 3]; JOINTS]]) -> f64 {
        self.residual(motion).iter().map(|r| r.to_f64() * r.to_f64()).sum::<f64>().sqrt()
    }
}

/// Mean control error, metres; 0 without anchors.
#[must_use]
pub fn control_error<T: Real>(anchors: &[Anchor], motion: &[[[T; 3]; JOINTS]]) -> f64 {
    anchors.iter().map(|a| a.error(motion)).sum::<f64>() / anchors.len().max(1) as f64
}
