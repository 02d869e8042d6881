//! The edit in motion space against its reference: motions of the shipped model, anchors on any joint, what both make of them.

use std::path::Path;

use motionette::memory::Arena;
use motionette::refining::Config;
use motionette::refining::motion_space::{self, Exact, Scratch};
use motionette::request::conditions::{AnchorList, AnchorSet};
use motionette::{Anchor, Request};
use motionette_host::blob::BlobFile;
use motionette_host::motion::{Pose, widened};
use motionette_host::reference::bridge::{reference_anchor, runtime_anchors};
use motionette_host::reference::motion_space as reference;
use motionette_host::{metrics, verify};

const FPS: u16 = 20;

fn motions() -> Vec<Vec<Pose>> {
    let blob = BlobFile::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/nano.blob")).expect("bundled");
    let made = |(text, frames): (&str, u16)| {
        let request = Request::text(text).frames(frames).steps(4).seed(3).unrefined();
        verify::run(&blob, text, &request).expect("it runs").joints
    };
    [
        ("a person walks forward", 120),
        ("a person kicks", 80),
        ("a person runs", 60),
        ("a person waves the right hand", 196),
    ]
    .map(made)
    .to_vec()
}

/// Numbers from 0 to 1.
fn numbers(seed: u64) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// Anchors near where the joints are, in the order of frames; `by` metres at most in each direction.
fn anchors(motion: &[Pose], count: usize, by: f32, seed: u64) -> Vec<Anchor> {
    let mut next = numbers(seed);
    let step = motion.len() / count;
    (0..count)
        .map(|i| {
            let frame = i * step + 1 + (next() * (step - 1) as f32) as usize;
            let joint = (next() * 22.0) as u8;
            let [dx, dy, dz] = [(); 3].map(|()| 2.0 * by * (next() - 0.5));
            let [x, y, z] = motion[frame][usize::from(joint)];
            match joint {
                0 if next() < 0.5 => Anchor::planar_root(frame as u16, [x + dx, z + dz]),
                0 => Anchor::root(frame as u16, [x + dx, y + 0.3 * dy, z + dz]),
                _ => Anchor::joint(frame as u16, joint, [x + dx, y + 0.3 * dy, z + dz]),
            }
        })
        .collect()
}

fn edited(motion: &[Pose], anchors: &[Anchor], settings: &Exact) -> (Vec<Pose>, motion_space::Edited) {
    let set = AnchorSet::of(AnchorList::Frames(anchors), FPS, motion.len()).expect("they are anchors");
    let bytes = Arena::measure(|arena| Scratch::take(motion.len(), set.len(), arena));
    let mut memory = vec![0u128; bytes.div_ceil(16)];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
    let mut scratch = Scratch::take(motion.len(), set.len(), &mut arena).expect("as measured");
    let mut out = motion.to_vec();
    let edited = motion_space::solve(&mut out, &set, settings, FPS, &mut scratch);
    (out, edited)
}

#[test]
fn runtime_and_reference_make_the_same_motion() {
    let (mut worst, mut stances) = (0.0f64, 0usize);
    for (m, motion) in motions().iter().enumerate() {
        let wide = widened(motion);
        for (case, count) in [0, 2, 4, 8, 2, 4].into_iter().enumerate() {
            let planted = case < 4;
            let list = if count == 0 { Vec::new() } else { anchors(motion, count, 0.25, (10 * m + case) as u64) };
            let (ours, report) = edited(motion, &list, &Exact { planted, ..Exact::DEFAULT });
            let theirs: Vec<_> = list.iter().map(reference_anchor).collect();
            assert_eq!(runtime_anchors(&theirs), list, "the bridge loses nothing");
            let settings = reference::Exact { added_speed: 5.0, planted };
            let (want, loose) = reference::edited(&wide, &theirs, settings, f64::from(FPS));
            assert_eq!(loose.iter().filter(|loose| **loose > 0.0).count(), usize::from(report.loosened));
            for (frame, (a, b)) in ours.iter().zip(&want).enumerate() {
                for (joint, (a, b)) in a.iter().zip(b).enumerate() {
                    let off = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum::<f64>().sqrt();
                    assert!(off < 1e-3, "motion {m} case {case}, frame {frame} joint {joint}: {off} m, {report:?}");
                    worst = worst.max(off);
                }
            }
            let strain = reference::strain(&wide, &widened(&ours), f64::from(FPS));
            assert!((f64::from(report.strain.value) - strain).abs() < 1e-3 * (1.0 + strain), "{report:?}: {strain}");
            stances += usize::from(planted);
            let met = report.after.is_none_or(|after| after.worst < 0.002);
            assert!(met || report.loosened > 0, "motion {m} case {case}: {report:?} of {list:?}");
        }
    }
    println!("{stances} edits with planted feet; runtime and reference differ by {worst:.2e} m at most");
}

