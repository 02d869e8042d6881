//! What the blob knows of text.

use super::{Reader, generator::transformer};
use crate::nn::block::TransformerConfig;
use serde::Serialize;

/// Words a vocabulary may have.
pub const MAX_VOCABULARY: usize = 16_384;
/// Prompts a blob may store.
pub const MAX_BANK: usize = 512;

/// What the blob knows of text.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TextConfig<'a> {
    /// Width of a memory row and of the pooled vector.
    pub width: u16,
    /// Longest prompt, words.
    pub max_words: u16,
    /// How prompts come in.
    pub encoder: TextEncoding<'a>,
    /// How long a motion the text asks for.
    pub length: TextLength,
    /// Stored prompts.
    pub bank: PhraseBank<'a>,
}

/// How prompts come in.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub enum TextEncoding<'a> {
    /// As names of stored ones alone.
    Stored,
    /// In words, which an encoder reads.
    Words(TextEncoderConfig<'a>),
    /// As vectors of an encoder elsewhere, or names of stored ones.
    Vectors,
}

/// Words to memory rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TextEncoderConfig<'a> {
    /// Words to rows.
    pub table: TextTable<'a>,
    /// Its blocks.
    pub transformer: TransformerConfig,
}

/// How words become rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum TextTable<'a> {
    /// Words in id order, `\n` between; 0 is `<none>`, 1 is `<unknown>`. An embedding each.
    Words(&'a str),
    /// Vectors of words that were made elsewhere, found by the words' hashes. A linear layer makes rows of them; `<none>` and `<unknown>`
    /// have rows of their own.
    Vectors {
        /// Words with a vector.
        words: u16,
        /// Numbers of a vector.
        dims: u16,
    },
}

/// What says how long a motion is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum TextLength {
    /// A linear layer of the pooled vector: logits of 1 token to the longest motion.
    Head,
    /// The text does not: the request says it, or the planner where it ends.
    Unsaid,
}

/// Texts that the blob brings along.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub enum PhraseBank<'a> {
    /// Prompts encoded beforehand, by name: names, `\n` between; empty for none.
    Prompts(&'a str),
    /// The same, and phrases that a text may mean.
    Meanings {
        /// Names of the stored prompts, as above.
        prompts: &'a str,
        /// Phrases, `\n` between, those of actions before those of styles.
        phrases: &'a str,
        /// Phrases of actions.
        actions: u16,
        /// Probability of the likeliest action from which a text counts as understood.
        threshold: f32,
    },
}

impl<'a> TextConfig<'a> {
    pub(super) fn read(from: &mut Reader<'a>) -> Option<Self> {
        if from.kind("text", 2) == 0 {
            return None;
        }
        Some(TextConfig {
            width: from.short(),
            max_words: from.short(),
            encoder: TextEncoding::read(from),
            length: TextLength::read(from),
            bank: PhraseBank::read(from),
        })
    }
}

impl<'a> TextEncoding<'a> {
    fn read(from: &mut Reader<'a>) -> Self {
        match from.kind("text.encoder", 3) {
            0 => TextEncoding::Stored,
            1 => {
                TextEncoding::Words(TextEncoderConfig { table: TextTable::read(from), transformer: transformer(from) })
            }
            _ => TextEncoding::Vectors,
        }
    }

    /// The encoder of words, if there is one.
    #[must_use]
    pub const fn words(&self) -> Option<&TextEncoderConfig<'a>> {
        if let TextEncoding::Words(encoder) = self { Some(encoder) } else { None }
    }
}

impl<'a> TextTable<'a> {
    fn read(from: &mut Reader<'a>) -> Self {
        match from.kind("text.encoder.table", 2) {
            0 => TextTable::Words(from.text()),
            _ => TextTable::Vectors { words: from.short(), dims: from.short() },
        }
    }
}

impl TextLength {
    fn read(from: &mut Reader<'_>) -> Self {
        if from.kind("text.length", 2) == 0 { TextLength::Head } else { TextLength::Unsaid }
    }
}

impl<'a> PhraseBank<'a> {
    fn read(from: &mut Reader<'a>) -> Self {
        match from.kind("text.bank", 2) {
            0 => PhraseBank::Prompts(from.text()),
            _ => PhraseBank::Meanings {
                prompts: from.text(),
                phrases: from.text(),
                actions: from.short(),
                threshold: from.single(),
            },
        }
    }

    /// Names of the stored prompts, `\n` between; empty for none.
    #[must_use]
    pub const fn names(&self) -> &'a str {
        match *self {
            PhraseBank::Prompts(prompts) | PhraseBank::Meanings { prompts, .. } => prompts,
        }
    }
}
