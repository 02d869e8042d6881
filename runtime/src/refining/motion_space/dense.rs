//! Rows at any number of frames: tracks, which say where joints are, and obstacles, which say where they are not.
//!
//! A track follows its joint through the frames; all tracks together are met in time that grows with frames and tracks alone, by the smoother: the
//! root's path and height take what the tracks share, each part the rest, and again on what is left, since limbs are not linear. Each row
//! has a noise of its own: without one it is hard, with one it takes its share of the prior. An obstacle is a row of those frames in
//! which a joint is inside, or would be but for the row.

use super::edit::{Edit, HEIGHT};
use super::obstacles::Obstacle;
use super::parts::Part;
use super::place;
use super::smoother::{Process, Seen, Smoother};
use crate::memory::{Arena, ArenaTooSmall};
use crate::numerics::vector::{Vector, add, dot, length, scale, subtract, unit};
use crate::representation::Pose;
use crate::request::conditions::AnchorSet;
use heapless::Vec;

pub use super::edit::TRACKS;
/// Repetitions at most.
const ROUNDS: u16 = 8;
/// And at least: soft rows are never met.
const LEAST_ROUNDS: u16 = 2;
/// Rows are met when nothing is farther off than this, metres.
const MET: f32 = 0.0005;
/// No row asks for more at a time, metres.
const MOST: f32 = 0.5;
/// What the root's path varies by over many frames, square metres a frame.
const PATH_GROWTH: f32 = 0.01;
/// Over so many frames velocities of the path, heights and ways of parts go together.
const LENGTH: f32 = 6.0;
/// Most obstacles in the way, each time counted.
const PASSES: usize = 16;
/// A joint that goes farther through an obstacle than this passes it, metres.
const PASSED: f32 = 0.1;
/// A way up or down counts so many times more: bodies stand on the floor, and arms hang down straight.
const LESS_UPRIGHT: f32 = 3.0;
/// From one repetition to the next a part goes so much less of its own way, and the root so much more.
const YIELD: f32 = 0.5;
/// Least standard deviation of a part's own way, metres: what has none leaves everything to the root.
const LEAST_WAY: f32 = 1e-3;

/// What is wanted of a joint at a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// Where it is to be, metres.
    pub place: Vector,
    /// Which of x, y, z that counts for.
    pub axes: [bool; 3],
    /// How loosely: the variance around it, square metres; 0 is as hard as can be.
    pub noise: f32,
}

/// A joint with rows.
pub struct Track<'r> {
    /// Which joint, 0 to 21.
    pub joint: u8,
    /// Where it is to be at a frame; nothing where it is free.
    pub wanted: &'r dyn Fn(usize) -> Option<Wanted>,
}

/// An obstacle by frame; nothing where it is not there.
pub type Moving<'r> = &'r dyn Fn(usize) -> Option<Obstacle>;

/// All rows.
pub struct Rows<'r> {
    /// The joints, at most [`TRACKS`], each once; others are left alone, and obstacles count for these only.
    pub tracks: &'r [Track<'r>],
    /// Obstacles.
    pub obstacles: &'r [Moving<'r>],
}

/// What is left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Left {
    /// Largest distance of a joint from where it is wanted, over hard rows, metres.
    pub off: f32,
    /// Least distance of a joint beyond an obstacle's margin, metres; negative inside, infinite without obstacles.
    pub clearance: f32,
    /// Repetitions.
    pub rounds: u16,
}

/// Everything that [`follow`] works in.
#[derive(Debug)]
pub struct DenseScratch<'a> {
    edit: Edit<'a>,
    smoother: Smoother<'a, 1>,
    smoothed: &'a mut [[f32; 1]],
    /// Way and noise of each frame's [`Lack`].
    lacks: &'a mut [[Vector; 2]],
}

