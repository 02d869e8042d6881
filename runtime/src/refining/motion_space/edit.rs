//! What is added to a motion, and the motion that comes of it.

use super::covariance::Covariance;
use super::parts::{Part, Side};
use super::rows::Mover;
use super::stances::{HELD, fill, mark, next_run};
use crate::JOINTS;
use crate::kernels;
use crate::memory::{Arena, ArenaTooSmall};
use crate::numerics::rotation::Rotation;
use crate::numerics::vector::{Vector, add, length, scale, subtract, unit};
use crate::representation::Pose;
use crate::representation::limbs::{Limb, along};
use crate::request::conditions::{AnchorSet, MAX_ANCHORS, Observed};

/// Rows of the root's path beside the anchors': where it stays behind the last of them.
pub const TAIL: usize = 2;
/// Behind the last anchor the path's edit stays: its standard deviation grows so fast, metres a frame.
const TAIL_SPREAD: f32 = 0.3 / 20.0;
/// It is to stay so many frames behind the last anchor, and at the end.
const TAIL_NEAR: usize = 9;
/// Standard deviation of the body's height, metres.
pub const HEIGHT: f32 = 0.05;
/// The last way to an anchor is never longer than this, metres.
const LAST: f32 = 0.03;
/// A stance is drawn so far to its own mean: feet that slide stand.
const LOCK: f32 = 0.65;
/// A foot without an anchor is never put farther aside than this, metres.
const ASIDE: f32 = 0.15;
/// To which side a straight limb bends, metres: knees forward, elbows back.
const POLE: f32 = 0.02;

/// Joints of the trunk and above it: what a lean moves.
const UPPER: [usize; 13] = [3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21];

/// The difference of the root's path at two frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Row {
    /// The later frame.
    pub plus: usize,
    /// The earlier one; at 0 the path begins and is never edited.
    pub minus: usize,
}

/// An anchor, as the edit sees it.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// Its frame.
    pub frame: usize,
    /// Whether its height counts.
    pub tall: bool,
    /// What moves for it.
    pub part: Part,
    /// How much of its own way the part still takes: 1, and less where the anchor was not met.
    pub soft: f32,
    /// How loose the anchor is: its noise as a share of its signal; 0 for exact.
    pub loose: f32,
}

impl Point {
    const NONE: Self = Point { frame: 0, tall: false, part: Part::Body, soft: 1.0, loose: 0.0 };
}

/// Whether there may be tracks.
const TRACKED: bool = cfg!(feature = "tracks");
/// Most joints with rows.
const MOST: usize = if TRACKED { JOINTS } else { 0 };
/// A mark of a frame with an anchor, outside of stances.
const ANCHORED: u8 = 1;
/// A stance is not held more loosely than this, of [`HELD`].
const LEAST_HELD: u8 = 2;

/// Offsets that are known at some frames and filled in between: of a foot, or of the body's last way.
#[derive(Debug)]
struct Offsets<'a> {
    /// Not 0 where the offset is known: in stances how firmly they are held, up to [`HELD`]; at other anchors [`ANCHORED`].
    known: &'a mut [u8],
    offsets: &'a mut [Vector],
}

/// Ways that are known at every frame, of joints with rows: of the root, and of a part each.
#[derive(Debug)]
pub struct Tracks<'a> {
    /// The parts.
    parts: [Part; MOST],
    count: usize,
    /// Of the root, then of each part, `[1 + count][T]`; empty without tracks.
    ways: &'a mut [Vector],
    frames: usize,
}

impl<'a> Tracks<'a> {
    fn take(frames: usize, count: usize, arena: &mut Arena<'a>) -> Result<Self, ArenaTooSmall> {
        let count = if count < MOST { count } else { MOST };
        let ways = arena.take(if count > 0 { (1 + count) * frames } else { 0 })?;
        Ok(Tracks { parts: [Part::Body; MOST], count, ways, frames })
    }

    /// Whose ways they are.
    pub(super) fn set(&mut self, movers: &[Mover]) {
        for (slot, mover) in self.parts.iter_mut().zip(movers) {
            *slot = mover.part;
        }
    }

    /// The part of a joint with rows.
    pub(super) fn part(&self, index: usize) -> Part {
        self.parts.get(index).copied().unwrap_or(Part::Body)
    }

    fn parts(&self) -> &[Part] {
        if TRACKED { part!(self.parts, ..self.count) } else { &[] }
    }

