//! `motionette convert`: a checkpoint into a blob.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use super::model::{CheckpointFiles, grouped};
use super::{bar, say};
use crate::convert::{self, CardText, Options, Rounding, calibration};
use crate::dataset::Dataset;
use crate::output::write_atomic;

/// Quantises a tokenizer checkpoint and writes the blob that devices run.
///
/// Reads our own checkpoints, MoMask's RVQ-VAE (.tar or .safetensors with opt.txt) and T2M-GPT's VQ-VAE (.pth or .safetensors with
/// t2mgpt_args.json). With a dataset, rounding is calibrated on its train split; without, on random tokens.
///
/// Example: motionette convert nano.safetensors --calibration data/pack.mds -o nano.blob
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// The checkpoint.
    checkpoint: PathBuf,
    /// The blob to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Dataset whose train split calibrates the rounding.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    #[command(flatten)]
    files: CheckpointFiles,
    /// Name of the model in its card; else the checkpoint's preset or file name.
    #[arg(long)]
    name: Option<String>,
    /// Licence of the weights in the card.
    #[arg(long, default_value = "unknown")]
    licence: String,
    /// Data of the weights in the card; else the hash of the training data.
    #[arg(long)]
    data: Option<String>,
    /// How weights are rounded.
    #[arg(long, value_enum, default_value_t = Way::Feedback)]
    rounding: Way,
    /// Do not refit layers to make up for the layers before them.
    #[arg(long)]
    no_refit: bool,
    /// Do not correct biases.
    #[arg(long)]
    no_bias_correction: bool,
}

/// Roundings by name.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Way {
    /// To nearest; with --no-refit and --no-bias-correction this is plain quantisation.
    Nearest,
    /// To nearest, with the scale that loses least.
    Clipped,
    /// With feedback: errors are passed on so that the output changes least.
    Feedback,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let checkpoint = self.files.load(&self.checkpoint)?;
        let rounding = match self.rounding {
            Way::Nearest => Rounding::Nearest,
            Way::Clipped => Rounding::Clipped,
            Way::Feedback => Rounding::Feedback,
        };
        let options = Options {
            rounding,
            refit: !self.no_refit,
            bias_correction: !self.no_bias_correction,
            ..Options::default()
        };
        let latents = match &self.calibration {
            _ if !options.needs_calibration() => Vec::new(),
            Some(path) => calibration::from_dataset(&checkpoint, &Dataset::load(path)?)?,
            None => {
                say("note: calibrated on random tokens; with --calibration <dataset> the error is about half");
                calibration::random(&checkpoint)
            }
        };
        let stem = || self.checkpoint.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let preset = Some(checkpoint.config.preset.clone()).filter(|p| !p.is_empty());
        let hash = crate::checkpoint::file_hash(&self.checkpoint).context("hashing the checkpoint")?;
        let card = CardText {
            name: self.name.or(preset).unwrap_or_else(stem),
            licence: self.licence,
            data: self.data.unwrap_or_else(|| checkpoint.config.data_hash.clone()),
            checkpoint: hash,
        };
        let progress = bar(checkpoint.decoder.convolutions().len() as u64, "layers");
        let conversion = convert::convert(&checkpoint, &options, &latents, &card, |layer| {
            progress.set_message(layer.to_owned());
            progress.inc(1);
        })?;
        progress.finish_and_clear();
        let bytes = conversion.blob.bytes();
        write_atomic(&self.output, |w| w.write_all(bytes)).context("writing the blob")?;
        say(&format!("{} bytes to {}", grouped(bytes.len() as u64), self.output.display()));
        Ok(json!({
            "output": self.output,
            "bytes": bytes.len(),
            "layers": conversion.layers.len(),
            "calibration_sequences": latents.len(),
            "name": card.name,
            "checkpoint": card.checkpoint,
        }))
    }
}
