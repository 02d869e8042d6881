//! From where the joints are to servo angles, and back.
//!
//! The servos of a joint turn its segment by `R(a_1, theta_1) R(a_2, theta_2) ...` on the segment that it stands on, as the robot has
//! turned that. Their angles maximise `p . R p_0 + w s . R s_0`, where `p` is the segment's bone and `s` the direction that tells its
//! twist, both as observed, and `p_0`, `s_0` the same when standing: one angle after the other, each by its closed form, kept in its
//! range, from the angles of the frame before. So a robot with fewer axes than the body, or narrower ranges, points its limbs as well
//! as it can, and a joint makes up for what the one before it could not do.

use heapless::Vec;

use super::body::{Aside, Orientations, SEGMENTS, Segment, UP};
use super::robot::{Channel, MAX_AXES, MAX_CHANNELS, Robot, Source};
use crate::Joint;
use crate::numerics::rotation::Rotation;
use crate::numerics::vector::{Vector, cross, dot, scale};
use crate::representation::Pose;
use core::f32::consts::PI;

/// How much a segment's twist counts against where its bone points.
const TWIST: f32 = 0.3;
/// How much an axis keeps to its angle of the frame before: little against a limb that points across it, much against one that points
/// nearly along it, where small movements would ask for large turns.
const INERTIA: f32 = 0.05;
/// Rounds over a joint's axes from the angles of the frame before.
const ROUNDS: usize = 8;
/// Rounds of the first frame.
const FIRST_ROUNDS: usize = 64;

/// Maps poses to servo angles, one after the other.
#[derive(Debug, Clone)]
pub struct Mapper {
    /// Angles of the sources: radians, metres for a height.
    state: Vec<f32, MAX_CHANNELS>,
    ground: f32,
    fresh: bool,
}

/// A robot's axis in the search for its angle.
#[derive(Debug, Clone, Copy)]
struct Turn {
    channel: usize,
    axis: Vector,
    range: [f32; 2],
    angle: f32,
    /// What keeps it at the angle of the frame before: sine and cosine of that, scaled.
    inertia: (f32, f32),
}

impl Mapper {
    /// A mapper of `robot` that has seen nothing yet.
    #[must_use]
    pub fn new(robot: &Robot) -> Self {
        let mut state = Vec::new();
        for _ in &robot.channels {
            // There is room for a state a channel.
            let _ = state.push(0.0);
        }
        Mapper { state, ground: 0.0, fresh: true }
    }

    /// Servo angles for `pose`, degrees, in the robot's order of channels, inside the ranges. `robot` is the one that the mapper was made for.
    #[inline(never)]
    pub fn map(&mut self, robot: &Robot, pose: &Pose) -> Vec<f32, MAX_CHANNELS> {
        let observed = Orientations::observe(pose);
        let height = pose.first().map_or(0.0, |root| root[1]);
        if self.fresh {
            self.ground = height;
        }
        let mut reached = observed;
        for segment in &SEGMENTS {
            let base = match segment.joint {
                Joint::Pelvis => Rotation::new(UP, observed.heading),
                _ => reached.get(segment.base),
            };
            let mut turns = self.turns(robot, segment.joint);
            let orientation = if turns.is_empty() {
                follow(&observed, segment, &reached)
            } else {
                let rounds = if self.fresh { FIRST_ROUNDS } else { ROUNDS };
                base * search(&mut turns, segment, base.inverse() * observed.get(segment.joint), rounds)
            };
            for turn in &turns {
                if let Some(state) = self.state.get_mut(turn.channel) {
                    *state = turn.angle;
                }
            }
            reached.set(segment.joint, orientation);
        }
        let mut angles = Vec::new();
        for (state, channel) in self.state.iter_mut().zip(&robot.channels) {
            match channel.source {
                Source::Heading => *state += nearest_turn(observed.heading - *state),
                Source::Height => *state = height - self.ground,
                Source::Joint(..) | Source::Still => {}
            }
            // As many as there are channels.
            let _ = angles.push(channel.angle(*state));
        }
        self.fresh = false;
        angles
    }

    /// The axes that turn `joint`, each with the angle that it had.
    #[inline(never)]
    fn turns(&self, robot: &Robot, joint: Joint) -> Vec<Turn, MAX_AXES> {
        let mut turns = Vec::new();
        for (channel, (servo, state)) in robot.channels.iter().zip(&self.state).enumerate() {
            if let Source::Joint(number, axis) = servo.source
                && usize::from(number) == joint.index()
            {
                let (sin, cos) = crate::numerics::angle::sin_cos(*state);
                let inertia = if self.fresh { 0.0 } else { INERTIA };
                let turn = Turn {
                    channel,
                    axis: axis.vector(),
                    range: servo.source_range(),
                    angle: *state,
                    inertia: (inertia * sin, inertia * cos),
                };
                // A joint has no more than three different axes.
                let _ = turns.push(turn);
            }
        }
        turns
    }
}

