//! The body of a request.

use super::Error;
use crate::JOINTS;
use crate::model::{Model, is_bone};
use crate::representation::Pose;
use crate::representation::rigid::Body;
use crate::request::Bones;

/// The body that moves; `None` where joints stay as they were decoded.
#[inline(never)]
pub(super) fn body(model: &Model<'_>, bones: Bones<'_>) -> Option<Body> {
    let own = Body::new(&model.skeleton().offsets());
    match bones {
        Bones::Model => Some(own),
        Bones::Given(offsets) => Some(Body::new(offsets).in_place_of(&own)),
        Bones::Decoded => None,
    }
}

/// Refuses bones that no body has.
///
/// # Errors
/// [`Error::Bone`].
#[inline(never)]
pub(super) fn check(bones: Bones<'_>) -> Result<(), Error> {
    let Bones::Given(offsets) = bones else { return Ok(()) };
    match offsets.iter().enumerate().find(|&(joint, bone)| !is_bone(joint, *bone)) {
        Some((joint, _)) => Err(Error::Bone { joint: joint as u8 }),
        None => Ok(()),
    }
}

/// How much larger the body's world is than the one that motions are generated in.
#[inline(never)]
pub(super) fn scale(model: &Model<'_>, bones: Bones<'_>) -> f32 {
    body(model, bones).map_or(1.0, |body| body.scale())
}

/// Gives decoded joints, `[T][22][3]` metres, the body's bones.
#[inline(never)]
pub(super) fn pose(model: &Model<'_>, bones: Bones<'_>, joints: &mut [f32]) {
    if let Some(body) = body(model, bones) {
        pose_by(&body, joints);
    }
}

/// The same of a body.
#[inline(never)]
pub(super) fn pose_by(body: &Body, joints: &mut [f32]) {
    let (points, _) = joints.as_chunks_mut::<3>();
    let (poses, _): (&mut [Pose], _) = points.as_chunks_mut::<JOINTS>();
    for pose in poses {
        *pose = body.posed(pose);
    }
}
