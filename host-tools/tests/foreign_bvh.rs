//! BVH files with the names, hierarchies, units and encodings of other programs, and what is no recording of a body.

mod common;

use std::fs;
use std::path::{Path, PathBuf};

use common::Random;
use common::bench::Bench;
use common::foreign::{Foreign, Scheme};
use motionette_host::import::bvh::{Problem, Reading, Recording, load};
use motionette_host::motion::{JOINTS, skeleton};
use serde_json::json;

type Chain = &'static [(&'static str, &'static str)];

const MIXAMO: Scheme = Scheme {
    name: "mixamo",
    sides: ["Left", "Right"],
    unit: 0.01,
    z_up: false,
    roots: &[],
    spine_above: false,
    pelvis: "mixamorig:Hips",
    leg: &[
        ("mixamorig:{}UpLeg", "hip"),
        ("mixamorig:{}Leg", "knee"),
        ("mixamorig:{}Foot", "ankle"),
        ("mixamorig:{}ToeBase", "foot"),
    ],
    spine: &[("mixamorig:Spine", 0.2), ("mixamorig:Spine1", 0.45), ("mixamorig:Spine2", 0.65)],
    neck: &[("mixamorig:Neck", "neck"), ("mixamorig:Head", "head"), ("mixamorig:HeadTop_End", "top")],
    arm: &[
        ("mixamorig:{}Shoulder", "collar"),
        ("mixamorig:{}Arm", "shoulder"),
        ("mixamorig:{}ForeArm", "elbow"),
        ("mixamorig:{}Hand", "wrist"),
        ("mixamorig:{}HandIndex1", "finger"),
    ],
};

const SMPL_LEG: Chain = &[("{}_Hip", "hip"), ("{}_Knee", "knee"), ("{}_Ankle", "ankle"), ("{}_Foot", "foot")];
const SMPL_ARM: Chain = &[
    ("{}_Collar", "collar"),
    ("{}_Shoulder", "shoulder"),
    ("{}_Elbow", "elbow"),
    ("{}_Wrist", "wrist"),
    ("{}_Hand", "finger"),
];

