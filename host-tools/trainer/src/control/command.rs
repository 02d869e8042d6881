//! `motionette-train control`: trains or resumes the control of a prior.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Instant;

use indicatif::{ProgressBar, ProgressStyle};
use motionette_host::checkpoint::prior::codebook_hash;
use motionette_host::dataset::{Dataset, Split};
use serde_json::json;

use super::config::{Config, Variant};
use super::curves::Point;
use super::state::{Sources, State};
use super::training::{Distance, Frozen, Trainer};
use super::validation::{self, Report};
use super::{Error, checkpoint};
use crate::prior::corpus::{self, Corpus};
use crate::prior::corruption::Metric;
use crate::prior::training::Score;
use crate::prior::{self, model};
use crate::run::{changed, finish, with_suffix};
use crate::schedule::Plan;
use crate::tokenizer;

/// Trains what a frozen prior is told of anchors.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Dataset file.
    #[arg(long, value_name = "FILE", default_value = "data/pack.mds")]
    pub data: PathBuf,
    /// Checkpoint of the tokenizer; stays as it is.
    #[arg(long, value_name = "FILE", default_value = "models/nano.safetensors")]
    pub tokenizer: PathBuf,
    /// Checkpoint of the prior; stays as it is.
    #[arg(long, value_name = "FILE", default_value = "models/nano.prior.safetensors")]
    pub prior: PathBuf,
    /// Where the checkpoint goes, with or without `.safetensors`; state and curves go beside it.
    #[arg(short, long, value_name = "FILE", default_value = "data/train/nano.control.safetensors")]
    pub out: PathBuf,
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
    /// Changes one setting, e.g. `rank=16` or `architecture.scaffold.layers=3`; may be repeated.
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
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..))]
    pub log_every: u64,
    /// Points of the curves between two checkpoints with their figures on the validation split.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    pub save_every: u64,
    /// Motions of the validation split that are measured, spread evenly.
    #[arg(long, default_value_t = 160)]
    pub validate: usize,
    /// Prints one JSON object on the last line.
    #[arg(long)]
    pub json: bool,
}

impl Args {
    fn config(&self) -> anyhow::Result<Config> {
        let mut config = Config::preset(&self.preset)?;
        config.seed = self.seed.unwrap_or(config.seed);
        config.architecture.variant = self.variant.unwrap_or(config.architecture.variant);
        config.architecture.context &= !self.no_context;
        if self.no_anchor_loss {
            config.anchor_loss = 0.0;
        }
        if self.scaffold.is_some() {
            config.alone = 0;
        }
        let config = self.set.iter().try_fold(config, |config, change| changed(&config, change))?;
        config.check()?;
        Ok(config)
    }
}

