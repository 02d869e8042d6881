//! The figures over all prompts, for people and as JSON.

use std::collections::BTreeMap;
use std::path::Path;

use motionette_host::detect::Seen;
use motionette_host::detect::score::Score;
use motionette_host::output::{self, write_atomic};
use serde_json::{Map, Value, json};

use super::trust::{Accuracy, LEAST_ACCURACY};
use super::verdict::{Outcome, Tally, Verdict};
use crate::evaluate::bootstrap;
use crate::evaluate::report::Facts;

/// Random numbers of the intervals.
const SEED: u64 = 18;

/// A share and half the width of its 95 % interval; prompts are drawn again by their first action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Share {
    /// The share, 0 to 1.
    pub mean: f64,
    /// Half the width.
    pub half_width: f64,
    /// Prompts that it is over.
    pub prompts: usize,
}

/// Shares of the prompts that have no content word of what was said of their actions in training.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unseen {
    /// In captions of the training split.
    pub captions: f64,
    /// In templates of phrases.
    pub phrases: f64,
}

/// Everything that is reported.
pub struct Report<'a> {
    /// What became of the prompts.
    pub outcomes: &'a [Outcome],
    /// What the judges say, in the same order.
    pub verdicts: &'a [Verdict],
    /// How the evaluator fares on real test clips.
    pub accuracies: &'a BTreeMap<String, Accuracy>,
    /// How the detectors fare on real test clips.
    pub scores: &'a [Score],
    /// Shares of prompts that say their actions in other words.
    pub unseen: Unseen,
    /// What the table was made from.
    pub facts: &'a Facts,
}

/// One of the tallies of a verdict.
type Pick = fn(&Verdict) -> Option<Tally>;

/// Columns of the tables, with how they are taken.
const JUDGES: [(&str, Pick); 5] = [
    ("evaluator", |verdict| verdict.evaluator),
    ("detectors", |verdict| verdict.detectors),
    ("style", |verdict| verdict.style),
    ("order", |verdict| verdict.order),
    ("reversed", |verdict| verdict.reversed),
];

