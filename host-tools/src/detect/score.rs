//! How often the rules are right on real motion whose action is known.
//!
//! A clip that shows more than its action (a dribbler walks) counts as a false alarm, unless the table of actions says that the two
//! may be taken for one another: so the figures are a lower bound.

use super::actions::{RULES, Rule, rule_of};
use super::{Seen, detect};
use crate::dataset::{ClipView, Dataset, Split};
use crate::import::actions::Actions;
use crate::motion::FPS;
use crate::parallel;

/// How one rule fares on the clips of a split.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Score {
    /// Canonical name of the action.
    pub action: &'static str,
    /// Its clips.
    pub clips: usize,
    /// Those of them in which it was seen.
    pub found: usize,
    /// Clips of actions that must not be taken for it.
    pub others: usize,
    /// Those of them in which it was seen all the same.
    pub false_alarms: usize,
}

impl Score {
    /// Share of the action's clips in which it was seen; none without clips.
    pub fn recall(&self) -> Option<f64> {
        share(self.found, self.clips)
    }

    /// Share of the action's clips among those in which it was seen; none where it was not seen.
    pub fn precision(&self) -> Option<f64> {
        share(self.found, self.found + self.false_alarms)
    }

    /// Share of the other clips in which it was seen; none without others.
    pub fn false_alarm_share(&self) -> Option<f64> {
        share(self.false_alarms, self.others)
    }
}

fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

/// One score for every rule, in the order of [`RULES`]. Clips without an action are left out.
pub fn scores(dataset: &Dataset, split: Split, actions: &Actions) -> Vec<Score> {
    let clips: Vec<ClipView<'_>> = dataset.split(split).filter(|clip| clip.info.action().is_some()).collect();
    let seen: Vec<Vec<Seen>> = parallel::map(&clips, |clip| detect(clip.joints, FPS));
    let score = |rule: &'static Rule| {
        let mut score = Score { action: rule.action, clips: 0, found: 0, others: 0, false_alarms: 0 };
        for (clip, seen) in clips.iter().zip(&seen) {
            let action = clip.info.action().unwrap_or_default();
            let met = usize::from(rule.met(seen));
            if action == rule.action {
                score.clips += 1;
                score.found += met;
            } else if !alike(actions, rule, action) {
                score.others += 1;
                score.false_alarms += met;
            }
        }
        score
    };
    RULES.iter().map(score).collect()
}

/// Whether a clip of `action` may show what `rule` looks for.
fn alike(actions: &Actions, rule: &Rule, action: &str) -> bool {
    let accepts = |a: &str, b: &str| actions.find(a).is_some_and(|found| found.accept.iter().any(|name| name == b));
    let same = |other: &Rule| other.side == rule.side && other.deeds.iter().any(|deed| rule.deeds.contains(deed));
    accepts(rule.action, action) || accepts(action, rule.action) || rule_of(action).is_some_and(same)
}
