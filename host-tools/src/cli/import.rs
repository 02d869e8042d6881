//! `motionette import`: recordings into a dataset, constraint files into anchors.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use serde_json::{Value, json};

use super::{RecordingOptions, bar, say};
use crate::anchors_file;
use crate::dataset::{Dataset, Split};
use crate::import::actions::Actions;
use crate::import::collect::SplitChoice;
use crate::import::{Note, Summary, humanml, kimodo, pack, packs, recordings};
use crate::motion::features::{Bones, Options};

/// Reads recordings and writes one dataset file: joints, features, captions, splits, hashes. Reads other programs' constraints and writes
/// an anchors file.
#[derive(Debug, Args)]
pub(super) struct Cmd {
    #[command(subcommand)]
    source: Source,
}

#[derive(Debug, Subcommand)]
enum Source {
    Pack(Pack),
    Bvh(Bvh),
    Humanml(HumanMl),
    Kimodo(Kimodo),
}

/// What every kind of import takes.
#[derive(Debug, Args)]
struct Common {
    /// The dataset file to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Leave out clips with fewer frames than this (at 20 frames a second).
    #[arg(long, default_value_t = 8, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(2..))]
    shortest: u32,
    /// Keep the recording's bone lengths instead of retargeting to HumanML3D's skeleton.
    #[arg(long)]
    keep_bones: bool,
}

/// What imports take that have no list of clips.
#[derive(Debug, Args)]
struct Labels {
    /// Name of the collection.
    #[arg(long, default_value = "user")]
    subset: String,
    /// Split of the clips that no list names: train, val or test; by name = 80, 5, 15 % by a hash of the name.
    #[arg(long, default_value = "by-name", value_parser = split)]
    split: SplitChoice,
    /// Leave out files that cannot be read, and list them, instead of failing.
    #[arg(long)]
    skip_bad: bool,
}

fn split(name: &str) -> Result<SplitChoice, String> {
    match name {
        "by-name" => Ok(SplitChoice::ByName),
        other => other.parse::<Split>().map(SplitChoice::Fixed).map_err(|message| format!("{message}, or by-name")),
    }
}

/// Motion-capture packs: folders with clips.jsonl and joints.safetensors.
///
/// One pack is taken as it is. With --actions one or more packs become one dataset: canonical actions and sides, broken frames left out,
/// a validation split, quality, licence and actor of every clip, and a table by subset.
///
/// Example: motionette import pack ../shared/mocap -o data/pack.mds
///
/// Example: motionette import pack ../shared/mocap ../shared/mocap2 --actions docs/actions.toml --withdraw kinder,utd,ase -o data/pack2.mds
#[derive(Debug, Args)]
struct Pack {
    /// The folders.
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// Table of actions and sources (docs/data.md describes it).
    #[arg(long, value_name = "FILE")]
    actions: Option<PathBuf>,
    /// Leave out these subsets, beside those that the table withdraws.
    #[arg(long, value_name = "SUBSETS", value_delimiter = ',', requires = "actions")]
    withdraw: Vec<String>,
    #[command(flatten)]
    common: Common,
}

/// BVH files: any hierarchy, channel order and frame rate.
///
/// A text file of the same name beside a recording holds its captions, one a line, or in HumanML3D's form SENTENCE#TAGS#FROM#TO.
///
/// Example: motionette import bvh dance.bvh recordings/ -o data/mine.mds
#[derive(Debug, Args)]
#[command(after_help = MAPPING_HELP)]
struct Bvh {
    /// Files, or folders that are searched for .bvh.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    recording: RecordingOptions,
    #[command(flatten)]
    labels: Labels,
    #[command(flatten)]
    common: Common,
}

