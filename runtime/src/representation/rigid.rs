//! A body of rigid bones: the pose of a skeleton that is nearest to a generated one.
//!
//! A decoder's joints are 22 points; their distances change by some millimetres from frame to frame, now and then by far more. A body has
//! bones: pelvis and chest turn as wholes, with hips and collar bones where the skeleton has them, every other bone points where the
//! generated one does, and limbs are bent so that wrists and ankles are near where they were generated.
//!
//! A skeleton of another size is walked by as much longer or shorter ways as its legs are.

use super::Pose;
use super::limbs::{Limb, along, perpendicular};
use crate::JOINTS;
use crate::kernels;
use crate::numerics::vector::{Vector, add, cross, dot, length, scale, subtract, unit};

/// The skeleton's offsets from joint to joint at rest, metres.
#[derive(Debug, Clone, Copy)]
pub struct Body {
    offsets: [Vector; JOINTS],
    scale: f32,
}

/// Bones of a leg, by the joints at their ends.
const LEG: [usize; 2] = [4, 7];

/// Three bones that turn together: their ends, left, right and up.
type Triad = [usize; 3];
/// Hips and spine.
const PELVIS: Triad = [1, 2, 3];
/// Collar bones and neck.
const CHEST: Triad = [13, 14, 12];
/// Bones that follow one another, from the pelvis up to the chest, and from the neck on.
const SPINE: [(usize, usize); 2] = [(3, 6), (6, 9)];

impl Body {
    /// Of a skeleton's offsets, one a joint; the first is not looked at.
    pub const fn new(offsets: &[Vector; JOINTS]) -> Self {
        Body { offsets: *offsets, scale: 1.0 }
    }

    /// The same for motions that were generated for `other`: places become as much larger as this one's legs are longer.
    #[must_use]
    pub fn in_place_of(self, other: &Body) -> Self {
        let (own, generated) = (self.leg(), other.leg());
        Body { scale: if generated > 0.0 { own / generated } else { 1.0 }, ..self }
    }

    /// How much larger places are than those that were generated.
    #[must_use]
    pub const fn scale(&self) -> f32 {
        self.scale
    }

    /// Length of both legs, metres.
    #[inline(never)]
    fn leg(&self) -> f32 {
        let bone = |joint| length(self.offset(joint));
        LEG.iter().fold(0.0, |sum, &left| sum + bone(left) + bone(left + 1))
    }

    fn offset(&self, joint: usize) -> Vector {
        self.offsets.get(joint).copied().unwrap_or_default()
    }

    /// The pose with this body's bones; its pelvis is where it was, with [`Body::scale`].
    #[must_use]
    #[inline(never)]
    pub fn posed(&self, pose: &Pose) -> Pose {
        let mut was = *pose;
        for at in was.as_flattened_mut() {
            *at *= self.scale;
        }
        // Squares of places that only a broken blob gives are infinite.
        if was.as_flattened().iter().any(|v| !(v.abs() < FARTHEST)) {
            return was;
        }
        let mut posing = Posing { body: self, out: was, was };
        posing.triad(0, PELVIS);
        for (from, to) in SPINE {
            posing.bone(from, to);
        }
        posing.triad(9, CHEST);
        posing.bone(12, 15);
        posing.side(0);
        posing.side(1);
        posing.out
    }
}

/// A pose in the making, from the pelvis outwards.
struct Posing<'b> {
    body: &'b Body,
    /// Where joints were generated.
    was: Pose,
    /// Where they come.
    out: Pose,
}

/// A pose with a joint farther from the origin than this, metres, is left as it is.
const FARTHEST: f32 = 1e9;

