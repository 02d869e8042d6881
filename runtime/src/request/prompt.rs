//! What the motion is to be, in words, and why a prompt is refused.

use crate::text::bank;
use crate::text::meaning::Understood;
use crate::text::words::{MAX_PROMPT, UNKNOWN, Words};
use crate::text::{Text, VECTORS};

/// What the motion is to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Prompt<'r> {
    /// Free text, for blobs with a text encoder.
    Text(&'r str),
    /// The name of a prompt that the blob stores.
    Bank(&'r str),
    /// A vector of the encoder that the model was trained with, for blobs whose prompts are vectors.
    Vector(&'r [f32]),
}

/// What was understood of a prompt.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PromptStats {
    /// Words of a free text; of a stored prompt rows of its memory.
    pub words: u16,
    /// Words of a free text that the model does not know.
    pub unknown_words: u16,
    /// What the prompt was understood as, where the model was taught it.
    pub understood: Option<Understood>,
}

/// Why a prompt was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PromptError {
    /// The blob has no text encoder: only stored prompts can be asked for.
    NoEncoder {
        /// Prompts it stores.
        stored: usize,
    },
    /// The blob's prompts are vectors of another encoder: it reads no words.
    Vectors {
        /// Numbers of a vector.
        width: usize,
        /// Prompts it stores.
        stored: usize,
    },
    /// The blob's prompts are no vectors.
    NoVectors,
    /// The vector is of another encoder.
    VectorWidth {
        /// Its numbers.
        found: usize,
        /// Numbers of one that the model takes.
        width: usize,
    },
    /// A number of the vector is not finite, or beyond what any encoder gives.
    VectorValue {
        /// Its place.
        index: usize,
    },
    /// All numbers of the vector are zero, which asks for nothing.
    ZeroVector,
    /// The prompt has no words.
    Empty,
    /// The prompt is too long to be read.
    TooLong {
        /// Its bytes.
        found: usize,
        /// Most that are read.
        limit: usize,
    },
    /// The prompt has too many words.
    TooManyWords {
        /// Its words.
        found: usize,
        /// Most the model takes.
        limit: usize,
    },
    /// The model knows none of the words.
    OnlyUnknownWords {
        /// How many there are.
        words: usize,
    },
    /// The blob stores no prompt of that name.
    NotStored {
        /// Prompts it stores.
        stored: usize,
    },
}

impl core::fmt::Display for PromptError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            PromptError::NoEncoder { stored } => {
                write!(f, "the model has no text encoder, only {stored} stored prompts")
            }
            // Nothing takes vectors: nothing is said of them.
            PromptError::Vectors { .. }
            | PromptError::VectorWidth { .. }
            | PromptError::VectorValue { .. }
            | PromptError::ZeroVector
                if !VECTORS =>
            {
                Ok(())
            }
            PromptError::Vectors { width, stored } => {
                write!(
                    f,
                    "the model takes prompts as vectors of {width} numbers, or one of its {stored} stored prompts"
                )
            }
            PromptError::NoVectors => write!(f, "the model takes prompts in words, not as vectors"),
            PromptError::VectorWidth { found, width } => {
                write!(f, "the prompt is a vector of {found} numbers, the model takes {width}")
            }
            PromptError::VectorValue { index } => {
                write!(f, "number {index} of the prompt's vector is not finite, or beyond 10000")
            }
            PromptError::ZeroVector => write!(f, "the prompt's vector is all zeros"),
            PromptError::Empty => write!(f, "the prompt has no words"),
            PromptError::TooLong { found, limit } => {
                write!(f, "the prompt is {found} bytes long, at most {limit} are read")
            }
            PromptError::TooManyWords { found, limit } => {
                write!(f, "the prompt has {found} words, the model takes {limit}")
            }
            PromptError::OnlyUnknownWords { words } => {
                write!(f, "the model knows none of the prompt's {words} words")
            }
            PromptError::NotStored { stored } => {
                write!(f, "none of the model's {stored} stored prompts has that name")
            }
        }
    }
}

impl core::error::Error for PromptError {}

impl Text<'_> {
    /// Rows of memory that `prompt` will have: words of a free text, stored rows of another.
    ///
    /// # Errors
    /// [`PromptError`], but for [`PromptError::OnlyUnknownWords`].
    pub fn rows(&self, prompt: &Prompt<'_>) -> Result<usize, PromptError> {
        match *prompt {
            Prompt::Bank(name) => {
                let entry = self.bank().get(name).ok_or(PromptError::NotStored { stored: self.bank().len() })?;
                Ok(entry.rows())
            }
            Prompt::Vector(vector) if self.takes_vectors() => {
                if vector.len() != self.width() {
                    return Err(PromptError::VectorWidth { found: vector.len(), width: self.width() });
                }
                if let Some(index) = vector.iter().position(|v| !(v.abs() <= bank::MAX_VALUE)) {
                    return Err(PromptError::VectorValue { index });
                }
                if vector.iter().all(|v| *v == 0.0) { Err(PromptError::ZeroVector) } else { Ok(0) }
            }
            Prompt::Vector(_) => Err(PromptError::NoVectors),
            Prompt::Text(_) if self.takes_vectors() => {
                Err(PromptError::Vectors { width: self.width(), stored: self.bank().len() })
            }
            Prompt::Text(text) => {
                if self.encoder().is_none() {
                    return Err(PromptError::NoEncoder { stored: self.bank().len() });
                }
                if text.len() > MAX_PROMPT {
                    return Err(PromptError::TooLong { found: text.len(), limit: MAX_PROMPT });
                }
                match (Words::new(text).count(), self.max_words()) {
                    (0, _) => Err(PromptError::Empty),
                    (found, limit) if found > limit => Err(PromptError::TooManyWords { found, limit }),
                    (found, _) => Ok(found),
                }
            }
        }
    }

    /// Ids of the words of `text` into `ids`.
    ///
    /// # Errors
    /// [`PromptError::OnlyUnknownWords`], or [`PromptError::NoEncoder`].
    pub fn ids(&self, text: &str, ids: &mut [u16]) -> Result<PromptStats, PromptError> {
        let encoder = self.encoder().ok_or(PromptError::NoEncoder { stored: self.bank().len() })?;
        let mut heard = PromptStats::default();
        for (word, id) in Words::new(text).zip(ids.iter_mut()) {
            *id = encoder.vocabulary().id(&word);
            heard.words += 1;
            heard.unknown_words += u16::from(*id == UNKNOWN);
        }
        if heard.unknown_words == heard.words {
            return Err(PromptError::OnlyUnknownWords { words: usize::from(heard.words) });
        }
        Ok(heard)
    }
}
