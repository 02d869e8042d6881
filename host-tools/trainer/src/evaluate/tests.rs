//! Tables of known motions.

use std::path::Path;

use motionette_host::dataset::{self, Dataset, Side, Split};
use motionette_host::motion::FEATURES;
use motionette_host::{checkpoint, convert, metrics};

use super::Error;
use super::codec::Codec;
use super::figures::{METRICS, Row, Yardstick};
use super::prior::{Bench, Generate};
use super::prompt::{MAX_TOKENS, Motion, Prompt, prompts};
use super::report::{self, Facts};
use super::sample::{Judged, Sample};
use super::{command, generators, real};
use crate::evaluator::tests as evaluator;
use crate::harness::Run;
use crate::random::Random;
use crate::tokenizer::checkpoint::Checkpoint;
use crate::tokenizer::config::Config;
use crate::tokenizer::state::State;
use crate::tokenizer::training::Trainer;
use crate::{prior, testing};

/// A tokenizer of a few steps.
fn tokenizer(dataset: &Dataset) -> Checkpoint {
    let config = Config::preset("tiny").unwrap();
    let trainer = Trainer::new(&config, dataset).unwrap();
    let mut run = Run::new(trainer, State::begin(&config, &dataset.hash)).unwrap();
    (0..5).for_each(|_| drop(run.step().unwrap()));
    run.training.checkpoint(&run.state).unwrap()
}

fn mean(row: &Row, metric: &str) -> f64 {
    row.figures[metric].mean
}

/// 240 prompts of 40 labels. Sentences are points in 8 dimensions, motions lie near the sentences of their labels.
fn example(noise: f64) -> (Yardstick, Sample) {
    let mut random = Random::new(9, 0);
    let mut point = |scale: f64| -> Vec<f64> { (0..8).map(|_| scale * random.symmetric()).collect() };
    let centres: Vec<Vec<f64>> = (0..40).map(|_| point(1.0)).collect();
    let mut near =
        |label: usize| -> Vec<f64> { point(noise).iter().zip(&centres[label]).map(|(x, c)| x + c).collect() };
    let prompt = |i: usize| Prompt {
        clip: i,
        caption: String::new(),
        content: format!("content{}", i % 10),
        style: Some(format!("style{}", i % 40 / 10)),
        label: i % 40,
        tokens: 20,
    };
    let prompts: Vec<Prompt> = (0..240).map(prompt).collect();
    let seeds = (0..4)
        .map(|_| {
            let judged = |p: &Prompt| Judged {
                embedding: near(p.label),
                content: p.content.clone(),
                style: p.style.clone().unwrap_or_default(),
                foot_skating: 0.25,
                near_copy: p.clip < 24,
                controlled: None,
            };
            prompts.iter().map(judged).collect()
        })
        .collect();
    let real = prompts.iter().map(|p| near(p.label)).collect();
    let texts = prompts.iter().map(|p| centres[p.label].clone()).collect();
    (Yardstick { prompts, texts, real, rounds: 4 }, Sample::new("made", seeds))
}

#[test]
fn motions_near_their_sentences_score() {
    let (yardstick, sample) = example(0.01);
    let row = yardstick.measure(&sample, &(0..240).collect::<Vec<_>>());
    assert_eq!(row.figures.len(), METRICS.len());
    for metric in ["action_accuracy", "style_accuracy", "top1", "top2", "top3"] {
        assert_eq!((mean(&row, metric), row.figures[metric].half_width), (1.0, 0.0), "{metric}");
    }
    assert!((mean(&row, "near_copies") - 0.1).abs() < 1e-12);
    assert!((mean(&row, "foot_skating") - 0.25).abs() < 1e-12);
    // Uniform in +-0.01 in eight dimensions: mean squares 8 / 3 e-4 and, of differences, twice that.
    let spread = (8.0f64 / 3.0).sqrt() * 0.01;
    assert!((mean(&row, "mm_dist") / spread - 1.0).abs() < 0.05);
    assert!((mean(&row, "multimodality") / (2f64.sqrt() * spread) - 1.0).abs() < 0.05);
    assert!(mean(&row, "fid") < 1e-3, "{}", mean(&row, "fid"));
    assert!(mean(&row, "diversity") > 1.0);
}

