//! What can be wrong with a tracks file, a scene file or a timeline file.

use std::fmt;
use std::path::PathBuf;

use motionette::BodyParts;

use crate::entries::{Fault, Misformed};
use crate::motion::skeleton;
use crate::output;

/// Which of the files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum List {
    /// A tracks file.
    Tracks,
    /// A scene file.
    Obstacles,
    /// A timeline file.
    Timeline,
}

impl List {
    /// What the file looks like.
    const fn form(self) -> &'static str {
        match self {
            List::Tracks => {
                r#"a tracks file is {"tracks": [{"joint": "right_wrist", "frame": 0, "positions": [[x, y, z], ...]}, ...]}"#
            }
            List::Obstacles => r#"a scene file is {"obstacles": [{"sphere": {"radius": 0.3}, "at": [x, y, z]}, ...]}"#,
            List::Timeline => {
                r#"a timeline file is {"timeline": [{"parts": "right_arm", "from": 1.0, "to": 3.0, "text": "a person waves"}, ...]}"#
            }
        }
    }
}

/// Which entry of which list, counted from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// The list.
    pub list: List,
    /// The track, obstacle or span.
    pub index: usize,
    /// The keyframe of an obstacle.
    pub keyframe: Option<usize>,
}

impl Place {
    /// A track.
    pub(super) const fn track(index: usize) -> Self {
        Place { list: List::Tracks, index, keyframe: None }
    }

    /// An obstacle.
    pub(super) const fn obstacle(index: usize) -> Self {
        Place { list: List::Obstacles, index, keyframe: None }
    }

    /// A span of a timeline.
    pub(super) const fn span(index: usize) -> Self {
        Place { list: List::Timeline, index, keyframe: None }
    }

    /// A keyframe of this obstacle.
    pub(super) const fn keyframe(self, keyframe: usize) -> Self {
        Place { keyframe: Some(keyframe), ..self }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self.list {
            List::Tracks => "track",
            List::Obstacles => "obstacle",
            List::Timeline => "span",
        };
        write!(f, "{name} {}", self.index)?;
        self.keyframe.map_or(Ok(()), |keyframe| write!(f, ", keyframe {keyframe}"))
    }
}

/// What is wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("the file cannot be written")]
    Write(#[source] output::Error),
    /// The text is not JSON, or not an object with the one list of objects.
    #[error("line {line}, column {column}: {message}; {}", list.form())]
    Json {
        /// Which file it was to be.
        list: List,
        /// Line, from 1.
        line: usize,
        /// Column, from 1; 0 before the first character of a line.
        column: usize,
        /// What the reader said.
        message: String,
    },
    /// A field is unknown, stands twice, or holds something else than it should.
    #[error("{place}: {fault}")]
    Field {
        /// The entry.
        place: Place,
        /// What is wrong.
        fault: Fault,
    },
    /// A field lacks.
    #[error("{place}: {field} is missing; give {example}")]
    Missing {
        /// The entry.
        place: Place,
        /// The field.
        field: &'static str,
        /// What it may look like.
        example: &'static str,
    },
    /// A number is too large or too small.
    #[error("{place}: {field} is {value}; it must be {range}")]
    Range {
        /// The entry.
        place: Place,
        /// The field.
        field: &'static str,
        /// The number.
        value: f32,
        /// What it may be.
        range: &'static str,
    },
    /// The mask has another length than the positions.
    #[error("track {index}: its mask has {found} entries for {positions} positions; give one for each")]
    Mask {
        /// The track.
        index: usize,
        /// Entries of its mask.
        found: usize,
        /// Its positions.
        positions: usize,
    },
    /// No position counts.
    #[error("track {index}: no position counts; give some that are neither null nor 0 in the mask")]
    Nothing {
        /// The track.
        index: usize,
    },
    /// Positions at a frame rate of their own, of which none falls on a frame.
    #[error(
        "track {index}: at its frame_rate nothing of it falls on a frame of the model, which has {frame_rate} a second; give more positions, without null between them"
    )]
    BetweenFrames {
        /// The track.
        index: usize,
        /// The model's frames a second.
        frame_rate: u16,
    },
    /// The last position lies beyond frame 65535.
    #[error("track {index}: its last position lies at frame {frame}, beyond any motion (frame {})", u16::MAX)]
    TooLong {
        /// The track.
        index: usize,
        /// Frame of its last position.
        frame: u64,
    },
    /// None of the forms, or several.
    #[error(
        "obstacle {index}: {}; give exactly one of {}",
        if fields.is_empty() { "it has no form".to_owned() } else { format!("several forms ({})", fields.join(", ")) },
        super::obstacle::SHAPES.join(", ")
    )]
    Shape {
        /// The obstacle.
        index: usize,
        /// The forms given.
        fields: Vec<&'static str>,
    },
    /// Two fields that exclude each other.
    #[error("{place}: {first} and {second} are both given; keep one")]
    Both {
        /// The entry.
        place: Place,
        /// The one.
        first: &'static str,
        /// The other.
        second: &'static str,
    },
    /// A keyframe is not behind the one before it.
    #[error(
        "obstacle {index}, keyframe {keyframe}: its frame {frame} is not behind that of the keyframe before it; sort them by time"
    )]
    KeyframeOrder {
        /// The obstacle.
        index: usize,
        /// The keyframe.
        keyframe: usize,
        /// Its frame.
        frame: u16,
    },
    /// A joint index outside the skeleton, so it has no name to write.
    #[error("track {index}: there is no joint {joint}; the skeleton has {}", skeleton::NAMES.len())]
    NoSuchJoint {
        /// The track.
        index: usize,
        /// Its joint.
        joint: u8,
    },
    /// A part of the body that has no name.
    #[error("span {index}: there is no part {found:?}; parts are {}", BodyParts::NAMED.map(|(name, _)| name).join(", "))]
    UnknownPart {
        /// The span.
        index: usize,
        /// The name.
        found: String,
    },
    /// No part at all, so there is no name to write.
    #[error("span {index}: it moves no part; name some")]
    NoParts {
        /// The span.
        index: usize,
    },
    /// When a span lasts is said in no way, by halves, or in both ways.
    #[error(
        "span {index}: {}; give either from and to (seconds) or first_frame and frames",
        if given.is_empty() { "no time".to_owned() } else { format!("its times are {}", given.join(", ")) }
    )]
    SpanTimes {
        /// The span.
        index: usize,
        /// The fields given.
        given: Vec<&'static str>,
    },
    /// A span that ends where it begins, or before.
    #[error("span {index}: to, {to} s, is not behind from, {from} s; give a later one")]
    EndsFirst {
        /// The span.
        index: usize,
        /// Its beginning, seconds.
        from: f64,
        /// Its end, seconds.
        to: f64,
    },
}

impl Error {
    /// A reader's complaint about the form.
    pub(super) fn json(list: List, Misformed { line, column, message }: Misformed) -> Self {
        Self::Json { list, line, column, message }
    }
}
