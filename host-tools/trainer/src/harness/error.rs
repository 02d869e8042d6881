//! What can be wrong with any run.

use std::path::PathBuf;

use crate::setting::OutOfRange;
use crate::tensor_file;

/// Why a run cannot begin or go on.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no such preset.
    #[error("there is no preset {name:?}; use {known}")]
    UnknownPreset {
        /// Name as given.
        name: String,
        /// The names there are.
        known: &'static str,
    },
    /// A setting is out of range.
    #[error(transparent)]
    Setting(#[from] OutOfRange),
    /// A checkpoint, state or curves file cannot be used.
    #[error(transparent)]
    File(#[from] tensor_file::Error),
    /// A file belongs to another run.
    #[error("{} was written by a run with another {what}; start a new run or give the same {what}", path.display())]
    OtherRun {
        /// The file.
        path: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// A state has another number of parameters than its networks.
    #[error("the state holds {found} parameters, but configuration and data give {expected}; start a new run")]
    Parameters {
        /// Number in the state.
        found: usize,
        /// Number in the networks.
        expected: usize,
    },
    /// The objective or its gradient is no longer a number.
    #[error("the objective is not finite at step {step}; lower the learning rate and start from an earlier state")]
    Diverged {
        /// The step, counted from 0.
        step: u64,
    },
    /// The command line gives the run no end.
    #[error("the run has no end: give --steps or --minutes")]
    NoEnd,
    /// The last step came before there was anything to store.
    #[error("the run ended after {steps} steps, before there was a checkpoint to store; give it more steps")]
    TooShort {
        /// Steps done.
        steps: u64,
    },
}