const MAPPING_HELP: &str = "\
A mapping file gives a name, and for each of the 22 SMPL joints a joint of the file or a point between two; `unit` (m, cm, mm, inch, \
or the metres of a unit), `up` (\"y\" or \"z\") and `drop_frames` (a rest pose at the beginning) may be left out:
  {\"name\": \"mine\", \"unit\": \"cm\", \"up\": \"y\", \"drop_frames\": 0, \"joints\": {
    \"pelvis\": \"Hips\", \"spine1\": {\"from\": \"Hips\", \"to\": \"Chest\", \"at\": 0.4}, \"left_foot\": \"LeftFoot End Site\", ... }}
Joints: pelvis, spine1, spine2, spine3, neck, head; left_ and right_ hip, knee, ankle, foot, collar, shoulder, elbow, wrist. The End \
Site of a joint is called after it.
Built in: bandai-namco, iclone, cmu-cgspeed, mixamo, lafan1. Without a table that fits, joints are found by their names as many \
programs write them (CMU, Xsens, HumanIK, SMPL, Daz, Poser, 3ds Max, Unreal, Rigify, ...), and what was found is printed.";

/// A folder in HumanML3D's layout: new_joint_vecs, new_joints, texts, train.txt, val.txt, test.txt.
///
/// Example: motionette import humanml HumanML3D -o data/humanml3d.mds
#[derive(Debug, Args)]
struct HumanMl {
    /// The folder.
    folder: PathBuf,
    #[command(flatten)]
    labels: Labels,
    #[command(flatten)]
    common: Common,
}

/// A constraint file of Kimodo: waypoints, and the pelvis of poses, as anchors.
///
/// What has no anchor (rotations, headings) is listed.
///
/// Example: motionette import kimodo constraints.json -o anchors.json
#[derive(Debug, Args)]
struct Kimodo {
    /// The constraint file.
    file: PathBuf,
    /// The anchors file to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Frames a second of its frame numbers.
    #[arg(long, default_value_t = kimodo::KIMODO_FPS, value_parser = rate)]
    fps: f64,
    /// Keep one pelvis anchor each so many seconds of a drawn path, and the last.
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS", value_parser = seconds)]
    every: f64,
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (1.0..=1000.0).contains(&rate) => Ok(rate),
        _ => Err("must be from 1 to 1000".into()),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.0..=1e6).contains(&seconds) => Ok(seconds),
        _ => Err("must be a number of seconds".into()),
    }
}

impl Kimodo {
    fn run(&self) -> Result<Value> {
        let imported = kimodo::read(&self.file, self.fps, self.every)
            .with_context(|| format!("importing {}", self.file.display()))?;
        for left in &imported.left_out {
            say(&format!("left out, set {} ({}): {}", left.set, left.kind, left.what));
        }
        if imported.merged > 0 {
            say(&format!("{} entries gave way to others at the same frame and joint", imported.merged));
        }
        anchors_file::write(&self.output, &imported.anchors)?;
        say(&format!("{}: {} anchors", self.output.display(), imported.anchors.len()));
        Ok(json!({
            "output": super::shown(&self.output),
            "anchors": imported.anchors.len(),
            "merged": imported.merged,
            "left_out": imported.left_out,
        }))
    }
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let bar = bar(0, "clips");
        let progress = |done: usize, total: usize| {
            bar.set_length(total as u64);
            bar.inc(done as u64);
        };
        let (common, (dataset, summary)) = match self.source {
            Source::Pack(Pack { folders, actions: Some(actions), withdraw, common }) => {
                if common.keep_bones {
                    bail!("--keep-bones does not go with --actions: the bodies of several sources become one");
                }
                let actions = Actions::read(&actions)?;
                let request = packs::Request { folders, actions, withdraw, shortest: common.shortest as usize };
                let imported = packs::import(&request, &progress)?;
                bar.finish_and_clear();
                let mut result = common.finish(&imported.dataset, &imported.summary)?;
                print(&imported.report);
                result["report"] = json!(imported.report);
                return Ok(result);
            }
            Source::Pack(Pack { folders, common, .. }) => {
                let [folder] = folders.as_slice() else {
                    bail!("several packs name their actions differently; give --actions docs/actions.toml");
                };
                let result = pack::import(folder, common.shortest as usize, &common.options(), &progress)
                    .with_context(|| format!("importing the pack in {}", folder.display()))?;
                (common, result)
            }
            Source::Bvh(Bvh { paths, recording, labels, common }) => {
                let reading = recording.reading()?;
                let (options, shortest) = (common.options(), common.shortest as usize);
                let Labels { subset, split, skip_bad } = labels;
                let request = recordings::Request { paths, reading, subset, split, shortest, skip_bad, options };
                (common, recordings::import(&request, &progress)?)
            }
            Source::Humanml(HumanMl { folder, labels, common }) => {
                let (options, shortest) = (common.options(), common.shortest as usize);
                let Labels { subset, split, skip_bad } = labels;
                let request = humanml::Request { folder, subset, split, shortest, skip_bad, options };
                (common, humanml::import(&request, &progress)?)
            }
            Source::Kimodo(kimodo) => {
                bar.finish_and_clear();
                return kimodo.run();
            }
        };
        bar.finish_and_clear();
        common.finish(&dataset, &summary)
    }
}

