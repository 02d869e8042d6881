//! Prompts that share no content word with what the model was trained on for their actions: captions, and templates of phrases.
//!
//! Content words are all words but those of [`STOP`]; words count as the same when their stems ([`stem`]) are: `strolls` and `strolled`
//! are `stroll`. The stemmer is crude, and errs to the side of calling a word seen.

use std::collections::{BTreeMap, BTreeSet};

use motionette_host::dataset::{Dataset, Split};
use motionette_host::import::actions::Actions;
use motionette_host::import::phrases::Phrases;

use super::file::Line;

/// Words that do not count: articles, pronouns, prepositions, auxiliaries, politeness, degrees, sides and words for somebody.
pub const STOP: &str = "a about actually after again ah all almost also always am an and any anybody anyone are aren't as at away be been \
    before behind being bit both but by can can't cannot could couldn't did didn't do does doesn't doing don't done down each ever every \
    everyone far for from get gets getting give given gives go goes going got had has have he he'd he'll he's her here hers herself hey hi \
    him himself his how i i'd i'll i'm i've if i'm in into is isn't it it's its itself just keep keeps kind let let's like little lot lots \
    make makes making may maybe me might mine more most my myself need needs never next no nor not now of off oh ok okay on once one only onto \
    or other our out over own please quite rather really right left same see seen shall she she's should show shows so some somebody \
    someone something somewhere still such sure take takes taking than thanks that that's the their them then there there's these they \
    they're they've thing things this those though through to too toward towards try trying under until up upon us very want wants was way we \
    we're well were what what's when where which while who whose why will with without won't would yes yet you you'd you'll you're your \
    yourself person people man men woman women boy girl guy lady gentleman figure character robot body human kid child somebody's";

/// A word without its commonest endings.
pub fn stem(word: &str) -> String {
    let word = word.strip_suffix("'s").unwrap_or(word);
    let long = |stem: &&str| stem.len() >= 3;
    let mut stem = ["ing", "ies", "ied", "ed", "es", "s", "ly"]
        .iter()
        .find_map(|ending| {
            word.strip_suffix(ending).filter(long).map(|stem| match *ending {
                "ies" | "ied" => format!("{stem}y"),
                _ => stem.to_owned(),
            })
        })
        .unwrap_or_else(|| word.to_owned());
    // running, hopped; wave and waving.
    let bytes = stem.as_bytes();
    if let [.., a, b] = bytes
        && a == b
        && stem.len() > 3
        && !matches!(b, b'l' | b's' | b'e')
    {
        stem.pop();
    }
    if stem.len() > 3 && stem.ends_with('e') {
        stem.pop();
    }
    stem
}

/// Stems of the content words of a sentence.
pub fn content_words(sentence: &str) -> BTreeSet<String> {
    let stop: BTreeSet<&str> = STOP.split_whitespace().collect();
    let lower = sentence.to_lowercase();
    let words = lower.split(|c: char| !c.is_alphanumeric() && c != '\'').map(|word| word.trim_matches('\''));
    let stops = |word: &str| stop.contains(word) || word.strip_suffix("'s").is_some_and(|word| stop.contains(word));
    words.filter(|word| !word.is_empty() && !stops(word)).map(stem).collect()
}

/// Content words of what was said of each action in training.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TrainingWords {
    words: BTreeMap<String, BTreeSet<String>>,
}

impl TrainingWords {
    /// Adds what is said of an action.
    pub fn add(&mut self, action: &str, said: &str) {
        self.words.entry(action.to_owned()).or_default().extend(content_words(said));
    }

    /// Those of the captions of the training split.
    pub fn captions(dataset: &Dataset) -> Self {
        let mut words = Self::default();
        for clip in dataset.split(Split::Train) {
            if let Some(action) = clip.info.action() {
                clip.info.captions.iter().for_each(|caption| words.add(action, &caption.text));
            }
        }
        words
    }

    /// Those of the templates of phrases, for the actions of a table.
    pub fn templates(phrases: &Phrases, table: &Actions) -> Self {
        let mut words = Self::default();
        for action in &table.actions {
            phrases.words(&action.name).iter().for_each(|word| words.add(&action.name, word));
        }
        words
    }

    /// Content words of a prompt that were said of one of its actions.
    pub fn shared(&self, line: &Line) -> Vec<String> {
        let known = |word: &String| line.actions.iter().any(|a| self.words.get(a).is_some_and(|w| w.contains(word)));
        content_words(&line.text).into_iter().filter(known).collect()
    }

    /// Share of the prompts that have no such word; 0 without prompts.
    pub fn unseen_share(&self, lines: &[Line]) -> f64 {
        let meant = || lines.iter().filter(|line| !line.nonsense());
        let unseen = meant().filter(|line| self.shared(line).is_empty()).count();
        unseen as f64 / meant().count().max(1) as f64
    }
}
