//! Runs of the tiny prior: they learn, resume bit for bit, and refuse what does not fit.

use std::collections::BTreeMap;
use std::path::Path;

use motionette_host::checkpoint::prior::{Corruption, codebook_hash};
use motionette_host::convert;
use motionette_host::dataset::Dataset;

use super::checkpoint;
use super::command::{Args, run};
use super::config::Config;
use super::corpus::Material;
use super::corruption::Metric;
use super::sentences::Sentences;
use super::state::{Sources, State};
use super::training::Trainer;
use crate::harness::Run;
use crate::testing;
use crate::tokenizer::checkpoint::Checkpoint;

fn args(folder: &Path, more: &str) -> Args {
    let line = "--data @data.mds --tokenizer @tokenizer.safetensors --out @prior --preset tiny --log-every 4 --save-every 1 \
                --set schedule.learning_rate=0.005 --set schedule.warm_up=3 --set average_decay=0.9";
    testing::args(folder, &format!("{line} {more}"))
}

#[test]
fn a_run_learns_its_motions() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_tokenizer(folder.path());
    let args = args(folder.path(), "--steps 250 --log-every 10 --save-every 100");
    run(&args).unwrap();
    let state = State::load(&args.options.state_file()).unwrap();
    let points = &state.curves.points;
    let (early, late) = (points[0].loss, points[points.len() - 1].loss);
    assert!(late < 0.8 * early, "cross-entropy {early} -> {late}");
    let report = &state.curves.evaluations.last().unwrap().report;
    assert!(report.motions == 2 && report.accuracy[3] > report.accuracy[0], "{report:?}");
    let file = checkpoint::FORMAT.load(&args.options.checkpoint()).unwrap();
    for (parameter, average) in state.layout().split(&state.optimizer.average) {
        assert_eq!(file.values(&parameter.name, &parameter.shape()).unwrap(), average, "{}", parameter.name);
    }
    let facts: serde_json::Value = file.parsed("config").unwrap();
    assert_eq!(facts["vocabulary"][0], "<none>");
    assert!(args.options.checkpoint().with_extension("curves.svg").is_file());
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_tokenizer(folder.path());
    let dataset = Dataset::load(folder.path().join("data.mds")).unwrap();
    let tokenizer = Checkpoint::load(&folder.path().join("tokenizer.safetensors")).unwrap();
    let config = args(folder.path(), "").options.configured(Config::preset("tiny").unwrap()).unwrap();
    let sentences = Sentences::new(&dataset, None, None);
    let sources = Sources {
        data_hash: dataset.hash.clone(),
        tokenizer: codebook_hash(&tokenizer.codebook),
        codes: 8,
        code_dim: 4,
        vocabulary: sentences.vocabulary.words.clone(),
        word_vectors: 0,
        word_tiers: Vec::new(),
        meanings: Vec::new(),
        phrases: None,
        guidance: false,
        teacher: None,
    };
    let material = Material { dataset: &dataset, tokenizer: &tokenizer, sentences };
    testing::assert_resumes(|| {
        let metric = Metric::new(&tokenizer.codebook, 4, &config);
        let (training, held_out) = (material.training().unwrap(), material.held_out().unwrap());
        let trainer = Trainer::new(sources.layout(&config), training, held_out, metric);
        Run::new(trainer, State::begin(&config, sources.clone(), None)).unwrap()
    });
}

/// A student begins as its teacher and learns to say in one pass what that says in two; host tools read it.
#[test]
fn guidance_is_distilled_into_one_pass() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_prior(folder.path());
    let args = |more: &str| -> Args {
        let line = "--data @data.mds --tokenizer @tokenizer.safetensors --out @one --log-every 20 --save-every 100 \
                    --teacher @prior.safetensors --set schedule.learning_rate=0.01 --set schedule.warm_up=1";
        testing::args(folder.path(), &format!("{line} {more}"))
    };
    let student = args("--steps 300 --set dropout=0 --set average_decay=0.9");
    run(&student).unwrap();
    let points = State::load(&student.options.state_file()).unwrap().curves.points;
    let (early, late) = (points[0].loss, points[points.len() - 1].loss);
    assert!(late < early && late.is_finite(), "cross-entropy with the teacher {early} -> {late}");
    let teacher = checkpoint::load(&folder.path().join("prior.safetensors")).unwrap();
    let one = motionette_host::checkpoint::prior::load(&student.options.checkpoint()).unwrap();
    assert!(one.config.guidance && !teacher.sources.guidance);
    let table = one.planner.guidance.unwrap();
    assert_eq!(table.rows, 5);
    // Strengths are drawn from 1 to 4.
    assert!(
        table.weight[table.width..].iter().any(|w| *w != 0.0) && table.weight[..table.width].iter().all(|w| *w == 0.0)
    );
    testing::assert_refused(run(&args("--steps 3 --teacher @one.safetensors --out @two")), "one pass already");
    // A student that learns on begins where it was.
    let on = args(
        "--steps 2 --from @one.safetensors --out @on --set schedule.learning_rate=1e-9 --set dropout=0 --log-every 1",
    );
    run(&on).unwrap();
    let (was, is) = (checkpoint::load(&student.options.checkpoint()), checkpoint::load(&on.options.checkpoint()));
    let (was, is) = (was.unwrap().parameters, is.unwrap().parameters);
    let far = was.iter().zip(&is).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(far < 1e-6 && was != teacher.parameters, "{far}");
    testing::assert_refused(run(&args("--steps 3 --teacher @data.mds")), "offsets");
}

