//! What can be wrong with a field of an entry, whatever the list it stands in.

use crate::motion::skeleton;

/// What is wrong, and what to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// A field nobody knows.
    #[error("unknown field {field:?}; fields are {}", known.join(", "))]
    UnknownField {
        /// The field.
        field: String,
        /// Those there are.
        known: &'static [&'static str],
    },
    /// A field stands twice.
    #[error("{field} is given twice; remove one")]
    Repeated {
        /// The field.
        field: &'static str,
    },
    /// Neither `time` nor `frame`.
    #[error("no time; give time (seconds) or frame")]
    NoTime,
    /// Both `time` and `frame`.
    #[error("both time and frame are given; keep one")]
    TwoTimes,
    /// A field holds something else than it should.
    #[error("{field} must be {expected}, not {found}")]
    Type {
        /// The field.
        field: &'static str,
        /// What it should be.
        expected: &'static str,
        /// What it is, shortened.
        found: String,
    },
    /// A joint nobody knows.
    #[error("there is no joint {found:?}; joints are {}", skeleton::NAMES.join(", "))]
    UnknownJoint {
        /// The name.
        found: String,
    },
    /// A number that is NaN, infinite, or too large for single precision.
    #[error("{field} holds {value:e}, which is not a finite number of single precision")]
    NotFinite {
        /// The field.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// A time before the start.
    #[error("{field} {value} lies before the start of the motion; times count from 0")]
    Negative {
        /// The field, as `time` or `frame`.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// A time no motion reaches: beyond frame 65535.
    #[error("{field} {value} lies beyond any motion (frame {}, {} s)", u16::MAX, f64::from(u16::MAX) / f64::from(*frame_rate))]
    TooLate {
        /// The field, as `time` or `frame`.
        field: &'static str,
        /// The number.
        value: f64,
        /// Frames a second.
        frame_rate: u16,
    },
}
