//! A host that is not heard of any more.

use crate::message::LossAction;

/// What silence means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Silence {
    /// Milliseconds without a request of its session after which a host counts as lost; 0: never.
    pub after_ms: u32,
    /// What is done then with a motion: `Finish` or `Hold`.
    pub action: LossAction,
}

/// Watches for silence.
#[derive(Debug)]
pub struct Watch {
    silence: Silence,
    /// When the session's host was last heard of.
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
        self.heard.is_some() && self.left(now) == Some(0)
    }

    /// Milliseconds after which the host counts as lost if it says nothing more; `None`: it never does.
    pub fn left(&self, now: u64) -> Option<u32> {
        let passed = u32::try_from(now.saturating_sub(self.heard.unwrap_or(now))).unwrap_or(u32::MAX);
        (self.silence.after_ms > 0).then(|| self.silence.after_ms.saturating_sub(passed))
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
    pub const fn unreported(&self) -> Option<LossAction> {
        self.unreported
    }

    /// The session's host has been told.
    pub const fn reported(&mut self) {
        self.unreported = None;
    }
}
