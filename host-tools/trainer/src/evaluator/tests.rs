//! Whole runs on a small dataset with two labels, and the objective against plain loops.

use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::dataset::{Builder, Caption, ClipView, Dataset, Facts, Quality, Side, Split};
use motionette_host::motion::features::of_legs;
use motionette_host::motion::mirror::mirror_joints;
use motionette_host::motion::{FEATURES, Pose};
use serde_json::json;

use super::config::Config;
use super::corpus::{Batch, Corpus, Labels};
use super::judge::Judge;
use super::model::{self, MotionOutput, Network};
use super::motion::prepare;
use super::objective::objective;
use super::training::Trainer;
use super::{Error, check, command};
use crate::harness::{self, Run};
use crate::prior::captions::Vocabulary;
use crate::random::Random;
use crate::schedule::{self, Plan};
use crate::tensor_file::TensorFile;
use crate::testing;

/// The stick figures of [`testing::dataset`], which move faster from clip to clip: those of the first half wave the left hand calmly, the
/// others walk briskly.
pub(crate) fn dataset(clips: usize, frames: usize) -> Dataset {
    let plain = testing::dataset(clips, frames);
    let mut builder = Builder::new();
    for (index, clip) in plain.iter().enumerate() {
        let mut info = clip.info.clone();
        let (sentences, content, style) = match 2 * index < clips {
            true => (["A person waves the left hand.", "someone waves calmly, left"], "wave-left-hand", "calm"),
            false => (["a person walks briskly", "Someone walks on."], "walk", "brisk"),
        };
        let caption = |text: &str| Caption { text: text.into(), from: 0.0, to: 0.0, source: "test".into() };
        info.captions = sentences.into_iter().map(caption).collect();
        info.labels = json!({"content": content, "style": style});
        builder.push(info, clip.joints, clip.features).unwrap();
    }
    builder.finish()
}

/// A configuration that trains in a second.
pub(crate) fn tiny() -> Config {
    Config {
        steps: 8,
        batch: 6,
        width: 10,
        hidden: 8,
        word_width: 4,
        embedding: 5,
        average_decay: 0.8,
        schedule: schedule::Settings { learning_rate: 5e-3, warm_up: 2, decay: 1.0, final_rate: 0.1 },
        ..Config::default()
    }
}

/// An evaluator after `steps` steps on a dataset.
pub(crate) fn judge(dataset: &Dataset, steps: u64) -> Judge {
    let mut run = run(dataset, steps);
    (0..steps).for_each(|_| assert!(run.step().unwrap().update.rate > 0.0));
    run.training.judge(&run.state)
}

/// A run of `steps` steps.
fn run(dataset: &Dataset, steps: u64) -> Run<Trainer<'_>> {
    let config = Config { steps, ..tiny() };
    let training = Trainer::new(&config, dataset).unwrap();
    let mut state = training.begin(&config);
    state.plan = Some(Plan::of_steps(steps, config.schedule.decay));
    Run::new(training, state).unwrap()
}

fn noise(n: usize, stream: u64) -> Vec<f32> {
    let mut random = Random::new(23, stream);
    (0..n).map(|_| random.symmetric() as f32).collect()
}

#[test]
fn training_lowers_the_objective_and_names_the_labels() {
    let dataset = dataset(24, 60);
    let mut run = run(&dataset, 150);
    assert_eq!(run.training.corpus().motions(), 2 * dataset.split(Split::Train).count());
    assert_eq!(run.training.corpus().labels().contents, ["walk", "wave-left-hand", "wave-right-hand"]);
    let totals: Vec<f32> = (0..150).map(|_| run.step().unwrap().terms.total).collect();
    let mean = |part: &[f32]| part.iter().sum::<f32>() / part.len() as f32;
    let (early, late) = (mean(&totals[..10]), mean(&totals[140..]));
    assert!(late < 0.7 * early, "objective {early} -> {late}");
    let judge = run.training.judge(&run.state);
    let clips: Vec<_> = dataset.split(Split::Train).collect();
    let right = |style: &str, index: usize| clips[index].info.labels["style"] == style;
    let hits = (0..clips.len()).filter(|i| right(judge.motion(clips[*i].joints).unwrap().style, *i)).count();
    assert!(hits * 10 >= clips.len() * 7, "{hits} of {}", clips.len());
}

