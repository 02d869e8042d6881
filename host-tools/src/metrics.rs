//! What a motion is worth: figures over joint positions (DESIGN section 6, EQUATIONS section 9).
//!
//! All lengths are metres, all motions have 20 frames a second unless a rate is given. [`crate::agreement`] collects the same
//! root-aligned distance and root drift over many clips, in millimetres.

use motionette::{Anchor, Target};

use crate::motion::{JOINTS, Pose};

/// Joints that count as feet for [`foot_skating`]: left and right foot (the ball), not the ankles, which are higher than 5 cm even
/// when the foot stands.
pub const FEET: [usize; 2] = [10, 11];
/// A foot nearer to the ground than this stands on it, metres (EQUATIONS section 9).
pub const NEAR_GROUND: f64 = 0.05;
/// A standing foot that moves farther than this in a frame slides, metres a frame, horizontally (EQUATIONS section 9).
pub const SLIDE: f64 = 0.025;

/// Frames on either side of an anchor that count as its surroundings.
const AROUND: usize = 3;

/// Mean magnitude of the jerk over all joints and frames, m/s^3: the third difference of the positions times `fps^3`.
///
/// `fps` is in 1/s. 0 for fewer than four frames, which have no third difference. The smoothness DESIGN reports beside foot skating.
pub fn jerk(motion: &[Pose], fps: f64) -> f64 {
    let third = |w: &[Pose], j: usize, c: usize| {
        let x = |t: usize| f64::from(w[t][j][c]);
        x(3) - 3.0 * x(2) + 3.0 * x(1) - x(0)
    };
    let magnitudes =
        motion.windows(4).flat_map(|w| (0..JOINTS).map(move |j| length([0, 1, 2].map(|c| third(w, j, c)))));
    mean(magnitudes) * fps.powi(3)
}

/// The same over third differences that lie within three frames of one of `frames`; 0 where there are none.
pub fn jerk_around(motion: &[Pose], fps: f64, frames: &[usize]) -> f64 {
    let near = |first: &usize| frames.iter().any(|frame| first + 3 <= frame + AROUND && *frame <= first + AROUND);
    let windows = (0..motion.len().saturating_sub(3)).filter(near);
    mean(windows.map(|first| jerk(&motion[first..first + 4], fps)))
}

/// Speed of the fastest joint, m/s; 0 for fewer than two frames. `fps` in 1/s.
pub fn top_speed(motion: &[Pose], fps: f64) -> f64 {
    let steps = motion.windows(2).flat_map(|w| (0..JOINTS).map(move |j| distance(w[0][j], w[1][j])));
    fps * steps.fold(0.0, f64::max)
}

/// Share of frames in which a foot skates, 0 to 1 (EQUATIONS section 9).
///
/// A foot ([`FEET`]) skates in a frame when it is less than [`NEAR_GROUND`] above `floor` (metres; 0 for a processed motion) in this
/// frame and the next and moves farther than [`SLIDE`] horizontally between the two. The last frame has no next one and is not
/// counted; 0 for fewer than two frames.
pub fn foot_skating(motion: &[Pose], floor: f64) -> f64 {
    let skates = |w: &[Pose], foot: usize| {
        let [a, b] = [w[0][foot], w[1][foot]].map(|p| p.map(f64::from));
        let near = |p: [f64; 3]| p[1] - floor < NEAR_GROUND;
        near(a) && near(b) && length([b[0] - a[0], 0.0, b[2] - a[2]]) > SLIDE
    };
    mean(motion.windows(2).map(|w| f64::from(u8::from(FEET.iter().any(|&foot| skates(w, foot))))))
}

