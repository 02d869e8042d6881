//! Serial bus servos: Feetech STS3215, on `embedded-io`.
//!
//! A packet is `FF FF id length instruction parameters.. checksum`; the length counts what follows it, the checksum is the inverted sum
//! of all bytes behind the header. All servos get their goals in one packet, which nobody answers; so before that, one servo a tick, in
//! turn, is asked where it stands and whether it is as it was set up. A servo that is gone or has lost its power, or a bus that garbles,
//! is found within as many ticks as there are servos, and after a silence no goal is sent before all servos have answered again. The bus
//! has one wire: the adapter must not echo what is sent.
//!
//! Whether power that comes up finds the motor on or off, and whether a goal switches it on, depends on the servo's firmware. So a servo
//! counts as set up when its motor is on *and* it keeps the speed and the acceleration that it was given, which are in its RAM; and no
//! goal is sent to one that is not, but where it stands ([`Output::hold`]).

use embedded_io::{Read, ReadReady, Write};

use super::{Held, Lost, Output, Time};
use crate::playback::robot::{Bus, Channel, MAX_CHANNELS};

/// Instructions.
pub mod instruction {
    /// Read registers.
    pub const READ: u8 = 0x02;
    /// Write registers.
    pub const WRITE: u8 = 0x03;
    /// Write the same registers of several servos.
    pub const SYNC_WRITE: u8 = 0x83;
}

/// Registers.
pub mod register {
    /// 1 when the motor is on.
    pub const TORQUE: u8 = 40;
    /// Largest acceleration, 100 positions a second squared; 0 is as much as it can.
    pub const ACCELERATION: u8 = 41;
    /// Goal, two bytes, low first.
    pub const GOAL: u8 = 42;
    /// Largest speed, two bytes, low first, positions a second; 0 is as fast as it can.
    pub const SPEED: u8 = 46;
    /// Where it stands, two bytes, low first.
    pub const POSITION: u8 = 56;
    /// How fast it turns, two bytes, low first, positions a second; the highest bit is the direction.
    pub const TURNING: u8 = 58;
}

/// The id that all servos listen to.
pub const BROADCAST: u8 = 0xFE;
/// First two bytes of a packet.
pub const HEADER: [u8; 2] = [0xFF, 0xFF];
/// Longest packet: goals of all channels.
const LONGEST: usize = 8 + 3 * MAX_CHANNELS;
/// Largest speed that is set; above it lies the direction.
const FASTEST: u16 = 0x7FFE;
/// Positions a second, 10 degrees.
const SLOW: u16 = 114;
/// How often a servo that sags is let sag on before it is stopped all the same.
const RESTLESS: u8 = 50;
/// Registers that are read: from [`register::TORQUE`] to the second byte of [`register::TURNING`].
const BLOCK: u8 = register::TURNING + 2 - register::TORQUE;
/// Bytes of the answer.
const ANSWER: usize = 6 + BLOCK as usize;

/// The servos of one bus.
#[derive(Debug)]
pub struct Sts3215<S> {
    port: S,
    /// Which servo is asked next.
    turn: usize,
    /// Servos that must answer before goals are sent again: there was a silence.
    doubted: usize,
    /// How often the servo that is to hold was found moving.
    restless: u8,
    positions: [Option<u16>; MAX_CHANNELS],
}

/// Why servos could not be written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Sts3215Error<E> {
    /// The port failed.
    Port(E),
    /// A servo did not answer in time.
    Silent {
        /// Which.
        id: u8,
    },
    /// An answer was garbled.
    Garbled {
        /// Whose.
        id: u8,
    },
    /// A servo's motor is off, or it has forgotten its limits: it has lost its power, or was switched off. [`Output::hold`] switches it
    /// on.
    Off {
        /// Which.
        id: u8,
    },
    /// After a silence, not all servos have been asked yet. Goals are sent when they have.
    Asking,
    /// A servo protects itself.
    Servo {
        /// Which.
        id: u8,
        /// Why: bit 0 voltage, 1 sensor, 2 temperature, 3 current, 5 overload.
        flags: u8,
    },
}

/// What a servo limits by itself, as its registers have it: a second guard behind the player's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Guard {
    acceleration: u8,
    speed: u16,
}

impl Guard {
    /// The limits of a channel, within what the registers can say.
    #[inline(never)]
    fn of(channel: &Channel) -> Self {
        let ([low, high], [first, last]) = (channel.range, channel.command.map(f32::from));
        let positions = (last - first) / (high - low);
        // Conversions saturate. An acceleration is rounded down, unless nothing were left; a speed up, so that it is no second lag.
        let (acceleration, speed) =
            ((channel.acceleration * positions / 100.0) as u8, (channel.speed * positions) as u16);
        let acceleration = match acceleration {
            0 => 1,
            u8::MAX => u8::MAX - 1,
            other => other,
        };
        Guard { acceleration, speed: if speed >= FASTEST { FASTEST } else { speed + 1 } }
    }

