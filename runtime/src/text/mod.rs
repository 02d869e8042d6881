//! Text: prompts in words, and what they say.
//!
//! This layer knows words. It does not know decoders, planners or the solver.

pub mod bank;
pub mod clauses;
pub mod encoder;
pub mod meaning;
pub mod table;
pub mod words;

use crate::blob::{Error, Tensors, TextConfig, TextEncoding, TextLength};
use crate::nn::block::below;
use crate::nn::linear::Linear;
use crate::nn::norm::MAX_INPUT;
use bank::Bank;
use clauses::Clauses;
use encoder::TextEncoder;
use meaning::Meanings;
use words::{UNKNOWN, Words};

/// Whether this build knows planners that are given vectors.
pub const VECTORS: bool = cfg!(any(feature = "masked", feature = "autoregressive"));

/// Everything a blob knows of text.
#[derive(Debug, Clone, Copy)]
pub struct Text<'a> {
    width: usize,
    max_words: usize,
    encoder: Option<TextEncoder<'a>>,
    /// Prompts are vectors.
    vectors: bool,
    length: Linear<'a>,
    meanings: Option<Meanings<'a>>,
    bank: Bank<'a>,
}

impl<'a> Text<'a> {
    /// Reads encoder, length head and stored prompts from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(tensors: &mut Tensors<'a>, config: &TextConfig<'a>, max_tokens: u16) -> Result<Self, Error> {
        let vectors = VECTORS && config.encoder == TextEncoding::Vectors;
        let encoder = match config.encoder.words() {
            Some(encoder) if cfg!(feature = "text") => {
                if encoder.transformer.width != config.width {
                    let (found, limit) = (u32::from(encoder.transformer.width), u32::from(config.width));
                    return Err(Error::Config { what: "text.encoder.width", found, limit });
                }
                Some(TextEncoder::open(tensors, encoder, config.max_words)?)
            }
            _ => None,
        };
        let index = tensors.index();
        let length = match config.length {
            TextLength::Unsaid if VECTORS => Linear::none(config.width),
            _ => Linear::open(tensors, config.width, max_tokens)?,
        };
        let meanings = Meanings::open(tensors, &config.bank, config.width)?;
        let bank = Bank::open(tensors, config.bank.names(), config.width, if vectors { 0 } else { config.max_words })?;
        // Guidance needs the prompt that says nothing, from one of the two.
        if encoder.is_none() && !vectors && bank.get(bank::UNCONDITIONAL).is_none() {
            return Err(Error::Config { what: "text.bank without <none>", found: bank.len() as u32, limit: 0 });
        }
        let text = Text {
            width: usize::from(config.width),
            max_words: usize::from(config.max_words),
            encoder,
            vectors,
            length,
            meanings,
            bank,
        };
        below(text.length.bound(text.bound()), MAX_INPUT, index)?;
        if let Some(meanings) = &text.meanings {
            below(meanings.head().bound(text.bound()), MAX_INPUT, index)?;
        }
        Ok(text)
    }

    /// Width of a memory row and of the pooled vector, `dt`.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Longest prompt, words.
    #[must_use]
    pub const fn max_words(&self) -> usize {
        self.max_words
    }

    /// The encoder, if the blob has one.
    #[must_use]
    pub const fn encoder(&self) -> Option<&TextEncoder<'a>> {
        if cfg!(feature = "text") { self.encoder.as_ref() } else { None }
    }

    /// Whether prompts are vectors, beside the stored ones.
    #[must_use]
    pub const fn takes_vectors(&self) -> bool {
        VECTORS && self.vectors
    }

    /// What a free text asks for one thing behind the other; all of it as one where a part has no word that the model knows.
    #[must_use]
    pub fn clauses<'p>(&self, prompt: &'p str) -> Clauses<'p> {
        let clauses = Clauses::of(prompt);
        let known =
            |clause| self.encoder().is_some_and(|e| Words::new(clause).any(|word| e.vocabulary().id(&word) != UNKNOWN));
        if clauses.iter().all(known) { clauses } else { Clauses::whole(prompt) }
    }

    /// The stored prompts.
    #[must_use]
    pub const fn bank(&self) -> &Bank<'a> {
        &self.bank
    }

    /// The length head: pooled vector to logits of lengths 1 to the longest, tokens.
    #[must_use]
    pub const fn length(&self) -> &Linear<'a> {
        &self.length
    }

    /// What prompts may be understood as, where the model was taught it.
    #[must_use]
    pub const fn meanings(&self) -> Option<&Meanings<'a>> {
        self.meanings.as_ref()
    }

    /// A bound of memory and pooled vectors.
    #[must_use]
    pub fn bound(&self) -> f32 {
        let encoder = self.encoder().map_or(0.0, TextEncoder::bound);
        if encoder > bank::MAX_VALUE || (self.bank.is_empty() && !self.takes_vectors()) {
            encoder
        } else {
            bank::MAX_VALUE
        }
    }
}
