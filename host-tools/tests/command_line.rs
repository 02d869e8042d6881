//! The `motionette` program from outside: results, `--json`, failures.

mod common;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use common::Random;
use motionette_host::dataset::{Dataset, Split};
use motionette_host::import::npy;
use motionette_host::motion::{FEATURES, JOINTS, Pose, recover, skeleton};
use motionette_host::output::write_atomic;
use serde_json::Value;

fn motionette(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_motionette")).args(arguments).current_dir(folder).output().unwrap()
}

/// The object on the last line of standard output.
fn report(output: &Output) -> Value {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    serde_json::from_str(text.lines().last().unwrap()).unwrap()
}

fn succeeds(folder: &Path, arguments: &[&str]) -> Value {
    let output = motionette(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    report(&output)
}

/// Fails with status 1, says all of `words`, and leaves the folder as it was.
fn fails(folder: &Path, arguments: &[&str], words: &[&str]) {
    let before = listing(folder);
    let output = motionette(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
    assert!(said.starts_with("error: ") && !said.contains("panicked"), "{said}");
    for word in words {
        assert!(said.contains(word), "{word:?} not in: {said}");
    }
    let error = report(&output);
    common::says_each_cause_once(&error, &said);
    assert_eq!(listing(folder), before, "a rest was left behind");
}

fn listing(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn write_npy(path: &Path, shape: &[usize], data: &[f32]) {
    write_atomic(path, |w| npy::write(w, shape, data)).unwrap();
}

/// Random features that are small enough to be a motion.
fn some_features(seed: u64, rows: usize) -> Vec<f32> {
    let mut random = Random(seed);
    (0..rows * FEATURES).map(|_| 0.1 * random.uniform() as f32).collect()
}

/// A standing body that sways.
fn some_joints(rows: usize) -> Vec<Pose> {
    (0..rows)
        .map(|t| {
            let mut pose = [[0.0f32, 1.0, 0.0]; JOINTS];
            for j in 1..JOINTS {
                let parent = pose[skeleton::PARENTS[j]];
                pose[j] = std::array::from_fn(|c| parent[c] + 0.2 * skeleton::REST_DIRECTIONS[j][c] as f32);
                pose[j][2] += 0.01 * (t as f32 * 0.3 + j as f32).sin();
            }
            pose
        })
        .collect()
}

/// A BVH file with the joints of the `mixamo` table.
fn some_bvh(frames: usize, frame_time: f64) -> String {
    let joint = |name: &str, x: i32, y: i32, inner: &str| {
        format!("JOINT mixamorig:{name} {{ OFFSET {x} {y} 1 CHANNELS 3 Zrotation Xrotation Yrotation {inner} }}\n")
    };
    let limb = |side: &str, names: [&str; 4], x: i32, y: i32| {
        names
            .iter()
            .rev()
            .fold("End Site { OFFSET 0 0 1 }".to_string(), |inner, name| joint(&format!("{side}{name}"), x, y, &inner))
    };
    let legs: String =
        [("Left", 10), ("Right", -10)].map(|(s, x)| limb(s, ["UpLeg", "Leg", "Foot", "ToeBase"], x, -20)).concat();
    let arms: String =
        [("Left", 15), ("Right", -15)].map(|(s, x)| limb(s, ["Shoulder", "Arm", "ForeArm", "Hand"], x, 2)).concat();
    let head = joint("Neck", 0, 10, &joint("Head", 0, 10, "End Site { OFFSET 0 9 0 }"));
    let spine = joint("Spine", 0, 10, &joint("Spine1", 0, 10, &joint("Spine2", 0, 10, &format!("{arms}{head}"))));
    let root = format!(
        "HIERARCHY\nROOT mixamorig:Hips {{ OFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n{legs}{spine} }}\n"
    );
    let rotations = root.matches("rotation").count();
    let mut text = format!("{root}MOTION\nFrames: {frames}\nFrame Time: {frame_time}\n");
    for t in 0..frames {
        text += &format!("{t} 90 {}{}\n", 2 * t, format!(" {}", t % 7).repeat(rotations));
    }
    text
}

#[test]
fn recover_writes_the_published_joints() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["012314", "000000"] {
        let Some(features) = common::shared(&format!("golden/new_joint_vecs_{name}.npy")) else { return };
        let golden = npy::read(&common::shared(&format!("golden/new_joints_{name}.npy")).unwrap()).unwrap();
        let features = fs::canonicalize(features).unwrap();
        let report = succeeds(folder.path(), &["recover", features.to_str().unwrap(), "-o", "joints.npy", "--json"]);
        let ours = npy::read(&folder.path().join("joints.npy")).unwrap();
        assert_eq!(ours.shape, golden.shape);
        assert_eq!(report["frames"], golden.shape[0]);
        assert!(ours.data.iter().zip(&golden.data).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}

#[test]
fn recover_refuses_what_is_no_feature_file() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write_npy(&here.join("good.npy"), &[3, FEATURES], &some_features(1, 3));
    write_npy(&here.join("narrow.npy"), &[3, 262], &[0.0; 3 * 262]);
    let mut nan = some_features(1, 3);
    nan[FEATURES + 5] = f32::NAN;
    write_npy(&here.join("nan.npy"), &[3, FEATURES], &nan);
    let whole = fs::read(here.join("good.npy")).unwrap();
    fs::write(here.join("cut.npy"), &whole[..whole.len() / 2]).unwrap();
    fs::write(here.join("text.npy"), "not an array").unwrap();
    fails(here, &["recover", "none.npy", "-o", "x.npy", "--json"], &["none.npy", "hint: "]);
    fails(here, &["recover", "narrow.npy", "-o", "x.npy", "--json"], &["narrow.npy", "262", "263"]);
    fails(here, &["recover", "nan.npy", "-o", "x.npy", "--json"], &["frame 1", "channel 5"]);
    fails(here, &["recover", "cut.npy", "-o", "x.npy", "--json"], &["cut.npy", "truncated"]);
    fails(here, &["recover", "text.npy", "-o", "x.npy", "--json"], &["text.npy"]);
    fails(here, &["recover", "good.npy", "-o", "good.npy/below.npy", "--json"], &["good.npy"]);
    fails(here, &["recover", "good.npy", "-o", ".", "--json"], &["not a file name"]);
}

#[test]
fn bvh_files_become_a_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::create_dir(here.join("takes")).unwrap();
    fs::write(here.join("takes/walk.bvh"), some_bvh(61, 0.0166667)).unwrap();
    fs::write(here.join("takes/walk.txt"), "someone walks.\nsomeone turns.#someone/NOUN turn/VERB#0.5#1.0\n").unwrap();
    fs::write(here.join("takes/blink.bvh"), some_bvh(3, 0.05)).unwrap();
    let report = succeeds(
        here,
        &["--json", "import", "bvh", "takes", "-o", "out/mine.mds", "--split", "test", "--subset", "me"],
    );
    let dataset = Dataset::load(here.join("out/mine.mds")).unwrap();
    assert_eq!(report["hash"], dataset.hash);
    assert_eq!(report["parts"]["me/test"]["clips"], 1);
    assert_eq!(report["skipped"][0]["id"], "blink");
    let clip = dataset.clip(0);
    assert_eq!((clip.info.id.as_str(), clip.info.split, clip.info.fps_source.round()), ("walk", Split::Test, 60.0));
    // 61 frames at 60 fps are one second: 21 frames at 20 fps, of which velocities need the last.
    assert_eq!(clip.frames(), 20);
    assert_eq!((clip.info.captions.len(), clip.info.captions[1].from), (2, 0.5));
    assert_eq!(clip.info.labels["mapping"], "mixamo");

    fs::write(here.join("bad.bvh"), some_bvh(30, 0.0)).unwrap();
    fails(here, &["import", "bvh", "takes", "bad.bvh", "-o", "b.mds", "--json"], &["bad.bvh line", "frame time"]);
    let report = succeeds(here, &["import", "bvh", "takes", "bad.bvh", "-o", "b.mds", "--skip-bad", "--json"]);
    assert_eq!(report["total"]["clips"], 1);
    assert!(report["skipped"].to_string().contains("frame time"), "{report}");
    fails(here, &["import", "bvh", "takes", "takes", "-o", "c.mds", "--json"], &["two clips"]);
    fails(here, &["import", "bvh", "out", "-o", "c.mds", "--json"], &["no .bvh file"]);
    fails(here, &["import", "bvh", "gone", "-o", "c.mds", "--json"], &["gone"]);
    fails(here, &["import", "bvh", "takes/blink.bvh", "-o", "c.mds", "--json"], &["left out"]);
    fails(here, &["import", "bvh", "takes", "-o", "c.mds", "--mapping", "bad.bvh", "--json"], &["not a joint mapping"]);
    fails(here, &["import", "bvh", "takes", "-o", "bad.bvh/c.mds", "--json"], &["bad.bvh"]);
}

#[test]
fn humanml_folders_become_a_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let features = some_features(7, 30);
    write_npy(&here.join("new_joint_vecs/000001.npy"), &[30, FEATURES], &features);
    let joints = some_joints(25);
    write_npy(&here.join("new_joints/000001.npy"), &[25, JOINTS, 3], joints.as_flattened().as_flattened());
    write_npy(&here.join("new_joints/000002.npy"), &[25, JOINTS, 3], joints.as_flattened().as_flattened());
    fs::create_dir(here.join("texts")).unwrap();
    fs::write(here.join("texts/000002.txt"), "a man sways#a/DET#0.0#0.0\n").unwrap();
    fs::write(here.join("val.txt"), "000002\n").unwrap();
    let arguments = ["import", "humanml", ".", "-o", "h.mds", "--split", "train", "--keep-bones", "--json"];
    let report = succeeds(here, &arguments);
    assert_eq!(report["total"]["frames"], 30 + 24);
    let dataset = Dataset::load(here.join("h.mds")).unwrap();
    let (first, second) = (dataset.clip(0), dataset.clip(1));
    assert_eq!((first.info.split, second.info.split), (Split::Train, Split::Val));
    assert_eq!(first.features, features, "features are taken as they are");
    assert_eq!(first.joints, recover::joints(&features).unwrap());
    assert_eq!(second.info.captions[0].text, "a man sways");
    let step = (0..3).map(|c| second.joints[3][5][c] - joints[3][5][c]).map(f32::abs).fold(0.0, f32::max);
    assert!(step < 1.2, "only the floor and the origin move: {step}");

    let mut nan = features.clone();
    nan[FEATURES * 4] = f32::INFINITY;
    write_npy(&here.join("new_joint_vecs/000003.npy"), &[30, FEATURES], &nan);
    fails(here, &arguments, &["000003.npy", "frame 4"]);
    let report = succeeds(here, &["import", "humanml", ".", "-o", "h.mds", "--skip-bad", "--json"]);
    assert_eq!((report["total"]["clips"].as_u64(), report["skipped"][0]["id"].as_str()), (Some(2), Some("000003")));
    fails(here, &["import", "humanml", "texts", "-o", "x.mds", "--json"], &["new_joint_vecs"]);
}

#[test]
fn a_pack_that_does_not_fit_together_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fails(here, &["import", "pack", ".", "-o", "p.mds", "--json"], &["clips.jsonl", "hint: "]);
    fs::write(here.join("clips.jsonl"), "{}\n").unwrap();
    fails(here, &["import", "pack", ".", "-o", "p.mds", "--json"], &["line 1"]);
    let line = r#"{"id":"a","subset":"s","source":"","src_fps":30,"split":"train","captions":[],"n_frames":9}"#;
    fs::write(here.join("clips.jsonl"), line).unwrap();
    fs::write(here.join("joints.safetensors"), [0u8; 40]).unwrap();
    fails(here, &["import", "pack", ".", "-o", "p.mds", "--json"], &["joints.safetensors"]);

    use safetensors::Dtype;
    use safetensors::tensor::TensorView;
    let joints = some_joints(9);
    let local: Vec<u8> =
        joints.as_flattened().as_flattened().iter().flat_map(|&x| half::f16::from_f32(x).to_le_bytes()).collect();
    let root = vec![0u8; 9 * 8];
    let pack = |offsets: [i32; 2]| {
        let offsets: Vec<u8> = offsets.iter().flat_map(|x| x.to_le_bytes()).collect();
        let tensors = [
            ("local", TensorView::new(Dtype::F16, vec![9, JOINTS, 3], &local).unwrap()),
            ("root_xz", TensorView::new(Dtype::F32, vec![9, 2], &root).unwrap()),
            ("offsets", TensorView::new(Dtype::I32, vec![2], &offsets).unwrap()),
        ];
        fs::write(here.join("joints.safetensors"), safetensors::serialize(tensors, None).unwrap()).unwrap();
    };
    for offsets in [[0, 8], [0, 10], [-1, 8], [9, 0]] {
        pack(offsets);
        fails(here, &["import", "pack", ".", "-o", "p.mds", "--json"], &["clip a"]);
    }
    pack([0, 9]);
    let report = succeeds(here, &["import", "pack", ".", "-o", "p.mds", "--json"]);
    assert_eq!(report["total"]["frames"], 8);
    fails(here, &["import", "pack", ".", "-o", "q.mds", "--shortest", "10", "--json"], &["left out"]);
}

