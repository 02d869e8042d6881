//! What generated motion is worth: the tables of `docs/results` (EQUATIONS section 9).
//!
//! | module | what it does |
//! |---|---|
//! | [`prompt`] | what is asked of a generator, and what comes back |
//! | [`codec`] | motion to tokens and back |
//! | [`real`] | real motion: what the tables compare with, and how good the judge is |
//! | [`sample`] | the motions of one row as the judge sees them |
//! | [`figures`] | from judged motions to a row of figures |
//! | [`frechet`] | Fréchet distance of two sets of embeddings |
//! | [`retrieval`] | R-precision, distance of motions and sentences |
//! | [`spread`] | diversity, multimodality |
//! | [`copies`] | near-copies of training sequences |
//! | [`bootstrap`] | intervals |
//! | [`generators`] | motion from text by reference and runtime |
//! | [`control`] | the tables of anchor control |
//! | [`obstacles`] | scenes with obstacles |
//! | [`prior`] | the table of the prior |
//! | [`prompts`] | prompts in a newcomer's words, and two judges of what they gave |
//! | [`report`] | Markdown and JSON |
//! | [`command`] | `motionette-train evaluate` |

pub mod bootstrap;
pub mod codec;
pub mod command;
pub mod control;
pub mod copies;
pub mod figures;
pub mod frechet;
pub mod generators;
pub mod obstacles;
pub mod prior;
pub mod prompt;
pub mod prompts;
pub mod real;
pub mod report;
pub mod retrieval;
pub mod sample;
pub mod spread;
#[cfg(test)]
mod tests;

use crate::{evaluator, tokenizer};

/// Why a table cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The evaluator cannot be used, or a motion cannot be judged.
    #[error(transparent)]
    Judge(#[from] evaluator::Error),
    /// The tokenizer cannot be used.
    #[error("the tokenizer cannot be used")]
    Tokenizer(#[from] tokenizer::Error),
    /// A generator failed.
    #[error("{row}: no motion for {caption:?} with seed {seed}")]
    Generate {
        /// Row of the table.
        row: String,
        /// The caption.
        caption: String,
        /// The seed.
        seed: u64,
        /// What the generator said.
        source: anyhow::Error,
    },
}
