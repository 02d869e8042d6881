//! Bodies of rigid bones: bones of every motion are as long as the blob says, or as the request does, whole or in a stream; the f64
//! reference poses the same body, and anchors are met in the body's own world.

use std::path::Path;

use motionette::representation::skeleton::PARENTS;
use motionette::{
    Anchor, Bones, Error, Generator, JOINTS, Model, ROWS, Request, StreamError, StreamLimits, refining::Config,
};
use motionette_host::blob::BlobFile;
use motionette_host::motion::{Pose, widened};
use motionette_host::reference::rigid::Body;
use motionette_host::verify;

type Offsets = [[f32; 3]; JOINTS];

fn blob() -> BlobFile {
    BlobFile::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/nano.blob")).expect("bundled")
}

/// A body of other proportions: long arms, short legs, hips that do not slope.
fn ape(model: &Model<'_>) -> Offsets {
    let mut offsets = model.skeleton().offsets();
    for (joint, share) in [(4, 0.7), (7, 0.7), (18, 1.3), (20, 1.4), (16, 1.1), (12, 0.8)] {
        for joint in [joint, joint + usize::from(joint != 12)] {
            offsets[joint] = offsets[joint].map(|value| value * share);
        }
    }
    for hip in [1, 2] {
        offsets[hip][1] = 0.0;
    }
    offsets
}

fn length(v: [f32; 3]) -> f32 {
    v.iter().map(|v| v * v).sum::<f32>().sqrt()
}

fn between(pose: &Pose, a: usize, b: usize) -> f32 {
    length(std::array::from_fn(|axis| pose[a][axis] - pose[b][axis]))
}

/// The bone that is farthest from its length, metres.
fn bone_error(motion: &[Pose], offsets: &Offsets) -> f32 {
    let off =
        |pose: &Pose, joint: usize| (between(pose, joint, usize::from(PARENTS[joint])) - length(offsets[joint])).abs();
    motion.iter().flat_map(|pose| (1..JOINTS).map(move |joint| off(pose, joint))).fold(0.0, f32::max)
}

const PROMPTS: [&str; 4] = ["a person dances", "a person kicks", "a person runs", "a person waves the right hand"];

#[test]
fn every_motion_has_the_bones_that_it_is_to_have() {
    let blob = blob();
    let model = blob.model().expect("it opens");
    let (own, other) = (model.skeleton().offsets(), ape(&model));
    let mut decoded_error = 0.0f32;
    for (seed, text) in PROMPTS.into_iter().enumerate() {
        let request = Request::text(text).frames(100).steps(4).seed(seed as u64).unrefined();
        let run = |request: &Request<'_>| verify::run(&blob, text, request).expect("it runs");
        let plain = run(&request);
        // Feet that stand do not stretch legs.
        let planted = run(&request.refined(Config::DEFAULT));
        assert!(bone_error(&planted.joints, &own) < 1e-3 && planted.joints != plain.joints, "{text}");
        decoded_error = decoded_error.max(bone_error(&run(&request.bones(Bones::Decoded)).joints, &own));
        assert!(bone_error(&plain.joints, &own) < 1e-3, "{text}");
        assert!(bone_error(&run(&request.bones(Bones::Given(&other))).joints, &other) < 1e-3, "{text}");
        // The same skeleton given is the same motion.
        assert_eq!(run(&request.bones(Bones::Given(&own))).joints, plain.joints);
        // Anchors bend limbs, they do not stretch them, and are where they are asked for in either body's world.
        for bones in [Bones::Model, Bones::Given(&other)] {
            let free = run(&request.bones(bones)).joints;
            let near = |frame: usize, joint: usize, by: [f32; 3]| {
                let [x, y, z] = free[frame][joint];
                Anchor::joint(frame as u16, joint as u8, [x + by[0], y + by[1], z + by[2]])
            };
            let [x, _, z] = free[70][0];
            let list = [
                near(30, 21, [0.08, 0.05, 0.1]),
                Anchor::planar_root(70, [x + 0.3, z - 0.2]),
                near(90, 7, [0.0, 0.0, 0.1]),
            ];
            let request = request.unconditioned().bones(bones).through(&list);
            let bent = run(&request);
            let after = bent.refinement.and_then(|report| report.after).expect("anchors");
            assert!(after.worst < 2e-3, "{text} {bones:?}: {after:?}");
            let skeleton = if bones == Bones::Model { &own } else { &other };
            assert!(bone_error(&bent.joints, skeleton) < 1e-3, "{text}: {}", bone_error(&bent.joints, skeleton));
            // The report speaks of the motion that is handed out, whatever met the anchors.
            let bent = run(&request.refined(Config::fast(4)));
            let after = bent.refinement.and_then(|report| report.after).expect("anchors");
            let [x, y, z] = bent.joints[30][21];
            let motionette::Target::Joint { position, .. } = list[0].target else { unreachable!() };
            let off = length([x - position[0], y - position[1], z - position[2]]);
            assert!(off <= after.worst + 1e-5, "{text}: {off} {after:?}");
        }
    }
    assert!(decoded_error > 0.02, "the decoder's bones are off by {decoded_error} m: nothing to mend");
}

