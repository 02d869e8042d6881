//! What a robot's servos make of a motion: the device's own player, run on the host, and how well it follows.
//!
//! [`Timeline::of`] runs a [`Feeder`](motionette::playback::Feeder) and a [`Player`](motionette::playback::Player), tick for tick as
//! firmware does, so limits and fades are those of the device. [`Fit`] compares that with what the motion asks for.

mod fit;

use motionette::Anchor;
use motionette::playback::queue::TooManyChannels;
use motionette::playback::robot::MAX_CHANNELS;
use motionette::playback::{Full, Handles, MotionQueue, Rest, Robot, State, reach};

use crate::metrics;
use crate::motion::Pose;

pub use fit::{ChannelFit, Distance, Fit};

/// Seconds after the motion's end in which servos must have come to rest; slower ones are not waited for.
const REST_SECONDS: usize = 60;

/// Why a motion cannot be played.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The robot has too many servos.
    #[error(transparent)]
    Channels(#[from] TooManyChannels),
    /// The line does not take the motion.
    #[error(transparent)]
    Full(#[from] Full),
    /// There is nothing to play.
    #[error("the motion has no frames")]
    NoFrames,
}

/// What servos are told, tick by tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    /// Ticks a second.
    pub tick_rate: u16,
    /// Names of the channels.
    pub names: Vec<String>,
    /// Servo angles, degrees: ticks by channels. Tick 0 is the first after standing at neutral; the motion's time 0 is its time.
    pub angles: Vec<Vec<f32>>,
    /// Commands, microseconds or positions of serial servos: ticks by channels.
    pub commands: Vec<Vec<u16>>,
    /// Ticks until the motion had been played; in the rest the servos come to rest or return.
    pub motion_ticks: usize,
    /// Ticks in which some servo was kept behind by its speed or acceleration.
    pub limited: u32,
}

impl Timeline {
    /// Plays a motion from neutral until the servos stand again. `frames` are joint positions, metres.
    ///
    /// # Errors
    /// [`Error`].
    pub fn of(robot: &Robot, frames: &[Pose], frame_rate: u16) -> Result<Self, Error> {
        if frames.is_empty() {
            return Err(Error::NoFrames);
        }
        // Room for all that a tick may take: 65535 frames a second at 20 ticks.
        let mut line = Box::new(MotionQueue::<MAX_CHANNELS, 4096>::new());
        let Handles { mut feeder, mut player, .. } = line.split(robot)?;
        let names = robot.channels.iter().map(|channel| channel.name.to_string()).collect();
        let (tick_rate, mut angles, mut commands) = (robot.tick_rate, Vec::new(), Vec::new());
        let mut frames = frames.iter();
        let (mut motion_ticks, mut ended) = (0, false);
        feeder.begin(frame_rate)?;
        loop {
            while !ended && feeder.free() > 1 {
                match frames.next() {
                    Some(pose) => feeder.frame(pose)?,
                    None => {
                        feeder.end()?;
                        ended = true;
                    }
                }
            }
            let servos = player.tick();
            let state = servos.state;
            commands.push(servos.commands.to_vec());
            angles.push(player.angles().collect::<Vec<f32>>());
            if player.status().finished == 0 {
                motion_ticks = angles.len();
                continue;
            }
            let still = matches!(&angles[..], [.., a, b, c] if a == b && b == c);
            let rests = match robot.after {
                Rest::Hold => still,
                Rest::Neutral => state == State::Neutral,
            };
            if rests || angles.len() > motion_ticks + REST_SECONDS * usize::from(tick_rate) {
                break;
            }
        }
        let limited = player.status().limited;
        Ok(Timeline { tick_rate, names, angles, commands, motion_ticks, limited })
    }

    /// Time of a tick, seconds.
    #[must_use]
    pub fn time(&self, tick: usize) -> f64 {
        tick as f64 / f64::from(self.tick_rate)
    }

    /// Servo angles, degrees, `time` seconds after the beginning: between two ticks on a line.
    #[must_use]
    pub fn at(&self, time: f64) -> Vec<f32> {
        let at = (time * f64::from(self.tick_rate)).clamp(0.0, self.angles.len().saturating_sub(1) as f64);
        let (tick, part) = (at as usize, at.fract() as f32);
        let Some(before) = self.angles.get(tick) else { return Vec::new() };
        let after = self.angles.get(tick + 1).unwrap_or(before);
        before.iter().zip(after).map(|(a, b)| a + part * (b - a)).collect()
    }

    /// Steps of a channel and their differences: degrees a second of every tick but the first, degrees a second squared of every tick
    /// but the first two.
    #[must_use]
    pub fn rates(&self, channel: usize) -> (Vec<f64>, Vec<f64>) {
        let rate = f64::from(self.tick_rate);
        let at = |tick: &Vec<f32>| f64::from(tick[channel]);
        let speeds: Vec<f64> = self.angles.windows(2).map(|w| (at(&w[1]) - at(&w[0])) * rate).collect();
        let accelerations = speeds.windows(2).map(|w| (w[1] - w[0]) * rate).collect();
        (speeds, accelerations)
    }

    /// The bodies that the servos make: forward kinematics of the commanded angles at the time of each frame, metres. What no servo
    /// turns, and where the pelvis is, is as the motion says.
    #[must_use]
    pub fn bodies(&self, robot: &Robot, frames: &[Pose], frame_rate: u16) -> Vec<Pose> {
        let time = |frame: usize| frame as f64 / f64::from(frame_rate.max(1));
        frames.iter().enumerate().map(|(frame, pose)| reach(robot, pose, &self.at(time(frame)))).collect()
    }

    /// Mean distance of that body from the anchors, metres; `None` without anchors or with one outside the motion.
    #[must_use]
    pub fn control_error(&self, robot: &Robot, frames: &[Pose], rate: u16, anchors: &[Anchor]) -> Option<f64> {
        metrics::control_error(&self.bodies(robot, frames, rate), anchors)
    }
}
