//! `motionette plan`: arena, flash and work before anything is flashed.

use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use motionette::generation::tokens::PlanningLimits;
use motionette::refining::Config;
use motionette::{LEAST_ROWS, MAX_SPANS, MOST_ROWS, ROWS};
use serde_json::Value;

use super::model::grouped;
use super::refinement::Refinement;
use super::say;
use crate::blob::BlobFile;
use crate::output::write_atomic;
use crate::plan::{self, Share};
use crate::robot_file;

/// Says exactly how much memory and work the largest request takes.
///
/// Example: motionette plan nano.blob --anchors 8 --model-rs src/model.rs
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// The blob.
    blob: PathBuf,
    /// Tokens of the largest request (4 frames each).
    #[arg(long, default_value_t = 49)]
    tokens: usize,
    /// Anchors of the largest request; 0 plans for no refinement.
    #[arg(long, default_value_t = 4)]
    anchors: usize,
    /// Joints with rows at many frames: those of tracks; beside tracks or obstacles those of anchors; with obstacles 6 at most to lead the
    /// body out. 22 is enough for whatever is asked for.
    #[arg(long, default_value_t = 0, value_name = "N")]
    tracked: usize,
    /// Spans of a timeline, prompts of their own for parts of the body, each as long as the motion.
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=MAX_SPANS as i64))]
    spans: u16,
    /// Plan for anchors that the planner does not see, though the model could show it them.
    #[arg(long)]
    unconditioned: bool,
    /// Words of the longest prompt; else as many as the model takes. 0 plans for requests that bring their tokens.
    #[arg(long)]
    words: Option<usize>,
    /// Steps of the planner; else as many as it is meant for.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1000))]
    steps: Option<u16>,
    /// Guidance of the planner; 1 is off and halves the work. Else what it is meant for.
    #[arg(long)]
    guidance: Option<f32>,
    /// Rows of the planner that pass through a layer at a time, 4 to 24, and of the decoder half as many tokens more. Weights are read
    /// from flash once for so many; each takes memory, and the motion is the same.
    #[arg(long, default_value_t = ROWS as u16, value_parser = clap::value_parser!(u16).range(LEAST_ROWS as i64..=MOST_ROWS as i64))]
    rows: u16,
    /// How anchors are met: exact, fast:N, fast:N+exact, rs200 and the like, or off.
    #[arg(long, default_value = Refinement::DEFAULT, value_name = "NAME")]
    refinement: Refinement,
    /// Plan for playing the motions on this robot, too: a preset or a file (docs/robot.md).
    #[arg(long, value_name = "NAME|FILE")]
    robot: Option<String>,
    /// Write Rust constants and the embedded blob for a firmware.
    #[arg(long, value_name = "FILE")]
    model_rs: Option<PathBuf>,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let robot = self.robot.as_deref().map(robot_file::load).transpose()?;
        let blob = BlobFile::open(&self.blob)?;
        let (refinement, anchors) = self.refinement.0.map_or((Config::fast(0), 0), |config| (config, self.anchors));
        let meant = blob.model()?.default_planning();
        let (guided, steps) = (self.guidance.unwrap_or(meant.guidance) != 1.0, self.steps.unwrap_or(meant.steps));
        let planning = match self.words.unwrap_or(usize::MAX) {
            0 => None,
            words => Some(PlanningLimits { words, steps, guided, anchors: !self.unconditioned, clauses: 1 }),
        };
        let edits = self.refinement.0.is_some_and(|config| config.exact.is_some());
        ensure!(
            edits || self.tracked == 0,
            "tracks and obstacles are met by the edit behind the decoder, which {} leaves out; leave --refinement out, or give one \
             that ends in exact",
            self.refinement
        );
        ensure!(
            self.spans == 0 || planning.is_some(),
            "spans of a timeline are planned from text: leave --words 0 out"
        );
        let conditions = (anchors, self.tracked, usize::from(self.spans));
        let report = plan::plan(&blob, self.tokens, conditions, refinement, planning, usize::from(self.rows))?;
        say(&format!(
            "{}: {} tokens, {} frames, {} anchors, {} joints with rows, {} spans, {} solver evaluations",
            report.model,
            report.tokens,
            report.frames,
            report.anchors,
            report.tracked,
            report.spans,
            report.solver_evaluations
        ));
        if let Some(p) = &report.planning {
            let guidance = if p.guided { "on" } else { "off" };
            let conditioned = if p.conditioned { ", conditioned on anchors" } else { "" };
            say(&format!(
                "planning: {} words, {} steps, guidance {guidance}{conditioned}: {} bytes, {} MAC",
                p.words,
                p.steps,
                grouped(p.bytes as u64),
                grouped(p.macs)
            ));
            say(&format!("{} rows at a time: the planner's weights are read {} times", report.rows, p.reads));
        }
        if let Some(p) = &report.planning {
            table("arena while tokens are planned", "bytes", &p.arena, p.bytes as u64);
        }
        table("arena", "bytes", &report.arena, report.arena_bytes as u64);
        say(&format!("  {:<32}  {:>13} bytes", "of these the edit", grouped(report.edit_bytes as u64)));
        say(&format!("  {:<32}  {:>13} bytes", "with the generator object", grouped(report.ram_bytes as u64)));
        table("flash", "bytes", &report.flash, report.flash_bytes as u64);
        let pass = report.decoder_macs.iter().map(|s| s.amount).sum();
        table("one decoder pass, all channels", "MAC", &report.decoder_macs, pass);
        say(&format!(
            "\nworst case: {} evaluations, {} gradients, {} MAC",
            report.evaluations,
            report.gradients,
            grouped(report.macs)
        ));
        let stream = &report.stream;
        table("stream of any length", "bytes", &stream.arena, stream.arena_bytes as u64);
        say(&format!(
            "  radius {} tokens, latency {} frames = {:.2} s, feet not planted; {} MAC a token, {} MAC a planned segment",
            stream.radius_tokens,
            stream.latency_frames,
            stream.latency_seconds,
            grouped(stream.token_macs),
            grouped(stream.planning_macs)
        ));
        let playback = robot.map(|robot| plan::playback(&robot, report.frames));
        if let Some(p) = &playback {
            let parts = [("line", p.queue_bytes), ("feeder", p.feeder_bytes), ("player", p.player_bytes)];
            let shares = parts.map(|(name, amount)| Share { name: name.to_owned(), amount: amount as u64 });
            let title = format!("playback on {}, {} servos, {} frames", p.robot, p.channels, p.frames);
            table(&title, "bytes", &shares, shares.iter().map(|share| share.amount).sum());
        }
        if let Some(path) = &self.model_rs {
            let text = plan::model_rs(&report, &seen_from(path, &self.blob)?);
            write_atomic(path, |w| w.write_all(text.as_bytes())).context("writing the constants")?;
            say(&format!("constants to {}", path.display()));
        }
        let mut value = serde_json::to_value(&report)?;
        if let (Value::Object(object), Some(playback)) = (&mut value, playback) {
            object.insert("playback".to_owned(), serde_json::to_value(playback)?);
        }
        Ok(value)
    }
}

