//! `motionette-train evaluator`: trains, resumes or measures an evaluator.

use std::path::PathBuf;

use motionette_host::console::{remark, say};
use motionette_host::dataset::{Dataset, Split};
use serde_json::json;

use super::config::Config;
use super::judge::Judge;
use super::training::{Trainer, figures};
use crate::harness::configuration::DatasetHash;
use crate::harness::options::{finish, with_default};
use crate::harness::{Length, Options, Run};

/// Trains the judge of generated motion on the training split, or measures one.
#[derive(clap::Args, Clone, Debug)]
#[command(mut_arg("out", |arg| with_default(arg, "models/evaluator.safetensors")))]
#[command(mut_arg("set", |arg| arg.help(SET)))]
#[command(mut_arg("save_every", |arg| arg.default_value("5")))]
pub struct Args {
    /// Files, settings and pace.
    #[command(flatten)]
    pub options: Options,
    /// Length of the run; the configuration's 1500 where it is not given.
    #[arg(long)]
    pub steps: Option<u64>,
    /// Measures this checkpoint on validation and test split and does not train.
    #[arg(long, value_name = "FILE")]
    pub evaluate: Option<PathBuf>,
}

const SET: &str = "Changes one setting, e.g. `width=192` or `schedule.warm_up=50`; may be repeated";

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or the run, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let options = &args.options;
    let dataset = Dataset::load(&options.data)?;
    if let Some(path) = &args.evaluate {
        let judge = Judge::load(path)?;
        let metrics = figures(&judge, &dataset, &[Split::Val, Split::Test])?;
        say(&metrics.to_string());
        return finish(options.json, &json!({"checkpoint": path, "steps": judge.steps(), "metrics": metrics}));
    }
    let config = Config::default();
    let config = options.configured(Config { steps: args.steps.unwrap_or(config.steps), ..config })?;
    let trainer = Trainer::new(&config, &dataset)?;
    remark(&format!("{} motions with their mirrored twins", trainer.corpus().motions()));
    let sources = DatasetHash { data_hash: dataset.hash.clone() };
    let state = options.state(&config, &sources, || Ok(trainer.begin(&config)))?;
    let length = Length { steps: Some(config.steps), minutes: None };
    let mut run = Run::new(trainer, state)?;
    let evaluation = run.train(options, length)?;
    finish(options.json, &run.facts(options, json!({"metrics": evaluation.report})))
}