#[test]
fn a_motion_is_judged_the_same_alone_and_in_a_batch() {
    let dataset = dataset(12, 90);
    let judge = judge(&dataset, 3);
    let prepared: Vec<_> = dataset.iter().map(|clip| prepare(clip.joints).unwrap()).collect();
    let together = judge.motions(&prepared.iter().collect::<Vec<_>>());
    for (index, (clip, judged)) in dataset.iter().zip(&together).enumerate() {
        let alone = judge.motion(clip.joints).unwrap();
        assert_eq!((alone.content, alone.style), (judged.content, judged.style), "clip {index}");
        for (a, b) in alone.embedding.iter().zip(&judged.embedding) {
            assert!((a - b).abs() < 1e-5, "clip {index}: {a} {b}");
        }
        let length: f64 = alone.embedding.iter().map(|x| x * x).sum();
        assert!((length - 1.0).abs() < 1e-5);
    }
    let sentences = ["a person walks", "someone waves the left hand with words nobody knows", ""];
    for (sentence, together) in sentences.iter().zip(judge.texts(&sentences)) {
        let alone = judge.texts(&[sentence]).remove(0);
        assert!(alone.iter().zip(&together).all(|(a, b)| (a - b).abs() < 1e-5), "{sentence}");
    }
}

fn labels() -> Labels {
    let words = ["<none>", "<unknown>", "left", "walk"].map(String::from).to_vec();
    Labels {
        vocabulary: Vocabulary::new(words),
        contents: vec!["a".into(), "b".into(), "c".into()],
        styles: vec!["x".into(), "y".into()],
    }
}

/// Five pairs: 0 and 3 have one label, 2 and 4 one sentence, 4 has no label.
fn batch() -> Batch {
    let lengths = vec![16, 9, 13, 1, 8];
    let mut features = vec![0.0; 5 * 16 * FEATURES];
    for (index, (row, length)) in features.chunks_exact_mut(16 * FEATURES).zip(&lengths).enumerate() {
        row[..length * FEATURES].copy_from_slice(&noise(length * FEATURES, index as u64));
    }
    Batch {
        features,
        lengths,
        sentences: vec![vec![1, 2], vec![3], vec![0, 1, 1], vec![2, 2, 2, 3], vec![0, 1, 1]],
        contents: vec![Some(0), Some(1), Some(2), Some(0), None],
        sides: vec![Side::Left, Side::None, Side::None, Side::Left, Side::None],
        styles: vec![Some(1), Some(1), Some(0), Some(1), None],
    }
}

/// Pairs of one action are left out of the contrast, with a style or without, but not those of the other side.
#[test]
fn the_other_side_is_another_label() {
    let pairs = |batch: &Batch| -> Vec<usize> {
        super::objective::excluded(batch).iter().enumerate().filter(|(_, out)| **out).map(|(pair, _)| pair).collect()
    };
    let mut changed = batch();
    assert_eq!(pairs(&changed), [3, 5 * 2 + 4, 5 * 3, 5 * 4 + 2]);
    changed.styles = vec![None; 5];
    assert_eq!(pairs(&changed), [3, 5 * 2 + 4, 5 * 3, 5 * 4 + 2]);
    changed.sides[3] = Side::Right;
    assert_eq!(pairs(&changed), [5 * 2 + 4, 5 * 4 + 2]);
}