/// Skeletons without a table.
fn foreign() -> Vec<Scheme> {
    vec![
        Scheme {
            name: "Mixamo through Blender",
            unit: 1.0,
            pelvis: "mixamorig_Hips",
            leg: &[
                ("mixamorig_{}UpLeg", "hip"),
                ("mixamorig_{}Leg", "knee"),
                ("mixamorig_{}Foot", "ankle"),
                ("mixamorig_{}ToeBase", "foot"),
                ("mixamorig_{}Toe_End", "foot"),
            ],
            spine: &[("mixamorig_Spine", 0.2), ("mixamorig_Spine1", 0.45), ("mixamorig_Spine2", 0.65)],
            neck: &[("mixamorig_Neck", "neck"), ("mixamorig_Head", "head")],
            arm: &[
                ("mixamorig_{}Shoulder", "collar"),
                ("mixamorig_{}Arm", "shoulder"),
                ("mixamorig_{}ForeArm", "elbow"),
                ("mixamorig_{}Hand", "wrist"),
            ],
            z_up: true,
            ..MIXAMO
        },
        Scheme {
            name: "HumanIK",
            roots: &["Character1_Reference"],
            pelvis: "Character1_Hips",
            leg: &[
                ("Character1_{}UpLeg", "hip"),
                ("Character1_{}UpLegRoll", "thigh"),
                ("Character1_{}Leg", "knee"),
                ("Character1_{}Foot", "ankle"),
                ("Character1_{}ToeBase", "foot"),
            ],
            spine: &[
                ("Character1_Spine", 0.15),
                ("Character1_Spine1", 0.35),
                ("Character1_Spine2", 0.5),
                ("Character1_Spine3", 0.7),
            ],
            neck: &[("Character1_Neck", "neck"), ("Character1_Head", "head")],
            arm: &[
                ("Character1_{}Shoulder", "collar"),
                ("Character1_{}Arm", "shoulder"),
                ("Character1_{}ForeArm", "elbow"),
                ("Character1_{}ForeArmRoll", "elbow"),
                ("Character1_{}Hand", "wrist"),
            ],
            ..MIXAMO
        },
        Scheme {
            name: "Xsens, joints",
            pelvis: "Hips",
            leg: &[("{}Hip", "hip"), ("{}Knee", "knee"), ("{}Ankle", "ankle"), ("{}Toe", "foot")],
            spine: &[("Chest", 0.15), ("Chest2", 0.3), ("Chest3", 0.5), ("Chest4", 0.7)],
            neck: &[("Neck", "neck"), ("Head", "head")],
            arm: &[("{}Collar", "collar"), ("{}Shoulder", "shoulder"), ("{}Elbow", "elbow"), ("{}Wrist", "wrist")],
            ..MIXAMO
        },
        Scheme {
            name: "Xsens, segments",
            pelvis: "Pelvis",
            leg: &[("{}UpperLeg", "hip"), ("{}LowerLeg", "knee"), ("{}Foot", "ankle"), ("{}Toe", "foot")],
            spine: &[("L5", 0.15), ("L3", 0.3), ("T12", 0.5), ("T8", 0.7)],
            neck: &[("Neck", "neck"), ("Head", "head")],
            arm: &[("{}Shoulder", "collar"), ("{}UpperArm", "shoulder"), ("{}ForeArm", "elbow"), ("{}Hand", "wrist")],
            ..MIXAMO
        },
        Scheme {
            name: "CMU, bones of the asf",
            sides: ["l", "r"],
            unit: 0.0254 / 0.45,
            pelvis: "root",
            leg: &[
                ("{}hipjoint", "pelvis"),
                ("{}femur", "hip"),
                ("{}tibia", "knee"),
                ("{}foot", "ankle"),
                ("{}toes", "foot"),
            ],
            spine: &[("lowerback", 0.0), ("upperback", 0.3), ("thorax", 0.6)],
            neck: &[("lowerneck", "neck"), ("upperneck", "neck"), ("head", "head")],
            arm: &[
                ("{}clavicle", "collar"),
                ("{}humerus", "shoulder"),
                ("{}radius", "elbow"),
                ("{}wrist", "wrist"),
                ("{}hand", "wrist"),
                ("{}fingers", "finger"),
            ],
            ..MIXAMO
        },
        Scheme {
            name: "SMPL",
            sides: ["L", "R"],
            unit: 1.0,
            pelvis: "Pelvis",
            leg: SMPL_LEG,
            spine: &[("Spine1", 0.24), ("Spine2", 0.5), ("Spine3", 0.6)],
            neck: &[("Neck", "neck"), ("Head", "head")],
            arm: SMPL_ARM,
            ..MIXAMO
        },
        Scheme {
            name: "SMPL, lower case",
            sides: ["left", "right"],
            unit: 1.0,
            pelvis: "pelvis",
            leg: &[("{}_hip", "hip"), ("{}_knee", "knee"), ("{}_ankle", "ankle"), ("{}_foot", "foot")],
            spine: &[("spine1", 0.24), ("spine2", 0.5), ("spine3", 0.6)],
            neck: &[("neck", "neck"), ("head", "head")],
            arm: &[("{}_collar", "collar"), ("{}_shoulder", "shoulder"), ("{}_elbow", "elbow"), ("{}_wrist", "wrist")],
            ..MIXAMO
        },
        Scheme {
            name: "SMPL, Maya",
            sides: ["L", "R"],
            unit: 1.0,
            roots: &["m_avg_root"],
            pelvis: "m_avg_Pelvis",
            leg: &[
                ("m_avg_{}_Hip", "hip"),
                ("m_avg_{}_Knee", "knee"),
                ("m_avg_{}_Ankle", "ankle"),
                ("m_avg_{}_Foot", "foot"),
            ],
            spine: &[("m_avg_Spine1", 0.24), ("m_avg_Spine2", 0.5), ("m_avg_Spine3", 0.6)],
            neck: &[("m_avg_Neck", "neck"), ("m_avg_Head", "head")],
            arm: &[
                ("m_avg_{}_Collar", "collar"),
                ("m_avg_{}_Shoulder", "shoulder"),
                ("m_avg_{}_Elbow", "elbow"),
                ("m_avg_{}_Wrist", "wrist"),
            ],
            ..MIXAMO
        },
        Scheme {
            name: "Rigify, deforming bones",
            sides: ["L", "R"],
            unit: 1.0,
            z_up: true,
            pelvis: "DEF-spine",
            leg: &[
                ("DEF-thigh.{}", "hip"),
                ("DEF-thigh.{}.001", "thigh"),
                ("DEF-shin.{}", "knee"),
                ("DEF-foot.{}", "ankle"),
                ("DEF-toe.{}", "foot"),
            ],
            spine: &[("DEF-spine.001", 0.2), ("DEF-spine.002", 0.45), ("DEF-spine.003", 0.65)],
            neck: &[
                ("DEF-spine.004", "neck"),
                ("DEF-spine.005", "neck"),
                ("DEF-spine.006", "head"),
                ("DEF-face", "top"),
            ],
            arm: &[
                ("DEF-shoulder.{}", "collar"),
                ("DEF-upper_arm.{}", "shoulder"),
                ("DEF-upper_arm.{}.001", "arm"),
                ("DEF-forearm.{}", "elbow"),
                ("DEF-hand.{}", "wrist"),
            ],
            ..MIXAMO
        },
        Scheme {
            name: "Poser",
            sides: ["l", "r"],
            unit: 0.0254,
            pelvis: "hip",
            leg: &[
                ("{}Buttock", "pelvis"),
                ("{}Thigh", "hip"),
                ("{}Shin", "knee"),
                ("{}Foot", "ankle"),
                ("{}Toe", "foot"),
            ],
            spine: &[("abdomen", 0.2), ("chest", 0.55)],
            neck: &[("neck", "neck"), ("head", "head")],
            arm: &[("{}Collar", "collar"), ("{}Shldr", "shoulder"), ("{}ForeArm", "elbow"), ("{}Hand", "wrist")],
            ..MIXAMO
        },
        Scheme {
            name: "Daz Genesis",
            sides: ["l", "r"],
            roots: &["hip"],
            spine_above: true,
            pelvis: "pelvis",
            leg: &[
                ("{}ThighBend", "hip"),
                ("{}ThighTwist", "thigh"),
                ("{}Shin", "knee"),
                ("{}Foot", "ankle"),
                ("{}Toe", "foot"),
            ],
            spine: &[("abdomenLower", 0.15), ("abdomenUpper", 0.3), ("chestLower", 0.5), ("chestUpper", 0.7)],
            neck: &[("neckLower", "neck"), ("neckUpper", "neck"), ("head", "head")],
            arm: &[
                ("{}Collar", "collar"),
                ("{}ShldrBend", "shoulder"),
                ("{}ShldrTwist", "arm"),
                ("{}ForearmBend", "elbow"),
                ("{}Hand", "wrist"),
            ],
            ..MIXAMO
        },
        Scheme {
            name: "3ds Max Biped",
            sides: ["L", "R"],
            roots: &["Bip01"],
            pelvis: "Bip01 Pelvis",
            leg: &[
                ("Bip01 {} Thigh", "hip"),
                ("Bip01 {} Calf", "knee"),
                ("Bip01 {} Foot", "ankle"),
                ("Bip01 {} Toe0", "foot"),
            ],
            spine: &[("Bip01 Spine", 0.2), ("Bip01 Spine1", 0.45), ("Bip01 Spine2", 0.65)],
            neck: &[("Bip01 Neck", "neck"), ("Bip01 Head", "head")],
            arm: &[
                ("Bip01 {} Clavicle", "collar"),
                ("Bip01 {} UpperArm", "shoulder"),
                ("Bip01 {} Forearm", "elbow"),
                ("Bip01 {} Hand", "wrist"),
                ("Bip01 {} Finger0", "finger"),
            ],
            ..MIXAMO
        },
        Scheme {
            name: "Unreal",
            sides: ["l", "r"],
            roots: &["root"],
            pelvis: "pelvis",
            leg: &[("thigh_{}", "hip"), ("calf_{}", "knee"), ("foot_{}", "ankle"), ("ball_{}", "foot")],
            spine: &[("spine_01", 0.2), ("spine_02", 0.45), ("spine_03", 0.65)],
            neck: &[("neck_01", "neck"), ("head", "head")],
            arm: &[
                ("clavicle_{}", "collar"),
                ("upperarm_{}", "shoulder"),
                ("lowerarm_{}", "elbow"),
                ("hand_{}", "wrist"),
            ],
            ..MIXAMO
        },
        Scheme {
            name: "VRM",
            sides: ["L", "R"],
            unit: 1.0,
            roots: &["Root"],
            pelvis: "J_Bip_C_Hips",
            leg: &[
                ("J_Bip_{}_UpperLeg", "hip"),
                ("J_Bip_{}_LowerLeg", "knee"),
                ("J_Bip_{}_Foot", "ankle"),
                ("J_Bip_{}_ToeBase", "foot"),
            ],
            spine: &[("J_Bip_C_Spine", 0.2), ("J_Bip_C_Chest", 0.45), ("J_Bip_C_UpperChest", 0.65)],
            neck: &[("J_Bip_C_Neck", "neck"), ("J_Bip_C_Head", "head")],
            arm: &[
                ("J_Bip_{}_Shoulder", "collar"),
                ("J_Bip_{}_UpperArm", "shoulder"),
                ("J_Bip_{}_LowerArm", "elbow"),
                ("J_Bip_{}_Hand", "wrist"),
            ],
            ..MIXAMO
        },
        Scheme {
            name: "Rokoko",
            pelvis: "Hips",
            leg: &[("{}Thigh", "hip"), ("{}Shin", "knee"), ("{}Foot", "ankle"), ("{}Toe", "foot")],
            spine: &[("Spine1", 0.15), ("Spine2", 0.3), ("Spine3", 0.5), ("Spine4", 0.7)],
            neck: &[("Neck", "neck"), ("Head", "head")],
            arm: &[("{}Shoulder", "collar"), ("{}Arm", "shoulder"), ("{}ForeArm", "elbow"), ("{}Hand", "wrist")],
            ..MIXAMO
        },
        Scheme {
            name: "Kinect, without collar bones",
            unit: 0.001,
            pelvis: "SpineBase",
            leg: &[("Hip{}", "hip"), ("Knee{}", "knee"), ("Ankle{}", "ankle"), ("Foot{}", "foot")],
            spine: &[("SpineMid", 0.5), ("SpineShoulder", 0.85)],
            neck: &[("Neck", "neck"), ("Head", "head")],
            arm: &[("Shoulder{}", "shoulder"), ("Elbow{}", "elbow"), ("Wrist{}", "wrist")],
            ..MIXAMO
        },
        Scheme {
            name: "toes, hands and head are End Sites",
            pelvis: "Hips",
            leg: &[("{}UpLeg", "hip"), ("{}Leg", "knee"), ("{}Foot", "ankle")],
            spine: &[("Spine", 0.4)],
            neck: &[("Neck", "neck")],
            arm: &[("{}Arm", "shoulder"), ("{}ForeArm", "elbow")],
            ..MIXAMO
        },
    ]
}

