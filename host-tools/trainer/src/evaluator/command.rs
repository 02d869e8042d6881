//! `motionette-train evaluator`: trains, resumes or measures an evaluator.

use std::path::{Path, PathBuf};

use motionette_host::console::{remark, say};
use motionette_host::dataset::{Dataset, Split};
use motionette_host::import::actions::Actions;
use serde_json::{Map, json};

use super::check;
use super::config::Config;
use super::judge::Judge;
use super::training::{Trainer, figures};
use crate::evaluate::codec::Codec;
use crate::evaluate::prompts::trust;
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
    /// Length of the run; the configuration's 3600 where it is not given.
    #[arg(long)]
    pub steps: Option<u64>,
    /// Measures this checkpoint on validation and test split and does not train.
    #[arg(long, value_name = "FILE")]
    pub evaluate: Option<PathBuf>,
    /// With --evaluate: the table of actions, to say which actions the checkpoint may judge.
    #[arg(long, value_name = "FILE", requires = "evaluate")]
    pub actions: Option<PathBuf>,
    /// With --evaluate: a tokenizer, to judge real motion through it as well.
    #[arg(long, value_name = "FILE", requires = "evaluate")]
    pub tokenizer: Option<PathBuf>,
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
        return measure(args, path, &dataset);
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

/// Says how a checkpoint fares on real motion.
fn measure(args: &Args, checkpoint: &Path, dataset: &Dataset) -> anyhow::Result<()> {
    let judge = Judge::load(checkpoint)?;
    let metrics = figures(&judge, dataset, &[Split::Val, Split::Test])?;
    say(&metrics.to_string());
    let codec = args.tokenizer.as_deref().map(Codec::load).transpose()?;
    let mut legs = Map::new();
    for split in [Split::Val, Split::Test] {
        if let Some(report) = check::measure(&judge, dataset, split, codec.as_ref())? {
            say(&format!("{split}: {report}"));
            legs.insert(split.to_string(), json!(report));
        }
    }
    let mut actions = Vec::new();
    if let Some(path) = &args.actions {
        let accuracies = trust::accuracies(&judge, dataset, &Actions::read(path)?)?;
        let trusted = accuracies.values().filter(|accuracy| accuracy.trusted()).count();
        say(&format!("test: {trusted} of {} actions may be judged; the others:", accuracies.len()));
        for (name, accuracy) in &accuracies {
            if !accuracy.trusted() {
                say(&format!("{name} {:.2} of {} clips", accuracy.share(), accuracy.clips));
            }
            let (clips, share, judges) = (accuracy.clips, accuracy.share(), accuracy.trusted());
            actions.push(json!({"name": name, "clips": clips, "accuracy": share, "judges": judges}));
        }
    }
    let facts =
        json!({"checkpoint": checkpoint, "steps": judge.steps(), "metrics": metrics, "legs": legs, "actions": actions});
    finish(args.options.json, &facts)
}