#[test]
fn actions_and_sides_of_facts_are_mirrored() {
    let dataset = testing::with_facts(&testing::dataset(12, 40), |_| Facts {
        action: "walk-turn-left".into(),
        side: Side::Left,
        ..testing::facts()
    });
    let corpus = Corpus::new(&dataset, 12).unwrap();
    let labels = corpus.labels();
    assert_eq!((labels.contents.join(" "), labels.styles.len()), ("walk-turn-left walk-turn-right".into(), 0));
    let config = Config { batch: 40, ..tiny() };
    let batch = corpus.batch(&config, &mut Random::new(2, 2)).unwrap();
    let wanted = [(Some(0), Side::Left), (Some(1), Side::Right)];
    let found: Vec<(Option<usize>, Side)> = batch.contents.iter().copied().zip(batch.sides.iter().copied()).collect();
    assert!(found.iter().all(|pair| wanted.contains(pair)) && wanted.iter().all(|pair| found.contains(pair)));
}

#[test]
fn the_objective_agrees_with_plain_loops() {
    let device = Device::flex();
    let batch = batch();
    let config = Config { temperature: 0.3, content: 0.7, style: 1.3, ..tiny() };
    let (motion, text, content, style) = (noise(5 * 4, 1), noise(5 * 4, 2), noise(5 * 3, 3), noise(5 * 2, 4));
    let tensor =
        |values: &[f32], columns| Tensor::<2>::from_data(TensorData::new(values.to_vec(), [5, columns]), &device);
    let output = MotionOutput { embedding: tensor(&motion, 4), content: tensor(&content, 3), style: tensor(&style, 2) };
    let terms = objective(output, tensor(&text, 4), &batch, &config, &device).terms;

    let similarity = |i: usize, j: usize| {
        (0..4).map(|c| f64::from(motion[4 * i + c]) * f64::from(text[4 * j + c])).sum::<f64>() / 0.3
    };
    let apart = [(0, 3), (3, 0), (2, 4), (4, 2)];
    let negative_log = |own: f64, others: &mut dyn Iterator<Item = f64>| others.map(f64::exp).sum::<f64>().ln() - own;
    let mut contrastive = 0.0;
    for i in 0..5 {
        let used = |j: &usize| !apart.contains(&(i, *j));
        contrastive += negative_log(similarity(i, i), &mut (0..5).filter(used).map(|j| similarity(i, j))) / 10.0;
        contrastive += negative_log(similarity(i, i), &mut (0..5).filter(used).map(|j| similarity(j, i))) / 10.0;
    }
    let entropy = |logits: &[f32], classes: usize, targets: &[Option<usize>]| {
        let row = |i: usize, target: usize| {
            let own = f64::from(logits[i * classes + target]);
            negative_log(own, &mut (0..classes).map(|c| f64::from(logits[i * classes + c])))
        };
        targets.iter().enumerate().filter_map(|(i, target)| target.map(|t| row(i, t))).sum::<f64>() / 4.0
    };
    let (c, s) = (entropy(&content, 3, &batch.contents), entropy(&style, 2, &batch.styles));
    for (got, expected) in [
        (terms.contrastive, contrastive),
        (terms.content, c),
        (terms.style, s),
        (terms.total, contrastive + 0.7 * c + 1.3 * s),
    ] {
        assert!((f64::from(got) - expected).abs() < 1e-4, "{got} {expected}");
    }
}

