//! Anchors written down in seconds and joint names.

use heapless::Vec;

use super::anchors::{Anchor, MAX_ANCHORS, Target};
use super::set::AnchorError;
#[cfg(test)]
use super::set::AnchorSet;
use crate::request::joint::Joint;

/// A list of anchors in the making, for [`Request::through`](crate::Request::through).
///
/// ```
/// use motionette::{Anchors, Joint, Request};
///
/// let anchors = Anchors::new()
///     .root_at(2.0, [0.0, 0.9, 1.5])
///     .planar_root_at(4.0, [0.5, 3.0])
///     .joint_at(3.5, Joint::RightWrist, [-0.3, 1.4, 2.4]);
/// let request = Request::text("a person walks").through(&anchors);
/// assert_eq!(request.anchors.len(), 3);
/// ```
///
/// Times are seconds from the start, taken to the nearest frame of the model that makes the motion; positions are metres (y up, the
/// motion starts with the pelvis at x = z = 0 facing +z, the body's left is +x). Everything is checked when a request is planned or
/// run, so that calls chain: times, coordinates, the motion's length, contradictions, and that the list is not longer than
/// [`MAX_ANCHORS`].
#[derive(Clone, Debug, Default)]
pub struct Anchors {
    items: Vec<Entry, MAX_ANCHORS>,
    /// Anchors that there was no room for.
    dropped: usize,
}

/// An anchor whose frame may not be known yet.
#[derive(Clone, Copy, Debug)]
struct Entry {
    at: Moment,
    target: Target,
}

#[derive(Clone, Copy, Debug)]
enum Moment {
    Frame(u16),
    Seconds(f32),
}

impl Anchors {
    /// No anchors yet.
    #[must_use]
    pub const fn new() -> Self {
        Anchors { items: Vec::new(), dropped: 0 }
    }

    /// Root-3D: the pelvis at `[x, y, z]` after `seconds`.
    #[must_use]
    pub fn root_at(self, seconds: f32, position: [f32; 3]) -> Self {
        self.at(Moment::Seconds(seconds), Target::Root(position))
    }

    /// [`Anchors::root_at`] by frame.
    #[must_use]
    pub fn root_at_frame(self, frame: u16, position: [f32; 3]) -> Self {
        self.with(Anchor::root(frame, position))
    }

    /// Planar-root: the pelvis above `[x, z]` after `seconds`, its height free.
    #[must_use]
    pub fn planar_root_at(self, seconds: f32, position: [f32; 2]) -> Self {
        self.at(Moment::Seconds(seconds), Target::PlanarRoot(position))
    }

    /// [`Anchors::planar_root_at`] by frame.
    #[must_use]
    pub fn planar_root_at_frame(self, frame: u16, position: [f32; 2]) -> Self {
        self.with(Anchor::planar_root(frame, position))
    }

    /// Body-point: `joint` at `[x, y, z]` after `seconds`.
    #[must_use]
    pub fn joint_at(self, seconds: f32, joint: Joint, position: [f32; 3]) -> Self {
        self.at(Moment::Seconds(seconds), Target::Joint { joint: joint as u8, position })
    }

    /// [`Anchors::joint_at`] by frame.
    #[must_use]
    pub fn joint_at_frame(self, frame: u16, joint: Joint, position: [f32; 3]) -> Self {
        self.with(Anchor::joint(frame, joint as u8, position))
    }

    /// The list with one more.
    #[must_use]
    pub fn with(self, anchor: Anchor) -> Self {
        self.at(Moment::Frame(anchor.frame), anchor.target)
    }

    /// The anchors in the order they were given, by frames of which there are `frame_rate` a second
    /// ([`Model::frame_rate`](crate::Model::frame_rate)).
    ///
    /// # Errors
    /// [`AnchorError::Time`] and [`AnchorError::TooMany`]; nothing else is checked.
    pub fn by_frame(&self, frame_rate: u16) -> Result<Vec<Anchor, MAX_ANCHORS>, AnchorError> {
        let mut anchors = Vec::new();
        for (index, entry) in self.items.iter().enumerate() {
            let pushed = anchors.push(entry.anchor(index, frame_rate)?);
            invariant!(pushed.is_ok(), "both lists have the same capacity");
        }
        AnchorList::Timed(self).check_length()?;
        Ok(anchors)
    }

    fn at(mut self, at: Moment, target: Target) -> Self {
        if self.items.push(Entry { at, target }).is_err() {
            self.dropped = self.dropped.saturating_add(1);
        }
        self
    }
}

impl Entry {
    fn anchor(&self, index: usize, frame_rate: u16) -> Result<Anchor, AnchorError> {
        let Entry { at, target } = *self;
        let frame = match at {
            Moment::Frame(frame) => frame,
            Moment::Seconds(seconds) => {
                let frame = libm::roundf(seconds * f32::from(frame_rate));
                if !(seconds >= 0.0 && frame <= f32::from(u16::MAX)) {
                    return Err(AnchorError::Time { index, seconds });
                }
                frame as u16
            }
        };
        Ok(Anchor { frame, target })
    }
}

