//! Properties of rotations, mirroring, retargeting and extraction over random motion.

mod common;

use common::Random;
use motionette_host::motion::features::{self, Bones, Error, Options, mirror_joints};
use motionette_host::motion::quaternion::{self as q, Quaternion};
use motionette_host::motion::{FEATURES, JOINTS, Pose, recover, skeleton, uniform};

/// A random rotation, all of them reached.
fn rotation(random: &mut Random) -> Quaternion {
    let axis = random.vector();
    q::normalise([random.uniform(), axis[0], axis[1], axis[2]])
}

fn same_rotation(a: Quaternion, b: Quaternion) -> bool {
    let dot: f64 = (0..4).map(|i| a[i] * b[i]).sum();
    1.0 - dot.abs() < 1e-12
}

#[test]
fn six_numbers_give_the_rotation_back() {
    let mut random = Random(1);
    for _ in 0..10_000 {
        let r = rotation(&mut random);
        assert!(same_rotation(q::from_6d(q::to_6d(r)).unwrap(), r));
        // Scaled and sheared columns mean the same rotation.
        let mut d = q::to_6d(r);
        for i in 0..3 {
            d[i + 3] = 2.0 * d[i + 3] + 0.7 * d[i];
            d[i] *= 3.0;
        }
        assert!(same_rotation(q::from_6d(d).unwrap(), r));
    }
    assert_eq!(q::from_6d([0.0; 6]), None);
    assert_eq!(q::from_6d([1.0, 0.0, 0.0, 2.0, 0.0, 0.0]), None);
}

#[test]
fn half_turns_are_rotations_too() {
    for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]] {
        let r = q::about(axis, std::f64::consts::PI);
        assert!(same_rotation(q::from_6d(q::to_6d(r)).unwrap(), r));
    }
}

#[test]
fn the_shortest_rotation_between_directions() {
    let mut random = Random(2);
    for n in 0..10_000 {
        let (Some(u), Some(v)) = (q::direction(random.vector()), q::direction(random.vector())) else { continue };
        let v = if n % 10 == 0 { q::scale(u, -1.0) } else { v };
        let r = q::between(u, v);
        assert!(q::length(q::subtract(q::rotate(r, u), v)) < 1e-9);
        // Shortest: the axis is perpendicular to both, so the angle is the angle between them.
        assert!((2.0 * r[0] * r[0] - 1.0 - q::dot(u, v)).abs() < 1e-9);
        assert!(same_rotation(q::multiply(r, q::inverse(r)), q::IDENTITY));
    }
}

#[test]
fn interpolation_divides_the_arc() {
    let mut random = Random(3);
    for _ in 0..1000 {
        let (a, b, t) = (rotation(&mut random), rotation(&mut random), (random.uniform() + 1.0) / 2.0);
        let angle = |x: Quaternion, y: Quaternion| 2.0 * (0..4).map(|i| x[i] * y[i]).sum::<f64>().abs().min(1.0).acos();
        let middle = q::slerp(a, b, t);
        assert!((angle(a, middle) - t * angle(a, b)).abs() < 1e-6);
        assert!((angle(middle, b) - (1.0 - t) * angle(a, b)).abs() < 1e-6);
        assert!(same_rotation(q::slerp(a, a, t), a));
    }
}

