//! Runs of the tiny control: they learn, leave the prior alone, resume bit for bit, agree with the reference, and refuse what does not fit.

use std::path::Path;

use motionette_host::checkpoint;
use motionette_host::dataset::Dataset;
use motionette_host::reference::tmd::{Sampling, Schedule, Settings};
use motionette_host::reference::{Anchor, Prior, Target};

use super::command::{Args, run};
use super::config::Config;
use super::frozen::Frozen;
use super::sampling::Planner;
use super::state::{Sources, State};
use super::training::{Corpora, Trainer};
use crate::harness::Run;
use crate::prior::corpus::Material;
use crate::prior::sentences::Sentences;
use crate::tokenizer::config::FPS;
use crate::{testing, tokenizer};

fn args(folder: &Path, more: &str) -> Args {
    let line = "--data @data.mds --tokenizer @tokenizer.safetensors --prior @prior.safetensors --out @control --preset tiny \
                --log-every 4 --save-every 1 --validate 2 \
                --set schedule.learning_rate=0.01 --set schedule.warm_up=3 --set average_decay=0.9";
    testing::args(folder, &format!("{line} {more}"))
}

#[test]
fn every_variant_learns_and_leaves_the_prior_alone() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_prior(folder.path());
    let bytes = |args: &Args| (std::fs::read(&args.prior).unwrap(), std::fs::read(&args.tokenizer).unwrap());
    let before = bytes(&args(folder.path(), ""));
    for (variant, steps) in
        [("anchor-kv", 160), ("anchor-kv --no-context", 20), ("cross --no-context", 20), ("copy --no-context", 20)]
    {
        let pace = format!("--steps {steps} --log-every {} --save-every 100", steps / 4);
        let args = args(folder.path(), &format!("--variant {variant} {pace}"));
        run(&args).unwrap();
        let state = State::load(&args.options.state_file()).unwrap();
        let points = &state.curves.points;
        let (early, late) = (points[0].loss, points[points.len() - 1].loss);
        assert!(steps < 100 || late < 0.9 * early, "{variant}: cross-entropy {early} -> {late}");
        let report = &state.curves.evaluations.last().unwrap().report;
        assert_eq!((report.motions, report.families.len()), (2, 3));
        // The file holds what the run averaged, and the frozen parts are named by what they were and are.
        let frozen = Frozen::load(&args.prior, &args.tokenizer).unwrap();
        let trained = super::checkpoint::load(&args.options.checkpoint(), &frozen, &state.sources.prior).unwrap();
        assert_eq!((&trained.statistics, &trained.parameters), (&state.extra, &state.optimizer.average));
        let hash = Dataset::load(&args.options.data).unwrap().hash;
        assert_eq!(Sources::of(&hash, &frozen), state.sources);
    }
    assert_eq!(bytes(&args(folder.path(), "")), before);
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_prior(folder.path());
    let args = args(folder.path(), "");
    let config = args.options.configured(Config::preset("tiny").unwrap()).unwrap();
    let dataset = Dataset::load(&args.options.data).unwrap();
    let frozen = Frozen::load(&args.prior, &args.tokenizer).unwrap();
    let sentences = Sentences::new(&dataset, None, None).of_prior(&frozen.prior.sources);
    let material = Material { dataset: &dataset, tokenizer: &frozen.tokenizer, sentences };
    testing::assert_resumes(|| {
        let training = material.training().unwrap();
        let sources = Sources::of(&dataset.hash, &frozen);
        let state = State::begin(&config, sources, training.statistics(), &frozen);
        let corpora = Corpora { training, held_out: material.held_out().unwrap(), measured: 2 };
        Run::new(Trainer::new(&config, &frozen, corpora), state).unwrap()
    });
}

/// The trainer's networks and the plain loops of the reference plan the same tokens from the same draws.
#[test]
fn the_reference_plans_the_same_tokens() {
    ["near", "masks"].into_iter().for_each(assert_same_tokens);
}

/// Of a prior whose tokens are corrupted like this, and a control of it.
fn assert_same_tokens(corruption: &str) {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_prior_of(folder.path(), corruption);
    let args = args(folder.path(), "--steps 60 --log-every 60 --save-every 100");
    run(&args).unwrap();
    let tokenizer = checkpoint::load(&args.tokenizer).unwrap();
    let checkpoint = checkpoint::prior::load(&args.prior).unwrap();
    let control = checkpoint::control::load(&args.options.checkpoint()).unwrap();
    control.check_prior(&checkpoint, &tokenizer).unwrap();
    let reference = Prior::<f32>::new(&checkpoint, &tokenizer).controlled(&control, FPS as f64);
    let frozen = Frozen::load(&args.prior, &args.tokenizer).unwrap();
    let prior = Sources::of("", &frozen).prior;
    let trained = super::checkpoint::load(&args.options.checkpoint(), &frozen, &prior).unwrap();
    let planner = Planner::new(frozen, Some(trained));
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
    assert!(agreeing * 20 >= count * 19, "{corruption}: {agreeing} of {count} tokens agree");
}

#[test]
fn bad_input_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    assert!(run(&args(folder, "--steps 4")).unwrap_err().is::<motionette_host::dataset::Error>(), "no dataset");
    testing::prepare_prior(folder);
    let refused = |more: &str, what: &str| testing::assert_refused(run(&args(folder, more)), what);
    refused("", "--minutes");
    refused("--steps 4 --preset huge", "huge");
    refused("--steps 4 --set charm=1", "charm");
    refused("--steps 4 --set anchors=[2,33]", "anchors");
    refused("--steps 4 --set anchor_loss=-1", "anchor_loss");
    refused("--steps 4 --prior @tokenizer.safetensors", "prior");
    refused("--steps 4 --resume", "cannot read");
    refused("--steps 4 --scaffold @prior.safetensors", "format");
    run(&args(folder, "--steps 4")).unwrap();
    refused("--steps 4 --resume --seed 9", "configuration");
    let other = "--data @data.mds --out @other --preset tiny --seed 5 --steps 5";
    tokenizer::command::run(&testing::args(folder, other)).unwrap();
    refused("--steps 4 --tokenizer @other.safetensors", "tokenizer");
}

/// Whatever the prior finds its words in: `motionette convert` takes only a control that names the prior beside it.
#[test]
fn a_prior_is_named_as_the_converter_names_it() {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    let [prior, tokenizer] = ["nano.prior.safetensors", "nano.safetensors"].map(|file| models.join(file));
    let frozen = Frozen::load(&prior, &tokenizer).unwrap();
    assert!(frozen.layout.parameters.iter().any(|parameter| parameter.frozen), "words with vectors");
    let read = checkpoint::prior::load(&prior).unwrap();
    assert_eq!(Sources::of("", &frozen).prior, read.weights_hash());
}
