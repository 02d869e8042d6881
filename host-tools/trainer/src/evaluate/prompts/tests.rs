//! Files of prompts, verdicts on made-up motions, the command on a model of a few steps, and the prompts in `docs`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use motionette_host::dataset::Side;
use motionette_host::detect::{Deed, Direction, Seen};
use motionette_host::import::actions::Actions;
use motionette_host::import::packs;
use motionette_host::import::phrases::Phrases;
use motionette_host::motion::Pose;
use motionette_host::{checkpoint, convert, dataset::Dataset};
use serde_json::{Value, json};

use super::file::{self, Line};
use super::order::{self, Order};
use super::report::{Report, Unseen};
use super::trust::Accuracy;
use super::unseen::{TrainingWords, content_words, stem};
use super::verdict::{Bench, Outcome, Shown, Tally, Verdict};
use crate::evaluate::command::{self, Args};
use crate::evaluate::report::Facts;
use crate::evaluator::tests as evaluator;
use crate::testing;

/// Styles of the packs.
const STYLES: &str = "active angry childish chimpira elderly exhausted feminine giant happy masculine masculinity musical normal \
    not-confident old proud sad tired youthful";

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn table() -> Actions {
    Actions::read(repository().join("docs/actions.toml")).unwrap()
}

fn phrases() -> Phrases {
    Phrases::read(repository().join("docs/phrases.toml")).unwrap()
}

fn styles() -> BTreeSet<String> {
    STYLES.split_whitespace().map(str::to_owned).collect()
}

fn parse(text: &str) -> Result<Vec<Line>, file::Error> {
    file::parse(Path::new("p.jsonl"), text, &table(), &styles())
}

fn line(actions: &[&str], styles: &[&str]) -> Line {
    let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
    Line { number: 1, text: "hop".into(), actions: owned(actions), styles: owned(styles), then: Vec::new() }
}

