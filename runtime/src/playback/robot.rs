//! What the robot is: its servos, what each of them follows, and what it may do.

use core::fmt;

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

use super::body::turns;
use crate::Joint;
use crate::blob::crc32;

/// Servo channels a robot may have.
pub const MAX_CHANNELS: usize = 32;
/// Degrees that a servo angle may have on either side of zero.
pub const MAX_ANGLE: f32 = 320.0;
/// Servo channels that may follow one joint.
pub const MAX_AXES: usize = 3;

/// Axis that a servo turns about: of the body standing, facing +z, arms hanging; right-handed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// To the body's left. Lifting a leg or an arm in front of the body is negative.
    X,
    /// Up. Turning to the left is positive.
    Y,
    /// Forward. Lifting the left arm sideways is positive.
    Z,
}

impl Axis {
    /// Its direction.
    #[must_use]
    pub const fn vector(self) -> [f32; 3] {
        match self {
            Axis::X => [1.0, 0.0, 0.0],
            Axis::Y => [0.0, 1.0, 0.0],
            Axis::Z => [0.0, 0.0, 1.0],
        }
    }
}

/// What a servo follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// A joint's turn about an axis, degrees. Servos of one joint stand in the order in which they carry each other.
    Joint(u8, Axis),
    /// Where the body faces, degrees to the left.
    Heading,
    /// Height of the pelvis above that of the first frame, metres: `gain` is degrees a metre.
    Height,
    /// Nothing: it stays at neutral.
    Still,
}

/// How a servo is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "lowercase")]
pub enum Bus {
    /// A pin of the microcontroller, numbered by the firmware; commands are pulses in microseconds.
    Pwm {
        /// Number.
        pin: u8,
    },
    /// An output of a PCA9685 on I2C; commands are pulses in microseconds.
    Pca9685 {
        /// Of the chip, 7 bits.
        address: u8,
        /// 0 to 15.
        output: u8,
    },
    /// A Feetech STS3215 on a serial bus; commands are positions, 4096 a turn.
    Sts3215 {
        /// 0 to 253.
        id: u8,
    },
}

impl Bus {
    /// Whether servos of this bus say where they stand.
    #[must_use]
    pub const fn reads_back(self) -> bool {
        matches!(self, Bus::Sts3215 { .. })
    }

    /// Smallest and largest command that the bus can be given.
    #[must_use]
    pub const fn commands(self) -> [u16; 2] {
        match self {
            Bus::Pwm { .. } | Bus::Pca9685 { .. } => [300, 3000],
            Bus::Sts3215 { .. } => [0, 4095],
        }
    }
}

/// A servo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Channel {
    /// Its name.
    pub name: String<24>,
    /// What it follows.
    pub source: Source,
    /// Angle when the source is at zero, degrees.
    pub neutral: f32,
    /// Angle at which its user promises that it stands when power comes up, degrees; `None` where it says so itself.
    pub start: Option<f32>,
    /// Degrees a degree of the source; negative turns the other way.
    pub gain: f32,
    /// Smallest and largest angle, degrees.
    pub range: [f32; 2],
    /// Commands at the ends of the range: microseconds, or positions of a serial servo.
    pub command: [u16; 2],
    /// Largest speed, degrees a second.
    pub speed: f32,
    /// Largest acceleration, degrees a second squared.
    pub acceleration: f32,
    /// How it is connected.
    pub bus: Bus,
}

/// What the robot does when a motion has ended, or when whoever commands it is gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "lowercase")]
pub enum Rest {
    /// It stays as it is.
    #[default]
    Hold,
    /// It goes to its neutral angles.
    Neutral,
}

/// A robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Robot {
    /// Its name.
    pub name: String<32>,
    /// Ticks a second: how often servos are given a command.
    pub tick_rate: u16,
    /// Seconds in which one motion fades into the next.
    pub fade: f32,
    /// Seconds in which it goes to neutral, if its limits let it.
    pub return_time: f32,
    /// What it does when a motion has ended.
    pub after: Rest,
    /// Whether a motion goes on when its host is gone; if not, the robot brakes and holds.
    pub finish_without_host: bool,
    /// Largest speed until it is known to stand where it should, degrees a second.
    pub creep: f32,
    /// Pin, as the firmware counts them, that is low when the chips may give pulses; `None` when none is connected.
    pub output_enable: Option<u8>,
    /// Its servos.
    pub channels: Vec<Channel, MAX_CHANNELS>,
}