/// The control: everything that looks at text is at chance, everything else as before.
#[test]
fn shuffled_text_is_at_chance() {
    let (yardstick, sample) = example(0.3);
    let members: Vec<usize> = (0..240).collect();
    let plain = yardstick.measure(&sample, &members);
    // Two permutations in one: labels are uniform, so a random one hits its own label in 1 of 40.
    let mut order = members.clone();
    let mut random = Random::new(4, 0);
    (1..240).rev().for_each(|i| order.swap(i, random.below(i + 1)));
    let row = yardstick.measure(&sample.shuffled("shuffled_text", order), &members);
    for (metric, chance) in [
        ("action_accuracy", 0.1),
        ("style_accuracy", 0.25),
        ("top1", 1.0 / 32.0),
        ("top2", 2.0 / 32.0),
        ("top3", 3.0 / 32.0),
    ] {
        let figure = row.figures[metric];
        assert!((figure.mean - chance).abs() < 2.0 * figure.half_width + 0.01, "{metric}: {figure:?}");
        assert!(mean(&plain, metric) > 3.0 * chance, "{metric}");
    }
    for metric in ["fid", "diversity", "foot_skating", "multimodality"] {
        assert_eq!(mean(&row, metric), mean(&plain, metric), "{metric}");
    }
}

#[test]
fn a_choice_of_prompts_counts_alone() {
    let (yardstick, sample) = example(0.3);
    let first: Vec<usize> = (0..24).collect();
    let row = yardstick.measure(&sample, &first);
    assert_eq!(mean(&row, "near_copies"), 1.0);
    // One seed: multimodality is within labels, and here no two prompts share one.
    let single = Sample::new("single", sample.motions[..1].to_vec());
    let mut apart = example(0.3).0;
    apart.prompts.iter_mut().enumerate().for_each(|(i, prompt)| prompt.label = i);
    assert!(!apart.measure(&single, &first).figures.contains_key("multimodality"));
    assert!(yardstick.measure(&single, &first).figures.contains_key("multimodality"));
    let independent = Sample { independent: Some(vec![yardstick.real.clone()]), ..single };
    assert!(mean(&yardstick.measure(&independent, &first), "fid") < 1e-9);
}

#[test]
fn prompts_are_of_scored_actions_with_and_without_a_style() {
    let plain = testing::dataset(24, 60);
    let facts = |scored: bool, style: Option<&str>, side: Side| dataset::Facts {
        action: "kick".into(),
        side,
        style: style.map(str::to_owned),
        scored,
        ..testing::facts()
    };
    let dataset = testing::with_facts(&plain, |info| match info.id.as_str() {
        "figure5" => facts(true, Some("proud"), Side::Left),
        "figure11" => facts(true, None, Side::Left),
        "figure17" => facts(true, None, Side::Right),
        _ => facts(false, None, Side::Left),
    });
    let found = prompts(&dataset, Split::Test);
    let names: Vec<(&str, Option<&str>)> =
        found.iter().map(|p| (dataset.clips[p.clip].id.as_str(), p.style.as_deref())).collect();
    assert_eq!(names, [("figure5", Some("proud")), ("figure11", None), ("figure17", None)]);
    assert_eq!(found.iter().map(|p| p.label).collect::<Vec<_>>(), [0, 1, 2], "a side is part of a label");
    assert!(found.iter().all(|p| p.content == "kick"));
}

