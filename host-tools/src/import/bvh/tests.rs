use std::fmt::Write as _;
use std::path::PathBuf;

use super::*;
use crate::motion::quaternion::{self as q, Vector};

/// Root with two children; channel orders differ, `b` has positions that replace its offset.
const SMALL: &str = "HIERARCHY
ROOT hips
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT a
  {
    OFFSET 0 10 0
    CHANNELS 3 Yrotation Zrotation Xrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
  JOINT b
  {
    OFFSET 7 7 7
    CHANNELS 5 Xrotation Zposition Yrotation Xposition Zrotation
    JOINT c
    {
      OFFSET 2 0 0
      CHANNELS 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.05
0 0 0 0 0 0 0 0 0 0 0 0 0 0
4 5 6 10 20 30 40 50 60 70 -8 80 9 25
";

fn positions(bvh: &Bvh, frame: usize) -> Vec<Vector> {
    kinematics::positions(bvh, &resample::to_20_fps(bvh, 0).nth(frame).unwrap())
}

fn close(a: Vector, b: Vector) {
    assert!(q::length(q::subtract(a, b)) < 1e-9, "{a:?} {b:?}");
}

/// Rotation matrix about an axis, written out: independent of the quaternions under test.
fn matrix(axis: usize, degrees: f64) -> [[f64; 3]; 3] {
    let (s, c) = degrees.to_radians().sin_cos();
    match axis {
        0 => [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]],
        1 => [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
        _ => [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
    }
}

fn apply(rotations: &[(usize, f64)], v: Vector) -> Vector {
    rotations.iter().rev().fold(v, |v, &(axis, degrees)| matrix(axis, degrees).map(|row| q::dot(row, v)))
}

#[test]
fn forward_kinematics_agrees_with_matrices() {
    let bvh = parse(SMALL).unwrap();
    let names: Vec<&str> = bvh.joints.iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names, ["hips", "a", "a End Site", "b", "c"]);
    let parents: Vec<Option<usize>> = bvh.joints.iter().map(|j| j.parent).collect();
    assert_eq!(parents, [None, Some(0), Some(1), Some(0), Some(3)]);
    assert_eq!((bvh.channels, bvh.frames(), bvh.fps()), (14, 2, 20.0));
    let rest = positions(&bvh, 0);
    close(rest[0], [0.0, 0.0, 0.0]);
    close(rest[1], [0.0, 10.0, 0.0]);
    close(rest[2], [0.0, 15.0, 0.0]);
    close(rest[3], [0.0, 7.0, 0.0]);

    let moved = positions(&bvh, 1);
    let root = [(2, 10.0), (0, 20.0), (1, 30.0)];
    close(moved[0], [4.0, 5.0, 6.0]);
    close(moved[1], q::add(moved[0], apply(&root, [0.0, 10.0, 0.0])));
    let a = [(2, 10.0), (0, 20.0), (1, 30.0), (1, 40.0), (2, 50.0), (0, 60.0)];
    close(moved[2], q::add(moved[1], apply(&a, [0.0, 5.0, 0.0])));
    close(moved[3], q::add(moved[0], apply(&root, [9.0, 7.0, -8.0])));
    let b = [(2, 10.0), (0, 20.0), (1, 30.0), (0, 70.0), (1, 80.0), (2, 25.0)];
    close(moved[4], q::add(moved[3], apply(&b, [2.0, 0.0, 0.0])));
}

#[test]
fn every_rotation_order_is_read_as_written() {
    for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        let names: Vec<String> = order.iter().map(|&axis| format!("{}rotation", ["X", "Y", "Z"][axis])).collect();
        let text = format!(
            "HIERARCHY ROOT r {{ OFFSET 0 0 0 CHANNELS 6 {} Zposition Xposition Yposition JOINT tip {{ OFFSET 1 2 3 CHANNELS 0 }} }}
             MOTION\nFrames: 1\nFrame Time: 0.05\n33 -71 128 3 1 2\n",
            names.join(" ")
        );
        let bvh = parse(&text).unwrap();
        let rotations: Vec<(usize, f64)> = order.into_iter().zip([33.0, -71.0, 128.0]).collect();
        close(positions(&bvh, 0)[1], q::add([1.0, 2.0, 3.0], apply(&rotations, [1.0, 2.0, 3.0])));
    }
}

#[test]
fn layout_is_free() {
    let text = "\u{feff}hierarchy root Left Hip{offset 0 0 0\nchannels 3 XPOSITION yposition Zposition End Site { OFFSET 1 1 1 } }\r\nMotion\r\nFrames: 2\r\nFrame Time: 0.0333333\r\n\r\n1 2 3\r\n\r\n  4\t5 6\r\n\r\n";
    let bvh = parse(text).unwrap();
    assert_eq!(bvh.joints[0].name, "Left Hip");
    assert_eq!(bvh.values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    assert_eq!(bvh.fps(), 30.0);
}

fn problem(text: &str) -> (usize, Problem) {
    parse(text).unwrap_err()
}

fn changed(from: &str, to: &str) -> (usize, Problem) {
    assert!(SMALL.contains(from));
    problem(&SMALL.replacen(from, to, 1))
}

#[test]
fn each_fault_is_named_with_its_line() {
    type Case = ((usize, Problem), usize, fn(&Problem) -> bool);
    let cases: Vec<Case> = vec![
        (problem(""), 0, |p| matches!(p, Problem::Ends { .. })),
        (problem("PNG ..."), 1, |p| matches!(p, Problem::Expected { .. })),
        (changed("OFFSET 0 10 0", "OFFSET 0 10"), 9, |p| matches!(p, Problem::NotANumber { .. })),
        (changed("OFFSET 0 10 0", "OFFSET 0 1,5 0"), 8, |p| matches!(p, Problem::NotANumber { .. })),
        (changed("OFFSET 0 10 0", "OFFSET 0 nan 0"), 8, |p| matches!(p, Problem::NotFinite { .. })),
        (changed("    OFFSET 0 10 0\n", ""), 13, |p| matches!(p, Problem::Incomplete { missing: "OFFSET", .. })),
        (changed("      CHANNELS 0\n", ""), 22, |p| matches!(p, Problem::Incomplete { missing: "CHANNELS", .. })),
        (changed("CHANNELS 3 Y", "CHANNELS 7 Y"), 9, |p| matches!(p, Problem::ChannelCount { .. })),
        (changed("CHANNELS 3 Y", "CHANNELS -1 Y"), 9, |p| matches!(p, Problem::ChannelCount { .. })),
        (changed("Yrotation Zrotation Xrotation", "Yrotation Wrotation Xrotation"), 9, |p| {
            matches!(p, Problem::UnknownChannel { .. })
        }),
        (changed("Yrotation Zrotation Xrotation", "Yrotation Zrotation Yrotation"), 9, |p| {
            matches!(p, Problem::RepeatedChannel { .. })
        }),
        (changed("CHANNELS 3 Y", "CHANNELS 2 Y"), 9, |p| matches!(p, Problem::Expected { .. })),
        (changed("MOTION", "ROOT second"), 26, |p| matches!(p, Problem::SecondRoot { .. })),
        (changed("Xposition Yposition", "Xrotation Yposition"), 5, |p| matches!(p, Problem::RepeatedChannel { .. })),
        (changed("6 Xposition Yposition Zposition", "5 Xposition Yposition"), 0, |p| {
            matches!(p, Problem::NoRootMotion)
        }),
        (changed("Frames: 2", "Frames: 0"), 27, |p| matches!(p, Problem::Frames { .. })),
        (changed("Frames: 2", "Frames: 99999999999999999999"), 27, |p| matches!(p, Problem::Frames { .. })),
        (changed("Frames: 2", "Frames: 4000000000"), 0, |p| matches!(p, Problem::MissingFrames { found: 2, .. })),
        (changed("Frames: 2", "Frames: 1"), 30, |p| matches!(p, Problem::ExtraFrames { announced: 1 })),
        (changed("Time: 0.05", "Time: 0"), 28, |p| matches!(p, Problem::FrameTime { .. })),
        (changed("Time: 0.05", "Time: -0.05"), 28, |p| matches!(p, Problem::FrameTime { .. })),
        (changed("Time: 0.05", "Time: NaN"), 28, |p| matches!(p, Problem::NotFinite { .. })),
        (changed("Time: 0.05", "Time: 1e9"), 28, |p| matches!(p, Problem::FrameTime { .. })),
        (changed("9 25", "9"), 30, |p| matches!(p, Problem::Row { frame: 1, expected: 14, found: 13 })),
        (changed("9 25", "9 25 1 2"), 30, |p| matches!(p, Problem::Row { frame: 1, expected: 14, found: 16 })),
        (
            changed("OFFSET 0 10 0", "OFFSET 0 2e7 0"),
            8,
            |p| matches!(p, Problem::TooLarge { what, .. } if what == "OFFSET of a"),
        ),
        (changed("OFFSET 0 5 0", "OFFSET 0 5e8 0"), 12, |p| matches!(p, Problem::TooLarge { .. })),
        (
            changed("4 5 6", "4 1e39 6"),
            30,
            |p| matches!(p, Problem::TooLarge { what, .. } if what.contains("\"hips\", Position(1)")),
        ),
        (
            changed("70 -8", "70 inf"),
            30,
            |p| matches!(p, Problem::NotFinite { what, .. } if what.contains("\"b\", Position(2)")),
        ),
    ];
    for (index, ((line, problem), expected, fits)) in cases.into_iter().enumerate() {
        assert!(fits(&problem), "case {index}: {problem:?}");
        assert_eq!(line, expected, "case {index}: {problem}");
    }
}

#[test]
fn every_truncation_is_an_error() {
    for length in 0..SMALL.len() - 2 {
        // Cutting digits off the very last number leaves a whole file.
        assert!(parse(&SMALL[..length]).is_err(), "{length}");
    }
}

#[test]
fn deep_nesting_neither_overflows_nor_passes() {
    let nested = |depth: usize| {
        let mut text = String::from("HIERARCHY ROOT r { OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition ");
        for _ in 1..depth {
            text.push_str("JOINT j { OFFSET 0 1 0 CHANNELS 0 ");
        }
        text.push_str(&"} ".repeat(depth));
        text.push_str("\nMOTION\nFrames: 1\nFrame Time: 0.05\n0 0 0\n");
        text
    };
    let bvh = parse(&nested(4096)).unwrap();
    close(positions(&bvh, 0)[4095], [0.0, 4095.0, 0.0]);
    assert!(matches!(problem(&nested(1_000_000)).1, Problem::TooManyJoints { .. }));
    assert!(matches!(problem(&format!("HIERARCHY ROOT {}", "x ".repeat(100_000))).1, Problem::Expected { .. }));
}

/// Whatever the bytes, parsing ends with a file or an error, and what parses can be played.
#[test]
fn mutated_files_never_panic() {
    let mut state = 1u64;
    let mut random = |bound: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % bound
    };
    let words = [
        "{",
        "}",
        "JOINT x {",
        "End Site",
        "nan",
        "-1",
        "1e308",
        "CHANNELS 1 Xrotation",
        "Frames: 3",
        "\n",
        "MOTION",
        "\u{e9}",
    ];
    let (mut parsed, mut refused) = (0, 0);
    for _ in 0..20_000 {
        let mut bytes = SMALL.as_bytes().to_vec();
        for _ in 0..1 + random(3) {
            if bytes.is_empty() {
                break;
            }
            let at = random(bytes.len());
            match random(4) {
                0 => bytes[at] = random(256) as u8,
                1 => drop(bytes.drain(at..(at + random(40)).min(bytes.len()))),
                2 => drop(bytes.splice(at..at, words[random(words.len())].bytes())),
                _ => bytes.truncate(at.max(1)),
            }
        }
        match parse(&String::from_utf8_lossy(&bytes)) {
            Ok(bvh) => {
                let last = positions(&bvh, 0);
                assert_eq!(last.len(), bvh.joints.len());
                parsed += 1;
            }
            Err((_, problem)) => {
                assert!(problem.to_string().len() < 400);
                refused += 1;
            }
        }
    }
    assert!(parsed > 100 && refused > 1000, "{parsed} {refused}");
}

/// One joint that walks and turns, at a frame rate.
fn walk(frame_time: f64, frames: usize) -> Bvh {
    let mut text = String::from(
        "HIERARCHY ROOT r { OFFSET 0 0 0 CHANNELS 4 Xposition Yposition Zposition Yrotation JOINT t { OFFSET 0 0 1 CHANNELS 0 } }\nMOTION\n",
    );
    writeln!(text, "Frames: {frames}\nFrame Time: {frame_time}").unwrap();
    for t in 0..frames {
        writeln!(text, "{} 0 0 {}", t as f64 * frame_time, 100.0 * t as f64 * frame_time).unwrap();
    }
    parse(&text).unwrap()
}

#[test]
fn resampling_keeps_time_and_turns_on_the_arc() {
    for (frame_time, frames, expected) in
        [(0.0333333, 128, 85), (0.0333333, 90, 60), (0.05, 7, 7), (0.0083333, 61, 11), (0.1, 4, 7)]
    {
        let bvh = walk(frame_time, frames);
        let out: Vec<_> = resample::to_20_fps(&bvh, 0).collect();
        assert_eq!(out.len(), expected, "{frame_time} x {frames}");
        for (k, frame) in out.iter().enumerate() {
            let seconds = k as f64 / 20.0;
            let at = kinematics::positions(&bvh, frame);
            let angle = (100.0 * seconds).to_radians();
            // Frame times in files are rounded; over 4 s that is some 1e-5.
            assert!((at[0][0] - seconds).abs() < 1e-4, "{k}: {at:?}");
            assert!(
                (at[1][0] - at[0][0] - angle.sin()).abs() < 2e-4 && (at[1][2] - angle.cos()).abs() < 2e-4,
                "{k}: {at:?}"
            );
        }
    }
}

#[test]
fn built_in_tables_are_whole() {
    let names: Vec<String> = Mapping::built_in().map(|mapping| mapping.name).collect();
    assert_eq!(names, ["bandai-namco", "iclone", "cmu-cgspeed", "mixamo", "lafan1"]);
    for mapping in Mapping::built_in() {
        let mut keys: Vec<&str> = mapping.joints.keys().map(String::as_str).collect();
        let mut expected = crate::motion::skeleton::NAMES.to_vec();
        keys.sort_unstable();
        expected.sort_unstable();
        assert_eq!(keys, expected, "{}", mapping.name);
    }
}

/// A file whose joints are called as in CMU's conversion by B. Hahne: a rest pose first, then `frames` frames.
fn cgspeed(frames: usize) -> String {
    let chain = |names: &[&str], offset: &str| {
        let open = |name: &&str| format!("JOINT {name} {{ OFFSET {offset} CHANNELS 3 Zrotation Yrotation Xrotation\n");
        let opened: String = names.iter().map(open).collect();
        format!("{opened} End Site {{ OFFSET 0 0 1 }}{}", "}".repeat(names.len()))
    };
    let arm = |s: &str| {
        chain(&[&format!("{s}Shoulder"), &format!("{s}Arm"), &format!("{s}ForeArm"), &format!("{s}Hand")], "3 0 0")
    };
    let leg = |s: &str, x: f64| {
        chain(
            &[&format!("{s}UpLeg"), &format!("{s}Leg"), &format!("{s}Foot"), &format!("{s}ToeBase")],
            &format!("{x} -7 0.5"),
        )
    };
    let spine = "JOINT LowerBack { OFFSET 0 0 0 CHANNELS 3 Zrotation Yrotation Xrotation\n";
    let text = format!(
        "HIERARCHY ROOT Hips {{ OFFSET 0 0 0 CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation\n{}{}{spine}\
         JOINT Spine {{ OFFSET 0 2 0 CHANNELS 3 Zrotation Yrotation Xrotation\n\
         JOINT Spine1 {{ OFFSET 0 2 0 CHANNELS 3 Zrotation Yrotation Xrotation\n{}{}{}\n}} }} }} }}\nMOTION\n",
        leg("Left", 1.6),
        leg("Right", -1.6),
        chain(&["Neck", "Neck1", "Head"], "0 1.7 0"),
        arm("Left"),
        arm("Right").replace("OFFSET 3", "OFFSET -3"),
    );
    let channels = 3 + text.matches("rotation").count();
    let mut text = format!("{text}Frames: {}\nFrame Time: 0.05\n", frames + 1);
    for t in 0..=frames {
        // The rest pose stands elsewhere, so that a forgotten one is noticed.
        let x = if t == 0 { 100.0 } else { t as f64 };
        writeln!(text, "{x} 17 0{}", " 1".repeat(channels - 3)).unwrap();
    }
    text
}

fn written(text: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("clip.bvh");
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

#[test]
fn cmu_conversions_lose_their_rest_pose() {
    let (_folder, path) = written(&cgspeed(5));
    let recording = load(&path, &Reading::default()).unwrap();
    assert_eq!((recording.mapping.as_str(), recording.joints.len(), recording.fps_source), ("cmu-cgspeed", 5, 20.0));
    for (t, pose) in recording.joints.iter().enumerate() {
        assert!((pose[0][0] - (t as f32 + 1.0) * 0.056_444_44).abs() < 1e-5);
    }
    assert!(crate::motion::features::process(&recording.joints, &Default::default()).is_ok());
    let (_folder, path) = written(&cgspeed(0));
    assert!(matches!(load(&path, &Reading::default()).unwrap_err().problem, Problem::NothingLeft { dropped: 1 }));
}

#[test]
fn unmapped_joints_are_listed() {
    let (_folder, path) = written(&cgspeed(3).replace("LeftForeArm", "gizmo"));
    let error = load(&path, &Reading::default()).unwrap_err();
    let text = format!("{error}: {}", error.problem);
    assert!(
        matches!(&error.problem, Problem::NoMapping { closest, missing, .. } if closest.as_ref() == "cmu-cgspeed" && missing == "LeftForeArm")
    );
    assert!(["clip.bvh", "gizmo", "--mapping", "the left arm"].iter().all(|word| text.contains(word)), "{text}");

    let (_folder, path) = written(&cgspeed(3).replace("JOINT LowerBack", "JOINT Neck1"));
    assert!(
        matches!(load(&path, &Reading::default()).unwrap_err().problem, Problem::Ambiguous { name } if name == "Neck1")
    );
    assert!(matches!(load(&path.with_extension("none"), &Reading::default()).unwrap_err().problem, Problem::Read(_)));
}

#[test]
fn a_mapping_of_the_users_own() {
    let text = cgspeed(4).replace("JOINT Left", "JOINT rig:l_").replace("JOINT Right", "JOINT rig:r_");
    let (folder, path) = written(&text);
    let mut json: serde_json::Value = serde_json::from_str(
        include_str!("mappings/cmu-cgspeed.json").replace("Left", "l_").replace("Right", "r_").as_str(),
    )
    .unwrap();
    json["unit"] = 0.05.into();
    json["up"] = "z".into();
    let file = folder.path().join("mapping.json");
    std::fs::write(&file, json.to_string()).unwrap();
    let mapping = Mapping::read(&file).unwrap();
    let pose = load(&path, &Reading { mapping: Some(mapping), unit: None }).unwrap().joints[0];
    assert_eq!(pose[0], [0.05, 0.0, -0.85]);

    let check = |change: &dyn Fn(&mut serde_json::Value), fits: fn(&MappingError) -> bool| {
        let mut wrong = json.clone();
        change(&mut wrong);
        std::fs::write(&file, wrong.to_string()).unwrap();
        let error = Mapping::read(&file).unwrap_err();
        assert!(fits(&error), "{error:?}");
    };
    check(&|j| j["unit"] = 0.into(), |e| matches!(e, MappingError::Form { .. }));
    check(&|j| j["unit"] = "furlong".into(), |e| matches!(e, MappingError::Form { .. }));
    check(&|j| j["units"] = 1.into(), |e| matches!(e, MappingError::Form { .. }));
    check(&|j| j["joints"]["tail"] = "Tail".into(), |e| matches!(e, MappingError::Unknown { .. }));
    check(
        &|j| drop(j["joints"].as_object_mut().unwrap().remove("head")),
        |e| matches!(e, MappingError::Missing { missing, .. } if missing == "head"),
    );
    assert!(matches!(Mapping::read(folder.path()), Err(MappingError::Read { .. })));
}
