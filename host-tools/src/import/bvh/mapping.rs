//! Which joints of a file are which of the 22.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::names::plain;
use super::{Bvh, Problem, Unit};
use crate::input;
use crate::motion::quaternion::{self as q, Vector};
use crate::motion::{JOINTS, skeleton};

/// Where a SMPL joint comes from: in JSON a joint's name, or an object with `from`, `to` and `at`. The End Site of a joint is called
/// after it: `LeftToeBase End Site`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "Value")]
pub enum Source {
    /// A joint of the file.
    Joint(String),
    /// A point on the line through two joints: `from + at (to - from)`.
    Between {
        /// Joint at `at` = 0.
        from: String,
        /// Joint at `at` = 1.
        to: String,
        /// Where on the line.
        at: f64,
    },
}

/// Numbers are taken out of a [`Value`]: an untagged enum would not see them where some other crate of the build turns
/// serde_json's arbitrary precision on.
impl TryFrom<Value> for Source {
    type Error = &'static str;

    fn try_from(value: Value) -> Result<Self, Self::Error> {
        let text = |name: &str| value.get(name).and_then(Value::as_str).map(str::to_owned);
        match &value {
            Value::String(joint) => Ok(Self::Joint(joint.clone())),
            Value::Object(fields) if fields.len() == 3 => {
                let at = value.get("at").and_then(Value::as_f64);
                let (Some(from), Some(to), Some(at)) = (text("from"), text("to"), at) else {
                    return Err("a point between two joints needs their names as `from` and `to` and a number `at`");
                };
                Ok(Self::Between { from, to, at })
            }
            _ => Err("a joint comes from a joint's name, or from an object with `from`, `to` and `at`"),
        }
    }
}

/// A table from a file's joints to the 22, as read from JSON.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// What to call it in messages.
    pub name: String,
    /// What a unit of the file is; the body's height says it where this does not.
    #[serde(default)]
    pub unit: Option<Unit>,
    /// The axis that points up, `y` or `z`.
    #[serde(default)]
    pub up: Up,
    /// Frames to leave out at the beginning: a rest pose.
    #[serde(default)]
    pub drop_frames: usize,
    /// All 22 SMPL joint names and where each comes from.
    pub joints: BTreeMap<String, Source>,
}

/// The axis that points up in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// As in motionette.
    #[default]
    Y,
    /// Turned about x: (x, y, z) becomes (x, z, -y).
    Z,
}

/// Why a mapping file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// It cannot be read.
    #[error("cannot read the mapping {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is not JSON of the right form.
    #[error("{} is not a joint mapping; it needs name, joints, and a unit that is one, see `motionette import bvh --help`", path.display())]
    Form {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        source: serde_json::Error,
    },
    /// It does not say where every joint comes from.
    #[error("{} does not map {missing}; all 22 joints are needed", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// SMPL joints it lacks.
        missing: String,
    },
    /// It maps something that is no SMPL joint.
    #[error("{} maps {unknown}, which is none of the 22 joints ({})", path.display(), skeleton::NAMES.join(", "))]
    Unknown {
        /// The file.
        path: PathBuf,
        /// The names.
        unknown: String,
    },
}

/// The tables that come with the program, most telling first.
const BUILT_IN: [&str; 5] = [
    include_str!("mappings/bandai-namco.json"),
    include_str!("mappings/iclone.json"),
    include_str!("mappings/cmu-cgspeed.json"),
    include_str!("mappings/mixamo.json"),
    include_str!("mappings/lafan1.json"),
];

/// A SMPL joint as indices into a file's joints: `from + at (to - from)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Joint at `at` = 0.
    pub from: usize,
    /// Joint at `at` = 1.
    pub to: usize,
    /// Where on the line.
    pub at: f64,
}

impl Place {
    /// A joint itself.
    pub const fn joint(joint: usize) -> Self {
        Self { from: joint, to: joint, at: 0.0 }
    }

    /// Its position, from those of the file's joints.
    pub fn of(&self, positions: &[Vector]) -> Vector {
        let start = positions[self.from];
        q::add(start, q::scale(q::subtract(positions[self.to], start), self.at))
    }

    /// As a mapping says it.
    pub fn source(&self, bvh: &Bvh) -> Source {
        let name = |joint: usize| bvh.joints[joint].name.clone();
        if self.from == self.to {
            return Source::Joint(name(self.from));
        }
        Source::Between { from: name(self.from), to: name(self.to), at: self.at }
    }
}

