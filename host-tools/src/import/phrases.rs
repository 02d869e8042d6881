//! Ways to say actions and styles (`docs/phrases.toml`), and the sentences that are made of them.
//!
//! A template marks its verbs and has slots and alternatives; frames put it into a sentence about a subject that it agrees with. The form
//! is described in `docs/data.md`, "Phrases". Words for a side stand in templates only as slots: with the same random numbers, the other
//! side gives the same sentence with left and right exchanged.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use motionette::numerics::hash::Stream;
use serde::Deserialize;

use crate::dataset::Side;
use crate::input;

/// Stands for `left` and `right` in a name.
const SIDE: &str = "{side}";
/// Slots that only an action with a side can fill.
const SIDED: [&str; 3] = ["side", "other", "clock"];
/// Slots that agree with the subject.
const AGREEING: [&str; 3] = ["they", "their", "themself"];
/// Slots of the sentence around an action.
const AROUND: [&str; 7] = ["who", "whom", "are", "were", "lead", "pre", "end"];
/// Words that must not stand in a template: a mirrored motion would keep them.
const FIXED: [&str; 8] =
    ["left", "right", "leftward", "rightward", "leftwards", "rightwards", "clockwise", "counterclockwise"];
/// One in so many times `{their}` is `the`.
const THE: u32 = 5;

/// Why phrases cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the phrases {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not TOML, or a key has another type or name.
    #[error("{} holds no phrases; docs/data.md describes its keys", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What the reader said, with line and column.
        source: Box<toml::de::Error>,
    },
    /// An entry or a template that no sentence can be made of.
    #[error("{} line {line}: {problem}", path.display())]
    Entry {
        /// The file.
        path: PathBuf,
        /// Line, from 1; 0 where no line is to blame.
        line: usize,
        /// What is wrong and what to do.
        problem: String,
    },
}

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

/// Form of a verb.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Base,
    /// As the subject asks.
    Agree,
    Ing,
    Past,
}

/// The slots of a verb phrase in each of its forms.
const FORMS: [(&str, Form); 4] = [("do", Form::Base), ("does", Form::Agree), ("doing", Form::Ing), ("did", Form::Past)];

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

