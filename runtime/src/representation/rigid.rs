//! A body of rigid bones: the pose of a skeleton that is nearest to a generated one.
//!
//! A decoder's joints are 22 points; their distances change by some millimetres from frame to frame, now and then by far more. A body has
//! bones: pelvis and chest turn as wholes, with hips and collar bones where the skeleton has them, every other bone points where the
//! generated one does, and limbs are bent so that wrists and ankles are near where they were generated.

use super::Pose;
use super::limbs::{Limb, along};
use crate::JOINTS;
use crate::numerics::rotation::Rotation;
use crate::numerics::vector::{Vector, add, cross, dot, length, scale, subtract, unit};

/// The skeleton's offsets from joint to joint at rest, metres.
#[derive(Debug, Clone, Copy)]
pub struct Body {
    offsets: [Vector; JOINTS],
}

/// Three bones that turn together: their ends, left, right and up.
type Triad = [usize; 3];
/// Hips and spine.
const PELVIS: Triad = [1, 2, 3];
/// Collar bones and neck.
const CHEST: Triad = [13, 14, 12];
/// Bones that follow one another, from the pelvis up to the chest, and from the neck on.
const SPINE: [(usize, usize); 2] = [(3, 6), (6, 9)];

impl Body {
    /// Of a skeleton's offsets, one a joint; the first is not looked at, those that are missing are zero.
    pub fn new(offsets: impl Iterator<Item = Vector>) -> Self {
        let mut body = Body { offsets: [[0.0; 3]; JOINTS] };
        for (slot, offset) in body.offsets.iter_mut().zip(offsets) {
            *slot = offset;
        }
        body
    }

    fn offset(&self, joint: usize) -> Vector {
        self.offsets.get(joint).copied().unwrap_or_default()
    }

    /// The bone to a joint as long as it is, in the direction of `way`.
    fn bone(&self, joint: usize, way: Vector) -> Vector {
        along(way, self.offset(joint))
    }

    /// The pose with this body's bones; its pelvis is where it was.
    #[must_use]
    pub fn posed(&self, pose: &Pose) -> Pose {
        let was = |joint: usize| pose.get(joint).copied().unwrap_or_default();
        let way = |from: usize, to: usize| subtract(was(to), was(from));
        let mut out = *pose;
        let mut set = |joint: usize, place: Vector| {
            if let Some(slot) = out.get_mut(joint) {
                *slot = place;
            }
            place
        };
        let pelvis = was(0);
        let turn = self.turn(PELVIS, was);
        let [left_hip, right_hip, spine] = PELVIS.map(|joint| set(joint, add(pelvis, turn.apply(self.offset(joint)))));
        let mut chest = spine;
        for (from, to) in SPINE {
            chest = set(to, add(chest, self.bone(to, way(from, to))));
        }
        let turn = self.turn(CHEST, was);
        let [left_collar, right_collar, neck] =
            CHEST.map(|joint| set(joint, add(chest, turn.apply(self.offset(joint)))));
        set(15, add(neck, self.bone(15, way(12, 15))));
        let sides = [(left_hip, left_collar), (right_hip, right_collar)];
        for ((hip, collar), right) in sides.into_iter().zip([0, 1]) {
            let [knee, ankle, toe, at_collar, shoulder, elbow, wrist] =
                [4, 7, 10, 13, 16, 18, 20].map(|left| left + right);
            let shoulder_at = set(shoulder, add(collar, self.bone(shoulder, way(at_collar, shoulder))));
            for (root, [from, middle, end]) in
                [(hip, [1 + right, knee, ankle]), (shoulder_at, [shoulder, elbow, wrist])]
            {
                let bent = add(root, self.bone(middle, way(from, middle)));
                let limb = Limb { root, middle: bent, end: add(bent, self.bone(end, way(middle, end))) };
                let limb = limb.reaching(eased(&limb, was(end)), [0.0; 3]);
                set(middle, limb.middle);
                let end_at = set(end, limb.end);
                if end == ankle {
                    set(toe, add(end_at, self.bone(toe, way(ankle, toe))));
                }
            }
        }
        out
    }

    /// The turn of a triad from rest: its left and right lie on the line between them, its up as near as it can then be.
    fn turn(&self, [left, right, up]: Triad, was: impl Fn(usize) -> Vector) -> Rotation {
        let base = if up == 3 { 0 } else { 9 };
        let rest = unit(subtract(self.offset(left), self.offset(right)), [1.0, 0.0, 0.0]);
        let over = self.offset(up);
        let aside = unit(subtract(over, scale(rest, dot(rest, over))), cross(rest, [0.0, 0.0, 1.0]));
        let across = unit(subtract(was(left), was(right)), rest);
        Rotation::aligning((rest, aside), across, subtract(was(up), was(base)))
    }
}

/// A straight limb has to bend far to become a little shorter, so small differences are left: two fifths of one of this length are made up
/// for, and nearly all of larger ones, metres.
const EASE: f32 = 0.03;

