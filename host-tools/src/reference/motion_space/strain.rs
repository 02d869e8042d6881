//! How far an edit takes a motion from what was generated.

use super::{JOINTS, Vector};

/// How far an edit takes a motion `[T]` from what was generated: the length of two numbers, how many times faster or slower the pelvis goes over
/// the floor on average (.15 m/s added to both; 2.7 times is 1, no change 0), and how far joints are from where they were as the pelvis
/// sees them, root of the mean square, in 15 cm.
#[must_use]
pub fn strain(generated: &[[[f64; 3]; JOINTS]], edited: &[[[f64; 3]; JOINTS]], frame_rate: f64) -> f64 {
    let at = |motion: &[[[f64; 3]; JOINTS]], t: usize, joint: usize| Vector::from(motion[t][joint]);
    let speed = |motion: &[[[f64; 3]; JOINTS]]| {
        let steps = (1..motion.len()).map(|t| (at(motion, t, 0) - at(motion, t - 1, 0)).xz().norm());
        0.15 + frame_rate * steps.sum::<f64>() / (motion.len() - 1) as f64
    };
    let seen = |motion: &[[[f64; 3]; JOINTS]], t: usize, joint: usize| at(motion, t, joint) - at(motion, t, 0);
    let apart = |t: usize| {
        (0..JOINTS).map(|joint| (seen(edited, t, joint) - seen(generated, t, joint)).norm_squared()).sum::<f64>()
    };
    let apart = (0..generated.len()).map(apart).sum::<f64>() / (generated.len() * JOINTS) as f64;
    let (was, is) = (speed(generated), speed(edited));
    (((was / is).max(is / was) - 1.0) / 1.7).hypot(apart.sqrt() / 0.15)
}