/// First four bytes of a packed robot.
pub const MAGIC: [u8; 4] = *b"MNTR";
/// Version of the format.
pub const VERSION: u16 = 2;
/// Slowest and fastest creeping, degrees a second.
pub const CREEP: [f32; 2] = [1.0, 90.0];
/// Bytes before the postcard: magic, version (u16), zero (u16), length of the postcard (u32), its CRC-32 (u32), little-endian.
pub const HEADER_LEN: usize = 16;
/// Bytes that a packed robot has at most.
pub const MAX_BYTES: usize = HEADER_LEN + 64 + 96 * MAX_CHANNELS;

/// Why a robot was refused.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RobotError {
    /// It does not begin as a packed robot does.
    NotARobot,
    /// It is of a version that is not read.
    Version {
        /// The version found.
        found: u16,
    },
    /// It ends too early.
    Truncated {
        /// Bytes it should have.
        needed: u32,
        /// Bytes there are.
        available: u32,
    },
    /// It was damaged.
    Checksum,
    /// The postcard cannot be read.
    Malformed,
    /// Something about the robot is not allowed.
    Violation(Violation),
}

/// Something about a robot that is not allowed.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Violation {
    /// The channel; `None` when it is about the whole robot.
    pub channel: Option<u8>,
    /// What.
    pub what: Fault,
}

/// What is not allowed.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
#[expect(missing_docs, reason = "the text of each says it")]
pub enum Fault {
    NoChannels,
    TickRate(u16),
    Times,
    Name,
    SameName { other: u8 },
    SameOutput { other: u8 },
    SameAxis { other: u8 },
    Joint(u8),
    Range { range: [f32; 2] },
    Neutral { neutral: f32, range: [f32; 2] },
    NoStart,
    Start { start: f32, range: [f32; 2] },
    Creep(f32),
    Gain(f32),
    Command { command: [u16; 2], allowed: [u16; 2] },
    Speed(f32),
    Acceleration { acceleration: f32, least: f32, most: f32 },
    Output { found: u8, most: u8 },
    Address(u8),
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Fault::NoChannels => write!(f, "the robot has no channels: give it at least one"),
            Fault::TickRate(found) => {
                write!(f, "tick_rate is {found}: servos are given 20 to 1000 commands a second")
            }
            Fault::Times => write!(f, "fade and return_time must be 0 to 60 seconds"),
            Fault::Name => write!(f, "the name is empty"),
            Fault::SameName { other } => write!(f, "channel {other} has the same name"),
            Fault::SameOutput { other } => write!(f, "channel {other} is connected to the same output"),
            Fault::SameAxis { other } => write!(f, "channel {other} follows the same axis of the same joint"),
            Fault::Joint(joint) => write!(
                f,
                "positions do not tell how joint {joint} turns: pelvis, spine3, neck and the shoulders, elbows, hips, knees and \
                 ankles can be followed"
            ),
            Fault::Range { range: [low, high] } => write!(
                f,
                "the range is {low} to {high} degrees: the first must be smaller, and both within -{MAX_ANGLE} to {MAX_ANGLE}"
            ),
            Fault::Neutral { neutral, range: [low, high] } => {
                write!(f, "neutral is {neutral} degrees, outside the range {low} to {high}")
            }
            Fault::NoStart => write!(
                f,
                "this servo cannot say where it stands: give start, the angle at which it stands when power comes up"
            ),
            Fault::Start { start, range: [low, high] } => {
                write!(f, "start is {start} degrees, outside the range {low} to {high}")
            }
            Fault::Creep(creep) => {
                let [least, most] = CREEP;
                write!(f, "creep is {creep} degrees a second: it must be {least} to {most}")
            }
            Fault::Gain(gain) => write!(f, "the gain is {gain}: it must be 0.01 to 1000 or -0.01 to -1000"),
            Fault::Command { command: [low, high], allowed: [least, most] } => write!(
                f,
                "the commands at the ends of the range are {low} and {high}: the first must be smaller (turn the direction with the \
                 sign of the gain), and both within {least} to {most}"
            ),
            Fault::Speed(speed) => write!(f, "the speed is {speed} degrees a second: it must be 0.1 to 10000"),
            Fault::Acceleration { acceleration, least, most } => write!(
                f,
                "the acceleration is {acceleration} degrees a second squared: at this tick rate it must be {least} to {most}"
            ),
            Fault::Output { found, most } => write!(f, "output {found} does not exist: 0 to {most} do"),
            Fault::Address(address) => {
                write!(f, "address {address:#04x} is none of a PCA9685: 0x40 to 0x7f without 0x70")
            }
        }
    }
}

