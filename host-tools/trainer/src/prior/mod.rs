//! The prior: text encoder and planner, trained to undo the corruption of motion tokens (EQUATIONS section 4).
//!
//! | module | what it does |
//! |---|---|
//! | [`config`] | sizes, corruption, augmentation, schedule, presets |
//! | [`captions`] | words, vocabulary, mirrored sentences, paraphrases |
//! | [`corpus`] | motions as tokens, and the examples drawn from them |
//! | [`corruption`] | tokens that move to near codes |
//! | [`model`] | text encoder and planner |
//! | [`training`] | one step |
//! | [`state`] | everything a run needs to go on, as a file |
//! | [`checkpoint`] | the finished prior, as a file |
//! | [`validation`] | cross-entropy on motions that were not trained on |
//! | [`curves`] | the run as JSON and SVG |
//! | [`command`] | `motionette-train prior` |

pub mod captions;
pub mod checkpoint;
pub mod command;
pub mod config;
pub mod corpus;
pub mod corruption;
pub mod curves;
pub mod model;
pub mod state;
#[cfg(test)]
mod tests;
pub mod training;
pub mod validation;

use std::path::PathBuf;

use motionette_host::dataset::Split;
use motionette_host::motion::features;

use crate::tensor_file;

/// Why a prior cannot be trained.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no such preset.
    #[error("there is no preset {name:?}; use nano, micro or tiny")]
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
    /// A split has no clip that is long enough and has a caption.
    #[error("the dataset has no {split} clip with a caption and at least one token (4 frames)")]
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
    /// The command line gives the run no end.
    #[error("give the run an end: --steps N or --minutes M")]
    NoEnd,
}
