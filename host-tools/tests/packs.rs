//! Several packs in one dataset: subsets, splits, sides, broken frames, figures; on made-up packs, and on the real ones where they are.

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use common::motions::standing;
use half::f16;
use motionette_host::dataset::{Clip, Dataset, Quality, Side, Split};
use motionette_host::import::actions::{Actions, SideRule};
use motionette_host::import::packs::{self, Imported, Request, Row};
use motionette_host::import::{Summary, pack};
use motionette_host::motion::features::Options;
use motionette_host::motion::uniform::BONE_LENGTHS;
use motionette_host::motion::{FEATURES, JOINTS, Pose, skeleton};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::{Value, json};

const TABLE: &str = r#"
[subset.a]
licence = "A"
val_actor = "2"
[subset.s1]
licence = "S"
[subset.s2]
licence = "S"
[subset.gone]
licence = "none"
card = false
withdrawn = true
[[action]]
name = "jump"
words = ["jump"]
[action.labels]
a = ["Hop"]
s1 = ["hop"]
gone = ["hop"]
[[action]]
name = "wave-{side}-hand"
side = "hand"
words = ["wave"]
[action.labels]
a = ["Wave", { label = "WaveLeft", side = "name" }]
s2 = [{ label = "wave", side = "name" }]
"#;

/// A body that shifts from foot to foot and waves; `hand` is the wrist that moves.
fn waving(frames: usize, hand: usize) -> Vec<Pose> {
    let pose = |t: usize| {
        let mut pose = standing();
        pose.iter_mut().for_each(|p| p[0] += 0.01 * (0.2 * t as f32).sin());
        pose[hand][1] += 0.1 * (0.7 * t as f32).sin();
        pose
    };
    (0..frames).map(pose).collect()
}

fn line(id: &str, subset: &str, split: &str, labels: Value, frames: usize) -> Value {
    json!({"id": id, "subset": subset, "source": "made up", "src_fps": 30, "split": split, "labels": labels, "n_frames": frames,
        "captions": [{"text": "whole", "f": 0.0, "t": 0.0, "src": "x"}, {"text": "early", "f": 0.0, "t": 0.3, "src": "x"},
            {"text": "late", "f": 0.5, "t": 9.0, "src": "x"}]})
}

fn write_pack(folder: &Path, clips: &[(Value, Vec<Pose>)]) {
    fs::create_dir_all(folder).unwrap();
    let text: Vec<String> = clips.iter().map(|(line, _)| line.to_string()).collect();
    fs::write(folder.join("clips.jsonl"), text.join("\n")).unwrap();
    let all: Vec<Pose> = clips.iter().flat_map(|(_, joints)| joints.clone()).collect();
    let local: Vec<u8> = all
        .iter()
        .flat_map(|pose| pose.map(|[x, y, z]| [x - pose[0][0], y, z - pose[0][2]]))
        .flatten()
        .flat_map(|x| f16::from_f32(x).to_le_bytes())
        .collect();
    let root: Vec<u8> = all.iter().flat_map(|pose| [pose[0][0], pose[0][2]]).flat_map(f32::to_le_bytes).collect();
    let mut offsets = vec![0i32];
    clips.iter().for_each(|(_, joints)| offsets.push(offsets[offsets.len() - 1] + joints.len() as i32));
    let offsets: Vec<u8> = offsets.iter().flat_map(|x| x.to_le_bytes()).collect();
    let tensors = [
        ("local", TensorView::new(Dtype::F16, vec![all.len(), JOINTS, 3], &local).unwrap()),
        ("root_xz", TensorView::new(Dtype::F32, vec![all.len(), 2], &root).unwrap()),
        ("offsets", TensorView::new(Dtype::I32, vec![clips.len() + 1], &offsets).unwrap()),
    ];
    fs::write(folder.join("joints.safetensors"), safetensors::serialize(tensors, None).unwrap()).unwrap();
}

const LEFT_WRIST: usize = 20;
const RIGHT_WRIST: usize = 21;