/// The anchors of a request: by frame, or as [`Anchors`] has them.
#[derive(Clone, Copy, Debug)]
pub enum AnchorList<'a> {
    /// By frame.
    Frames(&'a [Anchor]),
    /// By frame or time.
    Timed(&'a Anchors),
}

impl AnchorList<'_> {
    /// Anchors in the list, equal ones counted each.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            AnchorList::Frames(anchors) => anchors.len(),
            AnchorList::Timed(anchors) => anchors.items.len().saturating_add(anchors.dropped),
        }
    }

    /// True without anchors.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The anchor at `index`; `None` behind the last that is there.
    pub(super) fn get(&self, index: usize, frame_rate: u16) -> Option<Result<Anchor, AnchorError>> {
        match self {
            AnchorList::Frames(anchors) => anchors.get(index).copied().map(Ok),
            AnchorList::Timed(anchors) => anchors.items.get(index).map(|entry| entry.anchor(index, frame_rate)),
        }
    }

    /// Whether the list holds all that were given.
    pub(super) fn check_length(&self) -> Result<(), AnchorError> {
        match self {
            AnchorList::Timed(Anchors { dropped: 1.., .. }) => {
                Err(AnchorError::TooMany { anchors: self.len(), limit: MAX_ANCHORS })
            }
            _ => Ok(()),
        }
    }
}

/// What [`Request::through`](crate::Request::through) takes: [`Anchors`], or any list of [`Anchor`]s.
pub trait AsAnchors {
    /// The anchors.
    fn as_anchors(&self) -> AnchorList<'_>;
}

impl AsAnchors for Anchors {
    fn as_anchors(&self) -> AnchorList<'_> {
        AnchorList::Timed(self)
    }
}

impl<T: AsRef<[Anchor]> + ?Sized> AsAnchors for T {
    fn as_anchors(&self) -> AnchorList<'_> {
        AnchorList::Frames(self.as_ref())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_go_to_the_nearest_frame_of_the_model() {
        let anchors = Anchors::new()
            .root_at(2.0, [1.0, 2.0, 3.0])
            .root_at(-0.0, [0.0; 3])
            .planar_root_at(3.974, [7.0, 8.0])
            .joint_at(0.125, Joint::RightWrist, [0.25, 1.5, 3.0])
            .root_at_frame(7, [0.5; 3])
            .planar_root_at_frame(8, [0.5; 2])
            .joint_at_frame(u16::MAX, Joint::Head, [0.5; 3]);
        for (frame_rate, frames) in [(20, [40, 0, 79, 3]), (30, [60, 0, 119, 4]), (8, [16, 0, 32, 1])] {
            let [first, second, third, fourth] = frames;
            let expected = [
                Anchor::root(first, [1.0, 2.0, 3.0]),
                Anchor::root(second, [0.0; 3]),
                Anchor::planar_root(third, [7.0, 8.0]),
                Anchor::joint(fourth, 21, [0.25, 1.5, 3.0]),
                Anchor::root(7, [0.5; 3]),
                Anchor::planar_root(8, [0.5; 2]),
                Anchor::joint(u16::MAX, 15, [0.5; 3]),
            ];
            assert_eq!(anchors.by_frame(frame_rate).as_deref(), Ok(&expected[..]), "{frame_rate} frames a second");
        }
    }

    #[test]
    fn the_first_mistake_is_reported() {
        for seconds in [-0.1, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e9] {
            let anchors = Anchors::new().root_at_frame(1, [0.0; 3]).root_at(seconds, [0.0; 3]).root_at(-2.0, [0.0; 3]);
            for error in [anchors.by_frame(20).err(), AnchorSet::of(AnchorList::Timed(&anchors), 20, 100).err()] {
                match error {
                    Some(AnchorError::Time { index: 1, seconds: found }) => {
                        assert_eq!(found.to_bits(), seconds.to_bits())
                    }
                    other => panic!("{seconds}: {other:?}"),
                }
            }
        }
        // 3276 s are frame 65520 at 20 frames a second; at 30 no frame has that number.
        let late = Anchors::new().root_at(3276.0, [0.0; 3]);
        assert!(late.by_frame(20).is_ok());
        assert_eq!(late.by_frame(30), Err(AnchorError::Time { index: 0, seconds: 3276.0 }));

        let mut anchors = Anchors::new();
        for frame in 0..MAX_ANCHORS as u16 {
            anchors = anchors.planar_root_at_frame(frame, [0.0; 2]);
        }
        assert_eq!(anchors.by_frame(20).map(|list| list.len()), Ok(MAX_ANCHORS));
        let anchors = anchors.root_at(1.0, [0.0; 3]).root_at(f32::NAN, [0.0; 3]);
        let many = AnchorError::TooMany { anchors: MAX_ANCHORS + 2, limit: MAX_ANCHORS };
        assert_eq!(anchors.by_frame(20), Err(many));
        assert_eq!(AnchorSet::of(AnchorList::Timed(&anchors), 20, 100).err(), Some(many));
    }
}
