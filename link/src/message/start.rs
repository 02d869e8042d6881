//! How the robot's start stands, on the wire.

use core::fmt;

use motionette::playback;
use serde::{Deserialize, Serialize};

/// [`playback::Start`]: from power coming up to the first motion that may be played.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Start {
    /// It is found out where the servos stand.
    Reading,
    /// Servos that cannot say where they stand get no pulses before [`Command::Release`](super::Command::Release).
    Waiting,
    /// The servos are on and go slowly to where they are to be.
    Creeping,
    /// Motions are played.
    Ready,
    /// A servo keeps the robot still. It is asked again and again; the start goes on when it is as it should be.
    Refused {
        /// Number of its channel.
        channel: u8,
        /// What is wrong with it.
        why: StartFault,
    },
}

/// [`playback::StartFault`]: why a servo keeps the robot from starting.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum StartFault {
    /// It does not answer, or not so that it can be understood.
    Silent,
    /// It stands outside its range.
    OutOfRange {
        /// Where, tenths of a degree.
        decidegrees: i16,
    },
}

impl Start {
    /// Whether it is at the same point as `other`: where a servo stands outside its range is of no account, since it may tremble.
    #[must_use]
    pub fn is_as(self, other: Start) -> bool {
        match (self, other) {
            (Start::Refused { channel, why }, Start::Refused { channel: other, why: for_what }) => {
                channel == other && core::mem::discriminant(&why) == core::mem::discriminant(&for_what)
            }
            _ => self == other,
        }
    }

    /// Whether it goes on by itself. A robot that reads its servos or creeps will move, one that waits or refuses stands.
    #[must_use]
    pub const fn is_under_way(self) -> bool {
        matches!(self, Start::Reading | Start::Creeping)
    }
}

impl From<playback::Start> for Start {
    fn from(start: playback::Start) -> Self {
        match start {
            playback::Start::Reading => Start::Reading,
            playback::Start::Waiting => Start::Waiting,
            playback::Start::Creeping => Start::Creeping,
            playback::Start::Ready => Start::Ready,
            playback::Start::Refused { channel, why } => Start::Refused { channel, why: why.into() },
        }
    }
}

impl From<playback::StartFault> for StartFault {
    fn from(fault: playback::StartFault) -> Self {
        match fault {
            playback::StartFault::Silent => StartFault::Silent,
            playback::StartFault::OutOfRange { decidegrees } => StartFault::OutOfRange { decidegrees },
        }
    }
}

impl fmt::Display for Start {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Start::Reading => write!(f, "the robot finds out where its servos stand"),
            Start::Waiting => write!(f, "the robot waits for its release: its servos get no pulses yet"),
            Start::Creeping => write!(f, "the robot goes slowly to its first pose"),
            Start::Ready => write!(f, "the robot has started"),
            Start::Refused { channel, why } => write!(f, "servo channel {channel} keeps the robot still: {why}"),
        }
    }
}

impl fmt::Display for StartFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            StartFault::Silent => write!(f, "it does not answer"),
            StartFault::OutOfRange { decidegrees } => {
                let (sign, tenths) = (if decidegrees < 0 { "-" } else { "" }, decidegrees.unsigned_abs());
                write!(f, "it stands at {sign}{}.{} degrees, outside its range", tenths / 10, tenths % 10)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_servo_that_trembles_is_no_news() {
        let refused = |channel, why| Start::Refused { channel, why };
        let (at, trembling) = (StartFault::OutOfRange { decidegrees: 3 }, StartFault::OutOfRange { decidegrees: 4 });
        assert!(refused(1, at).is_as(refused(1, trembling)) && Start::Ready.is_as(Start::Ready));
        assert!(!refused(1, at).is_as(refused(2, at)) && !refused(1, at).is_as(refused(1, StartFault::Silent)));
        assert!(!refused(1, at).is_as(Start::Reading) && !Start::Reading.is_as(Start::Creeping));
    }
}
