//! What came of tracks and obstacles.

/// How far a motion is from its tracks.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TrackingError {
    /// Mean distance over all positions that count, on the axes that do, metres.
    pub mean: f32,
    /// Largest distance, metres.
    pub worst: f32,
    /// Track with the largest distance, counted in the caller's list.
    pub worst_track: u16,
    /// Its frame.
    pub worst_frame: u16,
}

/// How far a motion keeps clear of its obstacles, half frames counted.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Clearance {
    /// Least distance from a surface, metres; negative inside.
    pub least: f32,
    /// By how much it is less than the obstacle's margin, metres; negative where all of the margin is kept.
    pub missing: f32,
    /// The obstacle, counted in the caller's list.
    pub obstacle: u16,
    /// The joint, or the one at the end of the bone.
    pub joint: u8,
    /// The frame.
    pub frame: u16,
}

impl Clearance {
    /// A margin counts as kept when no more than this of it is missing, metres.
    pub const TOLERANCE: f32 = 0.005;

    /// Whether the figure keeps clear of all obstacles; where it does not, there was no way for it.
    #[must_use]
    pub fn kept(&self) -> bool {
        self.missing <= Self::TOLERANCE
    }
}

/// What came of tracks and obstacles.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Followed {
    /// Distance of the generated motion from the tracks; `None` without tracks.
    pub before: Option<TrackingError>,
    /// Distance of the edited one.
    pub after: Option<TrackingError>,
    /// Positions that could not be followed as fast as they ask for.
    pub hurried: u16,
    /// How near the generated motion came to an obstacle; `None` without obstacles.
    pub clearance_before: Option<Clearance>,
    /// How near the edited one does.
    pub clearance: Option<Clearance>,
}
