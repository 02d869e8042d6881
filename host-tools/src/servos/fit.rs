//! How well a robot can do a motion.

use motionette::playback::{Mapper, Robot, reach};
use serde::Serialize;

use super::{Error, Timeline};
use crate::motion::{JOINTS, Pose};

/// Degrees within which an angle counts as being at an end of its range.
const AT_END: f32 = 0.02;
/// What a servo without limits may do: degrees a second, and a second squared.
const UNLIMITED: (f32, f32) = (10_000.0, 1_000_000.0);
/// Rounding of the queue's angles, 0.01 degree, seen as a speed: ticks above the limit by less are not above it.
const ROUNDING: f64 = 0.01;

/// Distance of joints, millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distance {
    /// Over all frames and joints.
    pub mean_mm: f64,
    /// The largest.
    pub max_mm: f64,
}

/// What a motion asks of a channel, beside what the channel may do.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelFit {
    /// Its name.
    pub name: String,
    /// Smallest and largest angle that the motion takes it to, degrees.
    pub used: [f32; 2],
    /// Its range, degrees.
    pub range: [f32; 2],
    /// Share of frames at an end of the range.
    pub clipped: f64,
    /// Largest speed asked for, degrees a second.
    pub speed: f64,
    /// Its limit.
    pub speed_limit: f32,
    /// Largest acceleration asked for, degrees a second squared.
    pub acceleration: f64,
    /// Its limit.
    pub acceleration_limit: f32,
    /// Share of ticks in which more speed or acceleration is asked for than there is.
    pub beyond: f64,
}

/// How well a robot can do a motion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fit {
    /// Channel by channel.
    pub channels: Vec<ChannelFit>,
    /// Of the body that the servos make from the motion's, were they as fast as can be: axes and ranges alone.
    pub reached: Distance,
    /// The same with speed and acceleration as they are, from the end of the first fade on.
    pub played: Distance,
    /// Share of the motion's ticks in which some servo was kept behind.
    pub limited: f64,
}

impl Fit {
    /// Of a motion; `frames` are joint positions, metres.
    ///
    /// # Errors
    /// [`Error`].
    pub fn of(robot: &Robot, frames: &[Pose], frame_rate: u16) -> Result<Self, Error> {
        let timeline = Timeline::of(robot, frames, frame_rate)?;
        let mut mapper = Mapper::new(robot);
        let mapped: Vec<Vec<f32>> = frames.iter().map(|pose| mapper.map(robot, pose).to_vec()).collect();
        let reached: Vec<Pose> = frames.iter().zip(&mapped).map(|(pose, a)| reach(robot, pose, a)).collect();
        let played = timeline.bodies(robot, frames, frame_rate);
        let faded = (f64::from(robot.fade) * f64::from(frame_rate)).ceil() as usize;
        let faded = faded.min(frames.len() - 1);

        let mut unlimited = robot.clone();
        unlimited.fade = 0.0;
        for channel in &mut unlimited.channels {
            (channel.speed, channel.acceleration) = UNLIMITED;
        }
        let asked = Timeline::of(&unlimited, frames, frame_rate)?;
        let channels = robot.channels.iter().enumerate().map(|(index, channel)| {
            let angles = || mapped.iter().map(|frame| frame[index]);
            let [low, high] = channel.range;
            let clipped = angles().filter(|angle| *angle - low < AT_END || high - *angle < AT_END).count();
            // Before the first tick the servos stand at neutral, which the motion did not ask for.
            let (speeds, accelerations) = asked.rates(index);
            let during = |values: Vec<f64>, lost: usize| -> Vec<f64> {
                values.into_iter().take(asked.motion_ticks.saturating_sub(lost)).map(f64::abs).collect()
            };
            let (speeds, accelerations) = (during(speeds, 1), during(accelerations, 2));
            let (speed, acceleration) = (f64::from(channel.speed), f64::from(channel.acceleration));
            let rate = f64::from(robot.tick_rate);
            let beyond = accelerations
                .iter()
                .zip(&speeds[speeds.len().min(1)..])
                .filter(|(a, v)| **v > speed + ROUNDING * rate || **a > acceleration + 2.0 * ROUNDING * rate * rate);
            ChannelFit {
                name: channel.name.to_string(),
                used: [angles().fold(f32::INFINITY, f32::min), angles().fold(f32::NEG_INFINITY, f32::max)],
                range: channel.range,
                clipped: clipped as f64 / frames.len() as f64,
                speed: speeds.iter().copied().fold(0.0, f64::max),
                speed_limit: channel.speed,
                acceleration: accelerations.iter().copied().fold(0.0, f64::max),
                acceleration_limit: channel.acceleration,
                beyond: beyond.count() as f64 / accelerations.len().max(1) as f64,
            }
        });
        Ok(Fit {
            channels: channels.collect(),
            reached: distance(frames, &reached),
            played: distance(&frames[faded..], &played[faded..]),
            limited: f64::from(timeline.limited) / timeline.motion_ticks.max(1) as f64,
        })
    }
}

fn distance(a: &[Pose], b: &[Pose]) -> Distance {
    let off = |a: [f32; 3], b: [f32; 3]| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>().sqrt() * 1000.0;
    let all = || a.iter().zip(b).flat_map(|(a, b)| (0..JOINTS).map(move |j| off(a[j], b[j])));
    let count = (JOINTS * a.len()).max(1) as f64;
    Distance { mean_mm: all().sum::<f64>() / count, max_mm: all().fold(0.0, f64::max) }
}