#[test]
fn real_motion_is_measured_with_the_share_of_known_actors() {
    let plain = evaluator::dataset(24, 60);
    let judge = evaluator::judge(&plain, 2);
    let report = real::measure(&judge, &plain, Split::Test).unwrap();
    assert!(report.known_actor.is_none() && !report.to_string().contains("known"));
    let dataset = testing::with_facts(&plain, |info| dataset::Facts {
        action: info.action().unwrap().to_owned(),
        style: info.style().filter(|style| *style == "calm").map(str::to_owned),
        known_actor: info.id != "figure5",
        ..testing::facts()
    });
    let told = real::measure(&judge, &dataset, Split::Test).unwrap();
    assert_eq!((told.clips, told.known_actor), (4, Some(0.75)));
    assert!(told.to_string().ends_with("75 % known actors"), "{told}");
    assert_eq!(told.action_accuracy, report.action_accuracy);
    // Half of the clips have a style now; it is right for all of them or for none.
    let calm = prompts(&dataset, Split::Test).into_iter().filter(|prompt| prompt.style.is_some());
    let right = calm.clone().filter(|p| judge.motion(dataset.clip(p.clip).joints).unwrap().style == "calm").count();
    assert_eq!(told.style_accuracy, right as f64 / calm.count() as f64);
}

#[test]
fn styles_count_where_a_prompt_has_one() {
    let (mut yardstick, sample) = example(0.3);
    let members: Vec<usize> = (0..240).collect();
    for prompt in &mut yardstick.prompts[..120] {
        prompt.style = None;
    }
    assert_eq!(mean(&yardstick.measure(&sample, &members), "style_accuracy"), 1.0);
    yardstick.prompts.iter_mut().for_each(|prompt| prompt.style = None);
    assert!(!yardstick.measure(&sample, &members).figures.contains_key("style_accuracy"));
}

#[test]
fn real_motion_is_as_long_as_the_prompt_says() {
    let dataset = evaluator::dataset(24, 80);
    let codec = Codec::new(tokenizer(&dataset));
    let own = prompts(&dataset, Split::Test);
    assert_eq!(own.len(), 4);
    let long: Vec<Prompt> = own.iter().map(|p| Prompt { tokens: MAX_TOKENS, ..p.clone() }).collect();
    for (prompts, seed) in [(&own, 0), (&long, 0), (&long, 1)] {
        let motions = match seed {
            0 => real::motions(&dataset, prompts, &codec).unwrap(),
            _ => real::resampled(&dataset, prompts, seed, &codec).unwrap(),
        };
        for (motion, prompt) in motions.iter().zip(prompts) {
            assert_eq!((motion.tokens.len(), motion.joints.len()), (prompt.tokens, 4 * prompt.tokens));
            assert_eq!(codec.decode(&motion.tokens).len(), motion.joints.len());
            assert!(motion.joints.as_flattened().as_flattened().iter().all(|x| x.is_finite()));
        }
    }
    let clip = dataset.clip(own[0].clip);
    let whole = codec.encode(&clip.features[..own[0].tokens * 4 * FEATURES]);
    assert_eq!(real::motions(&dataset, &own, &codec).unwrap()[0].tokens, whole);
    assert_eq!(own[0].content, clip.info.labels["content"]);
    assert!(codec.encode(&[]).is_empty() && codec.decode(&[]).is_empty());
}

