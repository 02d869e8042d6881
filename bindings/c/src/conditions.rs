//! Tracks and obstacles of a request, as C says them.

use motionette::{Course, Joint, Keyframe, Obstacle, Request, Shape, Track};

use crate::error::{mtn_error, mtn_result};
use crate::pointer::{clamped, slice};
use crate::request::mtn_request;
use crate::timeline::{fill_spans, no_spans};

/// Most tracks of a request.
pub const MTN_MAX_TRACKS: usize = 24;
/// Most obstacles of a request.
pub const MTN_MAX_OBSTACLES: usize = 16;
/// Most keyframes of a request, those of all its obstacles together.
pub const MTN_MAX_KEYFRAMES: usize = 64;
/// All joints, as `joints` of an obstacle has them.
pub const MTN_ALL_JOINTS: u32 = 0x003F_FFFF;

const _: () = assert!(MTN_MAX_TRACKS == motionette::MAX_TRACKS && MTN_MAX_OBSTACLES == motionette::MAX_OBSTACLES);
const _: () = assert!(MTN_ALL_JOINTS == motionette::ALL_JOINTS);

/// Axes of which positions count: `MTN_AXIS_*`, added up.
pub type mtn_axes = u8;
/// x, to the body's left at the start.
pub const MTN_AXIS_X: mtn_axes = 1;
/// y, up.
pub const MTN_AXIS_Y: mtn_axes = 2;
/// z, ahead at the start.
pub const MTN_AXIS_Z: mtn_axes = 4;
/// All three.
pub const MTN_AXES_ALL: mtn_axes = 7;

/// Where a joint is to be at many frames, up to all of them.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_track {
    /// Where the joint is to be, `[count][3]`, metres, one position a frame. Those that do not count may hold any finite numbers.
    pub positions: *const [f32; 3],
    /// Which positions count, `[count]`, not 0 for those that do; null: all.
    pub mask: *const u8,
    /// Positions.
    pub count: usize,
    /// How loosely it is followed: the standard deviation around it, 0 to 1 metres. 0: as exactly as can be.
    pub tolerance: f32,
    /// Frame of the first position.
    pub first: u16,
    /// Which `mtn_joint`.
    pub joint: u8,
    /// Which axes of the positions count, `MTN_AXES_ALL` or some of `MTN_AXIS_*`; the others are free.
    pub axes: mtn_axes,
}

/// The form of an obstacle, around its middle: one of `MTN_SHAPE_*`.
pub type mtn_shape = u8;
/// All points no farther from the middle than `radius`.
pub const MTN_SHAPE_SPHERE: mtn_shape = 0;
/// All points no farther than `radius` from the stretch that reaches from the middle by `half` both ways.
pub const MTN_SHAPE_CAPSULE: mtn_shape = 1;
/// A pillar that stands upright, of `radius` and `half_height`.
pub const MTN_SHAPE_CYLINDER: mtn_shape = 2;
/// A box with sides along the axes, `half` of each.
pub const MTN_SHAPE_BOX: mtn_shape = 3;
/// All that lies behind a plane through the middle; `normal` says which way is free.
pub const MTN_SHAPE_PLANE: mtn_shape = 4;

/// How an obstacle moves: one of `MTN_COURSE_*`.
pub type mtn_course = u8;
/// Its middle stays at `position`.
pub const MTN_COURSE_STILL: mtn_course = 0;
/// Its middle is at `position` at frame 0 and goes on with `velocity`.
pub const MTN_COURSE_MOVING: mtn_course = 1;
/// Its middle goes from keyframe to keyframe in straight lines; before the first and behind the last it stays.
pub const MTN_COURSE_KEYFRAMES: mtn_course = 2;

/// Where the middle of an obstacle is at a frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_keyframe {
    /// The middle `[x, y, z]`, metres.
    pub position: [f32; 3],
    /// The frame.
    pub frame: u16,
}

