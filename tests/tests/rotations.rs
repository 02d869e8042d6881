//! A motion's own joint rotations against the f32 reference: all 263 features decoded by plain loops, rotations accumulated as
//! quaternions.

use std::path::Path;

use motionette::representation::Pose;
use motionette::{Generator, Request};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint;
use motionette_host::motion::features::ROTATIONS;
use motionette_host::motion::quaternion as q;
use motionette_host::motion::skeleton::{CHAINS, REST_DIRECTIONS};
use motionette_host::reference::Decoder;
use motionette_sim::sample_clips::SampleClips;

/// Bone directions of each frame that the reference's rotations say, by the joint at their end.
fn directions(features: &[f64], yaw: &mut f64) -> [[f64; 3]; 22] {
    // The root's rotation turns the heading to +z.
    let root = q::about([0.0, 1.0, 0.0], 2.0 * *yaw);
    *yaw += features[0];
    let mut directions = [[0.0; 3]; 22];
    for chain in CHAINS {
        let mut turned = root;
        for &joint in &chain[1..] {
            let six = &features[ROTATIONS.start + 6 * (joint - 1)..][..6];
            turned = q::multiply(turned, q::from_6d(six.try_into().unwrap()).unwrap());
            directions[joint] = q::rotate(turned, REST_DIRECTIONS[joint]);
        }
    }
    directions
}

#[test]
fn rotations_are_those_of_the_reference() {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    let blob = BlobFile::open(&models.join("nano.blob")).unwrap();
    let model = blob.model().unwrap();
    let tokens = SampleClips::built_in().unwrap().clips.remove(0).tokens;
    let mut arena = vec![0u128; 40_000];
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut arena)).unwrap();
    let motion = generator.generate(&Request::tokens(&tokens), &mut ()).unwrap();
    assert!(motion.rotated(motion.frames().len()).is_none());

    let checkpoint = checkpoint::load(&models.join("nano.safetensors")).unwrap();
    let statistics = checkpoint.statistics.as_ref().unwrap();
    let width = checkpoint.config.features;
    let latent: Vec<f64> = motion.u().iter().map(|u| f64::from(*u)).collect();
    let mut features = Decoder::<f64>::new(&checkpoint.decoder, width).forward(&latent).features;
    for row in features.chunks_exact_mut(width) {
        for ((x, mean), std) in row.iter_mut().zip(&statistics.mean).zip(&statistics.std) {
            *x = *x * std + mean;
        }
    }
    let (mut sum, mut worst, mut count, mut yaw) = (0.0, 0.0f64, 0, 0.0);
    for (frame, row) in features.chunks_exact(width).enumerate() {
        let expected = directions(row, &mut yaw);
        let found: Pose = motion.rotated(frame).unwrap();
        for (joint, &parent) in motionette::representation::skeleton::PARENTS.iter().enumerate().skip(1) {
            let bone = |pose: &Pose| q::subtract(pose[joint].map(f64::from), pose[usize::from(parent)].map(f64::from));
            let (given, found) = (bone(&motion.frames()[frame]), bone(&found));
            assert!((q::length(given) - q::length(found)).abs() < 1e-4, "bones keep their lengths");
            let angle = q::dot(q::direction(found).unwrap(), expected[joint]).clamp(-1.0, 1.0).acos().to_degrees();
            (sum, worst, count) = (sum + angle, worst.max(angle), count + 1);
        }
    }
    let mean = sum / f64::from(count);
    eprintln!("bones: {mean:.3} degrees off on average, {worst:.2} at most");
    eprintln!("rotations against positions: {:.4} m", motion.rotation_error(1).unwrap());
    assert!(mean < 0.3 && worst < 3.0, "{mean} {worst}");
    assert!(motion.rotation_error(1).unwrap() > 0.0);
}
