//! Chips, wires' ends and motors: what the firmware cannot see but through its buses.

use std::collections::BTreeMap;

use motionette::numerics::hash::Stream;
use motionette::playback::{Bus, Channel, Robot};

use super::motor::{Drive, Motor, STEP};
use super::pca9685::Pca9685;
use super::sts3215::{Chain, Sts3215};

/// Microseconds that a serial servo's firmware takes to start.
pub const AWAKE: u64 = 400_000;

/// How power comes up.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Boot {
    /// Where the servos stand, degrees; at their neutral angles when there are none.
    pub pose: Vec<f64>,
    /// Somebody holds the robot in that pose until its servos do.
    pub held: bool,
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
    /// Chips and motors have power.
    powered: bool,
    /// Microseconds at which the firmware of serial servos has started.
    awake_at: u64,
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
        Self::booted(robot, &Boot::default(), seed)
    }

    /// The hardware that `robot` describes as power comes up. What hangs on the servos hangs at neutral, and how heavy it is is drawn.
    #[must_use]
    pub fn booted(robot: &Robot, boot: &Boot, seed: u64) -> Self {
        let mut random = Stream::new(seed ^ 0x10AD);
        let channels: Vec<Channel> = robot.channels.iter().cloned().collect();
        let (mut chips, mut chain, mut motors) = (BTreeMap::new(), Chain::default(), Vec::new());
        for (index, channel) in channels.iter().enumerate() {
            let neutral = f64::from(channel.neutral);
            let angle = boot.pose.get(index).copied().unwrap_or(neutral);
            match channel.bus {
                Bus::Pca9685 { address, .. } => {
                    chips.entry(address).or_insert_with(Pca9685::default);
                }
                Bus::Sts3215 { id } => {
                    let stiff = random.below(2) == 1;
                    chain.servos.push(Sts3215::new(id, command(channel, angle).round() as u16, stiff));
                }
                Bus::Pwm { .. } => {}
            }
            let limits = (f64::from(channel.speed), f64::from(channel.acceleration));
            motors.push(Motor::new(angle, limits, neutral, f64::from(random.below(1001)) / 1000.0, boot.held));
        }
        Hardware { chips, chain, pins: BTreeMap::new(), channels, motors, powered: true, awake_at: AWAKE, time: 0 }
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
            Bus::Pwm { pin } => self.pins.get(&pin).filter(|duty| **duty > 0).map(|duty| f64::from(*duty)),
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
        self.motors[channel].angle()
    }

    /// Chips and servos lose their power, or get it back and have forgotten everything.
    pub fn power(&mut self, on: bool) {
        (self.powered, self.awake_at) = (on, self.time + AWAKE);
        self.chips.values_mut().for_each(Pca9685::reset);
        self.chain.servos.iter_mut().for_each(Sts3215::reset);
        self.chain.answers.clear();
    }

    /// What drives a servo's motor.
    fn drive(&self, index: usize) -> Drive {
        let channel = &self.channels[index];
        if let Bus::Sts3215 { id } = channel.bus {
            let servo = self.chain.servos.iter().find(|servo| servo.id == id);
            let Some(servo) = servo.filter(|servo| servo.torque && self.powered) else { return Drive::Off };
            // Degrees a position.
            let scale = degrees(channel, 1.0) - degrees(channel, 0.0);
            return Drive::Profile {
                goal: degrees(channel, f64::from(servo.goal.unwrap_or(servo.woke_at))),
                speed: scale * f64::from(servo.speed),
                acceleration: scale * 100.0 * f64::from(servo.acceleration),
            };
        }
        match self.heard(index) {
            Some(heard) if self.powered => Drive::Pulses(degrees(channel, heard)),
            _ => Drive::Off,
        }
    }

    /// Motors move until `time`, microseconds.
    pub fn advance(&mut self, time: u64) {
        while self.time < time {
            self.time += (STEP * 1e6) as u64;
            if self.powered && self.time >= self.awake_at {
                self.chain.servos.iter_mut().filter(|servo| !servo.awake).for_each(Sts3215::wake);
            }
            for index in 0..self.motors.len() {
                let drive = self.drive(index);
                self.motors[index].step(drive);
            }
            for servo in &mut self.chain.servos {
                let index = self.channels.iter().position(|channel| channel.bus == Bus::Sts3215 { id: servo.id });
                if let Some(index) = index {
                    let (channel, motor) = (&self.channels[index], &self.motors[index]);
                    servo.position = command(channel, motor.angle()).round() as u16;
                    let turning = command(channel, motor.speed()) - command(channel, 0.0);
                    servo.turning = turning.abs().round() as u16 | if turning < 0.0 { 0x8000 } else { 0 };
                }
            }
        }
    }
}