/// A body that joints, and the bones between them, keep clear of. Sizes that are not of its shape, and fields that are not of its course,
/// are not looked at.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_obstacle {
    /// Keyframes of `MTN_COURSE_KEYFRAMES`, each behind the one before it.
    pub keyframes: *const mtn_keyframe,
    /// How many there are, of all obstacles together at most `MTN_MAX_KEYFRAMES`.
    pub keyframe_count: usize,
    /// The middle `[x, y, z]`, metres; of `MTN_COURSE_MOVING` at frame 0.
    pub position: [f32; 3],
    /// Of `MTN_COURSE_MOVING`, metres a second, at most 20.
    pub velocity: [f32; 3],
    /// Of sphere, capsule and cylinder, metres.
    pub radius: f32,
    /// Of a cylinder: half of its height, metres.
    pub half_height: f32,
    /// Of a capsule: from the middle to one end, metres. Of a box: half of each side, metres.
    pub half: [f32; 3],
    /// Of a plane: which way is free, of any length but none.
    pub normal: [f32; 3],
    /// How far the figure keeps away from its surface, 0 to 1 metres; 0.05 is a good one.
    pub margin: f32,
    /// The joints that keep clear, `1 << joint` of each `mtn_joint` added up, each with the bone from its parent; `MTN_ALL_JOINTS` for the
    /// whole figure.
    pub joints: u32,
    /// Its form.
    pub shape: mtn_shape,
    /// How it moves.
    pub course: mtn_course,
}

/// Room for tracks, obstacles and keyframes: none in a library without them.
const TRACKS: usize = if cfg!(feature = "tracks") { MTN_MAX_TRACKS } else { 0 };
const OBSTACLES: usize = if cfg!(feature = "obstacles") { MTN_MAX_OBSTACLES } else { 0 };
const KEYFRAMES: usize = if cfg!(feature = "obstacles") { MTN_MAX_KEYFRAMES } else { 0 };

/// Runs `work` on `resolved` with the timeline, the tracks and the obstacles of `request`.
///
/// # Safety
/// The request's spans, tracks and obstacles, and what they point to, MUST be readable and unchanged during the call.
// Its own frame: requests without them do not need the room.
#[inline(never)]
pub(crate) unsafe fn with_conditions<R>(
    request: &mtn_request,
    resolved: Request<'_>,
    work: &mut dyn FnMut(Request<'_>) -> Result<R, mtn_result>,
) -> Result<R, mtn_result> {
    let mut spans = no_spans();
    // SAFETY: the caller vouches for them.
    let resolved = resolved.timeline(unsafe { fill_spans(request, &mut spans) }?);
    match (request.track_count, request.obstacle_count) {
        (0, 0) => work(resolved),
        // SAFETY: as above.
        _ => unsafe { with_tracks_and_obstacles(request, resolved, work) },
    }
}

/// The same of tracks and obstacles alone.
///
/// # Safety
/// As of [`with_conditions`].
#[inline(never)]
unsafe fn with_tracks_and_obstacles<R>(
    request: &mtn_request,
    resolved: Request<'_>,
    work: &mut dyn FnMut(Request<'_>) -> Result<R, mtn_result>,
) -> Result<R, mtn_result> {
    let mut tracks = [Track::new(Joint::Pelvis, 0, &[]); TRACKS];
    let mut obstacles = [Obstacle::new(Shape::Sphere { radius: 0.0 }, [0.0; 3]); OBSTACLES];
    let mut keyframes = [Keyframe { frame: 0, position: [0.0; 3] }; KEYFRAMES];
    // SAFETY: the caller vouches for them.
    let tracks = unsafe { fill_tracks(request, &mut tracks) }?;
    // SAFETY: as above.
    let obstacles = unsafe { fill_obstacles(request, &mut obstacles, &mut keyframes) }?;
    work(resolved.tracks(tracks).obstacles(obstacles))
}

/// The request's tracks in the runtime's form, in `room`.
///
/// # Safety
/// The tracks, and what they point to, MUST be readable and unchanged for `'r`.
unsafe fn fill_tracks<'a, 'r>(request: &mtn_request, room: &'a mut [Track<'r>]) -> Result<&'a [Track<'r>], mtn_result> {
    let count = request.track_count;
    check_count(count, MTN_MAX_TRACKS, cfg!(feature = "tracks"), mtn_error::TooManyTracks)?;
    // SAFETY: the caller vouches for them.
    let given = unsafe { slice(request.tracks, count, 1) }?;
    for (index, (to, from)) in room.iter_mut().zip(given).enumerate() {
        let mtn_track { positions, mask, count, tolerance, first, joint, axes } = *from;
        if axes & !MTN_AXES_ALL != 0 {
            let (found, limit) = (u32::from(axes), u32::from(MTN_AXES_ALL));
            return Err(mtn_result { index: clamped(index), found, limit, ..mtn_error::TrackAxes.into() });
        }
        let axes = [MTN_AXIS_X, MTN_AXIS_Y, MTN_AXIS_Z].map(|axis| axes & axis != 0);
        // SAFETY: the caller vouches for them.
        let positions = unsafe { slice(positions, count, 1) }?;
        let mask = match mask.is_null() {
            true => None,
            // SAFETY: the caller vouches for it.
            false => Some(unsafe { slice(mask, count, 1) }?),
        };
        *to = Track { joint, first, axes, mask, positions, tolerance };
    }
    Ok(room.get(..count).unwrap_or(&[]))
}

