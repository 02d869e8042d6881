//! Packed robots of version 1, which do not say how the robot starts.

use std::path::Path;

use motionette::blob::crc32;
use motionette::playback::robot::{HEADER_LEN, MAX_CHANNELS, RobotError, Source};
use motionette::playback::{Bus, Channel, Rest, Robot};
use serde::Deserialize;

use super::Error;
use super::reader::CREEP;

/// The version.
const VERSION: u16 = 1;

/// A robot as version 1 has it.
#[derive(Deserialize)]
struct OldRobot {
    name: heapless::String<32>,
    tick_rate: u16,
    fade: f32,
    return_time: f32,
    after: Rest,
    finish_without_host: bool,
    channels: heapless::Vec<OldChannel, MAX_CHANNELS>,
}

/// A channel as version 1 has it.
#[derive(Deserialize)]
struct OldChannel {
    name: heapless::String<24>,
    source: Source,
    neutral: f32,
    gain: f32,
    range: [f32; 2],
    command: [u16; 2],
    speed: f32,
    acceleration: f32,
    bus: Bus,
}

/// A robot of an earlier version, and what was taken for what it did not say.
#[derive(Debug, Clone, PartialEq)]
pub struct Lifted {
    /// The robot.
    pub robot: Robot,
    /// A line each, for people.
    pub taken: Vec<String>,
}

/// Reads a packed robot of version 1; `None` when the file is something else. What it does not say is taken as `robot.toml` takes it;
/// where its servos stand when power comes up can only be taken to be `at_neutral` if the user says so.
///
/// # Errors
/// [`Error::Read`], [`Error::Packed`] when it is damaged, or [`Error::NoStart`].
pub fn lift(path: &Path, at_neutral: bool) -> Result<Option<Lifted>, Error> {
    let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    if !matches!(Robot::open(&bytes), Err(RobotError::Version { found: VERSION })) {
        return Ok(None);
    }
    let packed = |source| Error::Packed { path: path.to_path_buf(), source };
    let old = unpack(&bytes).map_err(packed)?;
    let blind = |channel: &&OldChannel| !channel.bus.reads_back();
    let names: Vec<&str> = old.channels.iter().filter(blind).map(|channel| channel.name.as_str()).collect();
    if !at_neutral && !names.is_empty() {
        return Err(Error::NoStart { path: path.to_path_buf(), channels: names.join(", ") });
    }
    let mut taken = vec![format!("creep is not stated: {CREEP} degrees a second")];
    if !names.is_empty() {
        taken.push(format!("start is not stated: neutral, for {}", names.join(", ")));
        taken.push("output_enable is not stated: no pin".to_owned());
    }
    let OldRobot { name, tick_rate, fade, return_time, after, finish_without_host, channels } = old;
    let channels = channels.into_iter().map(|channel| {
        let OldChannel { name, source, neutral, gain, range, command, speed, acceleration, bus } = channel;
        let start = (!bus.reads_back()).then_some(neutral);
        Channel { name, source, neutral, start, gain, range, command, speed, acceleration, bus }
    });
    let robot = Robot {
        name,
        tick_rate,
        fade,
        return_time,
        after,
        finish_without_host,
        creep: CREEP,
        output_enable: None,
        channels: channels.collect(),
    };
    Ok(Some(Lifted { robot, taken }))
}

/// What is packed: behind magic, version and two zeros, the length and the CRC-32 of a postcard.
fn unpack(bytes: &[u8]) -> Result<OldRobot, RobotError> {
    let field = |at: usize| {
        let field = bytes.get(at..at + 4).and_then(|field| field.try_into().ok());
        field.map(u32::from_le_bytes).ok_or(RobotError::Malformed)
    };
    let (length, checksum) = (field(8)?, field(12)?);
    let needed = length.saturating_add(HEADER_LEN as u32);
    let truncated = RobotError::Truncated { needed, available: bytes.len() as u32 };
    let body = bytes.get(HEADER_LEN..needed as usize).ok_or(truncated)?;
    if !crc32(!0, body) != checksum {
        return Err(RobotError::Checksum);
    }
    postcard::from_bytes(body).map_err(|_| RobotError::Malformed)
}
