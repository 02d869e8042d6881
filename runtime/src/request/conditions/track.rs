//! Tracks: where a joint is to be at many frames, up to all of them.

use core::fmt;

use super::anchors::FARTHEST;
use super::set::AnchorSet;
use crate::JOINTS;
use crate::numerics::vector::Vector;
use crate::request::joint::Joint;

/// Most tracks one request may carry.
pub const MAX_TRACKS: usize = 24;
/// Two conditions of one place contradict each other when they are farther apart than this and their tolerances, metres.
const APART: f32 = 0.001;

/// Where a joint is to be, a frame at a time, in the frame of the motion. Borrowed: a track takes no memory of the request's own.
///
/// ```
/// use motionette::{Joint, Request, Track};
///
/// // The right hand goes up and down in front of the body from frame 10 on, for two seconds.
/// let path: [[f32; 3]; 40] = core::array::from_fn(|i| [-0.3, 1.2 + 0.01 * (i % 20) as f32, 0.4]);
/// let tracks = [Track::new(Joint::RightWrist, 10, &path)];
/// let request = Request::text("a person stands").frames(100).tracks(&tracks);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track<'r> {
    /// Joint in SMPL order, 0 to 21; the pelvis is 0.
    pub joint: u8,
    /// Frame of the first position.
    pub first: u16,
    /// Which of x, y, z count.
    pub axes: [bool; 3],
    /// Which positions count, not 0 for those that do; as many as there are positions. `None`: all.
    pub mask: Option<&'r [u8]>,
    /// Where the joint is to be, one a frame, metres. Those that do not count may hold any finite number.
    pub positions: &'r [[f32; 3]],
    /// How loosely it is followed: the standard deviation around it, metres. 0: as exactly as can be.
    pub tolerance: f32,
}

impl<'r> Track<'r> {
    /// `joint` at `positions`, metres, one a frame from frame `first` on.
    #[must_use]
    pub const fn new(joint: Joint, first: u16, positions: &'r [[f32; 3]]) -> Self {
        Track { joint: joint as u8, first, axes: [true; 3], mask: None, positions, tolerance: 0.0 }
    }

    /// The same, of which only these of x, y, z count.
    #[must_use]
    pub const fn axes(self, axes: [bool; 3]) -> Self {
        Track { axes, ..self }
    }

    /// The same, of which only those positions count whose `mask` is not 0.
    #[must_use]
    pub const fn masked(self, mask: &'r [u8]) -> Self {
        Track { mask: Some(mask), ..self }
    }

    /// The same, followed as loosely as `tolerance` says, metres.
    #[must_use]
    pub const fn within(self, tolerance: f32) -> Self {
        Track { tolerance, ..self }
    }

    /// Where the joint is to be at a frame; `None` where it is free.
    #[must_use]
    pub fn at(&self, frame: usize) -> Option<[f32; 3]> {
        let index = frame.checked_sub(usize::from(self.first))?;
        let counts = self.mask.is_none_or(|mask| mask.get(index).is_some_and(|counts| *counts != 0));
        self.positions.get(index).copied().filter(|_| counts)
    }

    /// Positions that count.
    #[must_use]
    pub fn count(&self) -> usize {
        self.mask.map_or(self.positions.len(), |mask| mask.iter().filter(|counts| **counts != 0).count())
    }

    /// Frames from the first position to the last, whether they count or not.
    pub(crate) fn frames(&self) -> core::ops::Range<usize> {
        let first = usize::from(self.first);
        first..first + self.positions.len()
    }

    /// The last frame of which a position counts.
    pub(crate) fn last(&self) -> Option<usize> {
        self.frames().rev().find(|frame| self.at(*frame).is_some())
    }

    /// Whether it and `place` at a frame, of which `axes` count within `tolerance`, cannot both be met.
    fn contradicts(&self, frame: usize, place: Vector, axes: [bool; 3], tolerance: f32) -> bool {
        let Some(own) = self.at(frame) else { return false };
        let both = self.axes.into_iter().zip(axes).map(|(a, b)| a && b);
        let far = both.zip(own.into_iter().zip(place)).filter(|(both, _)| *both);
        far.fold(0.0, |far, (_, (a, b))| if (a - b).abs() > far { (a - b).abs() } else { far })
            > APART + self.tolerance + tolerance
    }
}