/// Smooth random motion of a body: rest pose, swaying bones, walking and turning root.
fn motion(seed: u64, frames: usize) -> Vec<Pose> {
    let mut random = Random(seed);
    let waves: Vec<([f64; 3], f64, f64)> =
        (0..JOINTS).map(|_| (random.vector(), random.uniform(), 3.0 * random.uniform())).collect();
    let (turn, speed) = (0.05 * random.uniform(), 0.03 * random.uniform());
    (0..frames)
        .map(|t| {
            let time = t as f64 / 20.0;
            let heading = q::about([0.0, 1.0, 0.0], turn * t as f64 + 0.4);
            let mut pose = [[0.0f64; 3]; JOINTS];
            pose[0] = [speed * t as f64 + 1.0, 0.9 + 0.02 * (3.0 * time).sin(), 0.01 * t as f64 - 2.0];
            for j in 1..JOINTS {
                let (axis, phase, rate) = waves[j];
                let sway = match q::direction(axis) {
                    Some(axis) => q::about(axis, 0.6 * (rate * time + 3.0 * phase).sin()),
                    None => q::IDENTITY,
                };
                let bone = q::scale(skeleton::REST_DIRECTIONS[j], 0.1 + 0.02 * j as f64);
                pose[j] = q::add(pose[skeleton::PARENTS[j]], q::rotate(heading, q::rotate(sway, bone)));
            }
            pose.map(|p| p.map(|x| x as f32))
        })
        .collect()
}

#[test]
fn mirrored_twice_is_the_same_bits() {
    for seed in 0..20 {
        let motion = motion(seed, 9);
        let once = mirror_joints(&motion);
        assert_ne!(once, motion);
        assert_eq!(mirror_joints(&once), motion);
    }
}

/// What mirroring must do to features, channel by channel: negate x, yaw velocity and swap sides. An independent road to the same numbers.
fn mirrored_row(row: &[f32]) -> Vec<f32> {
    let mut out = row.to_vec();
    out[0] = -row[0];
    out[1] = -row[1];
    for j in 0..JOINTS {
        let other = skeleton::MIRROR[j];
        if j > 0 {
            let (to, from) = (features::POSITIONS.start + 3 * (j - 1), features::POSITIONS.start + 3 * (other - 1));
            out[to..to + 3].copy_from_slice(&[-row[from], row[from + 1], row[from + 2]]);
            // The mirror image of a rotation negates what mixes x with the other axes: columns x and y of the matrix.
            let (to, from) = (features::ROTATIONS.start + 6 * (j - 1), features::ROTATIONS.start + 6 * (other - 1));
            let signs = [1.0, -1.0, -1.0, -1.0, 1.0, 1.0];
            (0..6).for_each(|i| out[to + i] = signs[i] * row[from + i]);
        }
        let (to, from) = (features::VELOCITIES.start + 3 * j, features::VELOCITIES.start + 3 * other);
        out[to..to + 3].copy_from_slice(&[-row[from], row[from + 1], row[from + 2]]);
    }
    let contacts = features::CONTACTS.start;
    (0..4).for_each(|i| out[contacts + i] = row[contacts + (i + 2) % 4]);
    out
}

#[test]
fn features_of_the_mirrored_motion_are_mirrored_features() {
    for seed in 0..20 {
        let motion = motion(seed, 40);
        let options = Options { bones: Bones::Keep, ..Options::default() };
        let plain = features::extract(&motion, &options).unwrap();
        let mirrored = features::extract(&mirror_joints(&motion), &options).unwrap();
        for (row, theirs) in plain.chunks(FEATURES).zip(mirrored.chunks(FEATURES)) {
            for (c, (a, b)) in mirrored_row(row).iter().zip(theirs).enumerate() {
                assert!((a - b).abs() < 2e-5, "seed {seed} channel {c}: {a} {b}");
            }
        }
    }
}

#[test]
fn recovery_undoes_extraction() {
    for seed in 0..20 {
        let motion = motion(seed, 60);
        for bones in [Bones::Keep, Bones::Uniform] {
            let processed = features::process(&motion, &Options { bones, ..Options::default() }).unwrap();
            let recovered = recover::joints(&processed.features).unwrap();
            assert_eq!(recovered.len(), 59);
            for (a, b) in recovered.iter().flatten().zip(processed.joints.iter().flatten()) {
                assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-5), "seed {seed}: {a:?} {b:?}");
            }
        }
    }
}

