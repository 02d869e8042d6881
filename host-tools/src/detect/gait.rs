//! How the body gets about: walking and running, forward, backward and to a side, turning, stepping in place.

use super::body::{Body, reversals, runs};
use super::{Deed, Direction, Seen, Side};

/// Slower than this the body does not get about, m/s.
const MOVING: f64 = 0.35;
/// Faster than this it runs, m/s.
const RUNNING: f64 = 1.9;
/// Faster than this it runs when its feet leave the ground, m/s.
const JOGGING: f64 = 1.45;
/// A foot nearer than this to where it stands is down, metres.
const DOWN: f64 = 0.025;
/// The ground is where the lower foot was lowest within this time, seconds.
const GROUND_TIME: f64 = 0.4;
/// Share of the moving frames with no foot down, in a run.
const FLIGHT_SHARE: f64 = 0.1;
/// A gait or direction holds for at least so long, seconds.
const LASTS: f64 = 0.7;
/// Or for this share of the time that the body moves.
const SHARE: f64 = 0.6;
/// It never counts when it holds for less, seconds.
const BRIEF: f64 = 0.4;
/// Drift to one side begins at this angle from straight ahead, degrees.
const DRIFT: f64 = 12.0;
/// Up to this angle the body still goes forward, degrees.
const FORWARD: f64 = 50.0;
/// From this angle on it goes sideways rather than forward, degrees.
const SIDEWAYS: f64 = 45.0;
/// From this angle on it goes backward, degrees.
const BACKWARD: f64 = 125.0;
/// The least turn, degrees.
const TURN: f64 = 35.0;
/// The least turn in place, degrees.
const TURN_IN_PLACE: f64 = 60.0;
/// Who turns has the pelvis above this (see [`Body::height`]).
const TURN_HEIGHT: f64 = 0.6;
/// From one step in place to the next the difference of the feet's heights changes so much, metres.
const STEP: f64 = 0.04;
/// And each foot comes higher than the other by this, metres.
const STEP_LIFT: f64 = 0.015;
/// So many such changes make a walk.
const STEPS: usize = 3;
/// Who steps in place gets no faster than this, m/s.
const IN_PLACE: f64 = 0.3;

/// Everything that the gait was seen to be.
pub(super) fn detect(body: &Body) -> Vec<Seen> {
    let speed = &body.speed;
    let moving: Vec<usize> = (0..body.len()).filter(|t| speed[*t] > MOVING).collect();
    let mut seen = Vec::new();
    let turn = (body.heading[body.len() - 1] - body.heading[0]).to_degrees();
    let side = if turn > 0.0 { Side::Left } else { Side::Right };
    let least = body.frames(BRIEF);
    if moving.len() >= least {
        let lower: Vec<f64> = body.lift.iter().map(|feet| feet[0].min(feet[1])).collect();
        // The ground under the body: some recordings rise or sink as they go.
        let around = body.frames(GROUND_TIME);
        let ground = |t: usize| {
            lower[t.saturating_sub(around)..(t + around + 1).min(lower.len())]
                .iter()
                .copied()
                .fold(f64::INFINITY, f64::min)
        };
        let flying = moving.iter().filter(|t| lower[**t] > ground(**t) + DOWN).count();
        let typical = super::body::quantile(moving.iter().map(|t| speed[*t]).collect(), 0.6);
        let flies = flying as f64 > FLIGHT_SHARE * moving.len() as f64;
        let fast = typical > RUNNING || typical > JOGGING && flies;
        let deed = |direction: Direction| if fast { Deed::Run(direction) } else { Deed::Walk(direction) };
        for (direction, side) in directions(body, &moving) {
            seen.push(Seen { deed: deed(direction), side });
        }
        if turn.abs() > TURN {
            seen.push(Seen { deed: if fast { Deed::RunTurn } else { Deed::WalkTurn }, side });
        }
    }
    let mostly_there = (moving.len() as f64) < 0.5 * body.len() as f64;
    let up = body.height.iter().all(|height| *height > TURN_HEIGHT);
    if turn.abs() > TURN_IN_PLACE && mostly_there && up {
        seen.push(Seen { deed: Deed::Turn, side });
    }
    if steps_in_place(body) {
        seen.push(Seen { deed: Deed::StepInPlace, side: Side::None });
    }
    seen
}

/// The directions that the body moves in long enough, seen from itself.
fn directions(body: &Body, moving: &[usize]) -> Vec<(Direction, Side)> {
    let angle = |t: usize| {
        let [forward, left] = body.velocity[t];
        left.atan2(forward).to_degrees()
    };
    let lasts = |fits: &dyn Fn(f64) -> bool| {
        let holds: Vec<bool> = (0..body.len()).map(|t| moving.contains(&t) && fits(angle(t))).collect();
        let total = holds.iter().filter(|held| **held).count();
        let longest = runs(&holds, 1).into_iter().map(|run| run.len()).max().unwrap_or(0);
        longest >= body.frames(LASTS) || longest >= body.frames(BRIEF) && total as f64 > SHARE * moving.len() as f64
    };
    let mostly = |fits: &dyn Fn(f64) -> bool| {
        let total = moving.iter().filter(|t| fits(angle(**t))).count();
        lasts(fits) && total as f64 > SHARE * moving.len() as f64
    };
    let mut found = Vec::new();
    if lasts(&|a: f64| a.abs() < FORWARD) {
        found.push((Direction::Forward, Side::None));
    }
    if lasts(&|a: f64| a.abs() > BACKWARD) {
        found.push((Direction::Backward, Side::None));
    }
    for (side, sign) in [(Side::Left, 1.0), (Side::Right, -1.0)] {
        if mostly(&|a: f64| (DRIFT..BACKWARD).contains(&(sign * a))) {
            found.push((Direction::Drift, side));
        }
        if mostly(&|a: f64| (SIDEWAYS..180.0 - SIDEWAYS).contains(&(sign * a))) {
            found.push((Direction::Sideways, side));
        }
    }
    found
}

/// The feet go up and down in turn while the body stays.
fn steps_in_place(body: &Body) -> bool {
    let there = super::body::quantile(body.speed.clone(), 0.9) < IN_PLACE;
    let higher: Vec<f64> = body.lift.iter().map(|feet| feet[0] - feet[1]).collect();
    let turns: Vec<f64> = reversals(&higher, STEP).into_iter().map(|(_, higher)| higher).collect();
    let both = turns.iter().any(|higher| *higher > STEP_LIFT) && turns.iter().any(|higher| *higher < -STEP_LIFT);
    let up = body.height.iter().all(|height| *height > TURN_HEIGHT);
    there && up && both && turns.len() >= STEPS
}