/// Two packs that share the subset `s`.
fn two_packs(folder: &Path) -> Request {
    let hop = || json!({"action": "hop"});
    let still = |frames| waving(frames, RIGHT_WRIST);
    let mut first = vec![
        (line("actor1", "a", "train", json!({"action": "Hop", "actor": 1, "style": "proud"}), 40), still(40)),
        (
            line("actor2", "a", "train", json!({"action": "Wave", "actor": 2, "quality": "kinect"}), 40),
            waving(40, LEFT_WRIST),
        ),
        (line("actor2test", "a", "test", json!({"action": "Wave", "actor": 2, "hand": "left"}), 40), still(40)),
        (line("actor1test", "a", "test", json!({"action": "WaveLeft", "actor": 1}), 40), still(40)),
        (line("withdrawn", "gone", "train", hop(), 40), still(40)),
    ];
    for take in 0..12 {
        for window in 0..2 {
            let id = format!("take{take}_w{window}");
            first.push((line(&id, "s", "train", json!({"action": "hop", "quality": "optical"}), 20), still(20)));
        }
    }
    // 1 m in one frame is 20 m/s: after frame 30 of 40, and after frame 20.
    let jumping = |at: usize| {
        let mut motion = still(40);
        motion[at..].iter_mut().flatten().for_each(|p| p[2] += 1.0);
        motion
    };
    let second = vec![
        (line("cut", "s", "val", json!({"action": "wave", "name": "M_WaveRight_1"}), 40), jumping(30)),
        (line("dropped", "s", "train", json!({"action": "wave", "name": "M_WaveRight_1"}), 40), jumping(20)),
    ];
    write_pack(&folder.join("one"), &first);
    write_pack(&folder.join("two"), &second);
    Request {
        folders: vec![folder.join("one"), folder.join("two")],
        actions: Actions::parse(Path::new("table.toml"), TABLE).unwrap(),
        withdraw: Vec::new(),
        shortest: 8,
    }
}

fn import(request: &Request) -> Imported {
    packs::import(request, &|_, _| ()).unwrap()
}

fn clip<'d>(dataset: &'d Dataset, id: &str) -> &'d Clip {
    dataset.clips.iter().find(|clip| clip.id == id).expect(id)
}

fn row<'r>(imported: &'r Imported, name: &str) -> &'r Row {
    imported.report.rows.iter().find(|row| row.name == name).expect(name)
}

#[test]
fn clips_carry_action_side_quality_licence_and_actor() {
    let folder = tempfile::tempdir().unwrap();
    let request = two_packs(folder.path());
    let imported = import(&request);
    let facts = |id: &str| clip(&imported.dataset, id).facts.clone().unwrap();
    let waves = facts("actor2");
    assert_eq!((waves.action.as_str(), waves.side, waves.quality), ("wave-left-hand", Side::Left, Quality::Kinect));
    assert!(clip(&imported.dataset, "actor2").synthetic_legs() && !clip(&imported.dataset, "actor1").synthetic_legs());
    // The pack's word goes before what the joints show.
    assert_eq!(facts("actor2test").side, Side::Left);
    assert_eq!((facts("actor1test").side, facts("cut").side), (Side::Left, Side::Right));
    assert_eq!((facts("actor1").action.as_str(), facts("actor1").side), ("jump", Side::None));
    assert_eq!((facts("actor1").style.as_deref(), facts("actor1").licence.as_str()), (Some("proud"), "A"));
    assert_eq!((facts("actor1").actor.as_deref(), facts("cut").actor), (Some("a/1"), None));
    // Actor 2 is held out, so the test clip is of somebody new; who is not named may be known.
    assert_eq!(clip(&imported.dataset, "actor2").split, Split::Val);
    assert!(!facts("actor2test").known_actor && facts("actor1test").known_actor && facts("cut").known_actor);
    // 25 clips jump in train, none waves.
    assert!(facts("actor1").scored && !facts("actor2test").scored);
    let (twin, none) = (clip(&imported.dataset, "actor1test"), clip(&imported.dataset, "actor1"));
    assert_eq!((twin.action(), twin.style(), twin.scored()), (Some("wave-left-hand"), None, false));
    assert_eq!((none.action(), none.style(), none.side()), (Some("jump"), Some("proud"), Side::None));
}

