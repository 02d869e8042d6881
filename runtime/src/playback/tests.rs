//! Mapping and playing against known poses, brute force and the rules that the output must keep.

use super::Start;
use super::control::State;
use super::mapper::{Mapper, reach};
use super::queue::{Full, Handles, MotionQueue, When, queue_bytes};
use super::robot::{Axis, Bus, Channel, Fault, Rest, Robot, RobotError, Source, Violation};
use crate::numerics::hash::Stream;
use crate::representation::Pose;
use crate::{JOINTS, Joint};
use std::string::ToString;
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

#[test]
fn angles_that_made_a_pose_are_found_again() {
    let (robot, standing) = (whole_body(), standing());
    let mut random = Stream::new(5);
    let (mut sum, mut count) = (0.0, 0);
    for _ in 0..60 {
        // From one pose to the next on a line, as frames come.
        let mut draw = || -> Vec<f32> {
            let inside = |c: &Channel, u: f32| c.range[0] + (0.06 + 0.88 * u) * (c.range[1] - c.range[0]);
            robot.channels.iter().map(|c| inside(c, random.below(1001) as f32 / 1000.0)).collect()
        };
        let (from, to) = (draw(), draw());
        let mut mapper = Mapper::new(&robot);
        for k in 0..=40 {
            let angles: Vec<f32> = from.iter().zip(&to).map(|(a, b)| a + (b - a) * k as f32 / 40.0).collect();
            let pose = reach(&robot, &standing, &angles);
            let found = mapper.map(&robot, &pose);
            let again = reach(&robot, &pose, &found);
            let off = farthest(&pose, &again);
            // Legs and arms that are nearly straight leave their twist to the shortest arc.
            assert!(off < 0.015, "{off} m off at {angles:?}, found {found:?}");
            (sum, count) = (sum + off, count + 1);
        }
    }
    assert!(sum / (count as f32) < 0.002, "{} m on average", sum / count as f32);
}

#[test]
fn axes_turn_the_way_they_are_documented() {
    let standing = standing();
    let robot = whole_body();
    let angles: Vec<f32> = robot.channels.iter().map(|_| 0.0).collect();
    assert!(farthest(&reach(&robot, &standing, &angles), &standing) < 1e-4, "zero is standing");
    let moved = |joint: Joint, axis: Axis, angle: f32, seen: Joint| -> [f32; 3] {
        let source = Source::Joint(joint as u8, axis);
        let angles: Vec<f32> = robot.channels.iter().map(|c| if c.source == source { angle } else { 0.0 }).collect();
        reach(&robot, &standing, &angles)[seen.index()]
    };
    let [_, y, z] = moved(Joint::LeftShoulder, Axis::X, -90.0, Joint::LeftWrist);
    assert!(z > 0.5 && (y - 1.38).abs() < 1e-3, "the arm forward");
    let [x, y, _] = moved(Joint::LeftShoulder, Axis::Z, 90.0, Joint::LeftWrist);
    assert!(x > 0.65 && (y - 1.38).abs() < 1e-3, "the arm sideways");
    let [_, _, z] = moved(Joint::RightElbow, Axis::X, -90.0, Joint::RightWrist);
    assert!(z > 0.2, "the forearm forward");
    let [_, _, z] = moved(Joint::LeftKnee, Axis::X, 90.0, Joint::LeftAnkle);
    assert!(z < -0.3, "the shank backward");
    let [x, _, z] = moved(Joint::Spine3, Axis::Y, 40.0, Joint::LeftShoulder);
    assert!(z < -0.05 && x > 0.1, "the chest to the left");
    let [_, _, z] = moved(Joint::Neck, Axis::X, 30.0, Joint::Head);
    assert!(z > 0.03, "a nod");
}

/// What the mapper maximises, for one joint on an upright base with its bone hanging down.
fn fit(robot: &Robot, pose: &Pose, angles: &[f32]) -> f32 {
    let reached = reach(robot, pose, angles);
    let direction = |pose: &Pose| {
        let (a, b) = (pose[Joint::LeftShoulder.index()], pose[Joint::LeftElbow.index()]);
        [b[0] - a[0], b[1] - a[1], b[2] - a[2]]
    };
    let (a, b) = (direction(pose), direction(&reached));
    a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>() / a.iter().map(|a| a * a).sum::<f32>()
}

