//! Commands onto pins and buses, and what happens when a bus fails.
//!
//! An [`Output`] makes one attempt to give servos their commands. A [`Runner`] is what a timer interrupt calls: it brings the robot
//! from power coming up to where it may play ([`Start`](super::Start)), ticks the player, tries again while the tick's time lasts, and
//! when nothing helped leaves the motion standing where servos last heard of it, until the bus is back. Outputs can be paired:
//! `(Pca9685, Sts3215)` is an output, too; `Gate` adds an output-enable pin to one.

#[cfg(any(feature = "pca9685", feature = "pwm"))]
mod gate;
#[cfg(feature = "pca9685")]
mod pca9685;
#[cfg(feature = "pwm")]
mod pwm;
#[cfg(feature = "sts3215")]
pub mod sts3215;

mod runner;

#[cfg(any(feature = "pca9685", feature = "pwm"))]
pub use self::gate::Gate;
#[cfg(feature = "pca9685")]
pub use self::pca9685::{Pca9685, Pca9685Error};
#[cfg(feature = "pwm")]
pub use pwm::{Pwm, PwmError};
pub use runner::{BusStatus, Runner, Ticked};
#[cfg(feature = "sts3215")]
pub use sts3215::{Sts3215, Sts3215Error};

use super::robot::Channel;

/// A clock, and until when there is time.
pub struct Time<'a> {
    now: &'a mut dyn FnMut() -> u32,
    end: u32,
}

impl<'a> Time<'a> {
    /// `budget` microseconds from now on; `now` is a free-running count of microseconds, which may wrap.
    pub fn new(now: &'a mut dyn FnMut() -> u32, budget: u32) -> Self {
        let end = now().wrapping_add(budget);
        Time { now, end }
    }

    /// Microseconds that are left.
    pub fn left(&mut self) -> u32 {
        let left = self.end.wrapping_sub((self.now)());
        // More than half of the count is the past.
        if left > u32::MAX / 2 { 0 } else { left }
    }
}

/// What an error says of the servos' power.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Lost {
    /// It was lost; the servos can be asked where they have come to stand.
    Readable,
    /// It was lost, and nobody can say where they have come to stand.
    Blind,
}

/// What came of making a servo hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Held {
    /// It cannot say where it stands, and is left as it is.
    Unknown,
    /// It moves too fast to be stopped gently, and is left as it is.
    Moving,
    /// It stands at this command, and holds there if it was allowed to; else it is left as it is.
    At(u16),
}

/// Gives servos their commands. `index` is that of a channel among `channels`, of which an output serves those of its own bus.
///
/// Every method makes one attempt, MUST return before `time` is over or soon after, and MUST be able to go on after an error.
pub trait Output {
    /// What can go wrong.
    type Error;

    /// Whether this output serves a channel.
    fn serves(&self, channel: &Channel) -> bool;

    /// Finds out where a servo stands, as a command; `None` when it cannot say it. Switches nothing on, and stops the pulses of one that
    /// cannot say where it stands: this is called before the robot is known to be where it should be.
    ///
    /// # Errors
    /// It does not answer.
    fn find(&mut self, channels: &[Channel], index: usize, time: &mut Time<'_>) -> Result<Option<u16>, Self::Error>;

    /// Makes a servo hold where it stands, and says where that is. Outside its range, but by no more than `slack` degrees
    /// ([`Channel::admits`]), it is brought back to its end as slowly as it can be told to; farther off it is left as it is.
    ///
    /// # Errors
    /// It does not answer, or has not understood.
    fn hold(
        &mut self,
        channels: &[Channel],
        index: usize,
        slack: f32,
        time: &mut Time<'_>,
    ) -> Result<Held, Self::Error>;

    /// Gives every servo of this output its command; `commands` go with `channels`. Sets the bus or its chips up anew when needed, but
    /// MUST NOT move a servo that has lost its power.
    ///
    /// # Errors
    /// Some servo did not get its command, as far as can be told.
    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error>;

    /// What an error of [`Output::write`] says of the servos' power; `None` when they have it.
    fn lost(error: &Self::Error) -> Option<Lost>;
}

impl<T: Output + ?Sized> Output for &mut T {
    type Error = T::Error;

    fn serves(&self, channel: &Channel) -> bool {
        (**self).serves(channel)
    }

    fn find(&mut self, channels: &[Channel], index: usize, time: &mut Time<'_>) -> Result<Option<u16>, Self::Error> {
        (**self).find(channels, index, time)
    }

    fn hold(
        &mut self,
        channels: &[Channel],
        index: usize,
        slack: f32,
        time: &mut Time<'_>,
    ) -> Result<Held, Self::Error> {
        (**self).hold(channels, index, slack, time)
    }

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error> {
        (**self).write(channels, commands, time)
    }

    fn lost(error: &Self::Error) -> Option<Lost> {
        T::lost(error)
    }
}

/// Which of two outputs failed first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EitherError<A, B> {
    /// The first.
    First(A),
    /// The second.
    Second(B),
}

impl<A: Output, B: Output> Output for (A, B) {
    type Error = EitherError<A::Error, B::Error>;

    fn serves(&self, channel: &Channel) -> bool {
        self.0.serves(channel) || self.1.serves(channel)
    }

    fn find(&mut self, channels: &[Channel], index: usize, time: &mut Time<'_>) -> Result<Option<u16>, Self::Error> {
        if channels.get(index).is_some_and(|channel| self.0.serves(channel)) {
            self.0.find(channels, index, time).map_err(EitherError::First)
        } else {
            self.1.find(channels, index, time).map_err(EitherError::Second)
        }
    }

    fn hold(
        &mut self,
        channels: &[Channel],
        index: usize,
        slack: f32,
        time: &mut Time<'_>,
    ) -> Result<Held, Self::Error> {
        if channels.get(index).is_some_and(|channel| self.0.serves(channel)) {
            self.0.hold(channels, index, slack, time).map_err(EitherError::First)
        } else {
            self.1.hold(channels, index, slack, time).map_err(EitherError::Second)
        }
    }

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error> {
        // Both get their chance, whatever the other does.
        let first = self.0.write(channels, commands, time).map_err(EitherError::First);
        let second = self.1.write(channels, commands, time).map_err(EitherError::Second);
        match (first, second) {
            // What was lost must be known.
            (Err(first), Err(second)) if Self::lost(&first).is_none() => Err(second),
            (first, second) => first.and(second),
        }
    }

    fn lost(error: &Self::Error) -> Option<Lost> {
        match error {
            EitherError::First(error) => A::lost(error),
            EitherError::Second(error) => B::lost(error),
        }
    }
}