/// Mean horizontal speed of the feet ([`FEET`]) while they are near the ground, m/s: over steps that begin and end less than
/// [`NEAR_GROUND`] above 0, `fps` in 1/s. 0 where no foot comes there.
pub fn foot_speed(motion: &[Pose], fps: f64) -> f64 {
    let low = |(a, b): &([f64; 3], [f64; 3])| a[1] < NEAR_GROUND && b[1] < NEAR_GROUND;
    let steps = FEET
        .iter()
        .flat_map(|&foot| motion.windows(2).map(move |w| (w[0][foot].map(f64::from), w[1][foot].map(f64::from))));
    fps * mean(steps.filter(low).map(|(a, b)| length([b[0] - a[0], 0.0, b[2] - a[2]])))
}

/// How far the bone that is farthest from its length is from it, over all frames, metres. `skeleton`: offset of each joint from its parent.
pub fn bone_error(motion: &[Pose], skeleton: [[f32; 3]; JOINTS]) -> f64 {
    let lengths = skeleton.map(|offset| length(offset.map(f64::from)));
    let off = |pose: &Pose, joint: usize, wanted: f64| {
        let parent = crate::motion::skeleton::PARENTS[joint];
        (distance(pose[joint], pose[parent]) - wanted).abs()
    };
    let bones = || lengths.iter().copied().enumerate().skip(1);
    motion.iter().flat_map(|pose| bones().map(|(joint, wanted)| off(pose, joint, wanted))).fold(0.0, f64::max)
}

/// Mean distance of corresponding joints, metres, positions as they are (global MPJPE).
///
/// Over the frames of the shorter motion; 0 when that has none.
pub fn mpjpe(a: &[Pose], b: &[Pose]) -> f64 {
    mean(a.iter().zip(b).flat_map(|(a, b)| (0..JOINTS).map(|j| distance(a[j], b[j]))))
}

/// Mean distance of corresponding joints once both pelvises are laid over one another in each frame, metres (root-aligned MPJPE).
///
/// The 21 joints other than the pelvis count; its own distance is zero by construction. Over the frames of the shorter motion; 0 when
/// that has none. The joint error of DESIGN section 6.
pub fn mpjpe_root_aligned(a: &[Pose], b: &[Pose]) -> f64 {
    mean(a.iter().zip(b).flat_map(|(a, b)| root_aligned_distances(a, b)))
}

/// Distances of the 21 joints other than the pelvis once both pelvises are laid over one another, metres.
pub fn root_aligned_distances(a: &Pose, b: &Pose) -> [f64; JOINTS - 1] {
    std::array::from_fn(|i| {
        let j = i + 1;
        length([0, 1, 2].map(|c| f64::from(a[j][c] - a[0][c]) - f64::from(b[j][c] - b[0][c])))
    })
}

/// Distance of the pelvises in the last frame that both motions have, metres; 0 when there is none.
pub fn root_drift_end(a: &[Pose], b: &[Pose]) -> f64 {
    a.iter().zip(b).next_back().map_or(0.0, |(a, b)| distance(a[0], b[0]))
}

/// How far a motion misses one anchor, metres (EQUATIONS section 9): Euclidean; for Planar-root on the ground plane.
///
/// `None` when the motion has no such frame or the skeleton no such joint.
pub fn anchor_error(motion: &[Pose], anchor: &Anchor) -> Option<f64> {
    let pose = motion.get(usize::from(anchor.frame))?;
    Some(match anchor.target {
        Target::Root(target) => distance(pose[0], target),
        Target::PlanarRoot([x, z]) => distance([pose[0][0], 0.0, pose[0][2]], [x, 0.0, z]),
        Target::Joint { joint, position } => distance(*pose.get(usize::from(joint))?, position),
    })
}

/// Control error: mean of [`anchor_error`] over the anchors, metres (EQUATIONS section 9).
///
/// `None` when there are no anchors or one of them lies outside the motion.
pub fn control_error(motion: &[Pose], anchors: &[Anchor]) -> Option<f64> {
    let errors = anchors.iter().map(|anchor| anchor_error(motion, anchor)).collect::<Option<Vec<f64>>>()?;
    (!errors.is_empty()).then(|| mean(errors.into_iter()))
}

