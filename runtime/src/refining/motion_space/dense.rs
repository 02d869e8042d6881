//! Rows at any number of frames: tracks, which say where joints are, and obstacles, which say where the figure is not.
//!
//! A track follows its joint through the frames; all tracks together are met in time that grows with frames and tracks alone, by the smoother: the
//! root's path and height take what the tracks share, each part the rest, and again on what is left, since limbs are not linear. Each row
//! has a noise of its own: without one it is hard, with one it takes its share of the prior. What a track asks for grows from frame to frame no
//! faster than speed allows. An obstacle is a row of those frames in which a joint or a bone is inside, or would be but for the row; half
//! frames count as well, so that nothing passes through between two.

use super::edit::{Edit, HEIGHT};
use super::followed::{Clearance, Followed, TrackingError};
use super::heading::turn;
use super::parts::Part;
use super::passes::{Pass, SIDEWAYS, UP, over, passes, side_at};
use super::rows::{Led, Mover, Rows, Wanted};
use super::smoother::{Process, Seen, Smoother};
use super::{Edited, Exact, Strain, carry_out, place};
use crate::JOINTS;
use crate::memory::{Arena, ArenaTooSmall};
use crate::numerics::vector::{Vector, add, dot, length, scale, subtract};
use crate::refining::terms::anchors::Distances;
use crate::representation::Pose;
use crate::request::conditions::AnchorSet;

/// Repetitions at most.
const ROUNDS: u16 = 12;
/// And more of them, while an obstacle is not cleared.
const MORE_ROUNDS: u16 = 16;
/// And at least: soft rows are never met.
const LEAST_ROUNDS: u16 = 2;
/// Rows are met when nothing is farther off than this, metres.
const MET: f32 = 0.0005;
/// No row asks a part for more at a time, metres.
const MOST: f32 = 0.5;
/// What the root's path varies by over many frames, square metres a frame.
const PATH_GROWTH: f32 = 0.01;
/// Over so many frames velocities of the path, heights and ways of parts go together.
const LENGTH: f32 = 6.0;
/// So much more than its margin is kept from an obstacle, metres: between half frames a player goes other ways.
const SPARE: f32 = 0.008;
/// From one repetition to the next a part goes so much less of its own way, and the root so much more.
const YIELD: f32 = 0.5;
/// Least standard deviation of a part's own way, metres: what has none leaves everything to the root.
const LEAST_WAY: f32 = 1e-3;
/// Limbs may be off at the first frame by what so many frames of speed make good.
const NEAR: usize = 8;

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
    /// For motions of `frames` frames and so many joints with rows, [`Rows::joints`].
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn take(frames: usize, joints: usize, arena: &mut Arena<'a>) -> Result<Self, ArenaTooSmall> {
        let edit = Edit::take(frames, 0, joints, arena)?;
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

/// Edits a motion until its rows are met, in place. `poses`: `[T]`, metres, as many frames as `scratch` was taken for, and as many joints as
/// `rows` has.
pub fn follow(poses: &mut [Pose], rows: &Rows<'_>, settings: &Exact, scratch: &mut DenseScratch<'_>) -> Edited {
    let DenseScratch { edit, smoother, smoothed, lacks } = scratch;
    edit.begin(poses, &AnchorSet::EMPTY, settings.planted);
    let movers = &rows.movers();
    edit.tracks.set(movers);
    let step = settings.step(rows.frame_rate);
    let passes = &passes(poses, rows, movers);
    let before = View { poses, rows, movers, edit, passes, step };
    let distances = |view: &View<'_, '_>| Distances::of(rows.anchors, &|joint, frame| view.joint(joint, frame));
    let anchors = |view: &View<'_, '_>| (!rows.anchors.is_empty()).then(|| distances(view).control_error(rows.anchors));
    let first = anchors(&before);
    let generated = before.left();
    let mut left = generated;
    let mut hurried = 0;
    let mut soft = 1.0;
    let mut rounds = 0;
    loop {
        let blocked = left.clearance.is_some_and(|clearance| clearance.missing > MET);
        let most = if blocked { MORE_ROUNDS } else { ROUNDS };
        if rounds >= most || rounds >= LEAST_ROUNDS && !blocked && left.off <= MET {
            break;
        }
        for who in core::iter::once(None).chain((0..movers.len()).map(Some)) {
            let own_way = who.map_or([0.0; 2], |index| edit.tracks.part(index).own_way());
            if who.is_some() && own_way.iter().all(|deviation| !(*deviation > LEAST_WAY)) {
                continue;
            }
            let view = View { poses, rows, movers, edit, passes, step };
            let late = view.fill(who, soft, lacks);
            hurried = if who.is_none() { late } else { hurried };
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
                if rounds == 0 {
                    turn(poses, edit.tracks.ways(None));
                    edit.build(poses, &AnchorSet::EMPTY);
                }
            }
        }
        left = View { poses, rows, movers, edit, passes, step }.left();
        rounds += 1;
        soft *= YIELD;
    }
    let after = anchors(&View { poses, rows, movers, edit, passes, step });
    let strained = carry_out(poses, edit, rows.frame_rate);
    let followed = Followed {
        before: generated.tracks,
        after: left.tracks,
        hurried,
        clearance_before: generated.clearance,
        clearance: left.clearance,
    };
    let strain = Strain { value: strained, anchor: first.map_or(0, |before| before.worst_anchor) };
    Edited { before: first, after, rounds, loosened: 0, strain, followed: Some(followed) }
}

