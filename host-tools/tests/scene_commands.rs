//! `generate --tracks --scene` and `plan --tracked`: what is made of them, what is said, and what goes wrong on the way.

mod common;

use common::bench::{Bench, report};
use serde_json::Value;

/// The pelvis over all frames of a motion of five seconds, and a wrist near it over three of them.
fn tracks() -> String {
    let path = |at: &dyn Fn(f64) -> [f64; 3], frames: std::ops::Range<u16>| -> Vec<String> {
        frames.map(|frame| at(f64::from(frame))).map(|[x, y, z]| format!("[{x:.4}, {y:.4}, {z:.4}]")).collect()
    };
    let pelvis = path(&|frame| [0.1 * (0.05 * frame).sin(), 0.9, 0.01 * frame], 0..100);
    let wrist = path(&|frame| [-0.3, 1.1 + 0.1 * (0.1 * frame).sin(), 0.2 + 0.01 * frame], 20..80);
    format!(
        r#"{{"tracks": [{{"joint": "pelvis", "frame": 0, "axes": "xz", "positions": [{}]}},
        {{"joint": "right_wrist", "time": 1.0, "positions": [{}], "tolerance": 0.01}}]}}"#,
        pelvis.join(", "),
        wrist.join(", ")
    )
}

const SCENE: &str = r#"{"obstacles": [
    {"plane": {"normal": [-1, 0, 0]}, "at": [2.5, 0, 0], "margin": 0.1},
    {"sphere": {"radius": 0.2}, "at": [0.1, 0.9, 0.75], "velocity": [0.1, 0, 0], "joints": ["head", "left_wrist"]}
]}"#;