    /// The same as slowly as servos turn evenly, for one that comes back into its range by itself.
    const fn slow(self) -> Self {
        Guard { speed: if self.speed < SLOW { self.speed } else { SLOW }, ..self }
    }

    /// Positions a second from which a servo's controller, which takes some 15 ms to do so, stops it within its acceleration.
    const fn gentle(self) -> u16 {
        self.acceleration as u16 * 3 / 2
    }
}

/// What a servo says.
#[derive(Debug, Clone, Copy)]
struct Report {
    torque: bool,
    guard: Guard,
    goal: u16,
    position: u16,
    speed: u16,
}

/// The checksum of a packet's bytes behind the header.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u8 {
    !bytes.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte))
}

/// A packet in the making.
struct Packet {
    bytes: heapless::Vec<u8, LONGEST>,
}

impl Packet {
    #[inline(never)]
    fn new(id: u8, instruction: u8, parameters: &[u8]) -> Self {
        let mut packet = Packet { bytes: heapless::Vec::new() };
        packet.push(&HEADER);
        packet.push(&[id, 0, instruction]);
        packet.push(parameters);
        packet
    }

    #[inline(never)]
    fn push(&mut self, bytes: &[u8]) {
        // As long as the longest that is made.
        let _ = self.bytes.extend_from_slice(bytes);
    }

    #[inline(never)]
    fn send<S: Write>(mut self, port: &mut S) -> Result<(), S::Error> {
        // Length and checksum count the instruction, the parameters and one byte more.
        let length = self.bytes.len().saturating_sub(3) as u8;
        if let Some(field) = self.bytes.get_mut(3) {
            *field = length;
        }
        let sum = checksum(self.bytes.get(2..).unwrap_or(&[]));
        self.push(&[sum]);
        port.write_all(&self.bytes)?;
        port.flush()
    }
}

impl<S: Read + ReadReady + Write> Sts3215<S> {
    /// The servos on `port`. Nothing is sent yet.
    pub const fn new(port: S) -> Self {
        Sts3215 { port, turn: 0, doubted: 0, restless: 0, positions: [None; MAX_CHANNELS] }
    }

    /// The port.
    pub const fn port(&mut self) -> &mut S {
        &mut self.port
    }

    /// Where the servo of a channel last said that it stands.
    #[must_use]
    pub fn position(&self, channel: usize) -> Option<u16> {
        self.positions.get(channel).copied().flatten()
    }

    /// Asks the servo of a channel how it is.
    #[inline(never)]
    fn ask(&mut self, index: usize, id: u8, time: &mut Time<'_>) -> Result<Report, Sts3215Error<S::Error>> {
        // What is left of an answer that came too late.
        let mut byte = [0];
        for _ in 0..LONGEST {
            if !self.port.read_ready().map_err(Sts3215Error::Port)? {
                break;
            }
            self.port.read(&mut byte).map_err(Sts3215Error::Port)?;
        }
        let packet = Packet::new(id, instruction::READ, &[register::TORQUE, BLOCK]);
        packet.send(&mut self.port).map_err(Sts3215Error::Port)?;
        let mut answer = heapless::Vec::<u8, ANSWER>::new();
        while !answer.is_full() {
            if !self.port.read_ready().map_err(Sts3215Error::Port)? {
                if time.left() == 0 {
                    return Err(Sts3215Error::Silent { id });
                }
                continue;
            }
            if self.port.read(&mut byte).map_err(Sts3215Error::Port)? == 0 {
                return Err(Sts3215Error::Silent { id });
            }
            let [byte] = byte;
            let _ = answer.push(byte);
        }
        let garbled = Sts3215Error::Garbled { id };
        let Some((sum, packet)) = answer.split_last() else { return Err(garbled) };
        let [0xFF, 0xFF, content @ ..] = packet else { return Err(garbled) };
        let [from, length, flags, torque, acceleration, g0, g1, _, _, s0, s1, .., p0, p1, t0, t1] = *content else {
            return Err(garbled);
        };
        if from != id || length != BLOCK + 2 || *sum != checksum(content) {
            return Err(garbled);
        }
        if flags != 0 {
            return Err(Sts3215Error::Servo { id, flags });
        }
        let position = u16::from_le_bytes([p0, p1]);
        if let Some(slot) = self.positions.get_mut(index) {
            *slot = Some(position);
        }
        let guard = Guard { acceleration, speed: u16::from_le_bytes([s0, s1]) };
        let speed = u16::from_le_bytes([t0, t1]) & (i16::MAX as u16);
        Ok(Report { torque: torque != 0, guard, goal: u16::from_le_bytes([g0, g1]), position, speed })
    }

    /// Writes registers of a servo; nobody answers.
    #[inline(never)]
    fn set(&mut self, id: u8, register: u8, values: &[u8]) -> Result<(), Sts3215Error<S::Error>> {
        let mut packet = Packet::new(BROADCAST, instruction::SYNC_WRITE, &[register, values.len() as u8, id]);
        packet.push(values);
        packet.send(&mut self.port).map_err(Sts3215Error::Port)
    }