/// Order and values of the flat gradient: every layer's weights and biases against differences.
#[test]
fn gradients_agree_with_differences() {
    let shapes = model::shapes(&tiny(), &labels());
    let mut start = model::initial_parameters(&shapes, 3);
    start.iter_mut().zip(noise(1 << 16, 9)).for_each(|(value, n)| *value += 0.1 * n);
    let batch = batch();
    let device = Device::flex().autodiff();
    let run = |values: &[f32]| {
        let network = Network::new(&shapes, values, true, &device);
        let motion = network.motion(batch.features.clone(), &batch.lengths, None, &device);
        let text = network.text(&batch.sentences, None, &device);
        (network, objective(motion, text, &batch, &tiny(), &device).total)
    };
    let (network, total) = run(&start);
    let mut gradient = vec![0.0; start.len()];
    network.collect_gradients(&total.backward(), &mut gradient);
    let value = |values: &[f32]| f64::from(run(values).1.into_scalar::<f32>());
    let mut offset = 0;
    for shape in &shapes {
        // The largest gradient of the weights, and that of the last bias.
        let weights = offset..offset + shape.weights();
        let largest =
            weights.clone().fold(weights.start, |a, b| if gradient[b].abs() > gradient[a].abs() { b } else { a });
        for index in [largest, offset + shape.parameters() - 1] {
            let slope = testing::slope(value, &start, index, 2e-3);
            let error = (slope - f64::from(gradient[index])).abs();
            assert!(error < 0.01 + 0.05 * slope.abs(), "{} {index}: {slope} {}", shape.name, gradient[index]);
        }
        offset += shape.parameters();
    }
    assert_eq!(offset, start.len());
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let dataset = dataset(12, 60);
    testing::assert_resumes(|| run(&dataset, 12));
    let Run { training, mut state } = run(&dataset, 12);
    state.optimizer.values.pop();
    assert!(matches!(Run::new(training, state), Err(harness::Error::Parameters { .. })));
}

#[test]
fn batches_hold_whole_changed_and_joined_motions() {
    let dataset = dataset(12, 60);
    let corpus = Corpus::new(&dataset, 3).unwrap();
    let config = Config { batch: 200, ..tiny() };
    let batch = corpus.batch(&config, &mut Random::new(1, 1)).unwrap();
    assert_eq!(batch, corpus.batch(&config, &mut Random::new(1, 1)).unwrap());
    let window = batch.features.len() / 200 / FEATURES;
    assert!(window.is_multiple_of(8) && window >= *batch.lengths.iter().max().unwrap());
    assert!(batch.lengths.iter().any(|length| *length > 60) && batch.lengths.iter().any(|length| *length < 30));
    assert!(batch.lengths.iter().all(|length| *length <= 196 && *length >= 16));
    assert!(batch.sentences.iter().all(|sentence| (1..=3).contains(&sentence.len())));
    for (row, length) in batch.features.chunks_exact(window * FEATURES).zip(&batch.lengths) {
        assert!(row[length * FEATURES..].iter().all(|x| *x == 0.0));
    }
}

/// Clips of which four, one of them for validation and one for test, push before a Kinect; the others walk before cameras.
fn with_kinect(clips: usize) -> Dataset {
    testing::with_facts(&testing::dataset(clips, 60), |info| {
        let pushes = ["figure0", "figure2", "figure4", "figure5"].contains(&info.id.as_str());
        let (action, quality) = if pushes { ("push", Quality::Kinect) } else { ("walk", Quality::Optical) };
        Facts { action: action.into(), quality, ..testing::facts() }
    })
}

/// Channels of legs, or the others, of all rows.
fn channels(rows: &[f32], legs: bool) -> Vec<f32> {
    rows.iter().enumerate().filter(|(i, _)| of_legs(i % FEATURES) == legs).map(|(_, value)| *value).collect()
}

