//! The one road from joints to features, and the changes of a motion that leave its meaning alone.

use motionette_host::motion::features::{Bones, Error, Options, Processed, process};
use motionette_host::motion::{Pose, narrowed, skeleton, uniform, widened};
use motionette_host::reference::rigid::Body;

use super::config::MAX_FRAMES;

/// Frames over which the jump at a seam of [`append`] fades.
const FADE: usize = 8;

/// Joints moved to the floor and the origin, and their features (EQUATIONS section 1), of the first [`MAX_FRAMES`] frames; one row
/// fewer than frames. Everybody has the rigid bones of [`uniform::body`]: a judge that sees who was recorded with a Kinect by bones that change
/// their length, or by whose they are, tells actions by that.
///
/// # Errors
/// [`Error`] when the motion has no features.
pub fn prepare(joints: &[Pose]) -> Result<Processed, Error> {
    let options = Options { bones: Bones::Keep, ..Options::default() };
    process(&rigid(&joints[..joints.len().min(MAX_FRAMES)]), &options)
}

/// The motion with the bones of [`uniform::body`].
fn rigid(joints: &[Pose]) -> Vec<Pose> {
    narrowed(&Body::new(&uniform::body()).posed(&widened(joints)))
}

/// The motion `factor` times as fast, positions interpolated linearly. The last frame is not passed.
pub fn at_tempo(joints: &[Pose], factor: f64) -> Vec<Pose> {
    let last = joints.len().saturating_sub(1);
    let frames = (last as f64 / factor).floor() as usize + 1;
    let frame = |index: usize| {
        let at = (index as f64 * factor).min(last as f64);
        let before = (at.floor() as usize).min(last);
        let share = (at - before as f64) as f32;
        let (a, b) = (&joints[before], &joints[(before + 1).min(last)]);
        std::array::from_fn(|j| std::array::from_fn(|c| a[j][c] + share * (b[j][c] - a[j][c])))
    };
    if joints.is_empty() { Vec::new() } else { (0..frames).map(frame).collect() }
}

/// Goes on with `next` where `motion` ends: turned to the same heading, moved to the same place on the floor; the rest of the jump fades
/// over 0.4 s. The first frame of `next` is the last of `motion`.
pub fn append(motion: &mut Vec<Pose>, next: &[Pose]) {
    let (Some(&end), Some(begin)) = (motion.last(), next.first()) else { return motion.extend_from_slice(next) };
    let turn = heading(&end) - heading(begin);
    let (sin, cos) = turn.sin_cos();
    let place = |p: [f32; 3]| -> [f32; 3] {
        let (x, z) = (p[0] - begin[0][0], p[2] - begin[0][2]);
        [cos * x + sin * z + end[0][0], p[1], cos * z - sin * x + end[0][2]]
    };
    let jump: Pose = std::array::from_fn(|j| {
        let p = place(begin[j]);
        std::array::from_fn(|c| end[j][c] - p[c])
    });
    for (index, pose) in next.iter().enumerate().skip(1) {
        let progress = (index as f32 / FADE as f32).min(1.0);
        let left = 1.0 - progress * progress * (3.0 - 2.0 * progress);
        motion.push(std::array::from_fn(|j: usize| {
            let p = place(pose[j]);
            std::array::from_fn(|c| p[c] + left * jump[j][c])
        }));
    }
}

/// `first` and what `next` gives, one after another, cut to `frames`. An empty motion stays empty.
pub fn grown<'a>(first: &[Pose], frames: usize, mut next: impl FnMut() -> &'a [Pose]) -> Vec<Pose> {
    let mut joints = first.to_vec();
    while !joints.is_empty() && joints.len() < frames {
        append(&mut joints, next());
    }
    joints.truncate(frames);
    joints
}

