//! Tracks and obstacles of requests: whether the shipped model's motions meet them, judged in f64 by code that knows nothing of the runtime's, what is said of
//! it, what is refused, and in what memory.

use std::path::Path;

use motionette::refining::{Config, Followed};
use motionette::{
    Anchor, Bones, Course, Error, Generator, Joint, Keyframe, Model, Motion, Obstacle, ObstacleError, Request, Shape,
    Track, TrackError,
};
use motionette_host::blob::BlobFile;
use motionette_host::metrics;
use motionette_host::motion::Pose;
use motionette_host::reference::clearance;

const PAINT: u8 = 0xA5;

fn blob() -> BlobFile {
    BlobFile::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/nano.blob")).expect("bundled")
}

/// Makes a motion in the planned arena, and checks that the plan names all that was touched.
fn made(model: &Model<'_>, request: &Request<'_>) -> Result<(Vec<Pose>, Option<Followed>, u64), Error> {
    let plan = Generator::new(model.clone(), &mut []).expect("default rounding").plan(request)?;
    let mut words = vec![0u128; plan.arena_bytes.div_ceil(16)];
    let arena: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
    arena.fill(PAINT);
    let mut generator = Generator::new(model.clone(), arena).expect("default rounding");
    let motion = generator.generate(request, &mut ())?;
    assert_eq!(motion.arena_used, plan.arena_bytes);
    let followed = |motion: &Motion<'_>| motion.refinement.and_then(|report| report.edited)?.followed;
    let out = (motion.frames().to_vec(), followed(&motion), motion.hash());
    drop(generator);
    let touched = bytemuck::cast_slice::<u128, u8>(&words).iter().rposition(|byte| *byte != PAINT);
    assert!(touched.is_some_and(|last| last + 64 > plan.arena_bytes), "{touched:?} of {}", plan.arena_bytes);
    Ok(out)
}

fn widened(a: [f32; 3]) -> [f64; 3] {
    a.map(f64::from)
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// Dense paths of another motion, which is what a user's recording is: pelvis and hands over all frames, also on a body of one's own.
#[test]
fn tracks_of_another_motion_are_met() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let foreign = Request::text("a person walks in a circle").frames(120).seed(9);
    let plain = Request::text("a person walks forward and waves").frames(120).seed(2);
    let bones = model.skeleton().offsets().map(|bone| bone.map(|value| 1.3 * value));
    for (bones, factor) in [(Bones::Model, 1.0), (Bones::Given(&bones), 1.3)] {
        let (goal, _, _) = made(&model, &foreign.bones(bones)).expect("it runs");
        let paths = [Joint::Pelvis, Joint::LeftWrist, Joint::Head]
            .map(|joint| (joint, goal.iter().skip(2).map(|pose| pose[joint.index()]).collect::<Vec<_>>()));
        let tracks = paths.each_ref().map(|(joint, path)| Track::new(*joint, 2, path));
        for count in 1..=3 {
            let request = plain.bones(bones).tracks(&tracks[..count]);
            let (frames, followed, hash) = made(&model, &request).expect("it runs");
            let followed = followed.expect("it was edited");
            let far =
                |t: usize, joint: Joint| apart(widened(frames[t][joint.index()]), widened(goal[t][joint.index()]));
            let off: Vec<f64> = paths[..count].iter().flat_map(|(joint, _)| (2..120).map(|t| far(t, *joint))).collect();
            let (mean, worst) = (off.iter().sum::<f64>() / off.len() as f64, off.iter().copied().fold(0.0, f64::max));
            let said = followed.after.expect("there are tracks");
            println!("{count} tracks, x {factor}: mean {mean:.5}, worst {worst:.5} m; {followed:?}");
            assert!((f64::from(said.mean) - mean).abs() < 1e-5 && (f64::from(said.worst) - worst).abs() < 1e-5);
            // A hand is no nearer to where another body had it than this body's shoulder and arm let it come.
            let most = if count == 1 { [0.001, 0.002] } else { [0.01, 0.08] }.map(|most| most * factor);
            assert!(mean < most[0] && worst < most[1], "{count}: {mean} {worst}");
            assert!(followed.before.unwrap().mean > 0.05);
            let offsets = match bones {
                Bones::Given(offsets) => *offsets,
                _ => model.skeleton().offsets(),
            };
            assert!(metrics::bone_error(&frames, offsets) < 1e-3);
            assert_eq!(hash, made(&model, &request).expect("it runs").2);
        }
    }
}