#[test]
fn subsets_are_named_apart_and_whole_takes_are_held_out() {
    let folder = tempfile::tempdir().unwrap();
    let request = two_packs(folder.path());
    let imported = import(&request);
    let subsets: BTreeSet<&str> = imported.dataset.clips.iter().map(|clip| clip.subset.as_str()).collect();
    assert_eq!(subsets, BTreeSet::from(["a", "s1", "s2"]));
    // 5 % of 12 takes: one, with both of its windows.
    let val: Vec<&Clip> =
        imported.dataset.clips.iter().filter(|clip| clip.subset == "s1" && clip.split == Split::Val).collect();
    assert_eq!(val.len(), 2);
    assert_eq!(val[0].id.split_once('_').unwrap().0, val[1].id.split_once('_').unwrap().0);
    assert_eq!(import(&request).dataset, imported.dataset, "the same every time");
    let all = row(&imported, "all");
    assert_eq!((all.train, all.val, all.test, all.clips), (23, 4, 2, 29));
    // Two windows of s1 and the clip of s2; the test clip of actor 1. Not actor 2.
    assert_eq!((all.known_actor, row(&imported, "a").known_actor), (4, 1));
}

#[test]
fn takes_that_an_action_needs_are_not_held_out() {
    let folder = tempfile::tempdir().unwrap();
    let request = two_packs(folder.path());
    let clips: Vec<(Value, Vec<Pose>)> = (0..5)
        .map(|n| (line(&format!("c{n}"), "s1", "train", json!({"action": "hop"}), 20), waving(20, RIGHT_WRIST)))
        .collect();
    let val = |count: usize| {
        write_pack(&folder.path().join("few"), &clips[..count]);
        let imported = import(&Request { folders: vec![folder.path().join("few")], ..request.clone() });
        (row(&imported, "s1").val, clip(&imported.dataset, "c0").scored())
    };
    assert_eq!(val(5), (0, true));
    assert_eq!(val(4), (0, false));
}

#[test]
fn withdrawn_subsets_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let request = two_packs(folder.path());
    let imported = import(&request);
    assert!(imported.dataset.clips.iter().all(|clip| clip.subset != "gone"));
    assert!(imported.summary.notes.iter().any(|note| note.text.contains("gone is withdrawn")));
    let less = import(&Request { withdraw: vec!["a".into(), "s2".into()], ..request.clone() });
    assert!(less.dataset.clips.iter().all(|clip| clip.subset == "s1") && less.dataset.clips.len() == 24);
    for clip in &less.dataset.clips {
        let before = imported.dataset.clips.iter().find(|other| other.id == clip.id).unwrap();
        assert_eq!(clip.split, before.split, "{}: the split of a subset does not depend on the others", clip.id);
    }
    let wrong = packs::import(&Request { withdraw: vec!["b".into()], ..request }, &|_, _| ()).unwrap_err();
    assert!(matches!(wrong, packs::Error::Subset { ref subset, .. } if subset == "b"), "{wrong}");
}

