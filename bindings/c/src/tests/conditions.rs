//! Tracks and obstacles.

use super::*;

/// A way of the pelvis over the floor, and of the right wrist at some frames, a little loosely.
static PATH: [[f32; 3]; 20] = {
    let mut path = [[0.0, 0.0, 0.0]; 20];
    let mut frame = 0;
    while frame < 20 {
        path[frame] = [0.01 * frame as f32, 0.0, 0.25 + 0.04 * frame as f32];
        frame += 1;
    }
    path
};
static HAND: [[f32; 3]; 3] = [[-0.4, 1.2, 0.6], [9.0, 9.0, 9.0], [-0.4, 1.3, 0.7]];
static SOME: [u8; 3] = [1, 0, 255];
static KEYS: [mtn_keyframe; 2] =
    [mtn_keyframe { position: [2.0, 1.0, 3.0], frame: 4 }, mtn_keyframe { position: [1.5, 1.0, 3.0], frame: 20 }];

/// Tracks as C makes them: what they point to stays.
pub(super) struct Tracks(pub(super) [mtn_track; 2]);

impl Tracks {
    pub(super) fn new() -> Self {
        let pelvis = mtn_track {
            positions: PATH.as_ptr(),
            mask: ptr::null(),
            count: PATH.len(),
            tolerance: 0.0,
            first: 6,
            joint: 0,
            axes: MTN_AXIS_X | MTN_AXIS_Z,
        };
        let hand = mtn_track {
            positions: HAND.as_ptr(),
            mask: SOME.as_ptr(),
            count: HAND.len(),
            tolerance: 0.02,
            first: 14,
            joint: 21,
            axes: MTN_AXES_ALL,
        };
        Tracks([pelvis, hand])
    }
}

/// A pillar beside the way.
pub(super) fn pillar() -> mtn_obstacle {
    mtn_obstacle {
        keyframes: ptr::null(),
        keyframe_count: 0,
        position: [0.3, 1.0, 0.6],
        velocity: [0.0; 3],
        radius: 0.1,
        half_height: 1.0,
        half: [0.0; 3],
        normal: [0.0; 3],
        margin: 0.03,
        joints: MTN_ALL_JOINTS,
        shape: MTN_SHAPE_CYLINDER,
        course: MTN_COURSE_STILL,
    }
}

fn along(tracks: &[mtn_track], obstacles: &[mtn_obstacle]) -> mtn_request {
    mtn_request {
        tracks: tracks.as_ptr(),
        track_count: tracks.len(),
        obstacles: obstacles.as_ptr(),
        obstacle_count: obstacles.len(),
        ..tokens()
    }
}

#[test]
fn tracks_and_obstacles_have_the_bits_of_the_rust_library() {
    let mut bench = Bench::new(1 << 19);
    let still = pillar();
    let ball = mtn_obstacle {
        shape: MTN_SHAPE_SPHERE,
        course: MTN_COURSE_MOVING,
        position: [-2.0, 1.0, 1.0],
        velocity: [0.7, 0.0, 0.0],
        ..still
    };
    let bar = mtn_obstacle {
        shape: MTN_SHAPE_CAPSULE,
        course: MTN_COURSE_KEYFRAMES,
        keyframes: KEYS.as_ptr(),
        keyframe_count: 2,
        half: [0.5, 0.0, 0.1],
        ..still
    };
    let crate_ = mtn_obstacle { shape: MTN_SHAPE_BOX, half: [0.2, 0.3, 0.4], position: [1.0, 0.3, 1.0], ..still };
    let arms = 1 << 20 | 1 << 21;
    let wall = mtn_obstacle {
        shape: MTN_SHAPE_PLANE,
        normal: [-2.0, 0.0, 0.0],
        position: [0.6, 0.0, 0.0],
        joints: arms,
        ..still
    };
    let obstacles = [still, ball, bar, crate_, wall];
    let tracks = Tracks::new();
    let motion = bench.generate(&along(&tracks.0, &obstacles)).unwrap();
    let mut hash = 0;
    // SAFETY: the motion is the last one of its generator.
    assert_eq!(unsafe { mtn_motion_hash(&motion, &mut hash) }, FINE);

    // SAFETY: the blocks are contiguous bytes.
    let (_, blob, _) = unsafe { BLOB.align_to::<u8>() };
    let mut arena = vec![0; 1 << 19];
    let mut generator = Generator::new(Model::open(blob).unwrap(), &mut arena).unwrap();
    let same = [
        Track::new(Joint::Pelvis, 6, &PATH).axes([true, false, true]),
        Track::new(Joint::RightWrist, 14, &HAND).masked(&SOME).within(0.02),
    ];
    let keys = KEYS.map(|mtn_keyframe { position, frame }| Keyframe { frame, position });
    let of = |shape, position| Obstacle::new(shape, position).margin(0.03);
    let bodies = [
        of(Shape::Cylinder { radius: 0.1, half_height: 1.0 }, [0.3, 1.0, 0.6]),
        of(Shape::Sphere { radius: 0.1 }, [0.0; 3])
            .moving(Course::Moving { from: [-2.0, 1.0, 1.0], velocity: [0.7, 0.0, 0.0] }),
        of(Shape::Capsule { half: [0.5, 0.0, 0.1], radius: 0.1 }, [0.0; 3]).moving(Course::Keyframes(&keys)),
        of(Shape::Box { half: [0.2, 0.3, 0.4] }, [1.0, 0.3, 1.0]),
        of(Shape::Plane { normal: [-2.0, 0.0, 0.0] }, [0.6, 0.0, 0.0]).joints(arms),
    ];
    let request = Request::tokens(&TOKENS).tracks(&same).obstacles(&bodies);
    let expected = generator.generate(&request, &mut ()).unwrap();
    assert_eq!(hash, expected.hash());
    let followed = expected.refinement.unwrap().edited.unwrap().followed.unwrap();
    assert_eq!((motion.tracking_before, motion.tracking), (followed.before.into(), followed.after.into()));
    assert_eq!(
        (motion.clearance_before, motion.clearance),
        (followed.clearance_before.into(), followed.clearance.into())
    );
    assert_eq!(motion.hurried_positions, followed.hurried);
    assert!(motion.tracking_before.worst > 0.03 && motion.tracking.mean < 0.02, "{motion:?}");
    assert!(motion.clearance_before.least < 0.0 && motion.clearance.least > 0.0, "{motion:?}");

    // Without them there is nothing to say, and the motion is another.
    let plain = bench.generate(&tokens()).unwrap();
    let (mean, worst, obstacle) = (-1.0, -1.0, MTN_NO_OBSTACLE);
    assert_eq!(plain.tracking, mtn_tracking { mean, worst, track: 0, frame: 0 });
    let (least, missing) = (f32::INFINITY, f32::NEG_INFINITY);
    assert_eq!(plain.clearance, mtn_clearance { least, missing, obstacle, frame: 0, joint: 0 });
    let mut other = 0;
    // SAFETY: the motion is the last one of its generator.
    assert_eq!(unsafe { mtn_motion_hash(&plain, &mut other) }, FINE);
    assert_ne!(hash, other);
}

