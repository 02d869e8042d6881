//! Anchors that no body can reach in the time it has.
//!
//! They are no mistake of form, and a motion comes as near to them as it can, so they are not refused. Most of them are a slip all the same:
//! millimetres for metres, another origin, a time in another unit.

use std::fmt;

use motionette::{Anchor, Target};

/// Metres a second that nobody outruns over a few seconds.
const SPEED: f64 = 8.0;
/// Metres from the pelvis to the farthest joint, arms stretched.
const LIMB: f64 = 1.3;
/// Metres that anchors may be off what is said here without a word: bodies differ.
const SLACK: f64 = 0.5;
/// Metres above the ground that a pelvis gets in a jump.
const JUMP: f64 = 1.5;

/// An anchor out of reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutOfReach {
    /// The anchor's place in the list, from 0.
    pub index: usize,
    /// Where the body comes from: an earlier anchor, or the start of the motion.
    pub from: Option<usize>,
    /// Seconds that it has.
    pub seconds: f64,
    /// Metres between the anchor and what it can reach.
    pub beyond: f64,
}

impl fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { index, from, seconds, beyond } = self;
        write!(f, "anchor {index} lies {beyond:.1} m beyond what a body can reach in {seconds:.2} s from ")?;
        match from {
            Some(from) => write!(f, "anchor {from}")?,
            None => f.write_str("the start")?,
        }
        f.write_str("; the motion will miss it (positions are metres from where the motion starts)")
    }
}

/// What an anchor says of the pelvis.
struct Place {
    /// Metres on the ground.
    floor: [f64; 2],
    /// Metres above it, if that is said.
    height: Option<f64>,
    /// Metres that the pelvis may be away from there.
    limb: f64,
    /// Seconds from the start.
    time: f64,
}

impl Place {
    /// Every motion starts with the pelvis at the origin.
    const START: Self = Self { floor: [0.0; 2], height: None, limb: 0.0, time: 0.0 };

    fn of(anchor: &Anchor, frame_rate: u16) -> Self {
        let wide = |p: [f32; 3]| p.map(f64::from);
        let ([x, y, z], limb) = match anchor.target {
            Target::Root(p) => (wide(p), 0.0),
            Target::PlanarRoot([x, z]) => (wide([x, 0.0, z]), 0.0),
            Target::Joint { position, .. } => (wide(position), LIMB),
        };
        let height = (!matches!(anchor.target, Target::PlanarRoot(_))).then_some(y);
        Self { floor: [x, z], height, limb, time: f64::from(anchor.frame) / f64::from(frame_rate) }
    }

    /// Seconds from `other`, and metres that are missing.
    fn beyond(&self, other: &Self) -> (f64, f64) {
        let seconds = (self.time - other.time).abs();
        let [dx, dz] = [self.floor[0] - other.floor[0], self.floor[1] - other.floor[1]];
        let along = dx.hypot(dz) - (SPEED * seconds + self.limb + other.limb + SLACK);
        let above = self.height.map_or(0.0, |y| (y - (JUMP + self.limb + SLACK)).max(-SLACK - y));
        (seconds, along.max(0.0).hypot(above.max(0.0)))
    }
}

/// Those of `anchors` that are out of reach from the start, or from another anchor that is not, in a motion of `frame_rate` frames a
/// second, with the largest distance of each; in the order of the list. One that is given twice is judged once.
#[must_use]
pub fn out_of_reach(anchors: &[Anchor], frame_rate: u16) -> Vec<OutOfReach> {
    let mut order: Vec<usize> = (0..anchors.len()).collect();
    order.sort_by_key(|&index| anchors[index].frame);
    let mut seen: Vec<&Anchor> = Vec::new();
    let mut reached = vec![(None, Place::START)];
    let mut found = Vec::new();
    for index in order {
        if seen.contains(&&anchors[index]) {
            continue;
        }
        seen.push(&anchors[index]);
        let place = Place::of(&anchors[index], frame_rate);
        let missing = reached.iter().map(|(from, other)| (*from, place.beyond(other)));
        let worst = missing.max_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b));
        match worst {
            Some((from, (seconds, beyond))) if beyond > 0.0 => {
                found.push(OutOfReach { index, from, seconds, beyond });
            }
            _ => reached.push((Some(index), place)),
        }
    }
    found.sort_by_key(|far| far.index);
    found
}
