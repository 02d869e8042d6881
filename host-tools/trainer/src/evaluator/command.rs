//! `motionette-train evaluator`: trains, resumes or measures an evaluator.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use motionette_host::dataset::{Dataset, Split};
use serde_json::{Value, json};

use super::Error;
use super::config::Config;
use super::judge::Judge;
use super::objective::Terms;
use super::state::State;
use super::training::Trainer;
use crate::evaluate::prompt::prompts;
use crate::evaluate::real;
use crate::run::{changed, finish, with_suffix};

/// Trains the judge of generated motion on the training split, or measures one.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Dataset file.
    #[arg(long, value_name = "FILE")]
    pub data: PathBuf,
    /// Where the checkpoint goes; the state goes beside it.
    #[arg(short, long, value_name = "FILE", default_value = "models/evaluator.safetensors")]
    pub out: PathBuf,
    /// Seed of weights and batches.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Length of the run.
    #[arg(long)]
    pub steps: Option<u64>,
    /// Changes one setting, e.g. `width=192` or `schedule.warm_up=50`; may be repeated.
    #[arg(long, value_name = "FIELD=VALUE")]
    pub set: Vec<String>,
    /// Goes on with the run whose state lies beside the checkpoint.
    #[arg(long)]
    pub resume: bool,
    /// Steps between two log lines.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    pub log_every: u64,
    /// Log lines between two stored states with figures on the validation split.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..))]
    pub save_every: u64,
    /// Measures this checkpoint on validation and test split and does not train.
    #[arg(long, value_name = "FILE")]
    pub evaluate: Option<PathBuf>,
    /// Prints one JSON object on the last line.
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or the run, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let dataset = Dataset::load(&args.data)?;
    if let Some(path) = &args.evaluate {
        let judge = Judge::load(path)?;
        let figures = figures(&judge, &dataset, &[Split::Val, Split::Test])?;
        return finish(args.json, &json!({"checkpoint": path, "steps": judge.steps(), "metrics": figures}));
    }
    let args = &Args { out: with_suffix(&args.out), ..args.clone() };
    let state_path = args.out.with_extension("state.safetensors");
    let mut trainer = Trainer::new(first_state(args, &dataset, &state_path)?, &dataset)?;
    eprintln!("{} motions with their mirrored twins", trainer.corpus().motions());
    // A path that cannot be written should fail now and not at the end.
    trainer.state.save(&state_path).context("the state of the run cannot be stored")?;
    train(args, &mut trainer, &dataset, &state_path)?;
    let judge = trainer.judge();
    let metrics = figures(&judge, &dataset, &[Split::Val])?;
    judge.save(&args.out, &metrics)?;
    trainer.state.save(&state_path)?;
    finish(
        args.json,
        &json!({"checkpoint": args.out, "steps": judge.steps(), "seconds": trainer.state.seconds, "metrics": metrics}),
    )
}

fn train(args: &Args, trainer: &mut Trainer, dataset: &Dataset, state_path: &Path) -> anyhow::Result<()> {
    let mut clock = Instant::now();
    let (mut sums, mut count) = (Terms::default(), 0.0);
    while trainer.state.step < trainer.state.config.steps {
        let step = trainer.step()?;
        trainer.state.seconds += clock.elapsed().as_secs_f64();
        clock = Instant::now();
        sums.contrastive += step.terms.contrastive;
        sums.content += step.terms.content;
        sums.style += step.terms.style;
        sums.total += step.terms.total;
        count += 1.0;
        let state = &trainer.state;
        if state.step.is_multiple_of(args.log_every) {
            eprintln!(
                "step {:>6} {:>6.0} s rate {:.1e} loss {:.4} contrastive {:.4} content {:.4} style {:.4} norm {:.2}",
                state.step,
                state.seconds,
                step.rate,
                sums.total / count,
                sums.contrastive / count,
                sums.content / count,
                sums.style / count,
                step.gradient_norm,
            );
            (sums, count) = (Terms::default(), 0.0);
            if state.step.is_multiple_of(args.log_every * args.save_every) {
                figures(&trainer.judge(), dataset, &[Split::Val])?;
                trainer.state.save(state_path)?;
            }
        }
    }
    Ok(())
}

/// Figures of real motion by split, of the splits that have labels; printed as well.
fn figures(judge: &Judge, dataset: &Dataset, splits: &[Split]) -> anyhow::Result<Value> {
    let mut all = serde_json::Map::new();
    for split in splits.iter().filter(|split| !prompts(dataset, **split).is_empty()) {
        let report = real::measure(judge, dataset, *split)?;
        println!("{split}: {report}");
        all.insert(split.to_string(), json!(report));
    }
    Ok(Value::Object(all))
}

/// The state to go on from: a new one, or the stored one when it belongs to this dataset and configuration.
fn first_state(args: &Args, dataset: &Dataset, path: &Path) -> anyhow::Result<State> {
    let config = configuration(args)?;
    if !args.resume {
        return Ok(State::new(&config, &dataset.hash));
    }
    let state = State::load(path).context("the run cannot be resumed")?;
    let other = |what| Error::OtherRun { path: path.to_path_buf(), what };
    if state.config != config {
        return Err(other("configuration").into());
    }
    if state.data_hash != dataset.hash {
        return Err(other("dataset").into());
    }
    Ok(state)
}

fn configuration(args: &Args) -> anyhow::Result<Config> {
    let mut config = args.set.iter().try_fold(Config::default(), |config, change| changed(&config, change))?;
    config.seed = args.seed.unwrap_or(config.seed);
    config.steps = args.steps.unwrap_or(config.steps);
    config.check()?;
    Ok(config)
}
