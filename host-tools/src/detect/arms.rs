//! What arms do: wave, clap, raise, punch.

use super::body::{Body, LIMBS, Limbs, Point, bridged, joint, length, mean, minus, quantile, reversals, runs};
use super::{Deed, Seen, Side};

/// A hand lower than this hangs, metres above the shoulder.
const HANGING: f64 = -0.4;
/// A waving hand is above this in half of the frames, metres above the shoulder; below is swinging, carrying, fighting.
const WAVE_HEIGHT: f64 = -0.1;
/// A waving hand goes at least so far to one side before it comes back, metres.
const WAVE_SWING: f64 = 0.08;
/// So many turns of the hand make a wave.
const WAVE_TURNS: usize = 4;
/// Turns lower than this do not count, metres above the shoulder: there the arm goes up or comes down.
const TURN_HEIGHT: f64 = -0.35;
/// For so long it may hang between two swings of a large wave, seconds.
const WAVE_GAP: f64 = 0.5;
/// Travel of a body whose hands only swing along, m/s.
const WAVE_TRAVEL: f64 = 2.0;
/// A raised hand is at least so far above the shoulder, metres.
const RAISE_HEIGHT: f64 = 0.05;
/// It stays there, seconds.
const RAISE_TIME: f64 = 0.4;
/// Slower than this it is held, m/s relative to the shoulder.
const RAISE_SPEED: f64 = 0.6;
/// For so long, seconds.
const RAISE_HOLD: f64 = 0.15;
/// Hands that clap come nearer than this, metres between the wrists.
const CLAP_NEAR: f64 = 0.25;
/// And part again by at least this, metres.
const CLAP_SWING: f64 = 0.06;
/// Nor is one wrist farther ahead or higher than the other by more than this when they meet, metres: fists pass one another.
const CLAP_SKEW: f64 = 0.1;
/// So many times.
const CLAPS: usize = 2;
/// At most so long after one another, seconds.
const CLAP_PERIOD: f64 = 0.9;
/// Clapping hands are no higher above the shoulders than this, metres.
const CLAP_HEIGHT: f64 = 0.2;
/// A punch begins with the arm bent: distance of shoulder and wrist as a share of the arm's length.
const PUNCH_FROM: f64 = 0.65;
/// It ends with the arm stretched to at least this share.
const PUNCH_TO: f64 = 0.8;
/// Within so many seconds.
const PUNCH_TIME: f64 = 0.25;
/// The fist begins no higher above the shoulder than this, metres: higher is a throw.
const PUNCH_START: f64 = 0.1;
/// Nor farther behind it, metres forward.
const PUNCH_BACK: f64 = -0.1;
/// It lands at most so far above or below the shoulder, metres.
const PUNCH_HEIGHT: f64 = 0.2;
/// And at least so far in front of it, as a share of the arm's length.
const PUNCH_FORWARD: f64 = 0.6;
/// Both arms stretched within this time push, seconds.
const PUSH_TIME: f64 = 0.1;

/// Everything that the arms were seen to do.
pub(super) fn detect(body: &Body) -> Vec<Seen> {
    let mut seen = Vec::new();
    let waving = LIMBS.map(|limbs| waves(body, limbs));
    let raised = [0, 1].map(|side| !waving[side] && raises(body, LIMBS[side]));
    seen.extend(sided(Deed::Wave, waving));
    seen.extend(sided(Deed::Raise, raised));
    seen.extend(sided(Deed::Punch, punches(body)));
    if claps(body) {
        seen.push(Seen { deed: Deed::Clap, side: Side::Both });
    }
    seen
}

/// What left and right limb did, as one finding.
pub(super) fn sided(deed: Deed, [left, right]: [bool; 2]) -> Option<Seen> {
    let side = match (left, right) {
        (true, true) => Side::Both,
        (true, false) => Side::Left,
        (false, true) => Side::Right,
        (false, false) => return None,
    };
    Some(Seen { deed, side })
}

