//! Whole runs on a small dataset.

use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::dataset::{Dataset, Split};
use motionette_host::reference;

use super::checkpoint::Checkpoint;
use super::config::{Config, FEATURES};
use super::model::Network;
use super::state::State;
use super::training::Trainer;
use super::{Error, metrics};
use crate::harness::{self, Configuration, Run};
use crate::random::Random;
use crate::schedule::Plan;
use crate::{tensor_file, testing};

fn tiny() -> Config {
    Config { learning_rate: 5e-3, average_decay: 0.9, ..Config::preset("tiny").unwrap() }
}

/// A run of `steps` steps; quantisation begins at the third.
fn run(dataset: &Dataset, steps: u64) -> Run<Trainer<'_>> {
    let mut state = State::begin(&tiny(), &dataset.hash);
    state.plan = Some(Plan::of_steps(steps, state.config.decay));
    Run::new(Trainer::new(&tiny(), dataset).unwrap(), state).unwrap()
}

fn checkpoint(run: &Run<Trainer<'_>>) -> Option<Checkpoint> {
    run.training.checkpoint(&run.state)
}

#[test]
fn training_lowers_the_objective_and_the_error_of_whole_clips() {
    let dataset = testing::dataset(12, 48);
    let mut run = run(&dataset, 400);
    let mut totals = Vec::new();
    let mut first = None;
    for _ in 0..400 {
        totals.push(run.step().unwrap().terms.total);
        if run.state.step == 5 {
            first = checkpoint(&run);
        }
    }
    let mean = |part: &[f32]| part.iter().sum::<f32>() / part.len() as f32;
    let (early, late) = (mean(&totals[..10]), mean(&totals[390..]));
    assert!(late < 0.7 * early, "objective {early} -> {late}");
    let error = |checkpoint: &Checkpoint| {
        let reports = metrics::evaluate(checkpoint, &dataset, &[Split::Test]).unwrap();
        assert_eq!(reports.len(), 1);
        reports[0].mpjpe_root_mm
    };
    let (early, late) = (error(&first.unwrap()), error(&checkpoint(&run).unwrap()));
    assert!(late < 0.8 * early, "error {early} -> {late}");
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let dataset = testing::dataset(8, 40);
    testing::assert_resumes(|| run(&dataset, 12));
}