    /// Asks as many servos as must have answered before goals may be sent: the one whose turn it is, and after a silence all.
    #[inline(never)]
    fn check(&mut self, channels: &[Channel], time: &mut Time<'_>) -> Result<(), Sts3215Error<S::Error>> {
        let count = count(channels);
        loop {
            let Some((index, id)) = nth(channels, self.turn) else {
                self.turn = 0;
                return Ok(());
            };
            let report = match self.ask(index, id, time) {
                Ok(report) => report,
                Err(error) => {
                    if let Sts3215Error::Silent { .. } = error {
                        self.doubted = count;
                    }
                    return Err(error);
                }
            };
            let Some(channel) = channels.get(index) else { return Ok(()) };
            let guard = Guard::of(channel);
            let slow = report.guard != guard && report.guard == guard.slow();
            if !report.torque || !(slow || report.guard == guard) {
                return Err(Sts3215Error::Off { id });
            }
            if slow && channel.admits(report.position, 0.5) {
                // Back in its range.
                self.set(id, register::SPEED, &guard.speed.to_le_bytes())?;
            }
            self.turn = if self.turn + 1 < count { self.turn + 1 } else { 0 };
            self.doubted = self.doubted.saturating_sub(1);
            if self.doubted == 0 {
                return Ok(());
            }
            if time.left() == 0 {
                return Err(Sts3215Error::Asking);
            }
        }
    }
}

/// How many servos of this bus there are among the robot's.
#[inline(never)]
fn count(channels: &[Channel]) -> usize {
    mine(channels).count()
}

/// One of them: its channel and its id.
#[inline(never)]
fn nth(channels: &[Channel], number: usize) -> Option<(usize, u8)> {
    mine(channels).nth(number)
}

/// The servos of this bus among the robot's.
fn mine(channels: &[Channel]) -> impl Iterator<Item = (usize, u8)> + '_ {
    channels.iter().enumerate().filter_map(|(index, channel)| match channel.bus {
        Bus::Sts3215 { id } => Some((index, id)),
        _ => None,
    })
}

impl<S: Read + ReadReady + Write> Output for Sts3215<S> {
    type Error = Sts3215Error<S::Error>;

    fn serves(&self, channel: &Channel) -> bool {
        matches!(channel.bus, Bus::Sts3215 { .. })
    }

    fn find(&mut self, channels: &[Channel], index: usize, time: &mut Time<'_>) -> Result<Option<u16>, Self::Error> {
        let Some(Bus::Sts3215 { id }) = channels.get(index).map(|channel| channel.bus) else { return Ok(None) };
        self.ask(index, id, time).map(|report| Some(report.position))
    }

    fn hold(
        &mut self,
        channels: &[Channel],
        index: usize,
        slack: f32,
        time: &mut Time<'_>,
    ) -> Result<Held, Self::Error> {
        let Some(channel) = channels.get(index) else { return Ok(Held::Unknown) };
        let Bus::Sts3215 { id } = channel.bus else { return Ok(Held::Unknown) };
        // They are all asked now.
        self.doubted = 0;
        let (guard, report) = (Guard::of(channel), self.ask(index, id, time)?);
        if report.torque && report.guard == guard && channel.admits(report.goal, 0.0) {
            // It holds already: nothing but the microcontroller was reset, or others have lost their power.
            return Ok(Held::At(report.goal));
        }
        if !channel.admits(report.position, slack) {
            return Ok(Held::At(report.position));
        }
        if report.speed > guard.gentle() && self.restless < RESTLESS {
            self.restless += 1;
            return Ok(Held::Moving);
        }
        self.restless = 0;
        let [first, last] = channel.command;
        let goal = match report.position {
            below if below < first => first,
            above if above > last => last,
            inside => inside,
        };
        let guard = if goal == report.position { guard } else { guard.slow() };
        // One packet, so that no goal is ever without its limits, and read back, since writing is not answered.
        let ([g0, g1], [s0, s1]) = (goal.to_le_bytes(), guard.speed.to_le_bytes());
        self.set(id, register::ACCELERATION, &[guard.acceleration, g0, g1, 0, 0, s0, s1])?;
        let set = self.ask(index, id, time)?;
        if set.goal != goal || set.guard != guard {
            return Err(Sts3215Error::Garbled { id });
        }
        self.set(id, register::TORQUE, &[1])?;
        Ok(Held::At(goal))
    }

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error> {
        if mine(channels).next().is_none() {
            return Ok(());
        }
        self.check(channels, time)?;
        let mut packet = Packet::new(BROADCAST, instruction::SYNC_WRITE, &[register::GOAL, 2]);
        for (index, id) in mine(channels) {
            let [low, high] = commands.get(index).copied().unwrap_or(0).to_le_bytes();
            packet.push(&[id, low, high]);
        }
        packet.send(&mut self.port).map_err(Sts3215Error::Port)
    }

    fn lost(error: &Self::Error) -> Option<Lost> {
        matches!(error, Sts3215Error::Off { .. }).then_some(Lost::Readable)
    }
}