/// Whole motions: what is not of the legs is always a clip's own; legs are hidden, its own, or those of a recorded motion.
#[test]
fn no_example_shows_synthetic_legs() {
    let dataset = with_kinect(12);
    let corpus = Corpus::new(&dataset, 12).unwrap();
    let prepared = |joints: &[Pose]| corpus.normalization().apply(&prepare(joints).unwrap().features);
    let both = |joints: &[Pose]| [prepared(joints), prepared(&mirror_joints(joints))];
    let of = |quality: Quality| -> Vec<Vec<f32>> {
        let fits = |clip: &ClipView<'_>| clip.info.facts.as_ref().unwrap().quality == quality;
        dataset.split(Split::Train).filter(fits).flat_map(|clip| both(clip.joints)).collect()
    };
    let (kinect, optical) = (of(Quality::Kinect), of(Quality::Optical));
    let plain = Config { batch: 60, cropped: 0.0, joined: 0.0, ..tiny() };
    for (hidden_legs, exchanged_legs) in [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)] {
        let config = Config { hidden_legs, exchanged_legs, ..plain.clone() };
        let batch = corpus.batch(&config, &mut Random::new(5, 1)).unwrap();
        let window = batch.features.len() / 60 / FEATURES;
        for (index, row) in batch.features.chunks_exact(window * FEATURES).enumerate() {
            let rows = &row[..batch.lengths[index] * FEATURES];
            let pushes = batch.contents[index] == Some(0);
            let sources = if pushes { &kinect } else { &optical };
            let own = sources.iter().find(|own| channels(own, false) == channels(rows, false)).expect("a clip");
            let legs = channels(rows, true);
            let hides = if pushes { exchanged_legs == 0.0 } else { hidden_legs == 1.0 };
            assert_eq!(legs.iter().all(|value| *value == 0.0), hides, "{hidden_legs} {exchanged_legs}");
            assert_eq!(legs == channels(own, true), !hides && !pushes);
            let first = |rows: &[f32]| channels(&rows[..FEATURES], true);
            assert!(hides || optical.iter().any(|other| first(other) == first(rows)));
        }
    }
    // Where nobody's legs were recorded there are none to take.
    let all = testing::with_facts(&dataset, |_| Facts { quality: Quality::Kinect, ..testing::facts() });
    let batch = Corpus::new(&all, 12).unwrap().batch(&plain, &mut Random::new(5, 1)).unwrap();
    assert!(channels(&batch.features, true).iter().all(|value| *value == 0.0));
}

#[test]
fn rare_actions_and_styles_are_drawn_more_often() {
    // Of 16 training clips one waves, one walks sadly.
    let dataset = testing::with_facts(&testing::dataset(24, 40), |info| Facts {
        action: if info.id == "figure1" { "wave" } else { "walk" }.into(),
        style: (info.id == "figure2").then(|| "sad".into()),
        ..testing::facts()
    });
    let corpus = Corpus::new(&dataset, 12).unwrap();
    let share = |balance: f64| {
        let config = Config { balance, batch: 4000, cropped: 0.0, joined: 0.0, ..tiny() };
        let batch = corpus.batch(&config, &mut Random::new(8, 1)).unwrap();
        let of = |rare: usize| rare as f64 / 4000.0;
        let waves = batch.contents.iter().filter(|content| **content == Some(1)).count();
        (of(waves), of(batch.styles.iter().flatten().count()))
    };
    // Twins counted, 2 wave, 30 walk, 2 of them sadly: weights 2^-b and 30^-b.
    for balance in [0.0, 0.5, 1.0] {
        let (rare, common) = (2.0 * 2f64.powf(-balance), 28.0 * 30f64.powf(-balance));
        let wanted = rare / (2.0 * rare + common);
        let (waves, sad) = share(balance);
        assert!((waves - wanted).abs() < 0.03 && (sad - wanted).abs() < 0.03, "{balance}: {waves} {sad} {wanted}");
    }
}

#[test]
fn a_judge_is_measured_with_own_and_without_legs() {
    let dataset = with_kinect(12);
    let judge = judge(&dataset, 4);
    let report = check::measure(&judge, &dataset, Split::Test, None).unwrap().unwrap();
    assert_eq!((report.synthetic, report.recorded), (1, 1));
    let named = |id: &str| {
        let clip = dataset.iter().find(|clip| clip.info.id == id).unwrap();
        judge.motion(clip.joints).unwrap().content
    };
    let share = |holds: bool| f64::from(u8::from(holds));
    assert_eq!(
        (report.right.own, report.drawn.own),
        (share(named("figure5") == "push"), share(named("figure11") == "push"))
    );
    assert_eq!(report.recorded_right.own, share(named("figure11") == "walk"));
    // The donor walks: with one recorded clip there is no other, and what walks keeps its own legs.
    assert_eq!((report.drawn.exchanged, report.drawn.decoded), (report.drawn.own, None));
    assert!(check::measure(&judge, &testing::dataset(12, 60), Split::Test, None).unwrap().is_none());
}

