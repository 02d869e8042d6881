//! Runs of the tiny control: they learn, leave the prior alone, resume bit for bit, agree with the reference, and refuse what does not fit.

use std::path::Path;

use motionette_host::checkpoint;
use motionette_host::dataset::Dataset;
use motionette_host::reference::tmd::{Sampling, Schedule, Settings};
use motionette_host::reference::{Anchor, Prior, Target};

use super::command::{Args, frozen, run};
use super::config::Variant;
use super::sampling::Planner;
use super::state::{Sources, State};
use crate::prior::captions::Vocabulary;
use crate::tokenizer::config::FPS;
use crate::{prior, testing, tokenizer};

fn args(folder: &Path) -> Args {
    Args {
        data: folder.join("data.mds"),
        tokenizer: folder.join("tokenizer.safetensors"),
        prior: folder.join("prior.safetensors"),
        out: folder.join("control.safetensors"),
        preset: "tiny".into(),
        variant: None,
        scaffold: None,
        no_context: false,
        no_anchor_loss: false,
        set: vec!["schedule.learning_rate=0.01".into(), "schedule.warm_up=3".into(), "average_decay=0.9".into()],
        seed: None,
        steps: Some(8),
        minutes: None,
        resume: false,
        log_every: 4,
        save_every: 1,
        validate: 2,
        json: false,
    }
}

/// A dataset, a tokenizer of it and a prior of both.
fn prepare(folder: &Path) {
    let good = args(folder);
    testing::dataset(12, 48).save(&good.data).unwrap();
    let tokenizer = tokenizer::command::Args {
        data: good.data.clone(),
        out: good.tokenizer.clone(),
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
    let prior = prior::command::Args {
        data: good.data,
        tokenizer: good.tokenizer,
        out: good.prior,
        preset: "tiny".into(),
        set: Vec::new(),
        seed: None,
        steps: Some(20),
        minutes: None,
        resume: false,
        log_every: 100,
        save_every: 1,
        json: false,
    };
    prior::command::run(&prior).unwrap();
}

fn state(args: &Args) -> State {
    let (frozen, _) = frozen(&args.prior, &args.tokenizer).unwrap();
    State::load(&args.out.with_extension("state.safetensors"), &frozen).unwrap()
}

#[test]
fn every_variant_learns_and_leaves_the_prior_alone() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let bytes = |args: &Args| (std::fs::read(&args.prior).unwrap(), std::fs::read(&args.tokenizer).unwrap());
    let before = bytes(&args(folder.path()));
    for (variant, context, steps) in [
        (Variant::AnchorKv, true, 160),
        (Variant::AnchorKv, false, 20),
        (Variant::Cross, false, 20),
        (Variant::Copy, false, 20),
    ] {
        let mut args = Args { variant: Some(variant), no_context: !context, steps: Some(steps), ..args(folder.path()) };
        (args.log_every, args.save_every) = (steps / 4, 100);
        run(&args).unwrap();
        let state = state(&args);
        let points = &state.curves.points;
        let (early, late) = (points[0].loss, points[points.len() - 1].loss);
        assert!(steps < 100 || late < 0.9 * early, "{variant:?}: cross-entropy {early} -> {late}");
        let (_, report) = state.curves.evaluations.last().unwrap();
        assert_eq!((report.motions, report.families.len()), (2, 3));
        // The file holds what the run averaged, and the frozen parts are named by what they were and are.
        let (frozen, _) = frozen(&args.prior, &args.tokenizer).unwrap();
        let (_, statistics, values) = super::checkpoint::load(&args.out, &frozen, &state.sources.prior).unwrap();
        assert_eq!((&statistics, &values), (&state.statistics, &state.optimizer.average));
        let hash = Dataset::load(&args.data).unwrap().hash;
        assert_eq!(Sources::of(&hash, &frozen), state.sources);
    }
    assert_eq!(bytes(&args(folder.path())), before);
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let whole = args(folder.path());
    run(&whole).unwrap();
    let mut uninterrupted = state(&whole);
    // The clock decides where the fall begins, so the first part has to know the whole length: it begins again by hand.
    let parts = Args { out: folder.path().join("parts.safetensors"), ..whole.clone() };
    let path = parts.out.with_extension("state.safetensors");
    let (frozen, _) = frozen(&parts.prior, &parts.tokenizer).unwrap();
    let State { config, sources, statistics, plan, .. } = uninterrupted.clone();
    let fresh = State { plan, ..State::new(&config, sources, statistics, &frozen) };
    fresh.save(&path).unwrap();
    run(&Args { resume: true, ..parts.clone() }).unwrap();
    let mut resumed = state(&parts);
    (resumed.seconds, uninterrupted.seconds) = (0.0, 0.0);
    assert_eq!(resumed, uninterrupted);
}