/// Why tracks were refused. `index` counts in the caller's list.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TrackError {
    /// More tracks than a request may carry.
    TooMany {
        /// Length of the caller's list.
        tracks: usize,
        /// Most tracks allowed.
        limit: usize,
    },
    /// Nothing of it counts: no positions, a mask without any, or no axis.
    Nothing {
        /// Track at fault.
        index: usize,
    },
    /// The mask has another length than the positions.
    Mask {
        /// Track at fault.
        index: usize,
        /// Length of its mask.
        found: usize,
        /// Its positions.
        positions: usize,
    },
    /// There is no such joint.
    JointOutOfRange {
        /// Track at fault.
        index: usize,
        /// Its joint.
        joint: u8,
        /// Joints of the skeleton.
        joints: usize,
    },
    /// A position lies behind the end of the motion.
    FrameOutOfRange {
        /// Track at fault.
        index: usize,
        /// Frame of its last position.
        frame: usize,
        /// Frames of the motion.
        frames: usize,
    },
    /// A coordinate is NaN, infinite or farther than [`FARTHEST`].
    Position {
        /// Track at fault.
        index: usize,
        /// Frame of the position.
        frame: usize,
        /// Largest magnitude allowed, metres.
        limit: f32,
    },
    /// A tolerance that is negative, not a number or more than a metre.
    Tolerance {
        /// Track at fault.
        index: usize,
        /// Its tolerance, metres.
        tolerance: f32,
    },
    /// Two tracks want one joint in two places at one frame.
    Conflict {
        /// The earlier track of the two in the caller's list.
        first: usize,
        /// The later one.
        second: usize,
        /// The first frame at which they do.
        frame: usize,
    },
    /// A track and an anchor want one joint in two places at one frame.
    AnchorConflict {
        /// The track.
        track: usize,
        /// The anchor, counted in the caller's list.
        anchor: usize,
        /// Their frame.
        frame: usize,
    },
    /// Tracks and obstacles are met by the edit behind the decoder, which the request's refinement leaves out: take
    /// [`Config::exact`](crate::refining::Config::exact).
    NotExact,
}

impl fmt::Display for TrackError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooMany { tracks, limit } => write!(f, "{tracks} tracks given, a request has at most {limit}"),
            Self::Nothing { index } => {
                write!(f, "track {index}: nothing of it counts; give positions, a mask with some of them, and an axis")
            }
            Self::Mask { index, found, positions } => {
                write!(f, "track {index}: its mask has {found} entries for {positions} positions")
            }
            Self::JointOutOfRange { index, joint, joints } => {
                write!(f, "track {index}: joint {joint} does not exist, the skeleton has {joints}")
            }
            Self::FrameOutOfRange { index, frame, frames } => {
                write!(f, "track {index}: its last frame {frame} is outside the motion of {frames} frames")
            }
            Self::Position { index, frame, limit } => {
                write!(f, "track {index}: at frame {frame} a coordinate is no number or exceeds {limit} m")
            }
            Self::Tolerance { index, tolerance } => {
                write!(f, "track {index}: a tolerance of {tolerance} m; it is 0 to 1 m")
            }
            Self::Conflict { first, second, frame } => {
                write!(f, "tracks {first} and {second} want the same joint in two places at frame {frame}")
            }
            Self::AnchorConflict { track, anchor, frame } => {
                write!(f, "track {track} and anchor {anchor} want the same joint in two places at frame {frame}")
            }
            Self::NotExact => write!(
                f,
                "tracks and obstacles are met by the edit behind the decoder, which this refinement leaves out: take exact"
            ),
        }
    }
}

impl core::error::Error for TrackError {}

/// Checks `tracks` on their own, against each other and against the anchors, for a motion of `frames` frames.
///
/// # Errors
/// The first track at fault, [`TrackError`].
#[inline(never)]
pub fn check(tracks: &[Track<'_>], anchors: &AnchorSet, frames: usize) -> Result<(), TrackError> {
    if tracks.len() > MAX_TRACKS {
        return Err(TrackError::TooMany { tracks: tracks.len(), limit: MAX_TRACKS });
    }
    for (index, track) in tracks.iter().enumerate() {
        check_one(index, track, frames)?;
        for (first, other) in tracks.iter().enumerate().take(index).filter(|(_, other)| other.joint == track.joint) {
            let apart = |frame: &usize| {
                let place = other.at(*frame);
                place.is_some_and(|place| track.contradicts(*frame, place, other.axes, other.tolerance))
            };
            if let Some(frame) = track.frames().find(apart) {
                return Err(TrackError::Conflict { first, second: index, frame });
            }
        }
        for anchor in anchors.iter().filter(|anchor| anchor.joint == track.joint) {
            let frame = usize::from(anchor.frame);
            if track.contradicts(frame, anchor.target, [true, anchor.has_height(), true], 0.0) {
                return Err(TrackError::AnchorConflict { track: index, anchor: usize::from(anchor.index), frame });
            }
        }
    }
    Ok(())
}

fn check_one(index: usize, track: &Track<'_>, frames: usize) -> Result<(), TrackError> {
    if let Some(mask) = track.mask
        && mask.len() != track.positions.len()
    {
        return Err(TrackError::Mask { index, found: mask.len(), positions: track.positions.len() });
    }
    if track.count() == 0 || track.axes == [false; 3] {
        return Err(TrackError::Nothing { index });
    }
    if usize::from(track.joint) >= JOINTS {
        return Err(TrackError::JointOutOfRange { index, joint: track.joint, joints: JOINTS });
    }
    if track.frames().end > frames {
        return Err(TrackError::FrameOutOfRange { index, frame: track.frames().end - 1, frames });
    }
    if !(0.0..=1.0).contains(&track.tolerance) {
        return Err(TrackError::Tolerance { index, tolerance: track.tolerance });
    }
    let wild = |value: &f32| !(-FARTHEST..=FARTHEST).contains(value);
    match track.positions.iter().position(|position| position.iter().any(wild)) {
        Some(at) => Err(TrackError::Position { index, frame: usize::from(track.first) + at, limit: FARTHEST }),
        None => Ok(()),
    }
}
