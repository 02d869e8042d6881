//! Tracks, scenes and timelines: where joints are to be at many frames, what the figure keeps clear of, and what parts of the body do
//! instead.
//!
//! ```json
//! {"tracks": [
//!   {"joint": "right_wrist", "frame": 10, "positions": [[-0.3, 1.2, 0.4], null, [-0.3, 1.3, 0.4]], "axes": "xz", "tolerance": 0.02}
//! ]}
//! ```
//!
//! | field of a track | unit | meaning |
//! |---|---|---|
//! | `joint` | - | name of one of the 22 joints ([`crate::motion::skeleton::NAMES`]) |
//! | `time` | s | when the first position is, from the start. Exactly one of `time` and `frame` |
//! | `frame` | - | the same as a frame number from 0 |
//! | `positions` | m | where the joint is, `[x, y, z]` each, one a frame; `null` does not count |
//! | `mask` | - | 0 or 1 for each position: those that are 0 do not count; all do if it is left out |
//! | `axes` | - | which of `x`, `y`, `z` count; all if it is left out |
//! | `tolerance` | m | how loosely it is followed, 0 to 1; 0 if it is left out |
//! | `frame_rate` | 1/s | positions come so many a second and are taken to the model's frames in straight lines; none where a neighbour does not count |
//!
//! ```json
//! {"obstacles": [
//!   {"sphere": {"radius": 0.3}, "at": [0.5, 1.0, 2.0], "margin": 0.05, "joints": ["head", "left_wrist"]},
//!   {"capsule": {"radius": 0.05, "from": [-1.0, 0.3, 2.0], "to": [1.0, 0.3, 2.0]}},
//!   {"cylinder": {"radius": 0.15, "height": 2.0}, "at": [0.0, 1.0, 1.5], "velocity": [0.2, 0.0, 0.0]},
//!   {"box": {"size": [0.4, 0.8, 0.4]}, "keyframes": [{"time": 0.0, "position": [1, 0.4, 2]}, {"frame": 60, "position": [-1, 0.4, 2]}]},
//!   {"plane": {"normal": [-1.0, 0.0, 0.0]}, "at": [1.5, 0.0, 0.0]}
//! ]}
//! ```
//!
//! | field of an obstacle | unit | meaning |
//! |---|---|---|
//! | `sphere`, `capsule`, `cylinder`, `box`, `plane` | m | its form, exactly one; `size` and `height` are whole, not half; a plane's `normal` points to the free side |
//! | `at` | m | where its middle is, at frame 0 if it moves; a capsule has `from` and `to` instead |
//! | `velocity` | m/s | it moves on at this speed |
//! | `keyframes` | - | instead of `at` and `velocity`: where its middle is at some moments, `position` with `time` or `frame`; in between in straight lines |
//! | `margin` | m | how far the figure keeps away from its surface, 0 to 1; 0.05 if it is left out |
//! | `joints` | - | names of the joints that keep clear, each with the bone from its parent; all if it is left out |
//!
//! ```json
//! {"timeline": [
//!   {"parts": "right_arm", "from": 1.0, "to": 3.0, "text": "a person waves the right hand"},
//!   {"parts": ["left_arm", "head"], "first_frame": 60, "frames": 30, "prompt": "wave"}
//! ]}
//! ```
//!
//! | field of a span | unit | meaning |
//! |---|---|---|
//! | `parts` | - | what moves: a name of [`motionette::BodyParts::NAMED`], or a list of them |
//! | `from`, `to` | s | when, from the start, each taken to the nearest frame. Exactly one of these two and the next two |
//! | `first_frame`, `frames` | - | the same as a frame number from 0 and a count |
//! | `text`, `prompt` | - | what they do: words, or the name of a prompt that the model stores. Exactly one of them |
//!
//! Coordinates are those of [`crate::anchors_file`]. Other fields are refused. What a request demands besides (nothing behind the end of the
//! motion, no track through an obstacle, no two spans of one part at a time, not too many) checks the runtime. `docs/tracks.md`,
//! `docs/obstacles.md` and `docs/timeline.md` say the same to users.