#[test]
fn tracks_are_refused_by_place() {
    let mut bench = Bench::new(1 << 19);
    let good = Tracks::new().0;
    let [pelvis, hand] = good;
    let before = bench.generate(&along(&good, &[])).map(|motion| joints_of(&motion)).unwrap();
    let mut refused = |second: mtn_track| bench.refused(&along(&[pelvis, second], &[]));
    let null = result(mtn_error::NullPointer, 1, 0, 0);
    assert_eq!(refused(mtn_track { positions: ptr::null(), ..hand }), null);
    let off = HAND.as_ptr().wrapping_byte_add(2);
    assert_eq!(refused(mtn_track { positions: off, ..hand }), result(mtn_error::Misaligned, 1, 2, 4));
    let endless = mtn_track { count: usize::MAX / 4, ..hand };
    assert_eq!(refused(endless), result(mtn_error::Length, 1, u32::MAX, 0));
    assert_eq!(refused(mtn_track { axes: 9, ..hand }), result(mtn_error::TrackAxes, 1, 9, 7));
    let nothing = result(mtn_error::TrackNothing, 1, 0, 0);
    assert_eq!(refused(mtn_track { axes: 0, ..hand }), nothing);
    assert_eq!(refused(mtn_track { positions: ptr::null(), mask: ptr::null(), count: 0, ..hand }), nothing);
    assert_eq!(refused(mtn_track { mask: [0; 3].as_ptr(), ..hand }), nothing);
    assert_eq!(refused(mtn_track { joint: 22, ..hand }), result(mtn_error::TrackJoint, 1, 22, 22));
    assert_eq!(refused(mtn_track { first: 30, ..hand }), result(mtn_error::TrackFrame, 1, 32, 32));
    let wild = [[0.0, f32::NAN, 0.0]; 3];
    assert_eq!(refused(mtn_track { positions: wild.as_ptr(), ..hand }), result(mtn_error::TrackPosition, 1, 14, 1000));
    for tolerance in [-0.1, 1.5, f32::NAN] {
        assert_eq!(refused(mtn_track { tolerance, ..hand }), result(mtn_error::TrackTolerance, 1, 0, 1));
    }
    assert_eq!(refused(mtn_track { joint: 0, ..hand }), result(mtn_error::TrackConflict, 1, 0, 14));
    let refused = bench.refused(&mtn_request { anchors: &WRIST, anchor_count: 1, ..along(&good, &[]) });
    assert_eq!(refused, result(mtn_error::TrackAnchorConflict, 1, 0, 16));
    let bent = mtn_request { exact: 0, evaluations: 2, ..along(&good, &[]) };
    assert_eq!(bench.refused(&bent), result(mtn_error::NotExact, 0, 0, 0));
    let many = [hand; MTN_MAX_TRACKS + 1];
    assert_eq!(bench.refused(&along(&many, &[])), result(mtn_error::TooManyTracks, 0, 25, 24));
    assert_eq!(bench.refused(&mtn_request { tracks: ptr::null(), ..along(&good, &[]) }), null);
    assert_eq!(bench.generate(&along(&good, &[])).map(|motion| joints_of(&motion)), Ok(before));
}

