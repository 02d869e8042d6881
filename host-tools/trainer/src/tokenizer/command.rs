//! `motionette-train tokenizer`: trains, resumes or measures a tokenizer.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use motionette_host::dataset::{Dataset, Split};
use serde_json::json;

use super::Error;
use super::checkpoint::Checkpoint;
use super::config::Config;
use super::curves::{Evaluation, Point};
use super::loss::Terms;
use super::metrics::{self, Report};
use super::quantizer::Usage;
use super::state::State;
use super::training::{Step, Trainer};
use crate::run::{changed, finish, with_suffix};
use crate::schedule::Plan;

/// Trains a motion tokenizer on a dataset of `motionette import`, or measures one.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Dataset file.
    #[arg(long, value_name = "FILE")]
    pub data: PathBuf,
    /// Where the checkpoint goes, with or without `.safetensors`; state and curves go beside it.
    #[arg(short, long, value_name = "FILE", default_value = "data/train/nano.safetensors")]
    pub out: PathBuf,
    /// Configuration to begin with: nano or tiny.
    #[arg(long, default_value = "nano")]
    pub preset: String,
    /// Changes one setting, e.g. `architecture.encoder_width=192` or `loss.position=3`; may be repeated.
    #[arg(long, value_name = "FIELD=VALUE")]
    pub set: Vec<String>,
    /// Seed of weights, batches and code resets.
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
        let checkpoint = Checkpoint::load(path)?;
        let reports = metrics::evaluate(&checkpoint, &dataset, &measured(&dataset))?;
        print!("{}", metrics::table(&reports));
        return finish(args.json, &json!({"checkpoint": path, "steps": checkpoint.steps, "reports": reports}));
    }
    let (steps, minutes) = (args.steps, args.minutes);
    if steps.is_none() && !minutes.is_some_and(|m| m.is_finite() && m > 0.0) {
        return Err(Error::NoEnd.into());
    }
    let args = &Args { out: with_suffix(&args.out), ..args.clone() };
    let state_path = args.out.with_extension("state.safetensors");
    let state = first_state(args, &dataset, &state_path)?;
    let mut trainer = Trainer::new(state, &dataset)?;
    if let Some(steps) = steps {
        trainer.state.plan = Some(Plan::of_steps(steps, trainer.state.config.decay));
    }
    let corpus = trainer.corpus();
    eprintln!("{} motions with their mirrored twins, {} frames", corpus.motions(), corpus.frames());
    // A path that cannot be written should fail now and not after an hour.
    trainer.state.save(&state_path).context("the state of the run cannot be stored")?;
    train(args, &mut trainer, &dataset, &state_path)?;
    let checkpoint = trainer.checkpoint().context("the run ended before quantisation began; give it more steps")?;
    let reports = metrics::evaluate(&checkpoint, &dataset, &measured(&dataset))?;
    keep(args, &mut trainer, &checkpoint, reports.clone(), &state_path)?;
    print!("{}", metrics::table(&reports));
    let facts = json!({
        "checkpoint": args.out,
        "state": state_path,
        "steps": checkpoint.steps,
        "seconds": trainer.state.seconds,
        "reports": reports,
    });
    finish(args.json, &facts)
}

/// Validation and test split where the dataset has them.
fn measured(dataset: &Dataset) -> Vec<Split> {
    let has = |split: &Split| dataset.split(*split).next().is_some();
    [Split::Val, Split::Test].into_iter().filter(has).collect()
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
    let mut config = Config::preset(&args.preset)?;
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    let config = args.set.iter().try_fold(config, |config, change| changed(&config, change))?;
    config.check()?;
    Ok(config)
}