impl fmt::Display for RobotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RobotError::NotARobot => {
                write!(f, "these bytes are no packed robot: make one with `motionette robot pack`")
            }
            RobotError::Version { found } => {
                write!(
                    f,
                    "the packed robot has version {found}, {VERSION} is read: pack it again with `motionette robot pack`"
                )
            }
            RobotError::Truncated { needed, available } => {
                write!(f, "the packed robot should have {needed} bytes, {available} are there")
            }
            RobotError::Checksum => write!(f, "the packed robot was damaged: its checksum is another"),
            RobotError::Malformed => write!(f, "the packed robot cannot be read"),
            RobotError::Violation(Violation { channel: Some(channel), what }) => write!(f, "channel {channel}: {what}"),
            RobotError::Violation(Violation { channel: None, what }) => write!(f, "{what}"),
        }
    }
}

impl core::error::Error for RobotError {}

impl Robot {
    /// Reads and checks a packed robot.
    ///
    /// # Errors
    /// [`RobotError`]; a robot that was read breaks none of the rules of [`Robot::violations`].
    #[inline(never)]
    pub fn open(bytes: &[u8]) -> Result<Self, RobotError> {
        let truncated = |needed: usize| RobotError::Truncated { needed: needed as u32, available: bytes.len() as u32 };
        let (header, body) = bytes.split_at_checked(HEADER_LEN).ok_or(truncated(HEADER_LEN))?;
        let [m0, m1, m2, m3, v0, v1, _, _, l0, l1, l2, l3, c0, c1, c2, c3] = *header else {
            return Err(RobotError::NotARobot);
        };
        if [m0, m1, m2, m3] != MAGIC {
            return Err(RobotError::NotARobot);
        }
        let found = u16::from_le_bytes([v0, v1]);
        if found != VERSION {
            return Err(RobotError::Version { found });
        }
        let length = u32::from_le_bytes([l0, l1, l2, l3]) as usize;
        let body = body.get(..length).ok_or(truncated(length.saturating_add(HEADER_LEN)))?;
        if !crc32(!0, body) != u32::from_le_bytes([c0, c1, c2, c3]) {
            return Err(RobotError::Checksum);
        }
        let robot: Robot = postcard::from_bytes(body).map_err(|_| RobotError::Malformed)?;
        match robot.first_violation() {
            Some(violation) => Err(RobotError::Violation(violation)),
            None => Ok(robot),
        }
    }

    /// Packs it into `out` and says how many bytes that took, at most [`MAX_BYTES`].
    ///
    /// # Errors
    /// [`RobotError::Violation`], or [`RobotError::Truncated`] when `out` is too short.
    pub fn pack(&self, out: &mut [u8]) -> Result<usize, RobotError> {
        if let Some(violation) = self.first_violation() {
            return Err(RobotError::Violation(violation));
        }
        let available = out.len() as u32;
        let full = RobotError::Truncated { needed: MAX_BYTES as u32, available };
        let (header, body) = out.split_at_mut_checked(HEADER_LEN).ok_or(full)?;
        let body = postcard::to_slice(self, body).map_err(|_| full)?;
        let (length, crc) = ((body.len() as u32).to_le_bytes(), (!crc32(!0, body)).to_le_bytes());
        let version = VERSION.to_le_bytes();
        let fields = MAGIC.iter().chain(&version).chain(&[0, 0]).chain(&length).chain(&crc);
        for (to, from) in header.iter_mut().zip(fields) {
            *to = *from;
        }
        Ok(HEADER_LEN + body.len())
    }

