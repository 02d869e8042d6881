//! Anchors written down in seconds and joint names.

use core::fmt;

use heapless::Vec;

use super::anchors::{Anchor, MAX_ANCHORS};
use super::joint::Joint;

/// Frames a second of anchors and motions.
pub const FRAME_RATE: f32 = 20.0;

/// A list of anchors in the making. A mistake is kept until the list is asked for, so that calls chain.
///
/// ```
/// use motionette::{Anchors, Joint};
///
/// let anchors = Anchors::new()
///     .root_at(2.0, [0.0, 0.9, 1.5])
///     .planar_root_at(4.0, [0.5, 3.0])
///     .joint_at(3.5, Joint::RightWrist, [-0.3, 1.4, 2.4]);
/// assert_eq!(anchors.as_slice()?.len(), 3);
/// assert!(anchors.root_at(-1.0, [0.0; 3]).as_slice().is_err());
/// # Ok::<(), motionette::perception::authoring::AuthoringError>(())
/// ```
///
/// Times are seconds from the start, taken to the nearest frame ([`FRAME_RATE`]); positions are metres (y up, the motion
/// starts with the pelvis at x = z = 0 facing +z, the body's left is +x).
/// Coordinates, the motion's length and contradictions are looked at when the list is part of a request.
#[derive(Clone, Debug, Default)]
pub struct Anchors {
    items: Vec<Anchor, MAX_ANCHORS>,
    error: Option<AuthoringError>,
}

impl Anchors {
    /// No anchors yet.
    #[must_use]
    pub const fn new() -> Self {
        Anchors { items: Vec::new(), error: None }
    }

    /// Root-3D: the pelvis at `[x, y, z]` after `seconds`.
    #[must_use]
    pub fn root_at(self, seconds: f32, position: [f32; 3]) -> Self {
        self.at(seconds, |frame| Anchor::root(frame, position))
    }

    /// [`Anchors::root_at`] by frame.
    #[must_use]
    pub fn root_at_frame(self, frame: u16, position: [f32; 3]) -> Self {
        self.with(Anchor::root(frame, position))
    }

    /// Planar-root: the pelvis above `[x, z]` after `seconds`, its height free.
    #[must_use]
    pub fn planar_root_at(self, seconds: f32, position: [f32; 2]) -> Self {
        self.at(seconds, |frame| Anchor::planar_root(frame, position))
    }

    /// [`Anchors::planar_root_at`] by frame.
    #[must_use]
    pub fn planar_root_at_frame(self, frame: u16, position: [f32; 2]) -> Self {
        self.with(Anchor::planar_root(frame, position))
    }

    /// Body-point: `joint` at `[x, y, z]` after `seconds`.
    #[must_use]
    pub fn joint_at(self, seconds: f32, joint: Joint, position: [f32; 3]) -> Self {
        self.at(seconds, |frame| Anchor::joint(frame, joint as u8, position))
    }

    /// [`Anchors::joint_at`] by frame.
    #[must_use]
    pub fn joint_at_frame(self, frame: u16, joint: Joint, position: [f32; 3]) -> Self {
        self.with(Anchor::joint(frame, joint as u8, position))
    }

    /// The list with one more.
    #[must_use]
    pub fn with(mut self, anchor: Anchor) -> Self {
        if self.items.push(anchor).is_err() {
            self.keep(AuthoringError::TooMany { limit: MAX_ANCHORS });
        }
        self
    }

    /// The anchors in the order they were given, for [`Request::through`](crate::Request::through).
    ///
    /// # Errors
    /// The first mistake that was made.
    pub fn as_slice(&self) -> Result<&[Anchor], AuthoringError> {
        match self.error {
            None => Ok(&self.items),
            Some(error) => Err(error),
        }
    }

    fn at(mut self, seconds: f32, anchor: impl FnOnce(u16) -> Anchor) -> Self {
        let frame = libm::roundf(seconds * FRAME_RATE);
        if seconds >= 0.0 && frame <= f32::from(u16::MAX) {
            self.with(anchor(frame as u16))
        } else {
            self.keep(AuthoringError::Time { index: self.items.len(), seconds });
            self
        }
    }

    /// Keeps the first mistake.
    fn keep(&mut self, error: AuthoringError) {
        self.error = self.error.or(Some(error));
    }
}

/// Why a list of anchors cannot be had.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AuthoringError {
    /// More anchors than a request may carry.
    TooMany {
        /// Most anchors.
        limit: usize,
    },
    /// A time before the start, after frame 65535, or not a number.
    Time {
        /// Anchor at fault, counted from 0.
        index: usize,
        /// Its time.
        seconds: f32,
    },
}

impl fmt::Display for AuthoringError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooMany { limit } => write!(f, "at most {limit} anchors fit in a request"),
            Self::Time { index, seconds } => {
                write!(f, "anchor {index}: {seconds} s is no time in a motion; times count from 0")
            }
        }
    }
}

impl core::error::Error for AuthoringError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_go_to_the_nearest_frame() {
        let anchors = Anchors::new()
            .root_at(2.0, [1.0, 2.0, 3.0])
            .root_at(-0.0, [0.0; 3])
            .planar_root_at(3.974, [7.0, 8.0])
            .joint_at(0.125, Joint::RightWrist, [0.25, 1.5, 3.0])
            .root_at_frame(7, [0.5; 3])
            .planar_root_at_frame(8, [0.5; 2])
            .joint_at_frame(u16::MAX, Joint::Head, [0.5; 3]);
        let expected = [
            Anchor::root(40, [1.0, 2.0, 3.0]),
            Anchor::root(0, [0.0; 3]),
            Anchor::planar_root(79, [7.0, 8.0]),
            Anchor::joint(3, 21, [0.25, 1.5, 3.0]),
            Anchor::root(7, [0.5; 3]),
            Anchor::planar_root(8, [0.5; 2]),
            Anchor::joint(u16::MAX, 15, [0.5; 3]),
        ];
        assert_eq!(anchors.as_slice(), Ok(&expected[..]));
    }

    #[test]
    fn the_first_mistake_is_kept() {
        for seconds in [-0.1, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e9] {
            let anchors = Anchors::new().root_at_frame(1, [0.0; 3]).root_at(seconds, [0.0; 3]).root_at(-2.0, [0.0; 3]);
            match anchors.as_slice() {
                Err(AuthoringError::Time { index: 1, seconds: found }) => {
                    assert_eq!(found.to_bits(), seconds.to_bits())
                }
                other => panic!("{seconds}: {other:?}"),
            }
        }
        let mut anchors = Anchors::new();
        for frame in 0..MAX_ANCHORS as u16 {
            anchors = anchors.planar_root_at_frame(frame, [0.0; 2]);
        }
        assert_eq!(anchors.as_slice().map(<[_]>::len), Ok(MAX_ANCHORS));
        let anchors = anchors.root_at(1.0, [0.0; 3]).root_at(f32::NAN, [0.0; 3]);
        assert_eq!(anchors.as_slice(), Err(AuthoringError::TooMany { limit: MAX_ANCHORS }));
    }
}
