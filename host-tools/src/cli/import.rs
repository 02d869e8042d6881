//! `motionette import`: recordings into a dataset.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};
use serde_json::{Value, json};

use super::{bar, say};
use crate::dataset::Dataset;
use crate::import::{Summary, pack};
use crate::motion::features::{Bones, Options};

/// Reads recordings and writes one dataset file: joints, features, captions, splits, hashes.
#[derive(Debug, Args)]
pub(super) struct Cmd {
    #[command(subcommand)]
    source: Source,
}

#[derive(Debug, Subcommand)]
enum Source {
    Pack(Pack),
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

impl Common {
    fn options(&self) -> Options {
        Options { bones: if self.keep_bones { Bones::Keep } else { Bones::Uniform }, ..Options::default() }
    }

    /// Writes the dataset and says what is in it.
    fn finish(&self, dataset: &Dataset, summary: &Summary) -> Result<Value> {
        for skipped in &summary.skipped {
            say(&format!("left out {}: {}", skipped.id, skipped.reason));
        }
        ensure!(!dataset.clips.is_empty(), "nothing to import: all {} clips were left out", summary.skipped.len());
        dataset.save(&self.output).with_context(|| format!("writing {}", self.output.display()))?;
        for (part, count) in &summary.parts {
            say(&format!("{part:16} {:6} clips {:8} frames {:6} captions", count.clips, count.frames, count.captions));
        }
        let total = summary.total;
        say(&format!("{:16} {:6} clips {:8} frames {:6} captions", "total", total.clips, total.frames, total.captions));
        say(&format!("{} (hash {})", self.output.display(), dataset.hash));
        Ok(
            json!({"output": self.output, "hash": dataset.hash, "total": total, "parts": summary.parts, "skipped": summary.skipped}),
        )
    }
}

/// The motion-capture pack: a folder with clips.jsonl and joints.safetensors.
///
/// Example: motionette import pack ../shared/mocap -o data/pack.mds
#[derive(Debug, Args)]
struct Pack {
    /// The folder.
    folder: PathBuf,
    #[command(flatten)]
    common: Common,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        match self.source {
            Source::Pack(pack) => pack.run(),
        }
    }
}

impl Pack {
    fn run(self) -> Result<Value> {
        let bar = bar(0, "clips");
        let progress = |done: usize, total: usize| {
            bar.set_length(total as u64);
            bar.inc(done as u64);
        };
        let (dataset, summary) =
            pack::import(&self.folder, self.common.shortest as usize, &self.common.options(), &progress)
                .with_context(|| format!("importing the pack in {}", self.folder.display()))?;
        bar.finish_and_clear();
        self.common.finish(&dataset, &summary)
    }
}
