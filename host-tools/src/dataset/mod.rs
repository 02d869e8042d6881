//! The one file a training run reads.
//!
//! A safetensors file: `joints` f32 `[N][22][3]` (global, metres, uniform skeleton), `features` f32 `[N][263]` (unnormalised),
//! `offsets` i32 `[clips + 1]` (clip i = rows `offsets[i]..offsets[i + 1]`), and in `__metadata__` the strings `format`, `version`,
//! `clips` (JSON array of [`Clip`]) and `hash`. Equal content gives equal bytes.
//!
//! Every clip has a SHA-256 over its description, joints and features; the file's hash covers the clips' hashes in order, and loading
//! checks them all. Mean and deviation are not stored: they belong to a training run.

pub mod captioned;
mod digest;
mod error;
mod facts;
mod store;
#[cfg(test)]
mod tests;

use std::collections::HashSet;

use serde::{Deserialize, Serialize};

pub use crate::motion::side::Side;
pub use error::Error;
pub use facts::{Facts, Quality};

use crate::motion::{FEATURES, JOINTS, Pose};

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-dataset";
/// Values of `version` in the metadata: 1 without, 2 with [`Clip::facts`]. Both are read; a dataset without facts is written as 1.
pub const VERSIONS: [&str; 2] = ["1", "2"];

/// What a clip is used for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Weights are fitted on it.
    Train,
    /// Choices are made on it.
    Val,
    /// Figures are reported on it.
    Test,
}

impl std::str::FromStr for Split {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "train" => Ok(Self::Train),
            "val" => Ok(Self::Val),
            "test" => Ok(Self::Test),
            other => Err(format!("{other:?} is not a split; use train, val or test")),
        }
    }
}

impl std::fmt::Display for Split {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        })
    }
}

/// A sentence about a clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Caption {
    /// The sentence.
    pub text: String,
    /// Where it begins to hold, seconds.
    pub from: f64,
    /// Where it ceases to hold, seconds; 0 together with `from` = 0 means the whole clip.
    pub to: f64,
    /// Who wrote it (`humanml3d`, `kitml`, `label_template`, ...).
    pub source: String,
}

/// Everything about a clip but its motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Clip {
    /// Unique name.
    pub id: String,
    /// What it is used for.
    pub split: Split,
    /// Collection it belongs to (`bnr`, `cmu`, ...).
    pub subset: String,
    /// Where the recording comes from.
    pub source: String,
    /// Frame rate of the recording before resampling, 1/s.
    pub fps_source: f64,
    /// Sentences about it.
    pub captions: Vec<Caption>,
    /// Free facts of the collection.
    pub labels: serde_json::Value,
    /// What an import with a table of actions knows of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facts: Option<Facts>,
    /// SHA-256 (hex) over description, joints and features; set by [`Builder::push`].
    #[serde(default)]
    pub hash: String,
}

/// What motions have in common that can follow one another, and whose sentences can stand for one another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Label<'c> {
    /// Action.
    pub action: &'c str,
    /// Its side.
    pub side: Side,
    /// Style, where there is one.
    pub style: Option<&'c str>,
}

impl Clip {
    /// Action, side and style; none without an action.
    pub fn label(&self) -> Option<Label<'_>> {
        Some(Label { action: self.action()?, side: self.side(), style: self.style() })
    }

    /// The action: of the facts, else the label `content`.
    pub fn action(&self) -> Option<&str> {
        self.facts.as_ref().map_or_else(|| self.labels.get("content")?.as_str(), |facts| Some(&facts.action))
    }

    /// The style: of the facts, else the label `style`.
    pub fn style(&self) -> Option<&str> {
        self.facts.as_ref().map_or_else(|| self.labels.get("style")?.as_str(), |facts| facts.style.as_deref())
    }

    /// The side of the action; none where there are no facts.
    pub fn side(&self) -> Side {
        self.facts.as_ref().map_or(Side::None, |facts| facts.side)
    }

    /// Whether its action has enough training clips to be judged; true where there are no facts.
    pub fn scored(&self) -> bool {
        self.facts.as_ref().is_none_or(|facts| facts.scored)
    }

    /// Whether nothing may be learned from legs and contacts: a Kinect sees legs badly and makes feet up. Where the action is done with
    /// the legs (a kick, a raised knee), they are all that shows it, and count.
    pub fn synthetic_legs(&self) -> bool {
        self.facts.as_ref().is_some_and(|facts| facts.quality == Quality::Kinect && !facts.own_legs)
    }
}

