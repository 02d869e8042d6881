//! A timeline as the page shows it: which joints each span moves, and when.

use motionette::{JOINTS, Span};
use motionette_host::spans::HeardSpan;
use serde::Serialize;

/// A span.
#[derive(Debug, Serialize)]
pub struct ShownSpan {
    /// What moves, in words, a row each.
    pub parts: Vec<String>,
    /// Joints that it moves.
    pub joints: Vec<usize>,
    /// First frame.
    pub first: u16,
    /// Frames.
    pub frames: u16,
    /// What its prompt says.
    pub says: String,
    /// What it was understood as.
    pub understood: Option<String>,
    /// Words of it that the model does not know.
    pub unknown_words: Vec<String>,
}

impl ShownSpan {
    /// The spans of a request, with what was understood of them.
    #[must_use]
    pub fn of_all(spans: &[Span<'_>], heard: &[HeardSpan]) -> Vec<Self> {
        let shown = |(span, heard): (&Span<'_>, &HeardSpan)| ShownSpan {
            parts: heard.parts.iter().map(|part| part.replace('_', " ")).collect(),
            joints: (0..JOINTS).filter(|joint| span.parts.joints() >> joint & 1 == 1).collect(),
            first: span.first,
            frames: span.frames,
            says: heard.says().to_owned(),
            understood: heard.understood.clone(),
            unknown_words: heard.unknown_words.clone(),
        };
        spans.iter().zip(heard).map(shown).collect()
    }
}