/// The file as it is written.
mod written {
    use super::{BTreeMap, Deserialize};

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct File {
        pub who: Vec<Group>,
        pub frames: Frames,
        pub order: Order,
        pub typos: BTreeMap<String, String>,
        pub verbs: BTreeMap<String, String>,
        pub style: Vec<Style>,
        pub action: Vec<Action>,
    }

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Group {
        pub weight: u32,
        pub names: String,
        pub whom: Option<String>,
        pub they: String,
        pub their: String,
        pub themself: String,
        pub are: String,
        pub were: String,
        #[serde(default)]
        pub plural: bool,
    }

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Frames {
        #[serde(rename = "do")]
        pub action: String,
        pub thing: String,
    }

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Order {
        pub two: String,
    }

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Style {
        pub name: String,
        #[serde(default)]
        pub accept: Vec<String>,
        pub adverb: String,
        pub adjective: String,
        pub manner: String,
        pub lead: String,
        pub person: String,
    }

    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    pub struct Action {
        pub name: String,
        #[serde(rename = "do")]
        pub verbs: String,
        pub thing: String,
        pub say: String,
    }
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
        let text =
            input::read_text(path, input::WRITTEN).map_err(|source| Error::Read { path: path.into(), source })?;
        Self::parse(path, &text)
    }

    /// The phrases in `text`; `path` is what errors name.
    ///
    /// # Errors
    /// [`Error::Syntax`], [`Error::Entry`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let file: written::File =
            toml::from_str(text).map_err(|source| Error::Syntax { path: path.into(), source: Box::new(source) })?;
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

    /// The part that is wrong, and why.
    fn check(&self) -> Result<(), (String, String)> {
        let fail = |part: &str, problem: &str| Err((part.to_owned(), problem.to_owned()));
        if self.you == usize::MAX || self.who.iter().any(|group| group.names.is_empty() || group.weight == 0) {
            return fail("[[who]]", "every [[who]] needs names and a weight, and one has the name `you` alone");
        }
        let [do_frames, thing_frames] = &self.frames;
        if do_frames.is_empty() || thing_frames.is_empty() || self.order.is_empty() {
            return fail("[frames]", "there are no frames, or none for two actions");
        }
        for frame in do_frames {
            if slots(frame)?.filter(|slot| FORMS.iter().any(|(form, _)| form == slot)).count() != 1 {
                return fail(frame, "a frame needs one of {do}, {does}, {doing}, {did}");
            }
        }
        for frame in thing_frames {
            if slots(frame)?.filter(|slot| *slot == "thing").count() != 1 {
                return fail(frame, "a frame needs {thing} once");
            }
        }
        let numbered = |slot: &str, digit: char| {
            slot.strip_suffix(digit).is_some_and(|rest| FORMS.iter().any(|(form, _)| *form == rest))
        };
        for frame in &self.order {
            for digit in ['1', '2'] {
                if slots(frame)?.filter(|slot| numbered(slot, digit)).count() != 1 {
                    return fail(frame, "two actions in order need one verb slot ending in 1 and one ending in 2");
                }
            }
        }
        let known = |template: &str, more: &[&[&str]]| {
            for slot in slots(template)? {
                if !AGREEING.contains(&slot) && !more.iter().any(|slots| slots.contains(&slot)) {
                    return fail(template, &format!("there is no slot {{{slot}}} here"));
                }
            }
            let word = |c: char| !c.is_ascii_alphanumeric();
            match template.split(word).find(|word| FIXED.contains(word)) {
                Some(word) => fail(
                    template,
                    &format!("{word:?} would stay in mirrored motion; use {SIDE}, {{other}} or {{clock}}"),
                ),
                None => Ok(()),
            }
        };
        for frame in do_frames {
            known(frame, &[&AROUND, &FORMS.map(|(slot, _)| slot)])?;
        }
        for frame in thing_frames {
            known(frame, &[&AROUND, &["thing"]])?;
        }
        for action in &self.actions {
            let [verbs, things, sentences] = &action.kinds;
            if verbs.is_empty() || (action.name.contains(SIDE) && !verbs.iter().any(|verb| verb.contains(SIDE))) {
                return fail(
                    &format!("name = \"{}\"", action.name),
                    "the action needs a `do`, with its side if it has one",
                );
            }
            for template in verbs {
                known(template, &[&SIDED])?;
                if !template.contains('*') {
                    return fail(template, "no verb is marked with *");
                }
            }
            for template in things {
                known(template, &[&SIDED])?;
            }
            for template in sentences {
                known(template, &[&SIDED, &AROUND])?;
            }
        }
        for style in &self.styles {
            if style.adverb.is_empty() || style.manner.is_empty() {
                return fail(&format!("name = \"{}\"", style.name), "the style needs adverbs and manners");
            }
            for template in style.templates() {
                known(template, &[])?;
            }
        }
        Ok(())
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
        let kind = *pick(stream, &[DO, DO, DO, THING, SAY]);
        let kind = if action.usable(kind, side).is_empty() { DO } else { kind };
        let usable = action.usable(kind, side);
        let template = *pick(stream, &usable);
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

    /// A form of a verb for a subject.
    fn inflect(&self, verb: &str, form: Form, who: &Group) -> String {
        match form {
            Form::Agree if verb == "be" => return who.are.clone(),
            Form::Past if verb == "be" => return who.were.clone(),
            Form::Base => return verb.to_owned(),
            Form::Agree if who.plural => return verb.to_owned(),
            _ => {}
        }
        if let Some([third, ing, past]) = self.verbs.get(verb) {
            return match form {
                Form::Ing => ing,
                Form::Past => past,
                _ => third,
            }
            .clone();
        }
        let vowel = |c: char| matches!(c, 'a' | 'e' | 'i' | 'o' | 'u');
        let cut = |ending: &str| verb.strip_suffix(ending);
        // Carry, not play.
        let carry = cut("y").filter(|stem| !stem.ends_with(vowel));
        match (form, carry) {
            (Form::Agree, Some(stem)) => return format!("{stem}ies"),
            (Form::Agree, None) => {
                let hissing = ["s", "x", "z", "ch", "sh", "o"].iter().any(|ending| verb.ends_with(ending));
                return format!("{verb}{}", if hissing { "es" } else { "s" });
            }
            (Form::Past, Some(stem)) => return format!("{stem}ied"),
            _ => {}
        }
        let ending = if form == Form::Ing { "ing" } else { "ed" };
        if let (Form::Ing, Some(stem)) = (form, cut("ie")) {
            return format!("{stem}ying");
        }
        if let Some(stem) = cut("e") {
            let keeps = ["ee", "oe", "ye"].iter().any(|ending| verb.ends_with(ending));
            return match form {
                Form::Past => format!("{verb}d"),
                _ if keeps => format!("{verb}ing"),
                _ => format!("{stem}ing"),
            };
        }
        // One syllable, one vowel, one consonant: hop, not help, look or gallop.
        let sound = |c: char| vowel(c) || c == 'y';
        let groups = verb.split(|c| !sound(c)).filter(|part| !part.is_empty()).count();
        let mut back = verb.chars().rev();
        let doubled = match (back.next(), back.next(), back.next()) {
            (Some(last), Some(middle), before) if groups == 1 => {
                !sound(last) && !matches!(last, 'w' | 'x') && vowel(middle) && before.is_none_or(|c| !sound(c))
            }
            _ => false,
        };
        let again = if doubled { verb.get(verb.len() - 1..).unwrap_or_default() } else { "" };
        format!("{verb}{again}{ending}")
    }
}