/// The request's obstacles in the runtime's form, in `room`, and their keyframes in `keyframes`.
///
/// # Safety
/// The obstacles, and what they point to, MUST be readable and unchanged during the call.
unsafe fn fill_obstacles<'a, 'r>(
    request: &mtn_request,
    room: &'a mut [Obstacle<'r>],
    keyframes: &'r mut [Keyframe],
) -> Result<&'a [Obstacle<'r>], mtn_result> {
    let count = request.obstacle_count;
    check_count(count, MTN_MAX_OBSTACLES, cfg!(feature = "obstacles"), mtn_error::TooManyObstacles)?;
    // SAFETY: the caller vouches for them.
    let given = unsafe { slice(request.obstacles, count, 1) }?;
    let mut free = keyframes;
    for (index, (to, from)) in room.iter_mut().zip(given).enumerate() {
        let at = |error: mtn_error, found: u32| mtn_result { index: clamped(index), found, ..error.into() };
        let mtn_obstacle { position, velocity, radius, half_height, half, normal, margin, joints, .. } = *from;
        let shape = match from.shape {
            MTN_SHAPE_SPHERE => Shape::Sphere { radius },
            MTN_SHAPE_CAPSULE => Shape::Capsule { half, radius },
            MTN_SHAPE_CYLINDER => Shape::Cylinder { radius, half_height },
            MTN_SHAPE_BOX => Shape::Box { half },
            MTN_SHAPE_PLANE => Shape::Plane { normal },
            shape => return Err(at(mtn_error::UnknownShape, u32::from(shape))),
        };
        let course = match from.course {
            MTN_COURSE_STILL => Course::Still(position),
            MTN_COURSE_MOVING => Course::Moving { from: position, velocity },
            MTN_COURSE_KEYFRAMES => {
                // SAFETY: the caller vouches for them.
                let given = unsafe { slice(from.keyframes, from.keyframe_count, 1) }?;
                let (found, room) = (given.len(), free.len());
                let Some((own, rest)) = core::mem::take(&mut free).split_at_mut_checked(found) else {
                    let found = clamped(found.saturating_add(MTN_MAX_KEYFRAMES - room));
                    let limit = clamped(MTN_MAX_KEYFRAMES);
                    return Err(mtn_result { limit, ..at(mtn_error::TooManyKeyframes, found) });
                };
                for (to, &mtn_keyframe { position, frame }) in own.iter_mut().zip(given) {
                    *to = Keyframe { frame, position };
                }
                free = rest;
                Course::Keyframes(own)
            }
            course => return Err(at(mtn_error::UnknownCourse, u32::from(course))),
        };
        *to = Obstacle { shape, course, margin, joints };
    }
    Ok(room.get(..count).unwrap_or(&[]))
}

/// Refuses more than there may be, and any at all that the library was built without.
pub(crate) fn check_count(found: usize, limit: usize, linked: bool, error: mtn_error) -> Result<(), mtn_result> {
    if found > 0 && !linked {
        Err(mtn_error::BlobNotLinked.into())
    } else if found > limit {
        Err(mtn_result { found: clamped(found), limit: clamped(limit), ..error.into() })
    } else {
        Ok(())
    }
}