fn table(title: &str, unit: &str, shares: &[Share], total: u64) {
    say(&format!("\n{title}"));
    for s in shares {
        say(&format!("  {:<32}  {:>13}", s.name, grouped(s.amount)));
    }
    say(&format!("  {:<32}  {:>13} {unit}", "all", grouped(total)));
}

/// The blob's path as `include_bytes!` in `file` must say it: from the file's folder on, so that the two can be moved, or built elsewhere,
/// together.
fn seen_from(file: &Path, blob: &Path) -> Result<String> {
    let folder = real(file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new(".")))?;
    let blob = real(blob)?;
    let shared = folder.components().zip(blob.components()).take_while(|(a, b)| a == b).count();
    // On another drive: nothing in common, and no way but the whole path.
    let up = if shared == 0 { 0 } else { folder.components().count() - shared };
    let down = blob.components().skip(shared).map(Component::as_os_str);
    let path: PathBuf = std::iter::repeat_n("..".as_ref(), up).chain(down).collect();
    let text =
        path.to_str().with_context(|| format!("Rust source cannot name {}: it is no Unicode", path.display()))?;
    Ok(text.to_owned())
}

/// The absolute path without links, of which the last folders need not be there yet.
fn real(path: &Path) -> Result<PathBuf> {
    let path = std::path::absolute(path).with_context(|| format!("finding {}", path.display()))?;
    let there = path.ancestors().find_map(|there| Some((there, there.canonicalize().ok()?)));
    let Some((there, real)) = there else { return Ok(path) };
    Ok(path.strip_prefix(there).map_or_else(|_| path.clone(), |rest| real.join(rest)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_name_the_blob_from_where_they_lie() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(at("firmware/src")).expect("made");
        std::fs::create_dir(at("models")).expect("made");
        std::fs::write(at("models/nano.blob"), "blob").expect("written");
        for (file, path) in [
            ("models/model.rs", "nano.blob"),
            ("model.rs", "models/nano.blob"),
            ("firmware/src/model.rs", "../../models/nano.blob"),
            ("firmware/made/later/model.rs", "../../../models/nano.blob"),
        ] {
            let seen = seen_from(&at(file), &at("models/nano.blob")).expect("a path");
            assert_eq!(seen.replace('\\', "/"), path, "{file}");
        }
    }
}
