//! Motions without a model.

use motionette::JOINTS;
use motionette_host::motion::{Pose, skeleton};

use super::Random;

/// Offsets of the joints from their parents, a body of about 1.7 m with hanging arms, metres.
const OFFSETS: [[f32; 3]; JOINTS] = [
    [0.0, 0.95, 0.0],
    [0.08, -0.05, 0.0],
    [-0.08, -0.05, 0.0],
    [0.0, 0.11, 0.0],
    [0.0, -0.4, 0.0],
    [0.0, -0.4, 0.0],
    [0.0, 0.14, 0.0],
    [0.0, -0.4, 0.0],
    [0.0, -0.4, 0.0],
    [0.0, 0.05, 0.0],
    [0.0, -0.05, 0.12],
    [0.0, -0.05, 0.12],
    [0.0, 0.21, 0.0],
    [0.05, 0.15, 0.0],
    [-0.05, 0.15, 0.0],
    [0.0, 0.09, 0.0],
    [0.12, -0.02, 0.0],
    [-0.12, -0.02, 0.0],
    [0.0, -0.28, 0.0],
    [0.0, -0.28, 0.0],
    [0.0, -0.25, 0.0],
    [0.0, -0.25, 0.0],
];

/// A body that stands with hanging arms.
pub fn standing() -> Pose {
    let mut pose = OFFSETS;
    for j in 1..JOINTS {
        let parent = pose[skeleton::PARENTS[j]];
        pose[j].iter_mut().zip(parent).for_each(|(x, from)| *x += from);
    }
    pose
}

/// A body whose every bone swings by itself, up to `size` times its length, now slower, now faster.
pub fn random_motion(random: &mut Random, frames: usize, size: f32) -> Vec<Pose> {
    let swings: Vec<[[f32; 3]; 3]> =
        (0..JOINTS).map(|_| [random.vector(), random.vector(), random.vector()].map(|v| v.map(|x| x as f32))).collect();
    let pose = |frame: usize| {
        let mut pose = [[0.0; 3]; JOINTS];
        for j in 0..JOINTS {
            let [along, often, late] = swings[j];
            let length = OFFSETS[j].iter().map(|x| x * x).sum::<f32>().sqrt();
            let from = if j == 0 { [0.0; 3] } else { pose[skeleton::PARENTS[j]] };
            pose[j] = std::array::from_fn(|c| {
                let swing = (0.3 * often[c] * frame as f32 + 3.0 * late[c]).sin();
                from[c] + OFFSETS[j][c] + size * length * along[c] * swing
            });
        }
        pose
    };
    (0..frames).map(pose).collect()
}

/// The same body on a curve, turning around by 50 degrees a frame.
pub fn turning_motion(random: &mut Random, frames: usize, size: f32) -> Vec<Pose> {
    let turned = |(frame, pose): (usize, Pose)| {
        let frame = frame as f32;
        let (sin, cos) = (frame * 50f32.to_radians()).sin_cos();
        pose.map(|[x, y, z]| [0.3 * frame + cos * x + sin * z, y, 0.1 * frame * frame + cos * z - sin * x])
    };
    random_motion(random, frames, size).into_iter().enumerate().map(turned).collect()
}