#[test]
fn with_fewer_axes_and_narrow_ranges_a_limb_points_as_well_as_it_can() {
    let two = robot(&[(Joint::LeftShoulder, Axis::X, [-100.0, 20.0]), (Joint::LeftShoulder, Axis::Z, [0.0, 60.0])]);
    let all = whole_body();
    let mut random = Stream::new(8);
    for _ in 0..60 {
        let angles: Vec<f32> = all
            .channels
            .iter()
            .map(|c| c.range[0] + random.below(1001) as f32 / 1000.0 * (c.range[1] - c.range[0]))
            .collect();
        // Chest and pelvis upright, so that the arm alone is compared.
        let angles: Vec<f32> = angles.iter().enumerate().map(|(i, a)| if i < 6 { 0.0 } else { *a }).collect();
        let pose = reach(&all, &standing(), &angles);
        let found = Mapper::new(&two).map(&two, &pose);
        let mut best = -1.0f32;
        for x in -50..=10 {
            for z in 0..=30 {
                let fit = fit(&two, &pose, &[2.0 * x as f32, 2.0 * z as f32]);
                best = if fit > best { fit } else { best };
            }
        }
        let reached = fit(&two, &pose, &found);
        // The twist counts a little, too.
        assert!(reached > best - 0.1, "{reached} where {best} can be had");
    }
}

#[test]
fn heading_goes_on_beyond_a_turn_and_angles_stay_inside() {
    let mut robot = robot(&[(Joint::Neck, Axis::X, [-10.0, 10.0])]);
    let mut pan = channel("pan", Source::Heading, [-300.0, 300.0]);
    pan.bus = Bus::Pwm { pin: 1 };
    robot.channels.push(pan).unwrap();
    let mut mapper = Mapper::new(&robot);
    let mut last = 0.0;
    for degrees in (0..290).step_by(10) {
        let (sin, cos) = (degrees as f32).to_radians().sin_cos();
        let pose = standing().map(|[x, y, z]| [x * cos + z * sin, y, z * cos - x * sin]);
        last = mapper.map(&robot, &pose)[1];
        assert!((last - degrees as f32).abs() < 0.01, "{last} for {degrees}");
    }
    assert!(last > 270.0);
    let nonsense = [[f32::NAN; 3]; JOINTS];
    for angle in mapper.map(&robot, &nonsense).iter().zip(&robot.channels) {
        assert!((angle.1.range[0]..=angle.1.range[1]).contains(angle.0));
    }
}

