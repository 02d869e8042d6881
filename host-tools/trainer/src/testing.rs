//! What tests of trainings share: a small dataset, command lines, and the proof that a resumed run equals an uninterrupted one.

use std::path::Path;

use motionette_host::dataset::{Builder, Caption, Clip, Dataset, Facts, Quality, Side, Split};
use motionette_host::motion::Pose;
use motionette_host::motion::features::{self, process};
use motionette_host::motion::skeleton::{PARENTS, REST_DIRECTIONS};

use crate::harness::{EvaluationOf, Length, Options, Run, State, Training};
use crate::{prior, tokenizer};

/// Arguments from a command line in which `@` stands for a folder. Of an option that is given twice the second counts.
pub fn args<A: clap::Args>(folder: &Path, line: &str) -> A {
    let line = line.replace('@', &format!("{}/", folder.display()));
    let command = A::augment_args(clap::Command::new("test").no_binary_name(true).args_override_self(true));
    A::from_arg_matches(&command.try_get_matches_from(line.split_whitespace()).unwrap()).unwrap()
}

/// Checks that a command fails and that its error, with all causes, says `what`.
pub fn assert_refused(result: anyhow::Result<()>, what: &str) {
    let error = format!("{:#}", result.unwrap_err());
    assert!(error.contains(what), "{what}: {error}");
}

/// Slope of `value` along parameter `index`: the difference over `h` on either side.
pub fn slope(value: impl Fn(&[f32]) -> f64, parameters: &[f32], index: usize, h: f32) -> f64 {
    let at = |h: f32| {
        let mut moved = parameters.to_vec();
        moved[index] = parameters[index] + h;
        value(&moved)
    };
    (at(h) - at(-h)) / f64::from(2.0 * h)
}

/// A dataset `data.mds` and a tokenizer `tokenizer.safetensors` of a few steps.
pub fn prepare_tokenizer(folder: &Path) {
    dataset(12, 48).save(folder.join("data.mds")).unwrap();
    let line = "--data @data.mds --out @tokenizer --preset tiny --steps 30";
    tokenizer::command::run(&args(folder, line)).unwrap();
}

/// The same, and a prior `prior.safetensors` of them.
pub fn prepare_prior(folder: &Path) {
    prepare_prior_of(folder, "near");
}

/// The same of tokens that are corrupted like this.
pub fn prepare_prior_of(folder: &Path, corruption: &str) {
    prepare_tokenizer(folder);
    let line = "--data @data.mds --tokenizer @tokenizer.safetensors --out @prior --preset tiny --steps 20";
    prior::command::run(&args(folder, &format!("{line} --set corruption={corruption}"))).unwrap();
}

/// A training that fails before step `at`.
struct Interrupted<T> {
    training: T,
    at: u64,
}

/// Why an interrupted training fails.
#[derive(Debug, thiserror::Error)]
enum Stop<E> {
    #[error("interrupted")]
    Interrupted,
    #[error(transparent)]
    Training(E),
}

impl<T: Training> Training for Interrupted<T> {
    type Config = T::Config;
    type Step = T::Step;
    type Means = T::Means;
    type Error = Stop<T::Error>;

    fn decayed(&self) -> &[bool] {
        self.training.decayed()
    }

    fn step(&mut self, state: &mut State<T::Config>) -> Result<T::Step, Self::Error> {
        if state.step == self.at {
            return Err(Stop::Interrupted);
        }
        self.training.step(state).map_err(Stop::Training)
    }

    fn evaluate(&self, state: &State<T::Config>, finished: bool) -> Result<Option<EvaluationOf<T>>, Self::Error> {
        self.training.evaluate(state, finished).map_err(Stop::Training)
    }

    fn save(&self, state: &State<T::Config>, evaluation: &EvaluationOf<T>, path: &Path) -> Result<(), Self::Error> {
        self.training.save(state, evaluation, path).map_err(Stop::Training)
    }
}

