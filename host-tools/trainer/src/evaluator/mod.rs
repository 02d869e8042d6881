//! The evaluator: text and motion brought into one space, so that generated motion can be judged (EQUATIONS section 9).
//!
//! | module | what it does |
//! |---|---|
//! | [`config`] | sizes, schedule, weights of the objective |
//! | [`motion`] | the one road from joints to features; crops, tempo, joined motions |
//! | [`corpus`] | training examples with mirrored twins, random batches |
//! | [`legs`] | legs that say nothing: hidden, or those of another motion |
//! | [`model`] | motion encoder, text encoder, classification heads |
//! | [`objective`] | contrastive and classification terms |
//! | [`training`] | one step |
//! | [`state`] | what is stored of a run: points, figures |
//! | [`judge`] | the finished evaluator: a file, embeddings and labels of motions and sentences |
//! | [`check`] | whether a judge rests on legs |
//! | [`command`] | `motionette-train evaluator` |
//!
//! Real, reconstructed and generated motion take the same road: joints, HumanML3D features extracted from them, embedding. An
//! embedding is a unit vector; distances between embeddings are Euclidean, between 0 and 2.

pub mod check;
pub mod command;
pub mod config;
pub mod corpus;
pub mod judge;
pub mod legs;
pub mod model;
pub mod motion;
pub mod objective;
pub mod state;
#[cfg(test)]
pub(crate) mod tests;
pub mod training;

use motionette_host::dataset::Split;
use motionette_host::motion::features;

use crate::harness;

/// Why an evaluator cannot be trained or used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A split has no clip with a caption that is long enough.
    #[error("the dataset has no {split} clip of 12 frames or more with a caption; import clips of that split")]
    NoMotion {
        /// The split.
        split: Split,
    },
    /// A motion has no features.
    #[error("{name} cannot be judged")]
    Features {
        /// Which motion.
        name: String,
        /// Why not.
        source: features::Error,
    },
    /// The run or one of its files.
    #[error(transparent)]
    Run(#[from] harness::Error),
}