impl Mapping {
    /// The built-in tables in the order they are tried.
    pub fn built_in() -> impl Iterator<Item = Self> {
        // A test parses them all, so nothing is lost here.
        BUILT_IN.iter().filter_map(|text| serde_json::from_str(text).ok())
    }

    /// Reads a mapping file.
    ///
    /// # Errors
    /// [`MappingError`], naming the file and the joints.
    pub fn read(path: &Path) -> Result<Self, MappingError> {
        let text = input::read_text(path, input::WRITTEN)
            .map_err(|source| MappingError::Read { path: path.to_path_buf(), source })?;
        let mapping: Self =
            serde_json::from_str(&text).map_err(|source| MappingError::Form { path: path.to_path_buf(), source })?;
        let missing: Vec<&str> =
            skeleton::NAMES.into_iter().filter(|name| !mapping.joints.contains_key(*name)).collect();
        if !missing.is_empty() {
            return Err(MappingError::Missing { path: path.to_path_buf(), missing: missing.join(", ") });
        }
        let unknown: Vec<&str> =
            mapping.joints.keys().map(String::as_str).filter(|name| !skeleton::NAMES.contains(name)).collect();
        if !unknown.is_empty() {
            return Err(MappingError::Unknown { path: path.to_path_buf(), unknown: unknown.join(", ") });
        }
        Ok(mapping)
    }

    /// The built-in table all of whose joints the file has; else the closest and the joints it lacks.
    pub(super) fn detect(bvh: &Bvh) -> Result<Self, (Self, Vec<String>)> {
        let mut closest: Option<(Self, Vec<String>)> = None;
        for mapping in Self::built_in() {
            let missing = mapping.missing(bvh);
            if missing.is_empty() {
                return Ok(mapping);
            }
            if closest.as_ref().is_none_or(|(_, fewest)| missing.len() < fewest.len()) {
                closest = Some((mapping, missing));
            }
        }
        Err(closest.unwrap_or_else(|| (Self::none(), Vec::new())))
    }

    const fn none() -> Self {
        Self { name: String::new(), unit: None, up: Up::Y, drop_frames: 0, joints: BTreeMap::new() }
    }

    fn missing(&self, bvh: &Bvh) -> Vec<String> {
        let names: BTreeSet<&str> = bvh.joints.iter().map(|joint| plain(&joint.name)).collect();
        let needed: BTreeSet<&str> = self.joints.values().flat_map(Source::names).map(plain).collect();
        needed.difference(&names).map(ToString::to_string).collect()
    }

    /// Where each of the 22 comes from in this file.
    pub(super) fn resolve(&self, bvh: &Bvh) -> Result<[Place; JOINTS], Problem> {
        let missing = self.missing(bvh);
        if !missing.is_empty() {
            let mapping = self.name.clone();
            return Err(Problem::Unmapped { mapping, missing: missing.join(", "), present: present(bvh) });
        }
        let find = |name: &str| {
            let mut found = bvh.joints.iter().enumerate().filter(|(_, joint)| plain(&joint.name) == plain(name));
            match (found.next(), found.next()) {
                (Some((index, _)), None) => Ok(index),
                _ => Err(Problem::Ambiguous { name: name.into() }),
            }
        };
        let mut resolved = [Place::joint(0); JOINTS];
        for (slot, smpl) in resolved.iter_mut().zip(skeleton::NAMES) {
            *slot = match self.joints.get(smpl) {
                Some(Source::Joint(name)) => Place::joint(find(name)?),
                Some(Source::Between { from, to, at }) => Place { from: find(from)?, to: find(to)?, at: *at },
                None => {
                    let mapping = self.name.clone();
                    return Err(Problem::Unmapped { mapping, missing: smpl.into(), present: present(bvh) });
                }
            };
        }
        Ok(resolved)
    }
}

impl Source {
    fn names(&self) -> impl Iterator<Item = &str> {
        let (first, second) = match self {
            Self::Joint(name) => (name.as_str(), None),
            Self::Between { from, to, .. } => (from.as_str(), Some(to.as_str())),
        };
        std::iter::once(first).chain(second)
    }
}

/// The names of a file, for messages.
pub(super) fn present(bvh: &Bvh) -> String {
    const SHOWN: usize = 60;
    let names: Vec<&str> = bvh.joints.iter().take(SHOWN).map(|joint| joint.name.as_str()).collect();
    let more = bvh.joints.len().saturating_sub(SHOWN);
    if more > 0 { format!("{} and {more} more", names.join(", ")) } else { names.join(", ") }
}
