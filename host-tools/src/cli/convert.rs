//! `motionette convert`: a checkpoint into a blob.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use clap::{Args, ValueEnum};
use motionette::blob::MAJOR;
use serde_json::{Value, json};

use super::model::{CheckpointFiles, grouped};
use super::{bar, capabilities, say};
use crate::checkpoint::{PriorCheckpoint, PublishedPlanner, Source, TokenizerCheckpoint, control, prior, published};
use crate::convert::{
    self, CardText, FourBits, Options, PriorSource, PublishedSource, Rounding, bank, calibration, lift,
};
use crate::dataset::{Dataset, Split, captioned};
use crate::output::write_atomic;
use crate::reference::Prior;

/// Quantises a tokenizer checkpoint, and a prior if one is given, and writes the blob that devices run; or lifts an older blob.
///
/// Reads our own checkpoints, MoMask's RVQ-VAE (.tar or .safetensors with opt.txt) and T2M-GPT's VQ-VAE (.pth or .safetensors with
/// t2mgpt_args.json). With a dataset, rounding is calibrated on its train split; without, on random tokens.
///
/// With a prior the blob makes motions from text. Prompts of a bank file (a prompt a line: name, tab, text) are encoded here and stored
/// under their names; with --no-text-encoder these are all that the blob can be asked for. With the prior's control anchors do not only
/// bend what was planned, the planner sees them.
///
/// MoMask's mask and residual transformers and T2M-GPT's transformer are priors as well; their prompts are vectors (docs/published.md), in a
/// bank file .npy files in the place of texts: motionette convert rvq.tar --prior mask.tar --residual res.tar --bank bank.txt -o momask.blob
///
/// A blob of format 3 in place of the checkpoint becomes one of format 4 with the same weights, whose hash is printed for both; nothing
/// but -o goes with it: motionette convert old.blob -o new.blob
///
/// Example: motionette convert nano.safetensors --prior nano.prior.safetensors --control nano.control.safetensors --calibration
/// data/pack.mds -o out/nano.blob
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// The checkpoint, or a blob of format 3.
    checkpoint: PathBuf,
    /// The blob to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Dataset whose train split calibrates the rounding.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    #[command(flatten)]
    files: CheckpointFiles,
    /// Prior of the tokenizer's tokens: text encoder and planner of our own, or a published planner.
    #[arg(long, value_name = "FILE")]
    prior: Option<PathBuf>,
    /// MoMask's residual transformer, which plans what its mask transformer leaves open.
    #[arg(long, value_name = "FILE", requires = "prior")]
    residual: Option<PathBuf>,
    /// Option file of a published prior; else mask_opt.txt, opt.txt or t2mgpt_args.json beside it.
    #[arg(long, value_name = "FILE", requires = "prior")]
    prior_options: Option<PathBuf>,
    /// Option file of the residual transformer; else res_opt.txt or opt.txt beside it.
    #[arg(long, value_name = "FILE", requires = "residual")]
    residual_options: Option<PathBuf>,
    /// Anchor control of the prior.
    #[arg(long, value_name = "FILE", requires = "prior")]
    control: Option<PathBuf>,
    /// Prompts to store in the blob, a prompt a line: name, tab, text.
    #[arg(long, value_name = "FILE", requires = "prior")]
    bank: Option<PathBuf>,
    /// Leave the text encoder out: the blob can be asked for stored prompts only.
    #[arg(long, requires = "bank")]
    no_text_encoder: bool,
    /// Name of the model in its card; else the checkpoint's preset or file name.
    #[arg(long)]
    name: Option<String>,
    /// Licence of the weights in the card.
    #[arg(long, default_value = UNKNOWN)]
    licence: String,
    /// Data of the weights in the card; else the hash of the training data.
    #[arg(long)]
    data: Option<String>,
    /// Bits of the weights in the planner's blocks (attention and feed-forward layers), 8 or 4; everything else keeps 8. A published planner
    /// may have 16, all of it, and has them without this.
    #[arg(long, value_parser = PossibleValuesParser::new(["4", "8", "16"]).map(|b| b.parse::<u8>().unwrap_or(8)), value_name = "BITS")]
    planner_bits: Option<u8>,
    /// Bits of the weights in the decoder's hidden layers, 8 or 16. 16 double its bytes and work; without it 16 for published checkpoints that
    /// nothing calibrates, which were never meant for 8, else 8.
    #[arg(long, value_parser = PossibleValuesParser::new(["8", "16"]).map(|b| if b == "16" { 16_u8 } else { 8 }), value_name = "BITS")]
    decoder_bits: Option<u8>,
    /// Layers of the planner's blocks that have four bits where the others keep eight.
    #[arg(long, value_delimiter = ',', value_parser = PossibleValuesParser::new(FourBits::LAYERS), value_name = "LAYER")]
    four_bits: Vec<String>,
    /// Words with vectors that are kept: those of captions and phrases (0), common ones too (1), all (2).
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(0..=2), value_name = "TIER", requires = "prior")]
    word_tier: u8,
    /// How weights are rounded. With 8 bits those of a prior are always rounded to nearest.
    #[arg(long, value_enum, default_value_t = Way::Feedback)]
    rounding: Way,
    /// Do not refit layers to make up for the layers before them.
    #[arg(long)]
    no_refit: bool,
    /// Do not correct biases.
    #[arg(long)]
    no_bias_correction: bool,
}

