//! `generate --timeline` and `plan --spans`: what is made of spans, what is said, and what goes wrong on the way.

mod common;

use std::path::{Path, PathBuf};

use common::bench::{Bench, report};
use motionette::BodyParts;
use motionette_host::import::bvh;
use motionette_host::motion::Pose;
use motionette_host::scene_file;
use serde_json::{Value, json};

fn root(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name)
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// The figures and the text of `generate` on the default model, which must succeed; the motion is in `m.bvh`.
fn made(bench: &Bench, text: &str, options: &str) -> (Value, String) {
    let blob = root("models/nano.blob");
    let arguments = ["generate", "--blob", blob.to_str().expect("Unicode"), "--text", text, "-o", "m.bvh"];
    let arguments: Vec<&str> = arguments.into_iter().chain(options.split_whitespace()).collect();
    let output = bench.run(&arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    (report(&output), String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Joints of the motion that was written.
fn motion(bench: &Bench) -> Vec<Pose> {
    bvh::load(&bench.path("m.bvh"), &bvh::Reading::default()).expect("our own file").joints
}

fn apart(a: &Pose, b: &Pose, joint: usize) -> f32 {
    (0..3).map(|k| (a[joint][k] - b[joint][k]).powi(2)).sum::<f32>().sqrt()
}

const LEGS: [usize; 9] = [0, 1, 2, 4, 5, 7, 8, 10, 11];

#[test]
fn spans_move_their_parts_and_are_said() {
    let bench = Bench::new();
    let (plain, text) = made(&bench, "a person walks forward", "--seconds 5 --refinement off");
    assert_eq!(plain["timeline"], json!([]), "{plain}");
    assert!(!text.contains("span 0"), "{text}");
    let before = motion(&bench);

    bench.write(
        "t.json",
        br#"{"timeline": [
            {"parts": "right_arm", "from": 1.0, "to": 3.0, "text": "a person waves the right hand zebraquagga"},
            {"parts": ["head", "left_arm"], "first_frame": 60, "frames": 40, "text": "a person raises the left hand"}
        ]}"#,
    );
    let (figures, text) = made(&bench, "a person walks forward", "--seconds 5 --refinement off --timeline t.json");
    let [wave, raise] = &figures["timeline"].as_array().expect("a list")[..] else { panic!("{figures}") };
    for (span, fields) in [
        (
            wave,
            json!({"parts": ["right_arm"], "first_frame": 20, "frames": 40, "prompt": null,
            "text": "a person waves the right hand zebraquagga", "unknown_words": ["zebraquagga"]}),
        ),
        (
            raise,
            json!({"parts": ["left_arm", "head"], "first_frame": 60, "frames": 40, "prompt": null,
            "text": "a person raises the left hand", "unknown_words": []}),
        ),
    ] {
        let (span, fields) = (span.as_object().expect("fields"), fields.as_object().expect("fields").clone());
        for (name, value) in &fields {
            assert_eq!(&span[name], value, "{name}");
        }
        assert_eq!(span.len(), fields.len() + 1, "{span:?}");
        let understood = span["understood"].as_str().expect("the model was taught what it understands");
        let parts = fields["parts"].as_array().expect("a list").iter().map(|part| part.as_str().expect("a name"));
        let parts = parts.collect::<Vec<_>>().join(", ").replace('_', " ");
        let says = fields["text"].as_str().expect("text");
        let line = text.lines().find(|line| line.contains(&format!(": {parts}, "))).unwrap_or_else(|| panic!("{text}"));
        assert!(
            line.starts_with("span ") && line.contains(&format!(": {says}; understood as: {understood}")),
            "{line}"
        );
        let unknown = line.ends_with("; words the vocabulary does not have: zebraquagga");
        assert_eq!(unknown, says.contains("zebra"), "{line}");
    }
    assert!(wave["understood"].as_str().expect("text").contains("wave"), "{wave}");
    assert!(text.contains("span 0: right arm, 1.00 to 3.00 s: "), "{text}");
    assert_ne!(figures["hash"], plain["hash"]);

    // As read back, legs walk as before and each part moves in its own time.
    let after = motion(&bench);
    assert_eq!(after.len(), before.len());
    for (frame, (a, b)) in before.iter().zip(&after).enumerate() {
        for joint in LEGS {
            assert!(apart(a, b, joint) < 0.01, "joint {joint} at frame {frame}");
        }
        if !(20..60).contains(&frame) {
            assert!(apart(a, b, 21) < 0.02, "the right wrist at frame {frame}");
        }
        if frame < 60 {
            assert!(apart(a, b, 20) < 0.02, "the left wrist at frame {frame}");
        }
    }
    let most = |joint| before.iter().zip(&after).map(|(a, b)| apart(a, b, joint)).fold(0.0, f32::max);
    assert!(most(21) > 0.2 && most(20) > 0.2, "{} and {} m", most(21), most(20));
    assert_eq!(made(&bench, "a person walks forward", "--seconds 5 --refinement off --timeline t.json").0, figures);
}

/// With all else that a request may ask for; what is met is met as without a timeline.
#[test]
fn spans_go_with_anchors_tracks_and_scenes() {
    let bench = Bench::new();
    let positions: Vec<String> = (0..20).map(|_| "[0.2, 1.1, 1.2]".to_owned()).collect();
    let tracks = format!(
        r#"{{"tracks": [{{"joint": "left_wrist", "frame": 80, "tolerance": 0.01, "positions": [{}]}}]}}"#,
        positions.join(", ")
    );
    bench.write("tracks.json", tracks.as_bytes());
    bench.write("scene.json", br#"{"obstacles": [{"plane": {"normal": [-1, 0, 0]}, "at": [1.5, 0, 0]}]}"#);
    bench.write("anchors.json", br#"{"anchors": [{"frame": 99, "planar_root": [0, 1]}]}"#);
    bench.write("t.json", br#"{"timeline": [{"parts": "right_arm", "from": 0, "to": 2, "text": "a person waves"}]}"#);
    let options = "--seconds 5 --timeline t.json --tracks tracks.json --scene scene.json --anchors anchors.json";
    let (figures, text) = made(&bench, "a person walks forward", options);
    assert!(number(&figures["following"]["track_error_after"]["mean_cm"]) < 2.0, "{figures}");
    assert_eq!(figures["following"]["clearance_after"]["kept"], true, "{figures}");
    assert!(number(&figures["control_error_m"]) < 0.01, "{figures}");
    assert!(text.contains("span 0: right arm, 0.00 to 2.00 s: a person waves; understood as: "), "{text}");

    // Of a length that the prompt decides, no less than the last span.
    bench.write("late.json", br#"{"timeline": [{"parts": "head", "from": 8, "to": 9.8, "text": "a person bows"}]}"#);
    let (figures, _) = made(&bench, "a person stands", "--timeline late.json");
    assert_eq!(figures["frames"], 196, "{figures}");
}

#[test]
fn the_examples_are_understood() {
    let bench = Bench::new();
    for (file, seconds, spans) in [("wave", 6, 1), ("punch", 6, 1), ("three", 8, 3)] {
        let path = root("docs/examples").join(format!("{file}.timeline.json"));
        let options = format!("--seconds {seconds} --timeline {}", path.display());
        let (figures, _) = made(&bench, "a person walks forward", &options);
        let heard = figures["timeline"].as_array().expect("a list");
        assert_eq!(heard.len(), spans, "{figures}");
        for span in heard {
            assert_eq!(span["unknown_words"], json!([]), "{span}");
            assert!(!span["understood"].as_str().expect("text").contains("hardly"), "{span}");
        }
        let read = scene_file::read_timeline(&path, 20).expect("an example");
        let text = scene_file::timeline_text(&read).expect("writable");
        assert_eq!(scene_file::parse_timeline(&text, 20).expect("readable"), read);
    }
}

#[test]
fn plan_counts_what_spans_cost() {
    let bench = Bench::new();
    bench.convert();
    let plan = |options: &str| bench.succeeds(&format!("plan p.blob --tokens 20 --anchors 0 {options}"));
    let (none, three) = (plan(""), plan("--spans 3 --model-rs model.rs"));
    assert_eq!((&none["spans"], &none["timeline_bytes"]), (&0.into(), &0.into()), "{none}");
    // Six bytes for each direction of each frame.
    let bytes = (17 * 80 * 6_usize).next_multiple_of(16);
    assert_eq!((&three["spans"], &three["timeline_bytes"]), (&3.into(), &bytes.into()), "{three}");
    assert_eq!(three["planning"]["reads"], 4 * none["planning"]["reads"].as_u64().expect("a count"), "{three}");
    assert!(number(&three["macs"]) > 3.0 * number(&none["macs"]), "{three}");
    let arena: f64 = three["arena"].as_array().expect("shares").iter().map(|share| number(&share["amount"])).sum();
    assert_eq!(arena, number(&three["arena_bytes"]), "{three}");
    let constants = std::fs::read_to_string(bench.path("model.rs")).expect("text");
    assert!(constants.contains("pub const SPANS: usize = 3;\n"), "{constants}");
    bench.misused("plan p.blob --spans 9", "9 is not in 0..=8");
    bench.fails(&["plan", "p.blob", "--spans", "1", "--words", "0"], &["leave --words 0 out"]);
    // A model that plans nothing has none.
    bench.succeeds("convert t.safetensors -o t.blob");
    let given = bench.succeeds("plan t.blob --anchors 0 --spans 2");
    assert_eq!((&given["spans"], &given["planning"]), (&0.into(), &Value::Null), "{given}");
    // As much as such a request takes.
    bench.write(
        "t.json",
        br#"{"timeline": [
            {"parts": "upper_body", "first_frame": 0, "frames": 80, "text": "person"},
            {"parts": "legs", "first_frame": 0, "frames": 80, "prompt": "wave"}
        ]}"#,
    );
    let line = "generate --blob p.blob --text person --seconds 4 --timeline t.json -o m.bvh";
    let made = bench.succeeds(line);
    assert_eq!(made["timeline"][1]["prompt"], "wave", "{made}");
    assert_eq!(made["timeline"][1]["text"], Value::Null, "{made}");
    let parts = BodyParts::UPPER_BODY.and(BodyParts::LEGS);
    assert_eq!(parts.directions(), 17);
    let words = bench.succeeds("plan p.blob --tokens 20 --anchors 0 --spans 2");
    assert!(number(&made["arena_bytes"]) <= number(&words["arena_bytes"]), "{made}: {words}");
}

#[test]
fn bad_files_are_named_and_refusals_say_what_to_do() {
    let bench = Bench::new();
    bench.convert();
    let fails = |timeline: &str, words: &[&str]| {
        bench.write("bad.json", timeline.as_bytes());
        let line = "generate --blob p.blob --text person --seconds 4 --timeline bad.json -o x";
        bench.fails(&line.split_whitespace().collect::<Vec<_>>(), words);
    };
    let span = |rest: &str| format!("{{\"timeline\": [{{\"parts\": \"head\", {rest}}}]}}");
    fails("{\"timeline\": [\n7]}", &["reading the timeline", "line 2, column 1", "a timeline file is"]);
    fails(r#"{"timeline": [], "prompt": "wave"}"#, &["reading the timeline", "line 1", "prompt"]);
    fails(&span(r#""text": "person""#), &["span 0: no time; give either from and to"]);
    let part = r#"{"timeline": [{"parts": "hand", "from": 0, "to": 1, "text": "person"}]}"#;
    fails(part, &["span 0: there is no part \"hand\"; parts are head, left_arm, "]);
    // What the runtime refuses.
    fails(
        &span(r#""from": 3, "to": 5, "text": "person""#),
        &["span 0 ends with frame 100", "80 frames", "; end it within 4 s, or give --seconds 5"],
    );
    fails(&span(r#""from": 3, "to": 50, "text": "person""#), &["span 0 ends with frame 1000", "; end it within 4 s"]);
    fails(
        &span(r#""from": 1, "to": 1.3, "text": "person""#),
        &["span 0 has 6 frames, a span has at least 8", "; give it 0.4 s or more"],
    );
    let two = r#"{"timeline": [{"parts": "upper_body", "from": 0, "to": 2, "text": "person"}, {"parts": ["head", "legs"], "from": 1.9, "to": 3, "text": "person"}]}"#;
    fails(
        two,
        &[
            "spans 0 and 1 both move head at the same time",
            "; have one end where the other begins, or take head out of one",
        ],
    );
    let one = r#"{"parts": "head", "first_frame": 0, "frames": 8, "text": "person"}"#;
    let many = format!("{{\"timeline\": [{}]}}", [one; 9].join(", "));
    fails(&many, &["9 spans given, a timeline has at most 8", "; leave some out"]);
    fails(&span(r#""from": 0, "to": 1, "text": "!""#), &["span 0: the prompt has no words"]);
    fails(
        &span(r#""from": 0, "to": 1, "text": "zebra quagga""#),
        &["span 0: the model knows none of the prompt's 2 words", "; `motionette inspect --vocabulary` lists what"],
    );
    fails(
        &span(r#""from": 0, "to": 1, "prompt": "swim""#),
        &["span 0: none of the model's 2 stored prompts has that name", "; it stores "],
    );
    let line = "generate --blob p.blob --text person --timeline missing.json -o x";
    bench.fails(&line.split_whitespace().collect::<Vec<_>>(), &["cannot read missing.json"]);
    bench.misused(
        "export --bvh m.bvh --timeline t.json -o x.bvh",
        "'--bvh <FILE>' cannot be used with '--timeline <FILE>'",
    );
}
