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

type Writer = fn(&[Pose], f64, &mut dyn Write) -> io::Result<()>;

const FORMS: [(Writer, Bones); 2] = [(write_bvh, Bones::Rigid), (write_positions, Bones::Stretching)];

fn text(write: Writer, motion: &[Pose], frame_time: f64) -> String {
    let mut bytes = Vec::new();
    write(motion, frame_time, &mut bytes).expect("memory does not fail");
    String::from_utf8(bytes).expect("text")
}

/// What the importer reads of a written motion.
fn read_back(write: Writer, motion: &[Pose]) -> import::Recording {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("motion.bvh");
    std::fs::write(&path, text(write, motion, 0.05)).expect("writable");
    let back = import::load(&path, &import::Reading::default()).expect("readable");
    assert_eq!(back.joints.len(), motion.len());
    back
}

/// Distances of the joints of two motions, metres, frame by frame.
fn distances<'m>(a: &'m [Pose], b: &'m [Pose]) -> impl Iterator<Item = f64> + 'm {
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    pairs.map(|(a, b)| q::length(q::subtract(a.map(f64::from), b.map(f64::from))))
}

fn worst(a: &[Pose], b: &[Pose]) -> f64 {
    distances(a, b).fold(0.0, f64::max)
}

#[test]
fn positions_give_every_joint_back_and_rigid_bones_those_of_a_rigid_body() {
    let rigid = [rigid_motion(90), rigid_motion(1)];
    for (write, motion) in [(write_bvh as Writer, &rigid[0]), (write_bvh, &rigid[1]), (write_positions, &rigid[0])] {
        let back = read_back(write, motion);
        assert_eq!((back.mapping.as_str(), back.fps_source), ("mixamo", 20.0));
        assert!(worst(&back.joints, motion) < 1e-5, "{} m", worst(&back.joints, motion));
    }
    let stretching = stretched(rigid_motion(90), 0.02);
    assert!(worst(&read_back(write_positions, &stretching).joints, &stretching) < 5e-6);
}

