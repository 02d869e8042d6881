//! Which deed answers for which action of `docs/actions.toml`.

use super::{Deed, Direction, Seen, Side};

/// What must be seen for an action: one of these deeds, on a side where the action's name has one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rule {
    /// Canonical name of the action.
    pub action: &'static str,
    /// Any of these is enough.
    pub deeds: &'static [Deed],
    /// The side that is asked for; none where any will do.
    pub side: Option<Side>,
}

const fn rule(action: &'static str, deeds: &'static [Deed]) -> Rule {
    Rule { action, deeds, side: None }
}

const fn sided(action: &'static str, deeds: &'static [Deed], side: Side) -> Rule {
    Rule { action, deeds, side: Some(side) }
}

/// Every action that a deed answers for. Actions without one (drawing, throwing, dancing ...) are left to another judge.
pub const RULES: &[Rule] = &[
    sided("wave-left-hand", &[Deed::Wave], Side::Left),
    sided("wave-right-hand", &[Deed::Wave], Side::Right),
    sided("wave-both-hands", &[Deed::Wave], Side::Both),
    sided("raise-up-left-hand", &[Deed::Raise], Side::Left),
    sided("raise-up-right-hand", &[Deed::Raise], Side::Right),
    sided("raise-up-both-hands", &[Deed::Raise], Side::Both),
    rule("clap", &[Deed::Clap]),
    rule("punch", &[Deed::Punch]),
    rule("box", &[Deed::Punch]),
    rule("jump", &[Deed::Jump]),
    rule("jump-forward", &[Deed::Leap]),
    rule("jumping-jacks", &[Deed::JumpingJack]),
    rule("kick", &[Deed::Kick]),
    rule("kick-ball", &[Deed::Kick]),
    rule("roundhouse-kick", &[Deed::Kick]),
    rule("spin-kick", &[Deed::Kick]),
    rule("raise-knee", &[Deed::RaiseLeg]),
    rule("raise-leg-sideways", &[Deed::RaiseLeg, Deed::Kick]),
    rule("squat", &[Deed::Squat]),
    rule("sit-down", &[Deed::Sit]),
    rule("stand-up", &[Deed::Rise]),
    rule("crouch", &[Deed::Crouch]),
    rule("lie-down", &[Deed::Lie]),
    rule("fall", &[Deed::Lie]),
    rule("get-up", &[Deed::GetUp]),
    rule("crawl", &[Deed::Crawl]),
    rule("bow", &[Deed::Bow]),
    rule("pick-up", &[Deed::ReachDown]),
    rule("put-down", &[Deed::ReachDown]),
    rule("stand", &[Deed::Stand]),
    rule("walk", &[Deed::Walk(Direction::Forward)]),
    rule("walk-back", &[Deed::Walk(Direction::Backward)]),
    sided("walk-left", &[Deed::Walk(Direction::Drift), Deed::Run(Direction::Drift)], Side::Left),
    sided("walk-right", &[Deed::Walk(Direction::Drift), Deed::Run(Direction::Drift)], Side::Right),
    sided("side-step-left", &[Deed::Walk(Direction::Sideways), Deed::Run(Direction::Sideways)], Side::Left),
    sided("side-step-right", &[Deed::Walk(Direction::Sideways), Deed::Run(Direction::Sideways)], Side::Right),
    sided("walk-turn-left", &[Deed::WalkTurn], Side::Left),
    sided("walk-turn-right", &[Deed::WalkTurn], Side::Right),
    sided("turn-left", &[Deed::Turn], Side::Left),
    sided("turn-right", &[Deed::Turn], Side::Right),
    rule("run", &[Deed::Run(Direction::Forward)]),
    rule("dash", &[Deed::Run(Direction::Forward)]),
    rule("run-back", &[Deed::Run(Direction::Backward)]),
    sided("run-turn-left", &[Deed::RunTurn], Side::Left),
    sided("run-turn-right", &[Deed::RunTurn], Side::Right),
    rule("walk-in-place", &[Deed::StepInPlace]),
    rule("run-in-place", &[Deed::StepInPlace]),
];

/// The rule for an action; none where no deed answers for it.
pub fn rule_of(action: &str) -> Option<&'static Rule> {
    RULES.iter().find(|rule| rule.action == action)
}

impl Rule {
    /// Whether what was seen is the action.
    pub fn met(&self, seen: &[Seen]) -> bool {
        seen.iter().any(|seen| self.deeds.contains(&seen.deed) && self.side.is_none_or(|side| side == seen.side))
    }
}

/// Whether what was seen is the action; none where no deed answers for it.
pub fn does(seen: &[Seen], action: &str) -> Option<bool> {
    Some(rule_of(action)?.met(seen))
}
