//! Why a prompt is refused, on the wire.

use motionette::PromptError;

use super::fault::{Sent, fault};

fault! {
    /// [`motionette::PromptError`] on the wire: why a prompt was refused, the request's or that of a span.
    PromptFault of PromptError {
        /// The model reads no text.
        NoEncoder {
            /// Prompts it stores.
            stored: u32,
        },
        /// The model reads no words: it takes prompts as vectors.
        Vectors {
            /// Numbers of a vector.
            width: u32,
            /// Prompts it stores.
            stored: u32,
        },
        /// The model takes prompts in words, not as vectors.
        NoVectors,
        /// The vector is of another encoder.
        VectorWidth {
            /// Its numbers.
            found: u32,
            /// Numbers of one that the model takes.
            width: u32,
        },
        /// A number of the vector is not finite, or beyond what any encoder gives.
        VectorValue {
            /// Its place, from 0.
            index: u32,
        },
        /// All numbers of the vector are zero.
        ZeroVector,
        /// The prompt has no words.
        Empty,
        /// The prompt is too long to be read.
        TooLong {
            /// Its bytes.
            found: u32,
            /// Most that are read.
            limit: u32,
        },
        /// The prompt has too many words.
        TooManyWords {
            /// Its words.
            found: u32,
            /// Most the model takes.
            limit: u32,
        },
        /// The model knows none of the words.
        OnlyUnknownWords {
            /// How many there are.
            words: u32,
        },
        /// The model stores no prompt of that name.
        NotStored {
            /// Prompts it stores.
            stored: u32,
        },
    }
}

impl Sent<PromptFault> for PromptError {
    fn sent(self) -> PromptFault {
        self.into()
    }
}

impl Sent<PromptError> for PromptFault {
    fn sent(self) -> PromptError {
        self.into()
    }
}
