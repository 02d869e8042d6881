//! A limb of two bones: where its middle joint goes when its end is put elsewhere.

use crate::kernels;
use crate::numerics::vector::{Vector, add, cross, dot, length, scale, subtract, unit};

/// A limb is never longer than this share of its two bones, so that it always bends to the side it came from; one that was longer may stay
/// as long as it was.
const STRETCHED: f32 = 0.9995;
/// Nor shorter than the difference of its bones by this, metres.
const FOLDED: f32 = 0.02;

/// Places of a limb's joints, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limb {
    /// Hip or shoulder.
    pub root: Vector,
    /// Knee or elbow.
    pub middle: Vector,
    /// Ankle or wrist.
    pub end: Vector,
}

impl Limb {
    /// The limb with its end at `target`, or as near as its bones reach, in the direction of it. Bones keep their lengths, the middle keeps the
    /// side to which it bends; a straight limb bends towards `pole`.
    #[must_use]
    #[inline(never)]
    pub fn reaching(&self, target: Vector, pole: Vector) -> Self {
        let Limb { root, middle, end } = *self;
        let (upper, lower) = (length(subtract(middle, root)), length(subtract(end, middle)));
        let before = subtract(end, root);
        let after = subtract(target, root);
        let (had, wanted) = (length(before), length(after));
        let farthest = STRETCHED * (upper + lower);
        let nearest = (upper - lower).abs() + FOLDED;
        let farthest = if had > farthest { had } else { farthest };
        let nearest = if had < nearest { had } else { nearest };
        let reach = if wanted > farthest { farthest } else { wanted };
        let reach = if reach < nearest { nearest } else { reach };
        let from = unit(before, [0.0, -1.0, 0.0]);
        let to = unit(after, from);
        // The share of the upper bone along the line from root to end, and across it.
        let along = if reach > 1e-6 { (upper * upper - lower * lower + reach * reach) / (2.0 * reach) } else { 0.0 };
        let across = upper * upper - along * along;
        let across = if across > 0.0 { kernels::sqrt(across) } else { 0.0 };
        let side = add(subtract(middle, root), pole);
        let side = subtract(side, scale(from, dot(side, from)));
        let side = carried(side, from, to);
        let side = unit(subtract(side, scale(to, dot(side, to))), perpendicular(to));
        let middle = add(root, add(scale(to, along), scale(side, across)));
        Limb { root, middle, end: add(root, scale(to, reach)) }
    }

    /// The limb with its middle at `target`, or as near as its upper bone reaches; its end comes as near to where it was as it can.
    #[must_use]
    #[inline(never)]
    pub fn bending(&self, target: Vector) -> Self {
        let Limb { root, middle, end } = *self;
        let upper = subtract(middle, root);
        let at = add(root, along(subtract(target, root), upper));
        Limb { root, middle: at, end: add(at, along(subtract(end, at), subtract(end, middle))) }
    }
}

/// A vector in the direction of `direction`, as long as `bone`; the bone itself where there is no direction.
#[inline(never)]
pub fn along(direction: Vector, bone: Vector) -> Vector {
    let length = length(bone);
    scale(unit(direction, unit(bone, [0.0, 1.0, 0.0])), length)
}

/// `side`, perpendicular to `from`, by the shortest turn from `from` to `to`, both of length 1.
fn carried(side: Vector, from: Vector, to: Vector) -> Vector {
    let cos = dot(from, to);
    let twice = dot(side, to) / (1.0 + cos + 1e-6);
    subtract(side, scale(add(from, to), twice))
}

/// A direction across `to`, of length 1.
pub fn perpendicular(to: Vector) -> Vector {
    let [x, ..] = to;
    let other = if x.abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
    unit(cross(to, other), [0.0, 0.0, 1.0])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: Vector, b: Vector, tolerance: f32) -> bool {
        length(subtract(a, b)) < tolerance
    }

    const LIMBS: [Limb; 3] = [
        Limb { root: [0.1, 0.9, 0.0], middle: [0.12, 0.5, 0.08], end: [0.1, 0.1, 0.0] },
        Limb { root: [0.0, 1.4, 0.0], middle: [0.3, 1.4, 0.0], end: [0.3, 1.4, 0.25] },
        // Straight: it does not say to which side it bends.
        Limb { root: [0.0, 1.0, 0.0], middle: [0.0, 0.6, 0.0], end: [0.0, 0.2, 0.0] },
    ];
    const POLE: Vector = [0.0, 0.0, 0.02];

    #[test]
    fn ends_arrive_bones_keep_their_lengths_and_nothing_moves_without_need() {
        for limb in LIMBS {
            let bones = |limb: &Limb| [subtract(limb.middle, limb.root), subtract(limb.end, limb.middle)].map(length);
            let [upper, lower] = bones(&limb);
            for (i, j, k) in (0..125).map(|n| (n % 5, n / 5 % 5, n / 25)) {
                let offset = [i, j, k].map(|step| (step as f32 - 2.0) * 0.17);
                let target = add(limb.root, add(scale(subtract(limb.end, limb.root), 0.6), offset));
                let wanted = length(subtract(target, limb.root));
                let moved = limb.reaching(target, POLE);
                let [a, b] = bones(&moved);
                assert!((a - upper).abs() < 1e-4 && (b - lower).abs() < 1e-4, "{limb:?} {target:?} {moved:?}");
                let within = wanted < STRETCHED * (upper + lower) && wanted > (upper - lower).abs() + FOLDED;
                assert_eq!(near(moved.end, target, 1e-4), within, "{limb:?} {target:?} {moved:?}");
                let bent = limb.bending(target);
                let [a, b] = bones(&bent);
                assert!((a - upper).abs() < 1e-4 && (b - lower).abs() < 1e-4, "{bent:?}");
            }
            assert!(near(limb.reaching(limb.end, [0.0; 3]).middle, limb.middle, 2e-3), "{limb:?}");
            assert!(near(limb.bending(limb.middle).end, limb.end, 1e-5));
        }
    }

    #[test]
    fn a_knee_bends_forward_and_elbows_stay_on_their_side() {
        let lifted = LIMBS[2].reaching([0.0, 0.5, 0.0], POLE);
        assert!(lifted.middle[2] > 0.2, "{lifted:?}");
        // A turn about the vertical axis by a right angle turns the bend with it.
        let arm = LIMBS[1].reaching([-0.25, 1.4, 0.3], [0.0; 3]);
        assert!(near(arm.middle, [0.0, 1.4, 0.3], 1e-3), "{arm:?}");
        for target in [LIMBS[1].root, [f32::MAX; 3], [0.0, 1.4, -0.4]] {
            let moved = LIMBS[1].reaching(target, POLE);
            assert!([moved.middle, moved.end].as_flattened().iter().all(|v| v.is_finite()), "{moved:?}");
        }
    }
}