/// The hand, up, goes from side to side.
fn waves(body: &Body, limbs: Limbs) -> bool {
    let up: Vec<bool> = (0..body.len()).map(|t| body.seen(t, limbs.shoulder, limbs.wrist)[1] > HANGING).collect();
    bridged(&up, body.frames(WAVE_GAP)).into_iter().any(|run| {
        let hand: Vec<Point> = run.clone().map(|t| body.seen(t, limbs.shoulder, limbs.wrist)).collect();
        let height = quantile(hand.iter().map(|[_, up, _]| *up).collect(), 0.5);
        let sideways: Vec<f64> = hand.iter().map(|[left, ..]| *left).collect();
        let turns = reversals(&sideways, WAVE_SWING).into_iter();
        height > WAVE_HEIGHT
            && turns.filter(|(t, _)| hand[*t][1] > TURN_HEIGHT).count() >= WAVE_TURNS
            && mean(&body.speed[run]) < WAVE_TRAVEL
    })
}

/// The hand is held above the shoulder.
fn raises(body: &Body, limbs: Limbs) -> bool {
    let speed = body.relative_speed(limbs.shoulder, limbs.wrist);
    let up: Vec<bool> = (0..body.len()).map(|t| body.seen(t, limbs.shoulder, limbs.wrist)[1] > RAISE_HEIGHT).collect();
    runs(&up, body.frames(RAISE_TIME)).into_iter().any(|run| {
        let held: Vec<bool> = run.map(|t| speed[t] < RAISE_SPEED).collect();
        !runs(&held, body.frames(RAISE_HOLD)).is_empty()
    })
}

/// The frames in which an arm is stretched forward all at once.
fn thrusts(body: &Body, limbs: Limbs) -> Vec<usize> {
    let reach: Vec<f64> =
        body.joints.iter().map(|pose| length(minus(pose[limbs.wrist], pose[limbs.shoulder])) / body.arm).collect();
    let within = body.frames(PUNCH_TIME);
    let lands = |t: usize| {
        let [_, up, forward] = body.seen(t, limbs.shoulder, limbs.wrist);
        let start = (t.saturating_sub(within)..t).rfind(|s| reach[*s] < PUNCH_FROM);
        let begins = |s: usize| {
            let [_, up, forward] = body.seen(s, limbs.shoulder, limbs.wrist);
            up < PUNCH_START && forward > PUNCH_BACK
        };
        reach[t] > PUNCH_TO
            && up.abs() < PUNCH_HEIGHT
            && forward > PUNCH_FORWARD * body.arm
            && start.is_some_and(begins)
    };
    (1..body.len()).filter(|t| lands(*t)).collect()
}

/// One arm at a time is stretched forward all at once.
fn punches(body: &Body) -> [bool; 2] {
    let near = body.frames(PUSH_TIME);
    let [left, right] = LIMBS.map(|limbs| thrusts(body, limbs));
    let alone = |own: &[usize], other: &[usize]| own.iter().any(|t| other.iter().all(|o| t.abs_diff(*o) > near));
    [alone(&left, &right), alone(&right, &left)]
}

/// The hands meet in front of the body, part and meet again.
fn claps(body: &Body) -> bool {
    let [left, right] = LIMBS;
    let level = |t: usize| {
        let [_, up, forward] = body.seen(t, left.wrist, right.wrist);
        up.hypot(forward) < CLAP_SKEW
    };
    let apart: Vec<f64> = (0..body.len())
        .map(|t| {
            let distance = length(minus(body.joints[t][left.wrist], body.joints[t][right.wrist]));
            // Hands that are near but not level do not meet.
            if level(t) { distance } else { distance.max(CLAP_NEAR) }
        })
        .collect();
    let low: Vec<bool> = body
        .joints
        .iter()
        .map(|pose| {
            let wrist = pose[left.wrist][1].max(pose[right.wrist][1]);
            let shoulder = 0.5 * (pose[left.shoulder][1] + pose[right.shoulder][1]);
            wrist < shoulder + CLAP_HEIGHT && wrist > pose[joint::PELVIS][1]
        })
        .collect();
    let period = body.frames(CLAP_PERIOD * (CLAPS - 1) as f64);
    runs(&low, 1).into_iter().any(|run| {
        let turns = reversals(&apart[run], CLAP_SWING);
        let met: Vec<usize> = turns.into_iter().filter(|(_, distance)| *distance < CLAP_NEAR).map(|(t, _)| t).collect();
        met.windows(CLAPS).any(|met| met[CLAPS - 1] - met[0] <= period)
    })
}