/// Licence in a card where none is given.
const UNKNOWN: &str = "unknown";

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
        if begins_like_a_blob(&self.checkpoint) {
            return self.lift();
        }
        let checkpoint = self.files.load(&self.checkpoint)?;
        if let Some(path) = self.prior.as_deref().filter(|path| published::is_published(path)) {
            return self.published(&checkpoint, path);
        }
        ensure!(self.planner_bits != Some(16), "--planner-bits 16 is for published planners; ours have 8 or 4");
        ensure!(self.residual.is_none(), "--residual follows MoMask's mask transformer, and --prior is another");
        let mut prior = self.prior.as_deref().map(prior::load).transpose().context("reading the prior")?;
        if let Some(prior) = &prior {
            prior.check_tokenizer(&checkpoint).context("matching prior and tokenizer")?;
        }
        let control = self.control.as_deref().map(control::load).transpose().context("reading the control")?;
        if let (Some(control), Some(prior)) = (&control, &prior) {
            control.check_prior(prior, &checkpoint).context("matching control and prior")?;
        }
        prior = prior.map(|prior| {
            let tiers = prior.config.word_tiers.clone();
            prior.with_words(|row, _| tiers.get(row).is_none_or(|tier| *tier <= self.word_tier))
        });
        let bank = match (&prior, &self.bank) {
            (Some(prior), Some(path)) => stored_prompts(prior, path, self.no_text_encoder)?,
            _ => Vec::new(),
        };
        let options = self.options(self.wide_layers(&checkpoint));
        let dataset = self.calibration.as_ref().filter(|_| options.needs_calibration());
        let dataset = dataset.map(Dataset::load).transpose()?;
        let cases = match (&dataset, &prior) {
            (Some(dataset), Some(prior)) if options.calibrates_planner() => {
                let reference = Prior::<f32>::new(prior, &checkpoint);
                captioned::choose(&checkpoint, &reference, dataset, Split::Train, calibration::CASES, false)?
            }
            _ => Vec::new(),
        };
        let source = prior.as_ref().map(|p| PriorSource {
            checkpoint: p,
            bank: &bank,
            text_encoder: !self.no_text_encoder,
            control: control.as_ref(),
            cases: &cases,
        });
        let latents = latents(&checkpoint, &options, dataset.as_ref())?;
        let card = self.card(&checkpoint)?;
        let progress = bar(checkpoint.decoder.convolutions().len() as u64, "layers");
        let conversion = convert::convert_with_prior(&checkpoint, source, &options, &latents, &card, |layer| {
            progress.set_message(layer.to_owned());
            progress.inc(1);
        })?;
        progress.finish_and_clear();
        let bytes = conversion.blob.bytes();
        let lost = self.write(bytes)?;
        Ok(json!({
            "output": super::shown(&self.output),
            "bytes": bytes.len(),
            "lost": lost,
            "layers": conversion.layers.len(),
            "words": prior.as_ref().filter(|_| !self.no_text_encoder).map(|p| p.config.vocabulary.len()),
            "bank": bank.iter().map(|e| &e.name).collect::<Vec<_>>(),
            "control": control.as_ref().map(|c| &c.config.families),
            "calibration_sequences": latents.len(),
            "decoder_bits": if options.wide_layers { 16 } else { 8 },
            "planner_bits": prior.as_ref().map(|_| if options.four_bits == FourBits::ALL { 4 } else { 8 }),
            "four_bits": prior.as_ref().map(|_| options.four_bits.names().collect::<Vec<_>>()),
            "name": card.name,
            "checkpoint": card.checkpoint,
        }))
    }

    /// Converts a tokenizer with a published planner.
    fn published(&self, checkpoint: &TokenizerCheckpoint, path: &Path) -> Result<Value> {
        ensure!(
            self.control.is_none() && !self.no_text_encoder,
            "{} is a published planner, which has no text encoder and no anchor control: leave --control and --no-text-encoder out",
            path.display()
        );
        let planner = published::load(path, self.prior_options.as_deref()).context("reading the prior")?;
        let residual = self.residual.as_deref().map(|path| published::load(path, self.residual_options.as_deref()));
        let residual = match residual.transpose().context("reading the residual transformer")? {
            None => None,
            Some(PublishedPlanner::Residual(residual)) => Some(residual),
            Some(_) => bail!("{} is no residual transformer", self.residual.as_deref().unwrap_or(path).display()),
        };
        let bank = match &self.bank {
            None => Vec::new(),
            Some(path) => bank::vectors(path).with_context(|| format!("storing the prompts of {}", path.display()))?,
        };
        let source = PublishedSource { planner: &planner, residual: residual.as_ref(), bank: &bank };
        let wide_planner = self.planner_bits.is_none_or(|bits| bits == 16);
        let options = Options { wide_planner, ..self.options(self.wide_layers(checkpoint)) };
        let dataset = self.calibration.as_ref().filter(|_| options.needs_calibration());
        let dataset = dataset.map(Dataset::load).transpose()?;
        let latents = latents(checkpoint, &options, dataset.as_ref())?;
        let card = self.card(checkpoint)?;
        let progress = bar(checkpoint.decoder.convolutions().len() as u64, "layers");
        let conversion = convert::convert_published(checkpoint, &source, &options, &latents, &card, |layer| {
            progress.set_message(layer.to_owned());
            progress.inc(1);
        })?;
        progress.finish_and_clear();
        let bytes = conversion.blob.bytes();
        let lost = self.write(bytes)?;
        Ok(json!({
            "output": super::shown(&self.output),
            "bytes": bytes.len(),
            "lost": lost,
            "layers": conversion.layers.len(),
            "bank": bank.iter().map(|e| &e.name).collect::<Vec<_>>(),
            "residual": residual.is_some(),
            "calibration_sequences": latents.len(),
            "decoder_bits": if options.wide_layers { 16 } else { 8 },
            "planner_bits": self.planner_bits.unwrap_or(16),
            "four_bits": options.four_bits.names().collect::<Vec<_>>(),
            "name": card.name,
            "checkpoint": card.checkpoint,
        }))
    }

    /// Whether all of the decoder has 16 bits.
    fn wide_layers(&self, checkpoint: &TokenizerCheckpoint) -> bool {
        let published = checkpoint.config.source != Source::Motionette && self.calibration.is_none();
        self.decoder_bits.map_or(published, |bits| bits == 16)
    }

    /// How weights are quantised.
    fn options(&self, wide_layers: bool) -> Options {
        let rounding = match self.rounding {
            Way::Nearest => Rounding::Nearest,
            Way::Clipped => Rounding::Clipped,
            Way::Feedback => Rounding::Feedback,
        };
        let all = if self.planner_bits == Some(4) { FourBits::ALL } else { FourBits::NONE };
        let four_bits = self.four_bits.iter().try_fold(all, |layers, layer| layers.with(layer)).unwrap_or(all);
        if wide_layers {
            // What rounding to 16 bits loses is not worth making up for.
            return Options { four_bits, wide_layers, ..Options::PLAIN };
        }
        Options {
            rounding,
            refit: !self.no_refit,
            bias_correction: !self.no_bias_correction,
            four_bits,
            ..Options::default()
        }
    }

    fn card(&self, checkpoint: &TokenizerCheckpoint) -> Result<CardText> {
        let stem = || self.checkpoint.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let preset = Some(checkpoint.config.preset.clone()).filter(|p| !p.is_empty());
        // "tokenizer", "tokenizer+prior" or "tokenizer+prior+control": `verify` looks for any of them.
        let mut hash = crate::checkpoint::file_hash(&self.checkpoint).context("hashing the checkpoint")?;
        for path in self.prior.iter().chain(&self.residual).chain(&self.control) {
            hash = format!("{hash}+{}", crate::checkpoint::file_hash(path).context("hashing a checkpoint")?);
        }
        Ok(CardText {
            name: self.name.clone().or(preset).unwrap_or_else(stem),
            licence: self.licence.clone(),
            data: self.data.clone().unwrap_or_else(|| checkpoint.config.data_hash.clone()),
            checkpoint: hash,
        })
    }

    /// Writes the blob; what the one that it replaces had and it has not comes back.
    fn write(&self, bytes: &[u8]) -> Result<Vec<String>> {
        let lost = capabilities::lost(&self.output, bytes)?;
        if !lost.is_empty() {
            let (path, lost) = (self.output.display(), lost.join(", "));
            say(&format!("warning: {path} is replaced by a blob that can do less; the one before had {lost}"));
        }
        write_atomic(&self.output, |w| w.write_all(bytes)).context("writing the blob")?;
        say(&format!("{} bytes to {}", grouped(bytes.len() as u64), self.output.display()));
        Ok(lost)
    }

    /// Writes a blob of the format before this one anew.
    fn lift(self) -> Result<Value> {
        ensure!(!self.asks_for_more(), "{} is a blob: nothing but -o goes with it", self.checkpoint.display());
        let what = || format!("lifting the blob {}", self.checkpoint.display());
        let lifted = lift::lift(&std::fs::read(&self.checkpoint).with_context(what)?).with_context(what)?;
        let bytes = lifted.blob.bytes();
        write_atomic(&self.output, |w| w.write_all(bytes)).context("writing the blob")?;
        let ([major, minor], [old, new]) = (lifted.from, &lifted.hashes);
        say(&format!(
            "format {major}.{minor} to {MAJOR}.{}, {} bytes of weights",
            lift::LIFTED,
            grouped(lifted.weights as u64)
        ));
        say(&format!("  SHA-256 of the old weight section  {old}"));
        say(&format!("  SHA-256 of the new weight section  {new}"));
        say(&format!("{} bytes to {}", grouped(bytes.len() as u64), self.output.display()));
        Ok(json!({
            "output": self.output,
            "bytes": bytes.len(),
            "from": format!("{major}.{minor}"),
            "version": format!("{MAJOR}.{}", lift::LIFTED),
            "weights": lifted.weights,
            "old_weights_sha256": old,
            "new_weights_sha256": new,
        }))
    }

    /// Whether an option was given that means something for checkpoints alone.
    fn asks_for_more(&self) -> bool {
        let [residual, options] = [&self.residual, &self.prior_options];
        let paths =
            [&self.calibration, &self.prior, residual, options, &self.residual_options, &self.control, &self.bank];
        let texts = [&self.name, &self.data];
        paths.into_iter().any(Option::is_some)
            || texts.into_iter().any(Option::is_some)
            || self.files.given()
            || self.licence != UNKNOWN
            || self.planner_bits.is_some()
            || self.decoder_bits.is_some()
            || !self.four_bits.is_empty()
            || self.word_tier != 2
            || !matches!(self.rounding, Way::Feedback)
            || self.no_text_encoder
            || self.no_refit
            || self.no_bias_correction
    }
}

