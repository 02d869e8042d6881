//! Checks of the section `text`. Words and names are checked where they are opened, [`crate::text::Text`].

use super::value::{MAX_WIDTH, at_most, transformer};
use crate::blob::{Error, TextConfig};

/// Longest prompt any blob may declare, words.
const MAX_WORDS: u32 = 256;

/// Checks what the blob knows of text.
pub(super) fn check(text: Option<&TextConfig<'_>>) -> Result<(), Error> {
    let Some(text) = text else { return Ok(()) };
    at_most("text.width", u32::from(text.width), MAX_WIDTH)?;
    at_most("text.max_words", u32::from(text.max_words), MAX_WORDS)?;
    text.encoder.as_ref().map_or(Ok(()), |encoder| transformer(&encoder.transformer))
}
