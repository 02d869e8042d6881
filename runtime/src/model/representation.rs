//! Checks of the section `representation`.

use super::value::{at_most, within};
use crate::blob::{Error, Representation};

/// Shortest and longest bone, metres.
const BONE: [f32; 2] = [1e-3, 3.0];

/// Checks frame rate and skeleton.
pub(super) fn check(representation: &Representation<'_>) -> Result<(), Error> {
    at_most("representation.frame_rate", u32::from(representation.frame_rate()), 1000)?;
    let [shortest, longest] = BONE;
    for (joint, [x, y, z]) in representation.skeleton().offsets().enumerate() {
        let square = x * x + y * y + z * z;
        let [least, most] = if joint == 0 { [0.0; 2] } else { [shortest * shortest, longest * longest] };
        within("square of a bone's length in representation.skeleton", square, least, most)?;
    }
    Ok(())
}
