//! The main job as a user runs it: results, figures, viewer, and what it says about bad input.

mod browser;

use motionette_host::blob::{AlignedBlob, BlobFile};
use motionette_host::checkpoint::{self, prior};
use motionette_host::convert::{self, CardText, Options, PriorSource, Rounding};
use motionette_sim::default_model;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn simulate(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_motionette-sim"))
        .args(arguments)
        .env_remove("CARGO_MANIFEST_DIR")
        .output()
        .expect("the simulator starts")
}

fn last_line(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().last().unwrap_or_default();
    serde_json::from_str(line).unwrap_or_else(|e| panic!("last line is no JSON ({e}): {line}\n{output:?}"))
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn path(folder: &tempfile::TempDir, name: &str) -> String {
    folder.path().join(name).to_string_lossy().into_owned()
}

/// Whether the built-in model's planner sees anchors.
fn built_in_control() -> bool {
    let blob =
        BlobFile::new(AlignedBlob::new(default_model::BLOB), Path::new("(built in)")).expect("the built-in model");
    blob.parts().expect("its manifest").manifest.generator.control().is_some()
}

/// One run of the default job, in a folder that lives as long as the result.
fn default_job() -> (tempfile::TempDir, Value) {
    job(&[])
}

/// The same with more arguments.
fn job(more: &[&str]) -> (tempfile::TempDir, Value) {
    let out = folder();
    let results = path(&out, "results");
    let output = simulate(&[&["--json", "--out", &results], more].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let figures = last_line(&output);
    (out, figures)
}

#[test]
fn the_default_job_makes_a_motion_from_text_and_agrees_with_the_reference() {
    let (out, figures) = default_job();
    let number = |name: &str| figures[name].as_f64().unwrap_or_else(|| panic!("{name} is missing in {figures}"));
    for name in [
        "frames",
        "tokens",
        "jerk",
        "jerk_before",
        "foot_skating",
        "foot_skating_before",
        "root_drift_mm",
        "decoder_gradients",
    ] {
        assert!(number(name).is_finite(), "{name}");
    }
    assert!(number("control_error_unconditioned_cm") >= 10.0, "the anchors pull the motion away: {figures}");
    assert!(number("control_error_before_cm") <= number("control_error_unconditioned_cm"), "{figures}");
    assert!(number("control_error_after_cm") < 0.1, "{figures}");
    let conditioned = built_in_control();
    assert_eq!(figures["planner_conditioned"], conditioned);
    assert_eq!(number("unconditioned_anchors"), if conditioned { 0.0 } else { number("anchors") });
    assert_eq!(figures["unconditioned_because"].is_null(), conditioned, "{figures}");
    let each = figures["anchor_errors"].as_array().expect("a list");
    for name in ["unconditioned", "before", "after"] {
        let sum: f64 = each.iter().filter_map(|anchor| anchor[format!("{name}_cm")].as_f64()).sum();
        let mean = number(&format!("control_error_{name}_cm"));
        assert!((sum / each.len() as f64 - mean).abs() < 1e-9, "{name}: {figures}");
    }
    assert_eq!((number("decoder_evaluations"), figures["refinement"].as_str()), (0.0, Some("exact")));
    assert!(number("bone_error_mm") < 1.0 && number("foot_speed") > 0.0, "{figures}");
    assert_eq!(figures["prompt"], "a person walks forward");
    assert_eq!(figures["unknown_words"], Value::Array(Vec::new()));
    assert_eq!(figures["planner_steps"], 5);
    // Of the 250 positions of one motion; `motionette verify` asks for 98 % over many.
    assert!(number("planner_token_agreement") >= 0.95, "{figures}");
    assert!(number("macs") > 1e8 && number("instructions_estimate") > number("macs"), "{figures}");
    assert!(number("du") == 0.0 && number("anchors") == 3.0, "{figures}");
    assert!(number("reference_mean_mm") <= 1.0 && number("reference_max_mm") <= 30.0, "{figures}");
    assert!(number("arena_high_water_bytes") <= number("arena_bytes"));
    assert!(number("arena_high_water_bytes") + 16.0 > number("arena_bytes"), "{figures}");
    assert!(number("ram_bytes") <= 320.0 * 1024.0, "{figures}");
    assert_eq!(figures["motion_hash"].as_str().map(str::len), Some(16));
    for name in ["viewer.html", "before.bvh", "motion.bvh", "summary.md", "summary.json"] {
        let file = out.path().join("results").join(name);
        assert!(file.metadata().is_ok_and(|m| m.len() > 200), "{name}");
    }
    let (_again, second) = default_job();
    assert_eq!(second["motion_hash"], figures["motion_hash"], "the same request gives the same bits");
}

#[test]
fn the_default_job_needs_nothing_but_the_program() {
    let out = folder();
    let output = Command::new(env!("CARGO_BIN_EXE_motionette-sim"))
        .arg("--json")
        .env_remove("CARGO_MANIFEST_DIR")
        .current_dir(out.path())
        .output()
        .expect("the simulator starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(last_line(&output)["planner_token_agreement"].as_f64() > Some(0.95));
    assert!(out.path().join("out/viewer.html").is_file());
}

#[test]
fn each_stage_can_be_left_out() {
    let out = folder();
    let results = path(&out, "results");
    let made = |arguments: &[&str]| {
        let output = simulate(&[arguments, &["--json", "--out", &results]].concat());
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        (last_line(&output), String::from_utf8_lossy(&output.stdout).into_owned())
    };
    let error = |figures: &Value, name: &str| figures[format!("control_error_{name}_cm")].as_f64().expect("an error");

    let (blind, text) = made(&["--unconditioned"]);
    assert_eq!((&blind["planner_conditioned"], &blind["unconditioned_anchors"]), (&false.into(), &3.into()), "{blind}");
    assert_eq!(error(&blind, "unconditioned"), error(&blind, "before"));
    assert!(text.contains("no anchors: --unconditioned") && !text.contains("prompt alone"), "{text}");

    // A model without anchor control says so and makes that very motion.
    let without = path(&out, "without.blob");
    convert_without_control(Path::new(&without));
    let (plain, text) = made(&["--blob", &without]);
    assert_eq!(plain["planner_conditioned"], false);
    assert!(plain["unconditioned_because"].to_string().contains("has no anchor control"), "{plain}");
    assert!(text.contains("no anchors: the blob has no anchor control"), "{text}");
    assert!(error(&plain, "after") < 0.2 * error(&plain, "before"), "{plain}");
    let page = std::fs::read_to_string(out.path().join("results/viewer.html")).expect("viewer.html");
    assert!(page.contains("The planner saw no anchors: the blob has no anchor control"), "the page says so");

    // Planner alone: nothing is bent.
    let (controlled, text) = made(&["--refinement", "off"]);
    assert_eq!(controlled["planner_conditioned"], built_in_control(), "{controlled}");
    assert_eq!((error(&controlled, "before"), &controlled["du"]), (error(&controlled, "after"), &0.0.into()));
    assert!(!text.contains("refined"), "{text}");

    // Edited behind the decoder: no evaluation of it, and every anchor met.
    let (exact, text) = made(&["--refinement", "exact"]);
    assert_eq!((&exact["decoder_evaluations"], &exact["du"]), (&0.into(), &0.0.into()), "{exact}");
    assert!(error(&exact, "after") < 0.1 && error(&exact, "before") > 1.0, "{exact}");
    assert!(exact["edit_rounds"].as_u64() > Some(0) && text.contains("edited behind the decoder"), "{text}");
    assert!(exact["reference_mean_mm"].as_f64() < Some(2.0), "{exact}");
    let (both, _) = made(&["--refinement", "fast:3+exact"]);
    assert!(error(&both, "after") < 0.1 && both["decoder_evaluations"].as_u64() > Some(0), "{both}");

    // What was given is not planned, and nothing is said of a planner.
    let (given, text) = made(&["--clip", "bnr2_walk_masculine_023"]);
    assert!(given["control_error_unconditioned_cm"].is_null() && given["unconditioned_because"].is_null(), "{given}");
    assert!(text.contains("cm as given") && !text.contains("planner saw"), "{text}");
}

/// The project's model, rounded plainly, without anchor control.
fn convert_without_control(to: &Path) {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models");
    let tokenizer = checkpoint::load(&models.join("nano.safetensors")).expect("a tokenizer");
    let planner = prior::load(&models.join("nano.prior.safetensors")).expect("a prior");
    let source = PriorSource { checkpoint: &planner, bank: &[], text_encoder: true, control: None, cases: &[] };
    let options = Options { rounding: Rounding::Nearest, refit: false, bias_correction: false, ..Options::default() };
    let card = CardText::default();
    let made = convert::convert_with_prior(&tokenizer, Some(source), &options, &[], &card, |_| ()).expect("a blob");
    std::fs::write(to, made.blob.bytes()).expect("a file");
}

#[test]
fn text_seed_length_steps_and_guidance_decide_the_motion() {
    let out = folder();
    let made = |arguments: &[&str]| {
        let results = path(&out, "results");
        let output = simulate(&[arguments, &["--json", "--out", &results]].concat());
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        last_line(&output)
    };
    let text = ["--text", "A person walks forward, zigzagging", "--seconds", "2", "--seed", "7"];
    let first = made(&text);
    assert_eq!(first["unknown_words"], serde_json::json!(["zigzagging"]));
    assert_eq!((&first["tokens"], &first["frames"], &first["anchors"]), (&10.into(), &40.into(), &0.into()));
    assert_eq!(made(&text)["motion_hash"], first["motion_hash"]);
    let others: [&[&str]; 5] = [
        &["--text", "a person walks forward", "--seconds", "2", "--seed", "7"],
        &["--text", text[1], "--seconds", "2", "--seed", "8"],
        &["--text", text[1], "--seconds", "2.2", "--seed", "7"],
        &["--text", text[1], "--seconds", "2", "--seed", "7", "--steps", "4"],
        &["--text", text[1], "--seconds", "2", "--seed", "7", "--guidance", "1"],
    ];
    for other in others {
        assert_ne!(made(other)["motion_hash"], first["motion_hash"], "{other:?}");
    }
    let single = made(&["--text", "a person bows", "--seconds", "2", "--steps", "1"]);
    assert!(single["planner_token_agreement"].as_f64().is_some_and(|share| share >= 0.9), "{single}");
    assert!((1.0..=49.0).contains(&made(&["--text", "a person bows"])["tokens"].as_f64().unwrap_or(0.0)));
}

#[test]
fn a_written_motion_can_be_read_back_as_a_recording() {
    let (out, figures) = default_job();
    let bvh = out.path().join("results/motion.bvh").to_string_lossy().into_owned();
    let output =
        simulate(&["--json", "--bvh", &bvh, "--unit", "cm", "--refinement", "off", "--out", &path(&out, "again")]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let again = last_line(&output);
    assert_eq!(again["anchors"], 0);
    let frames = |v: &Value| v["frames"].as_f64().unwrap_or_default();
    assert!((frames(&again) - frames(&figures)).abs() <= 4.0, "{again}");
    // A body of 170 m.
    let output = simulate(&["--bvh", &bvh, "--unit", "m", "--out", &path(&out, "giant")]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && text.contains("give --unit cm"), "{text}");
    assert!(!out.path().join("giant").exists());
}

#[test]
fn the_viewer_plays_in_a_browser_without_errors() {
    let (out, figures) = default_job();
    let page = out.path().join("results/viewer.html");
    let text = std::fs::read_to_string(&page).expect("viewer.html");
    assert_eq!(text.matches("http://").count(), text.matches("http://www.w3.org").count(), "the page needs no network");
    assert!(!text.contains("https://"), "the page needs no network");
    let check = browser::run(&page, include_str!("browser/plays.js"));
    assert_eq!(check["state"]["frames"], figures["frames"], "{check}");
    assert_eq!(check["state"]["playing"], true, "{check}");
    let conditioned = built_in_control();
    assert_eq!(check["alone"], conditioned, "key 3 shows the motion of the prompt alone if there is one: {check}");
    let columns = ["#", "what", "prompt alone", "generated", "refined"];
    let columns: Vec<_> = columns.into_iter().filter(|name| conditioned || *name != "prompt alone").collect();
    assert_eq!(check["columns"], serde_json::json!(columns));
    let intervals = check["intervals"].as_array().expect("a list");
    assert_eq!(intervals.len(), 3, "{check}");
    let first = intervals[0].as_str().unwrap_or_default();
    assert!(first.starts_with("0.00 to 2.00 s, 10 tokens: activity ") && first.ends_with(" refined"), "{check}");
    assert!(check["state"]["frame"].as_f64().is_some_and(|f| f > 1.0), "the skeleton does not play: {check}");

    // Labels stand beside the body, whichever frame.
    let seen = browser::run(&page, include_str!("browser/labels.js"));
    let shares: Vec<f64> = seen["shares"].as_array().expect("a list").iter().filter_map(Value::as_f64).collect();
    assert_eq!(shares.len(), 12, "{seen}");
    assert!(shares.iter().all(|share| *share < 0.03), "labels cover the body: {seen}");
    for drawn in seen["drawn"].as_array().expect("a list") {
        let [body, labels] = [&drawn[0], &drawn[1]].map(|pixels| pixels.as_u64().unwrap_or_default());
        assert!(body > 500 && labels > 500, "body and labels are there: {seen}");
    }
}

#[test]
fn the_viewers_charts_are_reached_and_read_by_keyboard() {
    // An exact edit has no curve over evaluations.
    let (out, figures) = job(&["--refinement", "fast:20"]);
    let seen = browser::run(&out.path().join("results/viewer.html"), include_str!("browser/keyboard.js"));
    let frames = figures["frames"].as_u64().expect("frames");
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    assert_eq!(
        [&seen["tokenStops"], &seen["servoStops"], &seen["servoStopsLater"], &seen["curveStops"]],
        [1; 4],
        "{seen}"
    );
    // Three tokens of four frames, and a step up from the last of five.
    assert_eq!((&seen["tokenFirst"][0], &seen["tokenThird"][0]), (&0.into(), &12.into()), "{seen}");
    assert!(text(&seen["tokenFirst"][1]).starts_with("step 4, token 0 (0.0 s): code "), "{seen}");
    assert!(text(&seen["tokenThird"][1]).starts_with("step 3, token 3 (0.6 s): code "), "{seen}");
    assert_eq!((&seen["tokenLast"][0], &seen["tokenHandled"]), (&(frames - 4).into(), &true.into()), "{seen}");
    assert!(text(&seen["servos"][0]).starts_with("waist yaw,") && text(&seen["servos"][1]).starts_with("waist pitch,"));
    assert_eq!((&seen["servoTime"][0], &seen["servoHome"]), (&42.into(), &0.into()), "{seen}");
    let reading = text(&seen["servoTime"][1]);
    assert!(reading.contains(" s: ") && reading.contains(" degrees commanded, "), "{seen}");
    let evaluations = figures["decoder_evaluations"].as_u64().expect("a count");
    for (index, count) in [(0, evaluations), (1, evaluations - 1)] {
        assert!(text(&seen["curve"][index]).starts_with(&format!("{count} evaluations: ")), "{seen}");
    }
    assert!(text(&seen["curve"][2]).ends_with(" cm"), "{seen}");
    assert_eq!(seen["curve"][3], 40, "the motion stays where it is: {seen}");
}

#[test]
fn bad_input_says_what_where_and_what_to_do_and_leaves_nothing_behind() {
    let out = folder();
    let results = path(&out, "results");
    let write = |name: &str, text: &str| {
        let file = out.path().join(name);
        std::fs::write(&file, text).expect("a test file");
        file.to_string_lossy().into_owned()
    };
    let unknown_joint = write("joint.json", r#"{"anchors":[{"time":1.0,"joint":"tail","position":[0,0,0]}]}"#);
    let late = write("late.json", r#"{"anchors":[{"time":900.0,"root":[0,0,0]}]}"#);
    let broken = write("broken.json", r#"{"anchors":["#);
    let no_body = write(
        "no_body.bvh",
        "HIERARCHY\nROOT x\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\nMOTION\nFrames: 1\nFrame Time: 0\n0 0 0\n",
    );
    let no_blob = write("no.blob", "hello, this is no blob at all, only text of some length");
    let blocked = write("blocked", "a file where a folder should be");
    let long = "walk ".repeat(2000);
    let cases: &[(&[&str], &str)] = &[
        (&["--clip", "nothing"], "there are"),
        (&["--anchors", &unknown_joint], "right_wrist"),
        (&["--anchors", &late], "frames"),
        (&["--anchors", &broken], "line 1"),
        (&["--anchors", "missing.json"], "missing.json"),
        (&["--bvh", &no_body], "no_body.bvh"),
        (&["--bvh", "missing.bvh"], "missing.bvh"),
        (&["--bvh", &no_body, "--mapping", "missing.json"], "missing.json"),
        (&["--bvh", &no_body, "--unit", "furlong"], "m, cm, mm, inch"),
        (&["--unit", "cm"], "--bvh"),
        (&["--text", "a person walks", "--mapping", "map.json"], "cannot be used with"),
        (&["--blob", &no_blob], "no motionette blob"),
        (&["--blob", "missing.blob"], "missing.blob"),
        (&["--checkpoint", "missing.safetensors"], "missing.safetensors"),
        (&["--refinement", "slow"], "known are"),
        (&["--text", ""], "word"),
        (&["--text", "... !"], "word"),
        (&["--text", "zigzag quux"], "knows none"),
        (&["--text", &long], "4096"),
        (&["--text", "a person walks", "--seconds", "0"], "seconds above 0"),
        (&["--text", "a person walks", "--seconds", "NaN"], "seconds above 0"),
        (&["--text", "a person walks", "--seconds", "60"], "49"),
        (&["--text", "a person walks", "--guidance", "NaN"], "guidance"),
        (&["--text", "a person walks", "--steps", "0"], "steps"),
        (&["--text", "a person walks", "--prior", "missing.safetensors"], "missing.safetensors"),
        (&["--text", "a person walks", "--clip", "x"], "cannot be used with"),
        (&["--clip", "bnr2_walk_masculine_023", "--unconditioned"], "cannot be used with"),
    ];
    for (arguments, expected) in cases {
        let mut all = arguments.to_vec();
        all.extend(["--out", &results]);
        let output = simulate(&all);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{arguments:?} was accepted");
        assert!(text.contains(expected), "{arguments:?}: {text}");
        assert!(!text.contains("panicked"), "{arguments:?}: {text}");
        assert!(!Path::new(&results).exists(), "{arguments:?} left something behind");
    }
    let output = simulate(&["--out", &blocked]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && text.contains("--out") && !text.contains("panicked"), "{text}");
}

#[test]
fn an_anchor_out_of_reach_is_met_as_well_as_can_be_and_the_rest_is_reported() {
    let out = folder();
    let anchors = out.path().join("far.json");
    std::fs::write(&anchors, r#"{"anchors":[{"frame":40,"root":[0,0.9,0.5]},{"frame":41,"root":[10,0.9,0.5]}]}"#)
        .unwrap();
    let output = simulate(&["--json", "--anchors", &anchors.to_string_lossy(), "--out", &path(&out, "results")]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let figures = last_line(&output);
    let error = |name: &str| figures[name].as_f64().unwrap_or(f64::NAN);
    assert!(error("control_error_after_cm") <= error("control_error_before_cm"), "{figures}");
    assert!(error("control_error_after_cm") > 50.0, "ten metres in one frame cannot be met: {figures}");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        text.contains("warning: anchor 1 lies 9.1 m beyond what a body can reach in 0.05 s from anchor 0"),
        "{text}"
    );
}

#[cfg(target_os = "linux")]
#[test]
fn output_that_is_lost_is_a_failure() {
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("a full device");
    let output = Command::new(env!("CARGO_BIN_EXE_motionette-sim")).arg("--list").stdout(full).output();
    let output = output.expect("the simulator starts");
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("standard output") && text.contains("No space left"), "{text}");
}

#[cfg(unix)]
#[test]
fn a_prompt_that_is_no_text_is_refused() {
    use std::os::unix::ffi::OsStrExt;
    let output = Command::new(env!("CARGO_BIN_EXE_motionette-sim"))
        .arg("--text")
        .arg(std::ffi::OsStr::from_bytes(&[b'w', 0xFF, 0xFE]))
        .output()
        .expect("the simulator starts");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && text.contains("UTF-8") && !text.contains("panicked"), "{text}");
}

#[test]
fn the_robot_plays_it_and_comes_back_from_every_fault() {
    let out = folder();
    let arguments = ["--faults", "nack,brownout,overrun,corrupt,arena", "--fault-seed", "3", "--json", "--out"];
    let output = simulate(&[&arguments[..], &[&path(&out, "results")]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let figures = last_line(&output);
    // Another seed of the faults is the same motion.
    assert_eq!(figures["motion_hash"], default_job().1["motion_hash"]);
    let robot = &figures["robot"];
    assert_eq!((&robot["faults_injected"], &robot["faults_recovered"]), (&5.into(), &5.into()), "{robot}");
    assert_eq!((&robot["missed_ticks"], &robot["limit_violations"]), (&0.into(), &0.into()), "{robot}");
    assert_eq!((&robot["end_state"], &robot["motions"]), (&"neutral".into(), &2.into()), "{robot}");
    assert!(robot["ticks"].as_u64() > Some(500) && robot["bus_errors"].as_u64() > Some(0), "{robot}");
    let number = |name: &str| robot[name].as_f64().unwrap_or(f64::NAN);
    assert!(number("worst_tracking_deg") < 15.0 && number("servo_control_error_cm") < 30.0, "{robot}");

    let page = std::fs::read_to_string(path(&out, "results/viewer.html")).expect("the viewer");
    assert!(page.contains("\"brownout\"") && page.contains("right elbow"), "the viewer shows servos and faults");
    for (arguments, said) in [
        (&["--faults", "nack,flood"][..], "known are nack, stuck, late, bit, brownout, corrupt, overrun, arena"),
        (&["--robot", "no-such-robot"], "upper-body"),
    ] {
        let output = simulate(arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && text.contains(said), "{arguments:?}: {text}");
    }
}
