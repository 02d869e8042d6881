//! Why a checkpoint could not become a blob.

use crate::reference::decode_path::DecodePathError;
use crate::reference::tokenizer::EncodeError;

/// A conversion failed. Nothing was written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A size does not fit the blob format.
    #[error("{what} is {found}, the blob format allows {allowed}; train a smaller configuration")]
    Limit {
        /// Which size.
        what: &'static str,
        /// Its value.
        found: usize,
        /// What the format can say.
        allowed: String,
    },
    /// The checkpoint lacks what a motion needs.
    #[error(transparent)]
    DecodePath(#[from] DecodePathError),
    /// A standard deviation that cannot be a scale.
    #[error("std[{channel}] is {value}, expected a positive number; the statistics are damaged")]
    Std {
        /// Feature channel.
        channel: usize,
        /// Its value.
        value: f64,
    },
    /// A code that half precision cannot hold.
    #[error("code {code} of quantizer {quantizer} holds {value}, beyond the range of half precision (65504)")]
    Code {
        /// Codebook.
        quantizer: usize,
        /// Row of the codebook.
        code: usize,
        /// The value.
        value: f32,
    },
    /// Calibration clips could not be encoded.
    #[error("calibration clip {clip}: {source}")]
    Calibration {
        /// Its name.
        clip: String,
        /// Why.
        source: EncodeError,
    },
    /// The dataset has no clip to calibrate with.
    #[error(
        "the calibration dataset has no train clip of at least {least} frames; give another with --calibration, or none"
    )]
    NoCalibration {
        /// Shortest useful clip.
        least: usize,
    },
    /// The prior does not belong to the tokenizer, or the control to the prior.
    #[error(transparent)]
    Prior(crate::checkpoint::ErrorKind),
    /// A published planner does not belong to the tokenizer.
    #[error("{what} are {found}, the tokenizer's are {expected}: the files are of different models")]
    Planner {
        /// What is compared.
        what: String,
        /// The planner's.
        found: usize,
        /// The tokenizer's.
        expected: usize,
    },
    /// A stored prompt is no vector that the planner takes.
    #[error("{what} are {found}, the planner takes {expected}: make them with the encoder that it was trained with")]
    Vector {
        /// What is compared.
        what: String,
        /// The prompt's.
        found: usize,
        /// The planner's.
        expected: usize,
    },
    /// A stored prompt that half precision cannot hold.
    #[error("the stored prompt {name:?} holds {value}, beyond the range of half precision (65504)")]
    Prompt {
        /// Its name.
        name: String,
        /// The value.
        value: f32,
    },
    /// The blob cannot be written.
    #[error(transparent)]
    Write(#[from] crate::blob::write::Error),
    /// The finished blob is not accepted by the runtime.
    #[error("the runtime refuses the finished blob: {0}; the weights are out of its range")]
    Refused(motionette::blob::Error),
    /// The self-test could not be run.
    #[error("the self-test of the finished blob failed: {0}")]
    SelfTest(motionette::Error),
}
