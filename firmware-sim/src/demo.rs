//! The main job: a real motion through the embedded runtime, bent onto anchors, played by a virtual robot, checked
//! against the reference, written to a folder.

use crate::bundle;
use crate::report::{self, Parts, Report};
use crate::robot::{self, Recorder};
use crate::session::{self, Outcome};
use crate::source::{self, Source};
use crate::viewer::{self, CurvePoint, Fact, Scene, Shown, ShownAnchor};
use anyhow::{Context, bail};
use clap::Args;
use motionette::motion::skeleton::{NAMES, PARENTS};
use motionette::refining::{Activity, Basis, Config};
use motionette_host::agreement::Agreement;
use motionette_host::blob_file::BlobFile;
use motionette_host::checkpoint::{self, TokenizerCheckpoint};
use motionette_host::convert::AlignedBlob;
use motionette_host::motion::Pose;
use motionette_host::reference::Road;
use motionette_host::{anchors_file, export, output};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The robot's loop runs at 1 kHz.
const TICK_MICROSECONDS: u64 = 1_000;

/// Real motion through the runtime, bent onto anchors, checked against the reference, written to a folder.
///
/// Example: motionette-sim --bvh dance.bvh --anchors anchors.json --refinement fast:40
#[derive(Debug, Args)]
pub struct Cmd {
    /// A bundled motion by name (see --list); the first one if nothing is said.
    #[arg(long, value_name = "NAME", conflicts_with = "bvh")]
    clip: Option<String>,
    /// Your own recording; it is encoded first.
    #[arg(long, value_name = "FILE")]
    bvh: Option<PathBuf>,
    /// Anchors (docs/anchors.md); the bundled ones, or none for a recording, if nothing is said.
    #[arg(long, value_name = "FILE.json")]
    anchors: Option<PathBuf>,
    /// off, fast:N (N decoder evaluations), rs100, rs200, rs500 (RouteSolver as published), or rs200 with an ablation:
    /// rs200:plain, :transport, :slope, :quadratic, :cubic, :uniform, :shuffled.
    #[arg(long, default_value = "fast:20", value_parser = refinement)]
    refinement: Refinement,
    /// Seed of the shuffled-activity ablation.
    #[arg(long, default_value_t = 1)]
    seed: u32,
    /// Another model than the built-in one.
    #[arg(long, value_name = "FILE")]
    blob: Option<PathBuf>,
    /// The unquantised checkpoint of the model; models/nano.safetensors of this project if nothing is said.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Folder for the results.
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// List the bundled motions.
    #[arg(long)]
    list: bool,
    /// Print one machine-readable object on the last line of standard output.
    #[arg(long)]
    json: bool,
}

/// How anchors are met.
#[derive(Debug, Clone, Copy)]
struct Refinement(Option<Config>);

fn refinement(text: &str) -> Result<Refinement, String> {
    let known = "known are off, fast:N, rs100, rs200, rs500, rs200:plain, :transport, :slope, :quadratic, :cubic, :uniform, :shuffled";
    let bad = || format!("no refinement is called {text:?}; {known}");
    if text == "off" {
        return Ok(Refinement(None));
    }
    if let Some(budget) = text.strip_prefix("fast:") {
        let budget = budget.parse().ok().filter(|n| (1..=10_000).contains(n));
        return budget.map(|n| Refinement(Some(Config::fast(n)))).ok_or_else(bad);
    }
    let (steps, ablation) = text
        .strip_prefix("rs")
        .ok_or_else(bad)?
        .split_once(':')
        .map_or_else(|| (text.trim_start_matches("rs"), None), |(steps, ablation)| (steps, Some(ablation)));
    let steps = steps.parse().ok().filter(|n| (1..=10_000).contains(n)).ok_or_else(bad)?;
    let mut config = Config::published(steps);
    match ablation {
        None => {}
        Some("plain") => config.basis = Basis::Plain,
        Some("transport") => config.basis = Basis::Transport,
        Some("slope") => config.basis = Basis::Slope,
        Some("quadratic") => config.basis = Basis::Quadratic,
        Some("cubic") => config.basis = Basis::Cubic,
        Some("uniform") => config.activity = Activity::Uniform,
        Some("shuffled") => config.activity = Activity::Shuffled,
        Some(_) => return Err(bad()),
    }
    Ok(Refinement(Some(config)))
}