#[test]
fn obstacles_are_refused_by_place() {
    let mut bench = Bench::new(1 << 19);
    let good = pillar();
    let before = bench.generate(&along(&[], &[good])).map(|motion| joints_of(&motion)).unwrap();
    let mut refused = |second: mtn_obstacle| bench.refused(&along(&[], &[good, second]));
    assert_eq!(refused(mtn_obstacle { shape: 5, ..good }), result(mtn_error::UnknownShape, 1, 5, 0));
    assert_eq!(refused(mtn_obstacle { course: 3, ..good }), result(mtn_error::UnknownCourse, 1, 3, 0));
    let size = result(mtn_error::ObstacleSize, 1, 0, 100);
    assert_eq!(refused(mtn_obstacle { radius: 0.0, ..good }), size);
    assert_eq!(refused(mtn_obstacle { shape: MTN_SHAPE_PLANE, ..good }), size);
    assert_eq!(refused(mtn_obstacle { shape: MTN_SHAPE_BOX, half: [1.0, f32::NAN, 1.0], ..good }), size);
    assert_eq!(refused(mtn_obstacle { margin: 1.5, ..good }), result(mtn_error::ObstacleMargin, 1, 0, 1));
    let nowhere = mtn_obstacle { position: [0.0, f32::INFINITY, 0.0], ..good };
    assert_eq!(refused(nowhere), result(mtn_error::ObstaclePlace, 1, 0, 1000));
    let fast = mtn_obstacle { course: MTN_COURSE_MOVING, velocity: [20.5, 0.0, 0.0], ..good };
    assert_eq!(refused(fast), result(mtn_error::ObstacleSpeed, 1, 21, 20));
    for joints in [0, MTN_ALL_JOINTS + 1] {
        assert_eq!(refused(mtn_obstacle { joints, ..good }), result(mtn_error::ObstacleJoints, 1, 0, 0));
    }
    let late = KEYS[1];
    let led = |keys: &[mtn_keyframe]| mtn_obstacle {
        course: MTN_COURSE_KEYFRAMES,
        keyframes: keys.as_ptr(),
        keyframe_count: keys.len(),
        ..good
    };
    let missing = mtn_obstacle { keyframes: ptr::null(), ..led(&KEYS) };
    assert_eq!(refused(missing), result(mtn_error::NullPointer, 1, 0, 0));
    let none = mtn_obstacle { keyframe_count: 0, ..missing };
    assert_eq!(refused(none), result(mtn_error::ObstacleKeyframes, 1, 0, 0));
    assert_eq!(refused(led(&[KEYS[0], late, late])), result(mtn_error::ObstacleKeyframes, 1, 2, 0));
    let keys: Vec<_> = (0..MTN_MAX_KEYFRAMES as u16).map(|frame| mtn_keyframe { frame, ..late }).collect();
    let most = [led(&keys[..60]), led(&keys[60..]), good];
    assert!(bench.generate(&along(&[], &most)).is_ok());
    let refused = bench.refused(&along(&[], &[most[0], most[1], led(&keys[..1])]));
    assert_eq!(refused, result(mtn_error::TooManyKeyframes, 2, 65, 64));
    let inside = mtn_anchor { position: good.position, frame: 8, family: MTN_FAMILY_JOINT, joint: 21 };
    let refused = bench.refused(&mtn_request { anchors: &inside, anchor_count: 1, ..along(&[], &[good]) });
    assert_eq!(refused, result(mtn_error::AnchorInside, 0, 0, 0));
    let within = mtn_obstacle { position: HAND[2], ..good };
    assert_eq!(bench.refused(&along(&Tracks::new().0, &[good, within])), result(mtn_error::TrackInside, 1, 1, 14));
    let free = mtn_request { exact: 0, ..along(&[], &[good]) };
    assert_eq!(bench.refused(&free), result(mtn_error::NotExact, 0, 0, 0));
    let many = [good; MTN_MAX_OBSTACLES + 1];
    assert_eq!(bench.refused(&along(&[], &many)), result(mtn_error::TooManyObstacles, 0, 17, 16));
    let null = mtn_request { obstacles: ptr::null(), ..along(&[], &[good]) };
    assert_eq!(bench.refused(&null), result(mtn_error::NullPointer, 1, 0, 0));
    assert_eq!(bench.generate(&along(&[], &[good])).map(|motion| joints_of(&motion)), Ok(before));
}
