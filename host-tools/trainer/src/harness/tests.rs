//! The smallest training: a line `y = slope x + offset` through points with noise. It shows what a new training has to bring, and
//! that everything else comes from the harness.

use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::configuration::DatasetHash;
use super::{Configuration, Curves, Error, Evaluation, Figures, Length, Means, Options, Run, State, Training, Update};
use crate::chart::Panel;
use crate::random::Random;
use crate::setting::{OutOfRange, require};
use crate::tensor_file::{self, Format};
use crate::{optimizer, schedule, testing};

const CHECKPOINT: Format = Format { name: "line", version: "1" };

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    seed: u64,
    batch: usize,
    schedule: schedule::Settings,
}

impl Configuration for Config {
    const STATE: Format = Format { name: "line-state", version: "1" };
    type Sources = DatasetHash;
    type Extra = ();
    type Point = Point;
    type Evaluation = Evaluation<Report>;

    fn check(&self) -> Result<(), OutOfRange> {
        require(self.batch > 0, "batch", self.batch, "1 or more")
    }

    fn schedule(&self) -> schedule::Settings {
        self.schedule
    }

    fn optimizer(&self) -> optimizer::Settings {
        optimizer::Settings::new(0.0, 1.0, 0.9)
    }

    fn panels(curves: &Curves<Point, Evaluation<Report>>) -> Vec<Panel> {
        let error = curves.evaluation_line("slope", |evaluation| Some(evaluation.report.error));
        vec![Panel { title: "squared error", lines: vec![curves.line("training", |point| point.loss), error] }]
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Point {
    step: u64,
    loss: f64,
}

impl Figures for Point {
    fn step(&self) -> u64 {
        self.step
    }
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "loss {:.4}", self.loss)
    }
}

/// How far the averaged slope is from the true one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Report {
    error: f64,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "slope is {:.3} off", self.error)
    }
}

struct Step {
    loss: f64,
    update: Update,
}

#[derive(Default)]
struct Sums {
    steps: f64,
    loss: f64,
}

impl Means<Step, Point> for Sums {
    fn add(&mut self, step: &Step) {
        assert!(step.update.rate > 0.0);
        self.steps += 1.0;
        self.loss += step.loss;
    }

    fn point(&self, step: u64) -> Point {
        Point { step, loss: self.loss / self.steps }
    }
}

/// Slope and offset of the points.
struct Line {
    slope: f32,
    offset: f32,
}

impl Training for Line {
    type Config = Config;
    type Step = Step;
    type Means = Sums;
    type Error = Error;

    fn decayed(&self) -> &[bool] {
        &[true, false]
    }

    fn step(&mut self, state: &mut State<Config>) -> Result<Step, Error> {
        let mut random = Random::new(state.config.seed, state.step);
        let [slope, offset] = [state.optimizer.values[0], state.optimizer.values[1]];
        let (mut loss, mut gradient) = (0.0, [0.0; 2]);
        for _ in 0..state.config.batch {
            let (x, noise) = (random.symmetric() as f32, 0.01 * random.normal() as f32);
            let error = slope * x + offset - (self.slope * x + self.offset + noise);
            loss += f64::from(error * error) / state.config.batch as f64;
            gradient[0] += 2.0 * error * x;
            gradient[1] += 2.0 * error;
        }
        state.check_finite(loss)?;
        let update = state.update(&gradient, self.decayed())?;
        Ok(Step { loss, update })
    }

    fn evaluate(&self, state: &State<Config>, _finished: bool) -> Result<Option<Evaluation<Report>>, Error> {
        let error = f64::from((state.optimizer.average[0] - self.slope).abs());
        Ok(Some(Evaluation { step: state.step, report: Report { error } }))
    }

    fn save(&self, state: &State<Config>, _evaluation: &Evaluation<Report>, path: &Path) -> Result<(), Error> {
        let mut file = CHECKPOINT.file();
        file.insert("line", &[2], state.optimizer.average.clone());
        Ok(file.save(path)?)
    }
}

fn begin() -> Run<Line> {
    let schedule = schedule::Settings { learning_rate: 0.1, warm_up: 2, decay: 0.5, final_rate: 0.01 };
    let config = Config { seed: 3, batch: 8, schedule };
    let sources = DatasetHash { data_hash: "points".into() };
    Run::new(Line { slope: 0.75, offset: -0.5 }, State::new(config, sources, vec![0.0; 2], ())).unwrap()
}

fn options(folder: &Path, more: &str) -> Options {
    testing::args(folder, &format!("--data @none --out @line --log-every 50 --save-every 2 {more}"))
}

#[test]
fn a_line_is_found_and_stored_with_its_curves() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path(), "");
    let mut run = begin();
    let evaluation = run.train(&options, Length { steps: Some(300), minutes: None }).unwrap();
    assert!(evaluation.step == 300 && evaluation.report.error < 0.02, "{evaluation:?}");
    let file = CHECKPOINT.load(&options.checkpoint()).unwrap();
    let line = file.values("line", &[2]).unwrap();
    assert!((line[0] - 0.75).abs() < 0.02 && (line[1] + 0.5).abs() < 0.02, "{line:?}");
    let curves: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("line.curves.json")).unwrap()).unwrap();
    let steps = |list: &str, step: &str| -> Vec<u64> {
        curves[list].as_array().unwrap().iter().map(|entry| entry.pointer(step).unwrap().as_u64().unwrap()).collect()
    };
    assert_eq!(steps("points", "/step"), [50, 100, 150, 200, 250, 300]);
    assert_eq!(steps("evaluations", "/0"), [100, 200, 300]);
    let svg = std::fs::read_to_string(folder.path().join("line.curves.svg")).unwrap();
    assert_eq!(svg.matches("<polyline").count(), 2);
    assert_eq!(State::<Config>::load(&options.state_file()).unwrap(), run.state);
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    testing::assert_resumes(begin);
}

