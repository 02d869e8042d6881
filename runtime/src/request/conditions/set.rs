//! A request's anchors, checked: [`AnchorSet::of`] looks at a caller's list once; everything behind it works on a sorted set without
//! duplicates, in which no number is infinite or NaN.

use core::fmt;
use core::mem::swap;

use super::anchors::{Anchor, FARTHEST, Family, MAX_ANCHORS, Target};
use super::authoring::AnchorList;
use super::track::Track;
use crate::JOINTS;

/// Why a list of anchors was refused. `index` counts in the caller's list.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AnchorError {
    /// More distinct anchors than a request may carry.
    TooMany {
        /// Length of the caller's list.
        anchors: usize,
        /// Most distinct anchors allowed.
        limit: usize,
    },
    /// A time before the start, so late that its frame cannot be counted in 16 bits, or not a number.
    Time {
        /// Anchor at fault.
        index: usize,
        /// Its time.
        seconds: f32,
    },
    /// The frame lies behind the end of the motion.
    FrameOutOfRange {
        /// Anchor at fault.
        index: usize,
        /// Its frame.
        frame: u16,
        /// Frames of the motion.
        frames: usize,
    },
    /// There is no such joint.
    JointOutOfRange {
        /// Anchor at fault.
        index: usize,
        /// Its joint.
        joint: u8,
        /// Joints of the skeleton.
        joints: usize,
    },
    /// A coordinate is NaN or infinite.
    NotFinite {
        /// Anchor at fault.
        index: usize,
    },
    /// A coordinate exceeds [`FARTHEST`].
    TooFar {
        /// Anchor at fault.
        index: usize,
        /// Largest magnitude allowed, metres.
        limit: f32,
    },
    /// Two anchors want one joint in two places at one frame.
    Conflict {
        /// The earlier anchor of the two in the caller's list.
        first: usize,
        /// The later anchor.
        second: usize,
    },
}

impl fmt::Display for AnchorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooMany { anchors, limit } => {
                write!(f, "{anchors} anchors given, at most {limit} distinct ones fit in a request")
            }
            Self::Time { index, seconds } => {
                write!(f, "anchor {index}: {seconds} s is no time in a motion; times count from 0")
            }
            Self::FrameOutOfRange { index, frame, frames } => {
                write!(f, "anchor {index}: frame {frame} is outside the motion of {frames} frames")
            }
            Self::JointOutOfRange { index, joint, joints } => {
                write!(f, "anchor {index}: joint {joint} does not exist, the skeleton has {joints}")
            }
            Self::NotFinite { index } => write!(f, "anchor {index}: a coordinate is NaN or infinite"),
            Self::TooFar { index, limit } => write!(f, "anchor {index}: a coordinate exceeds {limit} m"),
            Self::Conflict { first, second } => {
                write!(f, "anchors {first} and {second} want the same joint in two places at one frame")
            }
        }
    }
}

impl core::error::Error for AnchorError {}

/// A checked anchor as the solver sees it: joint, axes and target in one form for all families.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Observed {
    /// Wanted position `[x, y, z]`, metres; y is 0 and unused for Planar-root.
    pub target: [f32; 3],
    /// Frame.
    pub frame: u16,
    /// Position of the anchor in the caller's list.
    pub index: u16,
    /// Joint in SMPL order; the pelvis is 0.
    pub joint: u8,
    /// Family, which decides whether y counts.
    pub family: Family,
}

impl Observed {
    const EMPTY: Self = Self { target: [0.0; 3], frame: 0, index: 0, joint: 0, family: Family::Root3d };

    fn new(index: usize, anchor: &Anchor) -> Self {
        let (joint, target) = match anchor.target {
            Target::Root(p) => (0, p),
            Target::PlanarRoot([x, z]) => (0, [x, 0.0, z]),
            Target::Joint { joint, position } => (joint, position),
        };
        let index = if index < u16::MAX as usize { index as u16 } else { u16::MAX };
        Self { target, frame: anchor.frame, index, joint, family: anchor.target.family() }
    }

    /// True when the height counts.
    pub const fn has_height(&self) -> bool {
        !matches!(self.family, Family::PlanarRoot)
    }

    /// `O_f(x) - y` for the observed joint at `position`, metres; the y component is 0 for Planar-root.
    pub fn residual(&self, position: [f32; 3]) -> [f32; 3] {
        let [x, y, z] = position;
        let [tx, ty, tz] = self.target;
        [x - tx, if self.has_height() { y - ty } else { 0.0 }, z - tz]
    }

    /// True when both speak of one joint at one frame.
    fn same_place(&self, other: &Self) -> bool {
        self.frame == other.frame && self.joint == other.joint
    }

    /// True when one position can satisfy both (only asked of anchors at the same joint and frame).
    fn agrees(&self, other: &Self) -> bool {
        let ([ax, ay, az], [bx, by, bz]) = (self.target, other.target);
        let heights = !self.has_height() || !other.has_height() || ay == by;
        ax == bx && az == bz && heights
    }

    /// How much the family says of one place: the pelvis as such before the pelvis as a joint, which says the same, and both before
    /// the pelvis on the ground, which leaves its height open.
    const fn rank(&self) -> u8 {
        match self.family {
            Family::Root3d => 2,
            Family::BodyPoint => 1,
            Family::PlanarRoot => 0,
        }
    }

    fn sorts_before(&self, other: &Self) -> bool {
        (self.frame, self.joint) < (other.frame, other.joint)
    }
}

/// Anchors of one request: checked, sorted by frame and joint, without duplicates. Owns its anchors (no borrow).
#[derive(Clone, Copy, Debug)]
pub struct AnchorSet {
    items: [Observed; MAX_ANCHORS],
    len: usize,
}