impl From<written::Group> for Group {
    fn from(group: written::Group) -> Self {
        let written::Group { weight, names, whom, they, their, themself, are, were, plural } = group;
        Group { weight, names: lines(&names), whom, they, their, themself, are, were, plural }
    }
}

impl From<written::Style> for Style {
    fn from(style: written::Style) -> Self {
        let [adverb, adjective, manner, lead, person] =
            [&style.adverb, &style.adjective, &style.manner, &style.lead, &style.person].map(|text| lines(text));
        Style { name: style.name, accept: style.accept, adverb, adjective, manner, lead, person }
    }
}

impl Style {
    fn templates(&self) -> impl Iterator<Item = &String> {
        [&self.adverb, &self.adjective, &self.manner, &self.lead, &self.person].into_iter().flatten()
    }
}

impl From<written::Action> for Action {
    fn from(action: written::Action) -> Self {
        Action { name: action.name, kinds: [lines(&action.verbs), lines(&action.thing), lines(&action.say)] }
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

/// A sentence in the making: its subject, and what its slots hold so far.
struct Sentence<'p> {
    phrases: &'p Phrases,
    group: &'p Group,
    name: String,
    whom: String,
    /// Whether the sentence names its subject.
    spoken: bool,
    their: &'p str,
    side: Side,
    slots: Vec<(String, String)>,
}

impl<'p> Sentence<'p> {
    fn new(phrases: &'p Phrases, frame: &str, side: Side, stream: &mut Stream) -> Self {
        let spoken = frame.contains("{who}") || frame.contains("{whom}");
        let mut ticket = stream.below(phrases.who.iter().map(|group| group.weight).sum());
        let drawn = phrases.who.iter().find(|group| match ticket.checked_sub(group.weight) {
            Some(rest) => {
                ticket = rest;
                false
            }
            None => true,
        });
        let you = &phrases.who[phrases.you];
        let group = if spoken { drawn.unwrap_or(you) } else { you };
        let name = pick(stream, &group.names).clone();
        let whom = group.whom.clone().unwrap_or_else(|| name.clone());
        let their = if stream.below(THE) == 0 { "the" } else { &group.their };
        Sentence { phrases, group, name, whom, spoken, their, side, slots: Vec::new() }
    }