#[test]
fn a_checkpoint_round_trips_and_names_what_it_lacks() {
    let dataset = dataset(12, 60);
    let judge = judge(&dataset, 3);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("evaluator.safetensors");
    judge.save(&path, &json!({"val": null})).unwrap();
    let back = Judge::load(&path).unwrap();
    assert_eq!((back.labels(), back.steps()), (judge.labels(), 3));
    let joints = dataset.clip(0).joints;
    assert_eq!(back.motion(joints).unwrap(), judge.motion(joints).unwrap());
    assert_eq!(back.texts(&["a person walks"]), judge.texts(&["a person walks"]));
    let whole = TensorFile::load(&path).unwrap();
    for name in whole.tensors.keys() {
        let mut part = whole.clone();
        part.tensors.remove(name);
        part.save(&path).unwrap();
        let error = Judge::load(&path).err().unwrap();
        assert!(error.to_string().contains(name), "{error}");
    }
    let mut other = whole.clone();
    other.metadata.insert("version".into(), "2".into());
    other.save(&path).unwrap();
    assert!(Judge::load(&path).err().unwrap().to_string().contains("\"2\""));
}

#[test]
fn the_command_trains_resumes_and_measures() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let args = |more: &str| -> command::Args {
        let set = "--set width=8 --set batch=4 --set embedding=4";
        let line = "--data @data.mds --out @out/evaluator --seed 3 --steps 4 --log-every 1 --save-every 2 --json";
        testing::args(folder, &format!("{line} {set} {more}"))
    };
    let data = folder.join("data.mds");
    dataset(12, 60).save(&data).unwrap();
    command::run(&args("")).unwrap();
    let out = folder.join("out/evaluator.safetensors");
    assert_eq!(Judge::load(&out).unwrap().steps(), 4);
    let bytes = std::fs::read(&out).unwrap();
    command::run(&args("--resume")).unwrap();
    assert_eq!(std::fs::read(&out).unwrap(), bytes, "nothing was left to do");
    let table = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/actions.toml");
    let measured = |more: &str| args(&format!("--evaluate @out/evaluator.safetensors {more}"));
    command::run(&measured(&format!("--actions {}", table.display()))).unwrap();
    testing::assert_refused(command::run(&measured("--actions @absent.toml")), "absent.toml");
    testing::assert_refused(command::run(&measured("--tokenizer @absent.safetensors")), "absent.safetensors");

    let refused = |more: &str, what: &str| testing::assert_refused(command::run(&args(more)), what);
    refused("--set batch=1", "batch");
    refused("--set temperature=0", "temperature");
    refused("--set cropped=0.9", "cropped");
    refused("--set hidden_legs=1.5", "hidden_legs");
    refused("--set balance=-0.1", "balance");
    refused("--set schedule.learning_rate=-1", "learning_rate");
    refused("--set charm=1", "charm");
    refused("--resume --seed 4", "configuration");
    dataset(6, 60).save(&data).unwrap();
    refused("--resume", "dataset");
    testing::dataset(6, 60).save(&data).unwrap();
    // Without labels there is nothing to name and nothing to measure.
    command::run(&args("")).unwrap();
    let unlabelled = Judge::load(&out).unwrap();
    assert_eq!(unlabelled.motion(dataset(6, 60).clip(0).joints).unwrap().content, "");
    dataset(6, 10).save(&data).unwrap();
    refused("", "no train clip");
}

#[test]
fn what_cannot_be_judged_is_a_typed_error() {
    let judge = judge(&dataset(6, 60), 0);
    assert!(matches!(judge.motion(&[]), Err(Error::Features { .. })));
    assert!(matches!(judge.motion(&[[[f32::NAN; 3]; 22]; 20]), Err(Error::Features { .. })));
    assert!(matches!(judge.motion(&[[[0.0; 3]; 22]; 20]), Err(Error::Features { .. })));
}
