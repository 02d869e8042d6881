//! Ways to say actions and styles (`docs/phrases.toml`), and the sentences that are made of them.
//!
//! A template marks its verbs and has slots and alternatives; frames put it into a sentence about a subject that it agrees with. The form
//! is described in `docs/data.md`, "Phrases". Words for a side stand in templates only as slots: with the same random numbers, the other
//! side gives the same sentence with left and right exchanged.

mod check;
mod inflect;
mod sentence;
#[cfg(test)]
mod tests;
mod written;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::table::{self, Error};
use crate::checkpoint::prior::MAX_PHRASE;
use crate::dataset::Side;
use inflect::{FORMS, Form};
use motionette::numerics::hash::Stream;
use sentence::{Sentence, pick, tidy};

/// What the file holds.
const WHAT: &str = "phrases";
/// Stands for `left` and `right` in a name.
const SIDE: &str = "{side}";
/// Slots that only an action with a side can fill.
const SIDED: [&str; 3] = ["side", "other", "clock"];
/// Slots that agree with the subject.
const AGREEING: [&str; 3] = ["they", "their", "themself"];
/// Subjects that verbs and pronouns agree with in the same way.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Group {
    weight: u32,
    names: Vec<String>,
    whom: Option<String>,
    they: String,
    their: String,
    themself: String,
    are: String,
    were: String,
    plural: bool,
}

/// Ways to say a style, by the place where they stand.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Style {
    name: String,
    accept: Vec<String>,
    adverb: Vec<String>,
    adjective: Vec<String>,
    manner: Vec<String>,
    lead: Vec<String>,
    person: Vec<String>,
    /// Verb phrases that say walking and the style in one.
    walk: Vec<String>,
}

/// Ways to say an action.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Action {
    name: String,
    /// Verb phrases, nouns, whole sentences.
    kinds: [Vec<String>; 3],
}

const DO: usize = 0;
const THING: usize = 1;
const SAY: usize = 2;
/// The action of which a style may have verbs of its own.
const WALK: &str = "walk";
/// One in so many sentences about walking in such a style has one of them.
const OWN_VERB: u32 = 3;

/// All phrases.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Phrases {
    who: Vec<Group>,
    /// Place of the subject of sentences that name none.
    you: usize,
    frames: [Vec<String>; 2],
    order: Vec<String>,
    typos: BTreeMap<String, Vec<String>>,
    verbs: BTreeMap<String, [String; 3]>,
    styles: Vec<Style>,
    actions: Vec<Action>,
}

fn lines(text: &str) -> Vec<String> {
    text.lines().map(str::trim).filter(|line| !line.is_empty()).map(str::to_owned).collect()
}

