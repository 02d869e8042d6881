//! `motionette-train prior`: trains or resumes a prior.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use motionette_host::checkpoint::prior::codebook_hash;
use motionette_host::dataset::{Dataset, Split};
use serde_json::json;

use super::Error;
use super::config::Config;
use super::corpus::{self, Corpus};
use super::corruption::Metric;
use super::curves::Point;
use super::state::{Sources, State};
use super::training::{Score, Trainer};
use super::validation::{self, Report};
use super::{captions::Vocabulary, checkpoint};
use crate::run::{changed, finish, with_suffix};
use crate::schedule::Plan;
use crate::tokenizer;

/// Trains text encoder and planner on a dataset of `motionette import` and the tokens of a tokenizer.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Dataset file.
    #[arg(long, value_name = "FILE")]
    pub data: PathBuf,
    /// Checkpoint of the tokenizer whose tokens are planned.
    #[arg(long, value_name = "FILE", default_value = "models/nano.safetensors")]
    pub tokenizer: PathBuf,
    /// Where the checkpoint goes, with or without `.safetensors`; state and curves go beside it.
    #[arg(short, long, value_name = "FILE", default_value = "data/train/nano.prior.safetensors")]
    pub out: PathBuf,
    /// Configuration to begin with: nano, micro or tiny.
    #[arg(long, default_value = "nano")]
    pub preset: String,
    /// Changes one setting, e.g. `dropout=0.2` or `architecture.planner.layers=6`; may be repeated.
    #[arg(long, value_name = "FIELD=VALUE")]
    pub set: Vec<String>,
    /// Seed of weights, batches and dropout.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Length of the run in steps.
    #[arg(long)]
    pub steps: Option<u64>,
    /// Length of the run in minutes; ignored when --steps is given.
    #[arg(long)]
    pub minutes: Option<f64>,
    /// Goes on with the run whose state lies beside the checkpoint.
    #[arg(long)]
    pub resume: bool,
    /// Steps between two points of the curves (and log lines where there is no terminal).
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    pub log_every: u64,
    /// Points of the curves between two checkpoints with their figures on the validation split.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    pub save_every: u64,
    /// Prints one JSON object on the last line.
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or the run, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if args.steps.is_none() && !args.minutes.is_some_and(|m| m.is_finite() && m > 0.0) {
        return Err(Error::NoEnd.into());
    }
    let mut config = Config::preset(&args.preset)?;
    config.seed = args.seed.unwrap_or(config.seed);
    let config = args.set.iter().try_fold(config, |config, change| changed(&config, change))?;
    config.check()?;
    let dataset = Dataset::load(&args.data)?;
    let codes = tokenizer::checkpoint::Checkpoint::load(&args.tokenizer)?;
    let (words, paraphrases) = corpus::vocabulary(&dataset);
    let sources = Sources {
        data_hash: dataset.hash.clone(),
        tokenizer: codebook_hash(&codes.codebook),
        codes: codes.config.architecture.codes,
        code_dim: codes.config.architecture.code_dim,
        vocabulary: words.words.clone(),
    };
    let args = &Args { out: with_suffix(&args.out), ..args.clone() };
    let state_path = args.out.with_extension("state.safetensors");
    let state = if args.resume { resumed(&state_path, &config, &sources)? } else { State::new(&config, sources) };
    let split = |split, twins, words: &Vocabulary| {
        Corpus::new(&dataset, split, twins, &codes, words, &paraphrases, config.architecture.max_words)
    };
    let training = split(Split::Train, true, &words)?;
    eprintln!(
        "{} motions with their mirrored twins, {} tokens, {} words, {} parameters",
        training.motions(),
        training.tokens(),
        words.words.len(),
        state.optimizer.values.len(),
    );
    let held_out = match dataset.split(Split::Val).next() {
        Some(_) => Some(split(Split::Val, false, &words)?),
        None => None,
    };
    let metric = Metric::new(&codes.codebook, codes.config.architecture.code_dim, config.c, config.a);
    let mut trainer = Trainer::new(state, training, metric.clone());
    if let Some(steps) = args.steps {
        trainer.state.plan = Some(Plan::of_steps(steps, config.schedule.decay));
    }
    // A path that cannot be written should fail now and not after an hour.
    trainer.state.save(&state_path)?;
    let measure = |state: &State| held_out.as_ref().map(|corpus| validation::measure(state, corpus, &metric));
    train(args, &mut trainer, &state_path, &measure)?;
    let report = measure(&trainer.state);
    let report = keep(args, &mut trainer.state, &state_path, report)?;
    println!("{}", validation::line(&report));
    let facts = json!({
        "checkpoint": args.out,
        "state": state_path,
        "steps": trainer.state.step,
        "seconds": trainer.state.seconds,
        "parameters": trainer.state.optimizer.values.len(),
        "validation": report,
    });
    finish(args.json, &facts)
}

