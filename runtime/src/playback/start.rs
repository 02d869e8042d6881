//! How a robot's start stands: from power coming up to the first motion that may be played.
//!
//! ```text
//!            all answer, all inside their range          all hold where they stand         there
//! Reading ────────────────────────────────────► Waiting ───────────────────────► Creeping ──────► Ready
//!   │  ▲                                         (until release, only where                          │
//!   ▼  │ it answers, and stands in its range      servos cannot say where they stand)                │
//! Refused                Reading ◄────────────────────────── servos have lost their power ───────────┘
//! ```

/// How a start stands. Motions that are queued before [`Start::Ready`] wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Start {
    /// It is found out where the servos stand. Those that are off stay off, and those that cannot say it get no pulses.
    #[default]
    Reading,
    /// Some servos cannot say where they stand: the robot is to be brought to the pose that its description states for the start.
    /// They get no pulses before [`Control::release`](super::Control::release).
    Waiting,
    /// The servos are on and go slowly from where they stood to where they are to be.
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

/// Why a servo keeps the robot from starting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
    /// As one number, for an atomic: kind, channel, and what the fault carries.
    pub(super) const fn to_bits(self) -> u32 {
        match self {
            Start::Reading => 0,
            Start::Waiting => 1,
            Start::Creeping => 2,
            Start::Ready => 3,
            Start::Refused { channel, why: StartFault::Silent } => 4 | (channel as u32) << 8,
            Start::Refused { channel, why: StartFault::OutOfRange { decidegrees } } => {
                5 | (channel as u32) << 8 | (decidegrees as u16 as u32) << 16
            }
        }
    }

    /// The inverse of [`Start::to_bits`].
    pub(super) const fn from_bits(bits: u32) -> Self {
        let [kind, channel, low, high] = bits.to_le_bytes();
        match kind {
            1 => Start::Waiting,
            2 => Start::Creeping,
            3 => Start::Ready,
            4 => Start::Refused { channel, why: StartFault::Silent },
            5 => {
                let decidegrees = i16::from_le_bytes([low, high]);
                Start::Refused { channel, why: StartFault::OutOfRange { decidegrees } }
            }
            _ => Start::Reading,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_start_survives_the_atomic() {
        let refused = |channel, why| Start::Refused { channel, why };
        for start in [
            Start::Reading,
            Start::Waiting,
            Start::Creeping,
            Start::Ready,
            refused(31, StartFault::Silent),
            refused(7, StartFault::OutOfRange { decidegrees: -1234 }),
            refused(0, StartFault::OutOfRange { decidegrees: i16::MAX }),
        ] {
            assert_eq!(Start::from_bits(start.to_bits()), start);
        }
    }
}