/// A track as sparse as anchors is met as they are; a hundred places of it are no more than they say.
#[test]
fn a_masked_track_is_as_good_as_anchors() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let plain = Request::text("a person walks forward").frames(80).seed(4);
    let places = [(20u16, [0.4f32, 1.2, 0.7]), (50, [0.2, 0.9, 1.5])];
    let anchors = places.map(|(frame, place)| Anchor::joint(frame, 20, place));
    let mut path = [[7.0f32; 3]; 80];
    let mut mask = [0u8; 80];
    for (frame, place) in places {
        (path[usize::from(frame)], mask[usize::from(frame)]) = (place, 1);
    }
    let tracks = [Track::new(Joint::LeftWrist, 0, &path).masked(&mask)];
    let (by_track, followed, _) = made(&model, &plain.tracks(&tracks)).expect("it runs");
    let (by_anchors, none, _) = made(&model, &plain.through(&anchors)).expect("it runs");
    assert!(none.is_none() && followed.unwrap().after.unwrap().worst < 0.001, "{followed:?}");
    for (frame, place) in places {
        for frames in [&by_track, &by_anchors] {
            assert!(apart(widened(frames[usize::from(frame)][20]), widened(place)) < 0.002);
        }
    }
    // Both at once, on different joints.
    let goal = [Anchor::planar_root(79, [0.5, 2.0])];
    let (frames, _, _) = made(&model, &plain.tracks(&tracks).anchors(&goal)).expect("it runs");
    let [x, _, z] = widened(frames[79][0]);
    assert!(apart([x, 0.0, z], [0.5, 0.0, 2.0]) < 0.002, "{x} {z}");
}

/// Obstacles in the way of a walk, at rest and moving, with a goal behind them: bones keep clear of them between frames as well, and the goal
/// is reached.
#[test]
fn obstacles_are_kept_clear_of() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let plain = Request::text("a person walks forward").frames(160).seed(3);
    let (free, _, _) = made(&model, &plain).expect("it runs");
    let at = |t: usize| free[t][0];
    let pillar = Obstacle::new(Shape::Cylinder { radius: 0.2, half_height: 1.1 }, [at(80)[0], 1.1, at(80)[2]]);
    let beam = Obstacle::new(Shape::Capsule { half: [1.0, 0.0, 0.0], radius: 0.05 }, [at(80)[0], 1.55, at(80)[2]]);
    let crate_ = Obstacle::new(Shape::Box { half: [0.25, 0.3, 0.25] }, [at(70)[0] + 0.2, 0.9, at(70)[2]]);
    let keys = [
        Keyframe { frame: 40, position: [at(80)[0] - 1.5, 1.0, at(80)[2]] },
        Keyframe { frame: 120, position: [at(80)[0] + 1.5, 1.0, at(80)[2]] },
    ];
    let passing = pillar.moving(Course::Keyframes(&keys)).margin(0.08);
    let goal = [Anchor::planar_root(159, [at(159)[0], at(159)[2]])];
    for (name, obstacles) in
        [("pillar", vec![pillar]), ("beam", vec![beam]), ("crate", vec![crate_]), ("passing", vec![passing])]
    {
        let request = plain.anchors(&goal).obstacles(&obstacles);
        let (frames, followed, _) = made(&model, &request).expect("it runs");
        let said = followed.and_then(|followed| followed.clearance).expect("there are obstacles");
        let [before, after] = [&free, &frames].map(|frames| {
            obstacles
                .iter()
                .map(|obstacle| clearance::least(frames, obstacle, 20.0) - f64::from(obstacle.margin))
                .fold(9.0, f64::min)
        });
        let end = widened(frames[159][0]);
        let off = apart([end[0], 0.0, end[2]], [f64::from(at(159)[0]), 0.0, f64::from(at(159)[2])]);
        println!("{name}: {before:.3} -> {after:.4} m beyond the margin, goal {off:.4} m off, {said:?}");
        assert!(before < -0.02, "{name}: nothing in the way");
        assert!(after > -0.005 && said.kept() && off < 0.01, "{name}: {after} {off}");
    }
}

