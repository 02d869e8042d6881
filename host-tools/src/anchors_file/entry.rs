//! One object of the list: its fields as they stand, then an anchor.

use std::fmt;

use motionette::{Anchor, Joint, Target};
use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde_json::Value;

use super::Error;

/// Fields an anchor may have.
pub(super) const FIELDS: [&str; 6] = ["time", "frame", "root", "planar_root", "joint", "position"];

/// Names and values in the order of the file. Kept raw, so that complaints can name the anchor and the field, and a field that stands
/// twice is noticed.
pub(super) struct Entry(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Entry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;
        impl<'de> Visitor<'de> for Fields {
            type Value = Entry;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an anchor, that is an object with a time and a target")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Entry, A::Error> {
                let mut fields = Vec::new();
                while let Some(field) = map.next_entry()? {
                    fields.push(field);
                }
                Ok(Entry(fields))
            }
        }
        deserializer.deserialize_map(Fields)
    }
}

impl Entry {
    /// The anchor in a motion of `frame_rate` frames a second, or what is wrong with the object.
    pub(super) fn anchor(&self, index: usize, frame_rate: u16) -> Result<Anchor, Error> {
        let [time, frame, root, planar_root, joint, position] = self.fields(index)?;
        let frame = match (time, frame) {
            (Some(time), None) => frame_at(index, time, frame_rate)?,
            (None, Some(frame)) => frame_number(index, frame, frame_rate)?,
            (Some(_), Some(_)) => return Err(Error::TwoTimes { index }),
            (None, None) => return Err(Error::NoTime { index }),
        };
        let given: Vec<&'static str> = [
            root.map(|_| "root"),
            planar_root.map(|_| "planar_root"),
            joint.map(|_| "joint").or(position.map(|_| "position")),
        ]
        .into_iter()
        .flatten()
        .collect();
        if given.len() > 1 {
            return Err(Error::SeveralTargets { index, fields: given });
        }
        let target = match (root, planar_root, joint, position) {
            (Some(at), ..) => Target::Root(coordinates(index, "root", "a list of three numbers [x, y, z]", at)?),
            (_, Some(at), ..) => {
                Target::PlanarRoot(coordinates(index, "planar_root", "a list of two numbers [x, z]", at)?)
            }
            (_, _, Some(name), Some(at)) => Target::Joint {
                joint: joint_number(index, name)?,
                position: coordinates(index, "position", "a list of three numbers [x, y, z]", at)?,
            },
            (_, _, Some(_), None) => return Err(Error::Half { index, field: "joint", missing: "position" }),
            (_, _, None, Some(_)) => return Err(Error::Half { index, field: "position", missing: "joint" }),
            (None, None, None, None) => return Err(Error::NoTarget { index }),
        };
        Ok(Anchor { frame, target })
    }

    /// Values in the order of [`FIELDS`].
    fn fields(&self, index: usize) -> Result<[Option<&Value>; FIELDS.len()], Error> {
        let mut values = [None; FIELDS.len()];
        for (name, value) in &self.0 {
            let Some(i) = FIELDS.iter().position(|field| field == name) else {
                return Err(Error::UnknownField { index, field: shortened(name) });
            };
            if values[i].replace(value).is_some() {
                return Err(Error::Repeated { index, field: FIELDS[i] });
            }
        }
        Ok(values)
    }
}

fn wrong(index: usize, field: &'static str, expected: &'static str, found: &Value) -> Error {
    Error::Type { index, field, expected, found: shortened(&found.to_string()) }
}

/// The frame nearest to a time in seconds.
fn frame_at(index: usize, value: &Value, frame_rate: u16) -> Result<u16, Error> {
    let field = "time";
    let time = value.as_f64().ok_or_else(|| wrong(index, field, "a number of seconds", value))?;
    if time < 0.0 {
        return Err(Error::Negative { index, field, value: time });
    }
    let frame = (time * f64::from(frame_rate)).round();
    if frame > f64::from(u16::MAX) {
        return Err(Error::TooLate { index, field, value: time, frame_rate });
    }
    Ok(frame as u16)
}

fn frame_number(index: usize, value: &Value, frame_rate: u16) -> Result<u16, Error> {
    let field = "frame";
    if let Some(frame) = value.as_u64() {
        return u16::try_from(frame).map_err(|_| Error::TooLate { index, field, value: frame as f64, frame_rate });
    }
    match value.as_i64() {
        Some(frame) => Err(Error::Negative { index, field, value: frame as f64 }),
        None => Err(wrong(index, field, "a whole number", value)),
    }
}

fn joint_number(index: usize, value: &Value) -> Result<u8, Error> {
    let name = value.as_str().ok_or_else(|| wrong(index, "joint", "the name of a joint", value))?;
    Joint::from_name(name).map(u8::from).ok_or_else(|| Error::UnknownJoint { index, found: shortened(name) })
}

fn coordinates<const N: usize>(
    index: usize,
    field: &'static str,
    expected: &'static str,
    value: &Value,
) -> Result<[f32; N], Error> {
    let mismatch = || wrong(index, field, expected, value);
    let list = value.as_array().filter(|list| list.len() == N).ok_or_else(mismatch)?;
    let mut coordinates = [0.0; N];
    for (slot, value) in coordinates.iter_mut().zip(list) {
        let value = value.as_f64().ok_or_else(mismatch)?;
        *slot = value as f32;
        if !slot.is_finite() {
            return Err(Error::NotFinite { index, field, value });
        }
    }
    Ok(coordinates)
}

/// At most 60 characters of a text that came from outside.
fn shortened(text: &str) -> String {
    const SHOWN: usize = 60;
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
