//! Anchors as frame features of the planner's anchor context (EQUATIONS section 2).
//!
//! Controlled components: the pelvis on the ground plane (x and z), its height, and joints 1 to 21 in space; 66 values in all,
//! value `3 joint + axis`. Each component has its own knots: the anchors that fix it. Between them runs the interpolation
//! prior `p`, defined from the first knot to the last: a natural cubic spline through four knots or more, straight lines
//! through fewer.
//!
//! `c[t] = [ma a | mp p | rate dp | mp | ma]`, values as `(metres - mean) / std`, differences as metres a second by `std`, all three
//! kept within [`LIMIT`] (nothing that a planner was trained on lies beyond). At a knot `p` is the anchor's value to the bit.
//!
//! Frames are computed one at a time from the anchors and a second derivative an anchor and axis: nothing is kept a frame.

use crate::JOINTS;
use crate::blob::{Error, Tensors};
use crate::request::conditions::{AnchorSet, MAX_ANCHORS, Observed};
use heapless::Vec;

/// Values of all components.
pub const VALUES: usize = 3 * JOINTS;
/// Components: the pelvis's two, and the other joints.
pub const COMPONENTS: usize = JOINTS + 1;
/// Features of a frame.
pub const WIDTH: usize = 3 * VALUES + 2 * COMPONENTS;
/// Largest magnitude of a feature.
pub const LIMIT: f32 = 16.0;
/// Knots from which on the curve is a spline.
const SPLINE: usize = 4;

/// Mean and deviation of the values, metres, world frame of a motion.
#[derive(Debug, Clone, Copy)]
pub struct Statistics<'a> {
    /// `[VALUES]`
    pub mean: &'a [f32],
    /// `[VALUES]`, positive.
    pub std: &'a [f32],
}

impl<'a> Statistics<'a> {
    /// Reads mean and deviation from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or holds refused values.
    pub fn open(tensors: &mut Tensors<'a>) -> Result<Self, Error> {
        let length = VALUES as u16;
        Ok(Statistics { mean: tensors.take()?.f32s(length)?, std: tensors.take()?.scales(length)? })
    }
}

/// Anchors and the curves through them.
#[derive(Debug)]
pub struct Scaffold<'s> {
    anchors: &'s AnchorSet,
    families: u8,
    statistics: Statistics<'s>,
    /// Frames a second.
    rate: f32,
    /// Second derivatives at the anchors, metres a frame squared, `[anchors][3]`.
    bends: &'s mut [[f32; 3]],
}

/// A knot of one curve while its second derivatives are solved for.
#[derive(Debug, Clone, Copy)]
struct Knot {
    frame: f32,
    value: f32,
    diagonal: f32,
    bend: f32,
}

/// Axes of a component.
const fn axes(component: usize) -> &'static [usize] {
    match component {
        0 => &[0, 2],
        1 => &[1],
        _ => &[0, 1, 2],
    }
}

impl<'s> Scaffold<'s> {
    /// Numbers that [`Scaffold::new`] needs.
    pub const NUMBERS: usize = 3 * MAX_ANCHORS;

    /// The curves through those of `anchors` that belong to `families`, a set of [`crate::request::conditions::Family::bit`]s, at `rate` frames a
    /// second; their second derivatives into `bends`, [`Scaffold::NUMBERS`] of them.
    #[must_use]
    pub fn new(
        anchors: &'s AnchorSet,
        families: u8,
        statistics: Statistics<'s>,
        rate: f32,
        bends: &'s mut [f32],
    ) -> Self {
        invariant!(bends.len() == Self::NUMBERS, "{} numbers", bends.len());
        bends.fill(0.0);
        let (bends, _) = bends.as_chunks_mut();
        invariant!(statistics.mean.len() == VALUES && statistics.std.len() == VALUES);
        let mut scaffold = Scaffold { anchors, families, statistics, rate, bends };
        for component in 0..COMPONENTS {
            for &axis in axes(component) {
                scaffold.bend(component, axis);
            }
        }
        scaffold
    }