impl<'a> DenseScratch<'a> {
    /// For motions of `frames` frames and so many tracks.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn take(frames: usize, tracks: usize, arena: &mut Arena<'a>) -> Result<Self, ArenaTooSmall> {
        let edit = Edit::take(frames, 0, tracks, arena)?;
        let (smoother, smoothed) = (Smoother::take(frames, arena)?, arena.take(frames)?);
        Ok(DenseScratch { edit, smoother, smoothed, lacks: arena.take(frames)? })
    }
}

/// What is lacking at a frame on each axis, metres, and its variance, square metres; infinite where nothing is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Lack {
    way: Vector,
    noise: Vector,
}

impl Lack {
    const NONE: Self = Lack { way: [0.0; 3], noise: [f32::INFINITY; 3] };
}

/// Edits a motion until its rows are met, in place. `poses`: `[T]`, metres, as many frames as `scratch` was taken for; of `rows` as many
/// tracks.
pub fn follow(poses: &mut [Pose], rows: &Rows<'_>, planted: bool, scratch: &mut DenseScratch<'_>) -> Left {
    let DenseScratch { edit, smoother, smoothed, lacks } = scratch;
    edit.begin(poses, &AnchorSet::EMPTY, planted);
    for (slot, track) in edit.tracks.parts.iter_mut().zip(rows.tracks) {
        *slot = Part::alone(track.joint);
    }
    let passes = &passes(poses, rows);
    let mut left = View { poses, rows, edit, passes }.left(0);
    let mut soft = 1.0;
    while left.rounds < LEAST_ROUNDS || left.rounds < ROUNDS && (left.off > MET || left.clearance < -MET) {
        for who in core::iter::once(None).chain((0..rows.tracks.len()).map(Some)) {
            let view = View { poses, rows, edit, passes };
            for (frame, slot) in lacks.iter_mut().enumerate() {
                let Lack { way, noise } = view.lack_of(who, soft, frame);
                *slot = [way, noise];
            }
            let own_way = who.map_or([0.0; 2], |index| edit.tracks.part(index).own_way());
            for axis in 0..3 {
                let process = match (who, axis) {
                    (None, 1) => Process::own(HEIGHT, LENGTH),
                    (None, _) => Process::path(PATH_GROWTH, LENGTH),
                    (Some(_), _) => {
                        let [floor, height] = own_way;
                        let deviation = if axis == 1 { height } else { floor };
                        if !(deviation > LEAST_WAY) {
                            continue;
                        }
                        Process::own(deviation, LENGTH)
                    }
                };
                let ways = edit.tracks.ways(who);
                let seen = |frame: usize| {
                    let of = |vector: Vector| vector.get(axis).copied().unwrap_or(0.0);
                    let [lack, noise] = *lacks.get(frame)?;
                    let (way, noise) = (of(ways.get(frame).copied().unwrap_or_default()) + of(lack), of(noise));
                    (noise < f32::INFINITY).then_some(Seen { way: [way], noise })
                };
                smoother.smooth(&process, seen, smoothed);
                for (slot, [way]) in edit.tracks.ways_mut(who).iter_mut().zip(smoothed.iter()) {
                    if let Some(slot) = slot.get_mut(axis) {
                        *slot = *way;
                    }
                }
            }
            if who.is_none() {
                edit.build(poses, &AnchorSet::EMPTY);
            }
        }
        left = View { poses, rows, edit, passes }.left(left.rounds + 1);
        soft *= YIELD;
    }
    for (frame, pose) in poses.iter_mut().enumerate() {
        *pose = edit.apply(pose, frame);
    }
    left
}

/// An obstacle in the way of the motion as it was generated: from which frame to which, and to which side all joints pass it.
#[derive(Debug, Clone, Copy)]
struct Pass {
    obstacle: usize,
    first: usize,
    last: usize,
    side: Vector,
}