#[test]
fn a_table_has_all_rows_and_says_what_failed() {
    let mut dataset = evaluator::dataset(24, 80);
    dataset.clips[5].subset = "other".into();
    let judge = evaluator::judge(&dataset, 2);
    let codec = Codec::new(tokenizer(&dataset));
    let random_tokens = |prompt: &Prompt, seed: u64| {
        let mut random = Random::new(seed, prompt.clip as u64);
        let tokens: Vec<u16> = (0..prompt.tokens).map(|_| random.below(8) as u16).collect();
        Ok(Motion { joints: codec.decode(&tokens), tokens })
    };
    let failing = |prompt: &Prompt, seed: u64| match seed {
        0 => random_tokens(prompt, seed),
        _ => anyhow::bail!("out of luck"),
    };
    let run = |generators: &[(&str, Box<Generate<'_>>)]| {
        let bench =
            Bench { judge: &judge, codec: &codec, dataset: &dataset, training: &[vec![0; 60]], generators, seeds: 2 };
        bench.tables(3, &|_| ())
    };
    let tables = run(&[("reference", Box::new(random_tokens)), ("runtime", Box::new(random_tokens))]).unwrap();
    let names = |rows: &[Row]| rows.iter().map(|row| row.name.clone()).collect::<Vec<_>>();
    for rows in [&tables.all, &tables.short, &tables.long] {
        assert_eq!(names(rows), ["real", "tokenizer", "reference", "runtime", "shuffled_text"]);
        assert_eq!(rows[2].figures, rows[3].figures, "the same motions");
    }
    assert_eq!(tables.prompts, [3, 3, 1], "9.8 s are made for one prompt of four");
    assert_eq!(tables.clips, "3 clips of the test split (2 of `figure`, 1 of `other`)");
    let subsets: Vec<(&str, usize)> = tables.subsets.iter().map(|s| (s.name.as_str(), s.prompts)).collect();
    assert_eq!(subsets, [("figure", 2), ("other", 1)]);
    assert_eq!(names(&tables.subsets[1].rows), ["real", "tokenizer", "reference", "runtime"]);
    for (whole, row) in tables.all.iter().zip(&tables.subsets[0].rows) {
        // Means over two and one of three prompts.
        let parts = [row, tables.subsets[1].rows.iter().find(|other| other.name == row.name).unwrap()];
        let sum = 2.0 * mean(parts[0], "action_accuracy") + mean(parts[1], "action_accuracy");
        assert!((sum / 3.0 - mean(whole, "action_accuracy")).abs() < 1e-12);
        assert!(!row.figures.contains_key("fid"));
    }

    let facts =
        Facts { seeds: 2, files: vec![("a".into(), "b".into())], command: "make".into(), generation: "x".into() };
    let folder = tempfile::tempdir().unwrap();
    report::save(folder.path(), &tables, &facts).unwrap();
    let page = std::fs::read_to_string(folder.path().join("prior.md")).unwrap();
    assert!(
        page.contains("| runtime |")
            && page.contains("One caption for each of 3 clips of the test split (2 of `figure`, 1 of `other`)")
            && page.contains("| `other` | 1 | ")
            && page.contains("`runtime` within the interval of `reference` on every figure: reached")
    );
    let data: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("prior.json")).unwrap()).unwrap();
    assert_eq!(data["table"], "prior");
    assert_eq!(data["rows"][2]["name"], "reference");
    for metric in METRICS {
        let mean = data["rows"][2][metric].as_f64().unwrap();
        let half_width = data["rows"][2][format!("{metric}_ci")].as_f64().unwrap();
        assert!(mean.is_finite() && half_width.is_finite() && half_width >= 0.0, "{metric}");
    }
    let error = run(&[("runtime", Box::new(failing))]).unwrap_err();
    assert!(matches!(&error, Error::Generate { seed: 1, row, .. } if row == "runtime"), "{error}");
}

/// The options as the command line has them without flags.
fn options() -> generators::Options {
    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        options: generators::Options,
    }
    <Line as clap::Parser>::parse_from(["test"]).options
}

#[test]
fn flags_are_written_when_they_differ() {
    assert_eq!(options().flags(), "");
    let changed = generators::Options {
        steps: 20,
        schedule: generators::Times::Cosine,
        guidance: 1.5,
        proposal: generators::Proposal::Gumbel,
        temperature: 0.5,
        top_k: 9,
        top_p: 0.75,
    };
    let flags =
        " --steps 20 --schedule cosine --guidance 1.5 --proposal gumbel --temperature 0.5 --top-k 9 --top-p 0.75";
    assert_eq!(changed.flags(), flags);
}