/// The trainer's networks and the plain loops of the reference plan the same tokens from the same draws.
#[test]
fn the_reference_plans_the_same_tokens() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let args = Args { steps: Some(60), log_every: 60, save_every: 100, ..args(folder.path()) };
    run(&args).unwrap();
    let tokenizer = checkpoint::load(&args.tokenizer).unwrap();
    let checkpoint = checkpoint::prior::load(&args.prior).unwrap();
    let control = checkpoint::control::load(&args.out).unwrap();
    control.check_prior(&checkpoint, &tokenizer).unwrap();
    let reference = Prior::<f32>::new(&checkpoint, &tokenizer).controlled(&control, FPS as f64);
    let (frozen, sources) = frozen(&args.prior, &args.tokenizer).unwrap();
    let trained = super::checkpoint::load(&args.out, &frozen, &state(&args).sources.prior).unwrap();
    let planner = Planner::new(frozen, Vocabulary::new(sources.vocabulary), Some(trained));
    let anchors = [
        Anchor { frame: 3, target: Target::Root([0.1, 0.9, 0.4]) },
        Anchor { frame: 17, target: Target::PlanarRoot([0.3, 0.8]) },
        Anchor { frame: 30, target: Target::Joint { joint: 20, position: [0.5, 1.1, 1.4] } },
    ];
    let (mut agreeing, mut count, mut moved) = (0, 0, 0);
    for seed in 0..4 {
        let settings = Settings {
            seed,
            steps: 6,
            schedule: Schedule::Uniform,
            sampling: Sampling::Sample { temperature: 1.0, top_k: 0, top_p: 1.0 },
            fixed: Vec::new(),
        };
        let text = "a figure walks slowly.";
        let words = reference.text.read(text).unwrap();
        let guided = reference.guided(&words.ids, 2.0);
        let free = reference.sample(&guided, 9, &settings).pop().unwrap();
        let own = reference.sample(&reference.through(guided, &anchors, 9), 9, &settings).pop().unwrap();
        let other = planner.sample(text, 9, &anchors, 2.0, &settings);
        agreeing += own.iter().zip(&other).filter(|(a, b)| a == b).count();
        moved += own.iter().zip(&free).filter(|(a, b)| a != b).count();
        count += own.len();
    }
    assert!(moved > 0, "anchors change nothing");
    // A draw may fall between two sums that differ in the last bit.
    assert!(agreeing * 20 >= count * 19, "{agreeing} of {count} tokens agree");
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
    refused(Args { set: vec!["anchors=[2,33]".into()], ..good() }, "anchors");
    refused(Args { set: vec!["anchor_loss=-1".into()], ..good() }, "anchor_loss");
    refused(Args { prior: good().tokenizer, ..good() }, "prior");
    refused(Args { resume: true, ..good() }, "cannot read");
    refused(Args { scaffold: Some(good().prior), ..good() }, "format");
    run(&good()).unwrap();
    refused(Args { resume: true, seed: Some(9), ..good() }, "configuration");
    let other = folder.path().join("other.safetensors");
    let tokenizer = tokenizer::command::Args {
        data: good().data,
        out: other.clone(),
        preset: "tiny".into(),
        set: Vec::new(),
        seed: Some(5),
        steps: Some(5),
        minutes: None,
        resume: false,
        log_every: 100,
        save_every: 1,
        evaluate: None,
        json: false,
    };
    tokenizer::command::run(&tokenizer).unwrap();
    refused(Args { tokenizer: other, ..good() }, "tokenizer");
}