#[test]
fn broken_frames_are_cut_where_most_is_left_and_listed() {
    let folder = tempfile::tempdir().unwrap();
    let imported = import(&two_packs(folder.path()));
    assert_eq!(imported.report.cut.len(), 1);
    let cut = &imported.report.cut[0];
    assert_eq!((cut.id.as_str(), cut.from, cut.to, cut.frames), ("cut", 0, 30, 40));
    let Summary { skipped, .. } = &imported.summary;
    assert!(skipped.len() == 1 && skipped[0].id == "dropped" && skipped[0].reason.contains("12 m/s"), "{skipped:?}");
    let s2 = row(&imported, "s2");
    assert_eq!((s2.clips, s2.clips_dropped, s2.frames_dropped), (1, 1, 10 + 40));
    let captions = &clip(&imported.dataset, "cut").captions;
    let times: Vec<(&str, f64, f64)> = captions.iter().map(|c| (c.text.as_str(), c.from, c.to)).collect();
    assert_eq!(times, [("whole", 0.0, 0.0), ("early", 0.0, 0.3), ("late", 0.5, 1.5)]);

    // The longest stretch without a fast step, and the first of equals.
    let at = |x: &[f32]| -> Vec<Pose> { x.iter().map(|x| standing().map(|[px, y, z]| [px + x, y, z])).collect() };
    assert_eq!(packs::longest_slow_run(&at(&[0.0, 1.0, 1.0, 1.5, 2.2, 2.2])), 1..4);
    assert_eq!(packs::longest_slow_run(&at(&[0.0, 0.0, 1.0, 1.0])), 0..2);
    assert_eq!(packs::longest_slow_run(&at(&[0.0, 1.0])), 0..1);
    assert_eq!(packs::longest_slow_run(&[]), 0..0);
    let mut one_hand = at(&[0.0; 5]);
    one_hand[3][LEFT_WRIST][2] += 0.7;
    assert_eq!(packs::longest_slow_run(&one_hand), 0..3);
}

#[test]
fn bones_of_every_source_are_rigid_and_alike() {
    let folder = tempfile::tempdir().unwrap();
    let imported = import(&two_packs(folder.path()));
    let kinect = imported.dataset.iter().find(|clip| clip.info.id == "actor2").unwrap();
    // In the recording the moving wrist stretches its forearm by up to 10 cm.
    for pose in kinect.joints {
        for joint in 1..JOINTS {
            let [a, b] = [pose[joint], pose[skeleton::PARENTS[joint]]];
            let length = (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>().sqrt();
            assert!((length - BONE_LENGTHS[joint]).abs() < 1e-5, "joint {joint}: {length}");
        }
    }
}

#[test]
fn figures_are_those_of_the_frames() {
    let folder = tempfile::tempdir().unwrap();
    let imported = import(&two_packs(folder.path()));
    let frames: usize = imported.dataset.iter().map(|clip| clip.frames()).sum();
    let all = row(&imported, "all");
    assert!((all.hours - frames as f64 / 20.0 / 3600.0).abs() < 1e-12);
    let contacts: f64 =
        imported.dataset.features.chunks(FEATURES).flat_map(|row| &row[259..]).map(|x| f64::from(*x)).sum();
    assert!((all.contact - contacts / (4 * frames) as f64).abs() < 1e-9 && all.contact > 0.5, "{}", all.contact);
    assert!(all.jerk > 0.0 && all.skating == 0.0);
    let kinect = row(&imported, "kinect, all");
    assert_eq!((kinect.clips, kinect.quality.as_str(), all.quality.as_str()), (1, "kinect", "optical,kinect"));
    assert!(imported.report.rows.iter().all(|row| row.name != "retargeted, all"), "rows without clips are left out");
    let jump = imported.report.actions.iter().find(|action| action.name == "jump").unwrap();
    assert_eq!((jump.train, jump.val, jump.test, jump.scored, jump.kinect_only), (23, 2, 0, true, false));
}

#[test]
fn a_file_with_facts_comes_back_and_one_without_is_of_version_1() {
    let folder = tempfile::tempdir().unwrap();
    let imported = import(&two_packs(folder.path()));
    let path = folder.path().join("d.mds");
    imported.dataset.save(&path).unwrap();
    assert_eq!(Dataset::load(&path).unwrap(), imported.dataset);
    let version = |path: &Path| {
        let bytes = fs::read(path).unwrap();
        let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).unwrap();
        header.metadata().clone().unwrap()["version"].clone()
    };
    assert_eq!(version(&path), "2");
    let (plain, _) = pack::import(&folder.path().join("one"), 8, &Options::default(), &|_, _| ()).unwrap();
    plain.save(&path).unwrap();
    assert_eq!(version(&path), "1");
    let bytes = fs::read(&path).unwrap();
    assert!(!bytes.windows(7).any(|word| word == b"\\\"facts"), "nothing new in old files");
}