/// A run of 12 steps gives the same files whether it is interrupted and resumed or not. `begin` makes a training and its first state.
pub fn assert_resumes<T: Training>(begin: impl Fn() -> Run<T>) {
    let folder = tempfile::tempdir().unwrap();
    let options = |name: &str| -> Options {
        args(folder.path(), &format!("--data @none --out @{name}/run --log-every 2 --save-every 2"))
    };
    let files = |name: &str| {
        let read = |extension: &str| std::fs::read(options(name).checkpoint().with_extension(extension)).ok();
        let mut state = State::<T::Config>::load(&options(name).state_file()).unwrap();
        state.seconds = 0.0;
        (["safetensors", "curves.json", "curves.svg"].map(read), state)
    };
    let length = Length { steps: Some(12), minutes: None };
    begin().train(&options("whole"), length).unwrap();
    let whole = files("whole");
    assert!(whole.0[0].is_some() && whole.1.step == 12);
    // Before anything was stored, between two stored states, and at the last steps.
    for (at, stored) in [(3, 0), (6, 4), (11, 8)] {
        let Run { training, state } = begin();
        let error =
            Run::new(Interrupted { training, at }, state).unwrap().train(&options("parts"), length).unwrap_err();
        assert_eq!(error.to_string(), "interrupted");
        let Run { training, state } = begin();
        let stopped = State::resume(&options("parts").state_file(), &state.config, &state.sources).unwrap();
        assert_eq!(stopped.step, stored);
        Run::new(training, stopped).unwrap().train(&options("parts"), length).unwrap();
        assert!(files("parts") == whole, "interrupted before step {at}");
    }
}

/// `clips` clips of up to `frames` frames, lengths differ. Of six clips in a row the fifth is for validation, the sixth for test.
pub fn dataset(clips: usize, frames: usize) -> Dataset {
    let mut builder = Builder::new();
    for index in 0..clips {
        let split = match index % 6 {
            4 => Split::Val,
            5 => Split::Test,
            _ => Split::Train,
        };
        let length = frames - (index * frames / (2 * clips.max(1)));
        let motion: Vec<Pose> = (0..=length).map(|t| pose(index as f32, t as f32 / 20.0)).collect();
        let processed = process(&motion, &features::Options::default()).expect("the figure is a motion");
        let clip = Clip {
            id: format!("figure{index}"),
            split,
            subset: "figure".into(),
            source: "test".into(),
            fps_source: 20.0,
            captions: vec![Caption {
                text: format!("a figure walks {}.", ["slowly", "and turns left", "with its right arm"][index % 3]),
                from: 0.0,
                to: 0.0,
                source: "test".into(),
            }],
            labels: serde_json::Value::Null,
            facts: None,
            hash: String::new(),
        };
        builder.push(clip, &processed.joints, &processed.features).expect("the figure is finite");
    }
    builder.finish()
}

/// The same dataset with clips that a Kinect recorded.
pub fn kinect(dataset: &Dataset, ids: &[&str]) -> Dataset {
    let quality = |info: &Clip| if ids.contains(&info.id.as_str()) { Quality::Kinect } else { Quality::Optical };
    with_facts(dataset, |info| Facts { quality: quality(info), ..facts() })
}

/// Facts of a clip of somebody who walks.
pub fn facts() -> Facts {
    Facts {
        action: "walk".into(),
        side: Side::None,
        style: None,
        scored: true,
        quality: Quality::Optical,
        own_legs: false,
        licence: "none".into(),
        actor: None,
        known_actor: true,
    }
}

/// The same dataset with facts of every clip.
pub fn with_facts(dataset: &Dataset, facts: impl Fn(&Clip) -> Facts) -> Dataset {
    let mut builder = Builder::new();
    for clip in dataset.iter() {
        let info = Clip { facts: Some(facts(clip.info)), ..clip.info.clone() };
        builder.push(info, clip.joints, clip.features).expect("the clip was in a dataset");
    }
    builder.finish()
}

fn pose(style: f32, seconds: f32) -> Pose {
    let phase = 6.0 * seconds + style;
    let mut pose = [[0.0f32; 3]; 22];
    let heading = 0.3 * (1.0 + style) * seconds;
    let speed = 0.6 + 0.1 * style;
    let (sin, cos) = heading.sin_cos();
    for joint in 1..22 {
        let parent = PARENTS[joint];
        let swing = match joint {
            4 | 7 | 10 => 0.5 * phase.sin(),
            5 | 8 | 11 => -0.5 * phase.sin(),
            18 | 20 => -0.7 * phase.sin(),
            19 | 21 => 0.7 * phase.sin(),
            _ => 0.05 * (phase + joint as f32).sin(),
        };
        let d = REST_DIRECTIONS[joint].map(|x| x as f32);
        let (s, c) = swing.sin_cos();
        let tilted = [d[0], c * d[1] - s * d[2], s * d[1] + c * d[2]];
        let bone = if joint == 1 || joint == 2 { 0.1 } else { 0.25 };
        let turned = [cos * tilted[0] + sin * tilted[2], tilted[1], cos * tilted[2] - sin * tilted[0]];
        for i in 0..3 {
            pose[joint][i] = pose[parent][i] + bone * turned[i];
        }
    }
    let root = [speed * seconds * heading.sin(), 0.9 + 0.02 * (2.0 * phase).sin(), speed * seconds * heading.cos()];
    pose.map(|joint| std::array::from_fn(|i| joint[i] + root[i]))
}
