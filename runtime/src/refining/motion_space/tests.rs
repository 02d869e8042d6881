//! Anchors on a walk that was made by hand, against what must hold whatever they ask for.

use std::{vec, vec::Vec};

use super::*;
use crate::Anchor;
use crate::representation::limbs::Limb;
use crate::representation::skeleton::PARENTS;
use crate::request::conditions::AnchorList;

const FPS: u16 = 20;

/// A walk along +z at 1.2 m/s: each foot stands for half of a stride of 20 frames, and is carried through the other half.
fn walk(frames: usize) -> Vec<Pose> {
    let stride = 1.2;
    (0..frames)
        .map(|t| {
            let phase = t as f32 / 20.0;
            let z = stride * phase;
            let sway = 0.02 * (core::f32::consts::TAU * phase).sin();
            let mut pose: Pose = [[0.0; 3]; 22];
            let mut put = |joint: usize, at: Vector| pose[joint] = at;
            let pelvis = [sway, 0.92, z];
            put(0, pelvis);
            for (joint, up) in [(3, 0.12), (6, 0.25), (9, 0.31), (12, 0.53), (15, 0.62)] {
                put(joint, [sway, 0.92 + up, z + if joint == 15 { 0.05 } else { 0.0 }]);
            }
            for (left, [hip, knee, ankle, toe], [collar, shoulder, elbow, wrist], lag) in
                [(1.0, [1, 4, 7, 10], [13, 16, 18, 20], 0.0), (-1.0, [2, 5, 8, 11], [14, 17, 19, 21], 0.5)]
            {
                let own = phase + lag;
                let (step, share) = (own.floor(), own - own.floor());
                let swing = if share > 0.5 { 2.0 * share - 1.0 } else { 0.0 };
                let eased = swing * swing * (3.0 - 2.0 * swing);
                let x = 0.09 * left;
                let foot = [x, 0.08 + 0.12 * swing * (1.0 - swing), stride * (step - lag + 0.25 + eased)];
                let root = [x + sway, 0.84, z];
                let bent = Limb { root, middle: [x, 0.46, z + 0.05], end: [x, 0.08, z] };
                let leg = bent.reaching(foot, [0.0, 0.0, 0.05]);
                put(hip, leg.root);
                put(knee, leg.middle);
                put(ankle, leg.end);
                put(toe, add(leg.end, [0.0, -0.05, 0.13]));
                put(collar, [sway + 0.06 * left, 1.36, z]);
                put(shoulder, [sway + 0.17 * left, 1.38, z]);
                let hand = 0.2 * (core::f32::consts::TAU * own).cos();
                let arm = Limb {
                    root: [sway + 0.17 * left, 1.38, z],
                    middle: [x * 2.2, 1.1, z - 0.03],
                    end: [x * 2.3, 0.86, z],
                };
                let arm = arm.reaching([0.21 * left, 0.9, z + hand], [0.0, 0.0, -0.05]);
                put(elbow, arm.middle);
                put(wrist, arm.end);
            }
            pose
        })
        .collect()
}

fn set(anchors: &[Anchor], frames: usize) -> AnchorSet {
    let mut set = AnchorSet::EMPTY;
    set.fill(AnchorList::Frames(anchors), FPS, frames).unwrap();
    set
}

fn solved(poses: &[Pose], anchors: &[Anchor], settings: &Exact) -> (Vec<Pose>, Edited) {
    let anchors = set(anchors, poses.len());
    let bytes = Arena::measure(|arena| Scratch::take(poses.len(), anchors.len(), arena));
    let mut memory = vec![0u128; bytes / 16];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
    let mut scratch = Scratch::take(poses.len(), anchors.len(), &mut arena).unwrap();
    assert_eq!(arena.used(), bytes);
    let mut out = poses.to_vec();
    let edited = solve(&mut out, &anchors, settings, FPS, &mut scratch);
    (out, edited)
}

/// Numbers between 0 and 1.
fn numbers(seed: u32) -> impl FnMut() -> f32 {
    let mut stream = crate::numerics::hash::Stream::new(u64::from(seed));
    move || stream.below(1 << 20) as f32 / (1 << 20) as f32
}