    fn first_violation(&self) -> Option<Violation> {
        let mut first = None;
        self.violations(&mut |violation| first = first.or(Some(violation)));
        first
    }

    /// Tells `report` everything about this robot that is not allowed.
    pub fn violations(&self, report: &mut dyn FnMut(Violation)) {
        let mut whole = |what| report(Violation { channel: None, what });
        if self.channels.is_empty() {
            whole(Fault::NoChannels);
        }
        if !(20..=1000).contains(&self.tick_rate) {
            whole(Fault::TickRate(self.tick_rate));
        }
        if !(self.fade >= 0.0 && self.fade <= 60.0 && self.return_time >= 0.0 && self.return_time <= 60.0) {
            whole(Fault::Times);
        }
        let [least, most] = CREEP;
        if !(self.creep >= least && self.creep <= most) {
            whole(Fault::Creep(self.creep));
        }
        for (index, channel) in self.channels.iter().enumerate() {
            let mut fault = |what| report(Violation { channel: Some(index as u8), what });
            channel.faults(self.tick_rate, &mut fault);
            for (other, earlier) in self.channels.iter().take(index).enumerate() {
                let other = other as u8;
                if earlier.name == channel.name {
                    fault(Fault::SameName { other });
                }
                if earlier.bus == channel.bus {
                    fault(Fault::SameOutput { other });
                }
                if matches!(channel.source, Source::Joint(..)) && earlier.source == channel.source {
                    fault(Fault::SameAxis { other });
                }
            }
        }
    }
}

impl Channel {
    fn faults(&self, tick_rate: u16, fault: &mut dyn FnMut(Fault)) {
        let [low, high] = self.range;
        let allowed = |x: f32, least: f32, most: f32| x >= least && x <= most;
        if self.name.is_empty() {
            fault(Fault::Name);
        }
        if let Source::Joint(number, _) = self.source
            && !Joint::try_from(number).is_ok_and(turns)
        {
            fault(Fault::Joint(number));
        }
        if !(allowed(low, -MAX_ANGLE, MAX_ANGLE) && allowed(high, -MAX_ANGLE, MAX_ANGLE) && high - low >= 0.1) {
            fault(Fault::Range { range: self.range });
        } else if !allowed(self.neutral, low, high) {
            fault(Fault::Neutral { neutral: self.neutral, range: self.range });
        }
        match self.start {
            None if !self.bus.reads_back() => fault(Fault::NoStart),
            // A broken range, or neutral, has been reported.
            Some(start) if low < high && start != self.neutral && !allowed(start, low, high) => {
                fault(Fault::Start { start, range: self.range });
            }
            _ => {}
        }
        if !allowed(self.gain.abs(), 0.01, 1000.0) {
            fault(Fault::Gain(self.gain));
        }
        let ([least, most], [first, last]) = (self.bus.commands(), self.command);
        if !(least <= first && first < last && last <= most) {
            fault(Fault::Command { command: self.command, allowed: [least, most] });
        }
        if !allowed(self.speed, 0.1, 10_000.0) {
            fault(Fault::Speed(self.speed));
        }
        // A tick's change of speed is at least 16 units of 1/65536 degree, so that rounding it down costs little.
        let rate = f32::from(tick_rate);
        let (least, most) = (rate * rate * 16.0 / 65536.0, 1_000_000.0);
        if !allowed(self.acceleration, least, most) {
            fault(Fault::Acceleration { acceleration: self.acceleration, least, most });
        }
        match self.bus {
            Bus::Pwm { .. } => {}
            Bus::Pca9685 { address, output } => {
                if !(0x40..=0x7F).contains(&address) || address == 0x70 {
                    fault(Fault::Address(address));
                }
                if output > 15 {
                    fault(Fault::Output { found: output, most: 15 });
                }
            }
            Bus::Sts3215 { id } => {
                if id > 253 {
                    fault(Fault::Output { found: id, most: 253 });
                }
            }
        }
    }
}
