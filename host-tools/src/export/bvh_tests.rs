use std::path::PathBuf;

use super::super::rig::T_POSE;
use super::*;
use crate::import::bvh as import;
use crate::motion::skeleton;

/// A body of rigid bones that walks a curve, turns more than once, bends at every joint and passes the pole of its angles.
fn rigid_motion(frames: usize) -> Vec<Pose> {
    (0..frames)
        .map(|t| {
            let t = t as f64 * 0.05;
            let mut turns = [q::IDENTITY; JOINTS];
            let mut pose = [[0.0; 3]; JOINTS];
            pose[0] = [2.0 * t.sin(), 0.95 + 0.05 * (5.0 * t).cos(), 0.8 * t];
            turns[0] =
                q::multiply(q::about([0.0, 1.0, 0.0], 2.5 * t), q::about([1.0, 0.0, 0.0], 1.8 * (0.9 * t).sin()));
            for j in 1..JOINTS {
                let parent = skeleton::PARENTS[j];
                let length = 0.1 + 0.013 * j as f64;
                pose[j] = q::add(pose[parent], q::rotate(turns[parent], q::scale(T_POSE[j], length)));
                let axis = q::direction([1.0, (j % 3) as f64 - 1.0, (j % 5) as f64 - 2.0]).expect("not zero");
                turns[j] = q::multiply(turns[parent], q::about(axis, (t * (1.0 + 0.1 * j as f64)).sin()));
            }
            pose.map(|p| p.map(|x| x as f32))
        })
        .collect()
}

/// The same with joints that wander by up to `by` metres: bones stretch.
fn stretched(mut motion: Vec<Pose>, by: f32) -> Vec<Pose> {
    for (t, pose) in motion.iter_mut().enumerate() {
        for (j, p) in pose.iter_mut().enumerate() {
            for (axis, x) in p.iter_mut().enumerate() {
                *x += by * ((t * 7 + j * 13 + axis * 29) as f32).sin();
            }
        }
    }
    motion
}

fn text(motion: &[Pose], frame_time: f64) -> String {
    let mut bytes = Vec::new();
    write_bvh(motion, frame_time, &mut bytes).expect("memory does not fail");
    String::from_utf8(bytes).expect("text")
}

/// Writes, reads with the importer and gives its recording and the largest distance of a joint, metres.
fn round_trip(motion: &[Pose]) -> (import::Recording, f64) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("motion.bvh");
    std::fs::write(&path, text(motion, 0.05)).expect("writable");
    let back = import::load(&path, None).expect("readable");
    assert_eq!(back.joints.len(), motion.len());
    let worst = back
        .joints
        .iter()
        .flatten()
        .zip(motion.iter().flatten())
        .fold(0.0, |worst: f64, (a, b)| worst.max(q::length(q::subtract(a.map(f64::from), b.map(f64::from)))));
    (back, worst)
}

#[test]
fn the_importer_gives_every_joint_back() {
    for motion in [rigid_motion(90), stretched(rigid_motion(90), 0.02), rigid_motion(1)] {
        let (back, worst) = round_trip(&motion);
        assert_eq!((back.mapping.as_str(), back.fps_source), ("mixamo", 20.0));
        assert!(worst < 5e-6, "{worst} m");
    }
}

#[test]
fn recorded_motion_comes_back() {
    let path = std::env::var_os("MOTIONETTE_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from)
        .join("mocap/joints.safetensors");
    let Ok(bytes) = std::fs::read(&path) else {
        eprintln!("skipped: ../shared/mocap/joints.safetensors not found");
        return;
    };
    let tensors = safetensors::SafeTensors::deserialize(&bytes).expect("a safetensors file");
    let (local, root) = (tensors.tensor("local").expect("local"), tensors.tensor("root_xz").expect("root_xz"));
    let local: Vec<f32> =
        local.data().chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32()).collect();
    let root: Vec<f32> = root.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let rows = local.chunks_exact(3 * JOINTS).zip(root.chunks_exact(2)).take(400);
    let motion: Vec<Pose> = rows
        .map(|(row, root)| std::array::from_fn(|j| [row[3 * j] + root[0], row[3 * j + 1], row[3 * j + 2] + root[1]]))
        .collect();
    let (_, worst) = round_trip(&motion);
    assert!(worst < 5e-6, "{worst} m");
}

#[test]
fn rotations_carry_the_motion_of_rigid_bones() {
    let bvh = import::parse(&text(&rigid_motion(90), 0.05)).expect("readable");
    for frame in 0..bvh.frames() {
        for joint in &bvh.joints[1..] {
            let first = frame * bvh.channels + joint.first_channel;
            let position = [0, 1, 2].map(|axis| bvh.values[first + axis]);
            let moved = q::length(q::subtract(position, joint.offset));
            assert!(moved < 2e-3, "frame {frame}: {} leaves its offset by {moved} cm", joint.name);
        }
    }
}

#[test]
fn the_hierarchy_is_the_skeleton_in_a_t_pose() {
    let written = text(&rigid_motion(30), 1.0 / 30.0);
    assert_eq!(written.matches("End Site").count(), 5);
    let bvh = import::parse(&written).expect("readable");
    assert_eq!((bvh.fps(), bvh.frames(), bvh.channels), (30.0, 30, 6 * JOINTS));
    let index = |name: &str| NAMES.iter().position(|known| *known == name).expect("a known name");
    let mut rest = [[0.0; 3]; JOINTS];
    for joint in &bvh.joints {
        let j = index(&joint.name);
        let parent = joint.parent.map_or(0, |parent| index(&bvh.joints[parent].name));
        assert_eq!(parent, skeleton::PARENTS[j], "{}", joint.name);
        rest[j] = q::add(if j == 0 { [0.0; 3] } else { rest[parent] }, joint.offset);
        let length = if j == 0 { 0.0 } else { 10.0 + 1.3 * j as f64 };
        assert!((q::length(joint.offset) - length).abs() < 1e-3, "{}", joint.name);
    }
    let (hand, shoulder) = (rest[index("LeftHand")], rest[index("LeftArm")]);
    assert!((hand[1] - shoulder[1]).abs() < 1e-3 && hand[0] > shoulder[0] + 20.0, "{hand:?} {shoulder:?}");
}

#[test]
fn text_is_the_same_every_time_and_says_no_minus_zero() {
    let motion = rigid_motion(5);
    assert_eq!(text(&motion, 0.05), text(&motion, 0.05));
    assert!(!text(&motion, 0.05).contains("-0.00000 "));
}

#[test]
fn joints_that_coincide_are_written_all_the_same() {
    let mut motion = rigid_motion(10);
    motion[3] = [[1.0, 2.0, 3.0]; JOINTS];
    assert!(round_trip(&motion).1 < 5e-6);
    assert!(round_trip(&[[[0.0; 3]; JOINTS]]).1 < 5e-6);
}

#[test]
fn what_cannot_be_written_is_refused_with_its_place() {
    let refused = |motion: &[Pose], frame_time: f64| {
        let mut bytes = Vec::new();
        let error = write_bvh(motion, frame_time, &mut bytes).expect_err("refused");
        assert_eq!((error.kind(), bytes.len()), (io::ErrorKind::InvalidInput, 0));
        error.to_string()
    };
    let mut motion = rigid_motion(3);
    assert!(refused(&[], 0.05).contains("no frames"));
    assert!(refused(&motion, 0.0).contains("frame time") && refused(&motion, f64::NAN).contains("NaN"));
    motion[2][20][1] = f32::INFINITY;
    assert!(refused(&motion, 0.05).contains("frame 2: the position of left_wrist"));
}