/// Anchors that a body can reach: a joint of the walk at its frame, moved by up to `by` metres.
fn reachable(poses: &[Pose], count: usize, by: f32, seed: u32) -> Vec<Anchor> {
    let mut next = numbers(seed);
    let step = poses.len() / count;
    (0..count)
        .map(|i| {
            let frame = i * step + 1 + (next() * (step - 1) as f32) as usize;
            let joint = (next() * 22.0) as usize;
            let [dx, dy, dz] = [(); 3].map(|()| by * (next() - 0.5));
            let at = add(poses[frame][joint], [dx, 0.3 * dy, dz]);
            match joint {
                0 if next() < 0.5 => Anchor::planar_root(frame as u16, [at[0], at[2]]),
                0 => Anchor::root(frame as u16, at),
                joint => Anchor::joint(frame as u16, joint as u8, at),
            }
        })
        .collect()
}

fn bones(pose: &Pose) -> Vec<f32> {
    (1..22).map(|joint| length(subtract(pose[joint], pose[usize::from(PARENTS[joint])]))).collect()
}

fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

fn distance(a: Vector, b: Vector) -> f32 {
    length(subtract(a, b))
}

/// Fastest joint, beyond its speed in `generated`, metres a second.
fn added_speed(edited: &[Pose], generated: &[Pose]) -> f32 {
    let added = |t: usize, j: usize| subtract(edited[t][j], generated[t][j]);
    let steps = (1..edited.len()).flat_map(|t| (0..22).map(move |j| (t, j)));
    steps.map(|(t, j)| length(subtract(added(t, j), added(t - 1, j))) * f32::from(FPS)).fold(0.0, larger)
}

#[test]
fn anchors_of_every_joint_are_met_with_the_bones_that_are_there() {
    let poses = walk(196);
    let mut worst: (f32, u32) = (0.0, 0);
    for seed in 0..60 {
        let count = [2, 4, 8, 16, 32][seed as usize % 5];
        let anchors = reachable(&poses, count, 0.3, seed);
        let (out, edited) = solved(&poses, &anchors, &Exact::DEFAULT);
        let after = edited.after.unwrap();
        worst = if after.worst > worst.0 { (after.worst, seed) } else { worst };
        for (t, (new, old)) in out.iter().zip(&poses).enumerate() {
            for (joint, (a, b)) in bones(new).iter().zip(bones(old)).enumerate() {
                assert!((a - b).abs() < 2e-4, "seed {seed}, frame {t}, bone to {}: {a} {b}", joint + 1);
            }
        }
        for anchor in &anchors {
            let (joint, target, planar) = match anchor.target {
                crate::Target::Root(at) => (0, at, false),
                crate::Target::PlanarRoot([x, z]) => (0, [x, 0.0, z], true),
                crate::Target::Joint { joint, position } => (usize::from(joint), position, false),
            };
            let [x, y, z] = out[usize::from(anchor.frame)][joint];
            let off = distance([x, if planar { 0.0 } else { y }, z], target);
            assert!(off <= after.worst + 1e-6, "{anchor:?}");
        }
    }
    std::println!("farthest anchor, seed: {worst:?}");
    assert!(worst.0 < 0.01, "{worst:?}");
}

/// The same body, turned and put elsewhere, with its anchors: the same edit, turned. The first frame stays where it is, so the anchors move
/// with it.
#[test]
fn a_turned_room_gives_the_turned_motion() {
    let poses = walk(120);
    for seed in 0..6 {
        let anchors = reachable(&poses, 6, 0.4, 100 + seed);
        let angle = 0.7 + seed as f32;
        let (sin, cos) = (angle.sin(), angle.cos());
        let room = |[x, y, z]: Vector| [cos * x + sin * z + 3.0, y, cos * z - sin * x - 2.0];
        let turned: Vec<Pose> = poses.iter().map(|pose| pose.map(room)).collect();
        let moved: Vec<Anchor> = anchors
            .iter()
            .map(|anchor| match anchor.target {
                crate::Target::Root(at) => Anchor::root(anchor.frame, room(at)),
                crate::Target::PlanarRoot([x, z]) => {
                    let [x, _, z] = room([x, 0.0, z]);
                    Anchor::planar_root(anchor.frame, [x, z])
                }
                crate::Target::Joint { joint, position } => Anchor::joint(anchor.frame, joint, room(position)),
            })
            .collect();
        let ((plain, _), (other, _)) =
            (solved(&poses, &anchors, &Exact::DEFAULT), solved(&turned, &moved, &Exact::DEFAULT));
        for (a, b) in plain.iter().flatten().zip(other.iter().flatten()) {
            assert!(distance(room(*a), *b) < 2e-3, "seed {seed}: {a:?} {b:?}");
        }
    }
}

