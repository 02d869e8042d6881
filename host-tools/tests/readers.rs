//! What other programs read of the files that motionette exports: a fixture of `cargo xtask readers`, which this test needs none of them
//! for. It holds the files that they read, so a change of the export shows here and the fixture is to be made anew.

mod common;

use std::path::PathBuf;

use common::Random;
use common::motions::turning_motion;
use motionette_host::export::{bvh, glb};
use motionette_host::import::bvh::{Reading, load};
use motionette_host::motion::{JOINTS, Pose, skeleton};
use serde_json::{Value, json};

const FIXTURE: &str = include_str!("fixtures/readers.json");
const FRAMES: usize = 6;
const FRAME_TIME: f64 = 0.05;
/// Metres.
const CLOSE: f64 = 1e-3;

/// A body that turns around and whose bones stretch by some per cent.
fn motion() -> Vec<Pose> {
    turning_motion(&mut Random(17), FRAMES, 0.05)
}

fn written(write: impl Fn(&[Pose], f64, &mut dyn std::io::Write) -> std::io::Result<()>) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(&motion(), FRAME_TIME, &mut bytes).expect("memory does not fail");
    bytes
}

/// Name and bytes of every file.
fn files() -> [(&'static str, Vec<u8>); 3] {
    [
        ("rigid.bvh", written(bvh::write_bvh)),
        ("positions.bvh", written(bvh::write_positions)),
        ("motion.glb", written(glb::write_glb)),
    ]
}

fn fixture() -> Value {
    serde_json::from_str(FIXTURE).expect("the fixture is JSON")
}

/// Not a check: writes the files that the readers are given, and what they need to know.
#[test]
#[ignore = "cargo xtask readers runs it to write its files"]
fn write_the_files() {
    let folder = PathBuf::from(std::env::var_os("MOTIONETTE_READERS").expect("MOTIONETTE_READERS names a folder"));
    std::fs::create_dir_all(&folder).expect("a folder");
    for (name, bytes) in files() {
        std::fs::write(folder.join(name), bytes).expect("written");
    }
    let about =
        json!({"frames": FRAMES, "frame_time": FRAME_TIME, "bvh_names": bvh::NAMES, "glb_names": skeleton::NAMES});
    std::fs::write(folder.join("about.json"), about.to_string()).expect("written");
}

/// Equal but for the last digits of numbers: other machines compute other sines.
fn same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => {
            let [a, b] = [a, b].map(|x| x.as_f64().expect("a number"));
            (a - b).abs() <= 1e-4 * a.abs().max(1.0)
        }
        (Value::Array(a), Value::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b)),
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| same(a, b)))
        }
        _ => a == b,
    }
}

/// The words of a line; numbers as numbers.
fn words(line: &str) -> Value {
    line.split_whitespace().map(|word| word.parse::<f64>().map_or_else(|_| json!(word), |x| json!(x))).collect()
}

#[test]
fn the_readers_read_the_files_that_are_written_today() {
    let fixture = fixture();
    for (name, bytes) in files() {
        if name == "motion.glb" {
            let length = u32::from_le_bytes(bytes[12..16].try_into().expect("four bytes")) as usize;
            let document: Value = serde_json::from_slice(&bytes[20..20 + length]).expect("JSON");
            assert!(same(&document, &fixture["document"]), "the GLB has changed: cargo xtask readers");
            continue;
        }
        let text = String::from_utf8(bytes).expect("text");
        let lines = fixture["files"][name].as_array().expect("lines");
        assert_eq!(text.lines().count(), lines.len(), "{name} has changed: cargo xtask readers");
        for (index, (line, read)) in text.lines().zip(lines).enumerate() {
            let read = read.as_str().expect("a line");
            assert!(
                same(&words(line), &words(read)),
                "{name} line {}: {line} was {read}: cargo xtask readers",
                index + 1
            );
        }
    }
}

/// Joints of a reading, metres.
fn joints(reading: &Value) -> Vec<Pose> {
    serde_json::from_value(reading.clone()).expect("[frame][joint][x, y, z]")
}

fn farthest(a: &[Pose], b: &[Pose]) -> f64 {
    assert_eq!(a.len(), b.len());
    let distance = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>().sqrt();
    a.iter().flatten().zip(b.iter().flatten()).map(distance).fold(0.0, f64::max)
}

#[test]
fn every_reader_sees_the_joints_that_we_see() {
    let folder = tempfile::tempdir().expect("a folder");
    let fixture = fixture();
    let motion = motion();
    let bend = bvh::rigid_deviation(&motion).largest;
    assert!((0.005..0.1).contains(&bend), "bones that stretch make a difference: {bend}");
    let mut seen = Vec::new();
    for (name, bytes) in files() {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        // Of a GLB every joint is exact; the importer reads the others.
        let ours = if name.ends_with(".glb") {
            motion.clone()
        } else {
            load(&path, &Reading::default()).expect("read").joints
        };
        let off = farthest(&ours, &motion);
        assert!(if name == "rigid.bvh" { (off - bend).abs() < CLOSE } else { off < CLOSE }, "{name}: {off} m");
        for reading in fixture["readings"].as_array().expect("readings") {
            let Some(theirs) = reading.get(name) else { continue };
            let apart = farthest(&joints(theirs), &ours);
            assert!(apart < CLOSE, "{} reads {name} {apart} m elsewhere", reading["reader"]);
            seen.push(format!("{name} by {}", reading["reader"].as_str().unwrap_or_default()));
        }
    }
    let count = |words: [&str; 2]| seen.iter().filter(|seen| words.iter().all(|word| seen.contains(word))).count();
    assert_eq!([count([".bvh", "BVHLoader"]), count([".bvh", "bvhio"]), count([".glb", "GLTFLoader"])], [2, 2, 1]);
    assert_eq!(motion[0].len(), JOINTS);
}

#[test]
fn the_validator_of_gltf_has_nothing_to_say() {
    let fixture = fixture();
    let validator = &fixture["validator"];
    assert!(validator["reader"].as_str().is_some_and(|reader| reader.starts_with("gltf-validator")));
    for kind in ["errors", "warnings", "infos", "hints"] {
        assert_eq!(validator[kind], 0, "{}", validator["messages"]);
    }
}
