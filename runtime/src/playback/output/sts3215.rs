//! Serial bus servos: Feetech STS3215, on `embedded-io`.
//!
//! A packet is `FF FF id length instruction parameters.. checksum`; the length counts what follows it, the checksum is the inverted sum
//! of all bytes behind the header. All servos get their goals in one packet, which nobody answers; so one servo a tick, in turn, is
//! asked where it stands and whether its motor is on, and a servo that is gone or has lost its power, or a bus that garbles, is found within as many ticks as there are servos. The bus
//! has one wire: the adapter must not echo what is sent.

use embedded_io::{Read, ReadReady, Write};

use super::{Output, Time};
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
    /// Goal, two bytes, low first.
    pub const GOAL: u8 = 42;
    /// Where it stands, two bytes, low first.
    pub const POSITION: u8 = 56;
}

/// The id that all servos listen to.
pub const BROADCAST: u8 = 0xFE;
/// First two bytes of a packet.
pub const HEADER: [u8; 2] = [0xFF, 0xFF];
/// Longest packet: goals of all channels.
const LONGEST: usize = 8 + 3 * MAX_CHANNELS;
/// Registers that are read: from [`register::TORQUE`] to the second byte of [`register::POSITION`].
const BLOCK: u8 = register::POSITION + 2 - register::TORQUE;
/// Bytes of the answer.
const ANSWER: usize = 6 + BLOCK as usize;

/// The servos of one bus.
#[derive(Debug)]
pub struct Sts3215<S> {
    port: S,
    /// Which servo is asked next.
    turn: usize,
    /// Motors may be off.
    cold: bool,
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
    /// A servo's motor is off: it has lost its power, or was switched off. The next attempt switches it on.
    Off {
        /// Which.
        id: u8,
    },
    /// A servo protects itself.
    Servo {
        /// Which.
        id: u8,
        /// Why: bit 0 voltage, 1 sensor, 2 temperature, 3 current, 5 overload.
        flags: u8,
    },
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
    fn new(id: u8, instruction: u8, parameters: &[u8]) -> Self {
        let mut packet = Packet { bytes: heapless::Vec::new() };
        packet.push(&HEADER);
        packet.push(&[id, 0, instruction]);
        packet.push(parameters);
        packet
    }

    fn push(&mut self, bytes: &[u8]) {
        // As long as the longest that is made.
        let _ = self.bytes.extend_from_slice(bytes);
    }

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
        Sts3215 { port, turn: 0, cold: true, positions: [None; MAX_CHANNELS] }
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

    /// Asks a servo where it stands.
    fn ask(&mut self, id: u8, time: &mut Time<'_>) -> Result<u16, Sts3215Error<S::Error>> {
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
        let [from, length, flags, torque, .., low, high] = *content else { return Err(garbled) };
        if from != id || length != BLOCK + 2 || *sum != checksum(content) {
            return Err(garbled);
        }
        if flags != 0 {
            return Err(Sts3215Error::Servo { id, flags });
        }
        if torque == 0 {
            return Err(Sts3215Error::Off { id });
        }
        Ok(u16::from_le_bytes([low, high]))
    }
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

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error> {
        let count = mine(channels).count();
        if count == 0 {
            return Ok(());
        }
        if self.cold {
            let mut packet = Packet::new(BROADCAST, instruction::SYNC_WRITE, &[register::TORQUE, 1]);
            for (_, id) in mine(channels) {
                packet.push(&[id, 1]);
            }
            packet.send(&mut self.port).map_err(Sts3215Error::Port)?;
            self.cold = false;
        }
        let mut packet = Packet::new(BROADCAST, instruction::SYNC_WRITE, &[register::GOAL, 2]);
        for (index, id) in mine(channels) {
            let [low, high] = commands.get(index).copied().unwrap_or(0).to_le_bytes();
            packet.push(&[id, low, high]);
        }
        packet.send(&mut self.port).map_err(Sts3215Error::Port)?;
        let Some((index, id)) = mine(channels).nth(self.turn) else {
            self.turn = 0;
            return Ok(());
        };
        let answer = self.ask(id, time);
        match answer {
            Ok(position) => {
                self.turn = if self.turn + 1 < count { self.turn + 1 } else { 0 };
                if let Some(slot) = self.positions.get_mut(index) {
                    *slot = Some(position);
                }
                Ok(())
            }
            Err(error) => {
                // Motors are switched on again with the next goals.
                self.cold = true;
                Err(error)
            }
        }
    }
}
