//! What tracks, obstacles and the anchors beside them ask of each joint, and who moves for it.

use super::parts::Part;
use crate::JOINTS;
use crate::numerics::solid::Solid;
use crate::numerics::vector::{Vector, add, length, scale, subtract};
use crate::representation::Pose;
use crate::representation::skeleton::PARENTS;
use crate::request::conditions::{AnchorSet, Family, Observed, Obstacle, Track};
use heapless::Vec;

/// Points along a bone are so far apart at most where an obstacle is near, metres.
const SPACING: f32 = 0.04;
/// And so many of them at most.
const POINTS: usize = 32;

/// All that a motion is to meet at any number of frames.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'r> {
    /// Anchors: rows of a frame each.
    pub anchors: &'r AnchorSet,
    /// Where joints are to be.
    pub tracks: &'r [Track<'r>],
    /// Where they are not to be.
    pub obstacles: &'r [Obstacle<'r>],
    /// Frames a second.
    pub frame_rate: u16,
}

/// A joint with rows.
#[derive(Debug, Clone, Copy)]
pub struct Mover {
    /// The joint.
    pub joint: u8,
    /// What moves for it.
    pub part: Part,
    /// What it leads out of obstacles.
    pub led: Led,
}

/// What is wanted of a joint at a frame: the place, and on each axis how loosely, as a variance, square metres; infinite where it is free.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// Metres.
    pub place: Vector,
    /// Square metres.
    pub noise: Vector,
}

/// The parts of the figure by the joint that leads each out of an obstacle, the first of those that move anyway.
const LEADERS: [&[u8]; 6] = [&[0, 1, 2, 3], &[7, 10], &[8, 11], &[15], &[20], &[21]];

/// The place in [`LEADERS`] of a joint, with the bone from its parent.
const fn limb(joint: u8) -> usize {
    match joint {
        0..=3 => 0,
        4 | 7 | 10 => 1,
        5 | 8 | 11 => 2,
        18 | 20 => 4,
        19 | 21 => 5,
        _ => 3,
    }
}

/// The nearest, or deepest, point of a figure to an obstacle.
#[derive(Debug, Clone, Copy)]
pub struct Nearest {
    /// How far it is beyond the margin, metres; negative inside.
    pub clearance: f32,
    /// The point, metres.
    pub point: Vector,
    /// The joint at the end of its bone.
    pub joint: u8,
}

impl Nearest {
    const NONE: Self = Nearest { clearance: f32::INFINITY, point: [0.0; 3], joint: 0 };
}

impl Rows<'_> {
    /// Obstacles of this firmware.
    pub fn obstacles(&self) -> &[Obstacle<'_>] {
        if cfg!(feature = "obstacles") { self.obstacles } else { &[] }
    }

    /// Whether the sparse edit does as well.
    pub const fn is_empty(&self) -> bool {
        self.tracks.is_empty() && self.obstacles.is_empty()
    }

    /// The joints that rows are about, bit j for joint j, with those that lead limbs out of obstacles; none without tracks and obstacles. One
    /// bit more ([`NECK`]) where the neck takes what is left of the head.
    pub fn joints(&self) -> u32 {
        if self.is_empty() {
            return 0;
        }
        let tracked = self.tracks.iter().map(|track| track.joint).chain(self.anchors.iter().map(|anchor| anchor.joint));
        let mut joints = tracked.fold(0u32, |joints, joint| joints | 1 << (joint & 31));
        if !self.obstacles().is_empty() {
            for leaders in LEADERS {
                if !leaders.iter().any(|leader| joints >> leader & 1 == 1) {
                    joints |= 1 << leaders.first().copied().unwrap_or_default();
                }
            }
        }
        if joints & TRUNK == 1 << HEAD { joints | NECK } else { joints }
    }

    /// The same, each with what moves for it, those nearer to the pelvis first.
    pub fn movers(&self) -> Vec<Mover, JOINTS> {
        let joints = self.joints();
        let all = (0..JOINTS as u8).filter(|joint| joints >> joint & 1 == 1);
        let place = |joint| Observed { target: [0.0; 3], frame: 0, index: 0, joint, family: Family::BodyPoint };
        // There is room for every joint.
        let mut list: Vec<Observed, JOINTS> = Vec::new();
        for joint in all {
            let _ = list.push(place(joint));
        }
        let mut movers = Vec::new();
        for joint in &list {
            let (joint, part) = (joint.joint, Part::of(joint, list.iter()));
            let led = if self.obstacles().is_empty() { Led::NONE } else { Led::by(joint, joints) };
            let _ = movers.push(Mover { joint, part, led });
        }
        if joints & NECK != 0 {
            let _ = movers.push(Mover { joint: HEAD, part: Part::Neck(HEAD), led: Led::NONE });
        }
        movers
    }

    /// What is wanted of a joint at a frame; nothing where it is free.
    pub fn wanted(&self, joint: u8, frame: usize) -> Option<Wanted> {
        let mut wanted = Wanted { place: [0.0; 3], noise: [f32::INFINITY; 3] };
        let mut any = false;
        let mut add = |place: Vector, axes: [bool; 3], noise: f32| {
            any = true;
            let slots = wanted.place.iter_mut().zip(wanted.noise.iter_mut());
            for ((slot, loose), (value, counts)) in slots.zip(place.into_iter().zip(axes)) {
                // Of several the first that counts, and of an anchor and a track the anchor.
                if counts && *loose == f32::INFINITY {
                    (*slot, *loose) = (value, noise);
                }
            }
        };
        for anchor in self.anchors.iter().filter(|a| a.joint == joint && usize::from(a.frame) == frame) {
            add(anchor.target, [true, anchor.has_height(), true], 0.0);
        }
        for track in self.tracks.iter().filter(|track| track.joint == joint) {
            if let Some(place) = track.at(frame) {
                add(place, track.axes, track.tolerance * track.tolerance);
            }
        }
        any.then_some(wanted)
    }
}