/// What the rounding is calibrated on.
fn latents(checkpoint: &TokenizerCheckpoint, options: &Options, dataset: Option<&Dataset>) -> Result<Vec<Vec<f32>>> {
    Ok(match dataset {
        _ if !options.needs_calibration() => Vec::new(),
        Some(dataset) => calibration::from_dataset(checkpoint, dataset)?,
        None => {
            say("note: calibrated on random tokens; with --calibration <dataset> the error is about half");
            calibration::random(checkpoint)
        }
    })
}

/// Whether the file is a blob; what cannot be read is not.
fn begins_like_a_blob(path: &Path) -> bool {
    let mut first = [0; 4];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut first));
    read.is_ok() && lift::is_blob(&first)
}

/// Reads and encodes a bank file; says which words the vocabulary does not have.
fn stored_prompts(prior: &PriorCheckpoint, path: &Path, unconditional: bool) -> Result<Vec<bank::Entry>> {
    let what = || format!("storing the prompts of {}", path.display());
    let prompts = bank::read(path).with_context(what)?;
    ensure!(!prompts.is_empty(), "{} holds no prompt; write a name, a tab and a prompt a line", path.display());
    let entries = bank::encode(prior, &prompts, unconditional).with_context(what)?;
    for entry in entries.iter().filter(|e| !e.unknown.is_empty()) {
        say(&format!(
            "note: prompt {:?} has words the vocabulary does not have: {}",
            entry.name,
            entry.unknown.join(", ")
        ));
    }
    Ok(entries)
}
