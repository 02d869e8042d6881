//! The anchor loss of controlled training (AnchorRoute, equations 7 to 10).
//!
//! `sum over frames t within delta of an anchor of |O(x)[t] - O(x_gt)[t]|^2`, the nearest anchor of the same joint says what is observed
//! there. The target is the real motion; only at inference are anchors all there is. Beyond [`KNEE`] the square goes on as a line: a
//! motion that is still all noise is metres away, and would outweigh the rest of its batch.

use motionette_host::motion::Pose;
use motionette_host::reference::Anchor;

/// Distance at which the square goes on as a line, metres.
pub const KNEE: f32 = 0.25;

/// What the loss says of one motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchorLoss {
    /// The sum, square metres.
    pub loss: f64,
    /// Frames that it looked at, counted once for every joint.
    pub frames: usize,
}

/// The loss of one motion. Adds `weight dL/dx` to `gradient`, which has the motion's frames.
pub fn anchor_loss(
    motion: &[Pose],
    real: &[Pose],
    anchors: &[Anchor],
    support: usize,
    weight: f32,
    gradient: &mut [Pose],
) -> AnchorLoss {
    let mut joints: Vec<usize> = anchors.iter().map(Anchor::joint).collect();
    joints.sort_unstable();
    joints.dedup();
    let (mut loss, mut frames) = (0.0, 0);
    for joint in joints {
        for t in 0..motion.len().min(real.len()) {
            let near = anchors.iter().filter(|anchor| anchor.joint() == joint && anchor.frame.abs_diff(t) <= support);
            let Some(anchor) = near.min_by_key(|anchor| anchor.frame.abs_diff(t)) else { continue };
            frames += 1;
            let residual: [f32; 3] = std::array::from_fn(|axis| {
                let observed = axis != 1 || anchor.fixes_height();
                if observed { motion[t][joint][axis] - real[t][joint][axis] } else { 0.0 }
            });
            let distance = residual.iter().map(|r| r * r).sum::<f32>().sqrt();
            let near = distance.min(KNEE);
            loss += f64::from(near * (2.0 * distance - near));
            let slope = if distance > KNEE { KNEE / distance } else { 1.0 };
            for (g, r) in gradient[t][joint].iter_mut().zip(residual) {
                *g += 2.0 * weight * slope * r;
            }
        }
    }
    AnchorLoss { loss, frames }
}

#[cfg(test)]
mod tests {
    use motionette_host::reference::Target;

    use super::*;

    #[test]
    fn looks_where_anchors_are_and_its_gradient_is_its_slope() {
        let real: Vec<Pose> = vec![[[0.0; 3]; 22]; 12];
        let motion: Vec<Pose> = (0..12).map(|t| std::array::from_fn(|j| [0.1 * t as f32, 0.2, j as f32])).collect();
        let anchors = [
            Anchor { frame: 1, target: Target::PlanarRoot([0.0, 0.0]) },
            Anchor { frame: 4, target: Target::Root([0.0; 3]) },
            Anchor { frame: 11, target: Target::Joint { joint: 2, position: [0.0; 3] } },
        ];
        let mut gradient = vec![[[0.0f32; 3]; 22]; 12];
        let AnchorLoss { loss, frames } = anchor_loss(&motion, &real, &anchors, 2, 1.0, &mut gradient);
        // Pelvis: frames 0 to 6, of which 0 to 2 belong to the first anchor; joint 2: frames 9 to 11.
        assert_eq!(frames, 7 + 3);
        let of = |square: f64| if square > 0.0625 { 0.5 * square.sqrt() - 0.0625 } else { square };
        let pelvis: f64 = (0..=6).map(|t| of((0.1 * f64::from(t)).powi(2) + if t > 2 { 0.04 } else { 0.0 })).sum();
        let joint: f64 = (9..=11).map(|t| of((0.1 * f64::from(t)).powi(2) + 0.04 + 4.0)).sum();
        assert!((loss - pelvis - joint).abs() < 1e-5, "{loss}");
        for (t, j, c) in [(0, 0, 0), (2, 0, 1), (3, 0, 1), (6, 0, 0), (7, 0, 0), (10, 2, 2), (8, 2, 2)] {
            let mut moved = motion.clone();
            moved[t][j][c] += 1e-3;
            let more = anchor_loss(&moved, &real, &anchors, 2, 1.0, &mut gradient.clone()).loss;
            moved[t][j][c] -= 2e-3;
            let less = anchor_loss(&moved, &real, &anchors, 2, 1.0, &mut gradient.clone()).loss;
            let slope = (more - less) / 2e-3;
            assert!((slope - f64::from(gradient[t][j][c])).abs() < 2e-3, "{t} {j} {c}: {slope}");
        }
    }
}