#[test]
fn the_order_of_anchors_does_not_matter() {
    let poses = walk(100);
    let mut anchors = reachable(&poses, 8, 0.3, 5);
    let bits = |poses: &[Pose]| poses.as_flattened().as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let first = bits(&solved(&poses, &anchors, &Exact::DEFAULT).0);
    anchors.reverse();
    assert_eq!(first, bits(&solved(&poses, &anchors, &Exact::DEFAULT).0));
    // Nothing to do is done by leaving every bit alone.
    let free = Exact { planted: false, ..Exact::DEFAULT };
    assert_eq!(bits(&poses), bits(&solved(&poses, &[], &free).0));
    let edited = solved(&poses, &[], &Exact::DEFAULT).1;
    assert_eq!((edited.before, edited.after, edited.rounds, edited.loosened), (None, None, 0, 0));
}

/// Two wrists' anchors three metres and three frames apart, a foot that is to be somewhere at once, a pelvis far away: what comes out is
/// finite and no faster than it may be, and an anchor that asks for nothing of the sort is met.
#[test]
fn what_cannot_be_is_done_as_far_as_speed_allows() {
    let poses = walk(160);
    let easy = Anchor::joint(130, 21, add(poses[130][21], [0.05, 0.1, 0.0]));
    let far = |frame: u16, joint: u8, by: Vector| {
        Anchor::joint(frame, joint, add(poses[usize::from(frame)][usize::from(joint)], by))
    };
    let cases = [
        vec![far(50, 20, [1.5, 0.0, 0.0]), far(53, 20, [-1.5, 0.0, 0.0]), easy],
        vec![far(60, 11, [0.0, 0.4, 1.2]), far(62, 11, [0.0, 0.0, -1.0]), easy],
        vec![far(20, 0, [3.0, 0.0, 0.0]), far(30, 0, [-3.0, 0.0, 0.0]), easy],
        vec![far(80, 15, [0.0, 1.0, 0.0]), far(82, 0, [0.0, -1.0, 1.0]), easy],
        vec![Anchor::joint(40, 20, [1000.0, -1000.0, 1000.0]), Anchor::root(41, [-1000.0, 1000.0, 1000.0])],
        vec![Anchor::root(0, [5.0, 1.0, 5.0]), Anchor::joint(0, 20, [0.0; 3]), easy],
    ];
    for (i, anchors) in cases.iter().enumerate() {
        let (out, edited) = solved(&poses, anchors, &Exact::DEFAULT);
        let speed = added_speed(&out, &poses);
        std::println!("case {i}: {edited:?}, {speed:.2} m/s added");
        assert!(out.as_flattened().as_flattened().iter().all(|v| v.is_finite()));
        assert!(speed < 1.25 * Exact::DEFAULT.added_speed, "case {i}: {speed} m/s added");
        if anchors.contains(&easy) {
            assert!(distance(out[130][21], add(poses[130][21], [0.05, 0.1, 0.0])) < 0.002, "case {i}");
        }
    }
    let free = Exact { planted: false, ..Exact::DEFAULT };
    let anchors = [far(50, 20, [0.4, 0.2, 0.0])];
    let [fast, slow] = [free, Exact { added_speed: 0.3, ..free }].map(|settings| solved(&poses, &anchors, &settings));
    assert!(fast.1.loosened == 0 && slow.1.loosened == 1 && slow.1.after.unwrap().mean > fast.1.after.unwrap().mean);
    // Elbows swing out a little faster than their wrists go.
    assert!(added_speed(&slow.0, &poses) < 0.6, "{}", added_speed(&slow.0, &poses));
}