/// A motion, its rows, and what was added so far.
struct View<'s, 'a> {
    poses: &'s [Pose],
    rows: &'s Rows<'s>,
    movers: &'s [Mover],
    edit: &'s Edit<'a>,
    passes: &'s [Pass],
    /// Way that may be added from a frame to the next, metres.
    step: f32,
}

/// What is left of all rows.
#[derive(Debug, Clone, Copy)]
struct Left {
    /// Largest distance of a joint from where it is wanted, over hard rows, metres.
    off: f32,
    tracks: Option<TrackingError>,
    clearance: Option<Clearance>,
}

/// What a track asks of its joint, as far as speed allows: it follows with no more than a step a frame.
#[derive(Debug, Clone, Copy)]
struct Pace {
    /// Frame of the last row and what it asked for, metres from where the joint was generated.
    last: (usize, Vector),
}

impl Pace {
    /// What may be asked for at a frame of all of `need`, metres, and whether that is less.
    fn limited(&mut self, frame: usize, need: Vector, step: f32) -> (Vector, bool) {
        let (last, had) = self.last;
        let way = subtract(need, had);
        let (far, most) = (length(way), step * (frame - last) as f32);
        let hurried = far > most;
        let need = if hurried { add(had, scale(way, most / far)) } else { need };
        self.last = (frame, need);
        (need, hurried)
    }
}

impl View<'_, '_> {
    /// The edited pose of a frame, of which the parts that move for `who` count; the last one's behind the end.
    fn pose(&self, frame: usize, who: Option<usize>) -> Pose {
        let last = self.poses.len().saturating_sub(1);
        let frame = if frame < last { frame } else { last };
        let Some(pose) = self.poses.get(frame) else { return [[0.0; 3]; JOINTS] };
        match who.and_then(|index| self.movers.get(index)) {
            Some(mover) => self.edit.applied(pose, frame, Edit::limbs_of(mover.joint)),
            None => self.edit.apply(pose, frame),
        }
    }

    fn joint(&self, joint: u8, frame: usize) -> Vector {
        self.poses.get(frame).map(|pose| self.edit.joint(pose, frame, joint)).unwrap_or_default()
    }