impl AnchorSet {
    /// The set without anchors.
    pub const EMPTY: Self = Self { items: [Observed::EMPTY; MAX_ANCHORS], len: 0 };

    /// [`AnchorSet::of`] anchors by frame.
    ///
    /// # Errors
    /// As there.
    pub fn new(anchors: &[Anchor], frames: usize) -> Result<Self, AnchorError> {
        Self::of(AnchorList::Frames(anchors), 0, frames)
    }

    /// Checks `anchors` against a motion of `frames` frames, `frame_rate` a second, and sorts them. Order does not matter; anchors
    /// that say the same of one joint at one frame count once: as Root-3D if one of them is, else as the Body-point of the pelvis.
    ///
    /// # Errors
    /// The first anchor at fault in the order of the list: its time, numbers, frame, joint, then a conflict with an earlier
    /// anchor, then the count of distinct anchors.
    pub fn of(anchors: AnchorList<'_>, frame_rate: u16, frames: usize) -> Result<Self, AnchorError> {
        let mut set = Self::EMPTY;
        set.fill(anchors, frame_rate, frames)?;
        Ok(set)
    }

    /// The same into a set that lies where it is wanted already: it is too large to be handed on the stack from frame to frame.
    ///
    /// # Errors
    /// Those of [`AnchorSet::of`].
    #[inline(never)]
    pub(crate) fn fill(&mut self, anchors: AnchorList<'_>, frame_rate: u16, frames: usize) -> Result<(), AnchorError> {
        let set = self;
        set.len = 0;
        let mut index = 0;
        while let Some(anchor) = anchors.get(index, frame_rate) {
            let new = Observed::new(index, &anchor?);
            check(index, &new, frames)?;
            match set.items.iter_mut().take(set.len).find(|old| old.same_place(&new)) {
                Some(old) if !old.agrees(&new) => {
                    return Err(AnchorError::Conflict { first: old.index as usize, second: index });
                }
                Some(old) if new.rank() > old.rank() => *old = new,
                Some(_) => {}
                None if set.len >= MAX_ANCHORS => {
                    return Err(AnchorError::TooMany { anchors: anchors.len(), limit: MAX_ANCHORS });
                }
                None => set.insert(new),
            }
            index += 1;
        }
        anchors.check_length()
    }

    /// Adds places of tracks, spread evenly over their frames, as many as there is room for: what a planner that sees anchors can know of
    /// them. Positions of which only some axes count are left out, but for a pelvis' place over the floor.
    pub(crate) fn suggest(&mut self, tracks: &[Track<'_>]) {
        for (number, track) in tracks.iter().enumerate() {
            let family = match (track.joint, track.axes) {
                (0, [true, true, true]) => Family::Root3d,
                (0, [true, false, true]) => Family::PlanarRoot,
                (_, [true, true, true]) => Family::BodyPoint,
                _ => continue,
            };
            let share = (MAX_ANCHORS - self.len) / (tracks.len() - number).max(1);
            let count = track.count();
            let wanted = if share < count { share } else { count };
            let (mut passed, mut taken) = (0, 0);
            for frame in track.frames() {
                let Some(target) = track.at(frame) else { continue };
                passed += 1;
                // The last of every `count / wanted` of them, and so the last of all.
                if passed * wanted >= (taken + 1) * count {
                    taken += 1;
                    let [x, y, z] = target;
                    let target = if family == Family::PlanarRoot { [x, 0.0, z] } else { [x, y, z] };
                    let new = Observed { target, frame: frame as u16, index: u16::MAX, joint: track.joint, family };
                    if self.len < MAX_ANCHORS && !self.items.iter().take(self.len).any(|old| old.same_place(&new)) {
                        self.insert(new);
                    }
                }
            }
        }
    }

    /// Has all places `factor` times as far from the origin.
    pub(crate) fn scale(&mut self, factor: f32) {
        for anchor in self.items.iter_mut().take(self.len) {
            anchor.target = anchor.target.map(|value| value * factor);
        }
    }

    /// Insertion in order; the caller has made sure that there is room.
    fn insert(&mut self, new: Observed) {
        let mut carried = new;
        for slot in self.items.iter_mut().take(self.len) {
            if carried.sorts_before(slot) {
                swap(slot, &mut carried);
            }
        }
        invariant!(self.len < MAX_ANCHORS, "a set of {} anchors", self.len);
        if let Some(slot) = self.items.get_mut(self.len) {
            *slot = carried;
            self.len += 1;
        }
    }

    /// Number of distinct anchors.
    pub const fn len(&self) -> usize {
        self.len
    }

    /// True when there is nothing to meet.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Anchors by rising frame, then joint.
    pub fn iter(&self) -> impl Iterator<Item = &Observed> + Clone {
        self.items.iter().take(self.len)
    }

    /// Last frame that carries an anchor.
    pub fn last_frame(&self) -> Option<u16> {
        self.iter().last().map(|anchor| anchor.frame)
    }
}

fn check(index: usize, anchor: &Observed, frames: usize) -> Result<(), AnchorError> {
    for value in anchor.target {
        if !value.is_finite() {
            return Err(AnchorError::NotFinite { index });
        }
        if !(-FARTHEST..=FARTHEST).contains(&value) {
            return Err(AnchorError::TooFar { index, limit: FARTHEST });
        }
    }
    if anchor.frame as usize >= frames {
        return Err(AnchorError::FrameOutOfRange { index, frame: anchor.frame, frames });
    }
    if anchor.joint as usize >= JOINTS {
        return Err(AnchorError::JointOutOfRange { index, joint: anchor.joint, joints: JOINTS });
    }
    Ok(())
}