    /// Puts a style into one of the frame's places; `false` where none suits.
    fn style(&mut self, style: &'p Style, frame: &str, stream: &mut Stream) -> bool {
        let article = ["a ", "an ", "the "].iter().find(|article| self.name.starts_with(*article));
        let mut can: Vec<(&str, &'p [String])> = Vec::new();
        if frame.contains("{end}") {
            can.extend([
                ("end", &style.adverb[..]),
                ("end", &style.manner),
                ("end", &style.manner),
                ("after", &style.lead),
            ]);
        }
        if frame.contains("{pre}") {
            can.push(("pre", &style.adverb));
        }
        if frame.contains("{lead}") {
            can.extend([("lead", &style.lead[..]); 2]);
        }
        if self.spoken && article.is_some() {
            can.push(("adjective", &style.adjective));
        }
        if self.spoken {
            can.push(("person", &style.person));
        }
        can.retain(|(_, templates)| !templates.is_empty());
        if can.is_empty() {
            return false;
        }
        let (place, templates) = *pick(stream, &can);
        let template = pick(stream, templates);
        if place == "person" {
            // Spoken of as those of the first group.
            self.group = &self.phrases.who[0];
            self.their = &self.group.their;
            (self.name, self.whom) = (template.clone(), template.clone());
            return true;
        }
        let said = self.fill(template, Form::Base, stream);
        let (slot, said) = match (place, article) {
            ("adjective", Some(article)) => {
                let noun = &self.name[article.len()..];
                let vowel = said.starts_with(['a', 'e', 'i', 'o', 'u']);
                let article = match *article {
                    "the " => "the",
                    _ if vowel => "an",
                    _ => "a",
                };
                let name = format!("{article} {said} {noun}");
                (self.name, self.whom) = (name.clone(), name);
                return true;
            }
            ("after", _) => ("end", format!(", {said}")),
            ("lead", _) => ("lead", format!("{said},")),
            (slot, _) => (slot, said),
        };
        self.slots.push((slot.to_owned(), said));
        true
    }

    /// Fills the verb slots of a frame that end in `digit`.
    fn verbs(&mut self, digit: &str, template: &str, frame: &str, stream: &mut Stream) {
        for (slot, form) in FORMS {
            let slot = format!("{slot}{digit}");
            if frame.contains(&format!("{{{slot}}}")) {
                let said = self.fill(template, form, stream);
                self.slots.push((slot, said));
            }
        }
    }

    /// A template with alternatives drawn, verbs inflected, slots filled.
    fn fill(&self, template: &str, form: Form, stream: &mut Stream) -> String {
        let mut chosen = String::new();
        let mut rest = template;
        while let Some((before, open)) = rest.split_once('(') {
            let (inside, after) = open.split_once(')').unwrap_or((open, ""));
            let alternatives: Vec<&str> = inside.split('|').collect();
            chosen.push_str(before);
            chosen.push_str(pick::<&str>(stream, &alternatives));
            rest = after;
        }
        chosen.push_str(rest);
        let mut out = String::new();
        let mut rest = chosen.as_str();
        while let Some(at) = rest.find(['*', '{']) {
            let (before, marked) = rest.split_at(at);
            out.push_str(before);
            if let Some((slot, after)) = marked.strip_prefix('{').and_then(|slot| slot.split_once('}')) {
                out.push_str(&self.slot(slot));
                rest = after;
            } else {
                let verb = marked.trim_start_matches('*');
                let end = verb.find(|c: char| !c.is_ascii_lowercase() && c != '-').unwrap_or(verb.len());
                let (verb, after) = verb.split_at(end);
                out.push_str(&self.phrases.inflect(verb, form, self.group));
                rest = after;
            }
        }
        out.push_str(rest);
        out
    }

    fn slot(&self, slot: &str) -> String {
        let group = self.group;
        match slot {
            "who" => self.name.clone(),
            "whom" => self.whom.clone(),
            "are" => group.are.clone(),
            "were" => group.were.clone(),
            "they" => group.they.clone(),
            "their" => self.their.to_owned(),
            "themself" => group.themself.clone(),
            "side" => self.side.to_string(),
            "other" => self.side.mirrored().to_string(),
            // Seen from above.
            "clock" if self.side == Side::Left => "counterclockwise".to_owned(),
            "clock" => "clockwise".to_owned(),
            _ => self.slots.iter().find(|(name, _)| name == slot).map(|(_, said)| said.clone()).unwrap_or_default(),
        }
    }
}

/// The slots of a template in order; an error where brackets do not match or alternatives are nested.
fn slots(template: &str) -> Result<impl Iterator<Item = &str>, (String, String)> {
    let mut inside = [false; 2];
    let mut matched = true;
    for c in template.chars() {
        let (which, opens) = match c {
            '(' | ')' => (0, c == '('),
            '{' | '}' => (1, c == '{'),
            _ => continue,
        };
        matched &= inside[which] != opens;
        inside[which] = opens;
    }
    if !matched || inside != [false; 2] {
        return Err((template.to_owned(), "brackets do not match".to_owned()));
    }
    Ok(template.split('{').skip(1).filter_map(|part| part.split('}').next()))
}

/// Words of a list.
fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

/// One of `from`, which is not empty.
fn pick<'a, T>(stream: &mut Stream, from: &'a [T]) -> &'a T {
    let count = u32::try_from(from.len()).unwrap_or(u32::MAX);
    &from[stream.below(count) as usize]
}