/// Steps until the end of the plan, with points, checkpoints and progress on the way.
fn train(args: &Args, trainer: &mut Trainer, dataset: &Dataset, state_path: &Path) -> anyhow::Result<()> {
    let progress = Progress::new();
    let mut clock = Instant::now();
    let mut recorder = Recorder::default();
    loop {
        let state = &mut trainer.state;
        let limit = args.minutes.unwrap_or(f64::INFINITY) * 60.0;
        if state.plan.is_none() && state.seconds >= limit * (1.0 - state.config.decay) {
            state.plan = Some(Plan::falling_from(state.step, state.config.decay));
        }
        if state.plan.is_some_and(|plan| state.step >= plan.steps) {
            break;
        }
        let step = trainer.step()?;
        let state = &mut trainer.state;
        state.seconds += clock.elapsed().as_secs_f64();
        clock = Instant::now();
        recorder.add(&step);
        progress.show(state, limit);
        if state.step.is_multiple_of(args.log_every) {
            let point = recorder.point(state);
            progress.log(&point, state);
            state.curves.points.push(point);
            if state.step.is_multiple_of(args.log_every * args.save_every) {
                save(args, trainer, dataset, state_path, &progress)?;
            }
        }
    }
    progress.finish();
    Ok(())
}

/// Stores the state, and once there are codes a checkpoint with its figures on the validation split.
fn save(
    args: &Args,
    trainer: &mut Trainer,
    dataset: &Dataset,
    state_path: &Path,
    progress: &Progress,
) -> anyhow::Result<()> {
    let Some(checkpoint) = trainer.checkpoint() else {
        return Ok(trainer.state.save(state_path)?);
    };
    let splits: Vec<Split> = measured(dataset).into_iter().take(1).collect();
    let reports = metrics::evaluate(&checkpoint, dataset, &splits)?;
    progress.line(metrics::table(&reports).trim_end());
    keep(args, trainer, &checkpoint, reports, state_path)
}

fn keep(
    args: &Args,
    trainer: &mut Trainer,
    checkpoint: &Checkpoint,
    reports: Vec<Report>,
    state_path: &Path,
) -> anyhow::Result<()> {
    checkpoint.save(&args.out, &reports)?;
    let state = &mut trainer.state;
    state.curves.evaluations.retain(|evaluation| evaluation.step < checkpoint.steps);
    state.curves.evaluations.push(Evaluation { step: checkpoint.steps, reports });
    state.save(state_path)?;
    state.curves.save(&args.out)?;
    Ok(())
}

/// Means between two points of the curves.
#[derive(Default)]
struct Recorder {
    steps: f32,
    terms: Terms,
    commitment: f32,
    gradient_norm: f32,
    rate: f32,
    moved: usize,
    counts: Vec<u64>,
}

impl Recorder {
    fn add(&mut self, step: &Step) {
        self.steps += 1.0;
        let (sum, terms) = (&mut self.terms, &step.terms);
        sum.features += terms.features;
        sum.position += terms.position;
        sum.velocity += terms.velocity;
        sum.root += terms.root;
        sum.heading += terms.heading;
        sum.total += terms.total;
        self.commitment += step.commitment;
        self.gradient_norm += step.gradient_norm;
        self.rate = step.rate;
        self.moved += step.moved;
        for id in &step.ids {
            let id = usize::from(*id);
            if id >= self.counts.len() {
                self.counts.resize(id + 1, 0);
            }
            self.counts[id] += 1;
        }
    }

    /// The point, and a fresh start.
    fn point(&mut self, state: &State) -> Point {
        let sums = std::mem::take(self);
        let n = sums.steps.max(1.0);
        let terms = Terms {
            features: sums.terms.features / n,
            position: sums.terms.position / n,
            velocity: sums.terms.velocity / n,
            root: sums.terms.root / n,
            heading: sums.terms.heading / n,
            total: sums.terms.total / n,
        };
        Point {
            step: state.step,
            rate: sums.rate,
            terms,
            commitment: sums.commitment / n,
            perplexity: Usage::of(&sums.counts).perplexity,
            moved: sums.moved,
            gradient_norm: sums.gradient_norm / n,
        }
    }
}

/// A bar on a terminal, log lines elsewhere.
struct Progress {
    bar: Option<ProgressBar>,
}