/// Masked tokens are filled in, more of them at a time when fewer are masked; the checkpoint converts, and the runtime plans from masks.
#[test]
fn masked_tokens_are_learnt() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_tokenizer(folder.path());
    let masks = "--set corruption=masks --log-every 10 --save-every 100";
    let first = args(folder.path(), &format!("--steps 250 {masks}"));
    run(&first).unwrap();
    let state = State::load(&first.options.state_file()).unwrap();
    let points = &state.curves.points;
    let (early, late) = (points[0].loss, points[points.len() - 1].loss);
    assert!(late < 0.8 * early, "cross-entropy {early} -> {late}");
    let report = &state.curves.evaluations.last().unwrap().report;
    assert!(report.motions == 2 && report.accuracy[3] > report.accuracy[0], "{report:?}");
    let path = first.options.checkpoint();
    let prior = motionette_host::checkpoint::prior::load(&path).unwrap();
    assert_eq!(
        (prior.config.corruption, prior.planner.mask.as_ref().map(|mask| mask.rows)),
        (Corruption::Masks, Some(1))
    );

    let tokenizer = motionette_host::checkpoint::load(&folder.path().join("tokenizer.safetensors")).unwrap();
    let card = convert::CardText::default();
    let source = convert::PriorSource { checkpoint: &prior, bank: &[], text_encoder: true, control: None, cases: &[] };
    let plain = &convert::Options::PLAIN;
    let blob = convert::convert_with_prior(&tokenizer, Some(source), plain, &[], &card, |_| ()).unwrap().blob;
    let blob = motionette_host::blob::BlobFile::new(blob, &path).unwrap();
    let meant = blob.model().unwrap().default_planning();
    let request = motionette::Request::text("a figure walks slowly").planned(meant);
    let tokens = motionette_host::verify::run(&blob, "walks", &request).unwrap().tokens;
    assert!(!tokens.is_empty() && tokens.iter().all(|token| *token < 8));

    // A teacher of masks has students of masks.
    let student = |more: &str| -> Args {
        let line = "--data @data.mds --tokenizer @tokenizer.safetensors --out @one --teacher @prior.safetensors";
        testing::args(folder.path(), &format!("{line} {more}"))
    };
    run(&student("--steps 3")).unwrap();
    let one = motionette_host::checkpoint::prior::load(&folder.path().join("one.safetensors")).unwrap();
    assert!(one.config.guidance && one.planner.mask.is_some());
    let near = testing::args::<Args>(
        folder.path(),
        "--data @data.mds --tokenizer @tokenizer.safetensors --out @near --from @prior.safetensors --steps 2 --set corruption=near",
    );
    run(&near).unwrap();
    for more in ["--set corruption=near", "--from @near.safetensors"] {
        let error = run(&student(&format!("--steps 3 {more}"))).unwrap_err();
        assert!(matches!(error.downcast_ref(), Some(super::Error::Corruption { .. })), "{more}: {error:#}");
    }
    testing::assert_refused(run(&args(folder.path(), "--steps 3 --set corruption=noise")), "does not fit");
}

/// A run of masks can begin with a prior of near codes, and the other way round: only the row of masked tokens is another.
#[test]
fn a_run_can_begin_with_a_prior_of_another_corruption() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_prior(folder.path());
    let args = |from: &str, corruption: &str| -> Args {
        let line = "--data @data.mds --tokenizer @tokenizer.safetensors --steps 1 --set schedule.learning_rate=1e-9 --log-every 1";
        let more = format!("--from @{from}.safetensors --out @{corruption} --set corruption={corruption}");
        testing::args(folder.path(), &format!("{line} {more}"))
    };
    let parameters = |name: &str| {
        let checkpoint = checkpoint::load(&folder.path().join(format!("{name}.safetensors"))).unwrap();
        let layout = checkpoint.sources.layout(&checkpoint.config);
        let all = layout.split(&checkpoint.parameters);
        all.map(|(parameter, values)| (parameter.name.clone(), values.to_vec())).collect::<BTreeMap<_, _>>()
    };
    run(&args("prior", "masks")).unwrap();
    run(&args("masks", "near")).unwrap();
    let [first, masks, near] = ["prior", "masks", "near"].map(parameters);
    let mut more: Vec<&String> = masks.keys().filter(|name| !first.contains_key(*name)).collect();
    assert_eq!(more.pop().map(String::as_str), Some("planner.mask.weight"));
    assert!(more.is_empty() && masks["planner.mask.weight"].iter().any(|v| *v != 0.0));
    for (name, values) in &first {
        for other in [&masks[name], &near[name]] {
            let far = values.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(far < 1e-6, "{name}: {far}");
        }
    }
}

