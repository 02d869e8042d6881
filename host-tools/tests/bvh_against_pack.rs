//! BVH files of the pack through our parser against the pack's own joints, which another program made.

mod common;

use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Stdio};

use motionette_host::import::{bvh, pack};
use motionette_host::motion::features::{self, Bones, Options};
use motionette_host::motion::{JOINTS, Pose};

/// Unpacks some members of an archive. `None` (with a line on standard error) where `tar` or `xz` are not installed.
fn unpack(archive: &Path, members: &BTreeSet<&str>, folder: &Path) -> Option<()> {
    for tool in ["tar", "xz"] {
        if Command::new(tool).arg("--version").stdout(Stdio::null()).status().is_err() {
            eprintln!("skipped: {tool} is not installed");
            return None;
        }
    }
    let status = Command::new("tar").arg("-xJf").arg(archive).arg("-C").arg(folder).args(members).status().unwrap();
    assert!(status.success(), "{}: {members:?}", archive.display());
    Some(())
}

/// Floor, origin and facing as the pack's, bone lengths kept.
fn placed(motion: &[Pose]) -> Vec<Pose> {
    features::process(motion, &Options { bones: Bones::Keep, ..Options::default() }).unwrap().joints
}

fn compare(
    subset: &str,
    archive: &str,
    choose: impl Fn(&serde_json::Value) -> bool,
    mapping: &str,
    mean_limit: f64,
    worst_limit: f64,
) {
    let (Some(archive), Some(folder)) = (common::shared(archive), common::shared("mocap")) else { return };
    let recordings = pack::read(&folder).unwrap();
    let text = std::fs::read_to_string(folder.join("clips.jsonl")).unwrap();
    let lines: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let chosen: Vec<usize> = (0..lines.len()).filter(|&i| lines[i]["subset"] == subset && choose(&lines[i])).collect();
    assert!(chosen.len() >= 5, "{subset}: {} clips", chosen.len());
    let members: Vec<&str> = chosen.iter().map(|&i| lines[i]["file"].as_str().unwrap()).collect();
    let place = tempfile::tempdir().unwrap();
    if unpack(&archive, &members.iter().copied().collect(), place.path()).is_none() {
        return;
    }
    let (mut sum, mut count, mut worst) = (0.0, 0usize, (0.0f64, String::new()));
    for (&index, member) in chosen.iter().zip(&members) {
        let line = &lines[index];
        let recording = bvh::load(&place.path().join(member), &bvh::Reading::default()).unwrap();
        assert_eq!(recording.mapping, mapping);
        let range = line["start"].as_u64().unwrap() as usize..line["end"].as_u64().unwrap() as usize;
        let (ours, theirs) = (placed(&recording.joints[range]), placed(&recordings[index].joints));
        assert_eq!(ours.len(), theirs.len());
        for (a, b) in ours.iter().zip(&theirs) {
            for j in 0..JOINTS {
                let d = (0..3).map(|c| f64::from(a[j][c] - b[j][c]).powi(2)).sum::<f64>().sqrt();
                sum += d;
                count += 1;
                if d > worst.0 {
                    worst = (d, format!("{member} joint {j}"));
                }
            }
        }
    }
    let mean = sum / count as f64;
    println!(
        "{subset}: {} files, {count} joints, mean {:.3} mm, worst {:.3} mm ({})",
        chosen.len(),
        mean * 1e3,
        worst.0 * 1e3,
        worst.1
    );
    assert!(mean < mean_limit && worst.0 < worst_limit, "mean {mean} m, worst {worst:?}");
}

#[test]
fn bandai_namco_files_give_the_packs_joints() {
    let take = |line: &serde_json::Value| {
        line["labels"]["take"] == 1 && line["labels"]["style"] == "normal" && line["labels"]["dataset"] == 1
    };
    compare("bnr", "mocap/bvh/bnr.tar.xz", take, "bandai-namco", 5e-4, 5e-3);
}

#[test]
fn iclone_files_give_the_packs_joints() {
    compare("cmu", "mocap/bvh/cmu.tar.xz", |line| line["labels"]["kind"] == "iclone_bvh", "iclone", 5e-4, 5e-3);
}
