//! Checks of the section `representation`.

use super::value::at_most;
use crate::blob::{Error, Representation};

/// Shortest and longest bone, metres.
const BONE: [f32; 2] = [1e-3, 3.0];

/// Whether the bone to a joint is one that a body can have.
#[inline(never)]
pub(crate) fn is_bone(joint: usize, [x, y, z]: [f32; 3]) -> bool {
    let square = x * x + y * y + z * z;
    let [shortest, longest] = BONE;
    if joint == 0 { square == 0.0 } else { square >= shortest * shortest && square <= longest * longest }
}

/// Checks frame rate and skeleton.
pub(super) fn check(representation: &Representation<'_>) -> Result<(), Error> {
    at_most("representation.frame_rate", u32::from(representation.frame_rate()), 1000)?;
    match representation.skeleton().offsets().into_iter().enumerate().find(|&(joint, offset)| !is_bone(joint, offset)) {
        Some((_, [x, y, z])) => {
            let (what, square) = ("square of a bone's length in representation.skeleton", x * x + y * y + z * z);
            Err(Error::Number { what, bits: square.to_bits() })
        }
        None => Ok(()),
    }
}
