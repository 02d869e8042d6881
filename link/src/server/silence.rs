//! A host that is not heard of any more.

use crate::message::LossAction;

/// What silence means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Silence {
    /// Milliseconds without a request after which a host counts as lost; 0: never.
    pub after_ms: u32,
    /// What is done then with a motion: `Finish` or `Hold`.
    pub action: LossAction,
}

/// Watches for silence.
#[derive(Debug)]
pub struct Watch {
    silence: Silence,
    /// When a host was last heard of.
    heard: Option<u64>,
    /// What was done in this silence.
    acted: Option<LossAction>,
    /// What was done and has not been reported.
    unreported: Option<LossAction>,
}

impl Watch {
    pub const fn new(silence: Silence) -> Self {
        Watch { silence, heard: None, acted: None, unreported: None }
    }

    pub const fn silence(&self) -> Silence {
        self.silence
    }

    pub fn heard(&mut self, now: u64) {
        self.heard = Some(now);
        self.acted = None;
    }

    /// Whether a host that was there counts as lost.
    pub fn silent(&self, now: u64) -> bool {
        let after = u64::from(self.silence.after_ms);
        after > 0 && self.heard.is_some_and(|heard| now.saturating_sub(heard) >= after)
    }

    /// Whether something is to be done about movement: once a silence, and again when a body that was to hold moves.
    pub fn must_act(&self, moves: bool) -> bool {
        self.acted != Some(self.silence.action) || (moves && self.silence.action == LossAction::Hold)
    }

    /// Notes what was done; true the first time in this silence.
    pub fn acted(&mut self, action: LossAction) -> bool {
        let first = self.acted != Some(action);
        self.acted = Some(action);
        self.unreported = Some(action);
        first
    }

    /// What was done since the last report.
    pub fn report(&mut self) -> Option<LossAction> {
        self.unreported.take()
    }
}
