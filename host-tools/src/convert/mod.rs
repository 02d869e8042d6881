//! From a checkpoint to a blob: quantisation, then the byte format.
//!
//! Weights become int8 with one scale per output channel. Two exceptions: the decoder's root rows become int16, because their errors add
//! up over time, and the weights of the planner's blocks become 4-bit where [`Options::four_bits`] says so.
//!
//! Rounding to the nearest integer alone loses accuracy. Three methods win it back, each an option so that it can be measured against
//! the others ([`Options`]): rounding with error feedback; refitting each layer to compensate for the error of the layers before it;
//! and bias correction. All three use the covariance of a layer's input over calibration clips.
//!
//! | file | what |
//! |---|---|
//! | [`calibration`] | latents of train clips |
//! | [`moments`] | covariances |
//! | [`rounding`] | one row of weights to integers |
//! | [`conv1d`] | one layer |
//! | [`decoder`] | all layers; each is calibrated on the output of the quantised layers before it |
//! | [`prior`] | text encoder, planner and anchor control |
//! | [`published`] | planners of MoMask and T2M-GPT |
//! | [`bank`] | prompts encoded beforehand |
//! | [`mod@blob`] | what of it all goes into the blob; its self-test |
//! | [`lift`] | blobs of the format before this one |

pub mod bank;
pub mod blob;
pub mod calibration;
pub mod conv1d;
pub mod decoder;
pub mod error;
pub mod lift;
pub mod moments;
pub mod prior;
pub mod published;
pub mod rounding;

pub use conv1d::{FourBits, Options};
pub use error::Error;
pub use published::PublishedSource;
pub use rounding::Rounding;

use crate::blob::{AlignedBlob, QuantisedConv1d};
use crate::checkpoint::{ControlCheckpoint, PriorCheckpoint, TokenizerCheckpoint};
use crate::dataset::captioned::CaptionedMotion;
use prior::{Inputs, QuantisedPrior};
use published::QuantisedPublished;

/// Longest motion of our models: 196 frames.
pub const MAX_TOKENS: usize = 49;
/// Output rows in int16: yaw velocity, planar velocity, height.
pub const ROOT_ROWS: usize = 4;

/// Text of the model card in a blob.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CardText {
    /// Name of the model.
    pub name: String,
    /// Licence of the weights.
    pub licence: String,
    /// Data it was trained on.
    pub data: String,
    /// Hash of the checkpoint.
    pub checkpoint: String,
}

/// A finished conversion.
#[derive(Debug, Clone)]
pub struct Conversion {
    /// The blob.
    pub blob: AlignedBlob,
    /// Its decoder in integers.
    pub layers: Vec<QuantisedConv1d>,
    /// Its text encoder, planner and anchor control in integers.
    pub prior: Option<QuantisedPrior>,
}

/// What plans a blob's tokens, and its weights in integers.
#[derive(Debug, Clone, Copy)]
enum Planned<'a> {
    /// Nothing.
    Given,
    /// A prior of our own.
    Prior(&'a PriorSource<'a>, &'a QuantisedPrior),
    /// A published planner.
    Published(&'a PublishedSource<'a>, &'a QuantisedPublished),
}

/// A prior that goes into a blob, and how.
#[derive(Debug, Clone, Copy)]
pub struct PriorSource<'a> {
    /// The prior.
    pub checkpoint: &'a PriorCheckpoint,
    /// Prompts to store ([`bank::encode`]).
    pub bank: &'a [bank::Entry],
    /// Whether the text encoder goes in; without it the bank must hold the unconditional prompt.
    pub text_encoder: bool,
    /// The prior's anchor control, if it goes in.
    pub control: Option<&'a ControlCheckpoint>,
    /// Motions with captions on which the rounding of 4-bit weights is calibrated; may be empty.
    pub cases: &'a [CaptionedMotion],
}

/// Quantises `checkpoint` with `options`, calibrated on `latents`, and writes the blob.
///
/// The same input gives the same bytes. `progress` is called with the name of each layer before it is worked on.
///
/// # Errors
/// [`Error`].
pub fn convert(
    checkpoint: &TokenizerCheckpoint,
    options: &Options,
    latents: &[Vec<f32>],
    card: &CardText,
    progress: impl FnMut(&str),
) -> Result<Conversion, Error> {
    convert_with_prior(checkpoint, None, options, latents, card, progress)
}

/// The same with text encoder, stored prompts, planner and anchor control.
///
/// # Errors
/// [`Error`]; [`Error::Prior`] for a prior of another tokenizer, or a control of another prior.
pub fn convert_with_prior(
    checkpoint: &TokenizerCheckpoint,
    prior: Option<PriorSource<'_>>,
    options: &Options,
    latents: &[Vec<f32>],
    card: &CardText,
    progress: impl FnMut(&str),
) -> Result<Conversion, Error> {
    if let Some(prior) = &prior {
        prior.checkpoint.check_tokenizer(checkpoint).map_err(Error::Prior)?;
        if let Some(control) = prior.control {
            control.check_prior(prior.checkpoint, checkpoint).map_err(Error::Prior)?;
        }
    }
    let layers = decoder::quantise(&checkpoint.decoder, ROOT_ROWS, options, latents, progress);
    let quantised = prior.as_ref().map(|p| {
        let inputs =
            if options.calibrates_planner() { prior::inputs(p.checkpoint, checkpoint, p.cases) } else { Inputs::new() };
        prior::quantise(p.checkpoint, p.control, options, &inputs)
    });
    let planned = match (&prior, &quantised) {
        (Some(source), Some(quantised)) => Planned::Prior(source, quantised),
        _ => Planned::Given,
    };
    let blob = blob::write(checkpoint, &layers, planned, card)?;
    Ok(Conversion { blob, layers, prior: quantised })
}

/// The same with a published planner.
///
/// # Errors
/// [`Error`]; [`Error::Planner`] for a planner of another tokenizer.
pub fn convert_published(
    checkpoint: &TokenizerCheckpoint,
    source: &PublishedSource<'_>,
    options: &Options,
    latents: &[Vec<f32>],
    card: &CardText,
    progress: impl FnMut(&str),
) -> Result<Conversion, Error> {
    source.check(checkpoint)?;
    let layers = decoder::quantise(&checkpoint.decoder, ROOT_ROWS, options, latents, progress);
    let quantised = source.quantise(options);
    let blob = blob::write(checkpoint, &layers, Planned::Published(source, &quantised), card)?;
    Ok(Conversion { blob, layers, prior: None })
}
