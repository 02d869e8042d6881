//! A sentence in the making.

use motionette::numerics::hash::Stream;

use super::inflect::{FORMS, Form};
use super::{Group, Phrases, Style};
use crate::dataset::Side;

/// One in so many times `{their}` is `the`.
const THE: u32 = 5;

/// A sentence in the making: its subject, and what its slots hold so far.
pub(super) struct Sentence<'p> {
    phrases: &'p Phrases,
    pub(super) group: &'p Group,
    name: String,
    whom: String,
    /// Whether the sentence names its subject.
    spoken: bool,
    their: &'p str,
    pub(super) side: Side,
    pub(super) slots: Vec<(String, String)>,
}

impl<'p> Sentence<'p> {
    pub(super) fn new(phrases: &'p Phrases, frame: &str, side: Side, stream: &mut Stream) -> Self {
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

    /// One about the first subject of the first group.
    pub(super) fn plain(phrases: &'p Phrases, side: Side) -> Self {
        let group = &phrases.who[0];
        let name = group.names[0].clone();
        let whom = group.whom.clone().unwrap_or_else(|| name.clone());
        Sentence { phrases, group, name, whom, spoken: true, their: &group.their, side, slots: Vec::new() }
    }

    /// Puts a style into one of the frame's places; `false` where none suits.
    pub(super) fn style(&mut self, style: &'p Style, frame: &str, stream: &mut Stream) -> bool {
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
    pub(super) fn verbs(&mut self, digit: &str, template: &str, frame: &str, stream: &mut Stream) {
        for (slot, form) in FORMS {
            let slot = format!("{slot}{digit}");
            if frame.contains(&format!("{{{slot}}}")) {
                let said = self.fill(template, form, stream);
                self.slots.push((slot, said));
            }
        }
    }

    /// A template with alternatives drawn, verbs inflected, slots filled.
    pub(super) fn fill(&self, template: &str, form: Form, stream: &mut Stream) -> String {
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

    pub(super) fn slot(&self, slot: &str) -> String {
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

/// One of `from`, which is not empty.
pub(super) fn pick<'a, T>(stream: &mut Stream, from: &'a [T]) -> &'a T {
    let count = u32::try_from(from.len()).unwrap_or(u32::MAX);
    &from[stream.below(count) as usize]
}

/// Single spaces, none before a comma, none at the ends.
pub(super) fn tidy(text: &str) -> String {
    let spaced = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let text = spaced.replace(" ,", ",").replace(" ?", "?");
    text.trim_matches([',', ' ']).to_owned()
}
