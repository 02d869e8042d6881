//! Anchors met in the motion itself, without the decoder.
//!
//! A generated motion is edited as an animator would: the root's path bends as little and as slowly as its anchors allow, feet stay where
//! they stood, limbs take what the root leaves. The edit is the most probable one under a Gaussian prior on edits of velocity, so that it is a
//! sum of smooth functions, one an anchor, found by one linear system of as many unknowns; what is not linear in it, limbs and feet, is
//! brought in by repeating the solution on what is left.
//!
//! # Layers
//! - `covariance`: how edits at different frames go together.
//! - `cholesky`: the linear systems.
//! - `smoother`: the same for dense tracks, in time that grows with the frames alone.
//! - `rows`: what tracks, obstacles and the anchors beside them ask of each joint.
//! - `passes`: to which side obstacles are passed.
//! - `dense`: meets these rows; a request without tracks and obstacles does without it. `followed`: what came of them.
//! - `heading`: bodies that rows lead elsewhere turn to where they go.
//! - `stances`: when feet stand, and how offsets go from one stance to the next.
//! - `parts`: which part of the body moves for which anchor.
//! - `strain`: how far the edit takes a motion from what was generated.
//! - `edit`: all that is added to a motion; a frame at a time, so that no second motion is in memory.
//!
//! # Numerics
//! `f32`, single operations in the order written. Whatever anchors are asked for, the result is finite: a system's pivots that are lost to
//! rounding drop their unknown.

mod cholesky;
mod covariance;
pub mod dense;
mod edit;
mod followed;
mod heading;
mod parts;
mod passes;
pub mod rows;
pub mod smoother;
mod stances;
mod strain;
#[cfg(test)]
mod tests;

use crate::memory::{Arena, ArenaTooSmall};
use crate::numerics::vector::{Vector, add, length, scale, subtract};
use crate::refining::ControlError;
use crate::refining::terms::anchors::Distances;
use crate::representation::Pose;
use crate::request::conditions::{AnchorSet, MAX_ANCHORS};
use cholesky::{Cholesky, triangle};
use edit::{Edit, HEIGHT, Point, TAIL};
pub use followed::{Clearance, Followed, TrackingError};
use parts::{Part, Side};
pub use strain::Strain;
use strain::Tally;

/// Repetitions at most, while an anchor is not met.
const ROUNDS: u16 = 6;
/// And more of them, while anchors that ask for too much speed are loosened.
const MORE_ROUNDS: u16 = 16;
/// An anchor is met when it is no farther off than this, metres.
const MET: f32 = 0.0005;
/// Share of the diagonal's mean that is added to it in the systems of path and height.
const RIDGE: f32 = 2e-5;
/// The same of the parts' own ways.
const OWN_RIDGE: f32 = 1e-3;
/// Of an anchor that is not met, a part takes so much less, and the root so much more.
const YIELD: f32 = 0.1;
/// The parts take what is left so often before the root is asked again: feet and clamps move what they have just met.
const SWEEPS: usize = 2;
/// Anchors so near to a frame that is too fast are loosened, frames.
const NEAR: usize = 8;
/// A loose anchor's noise, at first, as a share of its signal.
const LOOSE: f32 = 0.02;
/// It grows by so much at a time, at least.
const LEAST: f32 = 1.2;
/// Looser than this is not there at all; single precision can still tell it from infinity.
const LOOSEST: f32 = 1e6;
/// Least speed that is added, metres a frame; less, and what is no number, counts as this.
const LEAST_STEP: f32 = 0.001;

/// What steers the edit.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Exact {
    /// Speed that root and limb together may have beyond the generated motion's, metres a second. Anchors that ask for more are met
    /// as far as this allows. Less than a millimetre a frame counts as that.
    pub added_speed: f32,
    /// Whether feet stay where they stand and none is below the floor, with anchors and without.
    pub planted: bool,
}

impl Exact {
    /// 5 m/s, planted feet.
    pub const DEFAULT: Self = Self { added_speed: 5.0, planted: true };

    /// The way that may be added from a frame to the next, metres.
    fn step(&self, frame_rate: u16) -> f32 {
        let step = self.added_speed / f32::from(if frame_rate > 0 { frame_rate } else { 1 });
        if step > LEAST_STEP { step } else { LEAST_STEP }
    }
}

impl Default for Exact {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What came of it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Edited {
    /// Distance of the generated motion from its anchors; `None` without anchors.
    pub before: Option<ControlError>,
    /// Distance of the edited one.
    pub after: Option<ControlError>,
    /// Repetitions.
    pub rounds: u16,
    /// Anchors that were loosened, because they ask for too much speed.
    pub loosened: u16,
    /// How much the anchors asked of the motion.
    pub strain: Strain,
    /// What came of tracks and obstacles; `None` without them.
    pub followed: Option<Followed>,
}

/// Everything that [`solve`] works with.
#[derive(Debug)]
pub struct Scratch<'a> {
    edit: Edit<'a>,
    /// The triangle of a system.
    system: &'a mut [f32],
}