/// Speeds that make no sense leave a finite motion.
#[test]
fn speeds_that_are_none_do_no_harm() {
    let poses = walk(80);
    let at = |by: Vector| Anchor::joint(40, 20, add(poses[40][20], by));
    for added_speed in [0.0, -3.0, 1e-30, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
        for anchors in [vec![at([0.3, 0.1, 0.0]), Anchor::root(60, [5.0, 1.0, 0.0])], vec![at([900.0, 0.0, -900.0])]] {
            let (out, edited) = solved(&poses, &anchors, &Exact { added_speed, ..Exact::DEFAULT });
            let finite = out.as_flattened().as_flattened().iter().all(|v| v.is_finite());
            assert!(finite && edited.after.unwrap().mean.is_finite(), "{added_speed}: {edited:?}");
        }
    }
}

/// A root that is drawn aside takes its feet along, but not while they stand.
#[test]
fn feet_stay_where_they_stand() {
    let poses = walk(196);
    let slide = |poses: &[Pose], stands: &[u8], toe: usize| -> f32 {
        let steps = (1..poses.len()).filter(|t| stands[*t] > 0 && stands[t - 1] > 0);
        let slides = steps.map(|t| {
            let [x, _, z] = subtract(poses[t][toe], poses[t - 1][toe]);
            (x * x + z * z).sqrt()
        });
        slides.fold(0.0, larger)
    };
    let anchors = [
        Anchor::root(100, add(poses[100][0], [0.8, 0.0, 0.5])),
        Anchor::root(180, add(poses[180][0], [0.2, 0.0, 1.0])),
    ];
    let free = Exact { planted: false, ..Exact::DEFAULT };
    let [planted, free] = [Exact::DEFAULT, free].map(|settings| solved(&poses, &anchors, &settings).0);
    for toe in [10, 11] {
        let mut stands = vec![0; poses.len()];
        stances::mark(&poses, toe, &mut stands);
        assert!(stands.iter().filter(|mark| **mark > 0).count() > 60, "a walk has stances");
        let [generated, planted, free] = [&poses, &planted, &free].map(|poses| slide(poses, &stands, toe));
        assert!(planted < 0.006 && free > 2.0 * planted, "toe {toe}: {generated} {planted} {free}");
    }
    assert!(deepest(&planted) < 1e-4);
}

/// How far a toe is below the floor.
fn deepest(poses: &[Pose]) -> f32 {
    poses.iter().flat_map(|pose| [-pose[10][1], -pose[11][1]]).fold(0.0, larger)
}

/// A walk that slides, and sinks into the floor: without anchors feet come to stand on it, and nothing pops where a stance begins or ends.
#[test]
fn feet_stand_without_anchors_as_well() {
    let mut poses = walk(160);
    for (t, pose) in poses.iter_mut().enumerate() {
        let [x, z] = [0.02 * (0.9 * t as f32).sin(), 0.012 * t as f32];
        *pose = pose.map(|joint| add(joint, [x, -0.04, z]));
    }
    let (planted, edited) = solved(&poses, &[], &Exact::DEFAULT);
    assert_eq!((edited.before, edited.after), (None, None));
    let slid = |poses: &[Pose], stands: &[u8], toe: usize| -> f32 {
        let steps = (1..poses.len()).filter(|t| stands[*t] > 0 && stands[t - 1] > 0);
        let slides: Vec<f32> = steps
            .map(|t| {
                let [x, _, z] = subtract(poses[t][toe], poses[t - 1][toe]);
                (x * x + z * z).sqrt()
            })
            .collect();
        slides.iter().sum::<f32>() / slides.len() as f32
    };
    let jump = |poses: &[Pose], toe: usize| {
        let change = |w: &[Pose]| length(subtract(add(w[0][toe], w[2][toe]), scale(w[1][toe], 2.0)));
        poses.windows(3).map(change).fold(0.0, larger)
    };
    for toe in [10, 11] {
        let mut stands = vec![0; poses.len()];
        stances::mark(&poses, toe, &mut stands);
        assert!(stands.iter().filter(|mark| **mark > 0).count() > 40, "a walk has stances");
        let [before, after] = [&poses, &planted].map(|poses| slid(poses, &stands, toe));
        assert!(after < 0.5 * before && before > 0.01, "toe {toe}: {before} {after} m a frame");
        let [before, after] = [&poses, &planted].map(|poses| jump(poses, toe));
        assert!(after < 1.5 * before, "toe {toe}: {before} {after} m a frame a frame");
    }
    assert!(deepest(&planted) < 1e-4 && deepest(&poses) > 0.008, "{} {}", deepest(&poses), deepest(&planted));
    // Legs do what they can; the body above them stays where it was.
    for (a, b) in poses.iter().zip(&planted) {
        assert_eq!([a[0], a[15], a[20]], [b[0], b[15], b[20]]);
    }
}