#[test]
fn lines_are_read_and_bad_ones_named() {
    let lines = parse(
        "# a remark\n\n{\"text\": \"hop\", \"actions\": [\"jump\", \"skip\"]}\n{\"text\": \"\", \"actions\": [\"walk\"], \"styles\": [\"old\"]}\n",
    );
    let lines = lines.unwrap();
    assert_eq!(lines[0], Line { number: 3, ..line(&["jump", "skip"], &[]) });
    assert_eq!((lines[1].number, lines[1].text.as_str(), lines[1].styles.len()), (4, "", 1));
    assert!(lines[0].accepted(&table()).contains("jumping-jacks"));
    let cases = [
        ("", "has no prompts"),
        ("# only a remark", "has no prompts"),
        ("{", "p.jsonl line 1: not a JSON object"),
        ("\n[1]", "line 2: not a JSON object"),
        (r#"{"actions": ["walk"]}"#, "line 1, field \"text\": missing"),
        (r#"{"text": 3, "actions": ["walk"]}"#, "field \"text\": 3 is no text"),
        (r#"{"text": "go"}"#, "field \"actions\": missing"),
        (r#"{"text": "go", "actions": [], "styles": ["old"]}"#, "field \"actions\": empty"),
        (r#"{"text": "go", "actions": [], "then": ["walk"]}"#, "field \"actions\": empty"),
        (r#"{"text": "go", "actions": "walk"}"#, "field \"actions\": \"walk\" is no list of names"),
        (r#"{"text": "go", "actions": [null]}"#, "field \"actions\": null is no name"),
        (r#"{"text": "go", "actions": ["amble"]}"#, "field \"actions\": \"amble\" is no action"),
        (r#"{"text": "go", "actions": ["walk", "walk"]}"#, "field \"actions\": \"walk\" stands twice"),
        (r#"{"text": "go", "actions": ["walk"], "styles": ["grumpy"]}"#, "field \"styles\": \"grumpy\" is no style"),
        (r#"{"text": "go", "actions": ["walk"], "then": ["amble"]}"#, "field \"then\": \"amble\" is no action"),
        (r#"{"text": "go", "actions": ["walk"], "side": "left"}"#, "field \"side\": unknown"),
    ];
    for (text, what) in cases {
        let error = parse(text).unwrap_err().to_string();
        assert!(error.contains(what), "{what}: {error}");
    }
    let missing = file::read(Path::new("/no/such/file"), &table(), &styles()).unwrap_err();
    assert!(missing.to_string().contains("/no/such/file"));
}

#[test]
fn words_are_the_same_in_all_their_forms() {
    for (a, b) in
        [("strolls", "strolling"), ("waving", "wave"), ("hopped", "hops"), ("carries", "carry"), ("slowly", "slow")]
    {
        assert_eq!(stem(a), stem(b), "{a} {b}");
    }
    assert_ne!(stem("bus"), stem("bu"));
    assert_eq!(
        content_words("Could the old man's dog STROLL, please?"),
        BTreeSet::from(["old", "dog", "stroll"].map(stem))
    );
    let mut words = TrainingWords::default();
    words.add("jump", "a person hops on the spot");
    let lines = [line(&["jump"], &[]), line(&["walk"], &[])];
    assert_eq!((words.shared(&lines[0]), words.shared(&lines[1])), (vec!["hop".to_owned()], vec![]));
    assert_eq!((words.unseen_share(&lines), words.unseen_share(&[])), (0.5, 0.0));
    // Templates say `*hop` of a jump, and nothing like it of walking.
    let templates = TrainingWords::templates(&phrases(), &table());
    assert_eq!((templates.shared(&lines[0]), templates.shared(&lines[1])), (vec!["hop".to_owned()], vec![]));
}

fn shown(action: &str, style: &str, deed: Deed, side: Side) -> Shown {
    Shown { action: action.into(), style: style.into(), seen: vec![Seen { deed, side }], order: None }
}

#[test]
fn judges_count_what_is_accepted_and_keep_silent_about_the_rest() {
    let table = table();
    let good = Accuracy { named: true, clips: 10, right: 9 };
    let poor = Accuracy { named: true, clips: 10, right: 8 };
    let accuracies =
        BTreeMap::from([("walk".to_owned(), good), ("jump".to_owned(), poor), ("wave-left-hand".to_owned(), good)]);
    assert!(good.trusted() && !poor.trusted() && !Accuracy { named: false, ..good }.trusted());
    let bench = Bench { table: &table, accuracies: &accuracies, styles: BTreeSet::from(["old"]), seeds: 2 };
    let judge = |line: Line, motions: Vec<Shown>| {
        let outcome = Outcome { line, refused: None, unknown_words: 0, sure: None, motions };
        bench.judge(&outcome)
    };
    let forward = Deed::Walk(Direction::Forward);
    // What the table accepts for walk counts: sneaking to the evaluator, a turn to the detectors.
    let motions = vec![shown("sneak", "old", Deed::WalkTurn, Side::Left), shown("jump", "sad", forward, Side::None)];
    let verdict = judge(line(&["walk"], &["old"]), motions);
    assert_eq!(verdict.evaluator, Some(Tally { met: 1, of: 2 }));
    assert_eq!(verdict.detectors, Some(Tally { met: 2, of: 2 }));
    assert_eq!(verdict.style, Some(Tally { met: 1, of: 2 }));
    assert!(verdict.failed());
    // The other hand is not it.
    let right = vec![shown("wave-left-hand", "", Deed::Wave, Side::Right); 2];
    let verdict = judge(line(&["wave-left-hand"], &[]), right);
    assert_eq!((verdict.evaluator, verdict.detectors), (Some(Tally { met: 2, of: 2 }), Some(Tally { met: 0, of: 2 })));
    // A judge that does not know an action well says nothing of it; nor of a style that it cannot name.
    let verdict = judge(line(&["walk", "jump"], &["sad"]), vec![shown("walk", "sad", forward, Side::None); 2]);
    assert_eq!((verdict.evaluator, verdict.detectors, verdict.style), (None, Some(Tally { met: 2, of: 2 }), None));
    let verdict = judge(line(&["dance"], &[]), vec![shown("walk", "", forward, Side::None); 2]);
    assert!(!verdict.failed() && verdict.evaluator.is_none() && verdict.detectors.is_none());
}

/// The body of a test clip of walking, then the same standing still: the order is seen, and not the other one.
#[test]
fn the_order_of_two_actions_is_seen() {
    let still = |t: usize| motion_of_a_walker(t.min(60));
    let joints: Vec<Pose> = (0..120).map(still).collect();
    let (walk, stand) = (BTreeSet::from(["walk"]), BTreeSet::from(["stand"]));
    assert_eq!(order::of(&joints, &walk, &stand), Order { asked: true, other: false });
    assert_eq!(order::of(&joints, &stand, &walk), Order { asked: false, other: true });
    let backward: Vec<Pose> = joints.into_iter().rev().collect();
    assert!(!order::of(&backward, &walk, &stand).asked);
    for few in 0..3 {
        assert_eq!(order::of(&backward[..few], &walk, &stand), Order { asked: false, other: false });
    }

    let table = table();
    let bench = Bench { table: &table, accuracies: &BTreeMap::new(), styles: BTreeSet::new(), seeds: 2 };
    let seen = |asked, other| Shown {
        order: Some(Order { asked, other }),
        ..shown("walk", "", Deed::Walk(Direction::Forward), Side::None)
    };
    let judge = |then: &str| {
        let line = Line { then: vec![then.into()], ..line(&["walk"], &[]) };
        bench.judge(&Outcome {
            line,
            refused: None,
            unknown_words: 0,
            sure: None,
            motions: vec![seen(true, false), seen(true, true)],
        })
    };
    let verdict = judge("jump");
    assert_eq!((verdict.order, verdict.reversed), (Some(Tally { met: 2, of: 2 }), Some(Tally { met: 1, of: 2 })));
    assert!(!verdict.failed() && verdict.detectors.is_none() && verdict.evaluator.is_none());
    assert_eq!(judge("dance").order, None, "no detector knows dancing");
}

/// A walk along +z, 1 m/s: pelvis, feet that take turns, everything else above the pelvis.
fn motion_of_a_walker(frame: usize) -> Pose {
    let z = frame as f32 / 20.0;
    let swing = (frame as f32 / 3.0).sin();
    std::array::from_fn(|joint| {
        let left = if matches!(joint, 1 | 4 | 7 | 10 | 13 | 16 | 18 | 20) { 1.0 } else { -1.0 };
        match joint {
            0 => [0.0, 0.9, z],
            1 | 2 => [0.1 * left, 0.85, z],
            4 | 5 => [0.1 * left, 0.47, z + 0.1 * left * swing],
            7 | 8 => [0.1 * left, 0.08, z + 0.2 * left * swing],
            10 | 11 => [0.1 * left, 0.02 + 0.05 * (left * swing).max(0.0), z + 0.1 + 0.2 * left * swing],
            16..=21 => [0.2 * left, 1.4 - 0.25 * ((joint - 16) / 2) as f32, z],
            13 | 14 => [0.08 * left, 1.4, z],
            _ => [0.0, 0.9 + 0.05 * joint as f32, z],
        }
    })
}

#[test]
fn shares_are_over_motions_and_refused_prompts_count() {
    let verdict = |met: usize| {
        let tally = Some(Tally { met, of: 3 });
        Verdict {
            evaluator: tally,
            detectors: tally.map(|t| Tally { met: t.met.min(1), ..t }),
            style: None,
            order: None,
            reversed: None,
        }
    };
    let outcome = |action: &str, refused: Option<&str>, unknown_words: u16| Outcome {
        line: line(&[action], &[]),
        refused: refused.map(str::to_owned),
        unknown_words,
        sure: None,
        motions: Vec::new(),
    };
    let outcomes = [
        outcome("walk", None, 0),
        outcome("walk", None, 2),
        outcome("jump", Some("no words"), 0),
        outcome("run", None, 0),
    ];
    let verdicts = [verdict(3), verdict(2), verdict(0), verdict(3)];
    let facts = Facts { seeds: 3, files: Vec::new(), command: "evaluate".into(), generation: json!({}) };
    let accuracies = BTreeMap::from([("walk".to_owned(), Accuracy { named: true, clips: 2, right: 2 })]);
    let report = Report {
        outcomes: &outcomes,
        verdicts: &verdicts,
        accuracies: &accuracies,
        scores: &[],
        unseen: Unseen { captions: 0.5, phrases: 0.25 },
        facts: &facts,
    };
    let value = report.json();
    let number = |path: &str| value.pointer(path).and_then(Value::as_f64).unwrap_or(f64::NAN);
    assert_eq!(number("/judges/evaluator/share"), 8.0 / 12.0);
    assert_eq!(number("/judges/detectors/share"), 3.0 / 12.0);
    assert_eq!((number("/action_share"), number("/unknown_share"), number("/refused_share")), (0.25, 0.25, 0.25));
    assert_eq!((number("/unseen_share"), number("/unseen_phrases_share")), (0.5, 0.25));
    assert!(value["style_share"].is_null() && number("/judges/evaluator/share_ci") > 0.0);
    // Detectors miss two motions of each but the refused prompt, which misses all.
    assert_eq!(value["failed"].as_array().map(Vec::len), Some(4));
    assert_eq!(
        value["rows"][1],
        json!({"name": "run", "prompts": 1, "evaluator": 1.0, "detectors": 1.0 / 3.0, "style": null, "order": null, "reversed": null})
    );
    assert!(value["warned_share"].is_null() && value["caught_share"].is_null(), "nobody was taught");
    let page = report.markdown();
    assert!(page.contains("refused: no words") && page.contains("| walk | 2 | 5/6 | 2/6 | - | - | - |"), "{page}");
}

/// Of nonsense only counts whether it is caught, of everything else only whether it is warned of.
#[test]
fn nonsense_is_caught_or_not() {
    let prompt = |actions: &[&str], sure: Option<bool>, refused: Option<&str>| Outcome {
        line: line(actions, &[]),
        refused: refused.map(str::to_owned),
        unknown_words: u16::from(actions.is_empty()),
        sure,
        motions: Vec::new(),
    };
    let outcomes = [
        prompt(&["walk"], Some(true), None),
        prompt(&["walk"], Some(false), None),
        prompt(&["walk"], None, Some("no words")),
        prompt(&["walk"], Some(true), None),
        prompt(&[], Some(false), None),
        prompt(&[], Some(true), None),
        prompt(&[], None, Some("no words")),
    ];
    let table = table();
    let bench = Bench { table: &table, accuracies: &BTreeMap::new(), styles: BTreeSet::new(), seeds: 1 };
    let verdicts = outcomes.each_ref().map(|outcome| bench.judge(outcome));
    assert_eq!((verdicts[4].evaluator, verdicts[4].detectors, verdicts[4].failed()), (None, None, false));
    let facts = Facts { seeds: 1, files: Vec::new(), command: "evaluate".into(), generation: json!({}) };
    let report = Report {
        outcomes: &outcomes,
        verdicts: &verdicts,
        accuracies: &BTreeMap::new(),
        scores: &[],
        unseen: Unseen { captions: 0.0, phrases: 0.0 },
        facts: &facts,
    };
    assert_eq!((report.warned_share(), report.caught_share()), (Some(0.25), Some(2.0 / 3.0)));
    assert_eq!((report.unknown_share(), report.refused_share()), (0.0, 0.25));
    assert!(report.markdown().contains("| 0.250 | 0.667 |"));
}

/// A model of a few steps says nothing useful, but every kind of prompt ends in a figure and the files are there.
#[test]
fn the_command_judges_generated_motion() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    testing::prepare_prior(folder.path());
    let (tokenizer, prior) = (at("tokenizer.safetensors"), at("prior.safetensors"));
    let (first, second) = (checkpoint::load(&tokenizer).unwrap(), checkpoint::prior::load(&prior).unwrap());
    let card = convert::CardText {
        name: "tiny".into(),
        licence: String::new(),
        data: String::new(),
        checkpoint: String::new(),
    };
    let source = convert::PriorSource { checkpoint: &second, bank: &[], text_encoder: true, control: None, cases: &[] };
    let blob =
        convert::convert_with_prior(&first, Some(source), &convert::Options::PLAIN, &[], &card, |_| ()).unwrap().blob;
    std::fs::write(at("model.blob"), blob.bytes()).unwrap();
    let dataset: Dataset = evaluator::dataset(24, 60);
    dataset.save(at("data.mds")).unwrap();
    evaluator::judge(&dataset, 1).save(&at("evaluator.safetensors"), &Value::Null).unwrap();
    let prompts = "{\"text\": \"walk figure\", \"actions\": [\"walk\"], \"then\": [\"jump\"]}\n\
        {\"text\": \"a figure walks oddly\", \"actions\": [\"walk\"], \"styles\": [\"brisk\"]}\n\
        {\"text\": \"figure\", \"actions\": [\"dance\"]}\n{\"text\": \"\\u0007 \\ud83d\\ude42\", \"actions\": [\"walk\"]}\n\
        {\"text\": \"xyzzy\", \"actions\": [\"jump\"]}\n";
    std::fs::write(at("prompts.jsonl"), prompts).unwrap();
    let [actions, phrases] = ["actions", "phrases"].map(|name| repository().join(format!("docs/{name}.toml")));
    let line = format!(
        "--prompts @prompts.jsonl --data @data.mds --evaluator @evaluator.safetensors --blob @model.blob --actions {} --phrases {} \
         --out @results --seeds 2 --steps 2",
        actions.display(),
        phrases.display()
    );
    let args: Args = testing::args(folder.path(), &line);
    command::run(&args).unwrap();
    let value: Value = serde_json::from_slice(&std::fs::read(at("results/prompts.json")).unwrap()).unwrap();
    assert_eq!((value["prompts"].as_u64(), value["seeds"].as_u64()), (Some(5), Some(2)));
    assert_eq!((value["refused_share"].as_f64(), value["unknown_share"].as_f64()), (Some(0.4), Some(0.4)));
    assert!(value["style_share"].is_f64() && value["order_share"].is_f64() && at("results/prompts.md").is_file());
    std::fs::write(at("prompts.jsonl"), "{\"text\": \"hop\", \"actions\": [\"hop\"]}").unwrap();
    testing::assert_refused(command::run(&args), "prompts.jsonl line 1, field \"actions\": \"hop\" is no action");
    let absent = Args { prompts: Some(at("absent.jsonl")), ..args };
    testing::assert_refused(command::run(&absent), "absent.jsonl");
}

/// `docs/prompts-test.jsonl` is what it claims to be.
#[test]
fn the_prompts_of_the_documentation_are_many_and_different() {
    let lines = file::read(&repository().join("docs/prompts-test.jsonl"), &table(), &styles()).unwrap();
    let texts: BTreeSet<&str> = lines.iter().map(|line| line.text.as_str()).collect();
    let actions: BTreeSet<&str> = lines.iter().flat_map(|line| &line.actions).map(String::as_str).collect();
    let styled = lines.iter().filter(|line| !line.styles.is_empty()).count();
    assert_eq!(texts.len(), lines.len(), "a prompt stands twice");
    assert!(lines.len() >= 300 && actions.len() >= 60 && styled >= 80, "{} {} {styled}", lines.len(), actions.len());
    let shared = std::env::var_os("MOTIONETTE_SHARED").map_or_else(|| repository().join("../shared"), PathBuf::from);
    let folders = ["mocap", "mocap2"].map(|name| shared.join(name)).to_vec();
    if folders.iter().any(|folder| !folder.exists()) {
        eprintln!("skipped: no packs in {}", shared.display());
        return;
    }
    let request = packs::Request { folders, actions: table(), withdraw: Vec::new(), shortest: 8 };
    let dataset = packs::import(&request, &|_, _| ()).unwrap().dataset;
    let known: BTreeSet<String> = dataset.clips.iter().filter_map(|clip| clip.style()).map(str::to_owned).collect();
    assert_eq!(known, styles());
    let share = TrainingWords::captions(&dataset).unseen_share(&lines);
    println!(
        "{} prompts, {} actions, {styled} with a style, {share:.3} without a caption's words",
        lines.len(),
        actions.len()
    );
    assert!(share >= 0.5, "{share}");
}

/// Of every line of `docs/prompts-order.jsonl` the detectors can say whether it is done.
#[test]
fn the_prompts_of_two_actions_can_be_judged() {
    let (table, accuracies) = (table(), BTreeMap::new());
    let lines = file::read(&repository().join("docs/prompts-order.jsonl"), &table, &styles()).unwrap();
    let bench = Bench { table: &table, accuracies: &accuracies, styles: BTreeSet::new(), seeds: 1 };
    let held: BTreeSet<String> =
        file::texts(&repository().join("docs/prompts-test.jsonl")).unwrap().into_iter().collect();
    for line in &lines {
        assert!(!line.then.is_empty() && !held.contains(&line.text), "line {}", line.number);
        let outcome = Outcome { line: line.clone(), refused: None, unknown_words: 0, sure: None, motions: Vec::new() };
        assert_eq!(bench.judge(&outcome).order, Some(Tally { met: 0, of: 1 }), "line {}", line.number);
    }
    assert_eq!(lines.len(), 46);
}

/// And `docs/prompts-nonsense.jsonl` is nonsense.
#[test]
fn the_nonsense_of_the_documentation_asks_for_nothing() {
    let lines = file::read(&repository().join("docs/prompts-nonsense.jsonl"), &table(), &styles()).unwrap();
    assert!(lines.len() == 50 && lines.iter().all(Line::nonsense));
}