/// The clock decides where the fall begins; a run that knows that number of steps from the start gives the same weights.
#[test]
fn a_run_that_the_clock_ends_equals_one_of_as_many_steps() {
    let folder = tempfile::tempdir().unwrap();
    let mut by_clock = begin();
    by_clock.train(&options(folder.path(), ""), Length { steps: None, minutes: Some(0.0005) }).unwrap();
    let (steps, seconds) = (by_clock.state.step, by_clock.state.seconds);
    assert!(steps > 0 && seconds >= 0.5 * 0.0005 * 60.0, "{steps} steps in {seconds} s");
    let mut by_steps = begin();
    by_steps.train(&options(folder.path(), ""), Length { steps: Some(steps), minutes: None }).unwrap();
    assert_eq!(by_clock.state.optimizer, by_steps.state.optimizer);
    assert_eq!(by_clock.state.plan, by_steps.state.plan);
}

#[test]
fn a_state_is_taken_only_where_it_belongs() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path(), "--resume");
    let Run { state, .. } = begin();
    let resumed = |config: &Config, sources: &DatasetHash| {
        options.state(config, sources, || panic!("the stored state is asked for")).map_err(|error| format!("{error:#}"))
    };
    assert!(resumed(&state.config, &state.sources).unwrap_err().contains("cannot read"));
    state.save(&options.state_file()).unwrap();
    assert_eq!(resumed(&state.config, &state.sources).unwrap(), state);
    let seed = Config { seed: 4, ..state.config.clone() };
    assert!(resumed(&seed, &state.sources).unwrap_err().contains("another configuration"));
    let data = DatasetHash { data_hash: "other".into() };
    assert!(resumed(&state.config, &data).unwrap_err().contains("another dataset"));
    let longer = State { optimizer: optimizer::AdamW::new(vec![0.0; 3]), ..state };
    let error = Run::new(Line { slope: 0.0, offset: 0.0 }, longer).err().unwrap();
    assert!(matches!(error, Error::Parameters { found: 3, expected: 2 }), "{error}");
}

/// Every entry and tensor of a state is needed, but plan and curves: the evaluator's states had none at first.
#[test]
fn a_state_that_lacks_something_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.state.safetensors");
    let Run { state, .. } = begin();
    state.save(&path).unwrap();
    let whole = tensor_file::TensorFile::load(&path).unwrap();
    for name in whole.tensors.keys() {
        let mut part = whole.clone();
        part.tensors.remove(name);
        part.save(&path).unwrap();
        let error = State::<Config>::load(&path).unwrap_err().to_string();
        assert!(error.contains("optimizer."), "{name}: {error}");
    }
    let run: serde_json::Map<String, serde_json::Value> = whole.parsed("run").unwrap();
    for entry in ["config", "data_hash", "step", "seconds", "updates"] {
        let mut part = whole.clone();
        let mut run = run.clone();
        run.remove(entry).unwrap();
        part.describe("run", serde_json::Value::Object(run).to_string());
        part.save(&path).unwrap();
        let error = State::<Config>::load(&path).unwrap_err().to_string();
        assert!(error.contains(entry), "{entry}: {error}");
    }
    let mut first = whole.clone();
    let mut run = run.clone();
    run.remove("plan").unwrap();
    first.describe("run", serde_json::Value::Object(run).to_string());
    first.metadata.remove("curves").unwrap();
    first.save(&path).unwrap();
    assert_eq!(State::<Config>::load(&path).unwrap(), state);
}

#[test]
fn options_name_files_and_change_settings() {
    let folder = tempfile::tempdir().unwrap();
    let Run { state, .. } = begin();
    let configured = |more: &str| {
        options(folder.path(), more).configured(state.config.clone()).map_err(|error| format!("{error:#}"))
    };
    assert_eq!(options(folder.path(), "").checkpoint(), folder.path().join("line.safetensors"));
    let named = options(folder.path(), "--out @nano.line.safetensors");
    assert_eq!(named.checkpoint(), folder.path().join("nano.line.safetensors"));
    assert_eq!(named.state_file(), folder.path().join("nano.line.state.safetensors"));
    let changed = configured("--seed 9 --set batch=2 --set schedule.warm_up=7").unwrap();
    assert_eq!((changed.seed, changed.batch, changed.schedule.warm_up), (9, 2, 7));
    for (more, what) in [
        ("--set batch", "FIELD=VALUE"),
        ("--set schedule.charm=1", "there is no setting schedule.charm"),
        ("--set batch=x", "does not fit"),
        ("--set batch=-1", "does not fit"),
        ("--set batch=0", "batch is 0"),
        ("--set schedule.learning_rate=0", "learning_rate"),
        ("--set schedule.decay=2", "decay"),
    ] {
        let error = configured(more).unwrap_err();
        assert!(error.contains(what), "{more}: {error}");
    }
    let lengths = [(None, None), (None, Some(0.0)), (None, Some(f64::NAN)), (None, Some(f64::INFINITY))];
    for (steps, minutes) in lengths {
        assert!(matches!(Length { steps, minutes }.check(), Err(Error::NoEnd)));
    }
}

#[test]
fn a_run_that_diverges_stops_and_its_state_stays() {
    let mut run = begin();
    run.state.optimizer.values[0] = 1e30;
    let before = run.state.clone();
    assert!(matches!(run.step(), Err(Error::Diverged { step: 0 })));
    assert_eq!(run.state, before);
}