/// Reference and runtime on a prior of a few steps: what they say agrees with the trainer's own decoder, and replays.
#[test]
fn generators_replay_and_agree_with_the_decoder() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let dataset = evaluator::dataset(24, 60);
    dataset.save(at("data.mds")).unwrap();
    let tokens = tokenizer(&dataset);
    tokens.save(&at("tokenizer.safetensors"), &[]).unwrap();
    let line = "--data @data.mds --tokenizer @tokenizer.safetensors --out @prior --preset tiny --steps 2";
    prior::command::run(&testing::args(folder.path(), line)).unwrap();
    let (tokenizer, prior) = (at("tokenizer.safetensors"), at("prior.safetensors"));
    let (first, second) = (checkpoint::load(&tokenizer).unwrap(), checkpoint::prior::load(&prior).unwrap());
    let blob = |hash: String| {
        let card =
            convert::CardText { name: "tiny".into(), licence: String::new(), data: String::new(), checkpoint: hash };
        let source =
            convert::PriorSource { checkpoint: &second, bank: &[], text_encoder: true, control: None, cases: &[] };
        let options = &convert::Options::PLAIN;
        convert::convert_with_prior(&first, Some(source), options, &[], &card, |_| ()).unwrap().blob
    };
    let hash = |path| checkpoint::file_hash(path).unwrap();
    std::fs::write(at("model.blob"), blob(format!("{}+{}", hash(&tokenizer), hash(&prior))).bytes()).unwrap();
    std::fs::write(at("other.blob"), blob(hash(&tokenizer)).bytes()).unwrap();

    let codec = Codec::new(tokens);
    let reference = generators::reference(&prior, &tokenizer, options()).unwrap();
    let files: [&Path; 2] = [&tokenizer, &prior];
    let runtime = generators::runtime(&at("model.blob"), &files, options()).unwrap();
    let prompts = prompts(&dataset, Split::Test);
    for (generate, tolerance) in [(&reference, 1e-3), (&runtime, 0.1)] {
        let mut different = 0;
        for prompt in &prompts {
            let motion = generate(prompt, 3).unwrap();
            assert_eq!((motion.tokens.len(), motion.joints.len()), (prompt.tokens, 4 * prompt.tokens));
            assert_eq!(generate(prompt, 3).unwrap(), motion);
            different += usize::from(generate(prompt, 4).unwrap().tokens != motion.tokens);
            let decoded = codec.decode(&motion.tokens);
            let error = metrics::mpjpe_root_aligned(&decoded, &motion.joints);
            assert!(error < tolerance, "{error} m");
        }
        assert!(different > 0);
    }
    let wordless = Prompt { caption: "?".into(), ..prompts[0].clone() };
    assert!(reference(&wordless, 0).is_err() && runtime(&wordless, 0).is_err());
    let error = generators::runtime(&at("other.blob"), &files, options()).err().unwrap();
    assert!(error.to_string().contains("was not made of"), "{error}");
}

#[test]
fn bad_input_is_refused_and_leaves_no_table() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let args = command::Args {
        table: Some(command::Table::Prior),
        prompts: None,
        actions: at("actions.toml"),
        phrases: at("phrases.toml"),
        data: at("data.mds"),
        evaluator: at("evaluator.safetensors"),
        tokenizer: at("tokenizer.safetensors"),
        prior: at("prior.safetensors"),
        blob: at("model.blob"),
        generate: vec![command::Origin::None],
        generation: options(),
        out: at("results"),
        seeds: Some(2),
        limit: Some(2),
        control: Vec::new(),
        store: at("store.jsonl"),
        scenes: "scenes.jsonl".into(),
        instructions_per_mac: 5.5,
        json: true,
    };
    let refused = |what: &str| {
        let error = format!("{:#}", command::run(&args).unwrap_err());
        assert!(error.contains(what), "{what}: {error}");
        assert!(!args.out.exists());
    };
    refused("data.mds");
    let dataset = evaluator::dataset(24, 60);
    dataset.save(&args.data).unwrap();
    refused("evaluator.safetensors");
    evaluator::judge(&dataset, 1).save(&args.evaluator, &serde_json::Value::Null).unwrap();
    refused("tokenizer.safetensors");
    tokenizer(&dataset).save(&args.tokenizer, &[]).unwrap();
    command::run(&args).unwrap();
    let wanting = |origin, what: &str| {
        let error = command::run(&command::Args { generate: vec![origin], ..args.clone() }).unwrap_err();
        assert!(format!("{error:#}").contains(what), "{error:#}");
    };
    wanting(command::Origin::Reference, "prior.safetensors");
    wanting(command::Origin::Runtime, "model.blob");
    assert!(args.out.join("prior.md").is_file() && args.out.join("prior.json").is_file());
}