#[test]
fn a_checkpoint_round_trips_and_has_the_published_names() {
    let dataset = testing::dataset(8, 40);
    let mut run = run(&dataset, 6);
    assert!(checkpoint(&run).is_none(), "no codes yet");
    for _ in 0..6 {
        run.step().unwrap();
    }
    let trained = checkpoint(&run).unwrap();
    let reports = metrics::evaluate(&trained, &dataset, &[Split::Val]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tiny.safetensors");
    trained.save(&path, &reports).unwrap();
    assert_eq!(Checkpoint::load(&path).unwrap(), trained);
    let file = tensor_file::TensorFile::load(&path).unwrap();
    // Sizes of the preset: width 8, encoder 12, codes 8 x 4, two blocks a stage.
    for (name, shape) in [
        ("encoder.model.0.weight", vec![12, 263, 3]),
        ("encoder.model.2.0.weight", vec![12, 12, 4]),
        ("encoder.model.3.1.model.1.conv2.weight", vec![12, 12, 1]),
        ("encoder.model.4.bias", vec![4]),
        ("decoder.model.0.weight", vec![8, 4, 3]),
        ("decoder.model.2.0.model.0.conv1.weight", vec![8, 8, 3]),
        ("decoder.model.3.2.weight", vec![8, 8, 3]),
        ("decoder.model.4.weight", vec![8, 8, 3]),
        ("decoder.model.6.weight", vec![263, 8, 3]),
        ("quantizer.layers.0.codebook", vec![8, 4]),
        ("mean", vec![263]),
        ("std", vec![263]),
    ] {
        assert_eq!(file.tensors[name].0, shape, "{name}");
    }
    let config: serde_json::Value = file.parsed("config").unwrap();
    assert_eq!(config["steps"], 6);
    assert_eq!(config["data_hash"], dataset.hash);
    assert_eq!(config["dilations"], serde_json::json!([3, 1]));
    // As checkpoints were before these settings.
    assert!(config.get("right").is_none() && config.get("encoder_dilations").is_none());
    let mut other = trained.clone();
    let architecture = &mut other.config.architecture;
    architecture.right = vec![1, 0, 1, 0, 2, 0, 1, 0, 1];
    architecture.encoder_dilations = vec![2, 2];
    other.save(&path, &reports).unwrap();
    assert_eq!(Checkpoint::load(&path).unwrap(), other);
    let file = tensor_file::TensorFile::load(&path).unwrap();
    let config: serde_json::Value = file.parsed("config").unwrap();
    assert_eq!(config["right"], serde_json::json!([1, 0, 1, 0, 2, 0, 1, 0, 1]));
    assert_eq!(config["encoder_dilations"], serde_json::json!([2, 2]));
    agrees_with_the_reference(&other, &path);
    trained.save(&path, &reports).unwrap();
    agrees_with_the_reference(&trained, &path);
}

/// What a network computes while it trains is what the reference computes of its file, dilations and padding included.
fn agrees_with_the_reference(checkpoint: &Checkpoint, path: &std::path::Path) {
    let stored = motionette_host::checkpoint::load(path).unwrap();
    let encoder = reference::Encoder::<f64>::new(stored.encoder.as_ref().unwrap());
    let decoder = reference::Decoder::<f64>::new(&stored.decoder, FEATURES);
    let device = Device::flex();
    let network = Network::new(&checkpoint.config.architecture, &checkpoint.parameters, false, &device);
    let mut random = Random::new(3, 1);
    let tokens = 9;
    let x: Vec<f32> = (0..4 * tokens * FEATURES).map(|_| random.symmetric() as f32).collect();
    let tensor = |values: &[f32], shape| Tensor::<3>::from_data(TensorData::new(values.to_vec(), shape), &device);
    let latents = network.encode(tensor(&x, [1, 4 * tokens, FEATURES]), None);
    let features = network.decode(latents.clone(), None);
    let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let agree = |tensor: Tensor<3>, exact: &[f64]| {
        let found: Vec<f32> = tensor.into_data().try_into_vec().unwrap();
        assert_eq!(found.len(), exact.len());
        let largest = exact.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        assert!(found.iter().zip(exact).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-4 * largest));
    };
    let exact = encoder.forward(&wide(&x));
    agree(features, &decoder.forward(&exact).features);
    agree(latents, &exact);
}

#[test]
fn a_checkpoint_that_lacks_something_is_refused_by_name() {
    let dataset = testing::dataset(8, 40);
    let mut run = run(&dataset, 4);
    for _ in 0..4 {
        run.step().unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tiny.safetensors");
    checkpoint(&run).unwrap().save(&path, &[]).unwrap();
    let whole = tensor_file::TensorFile::load(&path).unwrap();
    for name in whole.tensors.keys() {
        let mut part = whole.clone();
        part.tensors.remove(name);
        part.save(&path).unwrap();
        let error = Checkpoint::load(&path).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
    }
    let mut other = whole.clone();
    other.metadata.insert("version".into(), "2".into());
    other.save(&path).unwrap();
    let error = Checkpoint::load(&path).unwrap_err().to_string();
    assert!(error.contains("\"2\"") && error.contains("\"1\""), "{error}");
}

#[test]
fn an_exploding_run_stops_with_a_typed_error() {
    let dataset = testing::dataset(6, 40);
    let mut run = run(&dataset, 10);
    run.state.optimizer.values.fill(1e30);
    assert!(matches!(run.step(), Err(Error::Run(harness::Error::Diverged { step: 0 }))));
}

#[test]
fn settings_out_of_range_are_refused() {
    let sizes = |change: fn(&mut super::config::Architecture)| {
        let mut config = tiny();
        change(&mut config.architecture);
        config
    };
    for (change, field) in [
        (sizes(|a| a.dilations.clear()), "dilations"),
        (sizes(|a| a.encoder_dilations = vec![0]), "encoder_dilations"),
        (sizes(|a| a.right = vec![0; 8]), "right"),
        (sizes(|a| a.right = vec![0, 4, 0, 0, 0, 0, 0, 0, 0]), "right"),
        (Config { window: 30, ..tiny() }, "window"),
        (Config { batch: 0, ..tiny() }, "batch"),
        (Config { learning_rate: f32::NAN, ..tiny() }, "learning_rate"),
        (Config { decay: 2.0, ..tiny() }, "decay"),
    ] {
        assert_eq!(change.checked().unwrap_err().field, field);
    }
    assert!(matches!(Config::preset("huge"), Err(harness::Error::UnknownPreset { .. })));
}
