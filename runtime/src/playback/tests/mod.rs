//! Mapping and playing against known poses, brute force and the rules that the output must keep.

mod limits;
mod mapping;
mod packing;
mod playing;
mod queue;
mod start;

use super::Player;
use super::control::State;
use super::mapper::reach;
use super::robot::{Axis, Bus, Channel, Rest, Robot, Source};
use crate::representation::Pose;
use crate::{JOINTS, Joint};
use std::vec::Vec;

fn channel(name: &str, source: Source, range: [f32; 2]) -> Channel {
    let bus = Bus::Pca9685 { address: 0x40, output: 0 };
    let name = heapless::String::try_from(name).unwrap();
    let (command, speed, acceleration) = ([1000, 2000], 300.0, 2000.0);
    Channel { name, source, neutral: 0.0, start: Some(0.0), gain: 1.0, range, command, speed, acceleration, bus }
}

fn robot(channels: &[(Joint, Axis, [f32; 2])]) -> Robot {
    let mut robot = Robot {
        name: heapless::String::try_from("test").unwrap(),
        tick_rate: 50,
        fade: 0.3,
        return_time: 1.0,
        after: Rest::Hold,
        finish_without_host: true,
        creep: 20.0,
        output_enable: None,
        channels: heapless::Vec::new(),
    };
    for (number, (joint, axis, range)) in channels.iter().enumerate() {
        let mut channel = channel(&std::format!("{joint} {axis:?}"), Source::Joint(*joint as u8, *axis), *range);
        channel.bus = Bus::Pca9685 { address: 0x40 + number as u8 / 16, output: number as u8 % 16 };
        robot.channels.push(channel).unwrap();
    }
    robot
}

/// A body of about 1.7 m, arms hanging.
fn standing() -> Pose {
    let mut pose = [[0.0; 3]; JOINTS];
    for (joint, at) in [
        (Joint::Pelvis, [0.0, 0.95, 0.0]),
        (Joint::Spine1, [0.0, 1.06, 0.0]),
        (Joint::Spine2, [0.0, 1.2, 0.0]),
        (Joint::Spine3, [0.0, 1.25, 0.0]),
        (Joint::Neck, [0.0, 1.46, 0.0]),
        (Joint::Head, [0.0, 1.55, 0.0]),
    ] {
        pose[joint.index()] = at;
    }
    for (side, at) in [(1.0, 0), (-1.0, 1)] {
        for (joint, place) in [
            (Joint::LeftHip, [0.08, 0.9, 0.0]),
            (Joint::LeftKnee, [0.08, 0.5, 0.0]),
            (Joint::LeftAnkle, [0.08, 0.1, 0.0]),
            (Joint::LeftFoot, [0.08, 0.0507, 0.12]),
            (Joint::LeftCollar, [0.05, 1.4, 0.0]),
            (Joint::LeftShoulder, [0.17, 1.38, 0.0]),
            (Joint::LeftElbow, [0.17, 1.1, 0.0]),
            (Joint::LeftWrist, [0.17, 0.85, 0.0]),
        ] {
            pose[joint.index() + at] = [side * place[0], place[1], place[2]];
        }
    }
    pose
}

fn farthest(a: &Pose, b: &Pose) -> f32 {
    let distance = |a: &[f32; 3], b: &[f32; 3]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt();
    a.iter().zip(b).map(|(a, b)| distance(a, b)).fold(0.0, |a, b| if a > b { a } else { b })
}

/// Three axes at every ball joint, one at every hinge.
fn whole_body() -> Robot {
    use Axis::{X, Y, Z};
    let mut axes = Vec::new();
    axes.extend([
        (Joint::Pelvis, X, [-30.0, 30.0]),
        (Joint::Spine3, Y, [-50.0, 50.0]),
        (Joint::Spine3, X, [-30.0, 60.0]),
    ]);
    axes.extend([(Joint::Spine3, Z, [-25.0, 25.0]), (Joint::Neck, X, [-40.0, 40.0]), (Joint::Neck, Z, [-30.0, 30.0])]);
    for (shoulder, elbow, hip, knee, ankle, side) in [
        (Joint::LeftShoulder, Joint::LeftElbow, Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle, 1.0),
        (Joint::RightShoulder, Joint::RightElbow, Joint::RightHip, Joint::RightKnee, Joint::RightAnkle, -1.0),
    ] {
        let out = |near: f32, far: f32| if side > 0.0 { [near, far] } else { [-far, -near] };
        axes.extend([(shoulder, X, [-160.0, 40.0]), (shoulder, Z, out(-5.0, 80.0)), (shoulder, Y, [-80.0, 80.0])]);
        axes.extend([(elbow, X, [-140.0, 0.0]), (hip, X, [-90.0, 30.0]), (hip, Z, out(-5.0, 40.0))]);
        axes.extend([(hip, Y, [-40.0, 40.0]), (knee, X, [0.0, 130.0]), (ankle, X, [-30.0, 40.0])]);
    }
    robot(&axes)
}

/// Arm waving frames.
fn wave(robot: &Robot, frames: usize) -> Vec<Pose> {
    let at = |frame: usize, c: usize| {
        let [low, high] = robot.channels[c].range;
        0.5 * (low + high) + 0.3 * (high - low) * (frame as f32 * 0.21 + c as f32).sin()
    };
    let angles = |frame| (0..robot.channels.len()).map(|c| at(frame, c)).collect::<Vec<_>>();
    (0..frames).map(|frame| reach(robot, &standing(), &angles(frame))).collect()
}

fn arms() -> Robot {
    let mut robot = whole_body();
    robot.channels = robot.channels.iter().filter(|c| c.name.contains("shoulder")).cloned().collect();
    robot
}

/// Checks every tick against range, speed, acceleration and commands.
struct Watch {
    before: Vec<[f32; 2]>,
}

impl Watch {
    fn new(robot: &Robot) -> Self {
        Watch { before: robot.channels.iter().map(|c| [c.neutral, 0.0]).collect() }
    }

    fn look(&mut self, robot: &Robot, angles: &[f32], commands: &[u16]) {
        let rate = f32::from(robot.tick_rate);
        for (((channel, before), angle), command) in
            robot.channels.iter().zip(&mut self.before).zip(angles).zip(commands)
        {
            let [at, speed] = *before;
            let new_speed = (angle - at) * rate;
            let slack = 1e-3 * rate;
            assert!((channel.range[0]..=channel.range[1]).contains(angle), "{} at {angle}", channel.name);
            assert!(new_speed.abs() <= channel.speed + slack, "{} at {new_speed} deg/s", channel.name);
            assert!((new_speed - speed).abs() * rate <= channel.acceleration + slack * rate, "{} jerks", channel.name);
            assert!((channel.command[0]..=channel.command[1]).contains(command));
            *before = [*angle, new_speed];
        }
    }
}

/// The states of so many ticks, each of them looked at.
fn play<const C: usize>(player: &mut Player<'_, C>, robot: &Robot, watch: &mut Watch, ticks: u32) -> Vec<State> {
    let mut states = Vec::new();
    for _ in 0..ticks {
        let servos = player.tick();
        let (commands, state) = (servos.commands.to_vec(), servos.state);
        states.push(state);
        let angles: Vec<f32> = player.angles().collect();
        watch.look(robot, &angles, &commands);
    }
    states
}
