//! Lists of objects in JSON files that a person writes, read so that a complaint names the entry, the field and what to do.
//!
//! `parse` says where text is no JSON of the form; `Entry::fields` and the readers of single fields say what is wrong with content, as a
//! [`Fault`] that knows nothing of the list it stands in.

mod fault;
mod node;

use motionette::Joint;
use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer};

pub use fault::Fault;
pub(crate) use node::Node;

/// Text that is no JSON, or JSON of another form.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Misformed {
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1; 0 before the first character of a line.
    pub column: usize,
    /// What the reader said, without the place.
    pub message: String,
}

/// Parses the text of a file that is one object.
pub(crate) fn parse<F: DeserializeOwned>(text: &str) -> Result<F, Misformed> {
    let text = text.trim_start_matches('\u{feff}');
    // The derived reader would take a list as the fields without their names.
    let before = &text[..text.len() - text.trim_start().len()];
    if text[before.len()..].starts_with('[') {
        let line = before.matches('\n').count() + 1;
        let column = before.len() - before.rfind('\n').map_or(0, |end| end + 1) + 1;
        return Err(Misformed { line, column, message: "expected an object, found a list".into() });
    }
    serde_json::from_str(text).map_err(|source| {
        let (line, column) = (source.line(), source.column());
        let message = source.to_string();
        let place = format!(" at line {line} column {column}");
        let message = message.strip_suffix(&place).unwrap_or(&message).to_owned();
        Misformed { line, column, message }
    })
}

/// An object: names and values in the order of the file. Kept raw, so that complaints can name the entry and the field, and a field that
/// stands twice is noticed.
#[derive(Debug, Clone)]
pub(crate) struct Entry(Vec<(String, Node)>);

impl<'de> Deserialize<'de> for Entry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(node::Fields).map(Entry)
    }
}

impl Entry {
    /// Values in the order of `known`.
    pub fn fields<const N: usize>(&self, known: &'static [&'static str; N]) -> Result<[Option<&Node>; N], Fault> {
        let mut values = [None; N];
        for (name, value) in &self.0 {
            let Some(i) = known.iter().position(|field| field == name) else {
                return Err(Fault::UnknownField { field: shortened(name), known });
            };
            if values[i].replace(value).is_some() {
                return Err(Fault::Repeated { field: known[i] });
            }
        }
        Ok(values)
    }
}

/// A value that is not what the field should hold.
pub(crate) fn wrong(field: &'static str, expected: &'static str, found: &Node) -> Fault {
    Fault::Type { field, expected, found: shortened(&found.to_string()) }
}

/// A finite number of single precision.
pub(crate) fn number(field: &'static str, expected: &'static str, value: &Node) -> Result<f32, Fault> {
    let value = value.as_f64().ok_or_else(|| wrong(field, expected, value))?;
    let narrow = value as f32;
    if narrow.is_finite() { Ok(narrow) } else { Err(Fault::NotFinite { field, value }) }
}

/// A list of so many finite numbers of single precision.
pub(crate) fn coordinates<const N: usize>(
    field: &'static str,
    expected: &'static str,
    value: &Node,
) -> Result<[f32; N], Fault> {
    let mismatch = || wrong(field, expected, value);
    let list = value.as_list().filter(|list| list.len() == N).ok_or_else(mismatch)?;
    let mut coordinates = [0.0; N];
    for (slot, value) in coordinates.iter_mut().zip(list) {
        let value = value.as_f64().ok_or_else(mismatch)?;
        *slot = value as f32;
        if !slot.is_finite() {
            return Err(Fault::NotFinite { field, value });
        }
    }
    Ok(coordinates)
}

/// Exactly one of `time` and `frame`, as a frame.
pub(crate) fn frame(time: Option<&Node>, frame: Option<&Node>, frame_rate: u16) -> Result<u16, Fault> {
    match (time, frame) {
        (Some(time), None) => frame_at("time", seconds("time", time)?, frame_rate),
        (None, Some(frame)) => frame_number("frame", frame, frame_rate),
        (Some(_), Some(_)) => Err(Fault::TwoTimes),
        (None, None) => Err(Fault::NoTime),
    }
}

/// A time in seconds from the start on.
pub(crate) fn seconds(field: &'static str, value: &Node) -> Result<f64, Fault> {
    let time = value.as_f64().ok_or_else(|| wrong(field, "a number of seconds", value))?;
    if time < 0.0 { Err(Fault::Negative { field, value: time }) } else { Ok(time) }
}

/// The frame nearest to a time in seconds.
pub(crate) fn frame_at(field: &'static str, time: f64, frame_rate: u16) -> Result<u16, Fault> {
    let frame = (time * f64::from(frame_rate)).round();
    if frame > f64::from(u16::MAX) {
        return Err(Fault::TooLate { field, value: time, frame_rate });
    }
    Ok(frame as u16)
}

/// The number of a frame.
pub(crate) fn frame_number(field: &'static str, value: &Node, frame_rate: u16) -> Result<u16, Fault> {
    if let Some(frame) = value.as_u64() {
        return u16::try_from(frame).map_err(|_| Fault::TooLate { field, value: frame as f64, frame_rate });
    }
    match value.as_i64() {
        Some(frame) => Err(Fault::Negative { field, value: frame as f64 }),
        None => Err(wrong(field, "a whole number", value)),
    }
}

/// The joint of a name.
pub(crate) fn joint(field: &'static str, value: &Node) -> Result<u8, Fault> {
    let name = value.as_str().ok_or_else(|| wrong(field, "the name of a joint", value))?;
    Joint::from_name(name).map(u8::from).ok_or_else(|| Fault::UnknownJoint { found: shortened(name) })
}

/// At most 60 characters of a text that came from outside.
pub(crate) fn shortened(text: &str) -> String {
    const SHOWN: usize = 60;
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
