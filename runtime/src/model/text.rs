//! Checks of the section `text`. Words and names are checked where they are opened, [`crate::text::Text`].

use super::value::{MAX_WIDTH, at_most, transformer, within};
use crate::blob::{Error, MAX_VOCABULARY, PhraseBank, TextConfig, TextTable};
use crate::kernels::GROUP;

/// Longest prompt any blob may declare, words.
const MAX_WORDS: u32 = 256;

/// The largest single below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Checks what the blob knows of text.
pub(super) fn check(text: Option<&TextConfig<'_>>) -> Result<(), Error> {
    let Some(text) = text else { return Ok(()) };
    at_most("text.width", u32::from(text.width), MAX_WIDTH)?;
    at_most("text.max_words", u32::from(text.max_words), MAX_WORDS)?;
    if let PhraseBank::Meanings { threshold, .. } = text.bank {
        within("text.bank.threshold", threshold, f32::MIN_POSITIVE, BELOW_ONE)?;
    }
    let Some(encoder) = text.encoder.words() else { return Ok(()) };
    if let TextTable::Vectors { words, dims } = encoder.table {
        at_most("text.encoder.table.words", u32::from(words), MAX_VOCABULARY as u32)?;
        at_most("text.encoder.table.dims", u32::from(dims), MAX_WIDTH)?;
        if !usize::from(dims).is_multiple_of(GROUP) {
            let what = "text.encoder.table.dims, no multiple of";
            return Err(Error::Config { what, found: u32::from(dims), limit: GROUP as u32 });
        }
    }
    transformer(&encoder.transformer)
}