/// The head.
const HEAD: u8 = 15;
/// With it all joints on which the trunk leans.
const TRUNK: u32 = 1 << HEAD | 1 << 6 | 1 << 9 | 1 << 12 | 1 << 13 | 1 << 14 | 1 << 16 | 1 << 17;
/// Stands for the neck, which bends where the trunk as a whole leans.
const NECK: u32 = 1 << JOINTS;

/// What of the figure keeps clear of an obstacle, and moves for one of `movers`.
#[derive(Debug, Clone, Copy)]
pub struct Led {
    /// Bit j for joint j with the bone from its parent.
    bones: u32,
}

impl Led {
    /// The whole figure.
    pub const ALL: Self = Led { bones: u32::MAX };

    /// Nothing.
    const NONE: Self = Led { bones: 0 };

    /// What `mover` leads out, where those of `joints`, bit by bit, move.
    fn by(mover: u8, joints: u32) -> Self {
        let moves = |joint: &&u8| joints >> *joint & 1 == 1;
        let mut bones = 0;
        for joint in 0..JOINTS as u8 {
            let leaders = LEADERS.get(limb(joint)).copied().unwrap_or_default();
            if leaders.iter().find(moves) == Some(&mover) {
                bones |= 1 << joint;
            }
        }
        Led { bones }
    }

    /// Whether there is anything.
    pub const fn is_empty(self) -> bool {
        self.bones == 0
    }

    /// The point of it, moved by `by` metres, that is deepest in `solid` or nearest to it, of the joints of `mask`.
    pub fn nearest(self, solid: &Solid, mask: u32, pose: &Pose, by: Vector) -> Nearest {
        let mut nearest = Nearest::NONE;
        let bones = self.bones & mask;
        for (joint, (end, parent)) in pose.iter().zip(PARENTS).enumerate() {
            if bones >> joint & 1 == 0 {
                continue;
            }
            let (end, start) = (add(*end, by), pose.get(usize::from(parent)).map_or(*end, |at| add(*at, by)));
            // A joint whose parent does not keep clear does so alone.
            let start = if mask >> parent & 1 == 1 { start } else { end };
            let along = subtract(end, start);
            let long = length(along);
            let mut way = 0.0;
            // A point is no nearer to the body than the last one less the way between them.
            for number in 0..POINTS {
                let last = way >= long || number + 1 == POINTS;
                let point = if last { end } else { add(start, scale(along, way / long)) };
                let clearance = solid.clearance(point);
                if clearance < nearest.clearance {
                    nearest = Nearest { clearance, point, joint: joint as u8 };
                }
                let spare = clearance - nearest.clearance;
                if last {
                    break;
                }
                way += if spare > SPACING { spare } else { SPACING };
            }
        }
        nearest
    }
}