/// What makes no sense is refused by name; a generator is usable afterwards.
#[test]
fn what_makes_no_sense_is_refused_by_name() {
    let blob = blob();
    let model = blob.model().expect("checked");
    let mut words = vec![0u128; 40_000];
    let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut words)).expect("rounding");
    let tokens: Vec<u16> = (0..10).collect();
    let plain = Request::tokens(&tokens);
    let want = generator.generate(&plain, &mut ()).expect("it runs").hash();
    let path = [[0.1f32, 1.0, 0.2]; 40];
    let nan = [[0.1f32, f32::NAN, 0.2]; 3];
    let far = [[0.1f32, 2000.0, 0.2]; 3];
    let track = Track::new(Joint::Head, 0, &path);
    let many = [track; 25];
    let other = [[0.1f32, 1.2, 0.2]; 5];
    let off = Track { positions: &other, first: 7, ..track };
    use TrackError as T;
    let cases: Vec<(Vec<Track<'_>>, TrackError)> = vec![
        (vec![Track { first: 1, ..track }], T::FrameOutOfRange { index: 0, frame: 40, frames: 40 }),
        (vec![Track { mask: Some(&[1; 39]), ..track }], T::Mask { index: 0, found: 39, positions: 40 }),
        (vec![Track { mask: Some(&[0; 40]), ..track }], T::Nothing { index: 0 }),
        (vec![Track { axes: [false; 3], ..track }], T::Nothing { index: 0 }),
        (vec![Track { positions: &[], ..track }], T::Nothing { index: 0 }),
        (vec![Track { joint: 22, ..track }], T::JointOutOfRange { index: 0, joint: 22, joints: 22 }),
        (vec![track, Track { positions: &nan, ..track }], T::Position { index: 1, frame: 0, limit: 1000.0 }),
        (vec![Track { positions: &far, first: 4, ..track }], T::Position { index: 0, frame: 4, limit: 1000.0 }),
        (vec![Track { tolerance: -1.0, ..track }], T::Tolerance { index: 0, tolerance: -1.0 }),
        (vec![track, off], T::Conflict { first: 0, second: 1, frame: 7 }),
        (many.to_vec(), T::TooMany { tracks: 25, limit: 24 }),
    ];
    for (tracks, error) in cases {
        let refused = generator.generate(&plain.tracks(&tracks), &mut ()).map(|_| ());
        assert_eq!(refused, Err(Error::Tracks(error)));
        assert_eq!(generator.generate(&plain, &mut ()).expect("usable").hash(), want);
    }
    // Equal places, places on other axes and within their tolerances are no contradiction.
    for fine in
        [vec![track, track], vec![track, Track { axes: [true, false, false], ..off }], vec![track, off.within(0.3)]]
    {
        assert!(generator.generate(&plain.tracks(&fine), &mut ()).is_ok());
    }
    let anchor = [Anchor::joint(8, 15, [0.1, 1.4, 0.2])];
    let error = T::AnchorConflict { track: 0, anchor: 0, frame: 8 };
    let tracks = [track];
    let both = plain.anchors(&anchor).tracks(&tracks);
    assert_eq!(generator.generate(&both, &mut ()).map(|_| ()), Err(Error::Tracks(error)));
    let refused = generator.generate(&plain.refined(Config::fast(3)).tracks(&tracks), &mut ()).map(|_| ());
    assert_eq!(refused, Err(Error::Tracks(T::NotExact)));
    // Without a refinement they are for a planner alone: these tokens are what they are.
    assert!(generator.generate(&plain.unrefined().tracks(&tracks), &mut ()).is_ok());

    use ObstacleError as O;
    let ball = Obstacle::new(Shape::Sphere { radius: 0.2 }, [3.0, 1.0, 0.0]);
    let keys = [Keyframe { frame: 9, position: [0.0; 3] }, Keyframe { frame: 9, position: [1.0; 3] }];
    let leap = [Keyframe { frame: 0, position: [0.0; 3] }, Keyframe { frame: 1, position: [0.0, 0.0, 4.0] }];
    let cases: Vec<(Obstacle<'_>, ObstacleError)> = vec![
        (Obstacle { shape: Shape::Sphere { radius: 0.0 }, ..ball }, O::Size { index: 0 }),
        (Obstacle { shape: Shape::Box { half: [0.1, -0.1, 0.1] }, ..ball }, O::Size { index: 0 }),
        (Obstacle { shape: Shape::Cylinder { radius: 0.1, half_height: f32::NAN }, ..ball }, O::Size { index: 0 }),
        (Obstacle { shape: Shape::Plane { normal: [0.0; 3] }, ..ball }, O::Size { index: 0 }),
        (ball.margin(-0.1), O::Margin { index: 0, margin: -0.1 }),
        (ball.moving(Course::Still([f32::INFINITY; 3])), O::Place { index: 0 }),
        (
            ball.moving(Course::Moving { from: [0.0; 3], velocity: [0.0, 0.0, 21.0] }),
            O::TooFast { index: 0, speed: 21.0, limit: 20.0 },
        ),
        (ball.moving(Course::Keyframes(&leap)), O::TooFast { index: 0, speed: 80.0, limit: 20.0 }),
        (ball.moving(Course::Keyframes(&keys)), O::Keyframes { index: 0, keyframe: 1 }),
        (ball.moving(Course::Keyframes(&[])), O::Keyframes { index: 0, keyframe: 0 }),
        (ball.joints(0), O::Joints { index: 0 }),
        (ball.joints(1 << 22), O::Joints { index: 0 }),
    ];
    for (obstacle, error) in cases {
        let obstacles = [obstacle];
        let refused = generator.generate(&plain.obstacles(&obstacles), &mut ()).map(|_| ());
        assert_eq!(refused, Err(Error::Obstacles(error)));
        assert_eq!(generator.generate(&plain, &mut ()).expect("usable").hash(), want);
    }
    let balls = [ball];
    let refused = generator.generate(&plain.unrefined().obstacles(&balls), &mut ()).map(|_| ());
    assert_eq!(refused, Err(Error::Tracks(T::NotExact)));
    let many = [ball; 17];
    let refused = generator.generate(&plain.obstacles(&many), &mut ()).map(|_| ());
    assert_eq!(refused, Err(Error::Obstacles(O::TooMany { obstacles: 17, limit: 16 })));
    let inside = [Obstacle::new(Shape::Sphere { radius: 0.2 }, [0.1, 1.0, 0.2])];
    let refused = generator.generate(&plain.tracks(&tracks).obstacles(&inside), &mut ()).map(|_| ());
    assert_eq!(refused, Err(Error::Obstacles(O::TrackInside { index: 0, track: 0, frame: 0 })));
    let anchor = [Anchor::joint(8, 15, [0.1, 1.0, 0.2])];
    let refused = generator.generate(&plain.anchors(&anchor).obstacles(&inside), &mut ()).map(|_| ());
    assert_eq!(refused, Err(Error::Obstacles(O::AnchorInside { index: 0, anchor: 0 })));
    assert_eq!(generator.generate(&plain, &mut ()).expect("usable").hash(), want);
}
