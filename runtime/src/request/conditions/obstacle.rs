//! Obstacles: bodies in the room, at rest or moving, that the figure keeps clear of.

use core::fmt;

use super::anchors::FARTHEST;
use super::set::AnchorSet;
use super::track::Track;
use crate::JOINTS;
pub use crate::numerics::solid::Shape;
use crate::numerics::solid::Solid;
use crate::numerics::vector::{Vector, add, length, scale, subtract};

/// Most obstacles one request may have.
pub const MAX_OBSTACLES: usize = 16;
/// No obstacle moves faster, metres a second.
pub const FASTEST_OBSTACLE: f32 = 20.0;
/// All joints, as [`Obstacle::joints`] has them.
pub const ALL_JOINTS: u32 = (1 << JOINTS) - 1;

/// Where an obstacle's middle is at a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Keyframe {
    /// The frame.
    pub frame: u16,
    /// The middle, metres.
    pub position: [f32; 3],
}

/// How an obstacle moves.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Course<'r> {
    /// Its middle stays there, metres.
    Still([f32; 3]),
    /// Its middle goes on at one speed.
    Moving {
        /// The middle at frame 0, metres.
        from: [f32; 3],
        /// Metres a second.
        velocity: [f32; 3],
    },
    /// Its middle goes from keyframe to keyframe in straight lines; before the first and behind the last it stays.
    Keyframes(&'r [Keyframe]),
}

/// A body that joints and the bones between them keep clear of.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Obstacle<'r> {
    /// Its form, around its middle.
    pub shape: Shape,
    /// Where its middle is.
    pub course: Course<'r>,
    /// How far the figure keeps away from its surface, metres.
    pub margin: f32,
    /// The joints that keep clear, bit j for joint j, each with the bone from its parent; [`ALL_JOINTS`] for the whole figure.
    pub joints: u32,
}

impl<'r> Obstacle<'r> {
    /// A body at rest with its middle at `position`, metres; the whole figure keeps 5 cm away from it.
    #[must_use]
    pub const fn new(shape: Shape, position: [f32; 3]) -> Self {
        Obstacle { shape, course: Course::Still(position), margin: 0.05, joints: ALL_JOINTS }
    }

    /// The same, moving.
    #[must_use]
    pub const fn moving(self, course: Course<'r>) -> Self {
        Obstacle { course, ..self }
    }

    /// The same with another margin, metres.
    #[must_use]
    pub const fn margin(self, margin: f32) -> Self {
        Obstacle { margin, ..self }
    }

    /// The same, of which only these joints keep clear.
    #[must_use]
    pub const fn joints(self, joints: u32) -> Self {
        Obstacle { joints, ..self }
    }

    /// Where its middle is at half a frame's number, of frames of which there are `frame_rate` a second, metres.
    fn middle(&self, halves: usize, frame_rate: u16) -> Vector {
        let frame = 0.5 * halves as f32;
        match self.course {
            Course::Still(position) => position,
            Course::Moving { from, velocity } => add(from, scale(velocity, frame / rate(frame_rate))),
            Course::Keyframes(frames) => {
                let after = frames.iter().position(|key| f32::from(key.frame) > frame);
                let [last, next] = match after {
                    Some(0) => [frames.first(); 2],
                    Some(next) => [frames.get(next - 1), frames.get(next)],
                    None => [frames.last(); 2],
                };
                let (Some(last), Some(next)) = (last, next) else { return [0.0; 3] };
                let gap = f32::from(next.frame) - f32::from(last.frame);
                let share = if gap > 0.0 { (frame - f32::from(last.frame)) / gap } else { 0.0 };
                add(last.position, scale(subtract(next.position, last.position), share))
            }
        }
    }

    /// The body as it stands at half a frame's number.
    pub(crate) fn at(&self, halves: usize, frame_rate: u16) -> Solid {
        Solid { shape: self.shape, middle: self.middle(halves, frame_rate), margin: self.margin }
    }

    /// Where its middle is at a frame, metres.
    #[must_use]
    pub fn position(&self, frame: u16, frame_rate: u16) -> [f32; 3] {
        self.middle(2 * usize::from(frame), frame_rate)
    }

    /// How far a point is from its surface at a frame, metres; negative inside.
    #[must_use]
    pub fn distance(&self, point: [f32; 3], frame: u16, frame_rate: u16) -> f32 {
        self.at(2 * usize::from(frame), frame_rate).distance(point)
    }
}

fn rate(frame_rate: u16) -> f32 {
    f32::from(if frame_rate > 0 { frame_rate } else { 1 })
}

/// Why obstacles were refused. `index` counts in the caller's list.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ObstacleError {
    /// More obstacles than a request may have.
    TooMany {
        /// Length of the caller's list.
        obstacles: usize,
        /// Most obstacles allowed.
        limit: usize,
    },
    /// A size that is not above 0 and at most 100 m, or a plane without a direction.
    Size {
        /// Obstacle at fault.
        index: usize,
    },
    /// A margin that is not between 0 and 1 m.
    Margin {
        /// Obstacle at fault.
        index: usize,
        /// Its margin, metres.
        margin: f32,
    },
    /// A place or velocity that is NaN, infinite or farther than [`FARTHEST`].
    Place {
        /// Obstacle at fault.
        index: usize,
    },
    /// It moves faster than [`FASTEST_OBSTACLE`].
    TooFast {
        /// Obstacle at fault.
        index: usize,
        /// Its speed, metres a second.
        speed: f32,
        /// Most of it.
        limit: f32,
    },
    /// No keyframes, or one that does not come after the one before it.
    Keyframes {
        /// Obstacle at fault.
        index: usize,
        /// The keyframe.
        keyframe: usize,
    },
    /// No joint keeps clear of it, or one that there is not.
    Joints {
        /// Obstacle at fault.
        index: usize,
    },
    /// An anchor lies inside it.
    AnchorInside {
        /// Obstacle at fault.
        index: usize,
        /// The anchor, counted in the caller's list.
        anchor: usize,
    },
    /// A track passes through it.
    TrackInside {
        /// Obstacle at fault.
        index: usize,
        /// The track, counted in the caller's list.
        track: usize,
        /// The first frame at which it is inside.
        frame: usize,
    },
}