/// Where the limb's end goes for `target`: in its direction, at a distance that differs from the limb's own less than the target's.
fn eased(limb: &Limb, target: Vector) -> Vector {
    let way = subtract(target, limb.root);
    let had = length(subtract(limb.end, limb.root));
    let change = length(way) - had;
    let made_up = libm::sqrtf(change * change + EASE * EASE) - EASE;
    let reach = if change < 0.0 { had - made_up } else { had + made_up };
    add(limb.root, scale(unit(way, [0.0, -1.0, 0.0]), reach))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::representation::skeleton::PARENTS;

    /// A body with hips that slope and shoulders that are wide.
    fn body() -> Body {
        let mut offsets = [[0.0; 3]; JOINTS];
        for (joint, offset) in [
            (1, [0.09, -0.05, 0.0]),
            (3, [0.0, 0.11, -0.01]),
            (4, [0.0, -0.4, 0.0]),
            (6, [0.0, 0.13, 0.0]),
            (7, [0.0, -0.41, 0.0]),
            (9, [0.0, 0.06, 0.0]),
            (10, [0.0, -0.05, 0.13]),
            (12, [0.0, 0.21, 0.0]),
            (13, [0.07, 0.11, 0.0]),
            (15, [0.0, 0.08, 0.04]),
            (16, [0.12, 0.03, 0.0]),
            (18, [0.26, 0.0, 0.0]),
            (20, [0.25, 0.0, 0.0]),
        ] {
            let [x, y, z] = offset;
            offsets[joint] = offset;
            if [1, 4, 7, 10, 13, 16, 18, 20].contains(&joint) {
                offsets[joint + 1] = [-x, y, z];
            }
        }
        Body::new(offsets.into_iter())
    }

    /// A pose of that body: every joint turned by its own rotation.
    fn pose(body: &Body, seed: u32) -> Pose {
        let mut stream = crate::numerics::hash::Stream::new(u64::from(seed));
        let mut next = move || stream.below(2001) as f32 / 1000.0 - 1.0;
        let mut turns = [Rotation::IDENTITY; JOINTS];
        let mut pose: Pose = [[0.0; 3]; JOINTS];
        pose[0] = [next(), 0.9, next()];
        for joint in 1..JOINTS {
            let parent = usize::from(PARENTS[joint]);
            pose[joint] = add(pose[parent], turns[parent].apply(body.offsets[joint]));
            turns[joint] = turns[parent] * Rotation::new(unit([next(), next(), next()], [0.0, 1.0, 0.0]), 0.7 * next());
            if joint == 1 || joint == 2 {
                turns[joint] = turns[0] * Rotation::new([1.0, 0.0, 0.0], 0.5 * next());
            }
        }
        let whole = Rotation::new(unit([0.2 * next(), 1.0, 0.2 * next()], [0.0, 1.0, 0.0]), 3.0 * next());
        let pelvis = pose[0];
        pose.map(|at| add(pelvis, whole.apply(subtract(at, pelvis))))
    }

    #[test]
    fn a_rigid_body_stays_as_it_is() {
        let body = body();
        for seed in 0..50 {
            let pose = pose(&body, seed);
            for (joint, (a, b)) in body.posed(&pose).iter().zip(&pose).enumerate() {
                assert!(length(subtract(*a, *b)) < 2e-3, "seed {seed}, joint {joint}: {a:?} {b:?}");
            }
        }
    }

    /// Points that are anywhere: bones have their lengths, triads their shape, hands and feet are near where they were.
    #[test]
    fn whatever_is_generated_becomes_a_body() {
        let body = body();
        let mut near = 0;
        for seed in 0..200 {
            let mut stream = crate::numerics::hash::Stream::new(seed);
            let mut next = move || stream.below(2001) as f32 / 1000.0 - 1.0;
            let size = if seed < 150 { 0.04 } else { 2.0 };
            let mut wild = pose(&body, seed as u32);
            for at in wild.iter_mut().skip(1) {
                *at = add(*at, [size * next(), size * next(), size * next()]);
            }
            let out = body.posed(&wild);
            for joint in 1..JOINTS {
                let bone = length(subtract(out[joint], out[usize::from(PARENTS[joint])]));
                let want = length(body.offsets[joint]);
                assert!((bone - want).abs() < 2e-4, "seed {seed}, joint {joint}: {bone} {want}");
            }
            for [left, right, up] in [PELVIS, CHEST] {
                let apart = |pose: &Pose, a: usize, b: usize| length(subtract(pose[a], pose[b]));
                let rest = |a: usize, b: usize| length(subtract(body.offsets[a], body.offsets[b]));
                for (a, b) in [(left, right), (left, up), (right, up)] {
                    assert!((apart(&out, a, b) - rest(a, b)).abs() < 2e-4, "seed {seed}: {a} {b}");
                }
            }
            assert_eq!(out[0], wild[0]);
            near += [7, 8, 20, 21].iter().filter(|end| length(subtract(out[**end], wild[**end])) < 0.06).count();
        }
        assert!(near > 500, "of 600 hands and feet {near} are where they were generated");
    }

    #[test]
    fn points_that_say_nothing_give_no_infinity() {
        let body = body();
        for wild in [[[0.0; 3]; JOINTS], [[1e-9, 2.0, 0.0]; JOINTS], [[1e6, -1e6, 1e6]; JOINTS]] {
            assert!(body.posed(&wild).as_flattened().iter().all(|v| v.is_finite()));
        }
    }
}