    /// Fills in what the root lacks, or one of the movers, at every frame, and how many positions of tracks speed does not allow.
    #[inline(never)]
    fn fill(&self, who: Option<usize>, soft: f32, lacks: &mut [[Vector; 2]]) -> u16 {
        let mut paces = [Pace { last: (0, [0.0; 3]) }; JOINTS];
        let looks = !self.rows.obstacles().is_empty();
        let mut here = self.pose(0, who);
        let mut before = here;
        let mut hurried = 0;
        for (frame, slot) in lacks.iter_mut().enumerate() {
            let after = if looks || who.is_none() { self.pose(frame + 1, who) } else { here };
            let window = [&before, &here, &after];
            let way = self.edit.tracks.ways(who).get(frame).copied().unwrap_or_default();
            let mut shared = Lack::NONE;
            let mut weights: Vector = [0.0; 3];
            let all = self.movers.iter().zip(&mut paces).enumerate();
            for (index, (mover, pace)) in all.filter(|(index, _)| who.is_none_or(|who| who == *index)) {
                let (lack, late) = self.lack(*mover, frame, window, way, pace);
                hurried = u16::saturating_add(hurried, u16::from(late));
                if who.is_some() {
                    let far = length(lack.way);
                    shared = if far > MOST { Lack { way: scale(lack.way, MOST / far), ..lack } } else { lack };
                    continue;
                }
                // The root takes the mean of all, each by how surely it asks that of the root: the more the less its part goes itself, of
                // which `soft` is left.
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
            if who.is_none() {
                for ((sum, noise), weight) in shared.way.iter_mut().zip(&mut shared.noise).zip(weights) {
                    if weight > 0.0 {
                        (*sum, *noise) = (*sum / weight, 1.0 / weight);
                    }
                }
            }
            *slot = [shared.way, shared.noise];
            before = here;
            here = if looks || who.is_none() { after } else { self.pose(frame + 1, who) };
        }
        hurried
    }

    /// What a mover lacks at a frame, whose pose is the middle one of `window`, and whether speed does not allow all of it; `way` is what has been
    /// added to it by whoever is to be found anew.
    fn lack(
        &self,
        Mover { joint, part, led }: Mover,
        frame: usize,
        window: [&Pose; 3],
        way: Vector,
        pace: &mut Pace,
    ) -> (Lack, bool) {
        let [_, here, _] = window;
        let mut lack = Lack::NONE;
        let mut hurried = false;
        if let Some(Wanted { place: wanted, noise }) = self.rows.wanted(joint, frame) {
            let at = here.get(usize::from(joint)).copied().unwrap_or_default();
            let was = place(self.poses.get(frame), joint);
            let mut need = subtract(wanted, was);
            for (need, noise) in need.iter_mut().zip(noise) {
                *need = if noise < f32::INFINITY { *need } else { 0.0 };
            }
            if part != Part::Body && pace.last.0 == 0 && frame < NEAR {
                // A limb may begin elsewhere.
                pace.last = (0, need);
            }
            (need, hurried) = pace.limited(frame, need, self.step);
            let off = subtract(add(was, need), at);
            for ((way, loose), (noise, off)) in lack.way.iter_mut().zip(&mut lack.noise).zip(noise.into_iter().zip(off))
            {
                if noise < f32::INFINITY {
                    (*way, *loose) = (off, noise);
                }
            }
        }
        if !led.is_empty() {
            self.clear((joint, led), frame, window, way, &mut lack);
        }
        // What is asked of a head is asked of its trunk already.
        (
            lack,
            hurried && !(part == Part::Neck(joint) && self.movers.iter().any(|other| other.part == Part::Lean(joint))),
        )
    }

    /// Adds what obstacles ask for.
    fn clear(&self, (joint, led): (u8, Led), frame: usize, window: [&Pose; 3], way: Vector, lack: &mut Lack) {
        let [before, here, after] = window;
        for (index, obstacle) in self.rows.obstacles().iter().enumerate() {
            let mut longest: Option<Vector> = None;
            let mut spare = f32::INFINITY;
            for (half, other) in [(1, before), (2, here), (3, after)] {
                let Some(halves) = (2 * frame + half).checked_sub(2) else { continue };
                let mut body = obstacle.at(halves, self.rows.frame_rate);
                body.margin += SPARE;
                let pose = &between(here, other);
                let nearest = led.nearest(&body, obstacle.joints, pose, [0.0; 3]);
                // Whoever has been taken out stays out.
                let freed = || led.nearest(&body, obstacle.joints, pose, scale(way, -1.0)).clearance < 0.0;
                if nearest.clearance < 0.0 || dot(way, way) > 0.0 && freed() {
                    let side = side_at(self.passes, index, frame);
                    let mut push = body.push(nearest.point, side, SIDEWAYS);
                    if side == UP {
                        push = add(push, over(&body, add(place(Some(pose), joint), push)));
                    }
                    spare = if nearest.clearance < spare { nearest.clearance } else { spare };
                    if longest.is_none_or(|longest| dot(push, push) > dot(longest, longest)) {
                        longest = Some(push);
                    }
                }
            }
            let Some(push) = longest else { continue };
            // What a track asks for against it does not count.
            let against = dot(lack.way, push);
            let square = dot(push, push);
            if against < 0.0 && square > 0.0 {
                lack.way = subtract(lack.way, scale(push, against / square));
            }
            lack.way = add(lack.way, push);
            // What is farther out than it needs to be may come back by as much.
            let noise = if spare > 0.0 { spare * spare } else { 0.0 };
            lack.noise = lack.noise.map(|other| if noise < other { noise } else { other });
        }
    }

    /// What is left of all rows.
    #[inline(never)]
    fn left(&self) -> Left {
        let mut left = Left { off: 0.0, tracks: None, clearance: None };
        let (mut sum, mut count) = (0.0, 0.0);
        let mut here = self.pose(0, None);
        for frame in 0..self.poses.len() {
            let after = self.pose(frame + 1, None);
            let at = |joint: u8| here.get(usize::from(joint)).copied().unwrap_or_default();
            for anchor in self.rows.anchors.iter().filter(|anchor| usize::from(anchor.frame) == frame) {
                let off = length(anchor.residual(at(anchor.joint)));
                left.off = if off > left.off { off } else { left.off };
            }
            for (index, track) in self.rows.tracks.iter().enumerate() {
                let Some(place) = track.at(frame) else { continue };
                let mut off = subtract(place, at(track.joint));
                for (off, counts) in off.iter_mut().zip(track.axes) {
                    *off = if counts { *off } else { 0.0 };
                }
                let off = length(off);
                (sum, count) = (sum + off, count + 1.0);
                left.off = if off > left.off && !(track.tolerance > 0.0) { off } else { left.off };
                if left.tracks.is_none_or(|tracks| off > tracks.worst) {
                    let (worst_track, worst_frame) = (index as u16, frame as u16);
                    left.tracks = Some(TrackingError { mean: 0.0, worst: off, worst_track, worst_frame });
                }
            }
            for (index, obstacle) in self.rows.obstacles().iter().enumerate() {
                for (half, other) in [(0, &here), (1, &after)] {
                    let body = obstacle.at(2 * frame + half, self.rows.frame_rate);
                    let nearest = Led::ALL.nearest(&body, obstacle.joints, &between(&here, other), [0.0; 3]);
                    let missing = -nearest.clearance;
                    if left.clearance.is_none_or(|clearance| missing > clearance.missing) {
                        left.clearance = Some(Clearance {
                            least: nearest.clearance + obstacle.margin,
                            missing,
                            obstacle: index as u16,
                            joint: nearest.joint,
                            frame: frame as u16,
                        });
                    }
                }
            }
            here = after;
        }
        if let Some(tracks) = &mut left.tracks {
            tracks.mean = sum / count;
        }
        left
    }
}

/// Half way from one pose to another.
fn between(a: &Pose, b: &Pose) -> Pose {
    let mut out = *a;
    for (a, b) in out.iter_mut().zip(b) {
        *a = scale(add(*a, *b), 0.5);
    }
    out
}