#[test]
fn what_does_not_fit_is_said_with_clip_and_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let request = two_packs(folder.path());
    let with = |subset: &str, labels: Value| {
        write_pack(&folder.path().join("bad"), &[(line("x", subset, "train", labels, 20), waving(20, RIGHT_WRIST))]);
        let request = Request { folders: vec![folder.path().join("bad")], ..request.clone() };
        packs::import(&request, &|_, _| ()).unwrap_err().to_string()
    };
    let cases = [
        (with("other", json!({"action": "hop"})), ["[subset.other]", "licence"]),
        (with("a", json!({"action": "Fly"})), ["label \"Fly\" of a (clip x)", "add it"]),
        (with("a", json!({"take": 3})), ["clip x of a has none", "--withdraw a"]),
        (with("s2", json!({"action": "wave"})), ["clip x of s2", "neither left nor right"]),
        (with("a", json!({"action": "Hop", "quality": "fine"})), ["quality \"fine\"", "optical"]),
    ];
    for (said, words) in cases {
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
    }
    let request = Request { folders: vec![folder.path().join("none")], ..request };
    assert!(matches!(packs::import(&request, &|_, _| ()), Err(packs::Error::Pack { .. })));
}

#[test]
fn the_command_prints_the_table_and_writes_nothing_on_failure() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    two_packs(here);
    fs::write(here.join("table.toml"), TABLE).unwrap();
    let run = |arguments: &[&str]| {
        let program = env!("CARGO_BIN_EXE_motionette");
        let output =
            Command::new(program).args(["--json", "import", "pack"]).args(arguments).current_dir(here).output();
        let output = output.unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let report: Value = text.lines().last().and_then(|line| serde_json::from_str(line).ok()).unwrap_or_default();
        (output.status.code(), text, report)
    };
    let (status, text, report) =
        run(&["one", "two", "--actions", "table.toml", "--withdraw", "s2,gone", "-o", "both.mds"]);
    assert_eq!(status, Some(0));
    assert!(text.contains("actions are scored") && text.contains("kinect"), "{text}");
    assert_eq!(report["report"]["rows"][0]["name"], "a");
    assert_eq!(report["total"]["clips"], 28);
    assert_eq!(Dataset::load(here.join("both.mds")).unwrap().clips.len(), 28);
    for (arguments, word) in [
        (&["one", "two", "-o", "x.mds"][..], "--actions"),
        (&["one", "--actions", "table.toml", "--keep-bones", "-o", "x.mds"], "--keep-bones"),
        (&["one", "--actions", "none.toml", "-o", "x.mds"], "none.toml"),
        (&["one", "--actions", "table.toml", "--withdraw", "b", "-o", "x.mds"], "subset.b"),
    ] {
        let (status, _, report) = run(arguments);
        assert_eq!(status, Some(1));
        assert!(report.to_string().contains(word), "{word}: {report}");
        assert!(!here.join("x.mds").exists());
    }
    assert_eq!(run(&["one", "--withdraw", "a", "-o", "x.mds"]).0, Some(2), "--withdraw needs --actions");
}

fn real_packs() -> Option<[PathBuf; 2]> {
    Some([common::shared("mocap")?, common::shared("mocap2")?])
}

/// The hash that the model card of the shipped weights names.
#[test]
fn one_pack_alone_gives_the_dataset_that_it_always_gave() {
    let Some([first, _]) = real_packs() else { return };
    let (dataset, _) = pack::import(&first, 8, &Options::default(), &|_, _| ()).unwrap();
    assert_eq!(dataset.hash, "eb00db8877d2fae06d87ec8d09ed520248b1724116bee5d14d9b3800f65daf83");
}

