//! A player and the servos that it moves: their start, their ticks, and what happens when a bus fails.

use super::{Held, Lost, Output, Time};
use crate::playback::control::State;
use crate::playback::player::Player;
use crate::playback::start::{Start, StartFault};

/// Attempts in a tick, and in a tick after one in which all failed: a bus that is down must not keep the processor from its work.
const ATTEMPTS: u32 = 4;
const ATTEMPTS_WHEN_DOWN: u32 = 2;
/// Seconds without commands after which servos that have lost their power, and cannot say where they are, are no longer taken to be
/// about where they were.
const REMEMBERED: u32 = 1;

/// Degrees beyond its range at which a servo may be found as power comes up: gears have play.
const PLAY: f32 = 1.0;
/// The same when it has lost its power in motion: it coasts on.
const COASTED: f32 = 20.0;

/// What a runner has counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BusStatus {
    /// Attempts that failed.
    pub errors: u32,
    /// Ticks in which a later attempt succeeded.
    pub retried: u32,
    /// Ticks in which none did, or in which servos that had lost their power were being found again.
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

/// What a runner is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Every servo is asked where it stands; nothing is switched on.
    Find,
    /// Every servo is made to hold where it stands.
    Hold,
    /// Servos get commands.
    Run,
}

/// A player and the servos it moves.
pub struct Runner<'a, O, const C: usize> {
    player: Player<'a, C>,
    output: O,
    bus: BusStatus,
    phase: Phase,
    /// The channel that is asked next, and for how many ticks it has not answered; from a second on it is said to be silent.
    next: usize,
    misses: u16,
    /// Where servos were found, degrees.
    found: [f32; C],
    /// Some servo cannot say where it stands.
    blind: bool,
    /// The servos have been moved before: those that cannot say where they stand are where the player has them.
    known: bool,
    /// Ticks without commands in a row.
    down: u32,
}

impl<'a, O: Output, const C: usize> Runner<'a, O, C> {
    /// Servos of `output` moved by `player`, once they have been found.
    pub const fn new(player: Player<'a, C>, output: O) -> Self {
        let bus = BusStatus { errors: 0, retried: 0, failed: 0, down: false };
        let (found, phase) = ([0.0; C], Phase::Find);
        Runner { player, output, bus, phase, next: 0, misses: 0, found, blind: false, known: false, down: 0 }
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

    /// One tick, to be called [`Player::tick_rate`] times a second: in a start, one attempt to ask one servo; then at most a few
    /// attempts to give all of them their commands, none of which begins when `budget` microseconds of the clock `now` are over.
    pub fn tick(&mut self, now: &mut dyn FnMut() -> u32, budget: u32) -> Ticked<O::Error> {
        let mut time = Time::new(now, budget);
        match self.phase {
            Phase::Run => self.run(&mut time),
            _ => self.start(&mut time),
        }
    }

    /// One tick of a start.
    #[inline(never)]
    fn start(&mut self, time: &mut Time<'_>) -> Ticked<O::Error> {
        let (start, failed) = if self.next < self.player.channels().len() {
            self.ask(time)
        } else if self.phase == Phase::Hold {
            self.player.stand_at(&self.found);
            (self.phase, self.known) = (Phase::Run, true);
            return self.run(time);
        } else if self.blind && !self.player.control().released() {
            (Start::Waiting, None)
        } else {
            (self.phase, self.next) = (Phase::Hold, 0);
            (Start::Reading, None)
        };
        self.bus.down = self.known || failed.is_some();
        self.bus.failed = self.bus.failed.wrapping_add(u32::from(self.known));
        self.down = self.down.saturating_add(1);
        Ticked { state: self.player.wait(start), failed }
    }

    /// Asks the servo whose turn it is, and those behind it while nobody can say anything.
    #[inline(never)]
    fn ask(&mut self, time: &mut Time<'_>) -> (Start, Option<O::Error>) {
        let channels = self.player.channels();
        loop {
            let index = self.next;
            let refused = |why| (Start::Refused { channel: index as u8, why }, None);
            let (Some(channel), Some(found)) = (channels.get(index), self.found.get_mut(index)) else {
                return (Start::Reading, None);
            };
            let slack = if self.known { COASTED } else { PLAY };
            let answer = match self.phase {
                Phase::Find => {
                    let found = self.output.find(channels, index, time);
                    found.map(|found| found.map_or(Held::Unknown, Held::At))
                }
                _ => self.output.hold(channels, index, slack, time),
            };
            let at = match answer {
                Err(error) => {
                    // When power comes up, servos take their time.
                    self.bus.errors = self.bus.errors.wrapping_add(u32::from(self.known));
                    self.misses = self.misses.saturating_add(1);
                    let patient = self.misses < self.player.tick_rate();
                    let start = if patient { Start::Reading } else { refused(StartFault::Silent).0 };
                    return (start, Some(error));
                }
                Ok(Held::At(command)) if channel.admits(command, slack) => Some(channel.degrees(command)),
                Ok(Held::At(command)) => {
                    let decidegrees = (10.0 * channel.degrees(command)) as i16;
                    return refused(StartFault::OutOfRange { decidegrees });
                }
                Ok(Held::Moving) => return (Start::Reading, None),
                Ok(Held::Unknown) if self.known => self.player.angles().nth(index),
                Ok(Held::Unknown) => {
                    self.blind = true;
                    channel.start
                }
            };
            // A servo that should say where it stands may be on an output that cannot ask it.
            let Some(at) = at else { return refused(StartFault::Silent) };
            (*found, self.next, self.misses) = (at, index.saturating_add(1), 0);
            if !matches!(answer, Ok(Held::Unknown)) || time.left() == 0 {
                return (Start::Reading, None);
            }
        }
    }

    /// The start begins again.
    fn again(&mut self, phase: Phase) {
        (self.phase, self.next, self.misses) = (phase, 0, 0);
    }

    /// One tick of servos that are known to be where they should be.
    #[inline(never)]
    fn run(&mut self, time: &mut Time<'_>) -> Ticked<O::Error> {
        let channels = self.player.channels();
        let remembered = REMEMBERED.saturating_mul(u32::from(self.player.tick_rate()));
        let servos = if self.bus.down { self.player.stand() } else { self.player.tick() };
        let state = servos.state;
        let mut failed = None;
        let most = if self.bus.down { ATTEMPTS_WHEN_DOWN } else { ATTEMPTS };
        for attempt in 1.. {
            let Err(error) = self.output.write(channels, servos.commands, time) else { break };
            self.bus.errors = self.bus.errors.wrapping_add(1);
            let phase = match O::lost(&error) {
                Some(Lost::Readable) => Phase::Hold,
                Some(Lost::Blind) if self.down > remembered => Phase::Find,
                _ => Phase::Run,
            };
            failed = Some(error);
            if phase != Phase::Run || attempt >= most || time.left() == 0 {
                self.bus.failed = self.bus.failed.wrapping_add(1);
                self.bus.down = true;
                self.down = self.down.saturating_add(1);
                self.player.rewind();
                if phase != Phase::Run {
                    self.again(phase);
                }
                if phase == Phase::Find {
                    self.known = false;
                    self.player.control().withdraw();
                }
                return Ticked { state: State::Holding, failed };
            }
        }
        self.bus.retried = self.bus.retried.wrapping_add(u32::from(failed.is_some()));
        self.bus.down = false;
        self.down = 0;
        Ticked { state, failed: None }
    }
}
