//! `anchors.json`: where the motion must pass.
//!
//! ```json
//! {"anchors": [
//!   {"time": 2.0, "root": [1.2, 0.9, 2.0]},
//!   {"frame": 70, "joint": "right_wrist", "position": [0.4, 1.3, 2.5]},
//!   {"time": 4.0, "planar_root": [2.0, 3.5]}
//! ]}
//! ```
//!
//! | field | unit | meaning |
//! |---|---|---|
//! | `time` | s | when, from the start; taken to the nearest frame of the model that is to make the motion. Exactly one of `time` and `frame` |
//! | `frame` | - | when, as a frame number from 0 |
//! | `root` | m | pelvis at `[x, y, z]` (Root-3D). Exactly one target: `root`, `planar_root`, or `joint` with `position` |
//! | `planar_root` | m | pelvis at `[x, z]`, its height free (Planar-root) |
//! | `joint` | - | name of one of the 22 joints ([`crate::motion::skeleton::NAMES`]), with `position` (Body-point) |
//! | `position` | m | where that joint is, `[x, y, z]` |
//!
//! Coordinates are those of the motion: y up, the pelvis starts at x = z = 0 and faces +z, the subject's left is +x. Other fields
//! are refused. [`parse`] knows the model's frame rate and nothing of the motion's length; [`check_at`] knows both. `docs/anchors.md` says the same to users.

mod entry;
mod error;
mod reach;
#[cfg(test)]
mod tests;

use std::fmt::Write as _;
use std::path::Path;

use motionette::request::conditions::{AnchorError, AnchorSet};
use motionette::{Anchor, Joint, Target};
use serde::Deserialize;

use crate::entries::{self, Entry};
use crate::input;
use crate::motion::{FPS, skeleton};
use crate::output;
pub use error::Error;
pub use reach::{OutOfReach, out_of_reach};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    anchors: Vec<Entry>,
}

/// Reads an anchors file for a motion of `frame_rate` frames a second.
///
/// # Errors
/// [`Error::Read`] when the file cannot be read, else as [`parse`].
pub fn read(path: &Path, frame_rate: u16) -> Result<Vec<Anchor>, Error> {
    let text =
        input::read_text(path, input::WRITTEN).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    parse(&text, frame_rate)
}

/// Parses the text of an anchors file for a motion of `frame_rate` frames a second. Anchors keep their order; an empty list is fine.
///
/// # Errors
/// [`Error`], with line and column for text that is not JSON of this form and with the anchor's index (from 0) and field for content
/// that makes no sense.
pub fn parse(text: &str, frame_rate: u16) -> Result<Vec<Anchor>, Error> {
    let file: File = entries::parse(text).map_err(Error::json)?;
    file.anchors.iter().enumerate().map(|(index, entry)| entry::anchor(entry, index, frame_rate)).collect()
}

/// [`check_at`] for a processed recording, which has [`FPS`] frames a second.
///
/// # Errors
/// As there.
pub fn check(anchors: &[Anchor], frames: usize) -> Result<(), Error> {
    check_at(anchors, frames, FPS as u16)
}

/// Checks anchors against a motion of `frames` frames, `frame_rate` a second: that all lie within it, and what a request demands
/// besides (numbers, no two targets for one joint at one frame, not too many).
///
/// # Errors
/// [`Error::BeyondEnd`], which says how long the motion is, [`Error::Conflict`], or [`Error::Refused`].
pub fn check_at(anchors: &[Anchor], frames: usize, frame_rate: u16) -> Result<(), Error> {
    if let Some((index, anchor)) = anchors.iter().enumerate().find(|(_, anchor)| usize::from(anchor.frame) >= frames) {
        return Err(Error::BeyondEnd { index, frame: anchor.frame, frames, frame_rate });
    }
    AnchorSet::new(anchors, frames).map(|_| ()).map_err(|error| match error {
        AnchorError::Conflict { first, second } => {
            let joint = match anchors[second].target {
                Target::Joint { joint, .. } => Joint::try_from(joint).unwrap_or(Joint::Pelvis),
                Target::Root(_) | Target::PlanarRoot(_) => Joint::Pelvis,
            };
            Error::Conflict { first, second, joint, frame: anchors[second].frame, frame_rate }
        }
        error => Error::Refused(error),
    })
}

/// The anchors without repetitions, in their order. A request takes as much memory and work as it has anchors, and says no more with one
/// given twice.
#[must_use]
pub fn distinct(anchors: &[Anchor]) -> Vec<Anchor> {
    let mut kept: Vec<Anchor> = Vec::new();
    for anchor in anchors {
        if !kept.contains(anchor) {
            kept.push(*anchor);
        }
    }
    kept
}

/// Writes anchors as a file that [`read`] gives back bit for bit: one anchor a line, `frame` rather than `time`.
///
/// # Errors
/// [`Error::NotFinite`] and [`Error::NoSuchJoint`] for anchors the file cannot hold, [`Error::Write`] when the file cannot be written.
pub fn write(path: &Path, anchors: &[Anchor]) -> Result<(), Error> {
    let text = text(anchors)?;
    output::write_atomic(path, |w| w.write_all(text.as_bytes())).map_err(Error::Write)
}

/// The text of such a file.
///
/// # Errors
/// [`Error::NotFinite`] and [`Error::NoSuchJoint`] for anchors the file cannot hold.
pub fn text(anchors: &[Anchor]) -> Result<String, Error> {
    let mut text = String::from("{\"anchors\": [");
    for (index, anchor) in anchors.iter().enumerate() {
        let (field, coordinates): (&'static str, &[f32]) = match &anchor.target {
            Target::Root(p) => ("root", p),
            Target::PlanarRoot(p) => ("planar_root", p),
            Target::Joint { position, .. } => ("position", position),
        };
        if let Some(&value) = coordinates.iter().find(|x| !x.is_finite()) {
            return Err(Error::NotFinite { index, field, value: f64::from(value) });
        }
        let joint = match anchor.target {
            Target::Joint { joint, .. } => {
                let name = skeleton::NAMES.get(usize::from(joint)).ok_or(Error::NoSuchJoint { index, joint })?;
                format!("\"joint\": \"{name}\", ")
            }
            _ => String::new(),
        };
        // The shortest digits that name this f32.
        let coordinates: Vec<String> = coordinates.iter().map(f32::to_string).collect();
        let comma = if index == 0 { "" } else { "," };
        let (frame, coordinates) = (anchor.frame, coordinates.join(", "));
        // Writing to a string cannot fail.
        let _ = write!(text, "{comma}\n  {{\"frame\": {frame}, {joint}\"{field}\": [{coordinates}]}}");
    }
    text.push_str("\n]}\n");
    Ok(text)
}
