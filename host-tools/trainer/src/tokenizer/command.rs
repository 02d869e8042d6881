//! `motionette-train tokenizer`: trains, resumes or measures a tokenizer.

use std::path::PathBuf;

use motionette_host::checkpoint::file_hash;
use motionette_host::console::{remark, say};
use motionette_host::dataset::Dataset;
use serde_json::json;

use super::checkpoint::Checkpoint;
use super::config::Config;
use super::state::State;
use super::training::{Trainer, measured};
use super::{kept, metrics};
use crate::harness::configuration::DatasetHash;
use crate::harness::options::{finish, with_default};
use crate::harness::{Length, Options, Run};

/// Trains a motion tokenizer on a dataset of `motionette import`, or measures one.
#[derive(clap::Args, Clone, Debug)]
#[command(mut_arg("out", |arg| with_default(arg, "data/train/nano.safetensors")))]
#[command(mut_arg("set", |arg| arg.help(SET)))]
pub struct Args {
    /// Files, settings and pace.
    #[command(flatten)]
    pub options: Options,
    /// The end of the run.
    #[command(flatten)]
    pub length: Length,
    /// Configuration to begin with: nano or tiny.
    #[arg(long, default_value = "nano")]
    pub preset: String,
    /// A tokenizer whose weights, codes and configuration the run begins with, instead of random ones.
    #[arg(long, value_name = "FILE", conflicts_with = "evaluate")]
    pub from: Option<PathBuf>,
    /// Measures this checkpoint on validation and test split and does not train.
    #[arg(long, value_name = "FILE")]
    pub evaluate: Option<PathBuf>,
}

