//! Anchors: sparse targets the motion must pass through.
//!
//! An anchor says "at this frame, this part of the body is here", in metres, in the frame of the motion (EQUATIONS 1 and
//! 2: the motion starts with the pelvis at x = z = 0 facing +z, y up).

/// Most distinct anchors one request may carry.
pub const MAX_ANCHORS: usize = 32;

/// Largest magnitude of a target's coordinate, metres. Beyond it squared errors lose all precision in `f32`.
pub const FARTHEST: f32 = 1000.0;

/// Control family (EQUATIONS 2): which observation an anchor constrains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Family {
    /// The pelvis in three dimensions.
    Root3d,
    /// The pelvis on the ground plane, x and z.
    PlanarRoot,
    /// Any joint in three dimensions.
    BodyPoint,
}

impl Family {
    /// Its bit in a set of families.
    #[must_use]
    pub const fn bit(self) -> u8 {
        match self {
            Family::Root3d => 1,
            Family::PlanarRoot => 2,
            Family::BodyPoint => 4,
        }
    }
}

/// The set of all families.
pub const FAMILIES: u8 = Family::Root3d.bit() | Family::PlanarRoot.bit() | Family::BodyPoint.bit();

/// Controlled part and its wanted position, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Target {
    /// Root-3D: pelvis at `[x, y, z]`.
    Root([f32; 3]),
    /// Planar-root: pelvis at `[x, z]`, its height free.
    PlanarRoot([f32; 2]),
    /// Body-point: joint `joint` (SMPL order, 0..22) at `position`.
    Joint {
        /// Index of the joint in SMPL order.
        joint: u8,
        /// Wanted position `[x, y, z]`, metres.
        position: [f32; 3],
    },
}

impl Target {
    /// Control family this target belongs to.
    pub const fn family(&self) -> Family {
        match self {
            Target::Root(_) => Family::Root3d,
            Target::PlanarRoot(_) => Family::PlanarRoot,
            Target::Joint { .. } => Family::BodyPoint,
        }
    }
}

/// One target at one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Anchor {
    /// Frame at which the target must be met, 0 = first.
    pub frame: u16,
    /// What must be where.
    pub target: Target,
}

impl Anchor {
    /// Root-3D anchor: pelvis at `position` (metres) at `frame`.
    pub const fn root(frame: u16, position: [f32; 3]) -> Self {
        Self { frame, target: Target::Root(position) }
    }

    /// Planar-root anchor: pelvis at `[x, z]` (metres) at `frame`.
    pub const fn planar_root(frame: u16, position: [f32; 2]) -> Self {
        Self { frame, target: Target::PlanarRoot(position) }
    }

    /// Body-point anchor: `joint` (SMPL order) at `position` (metres) at `frame`.
    pub const fn joint(frame: u16, joint: u8, position: [f32; 3]) -> Self {
        Self { frame, target: Target::Joint { joint, position } }
    }
}