mod error;
mod obstacle;
#[cfg(test)]
mod tests;
mod timeline;
mod track;

use std::fmt::Write as _;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use crate::entries::{self, Entry};
use crate::input;
use crate::motion::skeleton;
use crate::output;
pub use error::{Error, List, Place};
pub use obstacle::{OwnedCourse, OwnedObstacle};
pub use timeline::{OwnedPrompt, OwnedSpan, names_of_parts};
pub use track::OwnedTrack;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Tracks {
    tracks: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Scene {
    obstacles: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Timeline {
    timeline: Vec<Entry>,
}

fn read(path: &Path) -> Result<String, Error> {
    input::read_text(path, input::WRITTEN).map_err(|source| Error::Read { path: path.to_path_buf(), source })
}

/// Reads a tracks file for a motion of `frame_rate` frames a second.
///
/// # Errors
/// [`Error::Read`] when the file cannot be read, else as [`parse_tracks`].
pub fn read_tracks(path: &Path, frame_rate: u16) -> Result<Vec<OwnedTrack>, Error> {
    parse_tracks(&read(path)?, frame_rate)
}

/// Parses the text of a tracks file for a motion of `frame_rate` frames a second. Tracks keep their order; an empty list is fine.
///
/// # Errors
/// [`Error`], with line and column for text that is not JSON of this form and with the track's index (from 0) and field for content that
/// makes no sense.
pub fn parse_tracks(text: &str, frame_rate: u16) -> Result<Vec<OwnedTrack>, Error> {
    let file: Tracks = entries::parse(text).map_err(|misformed| Error::json(List::Tracks, misformed))?;
    file.tracks.iter().enumerate().map(|(index, entry)| track::track(entry, index, frame_rate)).collect()
}

/// Reads a scene file for a motion of `frame_rate` frames a second.
///
/// # Errors
/// [`Error::Read`] when the file cannot be read, else as [`parse_scene`].
pub fn read_scene(path: &Path, frame_rate: u16) -> Result<Vec<OwnedObstacle>, Error> {
    parse_scene(&read(path)?, frame_rate)
}

/// Parses the text of a scene file for a motion of `frame_rate` frames a second. Obstacles keep their order; an empty list is fine.
///
/// # Errors
/// [`Error`], with line and column for text that is not JSON of this form and with the obstacle's index (from 0) and field for content
/// that makes no sense.
pub fn parse_scene(text: &str, frame_rate: u16) -> Result<Vec<OwnedObstacle>, Error> {
    let file: Scene = entries::parse(text).map_err(|misformed| Error::json(List::Obstacles, misformed))?;
    file.obstacles.iter().enumerate().map(|(index, entry)| obstacle::obstacle(entry, index, frame_rate)).collect()
}

/// Reads a timeline file for a motion of `frame_rate` frames a second.
///
/// # Errors
/// [`Error::Read`] when the file cannot be read, else as [`parse_timeline`].
pub fn read_timeline(path: &Path, frame_rate: u16) -> Result<Vec<OwnedSpan>, Error> {
    parse_timeline(&read(path)?, frame_rate)
}

/// Parses the text of a timeline file for a motion of `frame_rate` frames a second. Spans keep their order; an empty list is fine.
///
/// # Errors
/// [`Error`], with line and column for text that is not JSON of this form and with the span's index (from 0) and field for content that
/// makes no sense.
pub fn parse_timeline(text: &str, frame_rate: u16) -> Result<Vec<OwnedSpan>, Error> {
    let file: Timeline = entries::parse(text).map_err(|misformed| Error::json(List::Timeline, misformed))?;
    file.timeline.iter().enumerate().map(|(index, entry)| timeline::span(entry, index, frame_rate)).collect()
}

/// Writes tracks as a file that [`read_tracks`] gives back.
///
/// # Errors
/// Those of [`tracks_text`], [`Error::Write`] when the file cannot be written.
pub fn write_tracks(path: &Path, tracks: &[OwnedTrack]) -> Result<(), Error> {
    let text = tracks_text(tracks)?;
    output::write_atomic(path, |w| w.write_all(text.as_bytes())).map_err(Error::Write)
}

/// The text of such a file: `frame` rather than `time`, one position a frame, `null` for those that do not count. All that counts comes
/// back bit for bit.
///
/// # Errors
/// [`Error::Field`] for a number the file cannot hold, [`Error::NoSuchJoint`], [`Error::Mask`].
pub fn tracks_text(tracks: &[OwnedTrack]) -> Result<String, Error> {
    let mut text = String::from("{\"tracks\": [");
    // Writing to a string cannot fail.
    for (index, track) in tracks.iter().enumerate() {
        let joint = usize::from(track.joint);
        let name = skeleton::NAMES.get(joint).ok_or(Error::NoSuchJoint { index, joint: track.joint })?;
        let (comma, first) = (if index == 0 { "" } else { "," }, track.first);
        let _ = write!(text, "{comma}\n  {{\"joint\": \"{name}\", \"frame\": {first}");
        if track.axes != [true; 3] {
            let axes: String = track::AXES.into_iter().zip(track.axes).filter(|(_, on)| *on).map(|(c, _)| c).collect();
            let _ = write!(text, ", \"axes\": \"{axes}\"");
        }
        if track.tolerance != 0.0 {
            let _ = write!(text, ", \"tolerance\": {}", finite(index, "tolerance", track.tolerance)?);
        }
        text.push_str(", \"positions\": [");
        if let Some(mask) = track.mask.as_ref().filter(|mask| mask.len() != track.positions.len()) {
            return Err(Error::Mask { index, found: mask.len(), positions: track.positions.len() });
        }
        for (number, position) in track.positions.iter().enumerate() {
            text.push_str(if number == 0 { "\n    " } else { ",\n    " });
            if !track.counts(number) {
                text.push_str("null");
                continue;
            }
            let [x, y, z] = position.map(|value| finite(index, "positions", value));
            let _ = write!(text, "[{}, {}, {}]", x?, y?, z?);
        }
        text.push_str("\n  ]}");
    }
    text.push_str("\n]}\n");
    Ok(text)
}

/// Writes a timeline as a file that [`read_timeline`] gives back.
///
/// # Errors
/// Those of [`timeline_text`], [`Error::Write`] when the file cannot be written.
pub fn write_timeline(path: &Path, spans: &[OwnedSpan]) -> Result<(), Error> {
    let text = timeline_text(spans)?;
    output::write_atomic(path, |w| w.write_all(text.as_bytes())).map_err(Error::Write)
}

/// The text of such a file: `first_frame` and `frames` rather than seconds. All of it comes back.
///
/// # Errors
/// [`Error::NoParts`], and [`Error::Range`] for a span without frames.
pub fn timeline_text(spans: &[OwnedSpan]) -> Result<String, Error> {
    let mut text = String::from("{\"timeline\": [");
    // Writing to a string cannot fail.
    for (index, span) in spans.iter().enumerate() {
        let parts = match names_of_parts(span.parts)[..] {
            [] => return Err(Error::NoParts { index }),
            [name] => Value::from(name),
            ref names => names.iter().copied().collect(),
        };
        if span.frames == 0 {
            let place = Place::span(index);
            return Err(Error::Range { place, field: "frames", value: 0.0, range: timeline::LENGTHS });
        }
        let (field, prompt) = match &span.prompt {
            OwnedPrompt::Text(text) => ("text", text),
            OwnedPrompt::Bank(name) => ("prompt", name),
        };
        let (comma, first, frames) = (if index == 0 { "" } else { "," }, span.first, span.frames);
        let prompt = Value::from(prompt.as_str());
        let _ = write!(
            text,
            "{comma}\n  {{\"parts\": {parts}, \"first_frame\": {first}, \"frames\": {frames}, \"{field}\": {prompt}}}"
        );
    }
    text.push_str("\n]}\n");
    Ok(text)
}

/// The shortest digits that name this f32.
fn finite(index: usize, field: &'static str, value: f32) -> Result<String, Error> {
    if value.is_finite() {
        return Ok(value.to_string());
    }
    let fault = entries::Fault::NotFinite { field, value: f64::from(value) };
    Err(Error::Field { place: Place::track(index), fault })
}