const SET: &str = "Changes one setting, e.g. `architecture.encoder_width=192` or `loss.position=3`; may be repeated";

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or the run, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let options = &args.options;
    let dataset = Dataset::load(&options.data)?;
    if let Some(path) = &args.evaluate {
        let checkpoint = Checkpoint::load(path)?;
        let reports = metrics::evaluate(&checkpoint, &dataset, &measured(&dataset))?;
        say(metrics::table(&reports).trim_end());
        let kept = kept::kept(&checkpoint, &dataset, &measured(&dataset));
        if !kept.is_empty() {
            say(kept::table(&kept).trim_end());
        }
        let steps = checkpoint.steps;
        return finish(options.json, &json!({"checkpoint": path, "steps": steps, "reports": reports, "kept": kept}));
    }
    args.length.check()?;
    let from = args.from.as_deref().map(Checkpoint::load).transpose()?;
    let begin = match (&from, &args.from) {
        (Some(from), Some(path)) => Config { begun_with: Some(file_hash(path)?), ..from.config.clone() },
        _ => Config::preset(&args.preset)?,
    };
    let config = options.configured(begin)?;
    let sources = DatasetHash { data_hash: dataset.hash.clone() };
    let state = options.state(&config, &sources, || {
        Ok(match &from {
            Some(from) => State::after(&config, &dataset.hash, from)?,
            None => State::begin(&config, &dataset.hash),
        })
    })?;
    let trainer = Trainer::new(&config, &dataset)?;
    let corpus = trainer.corpus();
    let sizes = &config.architecture;
    let (frames, tokens) = (sizes.look_ahead_frames(), sizes.look_ahead_tokens());
    remark(&format!("the decoder looks ahead {frames} frames (tokens: {tokens})"));
    remark(&format!("{} motions with their mirrored twins, {} frames", corpus.motions(), corpus.frames()));
    let mut run = Run::new(trainer, state)?;
    let evaluation = run.train(options, args.length)?;
    finish(options.json, &run.facts(options, json!({"reports": evaluation.reports})))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::curves::{Evaluation, Point};
    use super::*;
    use crate::harness::Curves;
    use crate::testing;

    fn args(folder: &Path, more: &str) -> Args {
        let line = "--data @data.mds --out @out/tiny --preset tiny --set quantize_from=1 --seed 5 --log-every 2 --save-every 1";
        testing::args(folder, &format!("{line} --json {more}"))
    }

    const STEPS: &str = "--steps 6";

    #[test]
    fn trains_resumes_and_evaluates() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        testing::dataset(12, 40).save(folder.join("data.mds")).unwrap();
        run(&args(folder, STEPS)).unwrap();
        let out = folder.join("out/tiny.safetensors");
        let whole = Checkpoint::load(&out).unwrap();
        assert_eq!(whole.steps, 6);
        let curves = std::fs::read(out.with_extension("curves.json")).unwrap();
        let curves: Curves<Point, Evaluation> = serde_json::from_slice(&curves).unwrap();
        assert_eq!(curves.points.iter().map(|p| p.step).collect::<Vec<_>>(), [2, 4, 6]);
        assert!(out.with_extension("curves.svg").is_file());
        // A finished run that is resumed has nothing left to do.
        run(&args(folder, "--steps 6 --resume")).unwrap();
        assert_eq!(Checkpoint::load(&out).unwrap(), whole);
        run(&args(folder, "--evaluate @out/tiny.safetensors")).unwrap();
    }

    /// A run that begins with a checkpoint goes on from its weights and codes, and says with which.
    #[test]
    fn a_run_can_begin_with_a_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        testing::dataset(12, 40).save(folder.join("data.mds")).unwrap();
        run(&args(folder, STEPS)).unwrap();
        let first = Checkpoint::load(&folder.join("out/tiny.safetensors")).unwrap();
        let more = "--from @out/tiny.safetensors --out @out/second --set balance=0.5 --set learning_rate=1e-9";
        run(&args(folder, &format!("--steps 2 {more}"))).unwrap();
        let second = Checkpoint::load(&folder.join("out/second.safetensors")).unwrap();
        assert_eq!((second.steps, second.config.balance), (2, 0.5));
        let hash = file_hash(&folder.join("out/tiny.safetensors")).unwrap();
        assert_eq!(second.config.begun_with, Some(hash));
        let far = first.parameters.iter().zip(&second.parameters).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far < 1e-6 && first.parameters != second.parameters, "{far}");
        let moved = first.codebook.iter().zip(&second.codebook).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(moved < 0.5, "codes begin where they were: {moved}");
        run(&args(folder, &format!("--steps 2 {more} --resume"))).unwrap();
        let refused = |more: &str, what: &str| testing::assert_refused(run(&args(folder, more)), what);
        refused(&format!("--steps 2 {more} --set architecture.codes=9"), "the sizes of the checkpoint");
        refused("--steps 2 --from @out/absent.safetensors", "absent.safetensors");
        refused("--steps 2 --set balance=2", "balance is 2");
    }

    #[test]
    fn a_run_limited_by_the_clock_ends() {
        let folder = tempfile::tempdir().unwrap();
        testing::dataset(12, 40).save(folder.path().join("data.mds")).unwrap();
        let args = args(folder.path(), "--minutes 0.01");
        run(&args).unwrap();
        let state = State::load(&args.options.state_file()).unwrap();
        let plan = state.plan.unwrap();
        assert_eq!(state.step, plan.steps);
        assert!(plan.fall_from < plan.steps);
    }

    #[test]
    fn bad_input_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        assert!(run(&args(folder, STEPS)).unwrap_err().is::<motionette_host::dataset::Error>(), "no dataset");
        testing::dataset(12, 40).save(folder.join("data.mds")).unwrap();
        let refused = |more: &str, what: &str| testing::assert_refused(run(&args(folder, more)), what);
        refused("", "--minutes");
        refused("--minutes NaN", "--minutes");
        refused("--steps 6 --preset huge", "huge");
        refused("--steps 6 --set window", "FIELD=VALUE");
        refused("--steps 6 --set loss.charm=1", "loss.charm");
        refused("--steps 6 --set window=\"x\"", "does not fit");
        refused("--steps 6 --set window=6", "multiple of 4");
        refused("--steps 6 --set architecture.charm=1", "there is no setting architecture.charm");
        refused("--steps 6 --set architecture.right=[1]", "right is [1]");
        refused("--steps 6 --resume", "resumed");
        refused("--evaluate @data.mds", "offsets");
        refused("--steps 6 --out @data.mds/x.safetensors", "cannot be stored");
        refused("--steps 6 --set quantize_from=7", "give it more steps");
        run(&args(folder, STEPS)).unwrap();
        refused("--steps 6 --resume --seed 6", "configuration");
        testing::dataset(11, 40).save(folder.join("data.mds")).unwrap();
        refused("--steps 6 --resume", "dataset");
    }
}
