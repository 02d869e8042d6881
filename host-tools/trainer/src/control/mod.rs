//! Anchor control: what a frozen prior is told of anchors, trained (EQUATIONS sections 2 and 3).
//!
//! | module | what it does |
//! |---|---|
//! | [`config`] | sizes, variants, anchors, loss, schedule, presets |
//! | [`anchors`] | anchors drawn from real motion |
//! | [`model`] | scaffold encoder, AnchorKV, dual context; the baselines |
//! | [`loss`] | the distance of decoded motion from real motion around anchors |
//! | [`training`] | one step |
//! | [`sampling`] | tokens from these networks, for comparison |
//! | [`state`] | everything a run needs to go on, as a file |
//! | [`checkpoint`] | the finished control, as a file |
//! | [`validation`] | figures on motions that were not trained on |
//! | [`curves`] | the run as JSON and SVG |
//! | [`command`] | `motionette-train control` |

pub mod anchors;
pub mod checkpoint;
pub mod command;
pub mod config;
pub mod curves;
pub mod loss;
pub mod model;
pub mod sampling;
pub mod state;
#[cfg(test)]
mod tests;
pub mod training;
pub mod validation;

use std::path::PathBuf;

use crate::{prior, tensor_file, tokenizer};

/// Why control cannot be trained.
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
    /// The prior cannot be used.
    #[error("the prior cannot be used")]
    Prior(#[from] prior::Error),
    /// The tokenizer cannot be used.
    #[error("the tokenizer cannot be used")]
    Tokenizer(#[from] tokenizer::Error),
    /// The prior plans the tokens of another tokenizer.
    #[error(
        "the prior was trained with tokenizer {wanted}, this one is {found}; give the tokenizer it was trained with"
    )]
    OtherTokenizer {
        /// Hash in the prior.
        wanted: String,
        /// Hash of the tokenizer.
        found: String,
    },
    /// A variant that has no place in a blob.
    #[error("{variant} is a baseline for comparison; a checkpoint for the runtime needs variant anchor_kv")]
    Baseline {
        /// Its name.
        variant: String,
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
    /// Frozen weights are not what they were.
    #[error("the frozen {what} changed during training: {before} before, {after} after; this is a bug")]
    Thawed {
        /// Prior or decoder.
        what: &'static str,
        /// Hash before.
        before: String,
        /// Hash after.
        after: String,
    },
    /// The command line gives the run no end.
    #[error("give the run an end: --steps N or --minutes M")]
    NoEnd,
}