#[test]
fn nonsense_arguments_have_status_two() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["import", "pack"][..], &["import", "bvh", "x", "-o", "y", "--split", "half"], &["dance"]] {
        assert_eq!(motionette(folder.path(), arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn what_has_no_end_is_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    if !Path::new("/dev/zero").exists() {
        return;
    }
    for arguments in [
        &["inspect", "/dev/zero"][..],
        &["plan", "/dev/zero"],
        &["robot", "check", "/dev/zero"],
        &["recover", "/dev/zero", "-o", "x.npy"],
        &["convert", "/dev/zero", "-o", "x.blob"],
        &["verify", "/dev/zero", "--checkpoint", "x", "--dataset", "y"],
        &["import", "kimodo", "/dev/zero", "-o", "x.json"],
    ] {
        fails(here, &[arguments, &["--json"]].concat(), &["/dev/zero", "device"]);
    }
    // Longer than any blob, and nothing in it.
    fs::File::create(here.join("huge.blob")).unwrap().set_len(5 << 30).unwrap();
    fails(here, &["inspect", "huge.blob", "--json"], &["huge.blob", "5368709120 bytes", "at most 4294967295"]);
}

#[cfg(target_os = "linux")]
mod on_linux {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::fs::{FileTypeExt, PermissionsExt};
    use std::os::unix::process::ExitStatusExt;
    use std::process::Stdio;

    use super::*;

    /// A folder with features, a recording, and a robot.
    fn with_files() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        write_npy(&folder.path().join("good.npy"), &[30, FEATURES], &some_features(1, 30));
        fs::write(folder.path().join("walk.bvh"), some_bvh(61, 0.05)).unwrap();
        folder
    }

    /// `script` in a shell, in which `$0` is the program.
    fn shell(folder: &Path, script: &str) -> Output {
        let program = env!("CARGO_BIN_EXE_motionette");
        Command::new("sh").args(["-c", script, program]).current_dir(folder).output().unwrap()
    }

    #[test]
    fn outputs_stay_what_they_are() {
        let folder = with_files();
        let here = folder.path();
        let mode = |name: &str| fs::metadata(here.join(name)).unwrap().permissions().mode() & 0o777;
        for (umask, expected) in [("077", 0o600), ("027", 0o640), ("002", 0o664)] {
            let name = format!("{umask}.npy");
            assert!(shell(here, &format!("umask {umask}; \"$0\" recover good.npy -o {name}")).status.success());
            assert_eq!(mode(&name), expected, "umask {umask}");
        }
        let private = here.join("private.npy");
        fs::write(&private, "old").unwrap();
        fs::set_permissions(&private, fs::Permissions::from_mode(0o600)).unwrap();
        std::os::unix::fs::symlink("private.npy", here.join("link.npy")).unwrap();
        assert!(motionette(here, &["recover", "good.npy", "-o", "link.npy"]).status.success());
        assert!(fs::symlink_metadata(here.join("link.npy")).unwrap().is_symlink());
        assert_eq!((mode("private.npy"), npy::read(&private).unwrap().shape), (0o600, vec![30, JOINTS, 3]));

        let piped =
            shell(here, "mkfifo pipe.npy; cat pipe.npy > read.npy & \"$0\" recover good.npy -o pipe.npy && wait");
        assert!(piped.status.success(), "{piped:?}");
        assert!(fs::metadata(here.join("pipe.npy")).unwrap().file_type().is_fifo());
        assert_eq!(fs::read(here.join("read.npy")).unwrap(), fs::read(&private).unwrap());
    }

    #[test]
    fn every_write_that_fails_is_reported() {
        let folder = with_files();
        let here = folder.path();
        fails(here, &["recover", "good.npy", "-o", "/dev/full", "--json"], &["/dev/full", "No space left", "hint: "]);
        assert!(fs::symlink_metadata("/dev/full").unwrap().file_type().is_char_device());
        for script in ["\"$0\" robot presets > /dev/full", "\"$0\" robot presets --json > /dev/full"] {
            let output = shell(here, script);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(1), "{script}: {said}");
            assert!(said.contains("standard output") && said.contains("No space left"), "{said}");
        }
        // Whoever reads the output may have enough of it.
        let mut child = Command::new(env!("CARGO_BIN_EXE_motionette"))
            .args(["robot", "show", "desk", "--json"])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        assert!(child.wait().unwrap().success());
    }

    #[test]
    fn a_killed_import_leaves_nothing_at_its_next_run() {
        let folder = with_files();
        let here = folder.path();
        fs::create_dir(here.join("made")).unwrap();
        // Beyond so many blocks of a file the system kills whoever writes.
        let killed = shell(here, "ulimit -f 8; exec \"$0\" import bvh walk.bvh -o made/set.mds");
        assert!(killed.status.signal().is_some(), "{killed:?}");
        let left = listing(&here.join("made"));
        assert!(left.len() == 1 && left[0].ends_with(".tmp"), "{left:?}");
        assert!(motionette(here, &["import", "bvh", "walk.bvh", "-o", "made/set.mds"]).status.success());
        assert_eq!(listing(&here.join("made")), ["set.mds"]);
    }

    #[test]
    fn paths_need_not_be_unicode() {
        let folder = with_files();
        let here = folder.path();
        let commands: [&[&str]; 4] = [
            &["recover", "good.npy"],
            &["import", "bvh", "walk.bvh"],
            &["robot", "pack", "desk"],
            &["export", "--bvh", "walk.bvh", "--format", "bvh"],
        ];
        for (index, arguments) in commands.into_iter().enumerate() {
            let name = [b"caf\xe9-", index.to_string().as_bytes()].concat();
            let output = Command::new(env!("CARGO_BIN_EXE_motionette"))
                .args(arguments)
                .arg("-o")
                .arg(OsStr::from_bytes(&name))
                .arg("--json")
                .current_dir(here)
                .output()
                .unwrap();
            assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
            assert!(report(&output).to_string().contains("caf\u{fffd}-"), "{output:?}");
            assert!(here.join(OsStr::from_bytes(&name)).is_file(), "{arguments:?}");
        }
    }
}
