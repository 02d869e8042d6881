//! What a control checkpoint says of anchors: the families it was trained with, and the shape and scale of the scaffold.

use serde::{Deserialize, Serialize};

use crate::motion::JOINTS;

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

/// Values of all components.
pub const VALUES: usize = 3 * JOINTS;
/// Components: the pelvis's two, and the other joints.
pub const COMPONENTS: usize = JOINTS + 1;
/// Features of a frame.
pub const WIDTH: usize = 3 * VALUES + 2 * COMPONENTS;

/// Mean and deviation of the values, metres, world frame of a motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// `[VALUES]`
    pub mean: Vec<f32>,
    /// `[VALUES]`, positive
    pub std: Vec<f32>,
}