    /// The ways of a track, or of the root, `[T]`; empty where there are no tracks.
    pub(super) fn ways(&self, who: Option<usize>) -> &[Vector] {
        let first = who.map_or(0, |index| 1 + index) * self.frames;
        if TRACKED { self.ways.get(first..first + self.frames).unwrap_or_default() } else { &[] }
    }

    /// The same to be written.
    pub(super) fn ways_mut(&mut self, who: Option<usize>) -> &mut [Vector] {
        let first = who.map_or(0, |index| 1 + index) * self.frames;
        self.ways.get_mut(first..first + self.frames).unwrap_or_default()
    }
}

/// What is added.
#[derive(Debug)]
pub struct Edit<'a> {
    covariance: Covariance<'a>,
    points: [Point; MAX_ANCHORS],
    /// Rows of the path's equations: the anchors', and where it stays.
    rows: [Row; MAX_ANCHORS + TAIL],
    count: usize,
    /// Weights of the rows, `[x, z]`.
    pub(super) weights: &'a mut [[f32; 2]],
    /// Weights of the height, one an anchor.
    pub(super) heights: &'a mut [[f32; 1]],
    /// Weights of the parts' own ways, one an anchor.
    pub(super) own: &'a mut [Vector],
    /// What is added to every joint of a frame.
    path: &'a mut [Vector],
    /// Of this, what the weights do not say: the last millimetres to the anchors.
    rest: Offsets<'a>,
    feet: [Offsets<'a>; 2],
    /// Of rows at every frame.
    pub(super) tracks: Tracks<'a>,
    planted: bool,
}