/// Sides measured from joints, against what the packs' makers measured or wrote.
#[test]
fn measured_sides_agree_with_the_packs() {
    let Some(folders) = real_packs() else { return };
    let mut agree: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
    for folder in folders {
        let text = fs::read_to_string(folder.join("clips.jsonl")).unwrap();
        for (line, recording) in text.lines().zip(pack::read(&folder).unwrap()) {
            let line: Value = serde_json::from_str(line).unwrap();
            let mut check = |what: &'static str, rule: SideRule, left: bool| {
                let wanted = if left { Side::Left } else { Side::Right };
                let same = packs::measured_side(rule, &recording.joints) == wanted;
                let counts = agree.entry(what).or_default();
                counts[0] += usize::from(same);
                counts[1] += 1;
            };
            let yaw = line["measured"]["yaw_deg"].as_f64().unwrap();
            if yaw.abs() > 30.0 {
                check("turn", SideRule::Turn, yaw > 0.0);
            }
            let labels = &line["labels"];
            let action = labels["action"].as_str().or(labels["content"].as_str()).unwrap_or_default();
            match action {
                "wave-left-hand" | "raise-up-left-hand" => check("hand", SideRule::Hand, true),
                "wave-right-hand" | "raise-up-right-hand" => check("hand", SideRule::Hand, false),
                "kickLFront1Reps" => check("leg", SideRule::Leg, true),
                _ if action.starts_with("Kick-a-ball") => check("leg", SideRule::Leg, labels["leg"] == "left"),
                _ => {}
            }
        }
    }
    println!("{agree:?}");
    for what in ["turn", "hand", "leg"] {
        let [same, all] = agree[what];
        assert!(all >= 50 && same as f64 >= 0.95 * all as f64, "{what}: {same} of {all}");
    }
}

#[test]
fn the_real_packs_make_one_dataset() {
    let Some(folders) = real_packs() else { return };
    let actions = Actions::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/actions.toml")).unwrap();
    let request = Request { folders: folders.to_vec(), actions, withdraw: Vec::new(), shortest: 8 };
    let imported = import(&request);
    assert!(imported.dataset.clips.iter().all(|clip| clip.facts.is_some() && clip.subset != "deepmimic"));
    let split = |subset: &str| (row(&imported, subset).train, row(&imported, subset).val, row(&imported, subset).test);
    // Splits that the packs' makers chose stay; whole subjects are held out of the others.
    assert_eq!((split("bnr"), split("cmu1")), ((2466, 155, 403), (105, 6, 23)));
    for (subset, actors) in [("mhad", [4, 11]), ("utd", [7, 8]), ("kinder", [976, 970])] {
        for clip in imported.dataset.clips.iter().filter(|clip| clip.subset == subset) {
            let facts = clip.facts.as_ref().unwrap();
            let split = match facts.actor.as_deref().unwrap() {
                actor if actor == format!("{subset}/{}", actors[0]) => Split::Val,
                actor if actor == format!("{subset}/{}", actors[1]) => Split::Test,
                _ => Split::Train,
            };
            assert_eq!(clip.split, split, "{}", clip.id);
            assert_eq!(facts.known_actor, split == Split::Train);
        }
    }
    for subset in ["hdm05", "cmu8"] {
        let (train, val, _) = split(subset);
        assert!((0.03..0.16).contains(&(val as f64 / (train + val) as f64)), "{subset}: {train} {val}");
    }
    assert_eq!(row(&imported, "kinect-only actions").quality, "kinect");
    let splits: BTreeMap<&str, Split> =
        imported.dataset.clips.iter().map(|clip| (clip.id.as_str(), clip.split)).collect();
    let withdraw = ["bnr", "mhad", "hdm05", "kinder", "utd", "ase"].map(str::to_owned).to_vec();
    let open = import(&Request { withdraw, ..request });
    let subsets: BTreeSet<&str> = open.dataset.clips.iter().map(|clip| clip.subset.as_str()).collect();
    assert_eq!(subsets, BTreeSet::from(["accad", "cmu1", "cmu2", "cmu8"]));
    assert!(open.dataset.clips.iter().all(|clip| splits[clip.id.as_str()] == clip.split));
    assert!(imported.report.cut.iter().all(|cut| 3 * (cut.to - cut.from) >= 2 * cut.frames));
    for action in &imported.report.actions {
        let sides = if action.name.contains("left") || action.name.contains("right") { 2 } else { 1 };
        assert!(action.scored || sides * action.train < 10, "{action:?}");
    }
}
