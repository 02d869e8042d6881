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

/// What was guessed or looked unusual in one or more clips.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Note {
    /// A sentence.
    pub text: String,
    /// The first clip that it is about.
    pub first: String,
    /// How many clips it is about.
    pub clips: usize,
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
    /// What the user should know about what was taken.
    pub notes: Vec<Note>,
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

    /// Notes something about a clip; the same text is kept once.
    pub fn note(&mut self, id: &str, text: String) {
        match self.notes.iter_mut().find(|note| note.text == text) {
            Some(note) => note.clips += 1,
            None => self.notes.push(Note { text, first: id.to_owned(), clips: 1 }),
        }
    }
}