impl Cmd {
    /// Runs the job.
    ///
    /// # Errors
    /// Whatever input is refused or cannot be read, and what cannot be written.
    pub fn run(self) -> anyhow::Result<()> {
        if self.list {
            for clip in bundle::Bundle::built_in()?.clips {
                println!("{:44} {:3} tokens  {}", clip.id, clip.tokens.len(), clip.caption);
            }
            return Ok(());
        }
        let checkpoint = self.checkpoint()?;
        let blob = match &self.blob {
            Some(path) => BlobFile::open(path)?,
            None => BlobFile::new(AlignedBlob::new(bundle::BLOB), Path::new("(built in)"))?,
        };
        motionette_host::verify::check_same_model(&blob, &checkpoint)?;
        let model = blob.model()?;
        let mut source = match &self.bvh {
            Some(path) => source::recording(path, &checkpoint, model.max_tokens())?,
            None => source::bundled(self.clip.as_deref())?,
        };
        let frames = source.tokens.len() / model.codebooks().quantizers() * model.frames_per_token();
        if let Some(path) = &self.anchors {
            source.anchors = anchors_file::read(path)?;
            anchors_file::check(&source.anchors, frames).with_context(|| format!("{}", path.display()))?;
        }

        say(&format!("{}: {}", source.name, source.caption));
        for note in &source.notes {
            say(&format!("  {note}"));
        }
        let config = self.refinement.0.map(|config| Config { seed: self.seed, ..config });
        let bar = motionette_host::cli::bar(u64::from(config.map_or(0, |c| c.evaluations)), "decoder evaluations");
        let before = session::run(&model, &session::request(&source.tokens, &[], None), |_| ())?;
        let after = session::run(&model, &session::request(&source.tokens, &source.anchors, config), |_| ())?;
        bar.finish_and_clear();

        let started = Instant::now();
        let reference = Road::<f32>::new(&checkpoint)?.forward(&after.u).joints;
        let reference_ms = started.elapsed().as_secs_f64() * 1e3;
        let mut agreement = Agreement::default();
        agreement.add(&source.name, &after.joints, &reference);
        let Some(agreement) = agreement.clips.first() else { bail!("the motion has no frames") };

        let mut body = Recorder::default();
        let robot = robot::play(&after.joints, model.frame_rate(), TICK_MICROSECONDS, &mut body);
        let report = Report::from(&Parts {
            clip: &source.name,
            caption: &source.caption,
            tokens: source.tokens.len() / model.codebooks().quantizers(),
            anchors: &source.anchors,
            before: &before,
            after: &after,
            agreement,
            reference_ms,
            robot,
            blob_bytes: model.bytes().len(),
        });
        for (label, value) in report.lines() {
            say(&format!("  {label:28}{value}"));
        }
        self.write(&source, &before, &after, &reference, &report)?;
        say(&format!("  results                     {}", self.out.join("viewer.html").display()));
        if self.json {
            say(&serde_json::to_string(&report)?);
        }
        Ok(())
    }

    /// The checkpoint that the reference runs from.
    fn checkpoint(&self) -> anyhow::Result<TokenizerCheckpoint> {
        let path = self.checkpoint.clone().unwrap_or_else(|| {
            // `cargo run` says where the package is; a binary on its own looks in the current folder.
            let root =
                std::env::var_os("CARGO_MANIFEST_DIR").map_or_else(PathBuf::new, |dir| PathBuf::from(dir).join(".."));
            root.join("models/nano.safetensors")
        });
        checkpoint::load(&path).with_context(|| {
            "the reference needs the model's unquantised checkpoint: run from the project's folder or give --checkpoint"
        })
    }

