//! Analytic inverse kinematics of the body: how its segments are turned, from where its joints are.
//!
//! A segment is what moves when a joint turns; its orientation is relative to *standing*: upright, facing +z, arms hanging at the
//! sides, palms inwards (x to the body's left, y up). Two bones give a segment's whole orientation: the trunk's from its length and
//! the line of hips or shoulders; an upper arm's or thigh's from itself and the bend of elbow or knee, which are hinges. The neck and
//! the feet have one bone, so they turn on the shortest arc and not about themselves.

use crate::kernels;
use crate::numerics::rotation::Rotation;
use crate::numerics::vector::{Vector, add, cross, dot, scale, subtract, unit};
use crate::representation::Pose;
use crate::{JOINTS, Joint};

const X: Vector = [1.0, 0.0, 0.0];
/// Up.
pub(super) const UP: Vector = [0.0, 1.0, 0.0];
const DOWN: Vector = [0.0, -1.0, 0.0];
const FORWARD: Vector = [0.0, 0.0, 1.0];
const BACKWARD: Vector = [0.0, 0.0, -1.0];
/// Of a foot from ankle to toes, as people in the training data stand.
const FOOT: Vector = [0.0, -0.38, 0.925];

/// How far an elbow or knee must be bent before the bend says more about the limb's twist than the shortest arc does: sine of the
/// angle.
const BEND: f32 = 0.04;

/// What tells a segment's orientation beside its own bone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Aside {
    /// The line between these two joints, which lies along +x when standing.
    Line(Joint, Joint),
    /// The bone behind, from these joints, which bends towards that direction.
    Bend(Joint, Joint, Vector),
    /// Nothing.
    Nothing,
}

/// A segment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    /// The joint that turns it.
    pub joint: Joint,
    /// The segment that it turns on; the pelvis turns on the heading.
    pub base: Joint,
    /// Its bone.
    pub bone: (Joint, Joint),
    /// Where the bone points when standing.
    pub rest: Vector,
    /// The rest of its orientation.
    pub aside: Aside,
    /// Joints whose bones it carries.
    carries: &'static [Joint],
}

/// The segments, each behind the one that it turns on. Spine1 and spine2 move with the pelvis and the collars with the chest:
/// positions do not tell how those turn.
pub(super) const SEGMENTS: [Segment; 13] = {
    use Aside::{Bend, Line, Nothing};
    use Joint::*;
    macro_rules! segment {
        ($joint:ident on $base:ident, $from:ident to $to:ident $rest:ident, $aside:expr, $carries:expr) => {
            Segment { joint: $joint, base: $base, bone: ($from, $to), rest: $rest, aside: $aside, carries: &$carries }
        };
    }
    [
        segment!(Pelvis on Pelvis, Pelvis to Spine1 UP, Line(RightHip, LeftHip), [LeftHip, RightHip, Spine1, Spine2, Spine3]),
        segment!(Spine3 on Pelvis, Spine3 to Neck UP, Line(RightShoulder, LeftShoulder),
            [Neck, LeftCollar, RightCollar, LeftShoulder, RightShoulder]),
        segment!(Neck on Spine3, Neck to Head UP, Nothing, [Head]),
        segment!(LeftShoulder on Spine3, LeftShoulder to LeftElbow DOWN, Bend(LeftElbow, LeftWrist, FORWARD), [LeftElbow]),
        segment!(RightShoulder on Spine3, RightShoulder to RightElbow DOWN, Bend(RightElbow, RightWrist, FORWARD), [RightElbow]),
        segment!(LeftElbow on LeftShoulder, LeftElbow to LeftWrist DOWN, Nothing, [LeftWrist]),
        segment!(RightElbow on RightShoulder, RightElbow to RightWrist DOWN, Nothing, [RightWrist]),
        segment!(LeftHip on Pelvis, LeftHip to LeftKnee DOWN, Bend(LeftKnee, LeftAnkle, BACKWARD), [LeftKnee]),
        segment!(RightHip on Pelvis, RightHip to RightKnee DOWN, Bend(RightKnee, RightAnkle, BACKWARD), [RightKnee]),
        segment!(LeftKnee on LeftHip, LeftKnee to LeftAnkle DOWN, Nothing, [LeftAnkle]),
        segment!(RightKnee on RightHip, RightKnee to RightAnkle DOWN, Nothing, [RightAnkle]),
        segment!(LeftAnkle on LeftKnee, LeftAnkle to LeftFoot FOOT, Nothing, [LeftFoot]),
        segment!(RightAnkle on RightKnee, RightAnkle to RightFoot FOOT, Nothing, [RightFoot]),
    ]
};

