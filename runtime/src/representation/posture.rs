//! How a body holds its parts: directions of bones as the part that carries them sees them, so that what one body does another can do
//! wherever it stands and however it is turned.
//!
//! The pelvis carries legs, spine and chest, the chest head and arms. A chest is held by where it points across and up; both together are as a
//! bone each.

use super::Pose;
use super::rigid::{axes, turned};
use crate::numerics::vector::{Vector, add, dot, length, scale, subtract, unit};
use crate::request::timeline::BodyParts;

/// Directions of a whole body.
pub const DIRECTIONS: usize = 17;

/// What a direction belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Held {
    /// From one joint to another, as the pelvis sees it.
    ByPelvis(usize, usize),
    /// From the right collar bone to the left, and from spine to neck.
    Across,
    /// The other direction of the chest.
    Up,
    /// From one joint to another, as the chest sees it.
    ByChest(usize, usize),
}

/// In the order in which a body is put together, each with the part that it moves with. The trunk is in no set without head and arms.
const HELD: [(Held, BodyParts); DIRECTIONS] = [
    (Held::ByPelvis(3, 6), BodyParts::UPPER_BODY),
    (Held::ByPelvis(6, 9), BodyParts::UPPER_BODY),
    (Held::Across, BodyParts::UPPER_BODY),
    (Held::Up, BodyParts::UPPER_BODY),
    (Held::ByChest(12, 15), BodyParts::HEAD),
    (Held::ByChest(13, 16), BodyParts::LEFT_ARM),
    (Held::ByChest(16, 18), BodyParts::LEFT_ARM),
    (Held::ByChest(18, 20), BodyParts::LEFT_ARM),
    (Held::ByChest(14, 17), BodyParts::RIGHT_ARM),
    (Held::ByChest(17, 19), BodyParts::RIGHT_ARM),
    (Held::ByChest(19, 21), BodyParts::RIGHT_ARM),
    (Held::ByPelvis(1, 4), BodyParts::LEFT_LEG),
    (Held::ByPelvis(4, 7), BodyParts::LEFT_LEG),
    (Held::ByPelvis(7, 10), BodyParts::LEFT_LEG),
    (Held::ByPelvis(2, 5), BodyParts::RIGHT_LEG),
    (Held::ByPelvis(5, 8), BodyParts::RIGHT_LEG),
    (Held::ByPelvis(8, 11), BodyParts::RIGHT_LEG),
];

/// Directions of some parts.
#[must_use]
pub fn count(parts: BodyParts) -> usize {
    HELD.iter().filter(|(_, part)| parts.has(*part)).count()
}

/// Joints that some parts move, as bits: those at the ends of what is held.
#[must_use]
pub fn joints(parts: BodyParts) -> u32 {
    let ends = |held| match held {
        Held::ByPelvis(_, to) | Held::ByChest(_, to) => 1 << to,
        Held::Up => 1 << 12 | 1 << 13 | 1 << 14,
        Held::Across => 0,
    };
    HELD.iter().filter(|(_, part)| parts.has(*part)).fold(0, |joints, (held, _)| joints | ends(*held))
}

/// A body's own axes: those of pelvis and chest.
struct Frames {
    pelvis: [Vector; 3],
    chest: [Vector; 3],
}

fn at(pose: &Pose, joint: usize) -> Vector {
    pose.get(joint).copied().unwrap_or_default()
}

fn way(pose: &Pose, from: usize, to: usize) -> Vector {
    subtract(at(pose, to), at(pose, from))
}

impl Frames {
    fn of(pose: &Pose) -> Self {
        Frames { pelvis: axes(way(pose, 2, 1), way(pose, 0, 3)), chest: axes(way(pose, 14, 13), way(pose, 9, 12)) }
    }

    /// A direction as the body sees it, of length 1.
    fn hold(&self, pose: &Pose, held: Held) -> Vector {
        let (frame, way) = match held {
            Held::ByPelvis(from, to) => (&self.pelvis, way(pose, from, to)),
            Held::Across => (&self.pelvis, way(pose, 14, 13)),
            Held::Up => (&self.pelvis, way(pose, 9, 12)),
            Held::ByChest(from, to) => (&self.chest, way(pose, from, to)),
        };
        unit(seen(frame, way), [0.0, 1.0, 0.0])
    }
}

/// A vector in these axes.
fn seen(frame: &[Vector; 3], v: Vector) -> Vector {
    let [x, y, z] = frame;
    [dot(*x, v), dot(*y, v), dot(*z, v)]
}

/// A vector that is so in these axes.
fn unseen([x, y, z]: &[Vector; 3], [a, b, c]: Vector) -> Vector {
    add(add(scale(*x, a), scale(*y, b)), scale(*z, c))
}

/// A direction's component in 16 bits.
const ONE: f32 = 32767.0;

/// Writes how `pose` holds `parts` into `out`, three numbers for each of their directions.
pub fn write(pose: &Pose, parts: BodyParts, out: &mut [i16]) {
    let frames = Frames::of(pose);
    let wanted = HELD.iter().filter(|(_, part)| parts.has(*part));
    for ((held, _), slot) in wanted.zip(out.chunks_exact_mut(3)) {
        for (slot, v) in slot.iter_mut().zip(frames.hold(pose, *held)) {
            // Away from zero by half, then towards it: the nearest number.
            *slot = (v * ONE + if v < 0.0 { -0.5 } else { 0.5 }) as i16;
        }
    }
}

