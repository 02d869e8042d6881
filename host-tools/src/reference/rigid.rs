//! A body of rigid bones in f64: what the runtime's `representation::rigid` makes of decoded joints.
//!
//! Pelvis with hips and spine, and chest with collar bones and neck, are frames of three axes here; every other bone keeps its direction,
//! limbs are then bent towards where their ends were.

use nalgebra::{Matrix3, Vector3};

use super::motion_space::limbs::reach;
use super::recover::JOINTS;

/// A joint's place or a bone, metres.
type Vector = Vector3<f64>;

/// Of a limb's change of length so much is left, as an eased amount, metres.
const EASE: f64 = 0.03;

/// A skeleton at rest.
#[derive(Debug, Clone)]
pub struct Body {
    offsets: [Vector; JOINTS],
    scale: f64,
}

impl Body {
    /// Of these offsets from joint to joint, metres.
    #[must_use]
    pub fn new(offsets: &[[f64; 3]; JOINTS]) -> Self {
        Self { offsets: offsets.map(Vector::from), scale: 1.0 }
    }

    /// The same for motions generated for `other`.
    #[must_use]
    pub fn in_place_of(self, other: &Body) -> Self {
        let legs = |body: &Body| [4, 5, 7, 8].iter().map(|joint| body.offsets[*joint].norm()).sum::<f64>();
        Self { scale: legs(&self) / legs(other), ..self }
    }

    /// The poses with this body's bones.
    #[must_use]
    pub fn posed(&self, motion: &[[[f64; 3]; JOINTS]]) -> Vec<[[f64; 3]; JOINTS]> {
        motion.iter().map(|pose| self.pose(&pose.map(|at| Vector::from(at) * self.scale)).map(Into::into)).collect()
    }

    fn pose(&self, was: &[Vector; JOINTS]) -> [Vector; JOINTS] {
        let bone = |parent: usize, joint: usize| {
            let way = was[joint] - was[parent];
            let rest = self.offsets[joint];
            let direction = if way.norm() > 1e-6 { way.normalize() } else { rest.normalize() };
            direction * rest.norm()
        };
        let mut out = *was;
        for (base, triad) in [(0, [1, 2, 3]), (9, [13, 14, 12])] {
            if base == 9 {
                out[6] = out[3] + bone(3, 6);
                out[9] = out[6] + bone(6, 9);
            }
            let [left, right, up] = triad;
            let rest = frame(self.offsets[left] - self.offsets[right], self.offsets[up], Vector::x());
            let now = frame(was[left] - was[right], was[up] - was[base], rest.column(0).into());
            let turn = now * rest.transpose();
            for joint in triad {
                out[joint] = out[base] + turn * self.offsets[joint];
            }
        }
        out[15] = out[12] + bone(12, 15);
        for side in [0, 1] {
            let (collar, shoulder) = (13 + side, 16 + side);
            out[shoulder] = out[collar] + bone(collar, shoulder);
            for [root, middle, end] in [[1 + side, 4 + side, 7 + side], [shoulder, 18 + side, 20 + side]] {
                let straight = out[root] + bone(root, middle);
                let limb = [out[root], straight, straight + bone(middle, end)];
                let (had, way) = ((limb[2] - limb[0]).norm(), was[end] - limb[0]);
                let change = way.norm() - had;
                let made_up = change.signum() * (change.hypot(EASE) - EASE);
                let target = limb[0] + way.normalize() * (had + made_up);
                (out[middle], out[end]) = reach(limb, target, Vector::zeros());
            }
            out[10 + side] = out[7 + side] + bone(7 + side, 10 + side);
        }
        out
    }
}

/// Axes of which the first points along `across` and the second as near to `up` as it can.
fn frame(across: Vector, up: Vector, otherwise: Vector) -> Matrix3<f64> {
    let x = if across.norm() > 1e-6 { across.normalize() } else { otherwise };
    let y = (up - x * x.dot(&up)).normalize();
    Matrix3::from_columns(&[x, y, x.cross(&y)])
}
