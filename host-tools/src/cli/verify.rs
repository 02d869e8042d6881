//! `motionette verify`: the quantised runtime against the f32 reference.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::Value;

use super::model::CheckpointFiles;
use super::{bar, say};
use crate::agreement::ClipAgreement;
use crate::blob::BlobFile;
use crate::checkpoint::{control, prior};
use crate::dataset::{Dataset, Split, captioned};
use crate::reference::Prior;
use crate::verify::{self, Verification, planner};

/// Clips named as the worst.
const WORST: usize = 5;

/// Decodes the same embeddings with runtime and reference and says how far apart they are, by layer and by clip; with a prior, gives both
/// planners the same corrupted tokens and captions and says how often they find the same token most probable; with a control the same
/// once more, with anchors on the clips' own motion.
///
/// Exits with status 1 when a budget is missed.
///
/// Example: motionette verify nano.blob --checkpoint nano.safetensors --dataset data/pack.mds
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// The blob.
    blob: PathBuf,
    /// The checkpoint it came from.
    #[arg(long, value_name = "FILE")]
    checkpoint: PathBuf,
    #[command(flatten)]
    files: CheckpointFiles,
    /// Dataset whose clips are encoded and decoded.
    #[arg(long, value_name = "FILE")]
    dataset: PathBuf,
    /// Split of the dataset: train, val or test.
    #[arg(long, default_value = "test")]
    split: Split,
    /// Clips at most, spread evenly over the split.
    #[arg(long, default_value_t = 200)]
    clips: usize,
    /// The prior it came from: adds the agreement of the planners.
    #[arg(long, value_name = "FILE")]
    prior: Option<PathBuf>,
    /// The control it came from: adds the agreement of the planners with anchors.
    #[arg(long, value_name = "FILE", requires = "prior")]
    control: Option<PathBuf>,
    /// Clips with captions on which the planners are compared, at most.
    #[arg(long, default_value_t = 60, value_name = "CLIPS")]
    planner: usize,
    /// Of the clips, those on which the solvers are compared.
    #[arg(long, default_value_t = 8, value_name = "CLIPS")]
    solver: usize,
}

/// Budgets were missed. Carries the figures, so that `--json` can show them.
#[derive(Debug, thiserror::Error)]
#[error("{}", missed.join("; "))]
pub(super) struct BudgetMissed {
    missed: Vec<String>,
    /// The figures.
    pub(super) report: Value,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let blob = BlobFile::open(&self.blob)?;
        let checkpoint = self.files.load(&self.checkpoint)?;
        verify::check_same_model(&blob, &checkpoint)?;
        let same = verify::names_checkpoint(&blob, &crate::checkpoint::file_hash(&self.checkpoint)?)?;
        if !same {
            say("note: the blob was converted from another checkpoint file than this one (their SHA-256 differ)");
        }
        let mut prior = self.prior.as_deref().map(prior::load).transpose().context("reading the prior")?;
        if let (Some(prior), Some(path)) = (&prior, &self.prior) {
            prior.check_tokenizer(&checkpoint).context("matching prior and tokenizer")?;
            verify::check_same_prior(&blob, prior)?;
            if !verify::names_checkpoint(&blob, &crate::checkpoint::file_hash(path)?)? {
                say("note: the blob was converted from another prior file than this one (their SHA-256 differ)");
            }
        }
        let control = self.control.as_deref().map(control::load).transpose().context("reading the control")?;
        if let (Some(control), Some(prior), Some(path)) = (&control, &prior, &self.control) {
            control.check_prior(prior, &checkpoint).context("matching control and prior")?;
            verify::check_same_control(&blob, control)?;
            if !verify::names_checkpoint(&blob, &crate::checkpoint::file_hash(path)?)? {
                say("note: the blob was converted from another control file than this one (their SHA-256 differ)");
            }
        }
        prior = prior.map(|prior| verify::same_words(&blob, prior)).transpose()?;
        let max_tokens = blob.model()?.max_tokens();
        let dataset = Dataset::load(&self.dataset)?;
        let sequences = verify::sequences(&checkpoint, &dataset, self.split, self.clips, max_tokens)?;
        let progress = bar(sequences.len() as u64, "clips");
        let mut result = verify::verify(&blob, &checkpoint, &sequences, self.solver, || progress.inc(1))?;
        progress.finish_and_clear();
        if let Some(prior) = &prior {
            let reference = Prior::<f32>::new(prior, &checkpoint);
            let compare = |control| -> Result<planner::Report> {
                let anchored = Option::is_some(&control);
                let cases = captioned::choose(&checkpoint, &reference, &dataset, self.split, self.planner, anchored)?;
                let progress = bar(3 * cases.len() as u64, "planner runs");
                let report = planner::verify(&blob, &checkpoint, prior, control, &cases, || progress.inc(1))?;
                progress.finish_and_clear();
                Ok(report)
            };
            result.planner = Some(compare(None)?);
            result.control = control.as_ref().map(|control| compare(Some(control))).transpose()?;
        }
        show(&result);
        let mut report = serde_json::to_value(&result)?;
        if let Some(object) = report.as_object_mut() {
            object.insert("passed".to_owned(), result.passed().into());
            object.insert("checkpoint_matches".to_owned(), same.into());
        }
        if result.passed() {
            return Ok(report);
        }
        let missed = result.budgets.iter().filter(|b| !b.met);
        let mut missed: Vec<String> =
            missed.map(|b| format!("{}: {:.2} mm, allowed {} mm", b.name, b.value_mm, b.limit_mm)).collect();
        for (report, with) in [(&result.planner, ""), (&result.control, " with anchors")] {
            let Some(planner) = report.as_ref().filter(|p| !p.met) else { continue };
            let (found, least) = (100.0 * planner.runtime.top1, 100.0 * planner.budget);
            missed.push(format!("agreement of the planners{with}: {found:.2} %, at least {least} % are wanted"));
        }
        Err(BudgetMissed { missed, report }.into())
    }
}

