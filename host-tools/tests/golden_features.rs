//! HumanML3D's published features against ours, both ways.

mod common;

use motionette_host::import::npy;
use motionette_host::motion::features::{self, Bones, Options};
use motionette_host::motion::{FEATURES, JOINTS, Pose, recover, uniform};

/// Published features `[T][263]` and joints `[T]` of one clip.
fn golden(name: &str) -> Option<(Vec<f64>, Vec<Pose>)> {
    let features = npy::read(&common::shared(&format!("golden/new_joint_vecs_{name}.npy"))?).unwrap();
    let joints = npy::read(&common::shared(&format!("golden/new_joints_{name}.npy"))?).unwrap();
    assert_eq!(features.shape, [joints.shape[0], FEATURES]);
    let (points, _) = joints.data.as_chunks::<3>();
    let (poses, _) = points.as_chunks::<JOINTS>();
    Some((features.data, poses.iter().map(|pose| pose.map(|p| p.map(|x| x as f32))).collect()))
}

const CLIPS: [&str; 2] = ["012314", "000000"];

#[test]
fn recovered_joints_match_to_a_hundredth_of_a_millimetre() {
    for name in CLIPS {
        let Some((features, joints)) = golden(name) else { return };
        let recovered = recover::joints_f64(&features).unwrap();
        let narrow: Vec<f32> = features.iter().map(|&x| x as f32).collect();
        let recovered_f32 = recover::joints(&narrow).unwrap();
        let mut worst = [0.0f64; 2];
        for ((a, b), c) in recovered.iter().zip(&joints).zip(&recovered_f32) {
            for j in 0..JOINTS {
                for x in 0..3 {
                    worst[0] = worst[0].max((a[j][x] - f64::from(b[j][x])).abs());
                    worst[1] = worst[1].max(f64::from((c[j][x] - b[j][x]).abs()));
                }
            }
        }
        println!("{name}: {} frames, recovery error {:.1e} m (f64), {:.1e} m (f32)", joints.len(), worst[0], worst[1]);
        assert!(worst.iter().all(|&e| e < 1e-5), "{worst:?}");
    }
}

/// The published arrays lost the clip's last frame: `T` frames gave `T - 1` rows, and the joints were recovered from the rows. The last
/// row's velocities say where every joint went, so the lost frame can be put back.
fn with_lost_frame(features: &[f64], joints: &[Pose]) -> Vec<Pose> {
    let rows = features.len() / FEATURES;
    let half_angle: f64 = (0..rows - 1).map(|t| features[t * FEATURES]).sum();
    let (sin, cos) = (-2.0 * half_angle).sin_cos();
    let last = &features[(rows - 1) * FEATURES..];
    let lost: Pose = std::array::from_fn(|j| {
        let v = &last[features::VELOCITIES][j * 3..j * 3 + 3];
        let step = [cos * v[0] + sin * v[2], v[1], cos * v[2] - sin * v[0]];
        std::array::from_fn(|x| (f64::from(joints[rows - 1][j][x]) + step[x]) as f32)
    });
    joints.iter().copied().chain([lost]).collect()
}

#[test]
fn extraction_from_published_joints_gives_the_published_features() {
    for name in CLIPS {
        let Some((golden, joints)) = golden(name) else { return };
        for (lost_frame, bones) in [(true, Bones::Keep), (true, Bones::Uniform), (false, Bones::Keep)] {
            let motion = if lost_frame { with_lost_frame(&golden, &joints) } else { joints.clone() };
            let options = Options { bones, ..Options::default() };
            let ours = features::extract(&motion, &options).unwrap();
            println!("{name} lost frame {lost_frame} bones {bones:?}");
            for (what, range) in [
                ("yaw", 0..1),
                ("planar", 1..3),
                ("height", 3..4),
                ("positions", features::POSITIONS),
                ("rotations", features::ROTATIONS),
                ("velocities", features::VELOCITIES),
                ("contacts", features::CONTACTS),
            ] {
                let mut worst = (0.0f64, 0, 0);
                let mut sum = 0.0;
                for t in 0..ours.len() / FEATURES {
                    for c in range.clone() {
                        let e = (f64::from(ours[t * FEATURES + c]) - golden[t * FEATURES + c]).abs();
                        sum += e;
                        if e > worst.0 {
                            worst = (e, t, c);
                        }
                    }
                }
                println!(
                    "  {what:10} worst {:.2e} at frame {} channel {}, mean {:.2e}",
                    worst.0,
                    worst.1,
                    worst.2,
                    sum / (ours.len() / FEATURES * range.len()) as f64
                );
            }
        }
    }
}
#[test]
fn lengths() {
    println!("{:?}", uniform::BONE_LENGTHS);
}
