//! `motionette-train prior`: trains or resumes a prior.

use std::path::PathBuf;

use anyhow::ensure;

use motionette_host::checkpoint::prior::codebook_hash;
use motionette_host::checkpoint::{WordTable, file_hash};
use motionette_host::console::remark;
use motionette_host::dataset::Dataset;
use motionette_host::import::phrases::Phrases;
use serde_json::json;

use super::config::Config;
use super::corpus::Material;
use super::corruption::Metric;
use super::sentences::Sentences;
use super::state::{Sources, State};
use super::training::{Teacher, Trainer};
use super::{Error, checkpoint};
use crate::evaluate::prompts::file;
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
    /// Ways to say the actions and styles of the dataset (docs/phrases.toml); without it there are captions alone.
    #[arg(long, value_name = "FILE")]
    pub phrases: Option<PathBuf>,
    /// Vectors of words (models/words.safetensors); without them the captions' words are known alone.
    #[arg(long, value_name = "FILE")]
    pub words: Option<PathBuf>,
    /// Prompts for tests, a JSON object with `text` a line (docs/prompts-test.jsonl): none of them is said in training; may be repeated.
    #[arg(long, value_name = "FILE")]
    pub hold_out: Vec<PathBuf>,
    /// A prior whose two passes with guidance are learnt in one: the run begins with its weights, words and meanings.
    #[arg(long, value_name = "FILE", conflicts_with = "words")]
    pub teacher: Option<PathBuf>,
    /// A prior whose weights, words, meanings and configuration the run begins with, instead of random ones. Its tokenizer may be another
    /// with as many codes: tokens mean much the same where one tokenizer was trained on from the other. Its tokens may be corrupted otherwise
    /// (`--set corruption=masks` or `near`): the row of masked tokens is then new, or dropped, and all others are its. With a teacher it is a
    /// student that learns on.
    #[arg(long, value_name = "FILE", conflicts_with = "words")]
    pub from: Option<PathBuf>,
    /// Configuration to begin with: nano, micro or tiny; with a teacher or another prior it is that one's.
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
    let path = args.teacher.as_deref().or(args.from.as_deref());
    let other = path.map(checkpoint::load).transpose()?;
    let student = args.from.as_deref().filter(|_| args.teacher.is_some()).map(checkpoint::load).transpose()?;
    let begun_with = args.from.as_deref().map(file_hash).transpose()?;
    let begin = match &other {
        Some(other) => Config { begun_with, ..other.config.clone() },
        None => Config::preset(&args.preset)?,
    };
    let config = args.options.configured(begin)?;
    let dataset = Dataset::load(&args.options.data)?;
    let tokenizer = Checkpoint::load(&args.tokenizer)?;
    let table = args.words.as_deref().map(WordTable::read).transpose()?;
    let phrases = args.phrases.as_ref().map(Phrases::read).transpose()?;
    let held_out = args.hold_out.iter().map(|path| file::texts(path)).collect::<Result<Vec<_>, _>>()?.concat();
    let sentences = Sentences::new(&dataset, table.as_ref(), phrases).without(held_out.iter().map(String::as_str));
    let codes = &tokenizer.config.architecture;
    let sentences = match &other {
        Some(other) => sentences.of_prior(&other.sources),
        None => sentences,
    };
    let mut sources = Sources {
        data_hash: dataset.hash.clone(),
        tokenizer: codebook_hash(&tokenizer.codebook),
        codes: codes.codes,
        code_dim: codes.code_dim,
        vocabulary: sentences.vocabulary.words.clone(),
        word_vectors: table.as_ref().map_or(0, |table| table.dims),
        word_tiers: table.as_ref().map_or_else(Vec::new, |table| table.tiers.clone()),
        meanings: sentences.meanings.clone(),
        phrases: args.phrases.as_deref().map(file_hash).transpose()?,
        guidance: false,
        teacher: None,
    };
    if let (Some(other), Some(path)) = (&other, path) {
        let own = &other.sources;
        ensure!(!own.guidance, "{} takes one pass already; give the prior that it was made from", path.display());
        sources.word_vectors = own.word_vectors;
        sources.word_tiers.clone_from(&own.word_tiers);
        if let Some(student) = &student {
            let of = |checkpoint: &checkpoint::Checkpoint| {
                (checkpoint.config.architecture.clone(), checkpoint.sources.vocabulary.clone())
            };
            ensure!(of(student) == of(other), "the student has other sizes or words than its teacher");
        }
        let expected = config.corruption;
        if args.teacher.is_some() {
            for (path, prior) in Some((path, other)).into_iter().chain(args.from.as_deref().zip(student.as_ref())) {
                let found = prior.config.corruption;
                if found != expected {
                    return Err(Error::Corruption { path: path.to_path_buf(), found, expected }.into());
                }
            }
            ensure!(own.tokenizer == sources.tokenizer, "{} plans the tokens of another tokenizer", path.display());
            sources.guidance = true;
            sources.teacher = Some(file_hash(path)?);
        } else {
            let sizes =
                |sources: &Sources, config: &Config| (sources.codes, sources.code_dim, config.architecture.clone());
            let alike = sizes(own, &other.config) == sizes(&sources, &config);
            ensure!(alike, "{} has other sizes: the run has those of its tokenizer and settings", path.display());
            if other.config.corruption != expected {
                let row = if expected.is_near() { "is dropped" } else { "begins anew" };
                remark(&format!("{} is of another corruption: the row of masked tokens {row}", path.display()));
            }
        }
    }
    let state = args.options.state(&config, &sources, || {
        Ok(match student.as_ref().or(other.as_ref()) {
            Some(begin) => State::after(&config, sources.clone(), begin),
            None => State::begin(&config, sources.clone(), table.as_ref()),
        })
    })?;
    let material = Material { dataset: &dataset, tokenizer: &tokenizer, sentences };
    let training = material.training()?;
    remark(&format!(
        "{} motions with their mirrored twins, {} tokens, {} words, {} meanings, {} parameters",
        training.motions(),
        training.tokens(),
        sources.vocabulary.len(),
        sources.meanings.len(),
        state.optimizer.values.len(),
    ));
    let metric = Metric::new(&tokenizer.codebook, codes.code_dim, &config);
    let mut trainer = Trainer::new(sources.layout(&config), training, material.held_out()?, metric);
    if let (Some(teacher), true) = (&other, args.teacher.is_some()) {
        trainer = trainer.taught(Teacher::new(teacher));
    }
    let mut run = Run::new(trainer, state)?;
    let evaluation = run.train(&args.options, args.length)?;
    finish(args.options.json, &run.facts(&args.options, json!({"validation": evaluation.report})))
}