/// A folder with one file.
struct File {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

fn file(bytes: impl AsRef<[u8]>) -> File {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("clip.bvh");
    fs::write(&path, bytes).expect("written");
    File { _folder: folder, path }
}

fn read(text: impl AsRef<[u8]>) -> Recording {
    load(&file(text).path, &Reading::default()).unwrap_or_else(|error| panic!("{error}: {}", error.problem))
}

fn refused(text: impl AsRef<[u8]>) -> Problem {
    load(&file(text).path, &Reading::default()).expect_err("refused").problem
}

/// Largest distance of the joints that the file has itself, metres, and the SMPL joint.
fn farthest(foreign: &Foreign, recording: &Recording) -> (f64, &'static str) {
    assert_eq!(recording.joints.len(), foreign.joints.len());
    let mut worst = (0.0, "");
    for (pose, wanted) in recording.joints.iter().zip(&foreign.joints) {
        for (j, wanted) in wanted.iter().enumerate().filter_map(|(j, wanted)| Some((j, (*wanted)?))) {
            let d = (0..3).map(|c| (f64::from(pose[j][c]) - wanted[c]).powi(2)).sum::<f64>().sqrt();
            if !(d <= worst.0) {
                worst = (d, skeleton::NAMES[j]);
            }
        }
    }
    worst
}

#[test]
fn skeletons_of_other_programs_open_without_a_table() {
    let mut random = Random(4);
    for scheme in foreign() {
        let moved = scheme.moved(4, 30.0, &mut random);
        let recording = read(&moved.text);
        let (off, joint) = farthest(&moved, &recording);
        assert!(off < 1e-4, "{}: {joint} is {off} m off\n{:?}", scheme.name, recording.notes);
        assert_eq!(recording.mapping, "guessed", "{}", scheme.name);
        assert_eq!(
            moved.joints[0].iter().filter(|joint| joint.is_some()).count(),
            if moved.names[13].is_some() { 19 } else { 17 }
        );
        let told = recording.notes.join("\n");
        for (smpl, name) in skeleton::NAMES.iter().zip(&moved.names) {
            let line = name.as_ref().map(|name| format!("{smpl} = {name}"));
            assert!(line.is_none_or(|line| told.contains(&line)), "{}: {smpl} in {told}", scheme.name);
        }
        assert!(told.contains("--mapping") && told.contains("--unit"), "{told}");
        assert_eq!(told.contains("z points up"), scheme.z_up, "{}: {told}", scheme.name);

        // Standing: what the skeleton lacks is about where it must be.
        let standing = scheme.moved(2, 0.0, &mut random);
        let pose = read(&standing.text).joints[0];
        let height = |j: usize| (pose[j][1] - pose[0][1]) / (pose[12][1] - pose[0][1]);
        for (joint, share) in [(3, 0.239), (6, 0.498), (9, 0.602)] {
            assert!(
                (height(joint) - share).abs() < 0.08,
                "{}: {} at {}",
                scheme.name,
                skeleton::NAMES[joint],
                height(joint)
            );
        }
        for (collar, side) in [(13, 1.0), (14, -1.0)] {
            let x = side * pose[collar][0];
            assert!((0.02..0.1).contains(&x) && height(collar) > 0.5, "{}: {:?}", scheme.name, pose[collar]);
        }
    }
}

#[test]
fn a_table_goes_before_a_guess_whatever_the_namespace() {
    let moved = MIXAMO.moved(3, 30.0, &mut Random(5));
    for namespace in ["mixamorig:", "mixamorig7:", "a:b:", "Armature|mixamorig:", ""] {
        let recording = read(moved.text.replace("mixamorig:", namespace));
        assert_eq!((recording.mapping.as_str(), recording.notes.len()), ("mixamo", 0), "{namespace}");
        assert!(farthest(&moved, &recording).0 < 1e-4);
    }
    let lafan = moved.text.replace("mixamorig:", "").replace("ToeBase", "Toe");
    assert_eq!(read(lafan).mapping, "lafan1");
}

#[test]
fn names_that_say_nothing_are_refused_with_what_is_unclear() {
    let text = MIXAMO.moved(3, 30.0, &mut Random(5)).text.replace("LeftLeg", "abc").replace("RightForeArm", "def");
    let said = refused(text).to_string();
    assert!(said.contains("the left leg, the right arm;") && said.contains("--mapping FILE.json"), "{said}");
    let many = [
        "HIERARCHY ROOT Hips { OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition ",
        &"JOINT LeftLeg { OFFSET 0 1 0 CHANNELS 0 ".repeat(4000),
        &"} ".repeat(4001),
        "\nMOTION\nFrames: 1\nFrame Time: 0.05\n0 0 0\n",
    ];
    assert!(matches!(refused(many.concat()), Problem::NoMapping { .. }));
}

/// Names in the wrong places: necks below feet, two pelvises, hands above arms.
#[test]
fn shuffled_names_are_read_or_refused() {
    let mut random = Random(10);
    let texts: Vec<String> = foreign().iter().map(|scheme| scheme.moved(2, 30.0, &mut random).text).collect();
    let (mut taken, mut refusals) = (0, 0);
    for case in 0..600 {
        let mut lines: Vec<String> = texts[case % texts.len()].lines().map(str::to_owned).collect();
        let named: Vec<usize> = (1..lines.len()).filter(|&i| lines[i].starts_with("JOINT")).collect();
        for _ in 0..=random.bits() % 6 {
            let [a, b] = [(); 2].map(|()| named[(random.bits() % named.len() as u64) as usize]);
            lines.swap(a, b);
            if random.bits().is_multiple_of(4) {
                lines[a] = lines[b].clone();
            }
        }
        match load(&file(lines.join("\n") + "\n").path, &Reading::default()) {
            Ok(recording) => {
                assert!(recording.joints.iter().flatten().flatten().all(|x| x.is_finite()), "case {case}");
                taken += 1;
            }
            Err(error) => {
                assert!(!error.problem.to_string().is_empty(), "case {case}");
                refusals += 1;
            }
        }
    }
    assert!(taken > 50 && refusals > 50, "{taken} {refusals}");
}

#[test]
fn encodings_and_ends_of_lines_of_other_systems_are_read() {
    let text = MIXAMO.moved(3, 30.0, &mut Random(6)).text;
    let plain = read(&text);
    let wide = |unit: fn(u16) -> [u8; 2]| -> Vec<u8> {
        std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(unit).collect()
    };
    assert_eq!(read(text.replace('\n', "\r")), plain);
    assert_eq!(read(text.replace('\n', "\r\n")), plain);
    assert_eq!(read(format!("\u{feff}{text}")), plain);
    assert_eq!(read(wide(u16::to_le_bytes)), plain);
    assert_eq!(read(wide(u16::to_be_bytes)), plain);
    // A line is still counted once.
    let line = text.lines().position(|line| line.starts_with("MOTION")).expect("a line") + 1;
    for end in ["\r", "\r\n"] {
        let broken = file(text.replace("MOTION", "MOTON").replace('\n', end));
        assert_eq!(load(&broken.path, &Reading::default()).expect_err("refused").line, line);
    }
}

/// The value of a channel of a frame in the text replaced.
fn with_value(text: &str, frame: usize, channel: usize, value: &str) -> String {
    let start = text.lines().position(|line| line.starts_with("Frame Time")).expect("a line") + 1;
    let changed = |(index, line): (usize, &str)| {
        if index != start + frame {
            return line.to_owned();
        }
        let mut words: Vec<&str> = line.split(' ').collect();
        words[channel] = value;
        words.join(" ")
    };
    text.lines().enumerate().map(changed).collect::<Vec<_>>().join("\n") + "\n"
}

/// Files that are no recording of a body, each with words of its refusal.
fn impossible() -> Vec<(String, &'static str)> {
    let text = MIXAMO.moved(12, 20.0, &mut Random(7)).text;
    let collapsed: Vec<&str> =
        text.lines().map(|line| if line.starts_with("OFFSET") { "OFFSET 0 0 0" } else { line }).collect();
    vec![
        (collapsed.join("\n") + "\n", "21 of the 21 bones have no length"),
        (with_value(&text, 5, 1, "1e39"), "1e39"),
        (with_value(&text, 5, 1, "-1e39"), "-1e39"),
        (with_value(&text, 5, 2, "nan"), "nan"),
        (with_value(&text, 5, 0, "-inf"), "-inf"),
        (with_value(&text, 5, 0, "5000"), "frame 5 (0.25 s): pelvis is 50 m"),
        (with_value(&text, 0, 2, "9e6"), "more than 10000 m"),
        (text.replace("OFFSET 0.", "OFFSET 1e300"), "1e300"),
    ]
}

#[test]
fn what_is_no_body_is_refused_before_anything_is_written() {
    let bench = Bench::new();
    for (text, words) in impossible() {
        bench.write("bad.bvh", text.as_bytes());
        bench.fails(&["export", "--bvh", "bad.bvh", "--format", "bvh", "-o", "x"], &["bad.bvh", words]);
        bench.fails(&["export", "--bvh", "bad.bvh", "--robot", "desk", "--format", "csv", "-o", "x"], &[words]);
        bench.fails(&["import", "bvh", "bad.bvh", "-o", "x"], &["bad.bvh", words]);
        bench.fails(&["robot", "fit", "desk", "--bvh", "bad.bvh"], &[words]);
    }
}

#[cfg(unix)]
#[test]
fn files_without_end_are_refused_unread() {
    let bench = Bench::new();
    for path in ["/dev/zero", "/dev/null"] {
        bench.fails(&["export", "--bvh", path, "--format", "bvh", "-o", "x"], &[path, "device"]);
        bench.fails(&["export", "--bvh", "m.bvh", "--mapping", path, "--format", "bvh", "-o", "x"], &["device"]);
        bench.fails(&["import", "bvh", path, "-o", "x"], &[path, "device"]);
        bench.fails(&["import", "kimodo", path, "-o", "x"], &[path, "device"]);
    }
    // A pipe in a folder would wait for a writer; a hole of 2 GiB costs nothing.
    fs::create_dir(bench.path("takes")).expect("a folder");
    let pipe = std::process::Command::new("mkfifo").arg(bench.path("takes/pipe.bvh")).status().expect("mkfifo");
    assert!(pipe.success());
    bench.fails(&["import", "bvh", "takes", "-o", "x"], &["no .bvh file in takes"]);
    fs::File::create(bench.path("long.bvh")).and_then(|file| file.set_len(2 << 30)).expect("a sparse file");
    bench.fails(&["export", "--bvh", "long.bvh", "--format", "bvh", "-o", "x"], &["at most 1073741824"]);
}

#[test]
fn the_unit_is_what_the_user_says_and_its_likelihood_is_checked() {
    let bench = Bench::new();
    let mut random = Random(8);
    let metres = Scheme { unit: 1.0, ..MIXAMO }.moved(12, 20.0, &mut random);
    let inches = Scheme { unit: 0.0254, ..MIXAMO }.moved(12, 20.0, &mut random);
    bench.write("m.bvh", metres.text.as_bytes());
    bench.write("inch.bvh", inches.text.as_bytes());
    let to_x = ["--format", "bvh", "-o", "x"];
    bench.fails(&[&["export", "--bvh", "m.bvh"][..], &to_x].concat(), &["the likely unit is m: give --unit m"]);
    bench.fails(&[&["export", "--bvh", "inch.bvh"][..], &to_x].concat(), &["--unit inch, or --unit cm"]);
    bench.fails(&[&["export", "--bvh", "m.bvh", "--unit", "100"][..], &to_x].concat(), &["give --unit m"]);
    bench.fails(&["import", "bvh", "m.bvh", "-o", "x"], &["--unit m"]);
    bench.fails(&["robot", "fit", "desk", "--bvh", "m.bvh"], &["--unit m"]);
    bench.misused("export --bvh m.bvh --unit furlong -o x", "m, cm, mm, inch");
    bench.succeeds("robot fit desk --bvh m.bvh --unit m");
    bench.succeeds("import bvh m.bvh --unit m -o m.mds");
    for (foreign, name, unit) in
        [(&metres, "m.bvh", "m"), (&inches, "inch.bvh", "inch"), (&inches, "inch.bvh", "0.0254")]
    {
        bench.succeeds(&format!("export --bvh {name} --unit {unit} --positions -o back.bvh"));
        let back = load(&bench.path("back.bvh"), &Reading::default()).expect("read");
        assert!(farthest(foreign, &back).0 < 1e-4, "{unit}");
    }
}

#[test]
fn a_mapping_may_name_end_sites_and_leave_the_unit_out() {
    let bench = Bench::new();
    let scheme = foreign().pop().expect("the last one has End Sites");
    let moved = scheme.moved(12, 20.0, &mut Random(9));
    let odd = |name: &str| name.replace("UpLeg", "A").replace("Leg", "B").replace("ForeArm", "C").replace("Arm", "D");
    bench.write("odd.bvh", odd(&moved.text).as_bytes());
    bench.fails(&["export", "--bvh", "odd.bvh", "--format", "bvh", "-o", "x"], &["LeftFoot End Site", "the left leg"]);
    let mut joints = serde_json::Map::new();
    for (smpl, name) in skeleton::NAMES.iter().zip(&moved.names) {
        let between = |from: &str, to: &str, at: f64| json!({"from": from, "to": to, "at": at});
        let source = match (name, *smpl) {
            (Some(name), _) => json!(odd(name)),
            (None, "left_collar") => between("Spine", "LeftD", 0.4),
            (None, "right_collar") => between("Spine", "RightD", 0.4),
            (None, "spine1") => between("Hips", "Neck", 0.25),
            (None, "spine2") => between("Hips", "Neck", 0.5),
            (None, _) => between("Hips", "Neck", 0.6),
        };
        joints.insert((*smpl).to_owned(), source);
    }
    bench.write("map.json", json!({"name": "odd", "joints": joints}).to_string().as_bytes());
    let made = bench.succeeds("export --bvh odd.bvh --mapping map.json --positions -o back.bvh");
    assert_eq!(made["frames"], 12);
    let back = load(&bench.path("back.bvh"), &Reading::default()).expect("read");
    assert!(farthest(&moved, &back).0 < 1e-4);
    bench.succeeds("robot fit desk --bvh odd.bvh --mapping map.json");
    let imported = bench.succeeds("import bvh odd.bvh --mapping map.json -o odd.mds");
    assert!(imported["notes"][0]["text"].as_str().is_some_and(|text| text.contains("taken to be in cm")), "{imported}");
    joints.insert("left_foot".into(), json!("LeftHand End Site"));
    bench.write("map.json", json!({"name": "odd", "unit": "cm", "joints": joints}).to_string().as_bytes());
    bench.fails(
        &["export", "--bvh", "odd.bvh", "--mapping", "map.json", "--format", "bvh", "-o", "x"],
        &["mapping odd needs joints the file does not have: LeftHand End Site"],
    );
}

#[test]
fn what_was_guessed_is_told_once_for_many_files() {
    let bench = Bench::new();
    let scheme = &foreign()[2];
    fs::create_dir(bench.path("takes")).expect("a folder");
    for take in 0..3 {
        let text = scheme.moved(12, 20.0, &mut Random(take)).text;
        bench.write(&format!("takes/{take}.bvh"), text.as_bytes());
    }
    let output = bench.run(&["import", "bvh", "takes", "-o", "takes.mds"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(
        said.lines().filter(|line| line.starts_with("note: ") && line.contains("joints guessed")).count(),
        1,
        "{said}"
    );
    assert!(said.contains("note: 0 and 2 more: joints guessed") && said.contains("left_hip = LeftHip"), "{said}");
    assert!(Path::new(&bench.path("takes.mds")).is_file());
    assert_eq!(JOINTS, skeleton::NAMES.len());
}
