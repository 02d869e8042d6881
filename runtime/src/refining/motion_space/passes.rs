//! To which side obstacles are passed: decided once, for the motion as it was generated, so that nobody goes to and fro.

use super::place;
use super::rows::{Led, Mover, Nearest, Rows};
use crate::JOINTS;
use crate::numerics::solid::Solid;
use crate::numerics::vector::{Vector, dot, scale, subtract, unit};
use crate::representation::Pose;
use crate::request::conditions::Obstacle;
use heapless::Vec;

/// Most obstacles in the way, each time counted.
pub const PASSES: usize = 16;
/// Whoever is in the way again after no more frames than this goes past on the same side.
const ONE_PASS: usize = 20;
/// Its way past an obstacle begins and ends so many frames before and behind what is inside.
const PAST: usize = 5;
/// A figure whose way past is longer than this passes, metres.
const PASSED: f32 = 0.25;
/// An obstacle is passed to a side by no more than this, metres.
pub const SIDEWAYS: f32 = 2.0;
/// Feet step over what is lower than this, metres.
const STEP_OVER: f32 = 0.45;
/// Trunks duck below what is higher than this, metres.
const CROUCHED: f32 = 1.0;
/// Everybody rises and sinks by less than this, metres.
const TIPTOE: f32 = 0.05;
/// A way into another obstacle counts so many times more.
const BLOCKED: f32 = 4.0;
/// A way up or down counts so many times more: bodies stand on the floor, and arms hang down straight.
const LESS_UPRIGHT: f32 = 3.0;
/// Over it.
pub const UP: Vector = [0.0, 1.0, 0.0];

/// An obstacle in the way of the motion as it was generated: from which frame to which, and to which side the figure passes it.
#[derive(Debug, Clone, Copy)]
pub struct Pass {
    obstacle: usize,
    first: usize,
    last: usize,
    side: Vector,
}

/// What of each limb is deepest in an obstacle at a frame, if anything is inside.
type Inside<'s> = &'s dyn Fn(usize, Led) -> Option<(Solid, Nearest)>;

/// Where obstacles are in the way, the first [`PASSES`] times.
#[inline(never)]
pub fn passes(poses: &[Pose], rows: &Rows<'_>, movers: &[Mover]) -> Vec<Pass, PASSES> {
    let mut passes = Vec::new();
    for (number, obstacle) in rows.obstacles().iter().enumerate() {
        let inside = |t: usize, led: Led| {
            let body = obstacle.at(2 * t, rows.frame_rate);
            let deepest = led.nearest(&body, obstacle.joints, poses.get(t)?, [0.0; 3]);
            (deepest.clearance < 0.0).then_some((body, deepest))
        };
        let any = |t: usize| {
            let body = obstacle.at(2 * t, rows.frame_rate);
            let pose = poses.get(t);
            pose.is_some_and(|pose| Led::ALL.nearest(&body, obstacle.joints, pose, [0.0; 3]).clearance < 0.0)
        };
        let mut pass: Option<(usize, usize)> = None;
        let mut end = |(first, last): (usize, usize)| {
            // The pelvis' way past, seen from the obstacle, which may move.
            let seen = |t: usize| subtract(place(poses.get(t), 0), obstacle.at(2 * t, rows.frame_rate).middle);
            let [from, to] =
                [first.saturating_sub(PAST), if last + PAST < poses.len() { last + PAST } else { poses.len() - 1 }];
            // By how much the figure, moved at a frame, is inside the others.
            let others = |t: usize, by: Vector| {
                let Some(pose) = poses.get(t) else { return 0.0 };
                let all = rows.obstacles().iter().enumerate().filter(|(other, _)| *other != number);
                let clearance = |other: &Obstacle<'_>| {
                    Led::ALL.nearest(&other.at(2 * t, rows.frame_rate), other.joints, pose, by).clearance
                };
                let missing = all.map(|(_, other)| -clearance(other));
                missing.fold(0.0, |sum: f32, missing| if missing > 0.0 { sum + missing } else { sum })
            };
            let side = side(movers, &inside, &others, subtract(seen(to), seen(from)), (first, last));
            // One more than there is room for is passed as that obstacle's nearest pass, or straight away from it.
            let _ = passes.push(Pass { obstacle: number, first, last, side });
        };
        for t in (0..poses.len()).filter(|t| any(*t)) {
            pass = Some(match pass {
                Some((first, last)) if t - last <= ONE_PASS => (first, t),
                Some(before) => {
                    end(before);
                    (t, t)
                }
                None => (t, t),
            });
        }
        if let Some(last) = pass {
            end(last);
        }
    }
    passes
}