/// Single spaces, none before a comma, none at the ends.
fn tidy(text: &str) -> String {
    let spaced = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let text = spaced.replace(" ,", ",").replace(" ?", "?");
    text.trim_matches([',', ' ']).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::actions::Actions;

    fn file(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs").join(name)
    }

    fn shipped() -> Phrases {
        Phrases::read(file("phrases.toml")).unwrap()
    }

    fn exchanged(sentence: &str) -> String {
        let parts = sentence.split_inclusive(|c: char| !c.is_ascii_lowercase());
        let pairs = [("left", "right"), ("counterclockwise", "clockwise")];
        let one = |part: &str| {
            let (word, end) = part.split_at(part.trim_end_matches(|c: char| !c.is_ascii_lowercase()).len());
            let other = pairs.iter().find_map(|(a, b)| {
                let stem = |from: &str, to: &str| {
                    word.strip_prefix(from)
                        .filter(|rest| ["", "ward", "wards"].contains(rest))
                        .map(|rest| format!("{to}{rest}"))
                };
                stem(a, b).or_else(|| stem(b, a))
            });
            other.unwrap_or_else(|| word.to_owned()) + end
        };
        parts.map(one).collect()
    }

    #[test]
    fn every_action_and_style_has_twenty_templates() {
        let phrases = shipped();
        let actions = Actions::read(file("actions.toml")).unwrap();
        assert_eq!(actions.actions.len(), 100);
        for action in &actions.actions {
            assert!(phrases.templates(&action.name) >= 20, "{}", action.name);
        }
        assert_eq!(phrases.styles.len(), 19);
        for style in &phrases.styles {
            assert!(style.templates().count() >= 20, "{}", style.name);
            assert!(style.accept.iter().all(|other| phrases.styles.iter().any(|style| style.name == *other)));
        }
    }

    #[test]
    fn the_other_side_is_the_same_sentence_exchanged() {
        let phrases = shipped();
        let actions = Actions::read(file("actions.toml")).unwrap();
        let mut sided = 0;
        for action in &actions.actions {
            let mirrored = exchanged(&action.name);
            for seed in 0..200 {
                let say =
                    |name: &str, side| phrases.sentence(name, side, Some("happy"), &mut Stream::new(seed)).unwrap();
                let (left, right) = (say(&action.name, Side::Left), say(&mirrored, Side::Right));
                assert_eq!(exchanged(&left), right);
                assert_eq!(exchanged(&right), left);
                sided += usize::from(left != right);
                let neither = phrases.sentence(&action.name, Side::None, None, &mut Stream::new(seed)).unwrap();
                assert!(!neither.contains(['{', '}', '(', ')', '*', '|']) && !neither.is_empty(), "{neither}");
                assert!(action.name != mirrored || exchanged(&neither) == neither, "{neither}");
            }
        }
        assert!(sided > 2_000);
    }

    #[test]
    fn verbs_and_pronouns_agree() {
        let text = r#"
frames = { do = "{who} {does} {end}", thing = "{thing}" }
order = { two = "{who} {does1} before {doing2}" }
typos = { walks = "wlaks" }
verbs = { lie = "lies lying lay", be = "is being was" }
[[who]]
weight = 1
names = "WHO"
they = "he"
their = "his"
themself = "himself"
are = "is"
were = "was"
PLURAL
[[who]]
weight = 1
names = "you"
they = "you"
their = "your"
themself = "yourself"
are = "are"
were = "were"
plural = true
[[style]]
name = "proud"
adverb = "proudly"
adjective = ""
manner = "as if {they} ruled"
lead = ""
person = ""
[[action]]
name = "lift"
do = "*carry it, *hop, *lie, *be calm and *watch {themself}"
thing = "a lift"
say = ""
"#;
        let say = |who: &str, plural: &str, form| {
            let text = text.replace("WHO", who).replace("PLURAL", plural);
            let phrases = Phrases::parse(Path::new("p"), &text).unwrap();
            let mut stream = Stream::new(0);
            let mut sentence = Sentence::new(&phrases, "{who}", Side::None, &mut stream);
            sentence.group = &phrases.who[0];
            sentence.fill(&phrases.actions[0].kinds[DO][0], form, &mut stream)
        };
        assert_eq!(say("he", "", Form::Agree), "carries it, hops, lies, is calm and watches himself");
        assert_eq!(say("he", "", Form::Ing), "carrying it, hopping, lying, being calm and watching himself");
        assert_eq!(say("they", "plural = true", Form::Agree), "carry it, hop, lie, is calm and watch himself");
        assert_eq!(say("he", "", Form::Past), "carried it, hopped, lay, was calm and watched himself");
    }

    #[test]
    fn regular_verbs() {
        let phrases = shipped();
        let he = phrases.who.iter().find(|group| group.names == ["he"]).unwrap();
        let they = phrases.who.iter().find(|group| group.names == ["they"]).unwrap();
        for (verb, third, ing, past) in [
            ("walk", "walks", "walking", "walked"),
            ("hop", "hops", "hopping", "hopped"),
            ("bow", "bows", "bowing", "bowed"),
            ("box", "boxes", "boxing", "boxed"),
            ("gallop", "gallops", "galloping", "galloped"),
            ("look", "looks", "looking", "looked"),
            ("hurry", "hurries", "hurrying", "hurried"),
            ("sway", "sways", "swaying", "swayed"),
            ("wave", "waves", "waving", "waved"),
            ("tiptoe", "tiptoes", "tiptoeing", "tiptoed"),
            ("die", "dies", "dying", "died"),
            ("sit", "sits", "sitting", "sat"),
            ("be", "is", "being", "was"),
        ] {
            let forms = [Form::Agree, Form::Ing, Form::Past].map(|form| phrases.inflect(verb, form, he));
            assert_eq!(forms, [third, ing, past]);
            assert_eq!(phrases.inflect(verb, Form::Base, he), verb);
            assert_eq!(phrases.inflect(verb, Form::Agree, they), if verb == "be" { "are" } else { verb });
        }
    }

    #[test]
    fn two_actions_keep_their_order_and_sides() {
        let phrases = shipped();
        let (mut stream, mut misspelt) = (Stream::new(1), 0);
        for _ in 0..500 {
            let said = phrases.sequence(("turn-left", Side::None), ("kick", Side::Right), &mut stream).unwrap();
            assert!(!said.contains(['{', '*', '|']), "{said}");
            misspelt += usize::from(phrases.misspelt(&said, &mut stream) != said);
        }
        assert!(misspelt > 50);
        assert_eq!(phrases.sequence(("turn-left", Side::None), ("hover", Side::None), &mut stream), None);
        assert_eq!(phrases.sentence("walk", Side::None, Some("wooden"), &mut stream), None);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let text = std::fs::read_to_string(file("phrases.toml")).unwrap();
        let cases = [
            ("*sway {their} arms", "*sway {there} arms", "no slot {there}"),
            ("*walk the dog", "walk the dog", "no verb"),
            ("*walk the dog", "*walk (the dog", "brackets"),
            ("*walk the dog", "*walk left", "mirrored"),
            ("{do1}, then {do2}", "{do1}, then", "ending in 2"),
            ("arise = \"arises arising arose\"", "arise = \"arises\"", "three forms"),
            ("names = \"you\"", "names = \"thou\"", "the name `you`"),
        ];
        for (old, new, said) in cases {
            let wrong = text.replacen(old, new, 1);
            let error = Phrases::parse(Path::new("phrases.toml"), &wrong).unwrap_err();
            assert!(error.to_string().contains(said), "{error}");
            assert!(matches!(error, Error::Entry { line, .. } if line > 0), "{error}");
        }
        assert!(matches!(Phrases::parse(Path::new("p"), "who = 1"), Err(Error::Syntax { .. })));
        assert!(matches!(Phrases::read("no/such/file"), Err(Error::Read { .. })));
    }
}