    fn write(
        &self,
        source: &Source,
        before: &Outcome,
        after: &Outcome,
        reference: &[Pose],
        report: &Report,
    ) -> anyhow::Result<()> {
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("cannot make the folder {}; give another one with --out", self.out.display()))?;
        let frame_time = 1.0 / 20.0;
        for (name, motion) in [("before.bvh", &before.joints), ("motion.bvh", &after.joints)] {
            output::write_atomic(self.out.join(name), |file| export::bvh::write_bvh(motion, frame_time, file))?;
        }
        let anchors: Vec<ShownAnchor> = source
            .anchors
            .iter()
            .map(|anchor| {
                let (joint, name, target) = report::describe(anchor);
                let before_cm = report::anchor_cm(&before.joints, anchor);
                let after_cm = report::anchor_cm(&after.joints, anchor);
                ShownAnchor { name, joint, frame: anchor.frame, target, before_cm, after_cm }
            })
            .collect();
        let rows: Vec<(String, f64, f64)> = anchors
            .iter()
            .map(|a| (format!("{} at {:.2} s", a.name, f64::from(a.frame) / 20.0), a.before_cm, a.after_cm))
            .collect();
        let mut motions = vec![
            Shown::new("before", "before: as the tokens say", &before.joints),
            Shown::new("after", "after: bent onto the anchors", &after.joints),
            Shown::new("reference", "f32 reference of the same embeddings", reference),
        ];
        motions.rotate_left(1);
        let scene = Scene {
            title: source.name.clone(),
            caption: source.caption.clone(),
            fps: 20,
            frames: after.joints.len(),
            joint_names: NAMES.to_vec(),
            parents: PARENTS.to_vec(),
            motions,
            anchors,
            curve: curve(&after.errors),
            error_before_cm: report.control_error_before_cm,
            error_after_cm: report.control_error_after_cm,
            facts: report.lines().into_iter().map(|(label, value)| Fact { label, value }).collect(),
        };
        let page = viewer::page(&scene)?;
        output::write_atomic(self.out.join("viewer.html"), |file| file.write_all(page.as_bytes()))?;
        let markdown = report.markdown(&rows);
        output::write_atomic(self.out.join("summary.md"), |file| file.write_all(markdown.as_bytes()))?;
        let json = serde_json::to_string_pretty(report)?;
        output::write_atomic(self.out.join("summary.json"), |file| writeln!(file, "{json}"))?;
        Ok(())
    }
}

/// Best control error so far after each decoder evaluation.
fn curve(errors: &[f32]) -> Vec<CurvePoint> {
    let mut best = f64::INFINITY;
    errors
        .iter()
        .enumerate()
        .map(|(index, error)| {
            best = best.min(100.0 * f64::from(*error));
            CurvePoint { evaluations: index + 1, error_cm: best }
        })
        .collect()
}

/// A line on standard output. A closed pipe is no reason to fail.
fn say(line: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stdout(), "{line}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refinements_are_read_or_refused_with_the_list() {
        assert!(refinement("off").unwrap().0.is_none());
        assert_eq!(refinement("fast:40").unwrap().0.unwrap(), Config::fast(40));
        assert_eq!(refinement("rs200").unwrap().0.unwrap(), Config::published(200));
        assert_eq!(refinement("rs100:slope").unwrap().0.unwrap().basis, Basis::Slope);
        assert_eq!(refinement("rs200:shuffled").unwrap().0.unwrap().activity, Activity::Shuffled);
        for text in ["", "fast", "fast:0", "fast:-1", "fast:99999", "rs", "rs0", "rsx", "rs200:", "rs200:x", "slow"] {
            assert!(refinement(text).unwrap_err().contains("known are"), "{text}");
        }
    }
}
