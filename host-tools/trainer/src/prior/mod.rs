//! The prior: text encoder and planner, trained to undo the corruption of motion tokens (EQUATIONS section 4), or to fill in masked ones.
//!
//! | module | what it does |
//! |---|---|
//! | [`config`] | sizes, corruption, augmentation, schedule, presets |
//! | [`captions`] | words, vocabulary, mirrored sentences |
//! | [`sentences`] | what is said of motions, and what it means |
//! | [`corpus`] | motions as tokens, and the examples drawn from them |
//! | [`corruption`] | tokens that move to near codes, or are masked |
//! | [`model`] | text encoder and planner |
//! | [`training`] | one step |
//! | [`state`] | what a run belongs to and begins with |
//! | [`checkpoint`] | the finished prior, as a file |
//! | [`validation`] | cross-entropy on motions that were not trained on |
//! | [`curves`] | points and diagrams of a run |
//! | [`command`] | `motionette-train prior` |

pub mod captions;
pub mod checkpoint;
pub mod command;
pub mod config;
pub mod corpus;
pub mod corruption;
pub mod curves;
pub mod model;
pub mod sentences;
pub mod state;
#[cfg(test)]
mod tests;
pub mod training;
pub mod validation;

use std::path::PathBuf;

use motionette_host::checkpoint::prior::Corruption;
use motionette_host::dataset::Split;
use motionette_host::motion::features;

use crate::harness;

/// Why a prior cannot be trained.
#[derive(Debug, thiserror::Error)]
pub enum Error {
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
    /// A student would learn of a teacher whose tokens are corrupted otherwise.
    #[error("{} has corruption {found:?}, the run's is {expected:?}: teacher and student must have the same", path.display())]
    Corruption {
        /// The other prior.
        path: PathBuf,
        /// Its corruption.
        found: Corruption,
        /// That of the run.
        expected: Corruption,
    },
    /// The run or one of its files.
    #[error(transparent)]
    Run(#[from] harness::Error),
}
