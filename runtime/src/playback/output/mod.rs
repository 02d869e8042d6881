//! Commands onto pins and buses, and what happens when a bus fails.
//!
//! An [`Output`] makes one attempt to give servos their commands. A [`Runner`] is what a timer interrupt calls: it ticks the player,
//! tries again while the tick's time lasts, and when nothing helped leaves the motion standing where servos last heard of it, until the
//! bus is back. Outputs can be paired: `(Pca9685, Sts3215)` is an output, too.

#[cfg(feature = "pca9685")]
mod pca9685;
#[cfg(feature = "pwm")]
mod pwm;
#[cfg(feature = "sts3215")]
pub mod sts3215;

#[cfg(feature = "pca9685")]
pub use self::pca9685::{Pca9685, Pca9685Error};
#[cfg(feature = "pwm")]
pub use pwm::{Pwm, PwmError};
#[cfg(feature = "sts3215")]
pub use sts3215::{Sts3215, Sts3215Error};

use super::control::State;
use super::player::Player;
use super::robot::Channel;

/// Attempts in a tick, and in a tick after one in which all failed: a bus that is down must not keep the processor from its work.
const ATTEMPTS: u32 = 4;
const ATTEMPTS_WHEN_DOWN: u32 = 2;

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

/// Gives servos their commands.
pub trait Output {
    /// What can go wrong.
    type Error;

    /// One attempt to give every servo of this output its command; `commands` go with `channels`, of which an output serves those of
    /// its own bus. MUST return before `time` is over, and MUST be able to write again after an error, setting the bus or its chips up
    /// anew when needed.
    ///
    /// # Errors
    /// Some servo did not get its command, as far as can be told.
    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error>;
}

impl<T: Output + ?Sized> Output for &mut T {
    type Error = T::Error;

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error> {
        (**self).write(channels, commands, time)
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

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error> {
        // Both get their chance, whatever the other does.
        let first = self.0.write(channels, commands, time).map_err(EitherError::First);
        let second = self.1.write(channels, commands, time).map_err(EitherError::Second);
        first.and(second)
    }
}

/// What a runner has counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BusStatus {
    /// Attempts that failed.
    pub errors: u32,
    /// Ticks in which a later attempt succeeded.
    pub retried: u32,
    /// Ticks in which none did.
    pub failed: u32,
    /// Whether the last tick was one of these: servos stand where they last heard.
    pub down: bool,
}

/// What a tick did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Ticked<E> {
    /// What the player does.
    pub state: State,
    /// The last error, if no attempt succeeded.
    pub failed: Option<E>,
}

/// A player and the servos it moves.
pub struct Runner<'a, O, const C: usize> {
    player: Player<'a, C>,
    output: O,
    bus: BusStatus,
}

impl<'a, O: Output, const C: usize> Runner<'a, O, C> {
    /// Servos of `output` moved by `player`.
    pub const fn new(player: Player<'a, C>, output: O) -> Self {
        Runner { player, output, bus: BusStatus { errors: 0, retried: 0, failed: 0, down: false } }
    }

    /// The player.
    #[must_use]
    pub const fn player(&self) -> &Player<'a, C> {
        &self.player
    }

    /// The output.
    pub const fn output(&mut self) -> &mut O {
        &mut self.output
    }

    /// What has happened on the bus.
    #[must_use]
    pub const fn bus(&self) -> &BusStatus {
        &self.bus
    }

    /// One tick, in at most a few attempts, none of which begins when `budget` microseconds of the clock `now` are over: to be called [`Player::tick_rate`] times a
    /// second.
    pub fn tick(&mut self, now: &mut dyn FnMut() -> u32, budget: u32) -> Ticked<O::Error> {
        let mut time = Time::new(now, budget);
        let channels = self.player.channels();
        let servos = if self.bus.down { self.player.stand() } else { self.player.tick() };
        let state = servos.state;
        let mut failed = None;
        let most = if self.bus.down { ATTEMPTS_WHEN_DOWN } else { ATTEMPTS };
        for attempt in 1.. {
            match self.output.write(channels, servos.commands, &mut time) {
                Ok(()) => break,
                Err(error) => {
                    self.bus.errors = self.bus.errors.wrapping_add(1);
                    failed = Some(error);
                    if attempt >= most || time.left() == 0 {
                        self.bus.failed = self.bus.failed.wrapping_add(1);
                        self.bus.down = true;
                        self.player.rewind();
                        return Ticked { state: State::Holding, failed };
                    }
                }
            }
        }
        self.bus.retried = self.bus.retried.wrapping_add(u32::from(failed.is_some()));
        self.bus.down = false;
        Ticked { state, failed: None }
    }
}
