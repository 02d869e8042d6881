//! `motionette-train prior`: trains or resumes a prior.

use std::path::PathBuf;

use motionette_host::checkpoint::prior::codebook_hash;
use motionette_host::console::remark;
use motionette_host::dataset::Dataset;
use serde_json::json;

use super::config::Config;
use super::corpus::{Material, Words};
use super::corruption::Metric;
use super::state::{Sources, State};
use super::training::Trainer;
use crate::harness::options::{finish, with_default};
use crate::harness::{Length, Options, Run};
use crate::tokenizer::checkpoint::Checkpoint;

/// Trains text encoder and planner on a dataset of `motionette import` and the tokens of a tokenizer.
#[derive(clap::Args, Clone, Debug)]
#[command(mut_arg("out", |arg| with_default(arg, "data/train/nano.prior.safetensors")))]
#[command(mut_arg("set", |arg| arg.help(SET)))]
pub struct Args {
    /// Files, settings and pace.
    #[command(flatten)]
    pub options: Options,
    /// The end of the run.
    #[command(flatten)]
    pub length: Length,
    /// Checkpoint of the tokenizer whose tokens are planned.
    #[arg(long, value_name = "FILE", default_value = "models/nano.safetensors")]
    pub tokenizer: PathBuf,
    /// Configuration to begin with: nano, micro or tiny.
    #[arg(long, default_value = "nano")]
    pub preset: String,
}

const SET: &str = "Changes one setting, e.g. `dropout=0.2` or `architecture.planner.layers=6`; may be repeated";

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or the run, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    args.length.check()?;
    let config = args.options.configured(Config::preset(&args.preset)?)?;
    let dataset = Dataset::load(&args.options.data)?;
    let tokenizer = Checkpoint::load(&args.tokenizer)?;
    let words = Words::of(&dataset);
    let codes = &tokenizer.config.architecture;
    let sources = Sources {
        data_hash: dataset.hash.clone(),
        tokenizer: codebook_hash(&tokenizer.codebook),
        codes: codes.codes,
        code_dim: codes.code_dim,
        vocabulary: words.vocabulary.words.clone(),
    };
    let state = args.options.state(&config, &sources, || Ok(State::begin(&config, sources.clone())))?;
    let max_words = config.architecture.max_words;
    let material = Material { dataset: &dataset, tokenizer: &tokenizer, words, max_words };
    let training = material.training()?;
    remark(&format!(
        "{} motions with their mirrored twins, {} tokens, {} words, {} parameters",
        training.motions(),
        training.tokens(),
        sources.vocabulary.len(),
        state.optimizer.values.len(),
    ));
    let metric = Metric::new(&tokenizer.codebook, codes.code_dim, config.c, config.a);
    let trainer = Trainer::new(sources.layout(&config), training, material.held_out()?, metric);
    let mut run = Run::new(trainer, state)?;
    let evaluation = run.train(&args.options, args.length)?;
    finish(args.options.json, &run.facts(&args.options, json!({"validation": evaluation.report})))
}