/// Where obstacles are in the way, the first [`PASSES`] times.
fn passes(poses: &[Pose], rows: &Rows<'_>) -> Vec<Pass, PASSES> {
    let mut passes = Vec::new();
    for (number, obstacle) in rows.obstacles.iter().enumerate() {
        let inside = |t: usize, joint: u8| {
            let at = place(poses.get(t), joint);
            obstacle(t).filter(|body| t < poses.len() && body.clearance(at) < 0.0).map(|body| (body, at))
        };
        let any = |t: usize| rows.tracks.iter().any(|track| inside(t, track.joint).is_some());
        let mut t = 0;
        while t < poses.len() {
            let first = t;
            while any(t) {
                t += 1;
            }
            if t > first {
                let side = side(rows, &inside, (first, t - 1));
                // One more than there is room for is passed as that obstacle's nearest pass, or straight away from it.
                let _ = passes.push(Pass { obstacle: number, first, last: t - 1, side });
            }
            t += 1;
        }
    }
    passes
}

/// To which side joints that are inside an obstacle between two frames leave it: the one in which the joint that has the longest way out has
/// the shortest: across the way on which it is passed, over or below it, or straight away from where one is deepest.
fn side(
    rows: &Rows<'_>,
    inside: &dyn Fn(usize, u8) -> Option<(Obstacle, Vector)>,
    (first, last): (usize, usize),
) -> Vector {
    // Of each joint where it is deepest, and its way through, seen from the obstacle, which may move.
    let mut deepest: Vec<(f32, Obstacle, Vector), TRACKS> = Vec::new();
    let mut travel = [0.0; 3];
    for track in rows.tracks {
        let mut own: Option<(f32, Obstacle, Vector)> = None;
        let mut entered = None;
        for t in first..=last {
            let Some((body, at)) = inside(t, track.joint) else { continue };
            let seen = subtract(at, body.middle);
            let way = subtract(seen, *entered.get_or_insert(seen));
            travel = if t == last || dot(way, way) > dot(travel, travel) { way } else { travel };
            let clearance = body.clearance(at);
            if own.is_none_or(|(least, ..)| clearance < least) {
                own = Some((clearance, body, at));
            }
        }
        if let Some(own) = own {
            // There is room for every track.
            let _ = deepest.push(own);
        }
    }
    let mut least = (f32::INFINITY, [0.0; 3]);
    let [x, _, z] = travel;
    let across = unit([z, 0.0, -x], [0.0; 3]);
    let away = deepest.first().map_or([0.0; 3], |(_, body, at)| body.away(*at));
    for direction in [across, scale(across, -1.0), [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], away] {
        // Back along one's own way is no way past.
        let along = dot(direction, unit(travel, [0.0; 3]));
        if dot(direction, direction) < 0.5 || dot(travel, travel) > PASSED * PASSED && along * along > 0.5 {
            continue;
        }
        let [_, up, _] = direction;
        let worth = 1.0 + LESS_UPRIGHT * libm::fabsf(up);
        let mut longest = 0.0;
        for (_, body, at) in &deepest {
            let way = worth * body.way_out(*at, direction).unwrap_or(f32::INFINITY);
            longest = if way > longest { way } else { longest };
        }
        if longest < least.0 {
            least = (longest, direction);
        }
    }
    least.1
}

/// A motion, its rows, and what was added so far.
struct View<'s, 'a> {
    poses: &'s [Pose],
    rows: &'s Rows<'s>,
    edit: &'s Edit<'a>,
    passes: &'s [Pass],
}

impl View<'_, '_> {
    fn joint(&self, joint: u8, frame: usize) -> Vector {
        place(self.poses.get(frame).map(|pose| self.edit.apply(pose, frame)).as_ref(), joint)
    }

