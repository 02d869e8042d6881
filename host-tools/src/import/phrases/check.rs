//! What must hold of phrases so that any sentence can be made of them.

use super::inflect::FORMS;
use super::{AGREEING, Phrases, SIDE, SIDED};

/// Slots of the sentence around an action.
const AROUND: [&str; 7] = ["who", "whom", "are", "were", "lead", "pre", "end"];
/// Words that must not stand in a template: a mirrored motion would keep them.
const FIXED: [&str; 8] =
    ["left", "right", "leftward", "rightward", "leftwards", "rightwards", "clockwise", "counterclockwise"];

impl Phrases {
    /// The part that is wrong, and why.
    pub(super) fn check(&self) -> Result<(), (String, String)> {
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
            if let Some(template) = style.walk.iter().find(|template| !template.contains('*')) {
                return fail(template, "no verb is marked with *");
            }
        }
        Ok(())
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