/// Euclidean distance of two points, in their unit.
pub(crate) fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    length([0, 1, 2].map(|c| f64::from(a[c]) - f64::from(b[c])))
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

/// Arithmetic mean; 0 of nothing.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), x| (sum + x, count + 1));
    sum / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-6 * b.abs().max(1.0), "{a} {b}");
    }

    fn still(frames: usize) -> Vec<Pose> {
        vec![std::array::from_fn(|j| [0.125 * j as f32, 1.0, -0.25]); frames]
    }

    #[test]
    fn jerk_of_a_cubic_is_its_third_derivative() {
        // x = t^3 of one joint, t in frames: third difference 6 in each window; y = 2 t^3 of another: 12. 22 joints, 10 fps.
        let mut motion = still(7);
        for (t, pose) in motion.iter_mut().enumerate() {
            let cube = (t * t * t) as f32;
            pose[4][0] = cube;
            pose[9][1] = 2.0 * cube;
            // Quadratic: none.
            pose[5][2] = (t * t) as f32;
        }
        close(jerk(&motion, 10.0), (6.0 + 12.0) / 22.0 * 1000.0);
        close(jerk(&motion, 20.0), (6.0 + 12.0) / 22.0 * 8000.0);
        assert_eq!((jerk(&motion[..3], 20.0), jerk(&still(9), 20.0), jerk(&[], 20.0)), (0.0, 0.0, 0.0));
    }

    #[test]
    fn feet_skate_when_near_the_ground_and_fast() {
        // (height, x) of the left foot, frame by frame; the right foot stays high except where set.
        let left = [(0.0, 0.0), (0.0, 0.02), (0.0, 0.06), (0.04, 0.10), (0.06, 0.20), (0.0, 0.20), (0.0, 0.20)];
        let mut motion = still(7);
        for (pose, (y, x)) in motion.iter_mut().zip(left) {
            pose[10] = [x, y, 0.0];
        }
        // Steps 1->2 and 2->3 are 4 cm, 0->1 only 2 cm, 3->4 and 4->5 touch a frame above 5 cm, 5->6 stands.
        close(foot_skating(&motion, 0.0), 2.0 / 6.0);
        // The right foot slides diagonally, 3 cm in x and 4 cm in z, in the last step: one more frame.
        motion[5][11] = [0.0, 0.01, 0.0];
        motion[6][11] = [0.03, 0.01, 0.04];
        close(foot_skating(&motion, 0.0), 3.0 / 6.0);
        // Both feet in one frame count once.
        motion[1][11] = [0.0, 0.0, 0.0];
        motion[2][11] = [0.0, 0.0, 0.5];
        close(foot_skating(&motion, 0.0), 3.0 / 6.0);
        // A lower floor lifts them all; motion straight up is no slide.
        assert_eq!(foot_skating(&motion, -0.1), 0.0);
        let mut rising = still(2);
        rising[0][10] = [0.0, 0.0, 0.0];
        rising[1][10] = [0.0, 0.04, 0.0];
        assert_eq!((foot_skating(&rising, 0.0), foot_skating(&rising[..1], 0.0)), (0.0, 0.0));
    }

    #[test]
    fn surroundings_and_speed_by_hand() {
        // One joint jumps 25 cm in frame 10 and back: third differences around it, none elsewhere.
        let mut motion = still(30);
        motion[10][7][1] += 0.25;
        close(top_speed(&motion, 20.0), 5.0);
        let all = jerk(&motion, 10.0);
        // Windows that touch frame 10 begin at 7 to 10; those within three frames of it begin at 7 to 10, too.
        close(jerk_around(&motion, 10.0, &[10]), 2.0 / 22.0 * 1000.0 / 4.0);
        close(all, 2.0 / 22.0 * 1000.0 / 27.0);
        assert_eq!((jerk_around(&motion, 10.0, &[20]), jerk_around(&motion, 10.0, &[])), (0.0, 0.0));
    }

    #[test]
    fn feet_near_the_ground_have_a_speed() {
        // Heights and places of the left foot; the right one stays high.
        let left = [(0.0, 0.0), (0.0, 0.03), (0.06, 0.5), (0.04, 0.9), (0.04, 1.0)];
        let mut motion = still(5);
        for (pose, (y, x)) in motion.iter_mut().zip(left) {
            pose[10] = [x, y, 0.0];
        }
        close(foot_speed(&motion, 20.0), 20.0 * (0.03 + 0.1) / 2.0);
        assert_eq!((foot_speed(&still(4), 20.0), foot_speed(&[], 20.0)), (0.0, 0.0));
    }

    #[test]
    fn the_bone_that_is_farthest_from_its_length_counts() {
        let mut motion = still(3);
        let rest = motion[0];
        let parents = crate::motion::skeleton::PARENTS;
        let skeleton = std::array::from_fn(|j| std::array::from_fn(|axis| rest[j][axis] - rest[parents[j]][axis]));
        close(bone_error(&motion, skeleton), 0.0);
        // A wrist aside: its bone is along x.
        motion[1][20][0] += 0.25;
        motion[2][21][0] -= 0.125;
        close(bone_error(&motion, skeleton), 0.25);
    }

    #[test]
    fn a_shift_and_a_bent_arm_by_hand() {
        let a = still(4);
        let mut b = still(5);
        for pose in &mut b {
            pose.iter_mut().for_each(|p| (p[0], p[2]) = (p[0] + 0.5, p[2] - 0.25));
        }
        let shift = 0.3125f64.sqrt();
        close(mpjpe(&a, &b), shift);
        close(mpjpe_root_aligned(&a, &b), 0.0);
        close(root_drift_end(&a, &b), shift);
        // One joint off by 3-4-0 in one of four frames, on top of nothing else.
        let mut bent = still(4);
        bent[2][20] = [bent[2][20][0] + 3.0, bent[2][20][1] + 4.0, bent[2][20][2]];
        close(mpjpe(&a, &bent), 5.0 / (4.0 * 22.0));
        close(mpjpe_root_aligned(&a, &bent), 5.0 / (4.0 * 21.0));
        // A moved pelvis alone moves every other joint relative to it.
        let mut root = still(4);
        root[3][0][1] += 0.5;
        close(mpjpe(&a, &root), 0.5 / (4.0 * 22.0));
        close(mpjpe_root_aligned(&a, &root), 0.5 / 4.0);
        close(root_drift_end(&a, &root), 0.5);
        assert_eq!(root_drift_end(&a, &root[..3]), 0.0);
        assert_eq!((mpjpe(&a, &[]), mpjpe_root_aligned(&[], &a), root_drift_end(&[], &a)), (0.0, 0.0, 0.0));
    }

    #[test]
    fn control_error_by_hand() {
        let mut motion = still(3);
        motion[1][0] = [1.0, 0.5, 2.0];
        let root = Anchor::root(1, [1.0, 2.5, 2.0]);
        let planar = Anchor::planar_root(1, [4.0, 6.0]);
        let wrist = Anchor::joint(2, 8, [1.0, 1.0, 2.75]);
        close(anchor_error(&motion, &root).expect("inside"), 2.0);
        close(anchor_error(&motion, &planar).expect("inside"), 5.0);
        close(anchor_error(&motion, &wrist).expect("inside"), 3.0);
        close(control_error(&motion, &[root, planar, wrist]).expect("inside"), 10.0 / 3.0);
        assert_eq!(control_error(&motion, &[]), None);
        assert_eq!(control_error(&motion, &[root, Anchor::root(3, [0.0; 3])]), None);
        assert_eq!(anchor_error(&motion, &Anchor::joint(0, 22, [0.0; 3])), None);
    }
}
