//! What an import did.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::dataset::Clip;

/// Counts of one part of a dataset.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Clips taken.
    pub clips: usize,
    /// Rows (frames with features).
    pub frames: usize,
    /// Captions.
    pub captions: usize,
}

/// A clip that was left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Skipped {
    /// Its name.
    pub id: String,
    /// Why.
    pub reason: String,
}

/// What an import took and left out.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// Everything taken.
    pub total: Count,
    /// The same by `subset/split`.
    pub parts: BTreeMap<String, Count>,
    /// Left out.
    pub skipped: Vec<Skipped>,
}

impl Summary {
    /// Counts a clip of `frames` rows.
    pub fn count(&mut self, clip: &Clip, frames: usize) {
        for count in [&mut self.total, self.parts.entry(format!("{}/{}", clip.subset, clip.split)).or_default()] {
            count.clips += 1;
            count.frames += frames;
            count.captions += clip.captions.len();
        }
    }

    /// Notes a clip that is left out.
    pub fn skip(&mut self, id: &str, reason: impl Into<String>) {
        self.skipped.push(Skipped { id: id.into(), reason: reason.into() });
    }
}