/// Angle about y from +z to the direction in which hips and shoulders face.
fn heading(pose: &Pose) -> f32 {
    let across = |c: usize| {
        pose[skeleton::LEFT_HIP][c] - pose[skeleton::RIGHT_HIP][c] + pose[skeleton::LEFT_SHOULDER][c]
            - pose[skeleton::RIGHT_SHOULDER][c]
    };
    // The left side of a body that faces +z is at +x.
    (-across(2)).atan2(across(0))
}

#[cfg(test)]
mod tests {
    use motionette_host::dataset::Dataset;

    use super::*;
    use crate::testing;

    fn example() -> (Dataset, usize) {
        (testing::dataset(2, 60), 1)
    }

    #[test]
    fn tempo_changes_the_length_and_nothing_else() {
        let (dataset, index) = example();
        let joints = dataset.clip(index).joints;
        assert_eq!(at_tempo(joints, 1.0), joints);
        let slow = at_tempo(joints, 0.5);
        assert_eq!(slow.len(), 2 * joints.len() - 1);
        assert_eq!(slow[10], joints[5]);
        assert_eq!(at_tempo(joints, 2.0)[7], joints[14]);
        assert!(at_tempo(&[], 1.1).is_empty());
    }

    /// Turned and moved copies of one motion give the same joined motion, and within the second part features are its own.
    #[test]
    fn appended_motion_goes_on_where_the_first_ends() {
        let (dataset, index) = example();
        let first = dataset.clip(0).joints.to_vec();
        let second = dataset.clip(index).joints;
        let (sin, cos) = 1.3f32.sin_cos();
        let moved: Vec<Pose> = second
            .iter()
            .map(|pose| pose.map(|[x, y, z]| [cos * x + sin * z + 3.0, y, cos * z - sin * x - 2.0]))
            .collect();
        let (mut a, mut b) = (first.clone(), first.clone());
        append(&mut a, second);
        append(&mut b, &moved);
        assert_eq!(a.len(), first.len() + second.len() - 1);
        for (p, q) in a.as_flattened().as_flattened().iter().zip(b.as_flattened().as_flattened()) {
            assert!((p - q).abs() < 1e-4, "{p} {q}");
        }
        let seam = first.len();
        let step = |t: usize| {
            let [p, q] = [a[t - 1][0], a[t][0]];
            (p[0] - q[0]).hypot(p[2] - q[2])
        };
        assert!(step(seam) < 0.15, "the pelvis jumps by {} m", step(seam));
        assert!((heading(&a[seam]) - heading(&a[seam - 1])).abs() < 0.2);
        // Once the jump has faded bones have their lengths again.
        let bone = |pose: &Pose| (0..3).map(|c| (pose[4][c] - pose[1][c]).powi(2)).sum::<f32>().sqrt();
        assert!((bone(&a[seam + FADE]) - bone(&second[FADE + 1])).abs() < 1e-4);
    }

    #[test]
    fn grown_motion_has_the_length_asked_for() {
        let (dataset, index) = example();
        let (first, other) = (dataset.clip(0).joints, dataset.clip(index).joints);
        let long = grown(first, 150, || other);
        assert_eq!((long.len(), &long[..first.len()]), (150, first));
        assert_eq!(grown(first, 10, || other), first[..10]);
        assert!(grown(&[], 10, || other).is_empty());
    }

    #[test]
    fn prepared_motion_does_not_depend_on_where_it_was() {
        let (dataset, index) = example();
        // With the bones that it is to have: to which side a straight limb that is too long bends, the world says.
        let joints = &rigid(dataset.clip(index).joints);
        let moved: Vec<Pose> = joints.iter().map(|pose| pose.map(|[x, y, z]| [z + 1.0, y + 0.5, 2.0 - x])).collect();
        let (a, b) = (prepare(joints).unwrap(), prepare(&moved).unwrap());
        assert_eq!(a.joints.len(), joints.len() - 1);
        for (p, q) in a.features.iter().zip(&b.features) {
            assert!((p - q).abs() < 1e-3, "{p} {q}");
        }
    }
}