/// The pose that the robot's body takes when the motion's is `pose` and its servos have these angles, degrees: forward kinematics with
/// the motion's own bones. What no servo turns is as the motion says, on what carries it.
#[must_use]
#[inline(never)]
pub fn reach(robot: &Robot, pose: &Pose, angles: &[f32]) -> Pose {
    let observed = Orientations::observe(pose);
    let mut reached = observed;
    for segment in &SEGMENTS {
        let mut turned = None;
        for (channel, angle) in robot.channels.iter().zip(angles) {
            if let Source::Joint(number, axis) = channel.source
                && usize::from(number) == segment.joint.index()
            {
                let turn = Rotation::new(axis.vector(), channel.source_angle(*angle));
                turned = Some(turned.map_or(turn, |before| before * turn));
            }
        }
        let orientation = match (turned, segment.joint) {
            (None, _) => follow(&observed, segment, &reached),
            (Some(turn), Joint::Pelvis) => Rotation::new(UP, observed.heading) * turn,
            (Some(turn), _) => reached.get(segment.base) * turn,
        };
        reached.set(segment.joint, orientation);
    }
    reached.pose(pose, &observed)
}

/// A segment that no servo turns: as observed, on what carries it.
fn follow(observed: &Orientations, segment: &Segment, reached: &Orientations) -> Rotation {
    match segment.joint {
        Joint::Pelvis => observed.get(Joint::Pelvis),
        joint => reached.get(segment.base) * observed.get(segment.base).inverse() * observed.get(joint),
    }
}

/// Finds the angles with which `turns` come nearest to `target`, and what they then make.
#[inline(never)]
fn search(turns: &mut [Turn], segment: &Segment, target: Rotation, rounds: usize) -> Rotation {
    // Without a direction aside the twist is that of the shortest arc: nothing to be kept.
    let aside = match segment.aside {
        Aside::Line(..) => Some([1.0, 0.0, 0.0]),
        Aside::Bend(_, _, towards) => Some(towards),
        Aside::Nothing => None,
    };
    let along = (segment.rest, target.apply(segment.rest));
    let aside = aside.map(|rest| (rest, scale(target.apply(rest), TWIST)));
    for _ in 0..rounds {
        for chosen in 0..turns.len() {
            let (before, behind) = (product(turns, 0..chosen), product(turns, chosen + 1..turns.len()));
            let Some(turn) = turns.get_mut(chosen) else { continue };
            // w . R(a, theta) v = sin(theta) (a . v x w) + cos(theta) (v . w - (a . v)(a . w)) + a constant.
            let (mut sine, mut cosine) = turn.inertia;
            for (rest, seen) in [Some(along), aside].into_iter().flatten() {
                let (v, w, a) = (behind.apply(rest), before.inverse().apply(seen), turn.axis);
                sine += dot(a, cross(v, w));
                cosine += dot(v, w) - dot(a, v) * dot(a, w);
            }
            // A bone along the axis says nothing about the angle.
            if sine * sine + cosine * cosine > 1e-8 {
                turn.angle = inside(libm::atan2f(sine, cosine), turn.range);
            }
        }
    }
    product(turns, 0..turns.len())
}

#[inline(never)]
fn product(turns: &[Turn], which: core::ops::Range<usize>) -> Rotation {
    let mut product = Rotation::IDENTITY;
    for turn in turns.get(which).unwrap_or(&[]) {
        product = product * Rotation::new(turn.axis, turn.angle);
    }
    product
}

/// The same angle within half a turn; of an angle within some turns.
fn nearest_turn(angle: f32) -> f32 {
    let turns = angle * (0.5 / PI);
    let whole = (if turns < 0.0 { turns - 0.5 } else { turns + 0.5 }) as i32;
    angle - whole as f32 * (2.0 * PI)
}

/// The angle of `range` at which a servo points most nearly as at `angle`, both radians.
#[inline(never)]
fn inside(angle: f32, [low, high]: [f32; 2]) -> f32 {
    let mut best = low;
    let mut least = f32::INFINITY;
    for turned in [angle - 2.0 * PI, angle, angle + 2.0 * PI] {
        let kept = if turned < low {
            low
        } else if turned > high {
            high
        } else {
            turned
        };
        let off = nearest_turn(angle - kept).abs();
        if off < least {
            (best, least) = (kept, off);
        }
    }
    best
}

impl Channel {
    /// Servo angle, degrees, when the source is at `source` (radians, metres for a height): inside the range.
    #[inline(never)]
    fn angle(&self, source: f32) -> f32 {
        let [low, high] = self.range;
        let degrees = self.neutral
            + match self.source {
                Source::Joint(..) | Source::Heading => self.gain * source * (180.0 / PI),
                Source::Height => self.gain * source,
                Source::Still => 0.0,
            };
        if degrees.is_nan() {
            self.neutral
        } else if degrees < low {
            low
        } else if degrees > high {
            high
        } else {
            degrees
        }
    }

    /// What the source is at, radians, when the servo is at `angle`, degrees.
    fn source_angle(&self, angle: f32) -> f32 {
        (angle - self.neutral) / self.gain * (PI / 180.0)
    }

    /// Angles of a joint, radians, that the servo's range leaves, at most a turn either way.
    fn source_range(&self) -> [f32; 2] {
        let [a, b] = self.range.map(|end| self.source_angle(end));
        let (low, high) = if a < b { (a, b) } else { (b, a) };
        [if low > -PI { low } else { -PI }, if high < PI { high } else { PI }]
    }
}
