//! How high and how upright the body is: squat, sit, rise, lie, get up, crawl, bow, reach for the floor, stand.

use super::body::{Body, LIMBS, joint, mean, quantile};
use super::{Deed, Seen, Side};

/// The first and last posture are means over so long, seconds.
const END: f64 = 0.25;
/// Above this height of the pelvis the body is up (see [`Body::height`]).
const UP: f64 = 0.8;
/// A squat takes the pelvis down by this share of the height it began at.
const SQUAT_DEPTH: f64 = 0.1;
/// And ends within this share of it.
const SQUAT_RETURN: f64 = 0.1;
/// Who squats leans no farther than this, degrees.
const SQUAT_LEAN: f64 = 60.0;
/// And stays within this, metres over the ground.
const SQUAT_TRAVEL: f64 = 0.6;
/// Who sits down or rises has this share of the standing height less at the lower end.
const SIT_DEPTH: f64 = 0.1;
/// Who sits is at least so high.
const SIT_LOWEST: f64 = 0.2;
/// And leans no farther than this, degrees.
const SIT_LEAN: f64 = 60.0;
/// A crouch is lower than this.
const CROUCH: f64 = 0.7;
/// And leans farther forward than who sits, degrees.
const CROUCH_LEAN: f64 = 15.0;
/// Or is lower than any chair.
const CROUCH_LOW: f64 = 0.42;
/// Who lies has the pelvis lower than this.
const LYING: f64 = 0.35;
/// And leans farther than this, degrees.
const LYING_LEAN: f64 = 55.0;
/// Who crawls gets along at least so fast, m/s.
const CRAWL_SPEED: f64 = 0.08;
/// Who crawls is on hands and knees for at least this share of the time.
const CRAWL_SHARE: f64 = 0.5;
/// A bow leans so much farther than the posture it ends in, degrees.
const BOW_LEAN: f64 = 22.0;
/// The pelvis stays above this.
const BOW_HEIGHT: f64 = 0.82;
/// Forward of the pelvis by this share of the length of the trunk.
const BOW_FORWARD: f64 = 0.3;
/// Who bows does not get about, m/s.
const BOW_TRAVEL: f64 = 0.6;
/// A hand that reaches the floor is nearer to it than this, metres.
const REACH: f64 = 0.45;
/// Who stands still has joints no faster than this in nine frames of ten, m/s.
const STILL: f64 = 0.6;
/// And goes nowhere, m/s.
const STILL_TRAVEL: f64 = 0.25;
/// And does not lean, degrees.
const STILL_LEAN: f64 = 25.0;

/// Everything that the posture was seen to do.
pub(super) fn detect(body: &Body) -> Vec<Seen> {
    let mut seen = Vec::new();
    let mut push = |deed: Deed, holds: bool| {
        if holds {
            seen.push(Seen { deed, side: Side::None });
        }
    };
    let [first, last] = body.ends(&body.height, END);
    let [first_lean, last_lean] = body.ends(&body.lean, END);
    let lowest = body.height.iter().copied().fold(f64::INFINITY, f64::min);
    let steepest = body.lean.iter().copied().fold(0.0, f64::max);
    let lies = |height: f64, lean: f64| height < LYING && lean > LYING_LEAN;
    let lying = (0..body.len()).any(|t| lies(body.height[t], body.lean[t]));
    let spread = travel(body);
    let dips = lowest < (1.0 - SQUAT_DEPTH) * first.min(last);
    let returns = (first - last).abs() < SQUAT_RETURN * first && last > UP * 0.85;
    push(Deed::Squat, dips && returns && steepest < SQUAT_LEAN && spread < SQUAT_TRAVEL);
    push(Deed::Sit, first > UP && last < (1.0 - SIT_DEPTH) * first && last > SIT_LOWEST && last_lean < SIT_LEAN);
    push(
        Deed::Rise,
        last > UP && first < (1.0 - SIT_DEPTH) * last && first > SIT_LOWEST && first_lean < SIT_LEAN + 20.0,
    );
    push(Deed::Crouch, first > UP && last < CROUCH && (last < CROUCH_LOW || last_lean > CROUCH_LEAN) && !lying);
    push(Deed::Lie, lying && (first > UP || lies(last, last_lean)));
    push(Deed::GetUp, lies(first, first_lean) && last > first + 0.2);
    let crawling = (0..body.len()).filter(|t| body.height[*t] < LYING + 0.1 && body.lean[*t] > LYING_LEAN);
    let crawls = crawling.count() as f64 > CRAWL_SHARE * body.len() as f64;
    push(Deed::Crawl, crawls && mean(&body.speed) > CRAWL_SPEED);
    let reach = body.joints.iter().any(|pose| {
        LIMBS.iter().any(|limbs| pose[limbs.wrist][1] - body.floor < REACH) && pose[joint::HEAD][1] > body.floor
    });
    push(Deed::Bow, !reach && bows(body, last_lean, lowest));
    push(Deed::ReachDown, reach && !lying && first.max(last) > UP * 0.85);
    push(Deed::Stand, stands(body, lowest));
    seen
}

/// How far the pelvis gets from where it began, metres over the ground.
fn travel(body: &Body) -> f64 {
    let start = body.joints[0][joint::PELVIS];
    let away = |t: usize| {
        let [x, _, z] = body.joints[t][joint::PELVIS];
        (x - start[0]).hypot(z - start[2])
    };
    (0..body.len()).map(away).fold(0.0, f64::max)
}

/// The trunk goes forward and comes back over straight legs.
fn bows(body: &Body, last_lean: f64, lowest: f64) -> bool {
    let trunk = |t: usize| body.seen(t, joint::PELVIS, joint::NECK);
    let bent = (0..body.len()).any(|t| {
        let [left, up, forward] = trunk(t);
        let size = left.hypot(up).hypot(forward).max(1e-6);
        body.lean[t] > last_lean + BOW_LEAN && forward > BOW_FORWARD * size && forward > 2.0 * left.abs()
    });
    bent && lowest > BOW_HEIGHT && quantile(body.speed.clone(), 0.9) < BOW_TRAVEL
}

/// Nothing moves.
fn stands(body: &Body, lowest: f64) -> bool {
    let slow = |from: usize, to: usize| quantile(body.relative_speed(from, to), 0.9) < STILL;
    let limbs = LIMBS.iter().all(|l| slow(l.shoulder, l.wrist) && slow(l.hip, l.ankle));
    let hanging = LIMBS
        .iter()
        .all(|l| quantile((0..body.len()).map(|t| body.seen(t, l.shoulder, l.wrist)[1]).collect(), 0.9) < 0.0);
    limbs
        && hanging
        && lowest > UP
        && quantile(body.speed.clone(), 0.9) < STILL_TRAVEL
        && quantile(body.lean.clone(), 0.9) < STILL_LEAN
}
