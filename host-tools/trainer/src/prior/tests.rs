//! Runs of the tiny prior: they learn, resume bit for bit, and refuse what does not fit.

use std::path::Path;

use super::checkpoint;
use super::command::{Args, run};
use super::state::State;
use crate::tensor_file::TensorFile;
use crate::{testing, tokenizer};

fn args(folder: &Path) -> Args {
    Args {
        data: folder.join("data.mds"),
        tokenizer: folder.join("tokenizer.safetensors"),
        out: folder.join("prior.safetensors"),
        preset: "tiny".into(),
        set: vec!["schedule.learning_rate=0.005".into(), "schedule.warm_up=3".into(), "average_decay=0.9".into()],
        seed: None,
        steps: Some(12),
        minutes: None,
        resume: false,
        log_every: 4,
        save_every: 1,
        json: false,
    }
}

/// A dataset and a tokenizer of it.
fn prepare(folder: &Path) {
    let good = args(folder);
    testing::dataset(12, 48).save(&good.data).unwrap();
    let tokenizer = tokenizer::command::Args {
        data: good.data,
        out: good.tokenizer,
        preset: "tiny".into(),
        set: Vec::new(),
        seed: None,
        steps: Some(30),
        minutes: None,
        resume: false,
        log_every: 100,
        save_every: 1,
        evaluate: None,
        json: false,
    };
    tokenizer::command::run(&tokenizer).unwrap();
}

#[test]
fn a_run_learns_its_motions() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let args = Args { steps: Some(250), log_every: 10, save_every: 100, ..args(folder.path()) };
    run(&args).unwrap();
    let state = State::load(&args.out.with_extension("state.safetensors")).unwrap();
    let points = &state.curves.points;
    let (early, late) = (points[0].loss, points[points.len() - 1].loss);
    assert!(late < 0.8 * early, "cross-entropy {early} -> {late}");
    let (_, report) = state.curves.evaluations.last().unwrap();
    assert!(report.motions == 2 && report.accuracy[3] > report.accuracy[0], "{report:?}");
    let file = TensorFile::load(&args.out).unwrap();
    file.expect("format", checkpoint::FORMAT).unwrap();
    for (parameter, average) in state.layout().split(&state.optimizer.average) {
        assert_eq!(file.values(&parameter.name, &parameter.shape()).unwrap(), average, "{}", parameter.name);
    }
    let facts: serde_json::Value = file.parsed("config").unwrap();
    assert_eq!(facts["vocabulary"][0], "<none>");
    assert!(args.out.with_extension("curves.svg").is_file());
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let whole = args(folder.path());
    run(&whole).unwrap();
    let path = whole.out.with_extension("state.safetensors");
    let mut uninterrupted = State::load(&path).unwrap();
    // The clock decides where the fall begins, so the first part has to know the whole length: it is stopped by hand.
    let first = Args { steps: Some(12), out: folder.path().join("parts.safetensors"), ..whole.clone() };
    run(&first).unwrap();
    let path = first.out.with_extension("state.safetensors");
    let mut stopped = State::load(&path).unwrap();
    assert_eq!(stopped.optimizer, uninterrupted.optimizer, "equal runs give equal weights");
    let fresh = State::new(&stopped.config, stopped.sources.clone());
    stopped = State { plan: stopped.plan, ..fresh };
    stopped.save(&path).unwrap();
    run(&Args { resume: true, ..first }).unwrap();
    let mut resumed = State::load(&path).unwrap();
    (resumed.seconds, uninterrupted.seconds) = (0.0, 0.0);
    assert_eq!(resumed, uninterrupted);
}

#[test]
fn bad_input_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let good = || args(folder.path());
    assert!(run(&good()).unwrap_err().is::<motionette_host::dataset::Error>(), "no dataset");
    prepare(folder.path());
    let refused = |args: Args, what: &str| {
        let error = format!("{:#}", run(&args).unwrap_err());
        assert!(error.contains(what), "{what}: {error}");
    };
    refused(Args { steps: None, ..good() }, "--minutes");
    refused(Args { preset: "huge".into(), ..good() }, "huge");
    refused(Args { set: vec!["charm=1".into()], ..good() }, "charm");
    refused(Args { set: vec!["dropout=1.5".into()], ..good() }, "dropout");
    refused(Args { set: vec!["architecture.planner.heads=5".into()], ..good() }, "heads");
    refused(Args { tokenizer: good().data, ..good() }, "offsets");
    refused(Args { resume: true, ..good() }, "cannot read");
    run(&good()).unwrap();
    refused(Args { resume: true, seed: Some(9), ..good() }, "configuration");
    testing::dataset(11, 48).save(good().data).unwrap();
    refused(Args { resume: true, ..good() }, "dataset");
}