/// The farther an anchor is, the more it strains; of two the one that asks for more is named, by its place in the list.
#[test]
fn strain_grows_with_what_is_asked_for() {
    let poses = walk(120);
    let at =
        |frame: usize, joint: usize, by: Vector| Anchor::joint(frame as u16, joint as u8, add(poses[frame][joint], by));
    let strain = |anchors: &[Anchor]| solved(&poses, anchors, &Exact::DEFAULT).1.strain;
    let root = |x: f32| Anchor::root(100, add(poses[100][0], [x, 0.0, 0.0]));
    let series = [0.0, 0.2, 0.5, 1.0, 3.0].map(|x| strain(&[root(x)]).value);
    assert!(series.windows(2).all(|pair| pair[0] < pair[1]) && series[0] < 0.3, "{series:?}");
    let series = [0.0, 0.1, 0.3].map(|y| strain(&[at(60, 20, [0.0, y, 0.0])]).value);
    assert!(series.windows(2).all(|pair| pair[0] < pair[1]), "{series:?}");
    for anchors in [[root(2.0), at(20, 20, [0.05, 0.0, 0.0])], [at(20, 20, [0.05, 0.0, 0.0]), root(2.0)]] {
        let blamed = strain(&anchors).anchor;
        assert_eq!(anchors[usize::from(blamed)], root(2.0), "in whatever order");
    }
}