/// A run that begins with another prior goes on from its weights, also with a tokenizer that was trained on, and says with which.
#[test]
fn a_run_can_begin_with_another_prior() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_prior(folder.path());
    let path = folder.path().join("prior.safetensors");
    let first = checkpoint::load(&path).unwrap();
    let args = |more: &str| -> Args {
        let line = "--data @data.mds --tokenizer @tokenizer.safetensors --out @second --log-every 1 --save-every 100";
        testing::args(folder.path(), &format!("{line} {more}"))
    };
    let begun = args("--from @prior.safetensors --steps 2 --set schedule.learning_rate=1e-9 --set sequences=0.3");
    run(&begun).unwrap();
    let second = checkpoint::load(&begun.options.checkpoint()).unwrap();
    let hash = motionette_host::checkpoint::file_hash(&path).unwrap();
    assert_eq!((second.config.begun_with, second.config.sequences), (Some(hash), 0.3));
    assert_eq!(second.sources.vocabulary, first.sources.vocabulary);
    let far = first.parameters.iter().zip(&second.parameters).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(far < 1e-6 && first.parameters != second.parameters, "{far}");
    let other = "--from @prior.safetensors --steps 2 --set architecture.planner.hidden=24 --out @third";
    testing::assert_refused(run(&args(other)), "other sizes");
}

/// Words that no caption holds have numbers, and what is meant is learnt, where there are vectors, phrases and actions.
#[test]
fn words_with_vectors_and_phrases_are_learnt() {
    let folder = tempfile::tempdir().unwrap();
    testing::prepare_tokenizer(folder.path());
    let dataset = Dataset::load(folder.path().join("data.mds")).unwrap();
    testing::with_facts(&dataset, |info| motionette_host::dataset::Facts {
        action: if info.id.ends_with(['1', '3']) { "walk" } else { "kick" }.into(),
        ..testing::facts()
    })
    .save(folder.path().join("data.mds"))
    .unwrap();
    let files = "--phrases ../../docs/phrases.toml --words ../../models/words.safetensors --hold-out ../../docs/prompts-test.jsonl";
    let args = args(folder.path(), &format!("{files} --steps 120 --log-every 10 --save-every 100 --set meaning=1"));
    run(&args).unwrap();
    let points = State::load(&args.options.state_file()).unwrap().curves.points;
    let last = &points[points.len() - 1];
    assert!(last.meaning < 0.7 * points[0].meaning && last.understood > 0.8, "{points:?}");
    let prior = motionette_host::checkpoint::prior::load(&args.options.checkpoint()).unwrap();
    assert_eq!((prior.config.word_vectors, prior.config.vocabulary.len()), (64, 14_021));
    let names: Vec<&str> = prior.config.meanings.iter().map(|meaning| meaning.name.as_str()).collect();
    assert_eq!(names, ["kick", "walk"]);
    // The table is what it was.
    let table = motionette_host::checkpoint::WordTable::read(Path::new("../../models/words.safetensors")).unwrap();
    let motionette_host::checkpoint::prior::WordRows::Vectors(vectors) = &prior.text.table else { panic!("vectors") };
    assert!(vectors.numbers.iter().zip(&table.numbers).all(|(a, b)| *a == f32::from(*b)));
    assert_eq!(vectors.scales, table.scales);
    testing::assert_refused(run(&self::args(folder.path(), "--steps 3 --words @data.mds")), "tensor `hash` not found");
    testing::assert_refused(run(&self::args(folder.path(), "--steps 3 --phrases @data.mds")), "phrases");
    testing::assert_refused(
        run(&self::args(folder.path(), "--steps 3 --hold-out ../../docs/phrases.toml")),
        "not a JSON object",
    );
}

#[test]
fn bad_input_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    assert!(run(&args(folder, "--steps 4")).unwrap_err().is::<motionette_host::dataset::Error>(), "no dataset");
    testing::prepare_tokenizer(folder);
    let refused = |more: &str, what: &str| testing::assert_refused(run(&args(folder, more)), what);
    refused("", "--minutes");
    refused("--steps 4 --preset huge", "huge");
    refused("--steps 4 --set charm=1", "charm");
    refused("--steps 4 --set dropout=1.5", "dropout");
    refused("--steps 4 --set architecture.planner.heads=5", "heads");
    refused("--steps 4 --tokenizer @data.mds", "offsets");
    refused("--steps 4 --resume", "cannot read");
    run(&args(folder, "--steps 4")).unwrap();
    refused("--steps 4 --resume --seed 9", "configuration");
    testing::dataset(11, 48).save(folder.join("data.mds")).unwrap();
    refused("--steps 4 --resume", "dataset");
}
