//! One object of the list of spans: its fields, then a span of a timeline.

use motionette::{BodyParts, Prompt, Span};

use super::{Error, Place};
use crate::entries::{self, Entry, Fault, Node};

/// Fields a span may have.
const FIELDS: [&str; 7] = ["parts", "from", "to", "first_frame", "frames", "text", "prompt"];
/// What `frames` may be.
pub(super) const LENGTHS: &str = "1 to 65535";

/// What some parts of the body do over a span of the motion, with its prompt.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OwnedSpan {
    /// What moves.
    pub parts: BodyParts,
    /// First frame.
    pub first: u16,
    /// Frames.
    pub frames: u16,
    /// What they do.
    pub prompt: OwnedPrompt,
}

/// What parts of the body do, in words or as a stored prompt.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OwnedPrompt {
    /// Words.
    Text(String),
    /// The name of a prompt that the model stores.
    Bank(String),
}

impl OwnedSpan {
    /// As a request takes it.
    #[must_use]
    pub fn borrowed(&self) -> Span<'_> {
        let prompt = match &self.prompt {
            OwnedPrompt::Text(text) => Prompt::Text(text),
            OwnedPrompt::Bank(name) => Prompt::Bank(name),
        };
        Span { parts: self.parts, first: self.first, frames: self.frames, prompt }
    }
}

/// Names of the largest sets that parts are made of, [`BodyParts::NAMED`]; they name all of it.
#[must_use]
pub fn names_of_parts(parts: BodyParts) -> Vec<&'static str> {
    let (mut left, mut names) = (parts, Vec::new());
    for (name, set) in BodyParts::NAMED.into_iter().rev() {
        if left.has(set) {
            names.push(name);
            left = BodyParts::from_bits(left.bits() & !set.bits()).unwrap_or(BodyParts::NONE);
        }
    }
    names
}

/// The span in a motion of `frame_rate` frames a second, or what is wrong with the object.
pub(super) fn span(entry: &Entry, index: usize, frame_rate: u16) -> Result<OwnedSpan, Error> {
    let place = Place::span(index);
    let fault = |fault: Fault| Error::Field { place, fault };
    let missing = |field, example| Error::Missing { place, field, example };
    let [parts, from, to, first, frames, text, prompt] = entry.fields(&FIELDS).map_err(fault)?;
    let parts = named(parts.ok_or(missing("parts", r#""parts": "right_arm""#))?, index)?;
    let (first, frames) = match (from, to, first, frames) {
        (Some(from), Some(to), None, None) => {
            let [from, to] = [("from", from), ("to", to)].map(|(field, value)| {
                let seconds = entries::seconds(field, value)?;
                Ok((seconds, entries::frame_at(field, seconds, frame_rate)?))
            });
            let ((from, first), (to, end)) = (from.map_err(fault)?, to.map_err(fault)?);
            if to <= from {
                return Err(Error::EndsFirst { index, from, to });
            }
            (first, end - first)
        }
        (None, None, Some(first), Some(frames)) => {
            let first = entries::frame_number("first_frame", first, frame_rate).map_err(fault)?;
            let count = || entries::wrong("frames", "a whole number", frames);
            let frames = frames.as_u64().ok_or_else(count).map_err(fault)?;
            let range = Error::Range { place, field: "frames", value: frames as f32, range: LENGTHS };
            (first, u16::try_from(frames).ok().filter(|frames| *frames > 0).ok_or(range)?)
        }
        times => {
            let given = [times.0, times.1, times.2, times.3].into_iter().zip(&FIELDS[1..5]);
            let given = given.filter_map(|(value, field)| value.map(|_| *field)).collect();
            return Err(Error::SpanTimes { index, given });
        }
    };
    let words = |field, expected, value: &Node| {
        let text = value.as_str().map(str::to_owned);
        text.ok_or_else(|| fault(entries::wrong(field, expected, value)))
    };
    let prompt = match (text, prompt) {
        (Some(text), None) => OwnedPrompt::Text(words("text", "what the parts do, in words", text)?),
        (None, Some(name)) => OwnedPrompt::Bank(words("prompt", "the name of a prompt that the model stores", name)?),
        (Some(_), Some(_)) => return Err(Error::Both { place, first: "text", second: "prompt" }),
        (None, None) => return Err(missing("text", r#""text": "a person waves the right hand""#)),
    };
    Ok(OwnedSpan { parts, first, frames, prompt })
}

/// Parts by a name, or by several.
fn named(value: &Node, index: usize) -> Result<BodyParts, Error> {
    let wrong = |found| {
        let fault = entries::wrong("parts", "the name of a part of the body, or a list of such names", found);
        Error::Field { place: Place::span(index), fault }
    };
    let names = match value.as_list() {
        Some([]) => return Err(wrong(value)),
        Some(names) => names,
        None => std::slice::from_ref(value),
    };
    names.iter().try_fold(BodyParts::NONE, |parts, name| {
        let name = name.as_str().ok_or_else(|| wrong(name))?;
        let part = BodyParts::named(name);
        let part = part.ok_or_else(|| Error::UnknownPart { index, found: entries::shortened(name) })?;
        Ok(parts.and(part))
    })
}
