//! Poses to angles, and back.

use super::{channel, farthest, robot, standing, whole_body};
use crate::numerics::hash::Stream;
use crate::playback::mapper::{Mapper, reach};
use crate::playback::robot::{Axis, Bus, Channel, Robot, Source};
use crate::representation::Pose;
use crate::{JOINTS, Joint};
use std::vec::Vec;

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