impl Report<'_> {
    /// The share of motions that a judge finds right; none where it judges nothing.
    pub fn share(&self, pick: Pick) -> Option<Share> {
        let mut groups: BTreeMap<&str, Tally> = BTreeMap::new();
        let mut prompts = 0;
        for (outcome, verdict) in self.outcomes.iter().zip(self.verdicts) {
            let Some(tally) = pick(verdict) else { continue };
            let action = outcome.line.actions.first().map_or("", String::as_str);
            let group = groups.entry(action).or_insert(Tally { met: 0, of: 0 });
            *group = Tally { met: group.met + tally.met, of: group.of + tally.of };
            prompts += 1;
        }
        let groups: Vec<Tally> = groups.into_values().collect();
        let mean = |members: &mut dyn Iterator<Item = usize>| {
            let (met, of) = members.fold((0, 0), |(met, of), i| (met + groups[i].met, of + groups[i].of));
            met as f64 / (of as f64).max(1.0)
        };
        let half_width = bootstrap::half_width(groups.len(), SEED, |draws| mean(&mut draws.iter().copied()));
        (prompts > 0).then(|| Share { mean: mean(&mut (0..groups.len())), half_width, prompts })
    }

    /// The share of the prompts that are nonsense, or of the others, of which something holds.
    fn count(&self, nonsense: bool, holds: impl Fn(&Outcome) -> bool) -> f64 {
        let prompts = || self.outcomes.iter().filter(|outcome| outcome.line.nonsense() == nonsense);
        prompts().filter(|outcome| holds(outcome)).count() as f64 / prompts().count().max(1) as f64
    }

    /// Share of prompts of which the model says that it hardly understood them; none of a model that was not taught to say so.
    pub fn warned_share(&self) -> Option<f64> {
        self.taught().then(|| self.count(false, |outcome| outcome.sure == Some(false)))
    }

    /// Share of nonsense that the model hardly understood, or refused.
    pub fn caught_share(&self) -> Option<f64> {
        let any = self.outcomes.iter().any(|outcome| outcome.line.nonsense());
        (any && self.taught()).then(|| self.count(true, |outcome| outcome.sure != Some(true)))
    }

    fn taught(&self) -> bool {
        self.outcomes.iter().any(|outcome| outcome.sure.is_some())
    }

    /// Share of prompts with a word that the model does not know.
    pub fn unknown_share(&self) -> f64 {
        self.count(false, |outcome| outcome.unknown_words > 0)
    }

    /// Share of prompts that the runtime refuses.
    pub fn refused_share(&self) -> f64 {
        self.count(false, |outcome| outcome.refused.is_some())
    }

    /// The lower of both judges' shares: what both agree is reached.
    pub fn action_share(&self) -> Option<f64> {
        [JUDGES[0], JUDGES[1]]
            .into_iter()
            .filter_map(|(_, pick)| self.share(pick))
            .map(|share| share.mean)
            .reduce(f64::min)
    }

    /// Prompts by their first action, with the judges' tallies.
    fn by_action(&self) -> BTreeMap<&str, (usize, [Tally; JUDGES.len()])> {
        let mut rows: BTreeMap<&str, (usize, [Tally; JUDGES.len()])> = BTreeMap::new();
        for (outcome, verdict) in self.outcomes.iter().zip(self.verdicts) {
            let Some(action) = outcome.line.actions.first() else { continue };
            let (prompts, tallies) = rows.entry(action).or_insert((0, [Tally { met: 0, of: 0 }; JUDGES.len()]));
            *prompts += 1;
            for (sum, (_, pick)) in tallies.iter_mut().zip(JUDGES) {
                let Tally { met, of } = pick(verdict).unwrap_or(Tally { met: 0, of: 0 });
                *sum = Tally { met: sum.met + met, of: sum.of + of };
            }
        }
        rows
    }

    fn failed(&self) -> impl Iterator<Item = (&Outcome, &Verdict)> {
        self.outcomes
            .iter()
            .zip(self.verdicts)
            .filter(|(outcome, verdict)| outcome.refused.is_some() || verdict.failed())
    }

    /// `{"table": "prompts", "action_share", "style_share", "unknown_share", "refused_share", "judges", "rows", "failed", ...}`.
    pub fn json(&self) -> Value {
        let mut judges = Map::new();
        for (name, pick) in JUDGES {
            let share = self.share(pick);
            judges.insert(
                name.into(),
                json!({
                    "share": share.map(|share| share.mean),
                    "share_ci": share.map(|share| share.half_width),
                    "prompts": share.map_or(0, |share| share.prompts),
                }),
            );
        }
        let rows: Vec<Value> = self
            .by_action()
            .into_iter()
            .map(|(action, (prompts, tallies))| {
                let share = |tally: Tally| (tally.of > 0).then(|| tally.met as f64 / tally.of as f64);
                let mut row = Map::from_iter([("name".into(), json!(action)), ("prompts".into(), json!(prompts))]);
                row.extend(
                    JUDGES.iter().zip(tallies.map(share)).map(|((name, _), share)| ((*name).into(), json!(share))),
                );
                Value::Object(row)
            })
            .collect();
        let failed: Vec<Value> = self.failed().map(|(outcome, verdict)| failure(outcome, verdict)).collect();
        let evaluator: Vec<Value> = self
            .accuracies
            .iter()
            .map(|(action, accuracy)| {
                json!({"name": action, "clips": accuracy.clips, "accuracy": accuracy.share(), "judges": accuracy.trusted()})
            })
            .collect();
        let detectors: Vec<Value> = self
            .scores
            .iter()
            .map(|score| {
                json!({
                    "name": score.action, "clips": score.clips, "recall": score.recall(), "precision": score.precision(),
                    "false_alarms": score.false_alarm_share(),
                })
            })
            .collect();
        let style = self.share(JUDGES[2].1);
        let files: Map<String, Value> =
            self.facts.files.iter().map(|(name, hash)| (name.clone(), json!(hash))).collect();
        json!({
            "table": "prompts",
            "prompts": self.outcomes.len(),
            "seeds": self.facts.seeds,
            "action_share": self.action_share(),
            "style_share": style.map(|share| share.mean),
            "style_share_ci": style.map(|share| share.half_width),
            "order_share": self.share(JUDGES[3].1).map(|share| share.mean),
            "unknown_share": self.unknown_share(),
            "refused_share": self.refused_share(),
            "warned_share": self.warned_share(),
            "caught_share": self.caught_share(),
            "unseen_share": self.unseen.captions,
            "unseen_phrases_share": self.unseen.phrases,
            "judges": judges,
            "rows": rows,
            "failed": failed,
            "real": {"evaluator": evaluator, "detectors": detectors},
            "files": files,
            "generation": self.facts.generation,
            "command": self.facts.command,
        })
    }

    /// The page for people.
    pub fn markdown(&self) -> String {
        let cell = |share: Option<Share>| {
            share.map_or("-".into(), |s| format!("{:.3} ± {:.3} ({} prompts)", s.mean, s.half_width, s.prompts))
        };
        let mut text = format!(
            "# Prompts in a newcomer's words\n\nMade by `{}`. {} prompts, {} motions each by the int8 runtime, of the length that the \
             model suggests. Shares are of motions, with half the width of a 95 % bootstrap interval over actions. The evaluator \
             judges actions that it names right on {LEAST_ACCURACY} of their real test clips, the detectors those that a rule over \
             joints answers for; a prompt is left to the other judge where one of its actions is not among them. Motions of refused \
             prompts count as wrong.\n\n\
             Of prompts of two things in an order the detectors say whether some cut of the motion has the first before it and the \
             second behind it, and, beside it, how often the other way round.\n\n\
             | action, evaluator | action, detectors | style | order | other order | prompts with unknown words | refused | hardly understood | nonsense caught | \
             without a caption's words | \
             without a phrase's words |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
            self.facts.command,
            self.outcomes.len(),
            self.facts.seeds
        );
        let judges = JUDGES.map(|(_, pick)| cell(self.share(pick))).join(" | ");
        let percent = |share: Option<f64>| share.map_or("-".into(), |share| format!("{share:.3}"));
        text += &format!(
            "| {judges} | {:.3} | {:.3} | {} | {} | {:.3} | {:.3} |\n",
            self.unknown_share(),
            self.refused_share(),
            percent(self.warned_share()),
            percent(self.caught_share()),
            self.unseen.captions,
            self.unseen.phrases
        );
        text += "\n## By first action\n\n| action | prompts | evaluator | detectors | style | order | other order |\n|---|---|---|---|---|---|---|\n";
        for (action, (prompts, tallies)) in self.by_action() {
            let share = |tally: Tally| if tally.of > 0 { format!("{}/{}", tally.met, tally.of) } else { "-".into() };
            text += &format!("| {action} | {prompts} | {} |\n", tallies.map(share).join(" | "));
        }
        text += "\n## Prompts that failed\n\nA motion or more without what was asked for; each motion as evaluator / detectors see it.\n\n";
        for (outcome, verdict) in self.failed() {
            text += &format!("- {}\n", described(outcome, verdict));
        }
        text += "\n## The evaluator on real test clips\n\n| action | clips | accuracy | judges |\n|---|---|---|---|\n";
        for (action, accuracy) in self.accuracies {
            let judges = if accuracy.trusted() { "yes" } else { "no" };
            text += &format!("| {action} | {} | {:.3} | {judges} |\n", accuracy.clips, accuracy.share());
        }
        text += "\n## The detectors on real test clips\n\n| action | clips | recall | precision | false alarms |\n|---|---|---|---|---|\n";
        for score in self.scores {
            let share = |share: Option<f64>| share.map_or("-".into(), |share| format!("{share:.3}"));
            let [recall, precision, alarms] = [score.recall(), score.precision(), score.false_alarm_share()].map(share);
            text += &format!("| {} | {} | {recall} | {precision} | {alarms} |\n", score.action, score.clips);
        }
        text += "\n## Made from\n\n| file | SHA-256 |\n|---|---|\n";
        for (name, hash) in &self.facts.files {
            text += &format!("| {name} | `{hash}` |\n");
        }
        text + &format!("\nGeneration: `{}`\n", self.facts.generation)
    }

    /// Writes `prompts.json` and `prompts.md` into a folder, each whole or not at all.
    ///
    /// # Errors
    /// [`output::Error`].
    pub fn save(&self, folder: &Path) -> Result<(), output::Error> {
        let mut data = serde_json::to_string_pretty(&self.json()).unwrap_or_default();
        data.push('\n');
        let page = self.markdown();
        write_atomic(folder.join("prompts.json"), |w| w.write_all(data.as_bytes()))?;
        write_atomic(folder.join("prompts.md"), |w| w.write_all(page.as_bytes()))
    }
}