impl<'a> Edit<'a> {
    /// Nothing yet, of a motion of `frames` frames, for so many anchors and tracks.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn take(frames: usize, anchors: usize, tracks: usize, arena: &mut Arena<'a>) -> Result<Self, ArenaTooSmall> {
        let mut offsets = || Ok(Offsets { known: arena.take(frames)?, offsets: arena.take(frames)? });
        let (feet, rest) = ([offsets()?, offsets()?], offsets()?);
        Ok(Edit {
            covariance: Covariance::take(frames, arena)?,
            points: [Point::NONE; MAX_ANCHORS],
            rows: [Row::default(); MAX_ANCHORS + TAIL],
            count: anchors,
            weights: arena.take(anchors + TAIL)?,
            heights: arena.take(anchors)?,
            own: arena.take(anchors)?,
            path: arena.take(frames)?,
            rest,
            feet,
            tracks: Tracks::take(frames, tracks, arena)?,
            planted: false,
        })
    }

    /// Of these anchors and this motion, with nothing added yet.
    pub fn begin(&mut self, poses: &[Pose], anchors: &AnchorSet, planted: bool) {
        self.planted = planted;
        self.weights.fill([0.0; 2]);
        self.heights.fill([0.0]);
        self.own.fill([0.0; 3]);
        self.tracks.ways.fill([0.0; 3]);
        for foot in self.feet.iter_mut().chain([&mut self.rest]) {
            foot.known.fill(0);
            foot.offsets.fill([0.0; 3]);
        }
        for (point, anchor) in self.points.iter_mut().zip(anchors.iter()) {
            let part = Part::of(anchor, anchors.iter());
            *point = Point { frame: usize::from(anchor.frame), tall: anchor.has_height(), part, soft: 1.0, loose: 0.0 };
        }
        let last = anchors.last_frame().map_or(0, usize::from);
        let end = poses.len().saturating_sub(1);
        let near = if last + TAIL_NEAR < end { last + TAIL_NEAR } else { end };
        let tail = |plus: usize| if plus > last + 1 { Row { plus, minus: last } } else { Row::default() };
        let tails = [tail(near), if end > near { tail(end) } else { Row::default() }];
        let rows = self.points.iter().take(self.count).map(|point| Row { plus: point.frame, minus: 0 });
        for (slot, row) in self.rows.iter_mut().zip(rows.chain(tails)) {
            *slot = row;
        }
        if planted {
            for (foot, toe) in self.feet.iter_mut().zip([10, 11]) {
                mark(poses, toe, foot.known);
            }
        }
        self.build(poses, anchors);
    }

    /// Takes the body the last way to its anchors, where the smooth path does not bend so far: whether there was any. `missing` is what the
    /// anchors lack.
    pub fn settle(&mut self, poses: &[Pose], anchors: &AnchorSet, missing: &[Vector; MAX_ANCHORS]) -> bool {
        for (point, missing) in self.points.iter().zip(missing).take(self.count) {
            if point.part != Part::Body || point.loose > 0.0 || length(*missing) > LAST {
                continue;
            }
            if let (Some(known), Some(offset)) =
                (self.rest.known.get_mut(point.frame), self.rest.offsets.get_mut(point.frame))
            {
                (*known, *offset) = (ANCHORED, *missing);
            }
        }
        fill(self.rest.offsets, self.rest.known);
        let any = self.rest.known.contains(&ANCHORED);
        if any {
            self.build(poses, anchors);
        }
        any
    }

    /// Holds stances more loosely from or to which a foot would swing more than `step` farther a frame than it did, metres: whether there are any.
    pub fn ease(&mut self, step: f32) -> bool {
        let mut any = false;
        for foot in &mut self.feet {
            let put = |t: usize| {
                let offset = foot.offsets.get(t).copied().unwrap_or_default();
                add(offset, self.path.get(t).copied().unwrap_or_default())
            };
            let mut from = 0;
            while let Some((a, b)) = next_run(foot.known, from) {
                let end = next_run(foot.known, b).map_or(self.path.len(), |(next, _)| next + 1);
                let mut fastest = 0.0;
                for t in from + 1..end {
                    let way = length(subtract(put(t), put(t - 1)));
                    fastest = if way > fastest { way } else { fastest };
                }
                from = b;
                for held in foot.known.iter_mut().take(b).skip(a) {
                    if fastest > step && *held > LEAST_HELD {
                        let less = f32::from(*held) * step / fastest;
                        *held = if less > f32::from(LEAST_HELD) { less as u8 } else { LEAST_HELD };
                        any = true;
                    }
                }
            }
        }
        any
    }

    /// The anchors.
    pub fn points(&self) -> &[Point] {
        part!(self.points, ..self.count)
    }

    /// The anchors, to be softened and loosened.
    pub fn points_mut(&mut self) -> &mut [Point] {
        part_mut!(self.points, ..self.count)
    }

    fn point(&self, i: usize) -> Point {
        self.points.get(i).copied().unwrap_or(Point::NONE)
    }

    fn row(&self, i: usize) -> Row {
        self.rows.get(i).copied().unwrap_or_default()
    }

    /// Covariance of the path's rows i and j, with the parts' ways over the floor and the rows' noise.
    pub fn of_path(&self, i: usize, j: usize) -> f32 {
        let (a, b) = (self.row(i), self.row(j));
        let covariance = |a, b| self.covariance.path(a, b);
        let later = covariance(a.plus, b.plus) - covariance(a.plus, b.minus);
        let path = later - covariance(a.minus, b.plus) + covariance(a.minus, b.minus);
        path + self.of_ways(i, j, 0) + if i == j { self.noise(i) } else { 0.0 }
    }

    /// Noise of a row of the path: a loose anchor's, a tail's spread.
    fn noise(&self, i: usize) -> f32 {
        let Row { plus, minus } = self.row(i);
        if i < self.count {
            return self.point(i).loose * self.covariance.path(plus, plus);
        }
        let spread = TAIL_SPREAD * (plus - minus) as f32;
        spread * spread
    }

    /// What the path's rows lack, where the anchors lack `missing`, `[x, z]`.
    pub fn lacks_of_path(&self, missing: &[Vector; MAX_ANCHORS]) -> [[f32; 2]; MAX_ANCHORS + TAIL] {
        let mut lacks = [[0.0; 2]; MAX_ANCHORS + TAIL];
        for (i, (lack, [wx, wz])) in lacks.iter_mut().zip(self.weights.iter()).enumerate() {
            let [x, _, z] = match missing.get(i) {
                Some(missing) if i < self.count => *missing,
                _ => subtract(self.shift(self.row(i).minus), self.shift(self.row(i).plus)),
            };
            let noise = self.noise(i);
            *lack = [x - noise * wx, z - noise * wz];
        }
        lacks
    }

    /// Covariance of the heights of anchors i and j, with the parts' ways. An anchor without a height stands alone.
    pub fn of_height(&self, i: usize, j: usize) -> f32 {
        let (a, b) = (self.point(i), self.point(j));
        let square = HEIGHT * HEIGHT;
        let both = match a.tall && b.tall {
            true => square * self.covariance.height(a.frame, b.frame) + self.of_ways(i, j, 1),
            false => 0.0,
        };
        both + if i == j { square * if a.tall { a.loose } else { 1.0 } } else { 0.0 }
    }

    /// Covariance of the ways that the parts of anchors i and j take of their own while the root takes the rest, over the floor or in height,
    /// square metres.
    fn of_ways(&self, i: usize, j: usize, axis: usize) -> f32 {
        if i >= self.count || j >= self.count {
            return 0.0;
        }
        let (a, b) = (self.point(i), self.point(j));
        let way = a.part.own_way().get(axis).copied().unwrap_or(0.0);
        if a.part == b.part { way * way * a.soft * b.soft * self.covariance.limb(a.frame, b.frame) } else { 0.0 }
    }

    /// The same for the ways alone, as shares, with the anchors' noise.
    pub fn of_own(&self, i: usize, j: usize) -> f32 {
        let (a, b) = (self.point(i), self.point(j));
        let same = a.part == b.part && a.part != Part::Body;
        let shared = if same { self.covariance.limb(a.frame, b.frame) } else { 0.0 };
        // What has no way of its own stands alone and gets nothing.
        let alone = if a.part == Part::Body { 1.0 } else { a.loose };
        shared + if i == j { alone } else { 0.0 }
    }

    /// What is added to every joint of a frame.
    pub fn shift(&self, frame: usize) -> Vector {
        self.path.get(frame).copied().unwrap_or_default()
    }

    /// Where a foot is put at a frame, beside what is added to all joints and its own way, metres.
    pub fn put(&self, side: Side, frame: usize) -> Vector {
        let [left, right] = &self.feet;
        let foot = if side == Side::Left { left } else { right };
        foot.offsets.get(frame).copied().unwrap_or_default()
    }

    /// The own way at a frame of those parts for which `which` holds, metres.
    // One of it for all parts: it is asked for in many places.
    #[inline(never)]
    pub fn way(&self, frame: usize, which: &dyn Fn(Part) -> bool) -> Vector {
        let mut sum = [0.0; 3];
        for (point, own) in self.points().iter().zip(self.own.iter()) {
            if which(point.part) {
                sum = add(sum, scale(*own, self.covariance.limb(frame, point.frame)));
            }
        }
        for (index, part) in self.tracks.parts().iter().enumerate() {
            if which(*part) {
                sum = add(sum, self.tracks.ways(Some(index)).get(frame).copied().unwrap_or_default());
            }
        }
        sum
    }

    /// Brings path and feet in line with the weights.
    pub fn build(&mut self, poses: &[Pose], anchors: &AnchorSet) {
        for (t, slot) in self.path.iter_mut().enumerate() {
            let [mut x, mut y, mut z] = [0.0; 3];
            for (row, [wx, wz]) in self.rows.iter().zip(self.weights.iter()).filter(|(_, w)| **w != [0.0; 2]) {
                let covariance = self.covariance.path(t, row.plus) - self.covariance.path(t, row.minus);
                x += wx * covariance;
                z += wz * covariance;
            }
            for (point, [weight]) in self.points.iter().zip(self.heights.iter()).filter(|(_, w)| **w != [0.0]) {
                y += weight * self.covariance.height(t, point.frame);
            }
            *slot = [x, y, z];
        }
        for (slot, rest) in self.path.iter_mut().zip(self.rest.offsets.iter()) {
            *slot = add(*slot, *rest);
        }
        for (slot, way) in self.path.iter_mut().zip(self.tracks.ways(None)) {
            *slot = add(*slot, *way);
        }
        for (foot, (ankle, toe)) in self.feet.iter_mut().zip([(7, 10), (8, 11)]) {
            foot.offsets.fill([0.0; 3]);
            if self.planted {
                let exact = |index: usize| self.points.get(index).is_some_and(|point| point.loose == 0.0);
                foot.place(poses, (anchors, &exact), self.path, (ankle, toe));
            }
        }
    }

    /// The edited pose of a frame, of which `pose` is what was generated.
    pub fn apply(&self, pose: &Pose, frame: usize) -> Pose {
        self.applied(pose, frame, [true; 3])
    }

    /// Where the edit puts one joint of it.
    pub fn joint(&self, pose: &Pose, frame: usize, joint: u8) -> Vector {
        self.applied(pose, frame, Self::limbs_of(joint)).get(usize::from(joint)).copied().unwrap_or_default()
    }

    /// Which limbs of [`Edit::applied`] a joint is part of.
    pub(super) const fn limbs_of(joint: u8) -> [bool; 3] {
        let (left, right) = (matches!(joint, 4 | 7 | 10), matches!(joint, 5 | 8 | 11));
        [left, right, joint > 2 && !left && !right]
    }

    /// The edited pose, of which only these count: left leg, right leg, all above the hips.
    pub(super) fn applied(&self, pose: &Pose, frame: usize, [left, right, upper]: [bool; 3]) -> Pose {
        let mut out = *pose;
        let shift = self.shift(frame);
        for joint in &mut out {
            *joint = add(*joint, shift);
        }
        let parts = self.points().iter().map(|point| point.part).chain(self.tracks.parts().iter().copied());
        let present = parts.fold(0, |present, part| present | part.bit());
        let any = |parts: &[Part]| parts.iter().any(|part| present & part.bit() != 0);
        let way = |which: &dyn Fn(Part) -> bool| self.way(frame, which);
        let forward = forward(&out);
        let at = |out: &Pose, joint: usize| out.get(joint).copied().unwrap_or_default();
        let set = |out: &mut Pose, joint: usize, place: Vector| {
            if let Some(slot) = out.get_mut(joint) {
                *slot = place;
            }
        };
        for (side, wanted, [hip, knee, ankle, toe]) in
            [(Side::Left, left, [1, 4, 7, 10]), (Side::Right, right, [2, 5, 8, 11])]
        {
            if !wanted || !self.planted && !any(&[Part::Ankle(side), Part::Knee(side), Part::Toes(side)]) {
                continue;
            }
            let sole = subtract(at(&out, toe), at(&out, ankle));
            let target = add(add(at(&out, ankle), self.put(side, frame)), way(&|part| part == Part::Ankle(side)));
            let limb = Limb { root: at(&out, hip), middle: at(&out, knee), end: at(&out, ankle) };
            let mut limb = limb.reaching(target, scale(forward, POLE));
            if any(&[Part::Knee(side)]) {
                limb = limb.bending(add(limb.middle, way(&|part| part == Part::Knee(side))));
            }
            set(&mut out, knee, limb.middle);
            set(&mut out, ankle, limb.end);
            let turned = match any(&[Part::Toes(side)]) {
                true => along(add(sole, way(&|part| part == Part::Toes(side))), sole),
                false => sole,
            };
            set(&mut out, toe, add(limb.end, turned));
        }
        if !upper {
            return out;
        }
        for joint in UPPER {
            let lean = |part| part == Part::Lean(joint as u8);
            if !any(&[Part::Lean(joint as u8)]) {
                continue;
            }
            let pelvis = at(&out, 0);
            let from = subtract(at(&out, joint), pelvis);
            let up = unit(from, [0.0, 1.0, 0.0]);
            let turn = Rotation::between(up, unit(add(from, way(&lean)), up));
            for moved in UPPER {
                let place = add(pelvis, turn.apply(subtract(at(&out, moved), pelvis)));
                set(&mut out, moved, place);
            }
        }
        let neck = |joint| move |part| part == Part::Neck(joint);
        if any(&[Part::Neck(12), Part::Neck(15)]) {
            let limb = Limb { root: at(&out, 9), middle: at(&out, 12), end: at(&out, 15) };
            let limb = limb.reaching(add(limb.end, way(&neck(15))), scale(forward, -POLE));
            let limb = limb.bending(add(limb.middle, way(&neck(12))));
            set(&mut out, 12, limb.middle);
            set(&mut out, 15, limb.end);
        }
        for (side, [collar, shoulder, elbow, wrist]) in
            [(Side::Left, [13, 16, 18, 20]), (Side::Right, [14, 17, 19, 21])]
        {
            let bone = |joint: usize| move |part| part == Part::Collar(side, joint as u8);
            if any(&[Part::Collar(side, collar as u8), Part::Collar(side, shoulder as u8)]) {
                let limb = Limb { root: at(&out, 9), middle: at(&out, collar), end: at(&out, shoulder) };
                let moved = limb.reaching(add(limb.end, way(&bone(shoulder))), [0.0; 3]);
                let moved = moved.bending(add(moved.middle, way(&bone(collar))));
                let along = subtract(moved.end, limb.end);
                set(&mut out, collar, moved.middle);
                for joint in [shoulder, elbow, wrist] {
                    let place = add(at(&out, joint), along);
                    set(&mut out, joint, place);
                }
            }
            if any(&[Part::Wrist(side), Part::Elbow(side)]) {
                let limb = Limb { root: at(&out, shoulder), middle: at(&out, elbow), end: at(&out, wrist) };
                let target = add(limb.end, way(&|part| part == Part::Wrist(side)));
                let mut limb = limb.reaching(target, scale(forward, -POLE));
                if any(&[Part::Elbow(side)]) {
                    limb = limb.bending(add(limb.middle, way(&|part| part == Part::Elbow(side))));
                }
                set(&mut out, elbow, limb.middle);
                set(&mut out, wrist, limb.end);
            }
        }
        out
    }
}