fn resumed(path: &Path, config: &Config, sources: &Sources) -> Result<State, Error> {
    let state = State::load(path)?;
    let other = |what| Err(Error::OtherRun { path: path.to_path_buf(), what });
    if state.config != *config {
        return other("configuration");
    }
    if state.sources.tokenizer != sources.tokenizer {
        return other("tokenizer");
    }
    if state.sources != *sources {
        return other("dataset");
    }
    Ok(state)
}

/// Steps until the end of the plan, with points, checkpoints and progress on the way.
fn train(
    args: &Args,
    trainer: &mut Trainer<'_>,
    state_path: &Path,
    measure: &dyn Fn(&State) -> Option<Report>,
) -> anyhow::Result<()> {
    let bar = std::io::stderr().is_terminal().then(|| {
        let style = ProgressStyle::with_template("{bar:30} {pos}/{len} steps, {per_sec}, {eta} left");
        ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
    });
    let (mut tokens, mut length) = (Score::default(), Score::default());
    let mut clock = Instant::now();
    let limit = args.minutes.unwrap_or(f64::INFINITY) * 60.0;
    loop {
        let state = &mut trainer.state;
        let decay = state.config.schedule.decay;
        if state.plan.is_none() && state.seconds >= limit * (1.0 - decay) {
            state.plan = Some(Plan::falling_from(state.step, decay));
        }
        if state.plan.is_some_and(|plan| state.step >= plan.steps) {
            break;
        }
        let step = trainer.step()?;
        let state = &mut trainer.state;
        state.seconds += clock.elapsed().as_secs_f64();
        clock = Instant::now();
        tokens.add(step.tokens);
        length.add(step.length);
        if let Some(bar) = &bar {
            let by_clock = (state.step as f64 * limit / state.seconds.max(1e-9)) as u64;
            bar.set_length(state.plan.map_or(by_clock, |plan| plan.steps));
            bar.set_position(state.step);
        }
        if !state.step.is_multiple_of(args.log_every) {
            continue;
        }
        let mean = |sum: f64, of: &Score| sum / of.count.max(1.0);
        let point = Point {
            step: state.step,
            rate: step.rate,
            loss: mean(tokens.loss, &tokens),
            accuracy: mean(tokens.right, &tokens),
            length: mean(length.loss, &length),
            gradient_norm: step.gradient_norm,
        };
        let line = format!(
            "step {:>6} {:>6.0} s rate {:.1e} cross-entropy {:.4} top-1 {:.3} length {:.3} norm {:.2}",
            point.step, state.seconds, point.rate, point.loss, point.accuracy, point.length, point.gradient_norm
        );
        say(bar.as_ref(), &line);
        state.curves.points.push(point);
        (tokens, length) = (Score::default(), Score::default());
        if state.step.is_multiple_of(args.log_every * args.save_every) {
            let report = measure(state);
            let report = keep(args, state, state_path, report)?;
            say(bar.as_ref(), &validation::line(&report));
            clock = Instant::now();
        }
    }
    Ok(())
}

fn say(bar: Option<&ProgressBar>, line: &str) {
    match bar {
        Some(bar) => bar.println(line),
        None => eprintln!("{line}"),
    }
}

/// Stores checkpoint, state and curves.
fn keep(args: &Args, state: &mut State, state_path: &Path, report: Option<Report>) -> Result<Report, Error> {
    let report = report.unwrap_or(Report { motions: 0, loss: Vec::new(), accuracy: Vec::new(), length: 0.0 });
    checkpoint::save(state, &args.out, &report)?;
    let step = state.step;
    state.curves.evaluations.retain(|(at, _)| *at < step);
    state.curves.evaluations.push((step, report.clone()));
    state.save(state_path)?;
    state.curves.save(&args.out)?;
    Ok(report)
}
