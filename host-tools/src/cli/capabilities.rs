//! What a blob that takes another's place can no longer do.

use std::path::Path;

use motionette::Words;

use crate::blob::AlignedBlob;
use crate::blob::{BlobFile, Error};
use crate::checkpoint::prior::UNCONDITIONAL;
use crate::inspect::{self, Inspection};

/// What the blob at `path` can do and `bytes` cannot; nothing where no blob stands that these tools read.
///
/// # Errors
/// [`Error`] when `bytes` are no blob.
pub(super) fn lost(path: &Path, bytes: &[u8]) -> Result<Vec<String>, Error> {
    let Ok(old) = BlobFile::open(path) else { return Ok(Vec::new()) };
    let new = BlobFile::new(AlignedBlob::new(bytes), path)?;
    let model = new.model()?;
    // Words are found by hash where they have vectors: they are asked for, not listed.
    let knows = |word: &str| Words::new(word).all(|word| model.knows(&word) == Some(true));
    let look = |blob| inspect::inspect(blob, None, None, None);
    let (Ok(old), Ok(new)) = (look(&old), look(&new)) else { return Ok(Vec::new()) };
    Ok(difference(&old, &new, &knows))
}

fn difference(old: &Inspection, new: &Inspection, knows: &dyn Fn(&str) -> bool) -> Vec<String> {
    let mut lost = Vec::new();
    let mut note = |gone: bool, what: String| {
        if gone {
            lost.push(what);
        }
    };
    let (before, after) = (old.prior.as_ref(), new.prior.as_ref());
    note(
        before.is_some_and(|p| p.planner.is_some()) && after.is_none_or(|p| p.planner.is_none()),
        "a planner".to_owned(),
    );
    let encoder = before.is_some_and(|p| p.text.is_some());
    let encodes = after.is_some_and(|p| p.text.is_some());
    note(encoder && !encodes, "a text encoder".to_owned());
    if let (true, true, Some(before), Some(after)) = (encoder, encodes, before, after) {
        let words = before.vocabulary.iter().filter(|word| !word.starts_with('<') && !knows(word)).count();
        note(words > 0, format!("{words} words of its vocabulary"));
        note(after.max_words < before.max_words, format!("prompts of {} words", before.max_words));
    }
    let stored = before.map_or(&[][..], |p| &p.bank);
    let kept = after.map_or(&[][..], |p| &p.bank);
    // The unconditional prompt is stored only where no text encoder makes it.
    let prompts = stored.iter().filter(|name| !kept.contains(name) && *name != UNCONDITIONAL);
    let prompts: Vec<&str> = prompts.map(String::as_str).collect();
    note(!prompts.is_empty(), format!("the stored prompts {}", prompts.join(", ")));
    let families = old.control.as_ref().map_or(&[][..], |c| &c.families);
    match &new.control {
        None => note(old.control.is_some(), "anchor control".to_owned()),
        Some(control) => {
            for family in families.iter().filter(|family| !control.families.contains(family)) {
                note(true, format!("anchor control for {family}"));
            }
        }
    }
    note(new.max_tokens < old.max_tokens, format!("motions of {} tokens", old.max_tokens));
    lost
}