/// Whether positions tell how this joint turns.
#[must_use]
pub fn turns(joint: Joint) -> bool {
    SEGMENTS.iter().any(|segment| segment.joint == joint)
}

/// The vector from one joint to another, metres.
fn bone(pose: &Pose, from: Joint, to: Joint) -> Vector {
    match (pose.get(from.index()), pose.get(to.index())) {
        (Some(from), Some(to)) => subtract(*to, *from),
        _ => [0.0; 3],
    }
}

/// Orientations of the segments of a pose, in the motion's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Orientations {
    /// About +y, radians, within half a turn; 0 faces +z.
    pub heading: f32,
    /// One a joint; those of joints that turn no segment mean nothing.
    of: [Rotation; JOINTS],
}

impl Orientations {
    /// Of `pose`. Where it is degenerate (bones without length), segments are turned as those that they stand on.
    #[inline(never)]
    pub fn observe(pose: &Pose) -> Self {
        let [x, _, z] = cross(bone(pose, Joint::RightHip, Joint::LeftHip), UP);
        let heading = if x * x + z * z > 1e-12 { libm::atan2f(x, z) } else { 0.0 };
        let mut seen = Orientations { heading, of: [Rotation::new(UP, heading); JOINTS] };
        for segment in &SEGMENTS {
            let orientation = seen.observed(segment, pose);
            seen.set(segment.joint, orientation);
        }
        seen
    }

    fn observed(&self, segment: &Segment, pose: &Pose) -> Rotation {
        let base = self.get(segment.base);
        let standing = base.apply(segment.rest);
        let along = unit(bone(pose, segment.bone.0, segment.bone.1), standing);
        let swing = Rotation::between(standing, along) * base;
        match segment.aside {
            Aside::Nothing => swing,
            Aside::Line(from, to) => Rotation::aligning((segment.rest, X), along, bone(pose, from, to)),
            Aside::Bend(from, to, towards) => {
                let behind = unit(bone(pose, from, to), along);
                let bend = subtract(behind, scale(along, dot(along, behind)));
                let doubt = BEND * BEND / (BEND + kernels::sqrt(dot(bend, bend)));
                let aside = add(bend, scale(swing.apply(towards), doubt));
                Rotation::aligning((segment.rest, towards), along, aside)
            }
        }
    }

    /// Of the segment that `joint` turns.
    pub fn get(&self, joint: Joint) -> Rotation {
        self.of.get(joint.index()).copied().unwrap_or(Rotation::IDENTITY)
    }

    /// Sets it.
    pub fn set(&mut self, joint: Joint, orientation: Rotation) {
        if let Some(slot) = self.of.get_mut(joint.index()) {
            *slot = orientation;
        }
    }

    /// `pose`, seen as `observed`, with its segments turned as these are: bones keep their lengths and their place in their segment.
    #[inline(never)]
    pub fn pose(&self, pose: &Pose, observed: &Orientations) -> Pose {
        let mut out = *pose;
        for segment in &SEGMENTS {
            let turn = self.get(segment.joint) * observed.get(segment.joint).inverse();
            for &joint in segment.carries {
                let parent = crate::representation::skeleton::PARENTS.get(joint.index()).map_or(0, |p| usize::from(*p));
                let (Some(from), Some(to)) = (pose.get(parent), pose.get(joint.index())) else { continue };
                let bone = turn.apply(subtract(*to, *from));
                let Some(at) = out.get(parent).map(|parent| add(*parent, bone)) else { continue };
                if let Some(slot) = out.get_mut(joint.index()) {
                    *slot = at;
                }
            }
        }
        out
    }
}