/// Has `pose` hold `parts` as `directions` say, as [`write`] wrote them, by `share`, 0 to 1; bones keep their lengths, the chest its shape.
#[inline(never)]
pub fn hold(pose: &mut Pose, parts: BodyParts, directions: &[i16], share: f32) {
    let was = *pose;
    let before = Frames::of(&was);
    let mut frames = Frames { ..before };
    let mut across = [1.0, 0.0, 0.0];
    let wanted = HELD.iter().filter(|(_, part)| parts.has(*part)).map(|(held, _)| *held);
    for (held, given) in wanted.zip(directions.as_chunks::<3>().0) {
        let other = given.map(|v| f32::from(v) / ONE);
        let own = before.hold(&was, held);
        let direction = unit(add(scale(own, 1.0 - share), scale(other, share)), other);
        match held {
            Held::Across => across = unseen(&frames.pelvis, direction),
            Held::Up => {
                frames.chest = axes(across, unseen(&frames.pelvis, direction));
                let base = at(pose, 9);
                for joint in [12, 13, 14] {
                    let bone = turned(&before.chest, &frames.chest, way(&was, 9, joint));
                    set(pose, joint, add(base, bone));
                }
            }
            Held::ByPelvis(from, to) | Held::ByChest(from, to) => {
                let frame = if matches!(held, Held::ByChest(..)) { &frames.chest } else { &frames.pelvis };
                let bone = length(way(&was, from, to));
                let place = add(at(pose, from), scale(unseen(frame, direction), bone));
                set(pose, to, place);
            }
        }
    }
}

fn set(pose: &mut Pose, joint: usize, place: Vector) {
    if let Some(slot) = pose.get_mut(joint) {
        *slot = place;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::JOINTS;
    use crate::numerics::hash::Stream;
    use crate::numerics::rotation::Rotation;
    use crate::representation::rigid::Body;
    use crate::representation::rigid::tests::{body, pose};
    use crate::representation::skeleton::PARENTS;
    use std::vec;
    use std::vec::Vec;

    fn apart(a: Vector, b: Vector) -> f32 {
        length(subtract(a, b))
    }

    /// A pose, somewhere, turned about the vertical.
    fn somewhere(body: &Body, seed: u32) -> (Pose, Pose) {
        let here = pose(body, seed);
        let mut stream = Stream::new(u64::from(seed) + 1000);
        let mut next = || stream.below(2001) as f32 / 1000.0 - 1.0;
        let (turn, to) = (Rotation::new([0.0, 1.0, 0.0], 3.0 * next()), [2.0 * next(), 0.2 * next(), 2.0 * next()]);
        (here, here.map(|at| add(turn.apply(at), to)))
    }

    fn directions(pose: &Pose, parts: BodyParts) -> Vec<i16> {
        let mut out = vec![0; 3 * count(parts)];
        write(pose, parts, &mut out);
        out
    }

    /// What is written does not depend on where a body stands and which way it looks, and a body of the same bones that holds its parts so has them where
    /// the other has them, as pelvis and chest see it.
    #[test]
    fn one_body_holds_what_another_does() {
        let body = body();
        for seed in 0..40 {
            let (here, there) = somewhere(&body, seed);
            for (_, parts) in BodyParts::NAMED {
                let (a, b) = (directions(&here, parts), directions(&there, parts));
                assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() <= 2), "{a:?} {b:?}");
            }
            let base = pose(&body, seed + 500);
            let mut held = base;
            let all = BodyParts::UPPER_BODY.and(BodyParts::LEGS);
            hold(&mut held, all, &directions(&there, all), 1.0);
            let (base, was) = (Frames::of(&held), Frames::of(&there));
            for joint in 1..JOINTS {
                let (a, b) = (seen(&base.pelvis, way(&held, 0, joint)), seen(&was.pelvis, way(&there, 0, joint)));
                assert!(apart(a, b) < 1e-3, "seed {seed}, joint {joint}: {a:?} {b:?}");
            }
        }
    }

    /// Parts that are not in the set keep every bit, those that are keep their bones' lengths and the chest its shape, whatever the share.
    #[test]
    fn all_else_stays_and_bones_keep_their_lengths() {
        let body = body();
        let counts = BodyParts::NAMED.map(|(_, parts)| joints(parts).count_ones());
        assert_eq!(counts, [1, 3, 3, 3, 3, 6, 6, 12], "of head, arm, arm, leg, leg, arms, legs, all above the pelvis");
        for (seed, (_, parts)) in (0..).zip(BodyParts::NAMED) {
            let (base, other) = (pose(&body, seed), pose(&body, seed + 77));
            let given = directions(&other, parts);
            assert_eq!(given.len(), 3 * count(parts));
            for share in [0.0, 0.3, 0.8, 1.0] {
                let mut held = base;
                hold(&mut held, parts, &given, share);
                for joint in 0..JOINTS {
                    if joints(parts) >> joint & 1 == 0 {
                        assert_eq!(held[joint], base[joint], "{parts}: joint {joint} is none of theirs");
                    } else if share == 0.0 {
                        assert!(apart(held[joint], base[joint]) < 1e-5);
                    }
                    let parent = usize::from(PARENTS[joint]);
                    let [bone, was] = [&held, &base].map(|pose| apart(pose[joint], pose[parent]));
                    assert!((bone - was).abs() < 1e-5, "{parts}, {share}: joint {joint}: {bone} {was}");
                }
                for (a, b) in [(12, 13), (12, 14), (13, 14)] {
                    assert!((apart(held[a], held[b]) - apart(base[a], base[b])).abs() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn a_body_without_extent_is_finite() {
        let mut pose: Pose = [[0.0; 3]; JOINTS];
        let all = BodyParts::UPPER_BODY.and(BodyParts::LEGS);
        let given = directions(&pose, all);
        hold(&mut pose, all, &given, 0.5);
        hold(&mut pose, all, &[i16::MIN; 3 * DIRECTIONS], 1.0);
        assert!(pose.as_flattened().iter().all(|v| v.is_finite()));
    }
}