/// The longest motion with most anchors, beside the motion itself.
#[test]
fn memory_is_small() {
    let bytes = Arena::measure(|arena| Scratch::take(196, MAX_ANCHORS, arena));
    std::println!("{bytes} bytes, {} on the stack", size_of::<Scratch<'_>>());
    assert!(bytes < 20 << 10);
}

mod rows {
    use super::super::Followed;
    use super::super::dense::{DenseScratch, follow};
    use super::super::rows::{Led, Rows};
    use super::*;
    use crate::numerics::solid::{Shape, Solid};
    use crate::request::conditions::{Course, Keyframe, Obstacle, Track};

    /// Pelvis, head, wrists, ankles.
    const SIX: [u8; 6] = [0, 15, 20, 21, 7, 8];
    const FREE: Track<'static> =
        Track { joint: 0, first: 0, axes: [true; 3], mask: None, positions: &[], tolerance: 0.0 };

    fn followed(
        poses: &[Pose],
        anchors: &[Anchor],
        tracks: &[Track<'_>],
        obstacles: &[Obstacle<'_>],
    ) -> (Vec<Pose>, Followed) {
        let anchors = &AnchorSet::new(anchors, poses.len()).unwrap();
        crate::request::conditions::track::check(tracks, anchors, poses.len()).unwrap();
        crate::request::conditions::obstacle::check(obstacles, anchors, tracks, 20).unwrap();
        let rows = Rows { anchors, tracks, obstacles, frame_rate: 20 };
        let joints = rows.joints().count_ones() as usize;
        let bytes = Arena::measure(|arena| DenseScratch::take(poses.len(), joints, arena));
        let mut memory = vec![0u128; bytes.div_ceil(16)];
        let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
        let mut scratch = DenseScratch::take(poses.len(), joints, &mut arena).unwrap();
        let mut out = poses.to_vec();
        let edited = follow(&mut out, &rows, &Exact::DEFAULT, &mut scratch);
        assert!(out.as_flattened().as_flattened().iter().all(|v| v.is_finite()));
        (out, edited.followed.unwrap())
    }

    /// How far limbs are from the length that they had.
    fn stretched(poses: &[Pose], from: &[Pose]) -> f32 {
        let limbs = [4, 5, 7, 8, 18, 19, 20, 21];
        let off = |(a, b): (&Pose, &Pose)| {
            let (a, b) = (bones(a), bones(b));
            limbs.map(|joint: usize| (a[joint - 1] - b[joint - 1]).abs()).into_iter().fold(0.0, larger)
        };
        poses.iter().zip(from).map(off).fold(0.0, larger)
    }

    /// Another walk of the same body: it takes another path, and its limbs reach elsewhere now and then.
    fn other(poses: &[Pose]) -> Vec<Pose> {
        let by = |t: usize| {
            [0.15 * (0.3 * t as f32).sin(), -0.05 + 0.05 * (0.7 * t as f32).cos(), 0.1 * (0.4 * t as f32).cos()]
        };
        let anchors: Vec<Anchor> = (1..20)
            .map(|i| {
                let (t, joint) = (9 * i, SIX[i % 6]);
                Anchor::joint(t as u16, joint, add(poses[t][usize::from(joint)], by(t)))
            })
            .collect();
        solved(poses, &anchors, &Exact::DEFAULT).0
    }

    #[test]
    fn dense_tracks_of_six_joints_are_met() {
        let poses = walk(196);
        let goal = other(&poses);
        let before = (0..196).flat_map(|t| SIX.map(|j| distance(poses[t][usize::from(j)], goal[t][usize::from(j)])));
        assert!(before.fold(0.0, larger) > 0.1);
        let every = |step: usize| {
            let mask: Vec<u8> = (3..196).map(|t| u8::from(t % step == 3 % step)).collect();
            let paths = SIX.map(|joint| goal[3..].iter().map(|pose| pose[usize::from(joint)]).collect::<Vec<_>>());
            let tracks: Vec<Track<'_>> = SIX
                .iter()
                .zip(&paths)
                .map(|(joint, positions)| Track { joint: *joint, first: 3, mask: Some(&mask), positions, ..FREE })
                .collect();
            followed(&poses, &[], &tracks, &[])
        };
        for step in [1, 4, 40] {
            let (out, left) = every(step);
            let off = (3..196).filter(|t| t % step == 3 % step);
            let off = off.flat_map(|t| SIX.map(|j| distance(out[t][usize::from(j)], goal[t][usize::from(j)])));
            let worst = off.fold(0.0, larger);
            std::println!("every {step} frames: {worst} m, {left:?}");
            let report = left.after.unwrap();
            assert!(worst < 0.001 && (worst - report.worst).abs() < 1e-5, "every {step}: {worst} {left:?}");
            assert!(report.mean <= report.worst && left.before.unwrap().worst > 0.1 && left.hurried == 0, "{left:?}");
            assert!(stretched(&out, &poses) < 1e-3);
            assert!(added_speed(&out, &poses) < 3.0, "{}", added_speed(&out, &poses));
        }
    }

    /// A soft row goes the less of its way the softer it is; an axis that does not count is left alone; an anchor beside a track is met.
    #[test]
    fn rows_have_their_own_hardness_and_axes() {
        let poses = walk(120);
        let go = |tolerance: f32, axes: [bool; 3]| {
            let positions = &[add(poses[60][0], [0.4, 0.3, 0.0])];
            let tracks = [Track { first: 60, axes, positions, tolerance, ..FREE }];
            let hand = add(poses[90][21], [0.1, 0.2, 0.0]);
            let (out, left) = followed(&poses, &[Anchor::joint(90, 21, hand)], &tracks, &[]);
            assert!(distance(out[90][21], hand) < 1e-3, "{left:?}");
            subtract(out[60][0], poses[60][0])
        };
        let ways = [0.0, 0.1, 0.3, 1.0].map(|tolerance| go(tolerance, [true, false, true]));
        assert!(ways.windows(2).all(|pair| pair[0][0] > pair[1][0] + 0.005), "{ways:?}");
        assert!((ways[0][0] - 0.4).abs() < 1e-3, "{ways:?}");
        assert!((go(0.0, [false, true, false])[1] - 0.3).abs() < 1e-3);
    }

    /// A track that leaps, and one that lies far off from the start: they are followed as fast as speed allows, and said to be too fast.
    #[test]
    fn tracks_that_leap_are_followed_as_fast_as_speed_allows() {
        let poses = walk(120);
        let leap: Vec<Vector> = (20..120)
            .map(|t| add(poses[t][0], if t / 10 % 2 == 0 { [2.0, 0.0, 0.0] } else { [-2.0, 0.0, 0.0] }))
            .collect();
        let far: Vec<Vector> = (0..120).map(|t| add(poses[t][0], [-4.0, 0.0, 0.0])).collect();
        for (first, positions) in [(20, &leap), (0, &far)] {
            let tracks = [Track { first, positions, ..FREE }];
            let (out, left) = followed(&poses, &[], &tracks, &[]);
            let speed = added_speed(&out, &poses);
            std::println!("{speed} m/s added, {left:?}");
            assert!(left.hurried > 0 && left.after.unwrap().worst > 0.1, "{left:?}");
            // Beside the path's own way limbs swing round as the body turns.
            assert!(speed < 1.6 * Exact::DEFAULT.added_speed, "{speed} m/s");
        }
    }

    /// Obstacles of all forms, still and moving, in the way of a walk: no joint and no bone is inside the margin, by more than five
    /// millimetres, bones keep their lengths, and early on the walk is nearly what it was.
    #[test]
    fn obstacles_are_kept_clear_of() {
        let poses = walk(196);
        let ahead = poses[100][0];
        let still = |shape: Shape, middle: Vector| Obstacle::new(shape, middle);
        let pillar = still(Shape::Cylinder { radius: 0.2, half_height: 1.2 }, [0.1, 1.2, ahead[2]]);
        let ball = still(Shape::Sphere { radius: 0.3 }, [-0.25, 1.0, ahead[2]]);
        let bar = still(Shape::Capsule { half: [0.8, 0.0, 0.0], radius: 0.06 }, [0.0, 1.58, ahead[2]]);
        let crate_ = still(Shape::Box { half: [0.2, 0.35, 0.2] }, [0.35, 0.95, ahead[2]]);
        let wall = still(Shape::Plane { normal: [-1.0, 0.0, 0.0] }, [0.18, 0.0, 0.0]);
        let sill = still(Shape::Box { half: [0.6, 0.06, 0.05] }, [0.0, 0.06, ahead[2]]);
        let crossing = Course::Moving { from: [0.03 * -104.0, 1.0, ahead[2] + 0.1], velocity: [0.6, 0.0, 0.0] };
        let crossing = still(Shape::Sphere { radius: 0.25 }, [0.0; 3]).moving(crossing);
        let place = |frame: u16, x: f32| Keyframe { frame, position: [x, 1.2, ahead[2]] };
        let keys = [place(60, 3.0), place(95, 0.1), place(110, 0.1), place(130, -3.0)];
        let comes = pillar.moving(Course::Keyframes(&keys));
        let rail = still(Shape::Capsule { half: [0.8, 0.0, 0.0], radius: 0.03 }, [0.0, 0.25, ahead[2]]);
        let table = still(Shape::Box { half: [0.4, 0.03, 0.4] }, [0.0, 0.72, ahead[2]]);
        let scenes: [(&str, Vec<Obstacle<'_>>); 11] = [
            ("rail", vec![rail]),
            ("table", vec![table]),
            ("sill", vec![sill]),
            ("pillar", vec![pillar]),
            ("ball", vec![ball]),
            ("bar", vec![bar]),
            ("crate", vec![crate_]),
            ("wall", vec![wall]),
            ("crossing ball", vec![crossing]),
            ("a pillar that comes and goes", vec![comes]),
            ("ball and wall", vec![ball, wall]),
        ];
        for (name, obstacles) in scenes {
            let watched = |poses: &[Pose]| {
                let each = poses.iter().enumerate().flat_map(|(t, pose)| {
                    obstacles.iter().map(move |obstacle| bones_clear(&obstacle.at(2 * t, 20), pose))
                });
                each.fold(f32::INFINITY, |a, b| if b < a { b } else { a })
            };
            assert!(watched(&poses) < -0.02, "{name}: nothing in the way");
            let (out, left) = followed(&poses, &[], &[], &obstacles);
            let least = watched(&out);
            std::println!("{name}: {} -> {least} m, {left:?}, {} m/s", watched(&poses), added_speed(&out, &poses));
            assert!(least > -0.005 && left.clearance.unwrap().kept(), "{name}: {least} {left:?}");
            assert!(stretched(&out, &poses) < 1e-3, "{name}");
            assert!(added_speed(&out, &poses) < 5.5, "{name}: {} m/s", added_speed(&out, &poses));
            // Nobody dives below a rail, or climbs onto a table.
            let heights = out.iter().map(|pose| pose[0][1]);
            assert!(
                heights.clone().all(|height| (0.6..1.1).contains(&height)),
                "{name}: {:?}",
                heights.collect::<Vec<_>>()
            );
            // The path bends early, but no body that is far off leaps.
            assert!(name.contains("wall") || distance(out[5][0], poses[5][0]) < 0.08, "{name}");
        }
    }

    /// The least clearance of points a centimetre apart on all bones.
    fn bones_clear(body: &Solid, pose: &Pose) -> f32 {
        let points = (1..22).flat_map(|joint| {
            let (a, b) = (pose[usize::from(PARENTS[joint])], pose[joint]);
            (0..=60).map(move |k| add(a, scale(subtract(b, a), k as f32 / 60.0)))
        });
        points.map(|point| body.clearance(point)).fold(f32::INFINITY, |a, b| if b < a { b } else { a })
    }

    /// The nearest point of a figure, found by steps as long as what there is to spare, against points a centimetre apart.
    #[test]
    fn the_nearest_point_of_a_figure_is_found() {
        let pose = walk(4)[3];
        let mut stream = crate::numerics::hash::Stream::new(5);
        let mut next = move || stream.below(2001) as f32 / 1000.0 - 1.0;
        for shape in [Shape::Sphere { radius: 0.1 }, Shape::Box { half: [0.1, 0.3, 0.05] }] {
            for _ in 0..200 {
                let body = Solid { shape, middle: [next(), 1.0 + next(), next()], margin: 0.02 };
                let found = Led::ALL.nearest(&body, u32::MAX, &pose, [0.0; 3]);
                let want = bones_clear(&body, &pose);
                assert!((found.clearance - want).abs() < 0.021, "{shape:?}: {found:?} {want}");
                let at = body.clearance(found.point);
                assert!((at - found.clearance).abs() < 1e-6);
            }
        }
    }

    /// No figure gets through a wall behind which its anchor is, nor away from where it begins: what is left is said.
    #[test]
    fn what_cannot_be_cleared_is_said() {
        let poses = walk(120);
        let wall = Obstacle::new(Shape::Plane { normal: [0.0, 0.0, -1.0] }, [0.0, 0.0, poses[60][0][2]]);
        let [x, _, z] = poses[119][0];
        let (out, left) = followed(&poses, &[Anchor::planar_root(119, [x, z])], &[], &[wall]);
        // The wall holds; the goal is missed.
        assert!(left.clearance.unwrap().kept() && distance(out[119][0], poses[119][0]) > 1.0, "{left:?}");
        let around = Obstacle::new(Shape::Sphere { radius: 0.5 }, poses[0][0]);
        let (_, left) = followed(&poses, &[], &[], &[around]);
        let clearance = left.clearance.unwrap();
        assert!(!clearance.kept() && clearance.frame < 10, "{left:?}");
    }

    /// The distances that obstacles say against the nearest of many points on their surfaces.
    #[test]
    fn distances_are_those_of_the_surfaces() {
        let middle = [0.3, 1.0, -0.2];
        let mut stream = crate::numerics::hash::Stream::new(9);
        let mut next = move || stream.below(2001) as f32 / 1000.0 - 1.0;
        for shape in [
            Shape::Sphere { radius: 0.4 },
            Shape::Capsule { half: [0.3, 0.1, -0.2], radius: 0.15 },
            Shape::Cylinder { radius: 0.3, half_height: 0.5 },
            Shape::Box { half: [0.2, 0.4, 0.3] },
            Shape::Plane { normal: [0.6, 0.0, 0.8] },
        ] {
            let body = Solid { shape, middle, margin: 0.0 };
            for _ in 0..400 {
                let [a, b] = [(); 2].map(|()| add(middle, [next(), next(), next()]));
                let (da, db) = (body.distance(a), body.distance(b));
                assert!((da - db).abs() <= distance(a, b) + 1e-5, "{shape:?}: no distance grows faster than the way");
                // Along the way in which it grows most it does so as fast as one goes, until the surface is reached.
                let out = body.push(a, [0.0; 3], 0.0);
                assert_eq!(da >= -0.0005, out == [0.0; 3], "{shape:?} {a:?}");
                assert!(body.distance(add(a, out)) > -0.002, "{shape:?} {a:?}: {out:?}");
            }
        }
    }
}
