//! What can be wrong with an anchors file.

use std::path::PathBuf;

use motionette::Joint;
use motionette::request::conditions::AnchorError;

use crate::entries::{Fault, Misformed};
use crate::motion::skeleton;
use crate::output;

/// What is wrong, where, and what to do. `index` counts anchors from 0.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the anchors file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("the anchors file cannot be written")]
    Write(#[source] output::Error),
    /// The text is not JSON, or not an object with a list `anchors` of objects.
    #[error(
        "line {line}, column {column}: {message}; an anchors file is {{\"anchors\": [{{\"time\": 2.0, \"root\": [x, y, z]}}, ...]}}"
    )]
    Json {
        /// Line, from 1.
        line: usize,
        /// Column, from 1; 0 before the first character of a line.
        column: usize,
        /// What the reader said.
        message: String,
    },
    /// A field nobody knows.
    #[error("anchor {index}: unknown field {field:?}; fields are {}", super::entry::FIELDS.join(", "))]
    UnknownField {
        /// The anchor.
        index: usize,
        /// The field.
        field: String,
    },
    /// A field stands twice.
    #[error("anchor {index}: {field} is given twice; remove one")]
    Repeated {
        /// The anchor.
        index: usize,
        /// The field.
        field: &'static str,
    },
    /// Neither `time` nor `frame`.
    #[error("anchor {index}: no time; give time (seconds) or frame")]
    NoTime {
        /// The anchor.
        index: usize,
    },
    /// Both `time` and `frame`.
    #[error("anchor {index}: both time and frame are given; keep one")]
    TwoTimes {
        /// The anchor.
        index: usize,
    },
    /// None of the targets.
    #[error("anchor {index}: no target; give root [x, y, z], planar_root [x, z], or joint and position [x, y, z]")]
    NoTarget {
        /// The anchor.
        index: usize,
    },
    /// More than one target.
    #[error("anchor {index}: several targets ({}); keep one, or make them anchors of their own", fields.join(", "))]
    SeveralTargets {
        /// The anchor.
        index: usize,
        /// The fields given.
        fields: Vec<&'static str>,
    },
    /// `joint` without `position` or the other way round.
    #[error("anchor {index}: {field} needs {missing} beside it")]
    Half {
        /// The anchor.
        index: usize,
        /// The field given.
        field: &'static str,
        /// The field that lacks.
        missing: &'static str,
    },
    /// A field holds something else than it should.
    #[error("anchor {index}: {field} must be {expected}, not {found}")]
    Type {
        /// The anchor.
        index: usize,
        /// The field.
        field: &'static str,
        /// What it should be.
        expected: &'static str,
        /// What it is, shortened.
        found: String,
    },
    /// A joint nobody knows.
    #[error("anchor {index}: there is no joint {found:?}; joints are {}", skeleton::NAMES.join(", "))]
    UnknownJoint {
        /// The anchor.
        index: usize,
        /// The name.
        found: String,
    },
    /// A joint index outside the skeleton, so it has no name to write.
    #[error("anchor {index}: there is no joint {joint}; the skeleton has {}", skeleton::NAMES.len())]
    NoSuchJoint {
        /// The anchor.
        index: usize,
        /// Its joint.
        joint: u8,
    },
    /// A number that is NaN, infinite, or too large for single precision.
    #[error("anchor {index}: {field} holds {value:e}, which is not a finite number of single precision")]
    NotFinite {
        /// The anchor.
        index: usize,
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// A time before the start.
    #[error("anchor {index}: {field} {value} lies before the start of the motion; times count from 0")]
    Negative {
        /// The anchor.
        index: usize,
        /// `time` or `frame`.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// A time no motion reaches: beyond frame 65535.
    #[error("anchor {index}: {field} {value} lies beyond any motion (frame {}, {} s)", u16::MAX, seconds(u16::MAX.into(), *frame_rate))]
    TooLate {
        /// The anchor.
        index: usize,
        /// `time` or `frame`.
        field: &'static str,
        /// The number.
        value: f64,
        /// Frames a second.
        frame_rate: u16,
    },
    /// A frame the motion does not have.
    #[error(
        "anchor {index}: frame {frame} ({:.2} s) lies beyond the end: the motion has {frames} frames ({:.2} s)",
        seconds((*frame).into(), *frame_rate), seconds(*frames, *frame_rate)
    )]
    BeyondEnd {
        /// The anchor.
        index: usize,
        /// Its frame.
        frame: u16,
        /// Frames of the motion.
        frames: usize,
        /// Frames a second.
        frame_rate: u16,
    },
    /// Two places for one joint at one frame.
    #[error(
        "anchors {first} and {second}: both say where {joint} is at frame {frame} ({:.2} s), and disagree; remove one",
        seconds((*frame).into(), *frame_rate)
    )]
    Conflict {
        /// The earlier anchor in the list.
        first: usize,
        /// The later one.
        second: usize,
        /// The joint; `root` and `planar_root` are the pelvis.
        joint: Joint,
        /// The frame.
        frame: u16,
        /// Frames a second.
        frame_rate: u16,
    },
    /// The runtime would refuse these anchors.
    #[error(transparent)]
    Refused(AnchorError),
}

/// How long so many frames take.
fn seconds(frames: usize, frame_rate: u16) -> f64 {
    frames as f64 / f64::from(frame_rate)
}

impl Error {
    /// A reader's complaint about the form.
    pub(super) fn json(Misformed { line, column, message }: Misformed) -> Self {
        Self::Json { line, column, message }
    }

    /// What is wrong with a field of an anchor.
    pub(super) fn of(index: usize, fault: Fault) -> Self {
        match fault {
            Fault::UnknownField { field, .. } => Self::UnknownField { index, field },
            Fault::Repeated { field } => Self::Repeated { index, field },
            Fault::NoTime => Self::NoTime { index },
            Fault::TwoTimes => Self::TwoTimes { index },
            Fault::Type { field, expected, found } => Self::Type { index, field, expected, found },
            Fault::UnknownJoint { found } => Self::UnknownJoint { index, found },
            Fault::NotFinite { field, value } => Self::NotFinite { index, field, value },
            Fault::Negative { field, value } => Self::Negative { index, field, value },
            Fault::TooLate { field, value, frame_rate } => Self::TooLate { index, field, value, frame_rate },
        }
    }
}
