//! Anchors on the wire.

use serde::{Deserialize, Serialize};

/// [`motionette::Target`], with the same meaning: metres in the frame of the motion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Target {
    /// Pelvis at `[x, y, z]`.
    Root([f32; 3]),
    /// Pelvis at `[x, z]`, its height free.
    PlanarRoot([f32; 2]),
    /// A joint in SMPL order, 0..22, at `[x, y, z]`.
    Joint {
        /// Index of the joint.
        joint: u8,
        /// Wanted position, metres.
        position: [f32; 3],
    },
}

/// [`motionette::Anchor`]: one target at one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Anchor {
    /// Frame at which the target must be met, 0 = first, 20 a second.
    pub frame: u16,
    /// What must be where.
    pub target: Target,
}

impl From<motionette::Anchor> for Anchor {
    fn from(anchor: motionette::Anchor) -> Self {
        let target = match anchor.target {
            motionette::Target::Root(position) => Target::Root(position),
            motionette::Target::PlanarRoot(position) => Target::PlanarRoot(position),
            motionette::Target::Joint { joint, position } => Target::Joint { joint, position },
        };
        Anchor { frame: anchor.frame, target }
    }
}

impl From<Anchor> for motionette::Anchor {
    fn from(anchor: Anchor) -> Self {
        let target = match anchor.target {
            Target::Root(position) => motionette::Target::Root(position),
            Target::PlanarRoot(position) => motionette::Target::PlanarRoot(position),
            Target::Joint { joint, position } => motionette::Target::Joint { joint, position },
        };
        motionette::Anchor { frame: anchor.frame, target }
    }
}