impl<'a> Scratch<'a> {
    /// For motions of `frames` frames and so many anchors.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    // One of it for measuring and taking.
    #[inline(never)]
    pub fn take(frames: usize, anchors: usize, arena: &mut Arena<'a>) -> Result<Self, ArenaTooSmall> {
        let edit = Edit::take(frames, anchors, 0, arena)?;
        Ok(Scratch { edit, system: arena.take(triangle(anchors + TAIL))? })
    }
}

/// Edits a motion until it meets its anchors, in place. `poses`: `[T]` joints, metres, as many frames as `scratch` was taken for;
/// `frame_rate` in 1/s.
pub fn solve(
    poses: &mut [Pose],
    anchors: &AnchorSet,
    settings: &Exact,
    frame_rate: u16,
    scratch: &mut Scratch<'_>,
) -> Edited {
    let Scratch { edit, system } = scratch;
    edit.begin(poses, anchors, settings.planted);
    let step = settings.step(frame_rate);
    let mut edited = Solver { poses, anchors, step, edit, system }.run();
    if !anchors.is_empty() || settings.planted {
        edited.strain.value = carry_out(poses, edit, frame_rate);
    }
    edited
}

/// Edits each pose, but for what is beyond all measure; how far that takes the motion from what was generated.
fn carry_out(poses: &mut [Pose], edit: &Edit<'_>, frame_rate: u16) -> f32 {
    let mut tally = Tally::new(frame_rate);
    for (frame, pose) in poses.iter_mut().enumerate() {
        let moved = edit.apply(pose, frame);
        if tally.add(pose, &moved) {
            *pose = moved;
        }
    }
    tally.value()
}

/// A solution in the making.
struct Solver<'s, 'a> {
    poses: &'s [Pose],
    anchors: &'s AnchorSet,
    /// Way that may be added from a frame to the next, metres.
    step: f32,
    edit: &'s mut Edit<'a>,
    system: &'s mut &'a mut [f32],
}

impl Solver<'_, '_> {
    fn run(&mut self) -> Edited {
        let strain = Strain { value: 0.0, anchor: 0 };
        let mut edited = Edited { before: None, after: None, rounds: 0, loosened: 0, strain, followed: None };
        if self.anchors.is_empty() {
            return edited;
        }
        let before = Distances::of(self.anchors, &|joint, frame| place(self.poses.get(frame), joint));
        let before = before.control_error(self.anchors);
        (edited.before, edited.strain.anchor) = (Some(before), before.worst_anchor);
        let mut missing = [[0.0; 3]; MAX_ANCHORS];
        let mut distances = self.lacks(&mut missing);
        while edited.rounds < MORE_ROUNDS {
            let off = |(error, point): (&f32, &Point)| *error > MET && point.loose == 0.0;
            let open = distances.errors.iter().zip(self.edit.points()).any(off);
            if (!open || edited.rounds >= ROUNDS) && !self.loosen() {
                break;
            }
            if edited.rounds > 0 {
                for (point, error) in self.edit.points_mut().iter_mut().zip(&distances.errors) {
                    point.soft *= if *error > MET && point.loose == 0.0 { YIELD } else { 1.0 };
                }
            }
            self.round(&missing);
            edited.rounds += 1;
            distances = self.lacks(&mut missing);
        }
        if self.edit.settle(self.poses, self.anchors, &missing) {
            self.sweep();
            distances = self.lacks(&mut missing);
        }
        edited.loosened = self.edit.points().iter().filter(|point| point.loose > 0.0).count() as u16;
        edited.after = Some(distances.control_error(self.anchors));
        edited
    }

    /// Distances of the edited motion, and what is missing at each anchor, metres; never more than speed allows from the first frame on, and so
    /// finite whatever is asked for.
    fn lacks(&self, missing: &mut [Vector; MAX_ANCHORS]) -> Distances {
        let mut distances = Distances::NONE;
        for ((slot, error), anchor) in missing.iter_mut().zip(&mut distances.errors).zip(self.anchors.iter()) {
            let frame = usize::from(anchor.frame);
            let at = self.poses.get(frame).map(|pose| self.edit.joint(pose, frame, anchor.joint));
            let whole = scale(anchor.residual(at.unwrap_or_default()), -1.0);
            let (far, most) = (length(whole), self.step * (frame + NEAR) as f32);
            distances.squares += far * far;
            *error = far;
            *slot = if far > most { scale(whole, most / far) } else { whole };
        }
        distances
    }