/// Positions of all joints of a file in its first frames, by rotation matrices; position channels replace OFFSET or are added to it.
fn by_convention(bvh: &import::Bvh, adds: bool) -> Vec<Vec<Vector>> {
    type Matrix = [[f64; 3]; 3];
    let product = |a: &Matrix, b: &Matrix| -> Matrix {
        std::array::from_fn(|r| std::array::from_fn(|c| (0..3).map(|k| a[r][k] * b[k][c]).sum()))
    };
    let about = |axis: usize, degrees: f64| -> Matrix {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut m = [[0.0; 3]; 3];
        (m[axis][axis], m[i][i], m[i][j], m[j][i], m[j][j]) = (1.0, cos, -sin, sin, cos);
        m
    };
    let frame = |values: &[f64]| {
        let mut placed: Vec<(Vector, Matrix)> = Vec::new();
        for joint in &bvh.joints {
            let (mut place, mut turn) = (joint.offset, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
            for (channel, &value) in joint.channels.iter().zip(&values[joint.first_channel..]) {
                match *channel {
                    import::Channel::Position(axis) if adds => place[axis] += value,
                    import::Channel::Position(axis) => place[axis] = value,
                    import::Channel::Rotation(axis) => turn = product(&turn, &about(axis, value)),
                }
            }
            if let Some(parent) = joint.parent {
                let (origin, above) = &placed[parent];
                place = q::add(*origin, above.map(|row| q::dot(row, place)));
                turn = product(above, &turn);
            }
            placed.push((place, turn));
        }
        placed.into_iter().map(|(place, _)| place).collect()
    };
    bvh.values.chunks(bvh.channels).map(frame).collect()
}

#[test]
fn readers_that_add_position_channels_to_offsets_see_what_those_see_that_replace_them() {
    for (write, bones) in FORMS {
        let bvh = import::parse(&text(write, &stretched(rigid_motion(40), 0.02), 0.05)).expect("readable");
        let (added, replaced) = (by_convention(&bvh, true), by_convention(&bvh, false));
        let apart = added.iter().flatten().zip(replaced.iter().flatten()).map(|(a, b)| q::length(q::subtract(*a, *b)));
        assert_eq!(apart.fold(0.0, f64::max), 0.0, "{bones:?}");
    }
}

#[test]
fn rigid_bones_keep_their_lengths_and_the_root_alone_moves() {
    let motion = stretched(rigid_motion(60), 0.02);
    let bvh = import::parse(&text(write_bvh, &motion, 0.05)).expect("readable");
    let places = |joint: &&import::Joint| joint.channels.iter().any(|c| matches!(c, import::Channel::Position(_)));
    assert_eq!(bvh.joints.iter().filter(places).map(|joint| joint.name.as_str()).collect::<Vec<_>>(), ["Hips"]);
    for frame in by_convention(&bvh, false) {
        for (joint, place) in bvh.joints.iter().zip(&frame) {
            let Some(parent) = joint.parent else { continue };
            let length = q::length(q::subtract(*place, frame[parent]));
            assert!((length - q::length(joint.offset)).abs() < 1e-9, "{}", joint.name);
        }
    }
}

#[test]
fn what_rigid_bones_cost_is_what_a_reader_finds() {
    let motion = stretched(rigid_motion(60), 0.02);
    let back = read_back(write_bvh, &motion).joints;
    let found: Vec<f64> = distances(&back, &motion).collect();
    let told = rigid_deviation(&motion);
    assert!((told.mean - found.iter().sum::<f64>() / found.len() as f64).abs() < 1e-6, "{told:?}");
    assert!((told.largest - found.iter().copied().fold(0.0, f64::max)).abs() < 1e-5, "{told:?}");
    assert!((told.largest - found[told.frame * JOINTS + told.joint]).abs() < 1e-5, "{told:?}");
    assert!(told.mean > 0.002, "the joints wander by 2 cm: {told:?}");
    assert!(rigid_deviation(&rigid_motion(60)).largest < 1e-6);
    assert_eq!(rigid_deviation(&[]), Deviation::default());

    // The same bones along the motion's own directions, which the other form's rotations are.
    let mut directions = import::parse(&text(write_positions, &motion, 0.05)).expect("readable");
    let rigid = import::parse(&text(write_bvh, &motion, 0.05)).expect("readable");
    for (joint, rigid) in directions.joints.iter_mut().zip(&rigid.joints).skip(1) {
        joint.offset = rigid.offset;
        joint.channels.iter_mut().filter(|c| matches!(c, import::Channel::Position(_))).for_each(|channel| {
            // A turn by nothing instead.
            *channel = import::Channel::Rotation(0);
        });
        let first = joint.first_channel;
        if !joint.channels.is_empty() {
            directions.values.chunks_mut(directions.channels).for_each(|row| row[first..first + 3].fill(0.0));
        }
    }
    let order: Vec<Option<usize>> =
        directions.joints.iter().map(|joint| NAMES.iter().position(|name| *name == joint.name)).collect();
    let (mut sum, mut count) = (0.0, 0.0);
    for (places, pose) in by_convention(&directions, false).iter().zip(&motion) {
        for (place, j) in places.iter().zip(&order).filter_map(|(place, j)| Some((place, (*j)?))) {
            sum += q::length(q::subtract(q::scale(*place, 0.01), pose[j].map(f64::from)));
            count += 1.0;
        }
    }
    assert!(told.mean < 0.8 * sum / count, "{told:?} {}", sum / count);
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
    assert!(worst(&read_back(write_positions, &motion).joints, &motion) < 5e-6);
    let rigid = rigid_deviation(&motion);
    assert!(rigid.mean < 0.01 && rigid.largest < 0.1, "{rigid:?}");
}

#[test]
fn rotations_carry_the_motion_of_rigid_bones() {
    let [rigid, positions] =
        FORMS.map(|(write, _)| import::parse(&text(write, &rigid_motion(90), 0.05)).expect("readable"));
    for frame in 0..positions.frames() {
        for (joint, rest) in positions.joints.iter().zip(&rigid.joints).skip(1).filter(|(j, _)| !j.end_site) {
            let first = frame * positions.channels + joint.first_channel;
            let position = [0, 1, 2].map(|axis| positions.values[first + axis]);
            let moved = q::length(q::subtract(position, rest.offset));
            assert!(moved < 2e-3, "frame {frame}: {} leaves its offset by {moved} cm", joint.name);
        }
    }
}

#[test]
fn the_hierarchy_is_the_skeleton_in_a_t_pose() {
    let written = text(write_bvh, &rigid_motion(30), 1.0 / 30.0);
    assert_eq!(written.matches("End Site").count(), 5);
    let bvh = import::parse(&written).expect("readable");
    assert_eq!((bvh.fps(), bvh.frames(), bvh.channels), (30.0, 30, 3 + 3 * JOINTS));
    let index = |name: &str| NAMES.iter().position(|known| *known == name).expect("a known name");
    let mut rest = [[0.0; 3]; JOINTS];
    for joint in bvh.joints.iter().filter(|joint| !joint.end_site) {
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
    for (write, _) in FORMS {
        assert_eq!(text(write, &motion, 0.05), text(write, &motion, 0.05));
        assert!(!text(write, &motion, 0.05).contains("-0.00000 "));
    }
}

#[test]
fn joints_that_coincide_are_written_all_the_same() {
    let mut motion = rigid_motion(10);
    motion[3] = [[1.0, 2.0, 3.0]; JOINTS];
    for (write, bones) in FORMS {
        for motion in [&motion[..], &[[[0.0; 3]; JOINTS]]] {
            let bvh = import::parse(&text(write, motion, 0.05)).expect("readable");
            let exact = bones == Bones::Stretching || motion.len() == 1;
            for (places, pose) in by_convention(&bvh, true).iter().zip(motion) {
                let root = q::subtract(q::scale(places[0], 0.01), pose[0].map(f64::from));
                assert!(q::length(root) < 1e-6 && places.iter().flatten().all(|x| x.is_finite()));
                let hand = bvh.joints.iter().position(|joint| joint.name == "LeftHand").expect("a hand");
                let hand = q::subtract(q::scale(places[hand], 0.01), pose[20].map(f64::from));
                assert!(!exact || q::length(hand) < 5e-6, "{hand:?}");
            }
        }
    }
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