impl fmt::Display for ObstacleError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooMany { obstacles, limit } => {
                write!(f, "{obstacles} obstacles given, a request has at most {limit}")
            }
            Self::Size { index } => {
                write!(f, "obstacle {index}: its sizes must be above 0 and at most 100 m, a plane needs a direction")
            }
            Self::Margin { index, margin } => write!(f, "obstacle {index}: a margin of {margin} m; it is 0 to 1 m"),
            Self::Place { index } => {
                write!(f, "obstacle {index}: a place or velocity is no number or exceeds {FARTHEST}")
            }
            Self::TooFast { index, speed, limit } => {
                write!(f, "obstacle {index}: it moves at {speed} m/s, at most {limit} are allowed")
            }
            Self::Keyframes { index, keyframe } => {
                write!(f, "obstacle {index}: keyframe {keyframe} is missing or not behind the one before it")
            }
            Self::Joints { index } => {
                write!(f, "obstacle {index}: joints 0 to 21 can keep clear, at least one of them")
            }
            Self::AnchorInside { index, anchor } => write!(f, "obstacle {index}: anchor {anchor} lies inside it"),
            Self::TrackInside { index, track, frame } => {
                write!(f, "obstacle {index}: track {track} is inside it at frame {frame}")
            }
        }
    }
}

impl core::error::Error for ObstacleError {}

/// Checks `obstacles` on their own, and that neither anchors nor tracks lie inside one.
///
/// # Errors
/// The first obstacle at fault, [`ObstacleError`].
#[inline(never)]
pub fn check(
    obstacles: &[Obstacle<'_>],
    anchors: &AnchorSet,
    tracks: &[Track<'_>],
    frame_rate: u16,
) -> Result<(), ObstacleError> {
    if obstacles.len() > MAX_OBSTACLES {
        return Err(ObstacleError::TooMany { obstacles: obstacles.len(), limit: MAX_OBSTACLES });
    }
    for (index, obstacle) in obstacles.iter().enumerate() {
        check_one(index, obstacle, frame_rate)?;
        let inside = |joint: u8, place: Vector, frame: usize| {
            obstacle.joints >> joint & 1 == 1 && obstacle.at(2 * frame, frame_rate).distance(place) < 0.0
        };
        for anchor in anchors.iter().filter(|anchor| anchor.has_height()) {
            if inside(anchor.joint, anchor.target, usize::from(anchor.frame)) {
                return Err(ObstacleError::AnchorInside { index, anchor: usize::from(anchor.index) });
            }
        }
        for (number, track) in tracks.iter().enumerate().filter(|(_, track)| track.axes == [true; 3]) {
            let hit = |frame: &usize| track.at(*frame).is_some_and(|place| inside(track.joint & 31, place, *frame));
            if let Some(frame) = track.frames().find(hit) {
                return Err(ObstacleError::TrackInside { index, track: number, frame });
            }
        }
    }
    Ok(())
}

fn check_one(index: usize, obstacle: &Obstacle<'_>, frame_rate: u16) -> Result<(), ObstacleError> {
    let good = |size: f32| size > 0.0 && size <= 100.0;
    let finite = |vector: Vector| vector.iter().all(|value| (-FARTHEST..=FARTHEST).contains(value));
    let sized = match obstacle.shape {
        Shape::Sphere { radius } => good(radius),
        Shape::Capsule { half, radius } => good(radius) && half.iter().all(|value| value.abs() <= 100.0),
        Shape::Cylinder { radius, half_height } => good(radius) && good(half_height),
        Shape::Box { half } => half.into_iter().all(good),
        Shape::Plane { normal } => finite(normal) && length(normal) > 1e-3,
    };
    if !sized {
        return Err(ObstacleError::Size { index });
    }
    if !(0.0..=1.0).contains(&obstacle.margin) {
        return Err(ObstacleError::Margin { index, margin: obstacle.margin });
    }
    if obstacle.joints == 0 || obstacle.joints & !ALL_JOINTS != 0 {
        return Err(ObstacleError::Joints { index });
    }
    let placed = match obstacle.course {
        Course::Still(position) => finite(position),
        Course::Moving { from, velocity } => finite(from) && finite(velocity),
        Course::Keyframes(frames) => frames.iter().all(|key| finite(key.position)),
    };
    if !placed {
        return Err(ObstacleError::Place { index });
    }
    let mut fastest = 0.0;
    match obstacle.course {
        Course::Still(_) => {}
        Course::Moving { velocity, .. } => fastest = length(velocity),
        Course::Keyframes(frames) => {
            if frames.is_empty() {
                return Err(ObstacleError::Keyframes { index, keyframe: 0 });
            }
            for (number, (a, b)) in frames.iter().zip(frames.iter().skip(1)).enumerate() {
                if b.frame <= a.frame {
                    return Err(ObstacleError::Keyframes { index, keyframe: number + 1 });
                }
                let seconds = f32::from(b.frame - a.frame) / rate(frame_rate);
                let speed = length(subtract(b.position, a.position)) / seconds;
                fastest = if speed > fastest { speed } else { fastest };
            }
        }
    }
    if fastest > FASTEST_OBSTACLE {
        return Err(ObstacleError::TooFast { index, speed: fastest, limit: FASTEST_OBSTACLE });
    }
    Ok(())
}