    /// The anchors that fix a component, by rising frame, and their places in the set.
    fn knots(&self, component: usize) -> impl Iterator<Item = (usize, &'s Observed)> + use<'s> {
        let families = self.families;
        self.anchors.iter().enumerate().filter(move |(_, anchor)| {
            let fixes = component != 1 || anchor.has_height();
            fixes && usize::from(anchor.joint) == component.saturating_sub(1) && anchor.family.bit() & families != 0
        })
    }

    /// Second derivatives of one curve at its knots.
    fn bend(&mut self, component: usize, axis: usize) {
        let mut knots: Vec<Knot, MAX_ANCHORS> = Vec::new();
        for (_, anchor) in self.knots(component) {
            let value = anchor.target.get(axis).copied().unwrap_or(0.0);
            let pushed = knots.push(Knot { frame: f32::from(anchor.frame), value, diagonal: 1.0, bend: 0.0 });
            invariant!(pushed.is_ok(), "a knot is an anchor");
        }
        if knots.len() < SPLINE {
            return;
        }
        solve(&mut knots);
        for ((place, _), knot) in self.knots(component).zip(&knots) {
            invariant!(place < self.bends.len(), "knot {place} of {}", self.bends.len());
            if let Some(bend) = self.bends.get_mut(place).and_then(|bends| bends.get_mut(axis)) {
                *bend = knot.bend;
            }
        }
    }

    /// Where a component is at a frame, metres; `None` before its first knot and behind its last.
    fn position(&self, component: usize, frame: usize) -> Option<[f32; 3]> {
        let mut before = None;
        for (place, knot) in self.knots(component) {
            invariant!(place < self.bends.len(), "knot {place} of {}", self.bends.len());
            let bends = self.bends.get(place).copied().unwrap_or_default();
            let at = usize::from(knot.frame);
            if at == frame {
                return Some(knot.target);
            }
            if at > frame {
                let (earlier, left): (&Observed, [f32; 3]) = before?;
                let h = f32::from(knot.frame - earlier.frame);
                let b = (frame as f32 - f32::from(earlier.frame)) / h;
                let a = 1.0 - b;
                let (from_left, from_right) = (a * a * a - a, b * b * b - b);
                let mut p = [0.0; 3];
                let ends = earlier.target.iter().zip(&knot.target).zip(left.iter().zip(&bends));
                for (p, ((from, to), (left, right))) in p.iter_mut().zip(ends) {
                    *p = a * *from + b * *to + (from_left * *left + from_right * *right) * h * h / 6.0;
                }
                return Some(p);
            }
            before = Some((knot, bends));
        }
        None
    }

    /// Features of frame `frame` into `c [WIDTH]`.
    pub fn features(&self, frame: usize, c: &mut [f32]) {
        invariant!(c.len() == WIDTH, "{} features", c.len());
        c.fill(0.0);
        for component in 0..COMPONENTS {
            let Some(p) = self.position(component, frame) else { continue };
            let earlier = frame.checked_sub(1).and_then(|earlier| self.position(component, earlier)).unwrap_or(p);
            let observed = self.knots(component).any(|(_, knot)| usize::from(knot.frame) == frame);
            let mut put = |feature: usize, value: f32| {
                if let Some(c) = c.get_mut(feature) {
                    *c = limited(value);
                }
            };
            for &axis in axes(component) {
                let place = 3 * component.saturating_sub(1) + axis;
                invariant!(place < self.statistics.mean.len() && place < self.statistics.std.len());
                let number = |values: &[f32]| values.get(place).copied().unwrap_or(1.0);
                let (mean, std) = (number(self.statistics.mean), number(self.statistics.std));
                let of = |position: &[f32; 3]| position.get(axis).copied().unwrap_or(0.0);
                let value = (of(&p) - mean) / std;
                if observed {
                    put(place, value);
                }
                put(VALUES + place, value);
                put(2 * VALUES + place, self.rate * (of(&p) - of(&earlier)) / std);
            }
            put(3 * VALUES + component, 1.0);
            put(3 * VALUES + COMPONENTS + component, f32::from(u8::from(observed)));
        }
    }
}

/// Second derivatives of the natural cubic spline through `knots`:
/// `h[i-1] m[i-1] + 2 (h[i-1] + h[i]) m[i] + h[i] m[i+1] = 6 (slope[i] - slope[i-1])`, eliminated downwards.
fn solve(knots: &mut [Knot]) {
    let inner = 1..knots.len().saturating_sub(1);
    for i in inner.clone() {
        let Some([before, at, after]) = knots.get_mut(i - 1..i + 2) else { return };
        let (left, right) = (at.frame - before.frame, after.frame - at.frame);
        let factor = if i == 1 { 0.0 } else { left / before.diagonal };
        at.diagonal = 2.0 * (left + right) - factor * left;
        let slopes = (after.value - at.value) / right - (at.value - before.value) / left;
        at.bend = 6.0 * slopes - factor * before.bend;
    }
    for i in inner.rev() {
        let Some([_, at, after]) = knots.get_mut(i - 1..i + 2) else { return };
        at.bend = (at.bend - (after.frame - at.frame) * after.bend) / at.diagonal;
    }
}

fn limited(x: f32) -> f32 {
    if x.abs() <= LIMIT { x } else { LIMIT.copysign(x) }
}