#[test]
fn the_reference_poses_the_same_body() {
    let blob = blob();
    let model = blob.model().expect("it opens");
    let mut worst = 0.0f64;
    for (seed, text) in PROMPTS.into_iter().enumerate() {
        let request = Request::text(text).frames(100).steps(4).seed(seed as u64).unrefined();
        let run = |bones| verify::run(&blob, text, &request.bones(bones)).expect("it runs").joints;
        let wide = widened(&run(Bones::Decoded));
        let (own, other) = (model.skeleton().offsets(), ape(&model));
        let body = |offsets: &Offsets| Body::new(&offsets.map(|offset| offset.map(f64::from)));
        for (ours, want) in [
            (run(Bones::Model), body(&own).posed(&wide)),
            (run(Bones::Given(&other)), body(&other).in_place_of(&body(&own)).posed(&wide)),
        ] {
            for (frame, (a, b)) in ours.iter().zip(&want).enumerate() {
                for (joint, (a, b)) in a.iter().zip(b).enumerate() {
                    let off = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum::<f64>().sqrt();
                    assert!(off < 1e-3, "{text}, frame {frame}, joint {joint}: {off} m");
                    worst = worst.max(off);
                }
            }
        }
    }
    println!("runtime and reference differ by {worst:.2e} m at most");
}

#[test]
fn streams_move_the_same_body() {
    let blob = blob();
    let model = blob.model().expect("it opens");
    let (own, other) = (model.skeleton().offsets(), ape(&model));
    let tokens: Vec<u16> = (0..20).map(|i| (i * 37 % 512) as u16).collect();
    let mut memory = vec![0u128; 40_000];
    for bones in [Bones::Model, Bones::Given(&other), Bones::Decoded] {
        let whole =
            verify::run(&blob, "whole", &Request::tokens(&tokens).bones(bones).unrefined()).expect("it runs").joints;
        let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut memory)).expect("a generator");
        let limits = StreamLimits { tokens: 20, planning: None, rows: ROWS };
        let mut stream = generator.stream(&limits).expect("a stream");
        stream.set_bones(bones).expect("a body");
        stream.push(&tokens).expect("there is room");
        stream.finish();
        let mut streamed: Vec<Pose> = Vec::new();
        while let Some(frames) = stream.frames(&mut ()).expect("frames") {
            streamed.extend_from_slice(frames);
        }
        assert_eq!(streamed, whole);
        match bones {
            Bones::Model => assert!(bone_error(&streamed, &own) < 1e-3),
            Bones::Given(_) => assert!(bone_error(&streamed, &other) < 1e-3),
            Bones::Decoded => assert!(bone_error(&streamed, &own) > 1e-2),
        }
    }
}

#[test]
fn bodies_that_cannot_be_are_refused() {
    let blob = blob();
    let model = blob.model().expect("it opens");
    let mut memory = vec![0u128; 40_000];
    let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut memory)).expect("a generator");
    for (joint, bone) in [(5, [0.0; 3]), (20, [0.0, f32::NAN, 0.0]), (12, [9.0, 0.0, 0.0]), (0, [0.1, 0.0, 0.0])] {
        let mut skeleton = model.skeleton().offsets();
        skeleton[joint] = bone;
        let request = Request::tokens(&[1, 2, 3]).bones(Bones::Given(&skeleton));
        let refused = Error::Bone { joint: joint as u8 };
        assert_eq!(generator.plan(&request), Err(refused));
        assert_eq!(generator.generate(&request, &mut ()).map(|motion| motion.hash()), Err(refused));
        let limits = StreamLimits { tokens: 4, planning: None, rows: ROWS };
        let mut stream = generator.stream(&limits).expect("a stream");
        assert_eq!(stream.set_bones(Bones::Given(&skeleton)), Err(StreamError::Request(refused)));
        assert!(refused.to_string().contains(&format!("joint {joint}")));
    }
}