#[test]
fn robots_are_packed_and_opened_or_refused_with_the_reason() {
    let robot = whole_body();
    let mut bytes = [0; super::robot::MAX_BYTES];
    let length = robot.pack(&mut bytes).unwrap();
    let packed = &bytes[..length];
    assert_eq!(Robot::open(packed).unwrap(), robot);
    for cut in 0..length {
        assert!(Robot::open(&packed[..cut]).is_err());
    }
    for at in 0..length {
        let mut damaged = packed.to_vec();
        damaged[at] ^= 0x10;
        // The two unused bytes of the header may be anything.
        assert!(Robot::open(&damaged).is_err() || (6..8).contains(&at), "byte {at}");
    }
    let broken = |change: &dyn Fn(&mut Robot)| {
        let mut robot = robot.clone();
        change(&mut robot);
        let mut all = Vec::new();
        robot.violations(&mut |violation| all.push(violation));
        assert_eq!(robot.pack(&mut [0; super::robot::MAX_BYTES]), Err(RobotError::Violation(all[0])));
        assert!(!all[0].what.to_string().is_empty());
        all
    };
    let of = |channel: u8, what: Fault| Violation { channel: Some(channel), what };
    let found = broken(&|r| r.channels[3].range = [20.0, -20.0]);
    assert_eq!(found, [of(3, Fault::Range { range: [20.0, -20.0] })]);
    assert_eq!(broken(&|r| r.channels[4].source = Source::Joint(20, Axis::X)), [of(4, Fault::Joint(20))]);
    assert_eq!(broken(&|r| r.channels[2].name = r.channels[1].name.clone()), [of(2, Fault::SameName { other: 1 })]);
    assert_eq!(broken(&|r| r.channels[9].bus = r.channels[0].bus), [of(9, Fault::SameOutput { other: 0 })]);
    assert_eq!(broken(&|r| r.channels[3].source = r.channels[1].source), [of(3, Fault::SameAxis { other: 1 })]);
    assert_eq!(broken(&|r| r.channels[0].speed = 0.0).len(), 1);
    assert_eq!(broken(&|r| r.channels[0].gain = 0.0), [of(0, Fault::Gain(0.0))]);
    assert_eq!(broken(&|r| r.channels[0].neutral = 31.0).len(), 1);
    assert_eq!(broken(&|r| r.channels[0].command = [2000, 1000]).len(), 1);
    assert_eq!(broken(&|r| r.channels[0].bus = Bus::Pca9685 { address: 0x70, output: 16 }).len(), 2);
    assert_eq!(broken(&|r| r.channels[0].bus = Bus::Sts3215 { id: 254 }).len(), 1);
    let mut nonsense = robot.clone();
    (nonsense.channels[0].speed, nonsense.channels[1].gain, nonsense.channels[2].range[1]) =
        (f32::NAN, f32::NAN, f32::NAN);
    nonsense.creep = f32::NAN;
    let mut count = 0;
    nonsense.violations(&mut |_| count += 1);
    assert_eq!(count, 4);
    assert_eq!(broken(&|r| r.tick_rate = 5)[0], Violation { channel: None, what: Fault::TickRate(5) });
    assert_eq!(broken(&|r| r.channels.clear())[0], Violation { channel: None, what: Fault::NoChannels });
    assert_eq!(broken(&|r| r.creep = f32::INFINITY).len(), 1);
    assert_eq!(broken(&|r| r.creep = 0.5)[0], Violation { channel: None, what: Fault::Creep(0.5) });
    assert_eq!(broken(&|r| r.channels[2].start = None), [of(2, Fault::NoStart)]);
    let range = robot.channels[2].range;
    assert_eq!(broken(&|r| r.channels[2].start = Some(99.0)), [of(2, Fault::Start { start: 99.0, range })]);
    assert_eq!(broken(&|r| r.fade = -1.0)[0], Violation { channel: None, what: Fault::Times });
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

macro_rules! play {
    ($player:expr, $robot:expr, $watch:expr, $ticks:expr) => {{
        let mut states = Vec::new();
        for _ in 0..$ticks {
            let servos = $player.tick();
            let (commands, state) = (servos.commands.to_vec(), servos.state);
            states.push(state);
            let angles: Vec<f32> = $player.angles().collect();
            $watch.look($robot, &angles, &commands);
        }
        states
    }};
}

#[test]
fn a_motion_is_played_to_its_last_frame_and_held() {
    let robot = arms();
    let mut line = MotionQueue::<8, 128>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let mut watch = Watch::new(&robot);
    let frames = wave(&robot, 60);
    feeder.play_frames(&frames, 20, When::Then).unwrap();
    let states = play!(player, &robot, watch, 60 * 50 / 20);
    assert!(states.iter().all(|s| *s == State::Playing), "{states:?}");
    play!(player, &robot, watch, 100);
    let status = control.status();
    assert_eq!((status.state, status.motions, status.finished, status.frames), (State::Holding, 1, 1, 60));
    assert_eq!(status.starved, 0);
    let mut mapper = Mapper::new(&robot);
    let expected = frames.iter().map(|pose| mapper.map(&robot, pose)).last().unwrap();
    for (angle, expected) in player.angles().zip(expected) {
        assert!((angle - expected).abs() < 0.02, "{angle} {expected}");
    }
}

#[test]
fn a_motion_is_never_half_queued() {
    let robot = arms();
    let mut line = MotionQueue::<8, 64>::new();
    let Handles { mut feeder, mut player, .. } = line.split(&robot).unwrap();
    let frames = wave(&robot, 40);
    assert_eq!(feeder.play_frames(&wave(&robot, 70), 20, When::Then), Err(Full::Never { needed: 72, room: 63 }));
    feeder.play_frames(&frames, 20, When::Then).unwrap();
    assert_eq!(feeder.play_frames(&frames, 20, When::Then), Err(Full::Wait { needed: 42, free: 21 }));
    assert_eq!(feeder.queued(), 42);
    let mut ticks = 0;
    while feeder.play_frames(&frames, 20, When::Then).is_err() {
        player.tick();
        ticks += 1;
        assert!(ticks < 100);
    }
    assert!(line_error(&robot));
}

fn line_error(robot: &Robot) -> bool {
    MotionQueue::<4, 8>::new().split(robot).is_err_and(|e| (e.found, e.room) == (robot.channels.len(), 4))
}

#[test]
fn orders_take_effect_and_keep_the_limits() {
    let robot = arms();
    let mut line = MotionQueue::<8, 256>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let mut watch = Watch::new(&robot);
    feeder.play_frames(&wave(&robot, 100), 20, When::Then).unwrap();
    play!(player, &robot, watch, 80);
    control.hold();
    let states = play!(player, &robot, watch, 50);
    assert!(states.iter().all(|s| *s == State::Holding));
    let held: Vec<f32> = player.angles().collect();
    let frames = control.status().frames;
    play!(player, &robot, watch, 50);
    assert_eq!(player.angles().collect::<Vec<_>>(), held);
    control.resume();
    play!(player, &robot, watch, 40);
    assert!(control.status().frames > frames && control.status().state == State::Playing, "it goes on where it was");

    // Now: what was queued is gone.
    feeder.play_frames(&wave(&robot, 30), 20, When::Now).unwrap();
    play!(player, &robot, watch, 4);
    assert!(feeder.queued() < 32, "{}", feeder.queued());
    play!(player, &robot, watch, 120);
    assert_eq!((control.status().motions, control.status().finished), (2, 1));

    feeder.play_frames(&wave(&robot, 100), 20, When::Then).unwrap();
    play!(player, &robot, watch, 60);
    control.stop();
    control.neutral();
    control.hold();
    let states = play!(player, &robot, watch, 40);
    assert_eq!((states[0], states[39]), (State::Stopping, State::Stopped), "nothing overrides a stop");
    let stopped: Vec<f32> = player.angles().collect();
    feeder.play_frames(&wave(&robot, 20), 20, When::Then).unwrap();
    play!(player, &robot, watch, 40);
    assert_eq!(player.angles().collect::<Vec<_>>(), stopped);
    control.resume();
    control.neutral();
    let states = play!(player, &robot, watch, 200);
    assert_eq!((states[0], states[199]), (State::Returning, State::Neutral));
    assert!(player.angles().all(|a| a.abs() < 1e-4));
}

#[test]
fn frames_that_come_late_are_waited_for() {
    let robot = arms();
    let mut line = MotionQueue::<8, 32>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let mut watch = Watch::new(&robot);
    let frames = wave(&robot, 40);
    feeder.begin(20).unwrap();
    for frame in &frames[..10] {
        feeder.frame(frame).unwrap();
    }
    let states = play!(player, &robot, watch, 100);
    assert_eq!(states[99], State::Starved);
    assert!(control.status().starved > 50);
    for frame in &frames[10..] {
        feeder.frame(frame).unwrap();
    }
    feeder.end().unwrap();
    let states = play!(player, &robot, watch, 100);
    assert_eq!((states[0], states[99]), (State::Playing, State::Holding));
    assert_eq!((control.status().frames, control.status().finished), (40, 1));
    // A motion without frames is one, too.
    feeder.play_frames(&[], 20, When::Then).unwrap();
    play!(player, &robot, watch, 3);
    assert_eq!((control.status().finished, control.status().state), (2, State::Holding));
}

#[test]
fn any_orders_at_any_time_keep_the_limits() {
    let robot = arms();
    let mut random = Stream::new(77);
    for _ in 0..60 {
        let mut line = MotionQueue::<8, 48>::new();
        let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
        let mut watch = Watch::new(&robot);
        let frames = wave(&robot, 40);
        for _ in 0..60 {
            match random.below(9) {
                0 => control.stop(),
                1 => control.hold(),
                2 => control.neutral(),
                3 | 4 => control.resume(),
                5 => drop(feeder.play_frames(&frames[random.below(40) as usize..], 20, When::Now)),
                6 => drop(feeder.play_frames(&frames[random.below(40) as usize..], 20, When::Then)),
                7 => drop(feeder.begin(20)),
                _ => drop(feeder.frame(&frames[random.below(40) as usize])),
            }
            play!(player, &robot, watch, random.below(30));
        }
        assert_eq!(control.status().ticks, player.status().ticks);
    }
}

#[test]
fn servos_creep_from_where_they_are_found_and_motions_wait() {
    let robot = arms();
    let mut line = MotionQueue::<8, 128>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let found: Vec<f32> = robot.channels.iter().map(|c| 0.8 * c.range[1] + 0.2 * c.range[0]).collect();
    feeder.play_frames(&wave(&robot, 40), 20, When::Then).unwrap();
    player.stand_at(&found);
    assert!(player.angles().zip(&found).all(|(angle, found)| (angle - found).abs() < 1e-4), "where they are");
    let mut before: Vec<f32> = player.angles().collect();
    let mut slow = |player: &mut super::Player<'_, 8>, ticks| {
        for _ in 0..ticks {
            player.tick();
            let now: Vec<f32> = player.angles().collect();
            let most = robot.creep / f32::from(robot.tick_rate) + 1e-4;
            assert!(now.iter().zip(&before).all(|(a, b)| (a - b).abs() <= most), "faster than creeping");
            before = now;
        }
    };
    slow(&mut player, 50);
    assert_eq!((control.start(), control.status().state), (Start::Creeping, State::Returning));
    control.stop();
    slow(&mut player, 20);
    let stopped: Vec<f32> = player.angles().collect();
    slow(&mut player, 20);
    assert_eq!((player.angles().collect::<Vec<_>>(), control.status().state), (stopped, State::Stopped));
    control.resume();
    feeder.play_frames(&wave(&robot, 40), 20, When::Then).unwrap();
    let ticks = (0..500).find(|_| {
        slow(&mut player, 1);
        control.start() == Start::Ready
    });
    assert!(ticks.is_some() && player.angles().all(|angle| angle.abs() < 1e-4), "at neutral");
    (0..40).for_each(|_| _ = player.tick());
    assert_eq!((control.status().motions, control.status().state), (1, State::Playing), "what came after the stop");

    // Servos that moved by themselves in mid-motion come back, and the motion goes on.
    let mut watch = Watch::new(&robot);
    let off: Vec<f32> = player.angles().map(|angle| angle - 3.0).collect();
    let frames = control.status().frames;
    player.stand_at(&off);
    player.tick();
    assert_eq!((control.start(), control.status().frames), (Start::Creeping, frames));
    watch.before = player.angles().map(|angle| [angle, 0.0]).collect();
    (0..5).for_each(|_| _ = player.tick());
    watch.before = player.angles().map(|angle| [angle, robot.creep]).collect();
    play!(player, &robot, watch, 200);
    assert_eq!((control.start(), control.status().finished), (Start::Ready, 1));
}

