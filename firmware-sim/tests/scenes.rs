//! The examples of docs/tracks.md and docs/obstacles.md, as a user runs them: tracks are met and obstacles kept clear of, judged on the motion
//! that the viewer shows.

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
        let shown = self.scene["motions"].as_array().expect("motions");
        let after = shown.iter().find(|motion| motion["id"] == "after").expect("the edited motion");
        let bytes = STANDARD.decode(after["positions"].as_str().expect("base64")).expect("base64");
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
    ] {
        let output = simulate(&[arguments, &["--text", "a person walks", "--out", &results]].concat());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(expected), "{arguments:?}: {said}");
        assert!(!said.contains("panicked") && !out.path().join("results").exists(), "{said}");
    }
}
