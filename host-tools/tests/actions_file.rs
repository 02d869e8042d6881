//! `docs/actions.toml`: every raw label of both packs has one meaning, and what is wrong in a table is said with its line.

mod common;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use motionette_host::dataset::Side;
use motionette_host::import::actions::{Actions, Error};
use serde_json::Value;

/// Names that results and weights before the table use.
const BEFORE: [&str; 23] = [
    "bow",
    "bye",
    "byebye",
    "call",
    "dance-short",
    "dash",
    "guide",
    "kick",
    "punch",
    "raise-up-both-hands",
    "raise-up-left-hand",
    "raise-up-right-hand",
    "run",
    "slash",
    "walk",
    "walk-back",
    "walk-left",
    "walk-right",
    "walk-turn-left",
    "walk-turn-right",
    "wave-both-hands",
    "wave-left-hand",
    "wave-right-hand",
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn table() -> Actions {
    Actions::read(root().join("docs/actions.toml")).unwrap()
}

/// Subset, named apart as an import of both packs does, and raw label of every clip of the packs; none where the packs are not here.
fn raw_labels() -> Option<Vec<(String, String)>> {
    let mut labels = Vec::new();
    for (number, pack) in ["mocap", "mocap2"].into_iter().enumerate() {
        let text = std::fs::read_to_string(common::shared(pack)?.join("clips.jsonl")).unwrap();
        for line in text.lines() {
            let clip: Value = serde_json::from_str(line).unwrap();
            let subset = match clip["subset"].as_str().unwrap() {
                "cmu" => format!("cmu{}", number + 1),
                other => other.to_owned(),
            };
            let keys = ["content", "action", "cmu_description"];
            let label = keys.iter().find_map(|key| clip["labels"][key].as_str()).unwrap();
            labels.push((subset, label.to_owned()));
        }
    }
    Some(labels)
}

#[test]
fn there_are_60_to_100_actions_and_the_names_in_use_stay() {
    let table = table();
    let names: BTreeSet<&str> = table.actions.iter().map(|action| action.name.as_str()).collect();
    assert_eq!(names.len(), table.actions.len(), "names differ");
    assert!((60..=100).contains(&names.len()), "{}", names.len());
    for name in BEFORE {
        assert!(names.contains(name), "{name}");
        if let Some(meaning) = table.meaning("bnr", name) {
            let side = if name.contains("left") { Side::Left } else { Side::Right };
            assert_eq!(meaning.action(side).as_deref(), Some(name));
        } else {
            panic!("bnr's {name} is not mapped");
        }
    }
}

#[test]
fn every_raw_label_of_both_packs_is_mapped_and_no_other() {
    let Some(labels) = raw_labels() else { return };
    let table = table();
    assert_eq!(labels.len(), 3158 + 2520);
    let found: BTreeSet<(&str, &str)> =
        labels.iter().map(|(subset, label)| (subset.as_str(), label.as_str())).collect();
    let mapped: BTreeSet<(&str, &str)> = table.labels().collect();
    assert_eq!(found, mapped);
}

#[test]
fn sided_names_come_in_pairs_and_their_mirror_images_accept_alike() {
    let table = table();
    let mut pairs = 0;
    for action in table.actions.iter().filter(|action| action.name.contains("left")) {
        let twin = table.find(&action.name.replace("left", "right")).expect("the right form");
        assert_eq!(twin.words, action.words);
        assert_eq!(twin.accept.len(), action.accept.len(), "{}", action.name);
        pairs += 1;
    }
    assert!(pairs >= 8, "{pairs}");
    let walk = table.find("walk-turn-left").unwrap();
    assert!(walk.accept.contains(&"turn-left".to_owned()) && !walk.accept.contains(&"turn-right".to_owned()));
}

#[test]
fn what_is_wrong_is_said_with_its_line() {
    let good = "[subset.a]\nlicence = \"x\"\n[[action]]\nname = \"wave-{side}\"\nside = \"hand\"\nwords = [\"wave\"]\n\
                [action.labels]\na = [\"w\"]\n";
    let table = Actions::parse(Path::new("t"), good).unwrap();
    assert_eq!(table.actions.len(), 2);
    let meaning = table.meaning("a", "w").unwrap();
    assert_eq!(meaning.action(Side::Left).as_deref(), Some("wave-left"));
    assert_eq!(meaning.action(Side::None), None);

    let second = "[[action]]\nname = \"b\"\nwords = [\"w\"]\n[action.labels]\n";
    let cases: [(String, usize, &str); 8] = [
        (format!("{good}{}", second.replace("\"b\"", "\"wave-left\"")), 10, "two actions"),
        (format!("{good}{second}a = [\"w\"]\n"), 13, "belongs to"),
        (format!("{good}{second}c = [\"w\"]\n"), 13, "no [subset.c]"),
        (good.replace("wave-{side}", "Wave {side}"), 4, "other characters"),
        (good.replace("[\"wave\"]", "[]"), 6, "must be one or more"),
        (good.replace("[\"wave\"]", "[\"wave\", \"Wave\"]"), 6, "must be one or more"),
        (good.replace("side = \"hand\"", "side = \"both\""), 8, "has no side"),
        (good.replace("words", "accept = [\"fly\"]\nwords"), 6, "which is no other action"),
    ];
    for (text, line, what) in cases {
        match Actions::parse(Path::new("t"), &text).unwrap_err() {
            Error::Entry { line: found, problem, .. } => {
                assert!(problem.contains(what) && found == line, "line {found}: {problem}");
            }
            other => panic!("{what}: {other}"),
        }
    }
    for text in ["", "no table", &good.replace("words", "wrods"), &good.replace("\"hand\"", "\"foot\"")] {
        assert!(matches!(Actions::parse(Path::new("t"), text), Err(Error::Syntax { .. })), "{text}");
    }
    assert!(matches!(Actions::read("no/such/actions.toml"), Err(Error::Read { .. })));
}
