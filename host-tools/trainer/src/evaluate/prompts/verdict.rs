//! What became of a prompt, and what each judge says about it.

use std::collections::{BTreeMap, BTreeSet};

use motionette_host::detect::Seen;
use motionette_host::detect::actions::{does, rule_of};
use motionette_host::import::actions::Actions;

use super::file::Line;
use super::order::Order;
use super::trust::Accuracy;

/// What the judges saw in one motion.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shown {
    /// Action that the evaluator names.
    pub action: String,
    /// Style that it names.
    pub style: String,
    /// What the detectors saw.
    pub seen: Vec<Seen>,
    /// In which order it shows two actions; none for a prompt of one.
    pub order: Option<Order>,
}

/// What became of a prompt.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// The prompt.
    pub line: Line,
    /// Why the runtime refused it; it has no motions then.
    pub refused: Option<String>,
    /// Words that the model does not know; 0 for a prompt that is refused before its words are looked up.
    pub unknown_words: u16,
    /// Whether the model is sure what was meant; none of a model that was not taught it, or a prompt that is refused.
    pub sure: Option<bool>,
    /// `[seed]` what its motions show.
    pub motions: Vec<Shown>,
}

/// Motions of a prompt that show what was asked for, of those that were asked for. Motions of a refused prompt show nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// Motions that show it.
    pub met: usize,
    /// Motions that were asked for.
    pub of: usize,
}

impl Tally {
    /// Whether every motion shows it.
    pub fn whole(self) -> bool {
        self.met == self.of
    }
}

/// What every judge says of a prompt; none where it cannot judge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Verdict {
    /// The action, by the evaluator.
    pub evaluator: Option<Tally>,
    /// The action, by the detectors.
    pub detectors: Option<Tally>,
    /// The style, by the evaluator.
    pub style: Option<Tally>,
    /// One action and then the other, by the detectors. Of such a prompt this alone is judged.
    pub order: Option<Tally>,
    /// The other one first: what [`Verdict::order`] is to be compared with.
    pub reversed: Option<Tally>,
}

impl Verdict {
    /// Whether a judge misses something in a motion.
    pub fn failed(&self) -> bool {
        [self.evaluator, self.detectors, self.style, self.order].into_iter().flatten().any(|tally| !tally.whole())
    }
}

/// Those who judge.
pub struct Bench<'a> {
    /// What is accepted for what.
    pub table: &'a Actions,
    /// How the evaluator fares on real clips.
    pub accuracies: &'a BTreeMap<String, Accuracy>,
    /// Styles that the evaluator can name.
    pub styles: BTreeSet<&'a str>,
    /// Motions a prompt.
    pub seeds: usize,
}

impl Bench<'_> {
    /// Judges a prompt's motions; nobody judges those of nonsense.
    ///
    /// A judge that cannot tell one of the prompt's actions cannot say that it is missing, and leaves the prompt to the other. Actions
    /// that the table accepts for them count as met, where the judge can tell them.
    pub fn judge(&self, outcome: &Outcome) -> Verdict {
        let line = &outcome.line;
        let accepted = line.accepted(self.table);
        let tally = |judges: bool, met: &dyn Fn(&Shown) -> bool| {
            let met = outcome.motions.iter().filter(|shown| met(shown)).count();
            judges.then_some(Tally { met, of: self.seeds })
        };
        let trusted = |action: &String| self.accuracies.get(action).is_some_and(|accuracy| accuracy.trusted());
        let known = |actions: &[String]| !actions.is_empty() && actions.iter().all(|action| rule_of(action).is_some());
        if !line.then.is_empty() {
            let judges = known(&line.actions) && known(&line.then);
            return Verdict {
                evaluator: None,
                detectors: None,
                style: None,
                order: tally(judges, &|shown| shown.order.is_some_and(|order| order.asked)),
                reversed: tally(judges, &|shown| shown.order.is_some_and(|order| order.other)),
            };
        }
        let styled = !line.styles.is_empty() && line.styles.iter().any(|style| self.styles.contains(style.as_str()));
        Verdict {
            evaluator: tally(!line.nonsense() && line.actions.iter().all(trusted), &|shown| {
                accepted.contains(shown.action.as_str())
            }),
            detectors: tally(known(&line.actions), &|shown| {
                accepted.iter().any(|action| does(&shown.seen, action) == Some(true))
            }),
            style: tally(styled, &|shown| line.styles.contains(&shown.style)),
            order: None,
            reversed: None,
        }
    }
}