    /// One repetition: path and height take their share of what is missing, then the parts what is left.
    fn round(&mut self, missing: &[Vector; MAX_ANCHORS]) {
        let count = self.anchors.len();
        let system = &mut *self.system;
        let edit = &mut *self.edit;
        let mut path = edit.lacks_of_path(missing);
        let path = part_mut!(path, ..count + TAIL);
        Cholesky::new(system, count + TAIL, RIDGE, &|i, j| edit.of_path(i, j)).solve(path.as_flattened_mut(), 2);
        let mut heights = [[0.0]; MAX_ANCHORS];
        let points = edit.points().iter().zip(edit.heights.iter()).zip(missing);
        for (slot, ((point, [weight]), [_, y, _])) in heights.iter_mut().zip(points) {
            *slot = [y - point.loose * weight];
        }
        let heights = part_mut!(heights, ..count);
        Cholesky::new(system, count, RIDGE, &|i, j| edit.of_height(i, j)).solve(heights.as_flattened_mut(), 1);
        for (weight, [x, z]) in edit.weights.iter_mut().zip(path) {
            *weight = [weight[0] + *x, weight[1] + *z];
        }
        for ([weight], [height]) in edit.heights.iter_mut().zip(heights) {
            *weight += HEIGHT * HEIGHT * *height;
        }
        edit.build(self.poses, self.anchors);
        self.sweep();
    }

    /// The parts take what is left.
    fn sweep(&mut self) {
        let count = self.anchors.len();
        for _ in 0..SWEEPS {
            let mut missing = [[0.0; 3]; MAX_ANCHORS];
            self.lacks(&mut missing);
            for (slot, (point, own)) in missing.iter_mut().zip(self.edit.points().iter().zip(self.edit.own.iter())) {
                let lack = if point.part == Part::Body { [0.0; 3] } else { *slot };
                *slot = subtract(lack, scale(*own, point.loose));
            }
            let edit = &*self.edit;
            let factor = Cholesky::new(self.system, count, OWN_RIDGE, &|i, j| edit.of_own(i, j));
            factor.solve(part_mut!(missing, ..count).as_flattened_mut(), 3);
            for (own, missing) in self.edit.own.iter_mut().zip(missing) {
                *own = add(*own, missing);
            }
        }
    }

    /// Loosens the anchors that ask for more speed than there may be; whether there are any.
    fn loosen(&mut self) -> bool {
        // How many times too fast the frames around an anchor are; 0 where they are not.
        let mut excess = [0.0f32; MAX_ANCHORS];
        let edit = &*self.edit;
        let mut blame = |(from, to): (usize, usize), way: Vector, guilty: &dyn Fn(Part) -> bool| {
            let times = length(way) / self.step;
            for (excess, point) in excess.iter_mut().zip(edit.points()) {
                let there = point.frame + NEAR >= from && point.frame <= to + NEAR;
                if times > 1.0 && times > *excess && there && guilty(point.part) {
                    *excess = times;
                }
            }
        };
        let points = || edit.points().iter().enumerate();
        let mut before = [[0.0; 3]; MAX_ANCHORS];
        for t in 0..self.poses.len() {
            // Each part once, whatever the number of its anchors.
            let first = |(index, point): &(usize, &Point)| {
                point.part != Part::Body
                    && edit.points().iter().position(|other| other.part == point.part) == Some(*index)
            };
            let path = if t > 0 { subtract(edit.shift(t), edit.shift(t - 1)) } else { [0.0; 3] };
            let mut ankles = [path; 2];
            for ((_, point), before) in points().zip(&mut before).filter(|(point, _)| first(point)) {
                let way = edit.way(t, &|other| other == point.part);
                let along = add(path, subtract(way, *before));
                *before = way;
                if t > 0 {
                    blame((t, t), along, &|part| part == point.part);
                }
                for (ankle, side) in ankles.iter_mut().zip([Side::Left, Side::Right]) {
                    *ankle = if point.part == Part::Ankle(side) { along } else { *ankle };
                }
            }
            if t == 0 {
                continue;
            }
            // Where the path itself is fast, the anchors near by pull at it, or, where there are none, those before and behind.
            if 2.0 * length(path) > self.step {
                let frames = || edit.points().iter().map(|point| point.frame);
                let before = frames().rfind(|frame| *frame <= t).unwrap_or(t);
                let behind = frames().find(|frame| *frame >= t).unwrap_or(t);
                let pullers = match (t - before <= NEAR, behind - t <= NEAR) {
                    (true, false) => (before, before),
                    (false, true) => (behind, behind),
                    _ => (before, behind),
                };
                blame(pullers, path, &|_| true);
            }
            for (side, along) in [Side::Left, Side::Right].into_iter().zip(ankles) {
                let put = add(along, subtract(edit.put(side, t), edit.put(side, t - 1)));
                blame((t, t), put, &|part| part == Part::Ankle(side));
            }
        }
        let mut any = self.edit.ease(self.step);
        for (point, excess) in self.edit.points_mut().iter_mut().zip(excess).filter(|(_, excess)| *excess > 0.0) {
            // Speed falls as noise grows, at most in the same measure.
            let times = if excess > LEAST { excess } else { LEAST };
            let loose = times * if point.loose > 0.0 { point.loose } else { LOOSE };
            point.loose = if loose < LOOSEST { loose } else { LOOSEST };
            any = true;
        }
        any
    }
}

/// Where a joint of a pose is.
fn place(pose: Option<&Pose>, joint: u8) -> Vector {
    pose.and_then(|pose| pose.get(usize::from(joint))).copied().unwrap_or_default()
}