fn seen_words(seen: &[Seen]) -> String {
    if seen.is_empty() { "nothing".into() } else { seen.iter().map(Seen::to_string).collect::<Vec<_>>().join(", ") }
}

/// One prompt that failed, on one line.
pub fn described(outcome: &Outcome, verdict: &Verdict) -> String {
    let line = &outcome.line;
    let mut text = format!("line {}, {:?}: asked for {}", line.number, line.text, line.actions.join(" or "));
    if !line.then.is_empty() {
        text += &format!(", then {}", line.then.join(" or "));
    }
    if !line.styles.is_empty() {
        text += &format!(", {}", line.styles.join(" or "));
    }
    if let Some(reason) = &outcome.refused {
        return text + &format!("; refused: {reason}");
    }
    for (name, pick) in JUDGES {
        if let Some(Tally { met, of }) = pick(verdict) {
            text += &format!("; {name} {met}/{of}");
        }
    }
    if outcome.unknown_words > 0 {
        text += &format!("; {} unknown words", outcome.unknown_words);
    }
    for shown in &outcome.motions {
        let style = if line.styles.is_empty() { String::new() } else { format!(" ({})", shown.style) };
        text += &format!("; {}{style} / {}", shown.action, seen_words(&shown.seen));
    }
    text
}

fn failure(outcome: &Outcome, verdict: &Verdict) -> Value {
    let tally = |tally: Option<Tally>| tally.map(|tally| json!([tally.met, tally.of]));
    let motions: Vec<Value> = outcome
        .motions
        .iter()
        .map(|shown| {
            let seen: Vec<String> = shown.seen.iter().map(Seen::to_string).collect();
            json!({"evaluator": shown.action, "style": shown.style, "detectors": seen})
        })
        .collect();
    json!({
        "line": outcome.line.number,
        "text": outcome.line.text,
        "actions": outcome.line.actions,
        "styles": outcome.line.styles,
        "then": outcome.line.then,
        "refused": outcome.refused,
        "unknown_words": outcome.unknown_words,
        "evaluator": tally(verdict.evaluator),
        "detectors": tally(verdict.detectors),
        "style": tally(verdict.style),
        "order": tally(verdict.order),
        "motions": motions,
    })
}