/// The table by subset, and the actions that are not scored.
fn print(report: &packs::Report) {
    for packs::Cut { id, from, to, frames } in &report.cut {
        let limit = packs::FASTEST;
        say(&format!("cut {id}: frames {from}..{to} of {frames} kept, in others a joint is faster than {limit} m/s"));
    }
    say(&format!(
        "\n{:20} {:>5} {:>6} {:>5} {:>4} {:>4} {:>5} {:>7} {:>6} {:>7} {:>7}  quality, licence (*: no card can state it)",
        "subset", "clips", "hours", "train", "val", "test", "known", "skating", "jerk", "contact", "dropped"
    ));
    for row in &report.rows {
        let packs::Row { name, quality, licence, card, clips, train, val, test, known_actor, .. } = row;
        let comma = if licence.is_empty() { "" } else { ", " };
        let star = if *card { "" } else { " *" };
        let dropped = format!("{}/{}", row.clips_dropped, row.frames_dropped);
        say(&format!(
            "{name:20} {clips:5} {:6.3} {train:5} {val:4} {test:4} {known_actor:5} {:7.3} {:6.1} {:7.3} {dropped:>7}  \
             {quality}{comma}{licence}{star}",
            row.hours, row.skating, row.jerk, row.contact
        ));
    }
    say("known: clips of val and test whose actor is, or may be, in train; dropped: clips/frames");
    let scored = report.actions.iter().filter(|action| action.scored).count();
    let rest: Vec<String> =
        report.actions.iter().filter(|a| !a.scored).map(|a| format!("{} ({})", a.name, a.train)).collect();
    say(&format!("{scored} actions are scored; trained, not scored: {}", rest.join(", ")));
}

impl Common {
    fn options(&self) -> Options {
        Options { bones: if self.keep_bones { Bones::Keep } else { Bones::Uniform }, ..Options::default() }
    }

    /// Writes the dataset and says what is in it.
    fn finish(&self, dataset: &Dataset, summary: &Summary) -> Result<Value> {
        for Note { text, first, clips } in &summary.notes {
            let others = if *clips > 1 { format!(" and {} more", clips - 1) } else { String::new() };
            say(&format!("note: {first}{others}: {text}"));
        }
        for skipped in &summary.skipped {
            say(&format!("left out {}: {}", skipped.id, skipped.reason));
        }
        if dataset.clips.is_empty() {
            bail!("nothing to import: all {} clips were left out", summary.skipped.len());
        }
        dataset.save(&self.output).with_context(|| format!("writing {}", self.output.display()))?;
        for (part, count) in &summary.parts {
            say(&format!("{part:16} {:6} clips {:8} frames {:6} captions", count.clips, count.frames, count.captions));
        }
        let total = summary.total;
        say(&format!("{:16} {:6} clips {:8} frames {:6} captions", "total", total.clips, total.frames, total.captions));
        say(&format!("{} (hash {})", self.output.display(), dataset.hash));
        Ok(json!({
            "output": super::shown(&self.output),
            "hash": dataset.hash,
            "total": total,
            "parts": summary.parts,
            "skipped": summary.skipped,
            "notes": summary.notes,
        }))
    }
}