impl Progress {
    fn new() -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(0);
            let style = ProgressStyle::with_template("{bar:30} {pos}/{len} steps, {per_sec}, {eta} left {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar
        });
        Self { bar }
    }

    fn show(&self, state: &State, limit: f64) {
        let Some(bar) = &self.bar else { return };
        let by_clock = || (state.step as f64 * limit / state.seconds.max(1e-9)) as u64;
        bar.set_length(state.plan.map_or_else(by_clock, |plan| plan.steps));
        bar.set_position(state.step);
    }

    fn log(&self, point: &Point, state: &State) {
        let text = format!(
            "step {:>6} {:>6.0} s rate {:.1e} loss {:.4} features {:.4} position {:.1} mm root {:.0} mm heading {:.3} \
             commitment {:.4} perplexity {:.0} moved {} norm {:.2}",
            point.step,
            state.seconds,
            point.rate,
            point.terms.total,
            point.terms.features,
            1e3 * point.terms.position,
            1e3 * point.terms.root,
            point.terms.heading,
            point.commitment,
            point.perplexity,
            point.moved,
            point.gradient_norm,
        );
        match &self.bar {
            Some(bar) => bar.set_message(format!("loss {:.4}", point.terms.total)),
            None => eprintln!("{text}"),
        }
    }

    fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None => eprintln!("{text}"),
        }
    }

    fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    fn args(folder: &Path) -> Args {
        Args {
            data: folder.join("data.mds"),
            out: folder.join("out/tiny"),
            preset: "tiny".into(),
            set: vec!["quantize_from=1".into()],
            seed: Some(5),
            steps: Some(6),
            minutes: None,
            resume: false,
            log_every: 2,
            save_every: 1,
            evaluate: None,
            json: true,
        }
    }

    #[test]
    fn trains_resumes_and_evaluates() {
        let folder = tempfile::tempdir().unwrap();
        let mut args = args(folder.path());
        testing::dataset(12, 40).save(&args.data).unwrap();
        run(&args).unwrap();
        let out = folder.path().join("out/tiny.safetensors");
        let whole = Checkpoint::load(&out).unwrap();
        assert_eq!(whole.steps, 6);
        let curves = std::fs::read(out.with_extension("curves.json")).unwrap();
        let curves: super::super::curves::Curves = serde_json::from_slice(&curves).unwrap();
        assert_eq!(curves.points.iter().map(|p| p.step).collect::<Vec<_>>(), [2, 4, 6]);
        assert!(out.with_extension("curves.svg").is_file());
        // A finished run that is resumed has nothing left to do.
        args.resume = true;
        run(&args).unwrap();
        assert_eq!(Checkpoint::load(&out).unwrap(), whole);
        run(&Args { evaluate: Some(out), ..args }).unwrap();
    }

    #[test]
    fn a_run_limited_by_the_clock_ends() {
        let folder = tempfile::tempdir().unwrap();
        let args = Args { steps: None, minutes: Some(0.01), ..args(folder.path()) };
        testing::dataset(12, 40).save(&args.data).unwrap();
        run(&args).unwrap();
        let state = State::load(&args.out.with_extension("state.safetensors")).unwrap();
        let plan = state.plan.unwrap();
        assert_eq!(state.step, plan.steps);
        assert!(plan.fall_from < plan.steps);
    }

    #[test]
    fn bad_input_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let good = || args(folder.path());
        assert!(run(&good()).unwrap_err().is::<motionette_host::dataset::Error>(), "no dataset");
        testing::dataset(12, 40).save(good().data).unwrap();
        let refused = |args: Args, what: &str| {
            let error = format!("{:#}", run(&args).unwrap_err());
            assert!(error.contains(what), "{what}: {error}");
        };
        refused(Args { steps: None, ..good() }, "--minutes");
        refused(Args { steps: None, minutes: Some(f64::NAN), ..good() }, "--minutes");
        refused(Args { preset: "huge".into(), ..good() }, "huge");
        refused(Args { set: vec!["window".into()], ..good() }, "FIELD=VALUE");
        refused(Args { set: vec!["loss.charm=1".into()], ..good() }, "loss.charm");
        refused(Args { set: vec!["window=\"x\"".into()], ..good() }, "does not fit");
        refused(Args { set: vec!["window=6".into()], ..good() }, "multiple of 4");
        refused(Args { resume: true, ..good() }, "resumed");
        refused(Args { evaluate: Some(good().data), ..good() }, "offsets");
        refused(Args { out: folder.path().join("data.mds/x.safetensors"), ..good() }, "cannot be stored");
        run(&good()).unwrap();
        refused(Args { resume: true, seed: Some(6), ..good() }, "configuration");
        testing::dataset(11, 40).save(good().data).unwrap();
        refused(Args { resume: true, ..good() }, "dataset");
    }
}