#[test]
fn everything_that_was_queued_at_a_stop_is_gone() {
    let robot = arms();
    for (orders, ticks) in [(0, 0), (0, 1), (0, 3), (1, 1), (2, 1)] {
        let mut line = MotionQueue::<8, 256>::new();
        let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
        let mut watch = Watch::new(&robot);
        // Two motions fill the line; a third one is still open.
        feeder.play_frames(&wave(&robot, 100), 20, When::Then).unwrap();
        feeder.play_frames(&wave(&robot, 100), 20, When::Then).unwrap();
        feeder.begin(20).unwrap();
        feeder.frame(&standing()).unwrap();
        play!(player, &robot, watch, 20);
        match orders {
            0 => control.stop(),
            1 => control.neutral(),
            _ => {
                control.stop();
                play!(player, &robot, watch, 1);
                // What comes while the robot is stopped is not kept for later, either.
                feeder.play_frames(&wave(&robot, 30), 20, When::Then).unwrap();
                feeder.play_frames(&wave(&robot, 10), 20, When::Then).unwrap();
            }
        }
        play!(player, &robot, watch, ticks);
        control.resume();
        feeder.frame(&standing()).unwrap();
        let states = play!(player, &robot, watch, 200);
        assert_eq!(
            (control.status().motions, control.status().finished),
            (1, 0),
            "{orders} {ticks}: another one began"
        );
        assert!(matches!(states[199], State::Holding | State::Neutral));
        feeder.play_frames(&wave(&robot, 30), 20, When::Then).unwrap();
        play!(player, &robot, watch, 200);
        assert_eq!(
            (control.status().motions, control.status().finished),
            (2, 1),
            "{orders} {ticks}: the next one plays"
        );
    }
}