impl Posing<'_> {
    fn was(&self, joint: usize) -> Vector {
        self.was.get(joint).copied().unwrap_or_default()
    }

    fn at(&self, joint: usize) -> Vector {
        self.out.get(joint).copied().unwrap_or_default()
    }

    fn set(&mut self, joint: usize, place: Vector) {
        if let Some(slot) = self.out.get_mut(joint) {
            *slot = place;
        }
    }

    /// The bone between two joints as it was generated.
    fn way(&self, from: usize, to: usize) -> Vector {
        subtract(self.was(to), self.was(from))
    }

    /// Puts a bone that begins at `start`, as long as it is, in the direction in which it was generated.
    #[inline(never)]
    fn behind(&self, start: Vector, from: usize, to: usize) -> Vector {
        add(start, along(self.way(from, to), self.body.offset(to)))
    }

    #[inline(never)]
    fn bone(&mut self, from: usize, to: usize) {
        self.set(to, self.behind(self.at(from), from, to));
    }

    /// Turns three bones together from rest: their left and right lie on the line between them, their up as near as it can then be.
    #[inline(never)]
    fn triad(&mut self, base: usize, triad: Triad) {
        let [left, right, up] = triad;
        let offset = |joint| self.body.offset(joint);
        let rest = axes(subtract(offset(left), offset(right)), offset(up));
        let now = axes(self.way(right, left), self.way(base, up));
        for joint in triad {
            self.set(joint, add(self.at(base), turned(&rest, &now, self.body.offset(joint))));
        }
    }

    /// Arm and leg, of the left side with 0, of the right with 1.
    #[inline(never)]
    fn side(&mut self, right: usize) {
        self.bone(13 + right, 16 + right);
        self.limb([1 + right, 4 + right, 7 + right]);
        self.limb([16 + right, 18 + right, 20 + right]);
        self.bone(7 + right, 10 + right);
    }

    /// Bends a limb until its end is near to where it was generated.
    #[inline(never)]
    fn limb(&mut self, [root, middle, end]: [usize; 3]) {
        let start = self.at(root);
        let bent = self.behind(start, root, middle);
        let limb = Limb { root: start, middle: bent, end: self.behind(bent, middle, end) };
        let limb = limb.reaching(eased(&limb, self.was(end)), [0.0; 3]);
        self.set(middle, limb.middle);
        self.set(end, limb.end);
    }
}

/// Three perpendicular directions: the first along `across`, the second as near to `up` as it can then be.
#[inline(never)]
pub fn axes(across: Vector, up: Vector) -> [Vector; 3] {
    let x = unit(across, [1.0, 0.0, 0.0]);
    let y = unit(subtract(up, scale(x, dot(x, up))), perpendicular(x));
    [x, y, cross(x, y)]
}

/// `bone` by the turn from the axes of rest to those of now.
#[inline(never)]
pub fn turned(rest: &[Vector; 3], now: &[Vector; 3], bone: Vector) -> Vector {
    rest.iter().zip(now).fold([0.0; 3], |sum, (from, to)| add(sum, scale(*to, dot(*from, bone))))
}

/// A straight limb has to bend far to become a little shorter, so small differences are left: two fifths of one of this length are made up
/// for, and nearly all of larger ones, metres.
const EASE: f32 = 0.03;

/// Where the limb's end goes for `target`: in its direction, at a distance that differs from the limb's own less than the target's.
fn eased(limb: &Limb, target: Vector) -> Vector {
    let way = subtract(target, limb.root);
    let had = length(subtract(limb.end, limb.root));
    let change = length(way) - had;
    let made_up = kernels::sqrt(change * change + EASE * EASE) - EASE;
    let reach = if change < 0.0 { had - made_up } else { had + made_up };
    add(limb.root, scale(unit(way, [0.0, -1.0, 0.0]), reach))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::numerics::rotation::Rotation;
    use crate::representation::skeleton::PARENTS;

    /// A body with hips that slope and shoulders that are wide.
    pub fn body() -> Body {
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
        Body::new(&offsets)
    }

    /// A pose of that body: every joint turned by its own rotation.
    pub fn pose(body: &Body, seed: u32) -> Pose {
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

    /// A body one and a half times as large takes larger steps and has the larger bones.
    #[test]
    fn a_larger_body_walks_farther() {
        let body = body();
        let large = Body::new(&body.offsets.map(|offset| scale(offset, 1.5))).in_place_of(&body);
        assert!((large.scale() - 1.5).abs() < 1e-6);
        for seed in 0..20 {
            let pose = pose(&body, seed);
            for (a, b) in large.posed(&pose).iter().zip(&pose) {
                assert!(length(subtract(*a, scale(*b, 1.5))) < 3e-3, "seed {seed}: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn points_that_say_nothing_give_no_infinity() {
        let body = body();
        let huge: Pose =
            core::array::from_fn(|j| if j % 2 == 0 { [1e28, -3e25, j as f32] } else { [-1e28, 1e20, 1e28] });
        for wild in [[[0.0; 3]; JOINTS], [[1e-9, 2.0, 0.0]; JOINTS], [[1e6, -1e6, 1e6]; JOINTS], huge] {
            let posed = body.posed(&wild);
            assert!(posed.as_flattened().iter().all(|v| v.is_finite()), "{posed:?}");
        }
    }
}