impl Phrases {
    /// Reads and checks phrases.
    ///
    /// # Errors
    /// [`Error`], naming the file and the line.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref();
        Self::parse(path, &table::read(path, WHAT)?)
    }

    /// The phrases in `text`; `path` is what errors name.
    ///
    /// # Errors
    /// [`Error::Syntax`], [`Error::Entry`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let file: written::File = table::parse(path, text, WHAT)?;
        let who: Vec<Group> = file.who.into_iter().map(Group::from).collect();
        let mut phrases = Phrases {
            you: who.iter().position(|group| group.names == ["you"]).unwrap_or(usize::MAX),
            who,
            frames: [lines(&file.frames.action), lines(&file.frames.thing)],
            order: lines(&file.order.two),
            typos: file.typos.iter().map(|(word, typos)| (word.clone(), words(typos))).collect(),
            verbs: BTreeMap::new(),
            styles: file.style.into_iter().map(Style::from).collect(),
            actions: file.action.into_iter().map(Action::from).collect(),
        };
        let fail = |part: &str, problem: String| {
            let line =
                text.lines().position(|line| line.trim() == part || line.starts_with(part)).map_or(0, |at| at + 1);
            Error::Entry { path: path.into(), line, problem }
        };
        for (verb, forms) in &file.verbs {
            let three = <[String; 3]>::try_from(words(forms)).map_err(|_| {
                fail(&format!("{verb} ="), format!("{verb:?} needs three forms: third person, -ing, past"))
            })?;
            phrases.verbs.insert(verb.clone(), three);
        }
        phrases.check().map_err(|(part, problem)| fail(&part, problem))?;
        Ok(phrases)
    }

    /// Names of the styles, each with those that may be taken for it.
    pub fn styles(&self) -> impl Iterator<Item = (&str, &[String])> {
        self.styles.iter().map(|style| (style.name.as_str(), style.accept.as_slice()))
    }

    /// How many templates a canonical action has; 0 when it is unknown.
    #[must_use]
    pub fn templates(&self, action: &str) -> usize {
        self.action(action, Side::None).map_or(0, |(action, _)| action.kinds.iter().map(Vec::len).sum())
    }

    /// Name of the entry of a canonical action, perhaps with `{side}`, and the side that the action's name or else `side` says.
    #[must_use]
    pub fn entry(&self, action: &str, side: Side) -> Option<(&str, Side)> {
        self.action(action, side).map(|(action, side)| (action.name.as_str(), side))
    }

    /// The plainest sentence for the entry of that name: "a person" and its first verb phrase that says the side, where there is one, and is
    /// short enough for a phrase bank. `None` where no phrase is.
    #[must_use]
    pub fn plain(&self, entry: &str, side: Side) -> Option<String> {
        let action = self.actions.iter().find(|action| action.name == entry)?;
        let usable = action.usable(DO, side);
        let sided = matches!(side, Side::Left | Side::Right);
        let says = |template: &&&str| template.contains("{side}") || template.contains("{clock}");
        let sentence = Sentence::plain(self, side);
        let said = |template: &&str| {
            let deed = sentence.fill(&first(template), Form::Agree, &mut Stream::new(0));
            tidy(&format!("{} {deed}", sentence.slot("who")))
        };
        let short: Vec<String> = usable
            .iter()
            .filter(|template| !sided || says(template))
            .map(said)
            .filter(|said| said.len() <= MAX_PHRASE)
            .collect();
        // A template may say the side in one of its alternatives alone.
        let aloud = |said: &&String| {
            said.split(' ').any(|word| word == sentence.slot("side") || word == sentence.slot("clock"))
        };
        short.iter().find(|said| sided && aloud(said)).or(short.first()).cloned()
    }

    /// The plainest way to say a style.
    #[must_use]
    pub fn plain_style(&self, name: &str) -> Option<String> {
        let style = self.styles.iter().find(|style| style.name == name)?;
        let template = style.adverb.first().or(style.manner.first())?;
        Some(tidy(&Sentence::plain(self, Side::None).fill(&first(template), Form::Base, &mut Stream::new(0))))
    }

    /// Words of the templates of a canonical action: verbs in all their forms, nothing of slots. Empty for an action that is unknown.
    #[must_use]
    pub fn words(&self, action: &str) -> BTreeSet<String> {
        let mut words = BTreeSet::new();
        let templates =
            self.action(action, Side::None).into_iter().flat_map(|(action, _)| action.kinds.iter().flatten());
        for part in templates.flat_map(|template| template.split('{')) {
            let text = part.split_once('}').map_or(part, |(_slot, text)| text);
            for word in text.split([' ', '(', '|', ')', ',']).filter(|word| !word.is_empty()) {
                match word.strip_prefix('*') {
                    Some(verb) => words.extend(FORMS.map(|(_, form)| self.inflect(verb, form, &self.who[0]))),
                    None => drop(words.insert(word.to_owned())),
                }
            }
        }
        words
    }

    /// The entry of a canonical action, and the side that its name or else `side` says.
    fn action(&self, name: &str, side: Side) -> Option<(&Action, Side)> {
        self.actions.iter().find_map(|action| {
            if action.name == name {
                return Some((action, side));
            }
            let sided = |side: Side| action.name.contains(SIDE) && action.name.replace(SIDE, &side.to_string()) == name;
            [Side::Left, Side::Right].into_iter().find(|side| sided(*side)).map(|side| (action, side))
        })
    }

    /// A sentence for a canonical action. `side` is that of the clip and does not count where the name says one. `None` for an action or a
    /// style that has no phrases.
    pub fn sentence(&self, action: &str, side: Side, style: Option<&str>, stream: &mut Stream) -> Option<String> {
        let (action, side) = self.action(action, side)?;
        let style = match style {
            Some(name) => Some(self.styles.iter().find(|style| style.name == name)?),
            None => None,
        };
        let own = style.filter(|style| action.name == WALK && !style.walk.is_empty() && stream.below(OWN_VERB) == 0);
        let kind = *pick(stream, &[DO, DO, THING, SAY, SAY]);
        let kind = if own.is_some() || action.usable(kind, side).is_empty() { DO } else { kind };
        let usable = action.usable(kind, side);
        let (template, style) = match own {
            Some(own) => (pick(stream, &own.walk).as_str(), None),
            None => (*pick(stream, &usable), style),
        };
        loop {
            let frame = match kind {
                SAY if template.contains("{end}") => template.to_owned(),
                SAY => format!("{template} {{end}}"),
                _ => pick(stream, self.frames.get(kind)?).clone(),
            };
            let mut sentence = Sentence::new(self, &frame, side, stream);
            if let Some(style) = style
                && !sentence.style(style, &frame, stream)
            {
                continue;
            }
            match kind {
                DO => sentence.verbs("", template, &frame, stream),
                THING => {
                    let thing = sentence.fill(template, Form::Base, stream);
                    sentence.slots.push(("thing".into(), thing));
                }
                _ => {}
            }
            return Some(tidy(&sentence.fill(&frame, Form::Agree, stream)));
        }
    }

    /// A sentence for two canonical actions, the first of which comes first. `None` for one that has no phrases.
    pub fn sequence(&self, first: (&str, Side), second: (&str, Side), stream: &mut Stream) -> Option<String> {
        let frame = pick(stream, &self.order);
        let mut sentence = Sentence::new(self, frame, Side::None, stream);
        for (digit, (name, side)) in [("1", first), ("2", second)] {
            let (action, side) = self.action(name, side)?;
            let template = *pick(stream, &action.usable(DO, side));
            sentence.side = side;
            sentence.verbs(digit, template, frame, stream);
        }
        Some(tidy(&sentence.fill(frame, Form::Agree, stream)))
    }

    /// The sentence with one word misspelt, where one has a common misspelling.
    #[must_use]
    pub fn misspelt(&self, sentence: &str, stream: &mut Stream) -> String {
        let mut words: Vec<&str> = sentence.split(' ').collect();
        let can: Vec<usize> = (0..words.len()).filter(|at| self.typos.contains_key(words[*at])).collect();
        if !can.is_empty() {
            let at = *pick(stream, &can);
            words[at] = pick::<String>(stream, &self.typos[words[at]]);
        }
        words.join(" ")
    }
}

impl Style {
    fn templates(&self) -> impl Iterator<Item = &String> {
        [&self.adverb, &self.adjective, &self.manner, &self.lead, &self.person, &self.walk].into_iter().flatten()
    }
}

impl Action {
    /// Templates of a kind that this side can fill.
    fn usable(&self, kind: usize, side: Side) -> Vec<&str> {
        let sided = matches!(side, Side::Left | Side::Right);
        let asks = |template: &str| SIDED.iter().any(|slot| template.contains(&format!("{{{slot}}}")));
        self.kinds
            .get(kind)
            .into_iter()
            .flatten()
            .map(String::as_str)
            .filter(|template| sided || !asks(template))
            .collect()
    }
}

/// The template with the first of its alternatives.
fn first(template: &str) -> String {
    let mut parts = template.split('(');
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (inside, after) = part.split_once(')').unwrap_or((part, ""));
        text.push_str(inside.split('|').next().unwrap_or_default());
        text.push_str(after);
    }
    text
}

/// Words of a list.
fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}