/// Of a length that the text suggests there are fewer frames than were planned for; the anchors are met all the same, in the planned memory.
#[test]
fn motions_of_predicted_length_are_edited() {
    let blob = BlobFile::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/nano.blob")).expect("bundled");
    for text in ["a person walks forward", "a person bows"] {
        let list = [Anchor::root(12, [0.1, 0.9, 0.2]), Anchor::joint(20, 20, [0.4, 1.3, 0.3])];
        let request = Request::text(text).steps(4).through(&list).refined(Config::exact());
        let made = verify::run(&blob, text, &request).expect("it runs in the planned arena");
        let report = made.refinement.expect("it was edited");
        assert!(made.joints.len() < 196, "{} frames: the longest motion says nothing", made.joints.len());
        assert!(report.edited.is_some() && report.evaluations == 0, "{report:?}");
        assert!(report.after.is_some_and(|after| after.worst < 0.002), "{report:?}");
    }
}

/// A request without anchors has its feet stand as well: they slide half as fast while they stand, skate no more, are not below the floor, and
/// nothing jerks for it; the body above the hips is the generated one.
#[test]
fn feet_stand_in_motions_without_anchors() {
    let blob = BlobFile::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/nano.blob")).expect("bundled");
    let (mut speed, mut skating, mut jerk, mut lowest) = ([0.0; 2], [0.0; 2], [0.0; 2], f32::INFINITY);
    let texts = ["a person walks forward", "a tired person walks", "a person waves the right hand", "a person bows"];
    for (seed, text) in texts.into_iter().enumerate() {
        let request = Request::text(text).frames(120).seed(seed as u64);
        let [free, planted] = [request.unrefined(), request].map(|r| verify::run(&blob, text, &r).expect("it runs"));
        assert!(planted.refinement.is_none(), "without anchors there is nothing to report");
        let toes = |t: usize, joints: &[Pose]| [10, 11].map(|toe: usize| joints[t][toe]);
        // Stances of the generated motion.
        for t in 1..free.joints.len() {
            let pairs = toes(t - 1, &free.joints).into_iter().zip(toes(t, &free.joints)).enumerate();
            for (foot, (a, b)) in pairs {
                let far = |a: [f32; 3], b: [f32; 3]| f64::from((a[0] - b[0]).hypot(a[2] - b[2]));
                if a[1] < 0.05 && b[1] < 0.05 && far(a, b) < 0.04 {
                    speed[0] += far(a, b);
                    speed[1] += far(toes(t - 1, &planted.joints)[foot], toes(t, &planted.joints)[foot]);
                }
            }
        }
        for (i, joints) in [&free.joints, &planted.joints].into_iter().enumerate() {
            skating[i] += metrics::foot_skating(joints, 0.0);
            jerk[i] += metrics::jerk(joints, f64::from(FPS));
        }
        for (a, b) in free.joints.iter().zip(&planted.joints) {
            assert_eq!([a[0], a[9], a[15], a[20]], [b[0], b[9], b[15], b[20]]);
            lowest = b[10][1].min(b[11][1]).min(lowest);
        }
    }
    println!("foot speed in stance {speed:?}, skating {skating:?}, jerk {jerk:?}, lowest toe {lowest} m");
    assert!(speed[1] < 0.5 * speed[0] && skating[1] < skating[0] && jerk[1] < 1.06 * jerk[0] && lowest > -1e-4);
}