/// A dataset in memory.
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// Descriptions, in the order of `offsets`.
    pub clips: Vec<Clip>,
    /// `[N][22][3]` global joints, metres.
    pub joints: Vec<f32>,
    /// `[N][263]` unnormalised features.
    pub features: Vec<f32>,
    /// `[clips + 1]` first row of every clip, then N.
    pub offsets: Vec<usize>,
    /// SHA-256 (hex) over all content.
    pub hash: String,
}

/// One clip, borrowed.
#[derive(Debug, Clone, Copy)]
pub struct ClipView<'a> {
    /// Its description.
    pub info: &'a Clip,
    /// `[T]` poses, global, metres.
    pub joints: &'a [Pose],
    /// `[T][263]` features, row after row.
    pub features: &'a [f32],
}

impl ClipView<'_> {
    /// Number of rows T.
    pub fn frames(&self) -> usize {
        self.joints.len()
    }
}

impl Dataset {
    /// Number of rows of all clips.
    pub fn frames(&self) -> usize {
        self.offsets.last().copied().unwrap_or(0)
    }

    /// Clip `index`.
    ///
    /// # Panics
    /// When `index` is not below `clips.len()`.
    pub fn clip(&self, index: usize) -> ClipView<'_> {
        let (from, to) = (self.offsets[index], self.offsets[index + 1]);
        let (points, _) = self.joints[from * JOINTS * 3..to * JOINTS * 3].as_chunks::<3>();
        let (joints, _) = points.as_chunks::<JOINTS>();
        ClipView { info: &self.clips[index], joints, features: &self.features[from * FEATURES..to * FEATURES] }
    }

    /// All clips in order.
    pub fn iter(&self) -> impl Iterator<Item = ClipView<'_>> {
        (0..self.clips.len()).map(|index| self.clip(index))
    }

    /// The clips of one split in order.
    pub fn split(&self, split: Split) -> impl Iterator<Item = ClipView<'_>> {
        self.iter().filter(move |clip| clip.info.split == split)
    }
}

/// Puts a dataset together clip by clip.
#[derive(Debug)]
pub struct Builder {
    dataset: Dataset,
    ids: HashSet<String>,
}

impl Default for Builder {
    fn default() -> Self {
        Self::new()
    }
}

impl Builder {
    /// An empty dataset.
    pub fn new() -> Self {
        Self {
            dataset: Dataset {
                clips: Vec::new(),
                joints: Vec::new(),
                features: Vec::new(),
                offsets: vec![0],
                hash: String::new(),
            },
            ids: HashSet::new(),
        }
    }

    /// Adds a clip of `joints.len()` rows and sets its hash.
    ///
    /// # Errors
    /// [`Error::Rows`] when joints and features disagree in length or are empty, [`Error::Value`] for values that are not finite,
    /// [`Error::Repeated`] for a name that is taken, [`Error::Full`] past 2^31 rows.
    pub fn push(&mut self, mut clip: Clip, joints: &[Pose], features: &[f32]) -> Result<(), Error> {
        if joints.is_empty() || features.len() != joints.len() * FEATURES {
            return Err(Error::Rows { clip: clip.id, joints: joints.len(), features: features.len() });
        }
        let flat = joints.as_flattened().as_flattened();
        if !flat.iter().chain(features).all(|x| x.is_finite()) {
            return Err(Error::Value { clip: clip.id });
        }
        if !self.ids.insert(clip.id.clone()) {
            return Err(Error::Repeated { clip: clip.id });
        }
        let rows = self.dataset.frames() + joints.len();
        if i32::try_from(rows).is_err() {
            return Err(Error::Full { rows });
        }
        clip.hash = digest::clip(&clip, flat, features);
        self.dataset.joints.extend_from_slice(flat);
        self.dataset.features.extend_from_slice(features);
        self.dataset.offsets.push(rows);
        self.dataset.clips.push(clip);
        Ok(())
    }

    /// The dataset with its hash.
    pub fn finish(mut self) -> Dataset {
        self.dataset.hash = digest::whole(&self.dataset.clips);
        self.dataset
    }
}