fn show(v: &Verification) {
    let a = &v.agreement;
    say(&format!("{} clips, {} of them 5 s long", a.clips.len(), a.drift_clips));
    for b in &v.budgets {
        let verdict = if b.met { "ok" } else { "MISSED" };
        say(&format!("  {:<46}  {:>7.3} mm  of {:>4} mm  {verdict}", b.name, b.value_mm, b.limit_mm));
    }
    say(&format!("  largest joint error {:.2} mm, largest drift {:.2} mm", a.max_mm, a.drift_max_mm));
    say("\nerror along the decoder (quantised weights, share of the signal)");
    for s in &v.layers.stages {
        say(&format!("  {:<38}  {:.4} %", s.name, 100.0 * s.relative_error));
    }
    say("\neach layer quantised alone                mean mm   drift mm");
    for l in &v.layers.alone {
        say(&format!("  {:<38}  {:>7.3}  {:>9.3}", l.name, l.mean_mm, l.drift_mm));
    }
    say(&format!(
        "  {:<38}  {:>7.3}  {:>9.3}",
        "the runtime's arithmetic", v.layers.arithmetic_mean_mm, v.layers.arithmetic_drift_mm
    ));
    v.planner.iter().for_each(|p| planners("planners", p));
    v.control.iter().for_each(|p| planners("planners with anchors", p));
    clips("worst clips", &a.worst(WORST));
    clips("worst drift", &a.worst_drift(WORST));
    if let Some(s) = &v.solvers {
        say(&format!(
            "\nsolvers on {} clips, {} evaluations: control error {:.2} cm before; runtime {:.3} cm ({:.3} cm decoded by the reference); \
             reference's own {:.3} cm; results {:.1} mm apart",
            s.clips,
            s.evaluations,
            s.before_cm,
            s.runtime_cm,
            s.runtime_in_reference_cm,
            s.reference_cm,
            s.difference_mm
        ));
    }
}

fn planners(what: &str, p: &planner::Report) {
    let verdict = if p.met { "ok" } else { "MISSED" };
    let (top1, least) = (100.0 * p.runtime.top1, 100.0 * p.budget);
    let (clips, positions) = (p.runtime.clips, p.runtime.positions);
    say(&format!("\n{what} on {clips} clips, {positions} positions: same most probable token"));
    say(&format!("  {:<46}  {top1:>7.2} %   of {least:>4} %   {verdict}", "runtime against reference"));
    for (t, w) in p.runtime.times.iter().zip(&p.weights.times) {
        say(&format!(
            "  t = {:.2}: {:.2} %, divergence {:.2e} nats; its weights alone {:.2} %, {:.2e}",
            t.time,
            100.0 * t.top1,
            t.divergence,
            100.0 * w.top1,
            w.divergence
        ));
    }
    say(&format!("  left to themselves they have {:.1} % of their tokens in common", 100.0 * p.free_running));
}

fn clips(title: &str, clips: &[&ClipAgreement]) {
    say(&format!("\n{title:<40}  frames   mean mm    p99 mm    max mm  drift at 5 s, at the end, mm"));
    for c in clips {
        let drift = c.drift_mm.map_or_else(|| "-".to_owned(), |d| format!("{d:.2}"));
        say(&format!(
            "  {:<38}  {:>6}  {:>8.3}  {:>8.3}  {:>8.3}  {drift:>8}  {:>8.2}",
            c.id, c.frames, c.mean_mm, c.p99_mm, c.max_mm, c.end_drift_mm
        ));
    }
}
