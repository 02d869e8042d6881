//! What legs do besides carrying the body along: kick, lift, jump.

use super::arms::sided;
use super::body::{Body, LIMBS, from_vertical, joint, length, mean, minus, quantile, runs};
use super::{Deed, Seen, Side};

/// In flight both feet are at least so far above where they stand, metres.
const FLIGHT_CLEARANCE: f64 = 0.05;
/// For at least so long, seconds.
const FLIGHT_TIME: f64 = 0.1;
/// A jump lifts the pelvis so far above its usual height, metres; a runner's flight does not.
const JUMP_RISE: f64 = 0.1;
/// Enough for a body that does not travel, metres.
const HOP_RISE: f64 = 0.05;
/// Who jumps has the pelvis above this in flight (see [`Body::height`]).
const JUMP_HEIGHT: f64 = 0.8;
/// A body that travels no faster hops in place, m/s.
const HOP_TRAVEL: f64 = 0.5;
/// A leap carries the body so far over the ground in one flight, metres.
const LEAP_LENGTH: f64 = 0.2;
/// The feet of a jumping jack are so far apart, metres between the ankles.
const JACK_SPREAD: f64 = 0.45;
/// Its flights, at least.
const JACK_FLIGHTS: usize = 1;
/// A kicking leg is stretched to this share of its length.
const KICK_STRETCH: f64 = 0.8;
/// It swings so far from the vertical, degrees.
const KICK_ANGLE: f64 = 40.0;
/// Its ankle is so fast, m/s relative to the pelvis.
const KICK_SPEED: f64 = 3.2;
/// For a body that stands, a smaller kick is enough, degrees and m/s.
const STANDING_KICK: [f64; 2] = [25.0, 2.2];
/// Slower than this the body stands, m/s.
const STANDING_TRAVEL: f64 = 0.55;
/// Faster than this it runs, and legs that fly are strides, m/s.
const KICK_TRAVEL: f64 = 1.4;
/// The foot of a kick is so far above where it stands, metres.
const KICK_LIFT: f64 = 0.08;
/// Who kicks has the pelvis above this (see [`Body::height`]).
const KICK_HEIGHT: f64 = 0.6;
/// The ankle is so fast within this time of the swing's end, seconds.
const KICK_TIME: f64 = 0.3;
/// A leg that is held up has its foot so far above where it stands, metres.
const LEG_LIFT: f64 = 0.12;
/// And is no faster than this, m/s relative to the pelvis.
const LEG_SPEED: f64 = 1.2;
/// For so long, seconds.
const LEG_HOLD: f64 = 0.3;

/// Everything that the legs were seen to do.
pub(super) fn detect(body: &Body) -> Vec<Seen> {
    let mut seen = Vec::new();
    seen.extend(jumps(body));
    seen.extend(sided(Deed::Kick, [0, 1].map(|side| kicks(body, side))));
    seen.extend(sided(Deed::RaiseLeg, [0, 1].map(|side| lifts(body, side))));
    seen
}

/// Both feet leave the ground and the pelvis rises.
fn jumps(body: &Body) -> Vec<Seen> {
    let usual = quantile(body.joints.iter().map(|pose| pose[joint::PELVIS][1]).collect(), 0.5);
    let up: Vec<bool> = body.lift.iter().map(|feet| feet[0].min(feet[1]) > FLIGHT_CLEARANCE).collect();
    let mut flights = 0;
    let mut leaps = false;
    let clearances = runs(&up, body.frames(FLIGHT_TIME));
    for flight in clearances {
        let rise = flight.clone().map(|t| body.joints[t][joint::PELVIS][1] - usual).fold(f64::NEG_INFINITY, f64::max);
        let travel = mean(&body.speed[flight.clone()]);
        let high = flight.clone().all(|t| body.height[t] > JUMP_HEIGHT);
        if !high || rise < if travel < HOP_TRAVEL { HOP_RISE } else { JUMP_RISE } {
            continue;
        }
        flights += 1;
        leaps |= travel * flight.len() as f64 / body.fps > LEAP_LENGTH;
    }
    let mut seen = Vec::new();
    let mut push = |deed| seen.push(Seen { deed, side: Side::None });
    if flights > 0 {
        push(Deed::Jump);
    }
    if leaps {
        push(Deed::Leap);
    }
    let jack = body.joints.iter().any(|pose| {
        let [left, right] = LIMBS;
        let spread = length(minus(pose[left.ankle], pose[right.ankle]));
        let hands = pose[left.wrist][1].min(pose[right.wrist][1]);
        spread > JACK_SPREAD && hands > pose[joint::NECK][1]
    });
    if flights >= JACK_FLIGHTS && jack {
        push(Deed::JumpingJack);
    }
    seen
}

/// A stretched leg swings up fast, forward or to a side.
fn kicks(body: &Body, side: usize) -> bool {
    let limbs = LIMBS[side];
    let ankle = body.relative_speed(joint::PELVIS, limbs.ankle);
    let around = body.frames(KICK_TIME);
    let leg = |t: usize| {
        let pose = &body.joints[t];
        length(minus(pose[limbs.hip], pose[limbs.knee])) + length(minus(pose[limbs.knee], pose[limbs.ankle]))
    };
    (0..body.len()).any(|t| {
        let thigh = minus(body.joints[t][limbs.hip], body.joints[t][limbs.ankle]);
        let angle = from_vertical(thigh);
        let [_, _, forward] = body.seen(t, limbs.hip, limbs.ankle);
        let stretched = length(thigh) > KICK_STRETCH * leg(t).max(1e-3);
        let nearby = t.saturating_sub(around)..(t + around + 1).min(body.len());
        let fastest = ankle[nearby].iter().copied().fold(0.0, f64::max);
        let large = angle > KICK_ANGLE && fastest > KICK_SPEED && body.speed[t] < KICK_TRAVEL;
        let small = angle > STANDING_KICK[0] && fastest > STANDING_KICK[1] && body.speed[t] < STANDING_TRAVEL;
        // Behind the body it is a stride, unless it is higher than a stride goes.
        let up = body.lift[t][side] > KICK_LIFT && body.height[t] > KICK_HEIGHT;
        up && stretched && (large || small) && (forward > 0.0 || angle > 75.0)
    })
}

/// One foot is held up while the other stands.
fn lifts(body: &Body, side: usize) -> bool {
    let ankle = body.relative_speed(joint::PELVIS, LIMBS[side].ankle);
    let up = |feet: &[f64; 2]| feet[side] > LEG_LIFT && feet[1 - side] < FLIGHT_CLEARANCE;
    let held: Vec<bool> = body.lift.iter().zip(ankle).map(|(feet, speed)| up(feet) && speed < LEG_SPEED).collect();
    !runs(&held, body.frames(LEG_HOLD)).is_empty()
}
