//! Chips, wires' ends and motors: what the firmware cannot see but through its buses.

use std::collections::BTreeMap;

use motionette::hash::Stream;
use motionette::playback::{Bus, Channel, Robot};

use super::pca9685::Pca9685;
use super::sts3215::{Chain, Sts3215};

/// Seconds of a step of the motors.
const STEP: f64 = 1e-3;
/// How fast a servo's own controller closes in, per second.
const GAIN: f64 = 40.0;

/// A servo's motor and gears.
#[derive(Debug, Clone)]
struct Motor {
    /// Degrees.
    angle: f64,
    /// Degrees a second that it reaches without load.
    slew: f64,
    /// Share of that which its load takes.
    load: f64,
}

/// Everything behind the buses.
#[derive(Debug)]
pub struct Hardware {
    /// Chips on I2C by address.
    pub chips: BTreeMap<u8, Pca9685>,
    /// Servos on the serial bus.
    pub chain: Chain,
    /// Duty of the microcontroller's pins, counts of 20 000.
    pub pins: BTreeMap<u8, u16>,
    channels: Vec<Channel>,
    motors: Vec<Motor>,
    time: u64,
}

fn degrees(channel: &Channel, command: f64) -> f64 {
    let ([low, high], [first, last]) = (channel.range.map(f64::from), channel.command.map(f64::from));
    low + (command - first) / (last - first) * (high - low)
}

fn command(channel: &Channel, degrees: f64) -> f64 {
    let ([low, high], [first, last]) = (channel.range.map(f64::from), channel.command.map(f64::from));
    first + (degrees - low) / (high - low) * (last - first)
}

impl Hardware {
    /// The hardware that `robot` describes, at rest at its neutral angles; loads are drawn.
    #[must_use]
    pub fn new(robot: &Robot, seed: u64) -> Self {
        let mut random = Stream::new(seed ^ 0x10AD);
        let channels: Vec<Channel> = robot.channels.iter().cloned().collect();
        let (mut chips, mut chain) = (BTreeMap::new(), Chain::default());
        for channel in &channels {
            match channel.bus {
                Bus::Pca9685 { address, .. } => {
                    chips.entry(address).or_insert_with(Pca9685::default);
                }
                Bus::Sts3215 { id } => {
                    let position = command(channel, f64::from(channel.neutral)).round() as u16;
                    chain.servos.push(Sts3215::new(id, position));
                }
                Bus::Pwm { .. } => {}
            }
        }
        let motor = |channel: &Channel| Motor {
            angle: f64::from(channel.neutral),
            slew: 1.25 * f64::from(channel.speed),
            load: f64::from(random.below(300)) / 1000.0,
        };
        let motors = channels.iter().map(motor).collect();
        Hardware { chips, chain, pins: BTreeMap::new(), channels, motors, time: 0 }
    }

    /// The command that a servo hears now; `None` when it hears none.
    #[must_use]
    pub fn heard(&self, channel: usize) -> Option<f64> {
        match self.channels[channel].bus {
            Bus::Pca9685 { address, output } => self.chips.get(&address)?.pulse(output),
            Bus::Sts3215 { id } => {
                let servo = self.chain.servos.iter().find(|servo| servo.id == id)?;
                servo.goal.filter(|_| servo.torque).map(f64::from)
            }
            Bus::Pwm { pin } => self.pins.get(&pin).map(|duty| f64::from(*duty)),
        }
    }

    /// How finely a channel's commands are resolved.
    #[must_use]
    pub fn resolution(&self, channel: usize) -> f64 {
        match self.channels[channel].bus {
            Bus::Pca9685 { address, .. } => self.chips.get(&address).map_or(1.0, Pca9685::count),
            Bus::Pwm { .. } | Bus::Sts3215 { .. } => 1.0,
        }
    }

    /// Degrees of a command for a channel.
    #[must_use]
    pub fn degrees(&self, channel: usize, command: f64) -> f64 {
        degrees(&self.channels[channel], command)
    }

    /// Where a servo stands, degrees.
    #[must_use]
    pub fn reached(&self, channel: usize) -> f64 {
        self.motors[channel].angle
    }

    /// Chips and servos lose their power and get it back.
    pub fn reset(&mut self) {
        self.chips.values_mut().for_each(Pca9685::reset);
        self.chain.servos.iter_mut().for_each(Sts3215::reset);
        self.chain.answers.clear();
    }

    /// Motors move until `time`, microseconds.
    pub fn advance(&mut self, time: u64) {
        while self.time < time {
            self.time += (STEP * 1e6) as u64;
            for index in 0..self.motors.len() {
                // Without a command the gears keep it where it is.
                let Some(goal) = self.heard(index).map(|heard| self.degrees(index, heard)) else { continue };
                let motor = &mut self.motors[index];
                let most = motor.slew * (1.0 - motor.load);
                motor.angle += (GAIN * (goal - motor.angle)).clamp(-most, most) * STEP;
            }
            for servo in &mut self.chain.servos {
                let index = self.channels.iter().position(|channel| channel.bus == Bus::Sts3215 { id: servo.id });
                if let Some(index) = index {
                    servo.position = command(&self.channels[index], self.motors[index].angle).round() as u16;
                }
            }
        }
    }
}