fn bench() -> Bench {
    let bench = Bench::new();
    bench.convert();
    bench.write("tracks.json", tracks().as_bytes());
    bench.write("scene.json", SCENE.as_bytes());
    bench
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// The figures and the text of a line that must succeed.
fn made(bench: &Bench, options: &str) -> (Value, String) {
    let line = format!("generate --blob p.blob --text person -o m.bvh {options}");
    let output = bench.run(&line.split_whitespace().collect::<Vec<_>>());
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    (report(&output), String::from_utf8_lossy(&output.stdout).into_owned())
}

#[test]
fn tracks_are_followed_and_the_rest_is_said() {
    let bench = bench();
    let (plain, text) = made(&bench, "--seconds 5");
    assert!(
        plain["following"].is_null() && plain["planner_saw_tracks"].is_null() && !text.contains("off before"),
        "{text}"
    );
    let (figures, text) = made(&bench, "--seconds 5 --tracks tracks.json");
    let following = &figures["following"];
    assert_eq!((&following["tracks"], &following["obstacles"]), (&2.into(), &0.into()), "{figures}");
    let [before, after] = ["before", "after"].map(|when| &following[format!("track_error_{when}")]);
    // A random motion is metres away, and no body is that fast.
    assert!(number(&after["mean_cm"]) < 0.5 * number(&before["mean_cm"]), "{figures}");
    assert!(number(&after["mean_cm"]) <= number(&after["worst_cm"]) && after["worst_joint"].is_string(), "{figures}");
    assert_eq!(number(&after["worst_seconds"]), number(&after["worst_frame"]) / 20.0, "{figures}");
    assert!(following["clearance_after"].is_null() && following["positions_beyond_end"] == 0, "{figures}");
    let said =
        format!("tracks 2: {:.2} cm off before, {:.2} cm after", number(&before["mean_cm"]), number(&after["mean_cm"]));
    assert!(text.contains(&said), "{said:?} not in: {text}");
    // This planner has no anchor control.
    assert_eq!(figures["planner_saw_tracks"], false, "{figures}");
    assert!(text.contains("note: the planner did not see the tracks: the blob has no anchor control"), "{text}");
    assert_ne!(figures["hash"], plain["hash"]);
    assert_eq!(made(&bench, "--seconds 5 --tracks tracks.json").0, figures, "a replay");
    let (_, text) = made(&bench, "--seconds 5 --tracks tracks.json --unconditioned");
    assert!(text.contains("did not see the tracks: --unconditioned"), "{text}");

    // Too fast, and behind the end.
    let jump = r#"{"tracks": [{"joint": "pelvis", "frame": 40, "axes": "xz", "positions": [[0, 0, 0], [30, 0, 0]]}]}"#;
    bench.write("jump.json", jump.as_bytes());
    let (figures, text) = made(&bench, "--seconds 5 --tracks jump.json");
    assert!(number(&figures["following"]["hurried_positions"]) >= 1.0, "{figures}");
    assert!(text.contains("positions of tracks ask for more speed than a body adds"), "{text}");
}

#[test]
fn obstacles_are_kept_clear_of_or_it_is_said_plainly() {
    let bench = bench();
    let (figures, text) = made(&bench, "--seconds 5 --tracks tracks.json --scene scene.json");
    let [before, after] = ["before", "after"].map(|when| &figures["following"][format!("clearance_{when}")]);
    assert_eq!(figures["following"]["obstacles"], 2, "{figures}");
    assert!(number(&after["missing_cm"]) <= number(&before["missing_cm"]), "{figures}");
    assert_eq!(after["kept"], true, "{figures}");
    assert!(text.contains("obstacles 2: before, ") && text.contains("; after, all clear, at least "), "{text}");
    assert!(!text.contains("could not be cleared"), "{text}");

    // The floor and a ceiling half a metre above it leave no room.
    let press = r#"{"obstacles": [{"plane": {"normal": [0, -1, 0]}, "at": [0, 0.5, 0]}, {"plane": {"normal": [0, 1, 0]}, "at": [0, 0.4, 0]}]}"#;
    bench.write("press.json", press.as_bytes());
    let (figures, text) = made(&bench, "--seconds 5 --scene press.json");
    assert_eq!(figures["following"]["clearance_after"]["kept"], false, "{figures}");
    assert!(text.contains("warning: the scene could not be cleared, the body is in an obstacle: "), "{text}");
}

#[test]
fn plan_counts_what_rows_cost() {
    let bench = bench();
    let plan = |options: &str| bench.succeeds(&format!("plan p.blob --tokens 20 --anchors 0 --words 0 {options}"));
    let bytes = |options: &str| number(&plan(options)["edit_bytes"]);
    assert!(bytes("") < bytes("--tracked 1") && bytes("--tracked 1") < bytes("--tracked 22"));
    let report = plan("--tracked 8 --model-rs model.rs");
    assert_eq!(report["tracked"], 8);
    let arena: f64 = report["arena"].as_array().expect("shares").iter().map(|share| number(&share["amount"])).sum();
    assert_eq!(arena, number(&report["arena_bytes"]), "{report}");
    let constants = std::fs::read_to_string(bench.path("model.rs")).expect("text");
    assert!(constants.contains("pub const TRACKED: usize = 8;\n"), "{constants}");
    bench.fails(&["plan", "p.blob", "--tracked", "23"], &["a plan for 23 joints with tracks: a body has 22"]);
    bench.fails(
        &["plan", "p.blob", "--tracked", "2", "--refinement", "fast:20"],
        &["tracks and obstacles are met by the edit behind the decoder, which fast:20 leaves out"],
    );
    // As much as such a request takes.
    let made = made(&bench, "--seconds 5 --tracks tracks.json").0;
    let plan = bench.succeeds("plan p.blob --tokens 25 --anchors 0 --tracked 2 --words 1 --unconditioned");
    assert_eq!(made["arena_bytes"], plan["arena_bytes"]);
}

#[test]
fn bad_files_are_named() {
    let bench = bench();
    let fails = |tracks: &str, scene: &str, words: &[&str]| {
        bench.write("bad.tracks.json", tracks.as_bytes());
        bench.write("bad.scene.json", scene.as_bytes());
        let line =
            "generate --blob p.blob --text person --seconds 5 --tracks bad.tracks.json --scene bad.scene.json -o x";
        bench.fails(&line.split_whitespace().collect::<Vec<_>>(), words);
    };
    let (none, empty) = (r#"{"tracks": []}"#, r#"{"obstacles": []}"#);
    let track = |rest: &str| format!("{{\"tracks\": [{{\"joint\": \"head\", {rest}}}]}}");
    let sphere = |rest: &str| format!("{{\"obstacles\": [{{\"sphere\": {{\"radius\": 0.3}}, {rest}}}]}}");
    fails("{\"tracks\": [\n7]}", empty, &["reading the tracks", "line 2, column 1", "a tracks file is"]);
    fails(none, "[]", &["reading the scene", "line 1, column 1", "a scene file is"]);
    fails(&track(r#""frame": 0"#), empty, &["track 0: positions is missing"]);
    fails(none, &sphere(r#""at": [0, 0]"#), &["obstacle 0: at must be a list of three"]);
    // What the runtime refuses.
    fails(
        &track(r#""frame": 99, "positions": [[0, 1, 0], [0, 1, 0]]"#),
        empty,
        &["track 0: its last frame 100", "100 frames"],
    );
    fails(&track(r#""frame": 9, "positions": [[0, 1, 2000]]"#), empty, &["track 0: at frame 9 a coordinate", "1000 m"]);
    let two = r#"{"tracks": [{"joint": "head", "frame": 3, "positions": [[0, 1, 0]]}, {"joint": "head", "frame": 3, "positions": [[0, 2, 0]]}]}"#;
    fails(two, empty, &["tracks 0 and 1 want the same joint in two places at frame 3"]);
    fails(none, &sphere(r#""at": [0, 1, 2], "velocity": [0, 0, 50]"#), &["obstacle 0: it moves at 50 m/s"]);
    fails(
        &track(r#""frame": 9, "positions": [[0, 1, 2]]"#),
        &sphere(r#""at": [0, 1, 2]"#),
        &["obstacle 0: track 0 is inside it at frame 9"],
    );
    let line = "generate --blob p.blob --text person --tracks tracks.json --refinement fast:5 --seconds 5 -o x";
    bench.fails(
        &line.split_whitespace().collect::<Vec<_>>(),
        &["leave --refinement out, or give one that ends in exact", "which this refinement leaves out"],
    );
    let line = "generate --blob p.blob --text person --scene missing.json -o x";
    bench.fails(&line.split_whitespace().collect::<Vec<_>>(), &["cannot read missing.json"]);
    bench.misused(
        "export --bvh m.bvh --tracks tracks.json -o x.bvh",
        "'--bvh <FILE>' cannot be used with '--tracks <FILE>'",
    );
}