impl Offsets<'_> {
    /// Puts the foot where it stood, or on those of its anchors that are exact.
    fn place(
        &mut self,
        poses: &[Pose],
        (anchors, exact): (&AnchorSet, &dyn Fn(usize) -> bool),
        path: &[Vector],
        (ankle, toe): (u8, u8),
    ) {
        for known in self.known.iter_mut().filter(|known| **known == ANCHORED) {
            *known = 0;
        }
        let at = |joint: u8, t: usize| poses.get(t).and_then(|pose| pose.get(usize::from(joint))).copied();
        let foot = |t: usize| at(toe, t).unwrap_or_default();
        let shift = |t: usize| path.get(t).copied().unwrap_or_default();
        let own = || {
            let all = anchors.iter().enumerate().filter(|(index, _)| exact(*index));
            all.map(|(_, anchor)| anchor).filter(|anchor| anchor.joint == ankle || anchor.joint == toe)
        };
        // From where the joint was generated to where it is wanted.
        let wanted = |anchor: &Observed| {
            let from = at(anchor.joint, usize::from(anchor.frame)).unwrap_or_default();
            scale(anchor.residual(from), -1.0)
        };
        let mut from = 0;
        while let Some((a, b)) = next_run(self.known, from) {
            from = b;
            let count = (b - a) as f32;
            let held = self.known.get(a).map_or(0.0, |held| f32::from(*held) / f32::from(HELD));
            let (mut mean, mut moved) = ([0.0; 3], [0.0; 3]);
            for t in a..b {
                mean = add(mean, foot(t));
                moved = add(moved, shift(t));
            }
            let (mean, [x, _, z]) = (scale(mean, 1.0 / count), scale(moved, 1.0 / count));
            let (mut sum, mut anchored) = ([0.0; 3], 0.0);
            for anchor in own().filter(|anchor| (a..b).contains(&usize::from(anchor.frame))) {
                sum = add(sum, wanted(anchor));
                anchored += 1.0;
            }
            let whole = if anchored > 0.0 { scale(sum, 1.0 / anchored) } else { [x, 0.0, z] };
            for (t, offset) in self.offsets.iter_mut().enumerate().take(b).skip(a) {
                let [sx, _, sz] = subtract(mean, foot(t));
                let put = subtract(add(whole, [LOCK * sx, 0.0, LOCK * sz]), shift(t));
                *offset = if anchored > 0.0 { put } else { capped(scale(put, held)) };
            }
        }
        for anchor in own() {
            let t = usize::from(anchor.frame);
            if let (Some(known @ 0), Some(offset)) = (self.known.get_mut(t), self.offsets.get_mut(t)) {
                *known = ANCHORED;
                *offset = subtract(wanted(anchor), shift(t));
            }
        }
        fill(self.offsets, self.known);
        let anchored = |t: usize| own().any(|anchor| usize::from(anchor.frame) == t);
        for (t, offset) in self.offsets.iter_mut().enumerate() {
            let ([_, was, _], [_, shift, _]) = (foot(t), shift(t));
            let [_, height, _] = offset;
            if was + shift + *height < 0.0 && !anchored(t) {
                *height = -was - shift;
            }
        }
    }
}

/// An offset that is never farther aside than [`ASIDE`].
fn capped([x, y, z]: Vector) -> Vector {
    let aside = kernels::sqrt(x * x + z * z);
    let share = if aside > 1e-6 { ASIDE * libm::tanhf(aside / ASIDE) / aside } else { 1.0 };
    [x * share, y, z * share]
}

/// Where a body faces, along the floor.
fn forward(pose: &Pose) -> Vector {
    let at = |joint: usize| pose.get(joint).copied().unwrap_or_default();
    let [x, _, z] = add(subtract(at(1), at(2)), subtract(at(16), at(17)));
    unit([-z, 0.0, x], [0.0, 0.0, 1.0])
}