/// Prior and tokenizer, checked against one another.
///
/// # Errors
/// [`Error::Prior`], [`Error::Tokenizer`], [`Error::OtherTokenizer`].
pub fn frozen(prior: &Path, tokenizer: &Path) -> Result<(Frozen, prior::state::Sources), Error> {
    let tokenizer = tokenizer::checkpoint::Checkpoint::load(tokenizer)?;
    let (config, sources, values) = prior::checkpoint::load(prior)?;
    let found = codebook_hash(&tokenizer.codebook);
    if found != sources.tokenizer {
        return Err(Error::OtherTokenizer { wanted: sources.tokenizer, found });
    }
    let layout = model::layout(&config.architecture, sources.vocabulary.len(), sources.codes);
    Ok((Frozen { config, layout, values, tokenizer }, sources))
}

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or the run, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if args.steps.is_none() && !args.minutes.is_some_and(|m| m.is_finite() && m > 0.0) {
        return Err(Error::NoEnd.into());
    }
    let config = args.config()?;
    let dataset = Dataset::load(&args.data)?;
    let (frozen, prior) = frozen(&args.prior, &args.tokenizer)?;
    let args = &Args { out: with_suffix(&args.out), ..args.clone() };
    let state_path = args.out.with_extension("state.safetensors");
    let words = prior::captions::Vocabulary::new(prior.vocabulary.clone());
    let (_, paraphrases) = corpus::vocabulary(&dataset);
    let split = |split, twins| {
        let longest = frozen.config.architecture.max_words;
        Corpus::new(&dataset, split, twins, &frozen.tokenizer, &words, &paraphrases, longest)
    };
    let training = split(Split::Train, true).map_err(Error::from)?;
    let held_out = match dataset.split(Split::Val).next() {
        Some(_) => Some(split(Split::Val, false).map_err(Error::from)?),
        None => None,
    };
    let sources = Sources::of(&dataset.hash, &frozen);
    let state = match args.resume {
        true => resumed(&state_path, &config, &sources, &frozen)?,
        false => {
            let mut state = State::new(&config, sources.clone(), training.statistics(), &frozen);
            if let Some(path) = &args.scaffold {
                checkpoint::adopt_scaffold(&mut state, path, &frozen)?;
            }
            state
        }
    };
    eprintln!(
        "{} motions with their mirrored twins; {} trainable parameters beside {} frozen ones of the prior {} and {} of the tokenizer {}",
        training.motions(),
        state.optimizer.values.len(),
        frozen.values.len(),
        &sources.prior[..12],
        frozen.tokenizer.parameters.len(),
        &sources.decoder[..12],
    );
    let architecture = &frozen.tokenizer.config.architecture;
    let metric = Metric::new(&frozen.tokenizer.codebook, architecture.code_dim, frozen.config.c, frozen.config.a);
    let mut trainer = Trainer::new(state, &frozen, &training, metric.clone());
    if let Some(steps) = args.steps {
        trainer.state.plan = Some(Plan::of_steps(steps, config.schedule.decay));
    }
    // A path that cannot be written should fail now and not after an hour.
    trainer.state.save(&state_path)?;
    let measure = |state: &State| {
        let report =
            held_out.as_ref().map(|corpus| validation::measure(state, &frozen, corpus, &metric, args.validate));
        report.unwrap_or_default()
    };
    train(args, &mut trainer, &state_path, &measure)?;
    let report = measure(&trainer.state);
    keep(args, &mut trainer, &state_path, &report)?;
    println!("{}", validation::line(&report));
    sources.check_frozen(&frozen)?;
    eprintln!("the frozen weights are what they were: prior {}, decoder {}", sources.prior, sources.decoder);
    let facts = json!({
        "checkpoint": args.out,
        "state": state_path,
        "steps": trainer.state.step,
        "seconds": trainer.state.seconds,
        "parameters": trainer.state.optimizer.values.len(),
        "frozen": sources,
        "validation": report,
    });
    finish(args.json, &facts)
}

fn resumed(path: &Path, config: &Config, sources: &Sources, frozen: &Frozen) -> Result<State, Error> {
    let state = State::load(path, frozen)?;
    let other = |what| Err(Error::OtherRun { path: path.to_path_buf(), what });
    if state.config != *config {
        return other("configuration");
    }
    if state.sources.prior != sources.prior {
        return other("prior");
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
    measure: &dyn Fn(&State) -> Report,
) -> anyhow::Result<()> {
    let bar = std::io::stderr().is_terminal().then(|| {
        let style = ProgressStyle::with_template("{bar:30} {pos}/{len} steps, {per_sec}, {eta} left");
        ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
    });
    let (mut tokens, mut distance) = (Score::default(), Distance::default());
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
        distance.add(step.distance);
        if let Some(bar) = &bar {
            let by_clock = (state.step as f64 * limit / state.seconds.max(1e-9)) as u64;
            bar.set_length(state.plan.map_or(by_clock, |plan| plan.steps));
            bar.set_position(state.step);
        }
        if !state.step.is_multiple_of(args.log_every) {
            continue;
        }
        let point = Point {
            step: state.step,
            rate: step.rate,
            loss: tokens.loss / tokens.count.max(1.0),
            accuracy: tokens.right / tokens.count.max(1.0),
            anchor: distance.loss / distance.motions.max(1.0),
            error: distance.error / distance.anchors.max(1.0),
            gradient_norm: step.gradient_norm,
        };
        let line = format!(
            "step {:>6} {:>6.0} s rate {:.1e} cross-entropy {:.4} top-1 {:.3} anchor loss {:.3} control error {:.3} m norm {:.2}",
            point.step,
            state.seconds,
            point.rate,
            point.loss,
            point.accuracy,
            point.anchor,
            point.error,
            point.gradient_norm
        );
        say(bar.as_ref(), &line);
        state.curves.points.push(point);
        (tokens, distance) = (Score::default(), Distance::default());
        if state.step.is_multiple_of(args.log_every * args.save_every) {
            let report = measure(state);
            keep(args, trainer, state_path, &report)?;
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
fn keep(args: &Args, trainer: &mut Trainer<'_>, state_path: &Path, report: &Report) -> Result<(), Error> {
    let frozen = trainer.frozen;
    let state = &mut trainer.state;
    checkpoint::save(state, frozen, &args.out, report)?;
    let step = state.step;
    state.curves.evaluations.retain(|(at, _)| *at < step);
    state.curves.evaluations.push((step, report.clone()));
    state.save(state_path)?;
    state.curves.save(&args.out)
}
