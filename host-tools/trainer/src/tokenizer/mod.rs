//! The motion tokenizer: a VQ-VAE with one codebook and four frames a token.
//!
//! | module | what it does |
//! |---|---|
//! | [`config`] | sizes, schedule, loss weights, presets |
//! | [`batch`] | training motions with mirrored twins, random crops |
//! | [`model`] | encoder and decoder |
//! | [`quantizer`] | codebook with running means and reset of dead codes |
//! | [`loss`] | objective in metres and over time, with its gradient |
//! | [`training`] | one step, and the run around it |
//! | [`state`] | everything a run needs to go on, as a file |
//! | [`checkpoint`] | the finished tokenizer, as a file |
//! | [`metrics`] | joint errors, drift, code use |
//! | [`curves`] | the run as JSON and SVG |
//! | [`command`] | `motionette-train tokenizer` |

pub mod batch;
pub mod checkpoint;
pub mod command;
pub mod config;
pub mod curves;
pub mod loss;
pub mod metrics;
pub mod model;
pub mod quantizer;
pub mod state;
#[cfg(test)]
mod tests;
pub mod training;

use std::path::PathBuf;

use motionette_host::dataset::{self, Split};
use motionette_host::motion::features;

use crate::tensor_file;

/// Why a tokenizer cannot be trained or measured.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no such preset.
    #[error("there is no preset {name:?}; use nano or tiny")]
    UnknownPreset {
        /// Name as given.
        name: String,
    },
    /// A setting is out of range.
    #[error("{field} is {value}; allowed: {allowed}")]
    Setting {
        /// Name of the setting.
        field: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        allowed: &'static str,
    },
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
    /// The dataset cannot be used.
    #[error(transparent)]
    Dataset(#[from] dataset::Error),
    /// A checkpoint or state file cannot be used.
    #[error(transparent)]
    File(#[from] tensor_file::Error),
    /// A state file belongs to another run.
    #[error("{} was written by a run with another {what}; start a new run or give the same {what}", path.display())]
    OtherRun {
        /// The state file.
        path: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// The objective is no longer a number.
    #[error("the objective is not finite at step {step}; lower the learning rate and start from an earlier state")]
    Diverged {
        /// The step.
        step: u64,
    },
    /// Neither steps nor minutes were given.
    #[error("the run has no end: give --steps or --minutes")]
    NoEnd,
}