/// The half angle of a turn is stored; no sign may flip where the body passes a half turn from its start, however it turns.
#[test]
fn turning_round_and_round_is_recovered() {
    for (seed, turn) in [(1, 0.15), (2, -0.15), (3, 0.31)] {
        let still = motion(seed, 200);
        let spinning: Vec<Pose> = still
            .iter()
            .enumerate()
            .map(|(t, pose)| {
                let heading = q::about([0.0, 1.0, 0.0], turn * t as f64);
                pose.map(|p| q::rotate(heading, p.map(f64::from)).map(|x| x as f32))
            })
            .collect();
        let processed = features::process(&spinning, &Options { bones: Bones::Keep, ..Options::default() }).unwrap();
        let recovered = recover::joints(&processed.features).unwrap();
        for (t, (a, b)) in recovered.iter().zip(&processed.joints).enumerate() {
            assert!((0..JOINTS).all(|j| (0..3).all(|c| (a[j][c] - b[j][c]).abs() < 2e-5)), "turn {turn} frame {t}");
        }
    }
}

#[test]
fn processing_does_not_care_where_and_how_large_the_body_stood() {
    for seed in 0..10 {
        let motion = motion(seed, 30);
        let turn = q::about([0.0, 1.0, 0.0], 2.0 + seed as f64);
        let elsewhere: Vec<Pose> = motion
            .iter()
            .map(|pose| {
                pose.map(|p| {
                    q::add(q::scale(q::rotate(turn, p.map(f64::from)), 1.3), [5.0, -2.0, 7.0]).map(|x| x as f32)
                })
            })
            .collect();
        let (a, b) =
            (features::process(&motion, &Options::default()), features::process(&elsewhere, &Options::default()));
        let (a, b) = (a.unwrap(), b.unwrap());
        // Toes and feet are a tenth of a metre long, coordinates some metres in f32: directions are known to about 1e-5.
        for (c, (x, y)) in a.features.iter().zip(&b.features).enumerate() {
            assert!((x - y).abs() < 2e-4, "seed {seed} row {} channel {}: {x} {y}", c / FEATURES, c % FEATURES);
        }
        for pose in &a.joints {
            let lengths = uniform::bone_lengths(&pose.map(|p| p.map(f64::from)));
            assert!((0..JOINTS).all(|j| (lengths[j] - uniform::BONE_LENGTHS[j]).abs() < 1e-5));
        }
        let lowest = a.joints.iter().flatten().map(|p| p[1]).fold(f32::MAX, |a, b| if b < a { b } else { a });
        assert!(
            (-1e-6..0.05).contains(&lowest),
            "the floor is at the lowest joint, the lost last frame included: {lowest}"
        );
        assert_eq!((a.joints[0][0][0], a.joints[0][0][2]), (0.0, 0.0));
    }
}

#[test]
fn motions_without_features_say_where_and_why() {
    let good = motion(1, 10);
    let fails = |change: &dyn Fn(&mut Vec<Pose>)| {
        let mut bad = good.clone();
        change(&mut bad);
        features::extract(&bad, &Options::default()).unwrap_err()
    };
    assert_eq!(fails(&|m| m.truncate(1)), Error::TooShort { frames: 1 });
    assert_eq!(fails(&|m| m.clear()), Error::TooShort { frames: 0 });
    assert_eq!(fails(&|m| m[3][7][1] = f32::NAN), Error::NotFinite { frame: 3, joint: 7 });
    assert_eq!(fails(&|m| m[9][0][2] = f32::INFINITY), Error::NotFinite { frame: 9, joint: 0 });
    assert_eq!(fails(&|m| m[5][15] = m[5][12]), Error::NoBone { frame: 5, joint: 15 });
    assert_eq!(fails(&|m| m[0] = [[1.0; 3]; JOINTS]), Error::NoBone { frame: 0, joint: 5 });
    let stacked = |m: &mut Vec<Pose>| {
        for (j, p) in m[0].iter_mut().enumerate() {
            *p = [0.0, j as f32, 0.0];
        }
    };
    assert_eq!(fails(&stacked), Error::NoFacing { frame: 0 });
}
