//! What a frame of the motion is made of.

use super::Reader;
use crate::JOINTS;
use serde::ser::SerializeTuple;
use serde::{Serialize, Serializer};

/// Bytes of a [`Skeleton`].
pub const SKELETON_BYTES: usize = 12 * JOINTS;

/// Meaning of the feature channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Representation<'a> {
    /// HumanML3D's 263 channels of a body with 22 joints (EQUATIONS section 1).
    HumanMl3d(HumanMl3d<'a>),
}

/// HumanML3D's channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct HumanMl3d<'a> {
    /// Frames a second.
    pub frame_rate: u16,
    /// The body that the model was trained on.
    pub skeleton: Skeleton<'a>,
}

/// A body at rest: offset of each joint from its parent, metres, y up, the subject's left at +x, in the order and with the parents of
/// [`crate::representation::skeleton`]. The pelvis has none.
///
/// `[22][3]` singles as little-endian bytes, read in place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Skeleton<'a> {
    bytes: &'a [u8],
}

impl<'a> Representation<'a> {
    pub(super) fn read(from: &mut Reader<'a>) -> Self {
        from.kind("representation", 1);
        let (frame_rate, bytes) = (from.short(), from.bytes(SKELETON_BYTES));
        Representation::HumanMl3d(HumanMl3d { frame_rate, skeleton: Skeleton { bytes } })
    }

    /// Frames a second.
    #[must_use]
    pub const fn frame_rate(&self) -> u16 {
        let Representation::HumanMl3d(body) = self;
        body.frame_rate
    }

    /// The body that the model was trained on.
    #[must_use]
    pub const fn skeleton(&self) -> Skeleton<'a> {
        let Representation::HumanMl3d(body) = self;
        body.skeleton
    }
}

impl<'a> Skeleton<'a> {
    /// The skeleton of these offsets.
    #[must_use]
    pub const fn new(bytes: &'a [u8; SKELETON_BYTES]) -> Self {
        Skeleton { bytes }
    }

    /// Offset of each joint from its parent `[22]`, metres.
    #[must_use]
    pub fn offsets(&self) -> [[f32; 3]; JOINTS] {
        let mut offsets = [[0.0; 3]; JOINTS];
        let (numbers, _) = self.bytes.as_chunks::<4>();
        for (slot, &bytes) in offsets.as_flattened_mut().iter_mut().zip(numbers) {
            *slot = f32::from_le_bytes(bytes);
        }
        offsets
    }
}

/// The bytes as they are, without a length.
impl Serialize for Skeleton<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(SKELETON_BYTES)?;
        for byte in self.bytes {
            tuple.serialize_element(byte)?;
        }
        tuple.end()
    }
}