#[test]
fn now_is_seen_however_many_motions_came_before() {
    let robot = arms();
    let mut line = MotionQueue::<8, 256>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let frames = wave(&robot, 60);
    for others in [0, 1, 253, 254, 255, 256, 65_534] {
        feeder.play_frames(&frames[..1], 20, When::Now).unwrap();
        for _ in 0..others {
            feeder.play_frames(&[], 20, When::Then).unwrap();
            player.tick();
        }
        (0..10).for_each(|_| _ = player.tick());
        // A long one plays, and is to be cut off.
        feeder.play_frames(&frames, 20, When::Then).unwrap();
        (0..10).for_each(|_| _ = player.tick());
        assert_eq!(control.status().state, State::Playing);
        let finished = control.status().finished;
        feeder.play_frames(&frames[..1], 1000, When::Now).unwrap();
        (0..10).for_each(|_| _ = player.tick());
        assert_eq!(
            (control.status().state, control.status().finished),
            (State::Holding, finished + 1),
            "after {others}"
        );
    }
}

#[test]
fn a_motion_of_any_frame_rate_lasts_its_time() {
    let robot = arms();
    let mut line = MotionQueue::<8, 4096>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    for (frame_rate, frames, seconds) in
        [(1, 3, 3.0), (255, 510, 2.0), (256, 512, 2.0), (300, 600, 2.0), (1000, 4000, 4.0)]
    {
        let finished = control.status().finished;
        feeder.play_frames(&wave(&robot, frames), frame_rate, When::Then).unwrap();
        let ticks = (0..1000).find(|_| {
            player.tick();
            control.status().finished > finished
        });
        let took = ticks.unwrap() as f32 / 50.0;
        assert!((took - seconds).abs() < 0.1, "{frame_rate} frames a second: {took} s, not {seconds}");
    }
    // 65535 frames a second are many a tick, but no reason to wait.
    feeder.play_frames(&wave(&robot, 3000), u16::MAX, When::Then).unwrap();
    (0..5).for_each(|_| _ = player.tick());
    assert_eq!(control.status().state, State::Holding);
    assert_eq!(feeder.play_frames(&wave(&robot, 3), 0, When::Then), Err(Full::NoFrameRate));
    assert_eq!((feeder.begin(0), feeder.queued()), (Err(Full::NoFrameRate), 0));
}

#[test]
fn the_bytes_of_a_line_are_as_promised() {
    assert_eq!(queue_bytes(1, 1), size_of::<MotionQueue<1, 4>>());
    assert_eq!(queue_bytes(3, 2), size_of::<MotionQueue<3, 5>>());
    assert_eq!(queue_bytes(8, 196), size_of::<MotionQueue<8, 199>>());
    assert_eq!(queue_bytes(12, 196), size_of::<MotionQueue<12, 199>>());
    assert_eq!(queue_bytes(31, 100), size_of::<MotionQueue<31, 103>>());
}
