//! The motion tokenizer: a VQ-VAE with one codebook and four frames a token.
//!
//! | module | what it does |
//! |---|---|
//! | [`config`] | sizes, schedule, loss weights, presets |
//! | [`batch`] | training motions with mirrored twins, random crops |
//! | [`model`] | encoder and decoder |
//! | [`quantizer`] | codebook with running means and reset of dead codes |
//! | [`loss`] | objective in metres and over time, with its gradient |
//! | [`training`] | one step |
//! | [`state`] | what a run begins with, and the codebook in its state |
//! | [`checkpoint`] | the finished tokenizer, as a file |
//! | [`metrics`] | joint errors, drift, code use |
//! | [`kept`] | which actions rules over joints still see |
//! | [`curves`] | points and diagrams of a run |
//! | [`command`] | `motionette-train tokenizer` |

pub mod batch;
pub mod checkpoint;
pub mod command;
pub mod config;
pub mod curves;
pub mod kept;
pub mod loss;
pub mod metrics;
pub mod model;
pub mod quantizer;
pub mod state;
#[cfg(test)]
mod tests;
pub mod training;

use motionette_host::dataset::Split;
use motionette_host::motion::features;

use crate::harness;

/// Why a tokenizer cannot be trained or measured.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A split has no clip that is long enough.
    #[error("the dataset has no {split} clip of at least one token (4 frames); import clips of that split")]
    NoMotion {
        /// The split.
        split: Split,
    },
    /// Features cannot be extracted from a mirrored clip.
    #[error("clip {clip} cannot be mirrored")]
    Mirror {
        /// Name of the clip.
        clip: String,
        /// Why not.
        source: features::Error,
    },
    /// The run or one of its files.
    #[error(transparent)]
    Run(#[from] harness::Error),
}
