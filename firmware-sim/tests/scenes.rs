//! The examples of docs/tracks.md, docs/obstacles.md and docs/timeline.md, as a user runs them: tracks are met, obstacles kept clear of and parts
//! of the body told otherwise, judged on the motion that the viewer shows.

mod browser;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use motionette::representation::skeleton::NAMES;
use motionette_host::motion::Pose;
use motionette_host::reference::clearance;
use motionette_host::scene_file;
use serde_json::Value;
use std::path::PathBuf;
use std::process::{Command, Output};

/// Of a margin, no more than this may be missing, metres.
const MISSING: f64 = 0.005;

type Vector = [f64; 3];

fn example(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs/examples").join(name)
}

fn simulate(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_motionette-sim")).args(arguments).output().expect("the simulator starts")
}

/// What a run gave.
struct Run {
    /// The object on the last line.
    figures: Value,
    /// What it said.
    text: String,
    /// What the page shows.
    scene: Value,
}

fn run(arguments: &[&str]) -> Run {
    let out = tempfile::tempdir().expect("a temporary folder");
    let results = out.path().to_string_lossy().into_owned();
    let output = simulate(&[arguments, &["--json", "--out", &results]].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let figures = serde_json::from_str(text.lines().last().unwrap_or_default()).expect("JSON on the last line");
    let page = std::fs::read_to_string(out.path().join("viewer.html")).expect("the page");
    let data = page.split("id=\"scene\">").nth(1).and_then(|rest| rest.split("</script>").next()).expect("its data");
    let scene = serde_json::from_str(data).expect("JSON");
    Run { figures, text, scene }
}

fn numbers(value: &Value) -> Vector {
    let list = value.as_array().unwrap_or_else(|| panic!("{value} is no list"));
    std::array::from_fn(|k| list[k].as_f64().expect("a number"))
}

impl Run {
    /// Joints of the edited motion, metres.
    fn motion(&self) -> Vec<Vec<Vector>> {
        self.shown("after")
    }

    /// Joints of a motion that the page shows, metres.
    fn shown(&self, id: &str) -> Vec<Vec<Vector>> {
        let shown = self.scene["motions"].as_array().expect("motions");
        let motion = shown.iter().find(|motion| motion["id"] == id).expect(id);
        let bytes = STANDARD.decode(motion["positions"].as_str().expect("base64")).expect("base64");
        let values: Vec<f64> =
            bytes.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect();
        let points: Vec<Vector> = values.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        points.chunks_exact(NAMES.len()).map(<[Vector]>::to_vec).collect()
    }

    /// Least distance of the figure from the surface of each obstacle of a file, metres.
    fn distances(&self, file: &str) -> Vec<f64> {
        let narrow = |joint: &Vector| joint.map(|value| value as f32);
        let motion: Vec<Pose> =
            self.motion().iter().map(|pose| std::array::from_fn(|joint| narrow(&pose[joint]))).collect();
        let scene = scene_file::read_scene(&example(file), 20).expect("an example");
        scene.iter().map(|obstacle| clearance::least(&motion, &obstacle.borrowed(), 20.0)).collect()
    }
}

/// Runs a scene of the examples; the figure keeps clear of all of it, as the report says.
fn keeps_clear(text: &str, file: &str) {
    let scene = example(file).to_string_lossy().into_owned();
    let run = run(&["--text", text, "--seconds", "6", "--scene", &scene]);
    let following = &run.figures["following"];
    let before = following["clearance_before"]["distance_cm"].as_f64().expect("a distance");
    assert!(before < 0.0, "the motion does not meet the obstacle, the example shows nothing: {following}");
    assert_eq!(following["clearance_after"]["kept"], true, "{following}");
    let distances = run.distances(file);
    let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
    println!("{file}: {distances:.3?} m, said {}", following["clearance_after"]["distance_cm"]);
    assert!(least >= 0.05 - MISSING, "{file}: {distances:?}, {following}");
    assert!(run.text.contains("all clear, at least") && !run.text.contains("could not be cleared"), "{}", run.text);
    let curve = run.scene["clearance"]["after_cm"].as_array().expect("a curve");
    assert_eq!(curve.len(), run.motion().len());
    let room = curve.iter().filter_map(Value::as_f64).fold(f64::INFINITY, f64::min);
    assert!((-0.6..20.0).contains(&room), "{file}: {room} cm");
}

#[test]
fn a_walk_goes_round_three_pillars() {
    keeps_clear("a person walks forward", "slalom.scene.json");
}

#[test]
fn a_walk_ducks_under_a_beam() {
    keeps_clear("a person walks forward", "low_beam.scene.json");
}

#[test]
fn a_walk_lets_a_pillar_pass() {
    keeps_clear("a person walks forward", "moving_pillar.scene.json");
}

/// Runs tracks of the examples; all are met on the axes that count, on average and everywhere, metres.
fn meets(text: &str, seconds: &str, file: &str, [mean, worst]: [f64; 2]) {
    let path = example(file).to_string_lossy().into_owned();
    let run = run(&["--text", text, "--seconds", seconds, "--tracks", &path]);
    let file: Value = serde_json::from_str(&std::fs::read_to_string(&path).expect("an example")).expect("JSON");
    let motion = run.motion();
    let (mut sum, mut count, mut largest) = (0.0, 0, 0.0_f64);
    for track in file["tracks"].as_array().expect("a list") {
        let joint = NAMES.iter().position(|name| track["joint"] == *name).expect("a joint");
        let first = track["frame"].as_u64().expect("a frame") as usize;
        let axes = track["axes"].as_str().unwrap_or("xyz");
        for (index, position) in track["positions"].as_array().expect("a list").iter().enumerate() {
            let (wanted, at) = (numbers(position), motion[first + index][joint]);
            let counts = |k: usize| axes.contains(["x", "y", "z"][k]);
            let off = (0..3).filter(|k| counts(*k)).map(|k| (wanted[k] - at[k]).powi(2)).sum::<f64>().sqrt();
            (sum, count, largest) = (sum + off, count + 1, largest.max(off));
        }
    }
    let found = [sum / f64::from(count), largest];
    let following = &run.figures["following"];
    println!("{path}: mean and worst {found:.4?} m; {following}");
    assert!(found[0] <= mean && found[1] <= worst, "{found:?}, {following}");
    let said = ["mean_cm", "worst_cm"].map(|name| following["track_error_after"][name].as_f64().expect("a number"));
    assert!(
        (said[0] - 100.0 * found[0]).abs() < 0.01 && (said[1] - 100.0 * found[1]).abs() < 0.01,
        "{said:?}, {found:?}"
    );
    assert!(following["track_error_before"]["mean_cm"].as_f64() > Some(5.0), "{following}");
    assert!(run.text.contains("cm off before, "), "{}", run.text);
    let shown = run.scene["tracks"].as_array().expect("tracks");
    assert_eq!(shown.len(), 2);
    let curve = shown[1]["after_cm"].as_array().expect("a curve");
    assert_eq!(curve.len(), shown[1]["positions"].as_array().expect("positions").len());
}

#[test]
fn a_walk_in_zigzag_waves_in_zigzag() {
    meets("a person walks forward and waves his hands", "6", "wave.tracks.json", [0.003, 0.03]);
}

#[test]
fn a_walk_goes_once_round_a_circle() {
    meets("a person walks in a circle counter-clockwise", "8", "circle.tracks.json", [0.02, 0.08]);
}

#[test]
fn the_viewer_shows_tracks_and_obstacles_with_their_curves() {
    let out = tempfile::tempdir().expect("a temporary folder");
    let results = out.path().to_string_lossy().into_owned();
    let [tracks, scene] =
        ["wave.tracks.json", "moving_pillar.scene.json"].map(|name| example(name).to_string_lossy().into_owned());
    let text = "a person walks forward and waves his hands";
    for (more, [curves, clearance]) in [(vec!["--tracks", &tracks], [2, 0]), (vec!["--scene", &scene], [0, 1])] {
        let output = simulate(&[&["--text", text, "--seconds", "6", "--out", &results][..], &more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let seen = browser::run(&out.path().join("viewer.html"), include_str!("browser/surroundings.js"));
        assert_eq!((&seen["tracks"], &seen["clearance"]), (&curves.into(), &clearance.into()), "{seen}");
        assert_eq!(seen["hidden"], true, "{seen}");
        assert!(seen["changed"].as_u64() > Some(1000), "{seen}");
        for (number, read) in seen["read"].as_array().expect("a list").iter().enumerate() {
            assert_eq!(read[0], 61 + number, "{seen}");
            let said = read[1].as_str().unwrap_or_default();
            assert!(said.contains(" s: ") && said.contains("cm before, ") && said.ends_with("cm refined"), "{seen}");
            assert!(read[2].as_u64() >= Some(2), "{seen}");
        }
    }
}

/// Joints that a timeline moves do something else while it says so, and all others what they do without it.
#[test]
fn a_walk_waves_claps_and_raises_a_hand() {
    let path = example("three.timeline.json").to_string_lossy().into_owned();
    let run = run(&["--text", "a person walks forward", "--seconds", "8", "--timeline", &path]);
    let heard = run.figures["timeline"].as_array().expect("a list");
    assert_eq!(heard.len(), 3, "{}", run.figures);
    for (index, span) in heard.iter().enumerate() {
        assert!(span["understood"].is_string() && span["unknown_words"] == Value::Array(Vec::new()), "{span}");
        assert!(run.text.contains(&format!("  span {index}")), "{}", run.text);
    }
    assert!(
        run.text.contains("right arm, 0.50 to 3.00 s: a person waves the right hand; understood as: "),
        "{}",
        run.text
    );
    // The planner saw no anchors: there are none.
    assert_eq!(run.figures["planner_conditioned"], false);
    assert!(run.figures["planner_token_agreement"].as_f64() > Some(0.9), "{}", run.figures);
    assert_eq!(run.figures["planner_steps"], 5, "those of the motion itself");
    let [alone, before, after] = ["alone", "before", "after"].map(|id| run.shown(id));
    assert_eq!((alone.len(), before.len(), after.len()), (160, 160, 160));
    let spans = run.scene["timeline"].as_array().expect("a list");
    let mut most = [0.0_f64; 3];
    for frame in 0..160_usize {
        let lasting = spans.iter().enumerate().filter(|(_, span)| {
            let [first, frames] = ["first", "frames"].map(|name| span[name].as_u64().expect("a number") as usize);
            (first..first + frames).contains(&frame)
        });
        let lasting: Vec<(usize, Vec<u64>)> = lasting
            .map(|(index, span)| {
                let joints = span["joints"].as_array().expect("a list").iter();
                (index, joints.map(|joint| joint.as_u64().expect("a joint")).collect())
            })
            .collect();
        for joint in 0..NAMES.len() {
            let apart = |motion: &[Vec<Vector>]| {
                let (a, b) = (motion[frame][joint], alone[frame][joint]);
                (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
            };
            match lasting.iter().find(|(_, joints)| joints.contains(&(joint as u64))) {
                Some((index, _)) => most[*index] = most[*index].max(apart(&after)),
                // The edit, which comes behind, smooths over all joints.
                None => assert!(apart(&after) < 5e-3, "joint {joint} at frame {frame}: {} m", apart(&after)),
            }
        }
    }
    println!("joints that are told otherwise are up to {most:.2?} m from where they were");
    assert!(most.iter().all(|most| *most > 0.2), "{most:?}");
    // The one before the edit has them as well.
    let wrist = |motion: &[Vec<Vector>]| motion[40][21];
    assert!((0..3).all(|k| (wrist(&before)[k] - wrist(&after)[k]).abs() < 0.1), "{:?}", wrist(&before));
}

/// Given tokens have spans as well, and the seed counts for these.
#[test]
fn a_recorded_motion_waves() {
    let path = example("wave.timeline.json").to_string_lossy().into_owned();
    let clips = String::from_utf8(simulate(&["--list"]).stdout).expect("text");
    let clip = clips.split_whitespace().next().expect("a clip").to_owned();
    let made = |seed: &str| run(&["--clip", &clip, "--timeline", &path, "--seed", seed]);
    let (one, two) = (made("1"), made("2"));
    assert_eq!(one.figures["timeline"][0]["parts"][0], "right_arm", "{}", one.figures);
    assert_eq!(one.figures["planner_steps"], 0, "{}", one.figures);
    assert_ne!(one.figures["motion_hash"], two.figures["motion_hash"]);
    assert_eq!(one.figures["motion_hash"], made("1").figures["motion_hash"], "a replay");
}

#[test]
fn the_viewer_shows_the_timeline_and_colours_what_it_moves() {
    let out = tempfile::tempdir().expect("a temporary folder");
    let results = out.path().to_string_lossy().into_owned();
    let path = example("three.timeline.json").to_string_lossy().into_owned();
    let text = "a person walks forward";
    let output = simulate(&["--text", text, "--seconds", "8", "--timeline", &path, "--out", &results]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let seen = browser::run(&out.path().join("viewer.html"), include_str!("browser/timeline.js"));
    let labels = [
        "right arm: a person waves the right hand",
        "left arm: a person raises the left hand",
        "arms: a person claps",
        "head: a person claps",
    ];
    assert_eq!(seen["labels"], Value::from(labels.to_vec()), "{seen}");
    let title = seen["titles"][0].as_str().expect("a title");
    assert!(title.starts_with("right arm, 0.50 to 3.00 s: a person waves the right hand; understood as: "), "{seen}");
    assert_eq!(seen["places"], serde_json::json!([[10, 59], [40, 99], [110, 159], [110, 159]]), "{seen}");
    assert_eq!(seen["now"], serde_json::json!([true, true, false, false]), "{seen}");
    assert!(seen["changed"].as_i64() > Some(1000), "{seen}");
    assert_eq!((&seen["hidden"], &seen["back"]), (&true.into(), &true.into()), "{seen}");
    assert_eq!(
        (&seen["frame"], &seen["later"]),
        (&110.into(), &serde_json::json!([false, false, true, true])),
        "{seen}"
    );
}

#[test]
fn bad_files_are_named_and_leave_nothing_behind() {
    let out = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        let file = out.path().join(name);
        std::fs::write(&file, text).expect("a test file");
        file.to_string_lossy().into_owned()
    };
    let broken = write("broken.json", "{\"tracks\": [");
    let tail = write("tail.json", r#"{"tracks":[{"joint":"tail","frame":0,"positions":[[0,0,0]]}]}"#);
    let late = write("late.json", r#"{"tracks":[{"joint":"head","frame":5000,"positions":[[0,0,0]]}]}"#);
    let ball = write("ball.json", r#"{"obstacles":[{"ball":{"radius":1}}]}"#);
    let fast = write("fast.json", r#"{"obstacles":[{"sphere":{"radius":1},"at":[0,0,9],"velocity":[0,0,99]}]}"#);
    let good = write("good.json", r#"{"tracks":[{"joint":"head","frame":0,"positions":[[0,1.5,0]]}]}"#);
    let part = write("part.json", r#"{"timeline":[{"parts":"hand","from":0,"to":2,"text":"a person waves"}]}"#);
    let long = write("long.json", r#"{"timeline":[{"parts":"head","from":1,"to":5,"text":"a person nods"}]}"#);
    let results = out.path().join("results").to_string_lossy().into_owned();
    for (arguments, expected) in [
        (&["--tracks", &broken][..], "line 1"),
        (&["--tracks", &tail], "track 0: there is no joint \"tail\""),
        (&["--tracks", &late], "track 0: its last frame 5000"),
        (&["--tracks", "missing.json"], "missing.json"),
        (&["--scene", &ball], "obstacle 0: unknown field \"ball\""),
        (&["--scene", &fast], "obstacle 0: it moves at 99 m/s"),
        (&["--scene", &good], "a scene file is"),
        (&["--tracks", &good, "--refinement", "fast:3"], "take exact"),
        (&["--timeline", &good], "a timeline file is"),
        (&["--timeline", &part], "span 0: there is no part \"hand\"; parts are head"),
        (&["--timeline", &long, "--seconds", "3"], "end it within 3 s, or give --seconds 5"),
    ] {
        let output = simulate(&[arguments, &["--text", "a person walks", "--out", &results]].concat());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(expected), "{arguments:?}: {said}");
        assert!(!said.contains("panicked") && !out.path().join("results").exists(), "{said}");
    }
}
