//! The 22-joint SMPL skeleton as HumanML3D uses it.

use super::JOINTS;

pub use motionette::representation::skeleton::NAMES;

/// Index of the left hip.
pub const LEFT_HIP: usize = 1;
/// Index of the right hip.
pub const RIGHT_HIP: usize = 2;
/// Index of the left shoulder.
pub const LEFT_SHOULDER: usize = 16;
/// Index of the right shoulder.
pub const RIGHT_SHOULDER: usize = 17;
/// Joints whose contact with the ground is a feature, in the order of those channels: left ankle, left foot, right ankle, right foot.
pub const FEET: [usize; 4] = [7, 10, 8, 11];

/// Joints of the legs below the hips: knees, ankles, feet.
pub const LEGS: [usize; 6] = [4, 5, 7, 8, 10, 11];

/// Parent of every joint; the pelvis is its own. A parent comes before its children.
pub const PARENTS: [usize; JOINTS] = [0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19];

/// Kinematic chains of HumanML3D. The arm chains hang at spine3, but their accumulated rotation starts at the root's.
pub const CHAINS: [&[usize]; 5] =
    [&[0, 2, 5, 8, 11], &[0, 1, 4, 7, 10], &[0, 3, 6, 9, 12, 15], &[9, 14, 17, 19, 21], &[9, 13, 16, 18, 20]];

/// Unit direction of the bone that ends at each joint in HumanML3D's rest pose; zero for the pelvis.
pub const REST_DIRECTIONS: [[f64; 3]; JOINTS] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, 1.0],
    [0.0, 1.0, 0.0],
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, -1.0, 0.0],
];

/// The joint on the other side of the body; joints of the middle line are their own partner.
pub const MIRROR: [usize; JOINTS] = [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20];
