//! Anchors: what must be where, when (EQUATIONS section 2).

use serde::{Deserialize, Serialize};

use super::real::Real;
use super::recover::JOINTS;

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

/// The three control families, in this order wherever there is one number for each; by their names in a control checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Family {
    /// Pelvis in space.
    #[serde(rename = "root3d")]
    Root3d,
    /// Pelvis on the ground plane.
    #[serde(rename = "planar")]
    PlanarRoot,
    /// A joint in space.
    #[serde(rename = "body")]
    BodyPoint,
}

impl core::fmt::Display for Family {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Family::Root3d => "Root-3D",
            Family::PlanarRoot => "Planar-root",
            Family::BodyPoint => "Body-point",
        })
    }
}

impl Family {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Root3d, Self::PlanarRoot, Self::BodyPoint];

    /// Its bit in a set of families, as a blob stores it.
    #[must_use]
    pub fn bit(self) -> u8 {
        match self {
            Family::Root3d => 1,
            Family::PlanarRoot => 2,
            Family::BodyPoint => 4,
        }
    }
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