    /// To which side an obstacle is passed at a frame: as the pass says that is nearest in time; nowhere without one.
    fn side(&self, obstacle: usize, frame: usize) -> Vector {
        let mut nearest = (usize::MAX, [0.0; 3]);
        for pass in self.passes.iter().filter(|pass| pass.obstacle == obstacle) {
            let before = pass.first.saturating_sub(frame);
            let away = before + frame.saturating_sub(pass.last);
            if away < nearest.0 {
                nearest = (away, pass.side);
            }
        }
        nearest.1
    }

    /// What a joint lacks; `way` is what has been added to it by whoever is to be found anew.
    fn lack(&self, track: &Track<'_>, frame: usize, way: Vector) -> Lack {
        let at = self.joint(track.joint, frame);
        let mut lack = Lack::NONE;
        if let Some(Wanted { place, axes, noise }) = (track.wanted)(frame) {
            let off = subtract(place, at);
            let slots = lack.way.iter_mut().zip(lack.noise.iter_mut());
            for ((way, loose), (counts, off)) in slots.zip(axes.into_iter().zip(off)) {
                if counts {
                    (*way, *loose) = (off, if noise > 0.0 { noise } else { 0.0 });
                }
            }
        }
        for (index, obstacle) in self.rows.obstacles.iter().enumerate() {
            let Some(body) = obstacle(frame) else { continue };
            // Whoever has been taken out stays where that led.
            if body.clearance(at) < 0.0 || body.clearance(subtract(at, way)) < 0.0 {
                lack.way = add(lack.way, body.push(at, self.side(index, frame)));
                lack.noise = [0.0; 3];
            }
        }
        let far = length(lack.way);
        if far > MOST {
            lack.way = scale(lack.way, MOST / far);
        }
        lack
    }

    /// What the root lacks, or a track's part. The root takes the mean of all tracks, each by how surely it asks that of the root: the more
    /// the less its part goes itself, of which `soft` is left.
    fn lack_of(&self, who: Option<usize>, soft: f32, frame: usize) -> Lack {
        let way = self.edit.tracks.ways(who).get(frame).copied().unwrap_or_default();
        if let Some(index) = who {
            return self.rows.tracks.get(index).map_or(Lack::NONE, |track| self.lack(track, frame, way));
        }
        let mut shared = Lack::NONE;
        let mut weights: Vector = [0.0; 3];
        for (index, track) in self.rows.tracks.iter().enumerate() {
            let lack = self.lack(track, frame, way);
            let [floor, height] = self.edit.tracks.part(index).own_way();
            let slots = shared.way.iter_mut().zip(&mut weights);
            for (((sum, weight), (way, noise)), own) in
                slots.zip(lack.way.iter().zip(lack.noise)).zip([floor, height, floor])
            {
                let own = if soft * own > LEAST_WAY { soft * own } else { LEAST_WAY };
                *sum += way / (own * own + noise);
                *weight += 1.0 / (own * own + noise);
            }
        }
        for ((sum, noise), weight) in shared.way.iter_mut().zip(&mut shared.noise).zip(weights) {
            if weight > 0.0 {
                (*sum, *noise) = (*sum / weight, 1.0 / weight);
            }
        }
        shared
    }

    /// What is left of all rows.
    fn left(&self, rounds: u16) -> Left {
        let mut left = Left { off: 0.0, clearance: f32::INFINITY, rounds };
        for frame in 0..self.poses.len() {
            for track in self.rows.tracks {
                let at = self.joint(track.joint, frame);
                if let Some(Wanted { place, axes, noise }) = (track.wanted)(frame)
                    && !(noise > 0.0)
                {
                    let mut off = subtract(place, at);
                    for (off, counts) in off.iter_mut().zip(axes) {
                        *off = if counts { *off } else { 0.0 };
                    }
                    left.off = if length(off) > left.off { length(off) } else { left.off };
                }
                for obstacle in self.rows.obstacles {
                    let clearance = obstacle(frame).map_or(f32::INFINITY, |body| body.clearance(at));
                    left.clearance = if clearance < left.clearance { clearance } else { left.clearance };
                }
            }
        }
        left
    }
}