/// To which side what is inside an obstacle between two frames leaves it: the one in which what has the longest way out has
/// the shortest: across the way on which it is passed, over or below it, or straight away from where one is deepest.
fn side(
    movers: &[Mover],
    inside: Inside<'_>,
    others: &dyn Fn(usize, Vector) -> f32,
    travel: Vector,
    (first, last): (usize, usize),
) -> Vector {
    // Of each limb where it is deepest, and when.
    let mut deepest: Vec<(u8, f32, Solid, Vector, usize), JOINTS> = Vec::new();
    for mover in movers {
        let mut own: Option<(u8, f32, Solid, Vector, usize)> = None;
        for t in first..=last {
            let Some((body, nearest)) = inside(t, mover.led) else { continue };
            if own.is_none_or(|(_, least, ..)| nearest.clearance < least) {
                own = Some((nearest.joint, nearest.clearance, body, nearest.point, t));
            }
        }
        if let Some(own) = own {
            // There is room for every one.
            let _ = deepest.push(own);
        }
    }
    let mut least = (f32::INFINITY, [0.0; 3]);
    let [x, _, z] = travel;
    let across = unit([z, 0.0, -x], [0.0; 3]);
    let away = deepest.first().map_or([0.0; 3], |(_, _, body, at, _)| body.away(*at));
    for direction in [across, scale(across, -1.0), UP, scale(UP, -1.0), away] {
        // Back along one's own way is no way past.
        let along = dot(direction, unit(travel, [0.0; 3]));
        if dot(direction, direction) < 0.5 || dot(travel, travel) > PASSED * PASSED && along * along > 0.5 {
            continue;
        }
        let [_, up, _] = direction;
        let worth = 1.0 + LESS_UPRIGHT * libm::fabsf(up);
        let mut longest = 0.0;
        let mut when = first;
        for (joint, _, body, at, t) in &deepest {
            let way = body.way_out(*at, direction, SIDEWAYS).unwrap_or(f32::INFINITY);
            let way = if can(*joint, *at, scale(direction, way)) { way } else { f32::INFINITY };
            (longest, when) = if way > longest { (way, *t) } else { (longest, when) };
        }
        // What other obstacles take back of it.
        let blocked = if longest < f32::INFINITY { others(when, scale(direction, longest)) } else { 0.0 };
        let longest = worth * longest + BLOCKED * blocked;
        if longest < least.0 {
            least = (longest, direction);
        }
    }
    least.1
}

/// Whether a body can take a point of itself, on the bone to `joint`, out over or below something: feet step over what is low, trunk and head duck
/// below what is high, and arms go either way.
fn can(joint: u8, [_, height, _]: Vector, [_, up, _]: Vector) -> bool {
    let after = height + up;
    match joint {
        18..=21 => after >= 0.0,
        4 | 5 | 7 | 8 | 10 | 11 if up > 0.0 => after < STEP_OVER,
        6 | 9 | 12..=17 if up < 0.0 => after > CROUCHED,
        _ => up.abs() < TIPTOE,
    }
}

/// To which side an obstacle is passed at a frame: as the pass says that is nearest in time; nowhere without one.
pub fn side_at(passes: &[Pass], obstacle: usize, frame: usize) -> Vector {
    let mut nearest = (usize::MAX, [0.0; 3]);
    for pass in passes.iter().filter(|pass| pass.obstacle == obstacle) {
        let before = pass.first.saturating_sub(frame);
        let away = before + frame.saturating_sub(pass.last);
        if away < nearest.0 {
            nearest = (away, pass.side);
        }
    }
    nearest.1
}

/// What takes the end of a leg up until nothing of the body is above it.
pub fn over(body: &Solid, at: Vector) -> Vector {
    let ([x, y, z], [_, middle, _]) = (at, body.middle);
    let column = [x, middle, z];
    let inside = y < middle && body.clearance(column) < 0.0;
    let top = if inside { body.way_out(column, UP, SIDEWAYS).map(|way| middle + way) } else { None };
    top.map_or([0.0; 3], |top| [0.0, top - y, 0.0])
}
