//! `motionette-train control`: trains or resumes the control of a prior.

use std::path::PathBuf;

use motionette_host::console::remark;
use motionette_host::dataset::Dataset;
use motionette_host::import::phrases::Phrases;
use serde_json::json;

use super::checkpoint;
use super::config::{Config, Variant};
use super::frozen::Frozen;
use super::state::{Sources, State};
use super::training::{Corpora, Trainer};
use crate::harness::options::{finish, with_default};
use crate::harness::{Length, Options, Run};
use crate::prior::corpus::Material;
use crate::prior::sentences::Sentences;

/// Trains what a frozen prior is told of anchors.
#[derive(clap::Args, Clone, Debug)]
#[command(mut_arg("data", |arg| with_default(arg, "data/pack.mds")))]
#[command(mut_arg("out", |arg| with_default(arg, "data/train/nano.control.safetensors")))]
#[command(mut_arg("set", |arg| arg.help(SET)))]
#[command(mut_arg("log_every", |arg| arg.default_value("50")))]
pub struct Args {
    /// Files, settings and pace.
    #[command(flatten)]
    pub options: Options,
    /// The end of the run.
    #[command(flatten)]
    pub length: Length,
    /// Checkpoint of the tokenizer; stays as it is.
    #[arg(long, value_name = "FILE", default_value = "models/nano.safetensors")]
    pub tokenizer: PathBuf,
    /// Checkpoint of the prior; stays as it is.
    #[arg(long, value_name = "FILE", default_value = "models/nano.prior.safetensors")]
    pub prior: PathBuf,
    /// Ways to say the actions and styles of the dataset (docs/phrases.toml); without it there are captions alone.
    #[arg(long, value_name = "FILE")]
    pub phrases: Option<PathBuf>,
    /// Configuration to begin with: nano or tiny.
    #[arg(long, default_value = "nano")]
    pub preset: String,
    /// How anchors reach the planner: what ships, or a baseline to compare it with.
    #[arg(long, value_enum)]
    pub variant: Option<Variant>,
    /// Begins with the scaffold encoder of another control, instead of training it alone first.
    #[arg(long, value_name = "FILE")]
    pub scaffold: Option<PathBuf>,
    /// Trains without pooled and local anchor context.
    #[arg(long)]
    pub no_context: bool,
    /// Trains without the anchor loss.
    #[arg(long)]
    pub no_anchor_loss: bool,
    /// Motions of the validation split that are measured, spread evenly.
    #[arg(long, default_value_t = 160)]
    pub validate: usize,
}

const SET: &str = "Changes one setting, e.g. `rank=16` or `architecture.scaffold.layers=3`; may be repeated";

impl Args {
    fn config(&self) -> anyhow::Result<Config> {
        let mut config = Config::preset(&self.preset)?;
        config.architecture.variant = self.variant.unwrap_or(config.architecture.variant);
        config.architecture.context &= !self.no_context;
        if self.no_anchor_loss {
            config.anchor_loss = 0.0;
        }
        if self.scaffold.is_some() {
            config.alone = 0;
        }
        self.options.configured(config)
    }
}

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or the run, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    args.length.check()?;
    let config = args.config()?;
    let dataset = Dataset::load(&args.options.data)?;
    let frozen = Frozen::load(&args.prior, &args.tokenizer)?;
    let phrases = args.phrases.as_ref().map(Phrases::read).transpose()?;
    let sentences = Sentences::new(&dataset, None, phrases).of_prior(&frozen.prior.sources);
    let material = Material { dataset: &dataset, tokenizer: &frozen.tokenizer, sentences };
    let training = material.training()?;
    let sources = Sources::of(&dataset.hash, &frozen);
    let state = args.options.state(&config, &sources, || {
        let mut state = State::begin(&config, sources.clone(), training.statistics(), &frozen);
        if let Some(path) = &args.scaffold {
            checkpoint::adopt_scaffold(&mut state, path, &frozen)?;
        }
        Ok(state)
    })?;
    remark(&format!(
        "{} motions with their mirrored twins; {} trainable parameters beside {} frozen ones of the prior {} and {} of the tokenizer {}",
        training.motions(),
        state.optimizer.values.len(),
        frozen.prior.parameters.len(),
        &sources.prior[..12],
        frozen.tokenizer.parameters.len(),
        &sources.decoder[..12],
    ));
    let corpora = Corpora { training, held_out: material.held_out()?, measured: args.validate };
    let mut run = Run::new(Trainer::new(&config, &frozen, corpora), state)?;
    let evaluation = run.train(&args.options, args.length)?;
    sources.check_frozen(&frozen)?;
    remark(&format!("the frozen weights are what they were: prior {}, decoder {}", sources.prior, sources.decoder));
    let facts = json!({"frozen": sources, "validation": evaluation.report});
    finish(args.options.json, &run.facts(&args.options, facts))
}
