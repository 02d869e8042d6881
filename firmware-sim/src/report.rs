//! The figures of a run: as text, as markdown, and as one JSON object with stable names.

use crate::robot::RobotReport;
use crate::session::{self, Outcome};
use motionette::blob::Skeleton;
use motionette::{Anchor, JOINTS, Target};
use motionette_host::agreement::ClipAgreement;
use motionette_host::cli::Refinement;
use motionette_host::console::strained;
use motionette_host::followed::Following;
use motionette_host::metrics;
use motionette_host::spans::HeardSpan;
use serde::Serialize;

/// Instructions a planned multiply-accumulate costs on a Cortex-M4 or M7 over whole requests, all other work included: the
/// standard request (49 tokens, 10 guided steps, 4 anchors, 20 decoder evaluations) takes 2.31 G in the emulator, and the plan says
/// 1.91 G multiply-accumulates at most (`cargo xtask bench`).
pub const INSTRUCTIONS_PER_MAC: f64 = 1.21;

/// Figures of one run. Names are stable: `--json` prints this.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Name of the motion.
    pub clip: String,
    /// What it shows.
    pub caption: String,
    /// Frames.
    pub frames: usize,
    /// Frames a second.
    pub frame_rate: u16,
    /// Tokens.
    pub tokens: usize,
    /// The prompt; null when tokens were given.
    pub prompt: Option<String>,
    /// Words of the prompt that the model does not know.
    pub unknown_words: Vec<String>,
    /// What the prompt was understood as, of a model that was taught it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub understood: Option<String>,
    /// Steps of the planner.
    pub planner_steps: usize,
    /// Share of positions, over all steps, at which runtime and f32 reference find the same token most probable, given the
    /// same tokens; null when tokens were given.
    pub planner_token_agreement: Option<f64>,
    /// Anchors.
    pub anchors: usize,
    /// Distinct anchors that the planner did not see.
    pub unconditioned_anchors: u16,
    /// Why; null when it saw all of them, or had nothing to plan.
    pub unconditioned_because: Option<String>,
    /// Whether the planner saw any of the anchors.
    pub planner_conditioned: bool,
    /// Mean distance from the anchors of the motion that the prompt alone gives, centimetres, without a timeline; null when tokens were
    /// given, and these had none.
    pub control_error_unconditioned_cm: Option<f64>,
    /// Of the motion as it was generated, with the planner seeing the anchors or as the tokens say, without refinement.
    pub control_error_before_cm: f64,
    /// And with it.
    pub control_error_after_cm: f64,
    /// The same for each anchor.
    pub anchor_errors: Vec<AnchorErrors>,
    /// What came of tracks and obstacles; null without them.
    pub following: Option<Following>,
    /// What was understood of each span of the timeline.
    pub timeline: Vec<HeardSpan>,
    /// Decoder evaluations of the refinement, line-search trials included.
    pub decoder_evaluations: u16,
    /// Decoder gradients of the refinement.
    pub decoder_gradients: u16,
    /// Repetitions of the edit in motion space; `null` where none was asked for.
    pub edit_rounds: Option<u16>,
    /// Anchors that were met only as far as speed allows.
    pub loosened_anchors: u16,
    /// How much the anchors ask of the motion; above 1 it may no longer do what the prompt says. `null` without an edit.
    pub strain: Option<f32>,
    /// The anchor that causes most of it, in the list of anchors, counted from 0.
    pub strained_by: Option<u16>,
    /// Mean jerk of all joints, m/s^3.
    pub jerk: f64,
    /// The same without refinement.
    pub jerk_before: f64,
    /// Share of frames in which a foot slides on the ground.
    pub foot_skating: f64,
    /// The same without refinement.
    pub foot_skating_before: f64,
    /// How anchors were met; null where nothing was.
    pub refinement: Option<String>,
    /// How far the bone that is farthest from its length is from it, millimetres.
    pub bone_error_mm: f64,
    /// Mean horizontal speed of feet near the ground, m/s.
    pub foot_speed: f64,
    /// `||u - u0||_F`, the correction's size in embedding space.
    pub du: f64,
    /// Root-aligned distance, in front of the edit, from the f32 reference decoding the same `u`, mean, millimetres.
    pub reference_mean_mm: f64,
    /// Largest.
    pub reference_max_mm: f64,
    /// Distance of the roots in the last frame, millimetres.
    pub root_drift_mm: f64,
    /// Arena the plan asks for.
    pub arena_bytes: usize,
    /// Arena that was touched.
    pub arena_high_water_bytes: usize,
    /// All RAM the runtime owns: arena and generator.
    pub ram_bytes: usize,
    /// The blob.
    pub blob_bytes: usize,
    /// Multiply-accumulates at most.
    pub macs: u64,
    /// Instructions of a Cortex-M4 or M7 for that, at [`INSTRUCTIONS_PER_MAC`].
    pub instructions_estimate: u64,
    /// Milliseconds on this machine in text encoder and planner.
    pub planning_ms: f64,
    /// Milliseconds on this machine in the solver.
    pub refining_ms: f64,
    /// Milliseconds in the final decoding.
    pub decoding_ms: f64,
    /// Milliseconds in the reference.
    pub reference_ms: f64,
    /// What the simulated robot made of it.
    pub robot: RobotReport,
    /// Hash over every bit of the token embeddings and joints.
    pub motion_hash: String,
}

/// An anchor and how far the motion of each stage misses it.
#[derive(Debug, Clone, Serialize)]
pub struct AnchorErrors {
    /// What is anchored.
    pub name: String,
    /// Joint index.
    pub joint: usize,
    /// Frame.
    pub frame: u16,
    /// Target, metres: `[x, y, z]`, or `[x, z]` on the floor.
    pub target: Vec<f32>,
    /// Distance of the motion that the prompt alone gives, as [`Report::control_error_unconditioned_cm`].
    pub unconditioned_cm: Option<f64>,
    /// Of the generated motion.
    pub before_cm: f64,
    /// Of the refined one.
    pub after_cm: f64,
}

/// Joint, name and target coordinates of an anchor.
fn describe(anchor: &Anchor) -> (usize, String, Vec<f32>) {
    match anchor.target {
        Target::Root(p) => (0, "root".into(), p.to_vec()),
        Target::PlanarRoot(p) => (0, "root on the floor".into(), p.to_vec()),
        Target::Joint { joint, position } => {
            let joint = usize::from(joint).min(JOINTS - 1);
            (joint, motionette::representation::skeleton::NAMES[joint].replace('_', " "), position.to_vec())
        }
    }
}

impl Report {
    /// The lines a person reads.
    #[must_use]
    pub fn lines(&self) -> Vec<(String, String)> {
        let line = |label: &str, value: String| (label.to_owned(), value);
        let mut lines = vec![line(
            "motion",
            format!(
                "{} tokens, {} frames, {:.2} s",
                self.tokens,
                self.frames,
                self.frames as f64 / f64::from(self.frame_rate)
            ),
        )];
        if let Some(prompt) = &self.prompt {
            lines.push(line("prompt", prompt.clone()));
            if !self.unknown_words.is_empty() {
                lines.push(line("unknown words", self.unknown_words.join(", ")));
            }
            lines.extend(self.understood.as_ref().map(|understood| line("understood as", understood.clone())));
            let agreement = 100.0 * self.planner_token_agreement.unwrap_or(f64::NAN);
            lines.push(line(
                "planner",
                format!("{} steps, {agreement:.1} % of tokens proposed as by the reference", self.planner_steps),
            ));
        }
        let spans = self.timeline.iter().enumerate();
        lines.extend(spans.map(|(index, span)| (format!("span {index}"), span.line(self.frame_rate))));
        if self.prompt.is_some() && (self.anchors > 0 || self.tracks() > 0) {
            lines.push(line("planner saw", self.seen()));
        }
        if self.anchors > 0 {
            let errors =
                (self.control_error_unconditioned_cm, self.control_error_before_cm, self.control_error_after_cm);
            lines.push(line("control error", format!("{}, {} anchors", self.by_stage(errors), self.anchors)));
        }
        if let Some(following) = &self.following {
            lines.extend(following.lines().into_iter().map(|(of, text)| line(of, text)));
            // As in "warning: the scene could not be cleared".
            let notes = following.notes();
            let notes = notes.iter().filter_map(|note| note.split_once(": "));
            lines.extend(notes.map(|(kind, text)| line(kind, text.to_owned())));
        }
        if self.refined() {
            let name = self.refinement.as_deref().unwrap_or_default();
            let work = match (self.decoder_evaluations, self.decoder_gradients) {
                (0, 0) => "no decoder evaluation".to_owned(),
                (evaluations, gradients) => format!("{evaluations} decoder evaluations, {gradients} gradients"),
            };
            lines.push(line("refinement", format!("{name}: {work}")));
            if let Some(rounds) = self.edit_rounds {
                let loose = match self.loosened_anchors {
                    0 => String::new(),
                    count => format!(", {count} anchors met as far as speed allows"),
                };
                lines.push(line("edited behind the decoder", format!("{rounds} rounds{loose}")));
            }
            if let (Some(strain), Some(anchor)) = (self.strain, self.strained_by) {
                let hardest = self.following.as_ref().and_then(Following::hardest).filter(|_| self.anchors == 0);
                let around = hardest.map_or_else(|| format!("anchor {}", anchor + 1), |frame| format!("frame {frame}"));
                lines.push(line("strain", strained(strain, &around)));
            }
            lines.push(line("distance |u - u0|", format!("{:.2}", self.du)));
        }
        let made = self.made();
        let refined = |text: String| if self.refined() { format!(", {text} refined") } else { String::new() };
        let jerk = refined(format!("{:.0}", self.jerk));
        lines.push(line("jerk", format!("{:.0} m/s\u{b3} {made}{jerk}", self.jerk_before)));
        let skating = refined(format!("{:.1} %", 100.0 * self.foot_skating));
        lines
            .push(line("foot skating", format!("{:.1} % of frames {made}{skating}", 100.0 * self.foot_skating_before)));
        let speed = 100.0 * self.foot_speed;
        lines.push(line("feet near the ground", format!("{speed:.1} cm/s on average")));
        lines.push(line("bones", format!("at most {:.2} mm off their lengths", self.bone_error_mm)));
        let (mean, max) = (self.reference_mean_mm, self.reference_max_mm);
        lines.push(line("against the f32 reference", format!("mean {mean:.2} mm, largest {max:.2} mm, root-aligned")));
        lines.push(line("root drift against it", format!("{:.2} mm at the end", self.root_drift_mm)));
        let (arena, touched) = (self.arena_bytes, self.arena_high_water_bytes);
        lines.push(line("arena", format!("{arena} bytes planned, {touched} touched")));
        lines.push(line("RAM in all, blob", format!("{} bytes, {} bytes", self.ram_bytes, self.blob_bytes)));
        let work = (self.macs as f64 / 1e6, self.instructions_estimate as f64 / 1e9);
        lines.push(line(
            "work",
            format!("at most {:.0} M multiply-accumulates, about {:.1} G instructions of a Cortex-M7", work.0, work.1),
        ));
        let times = (self.planning_ms, self.refining_ms, self.decoding_ms, self.reference_ms);
        lines.push(line(
            "time here",
            format!(
                "planning {:.0} ms, refining {:.0} ms, decoding {:.0} ms, reference {:.0} ms",
                times.0, times.1, times.2, times.3
            ),
        ));
        lines.extend(self.robot.lines());
        lines.push(line("motion hash", self.motion_hash.clone()));
        lines
    }

    /// A line for each anchor.
    #[must_use]
    pub fn anchor_lines(&self) -> Vec<(String, String)> {
        let lines = self.anchor_errors.iter().enumerate().map(|(i, anchor)| {
            let errors = self.by_stage((anchor.unconditioned_cm, anchor.before_cm, anchor.after_cm));
            (format!("anchor {}", i + 1), format!("{}: {errors}", anchor.place(self.frame_rate)))
        });
        lines.collect()
    }

    /// How the unrefined motion came about.
    const fn made(&self) -> &'static str {
        if self.prompt.is_some() { "generated" } else { "as given" }
    }

    /// Whether the motion was bent.
    const fn refined(&self) -> bool {
        self.refinement.is_some()
    }

    /// Errors of the prompt alone, of the generated motion and of the refined one, as far as they differ.
    fn by_stage(&self, (alone, before, after): (Option<f64>, f64, f64)) -> String {
        let alone = alone.filter(|_| self.planner_conditioned);
        let alone = alone.map_or_else(String::new, |cm| format!("{cm:.2} cm by the prompt alone, "));
        let after = if self.refined() { format!(", {after:.2} cm refined") } else { String::new() };
        format!("{alone}{before:.2} cm {}{after}", self.made())
    }

    /// Tracks.
    fn tracks(&self) -> usize {
        self.following.as_ref().map_or(0, |following| following.tracks)
    }

    /// What the planner saw of anchors and tracks.
    #[must_use]
    pub fn seen(&self) -> String {
        let because = self.unconditioned_because.as_deref().unwrap_or_default();
        let what = match (self.anchors > 0, self.tracks() > 0) {
            (true, false) => "anchors",
            (true, true) => "anchors and places of the tracks",
            (false, _) => "places of the tracks",
        };
        match (self.planner_conditioned, self.unconditioned_anchors) {
            (true, 0) if self.tracks() > 0 => format!("{what}, up to 32 in all"),
            (true, 0) => "all anchors".to_owned(),
            (true, count) => format!("all {what} but {count}: {because}"),
            (false, _) => format!("no {what}: {because}"),
        }
    }

    /// The summary file.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut text = format!("# {}\n\n{}\n\n| | |\n|---|---|\n", self.clip, self.caption);
        for (label, value) in self.lines() {
            text += &format!("| {label} | {value} |\n");
        }
        if !self.anchor_errors.is_empty() {
            text +=
                &format!("\n| anchor | prompt alone, cm | {}, cm | refined, cm |\n|---|---|---|---|\n", self.made());
            for anchor in &self.anchor_errors {
                let alone = anchor.unconditioned_cm.map_or_else(|| "-".to_owned(), |cm| format!("{cm:.2}"));
                let AnchorErrors { before_cm, after_cm, .. } = anchor;
                text += &format!("| {} | {alone} | {before_cm:.2} | {after_cm:.2} |\n", anchor.place(self.frame_rate));
            }
        }
        text
    }
}

impl AnchorErrors {
    /// What is anchored, and when.
    fn place(&self, frame_rate: u16) -> String {
        format!("{} at {:.2} s", self.name, f64::from(self.frame) / f64::from(frame_rate))
    }
}

/// What a report is made from.
#[derive(Debug)]
pub struct Parts<'p> {
    /// Name of the motion.
    pub clip: &'p str,
    /// What it shows.
    pub caption: &'p str,
    /// Tokens, positions.
    pub tokens: usize,
    /// The prompt, if there was one.
    pub prompt: Option<&'p str>,
    /// Its words that the model does not know.
    pub unknown_words: Vec<String>,
    /// How often the planner proposes what the reference proposes.
    pub planner_token_agreement: Option<f64>,
    /// The anchors.
    pub anchors: &'p [Anchor],
    /// What came of tracks and obstacles.
    pub following: Option<Following>,
    /// Why the planner did not see some of them.
    pub unconditioned_because: Option<String>,
    /// The motion of the prompt alone, where the others have spans or their planner saw anchors.
    pub alone: Option<&'p Outcome>,
    /// Whether it saw any.
    pub conditioned: bool,
    /// The run without refinement.
    pub before: &'p Outcome,
    /// The run.
    pub after: &'p Outcome,
    /// How anchors are met.
    pub refinement: Refinement,
    /// Whether there was anything to refine.
    pub refined: bool,
    /// The body that moves: offset of each joint from its parent, metres.
    pub skeleton: Skeleton<'p>,
    /// Agreement with the reference.
    pub agreement: &'p ClipAgreement,
    /// Milliseconds in the reference.
    pub reference_ms: f64,
    /// What the simulated robot made of it.
    pub robot: &'p RobotReport,
    /// Length of the blob.
    pub blob_bytes: usize,
}

impl From<&Parts<'_>> for Report {
    fn from(parts: &Parts<'_>) -> Self {
        let &Parts { before, after, .. } = parts;
        let milliseconds = |time: std::time::Duration| time.as_secs_f64() * 1e3;
        // A planner that saw no anchors made what the prompt alone gives.
        let alone = parts.alone.or_else(|| parts.prompt.map(|_| before));
        let error = |of: &Outcome| 100.0 * metrics::control_error(&of.joints, parts.anchors).unwrap_or(0.0);
        let errors = |anchor: &Anchor| {
            let (joint, name, target) = describe(anchor);
            let error = |of: &Outcome| 100.0 * metrics::anchor_error(&of.joints, anchor).unwrap_or(f64::NAN);
            let (unconditioned_cm, before_cm, after_cm) = (alone.map(error), error(before), error(after));
            AnchorErrors { name, joint, frame: anchor.frame, target, unconditioned_cm, before_cm, after_cm }
        };
        let edited = after.refinement.and_then(|report| report.edited);
        Report {
            clip: parts.clip.to_owned(),
            caption: parts.caption.to_owned(),
            frames: after.joints.len(),
            frame_rate: after.frame_rate,
            tokens: parts.tokens,
            prompt: parts.prompt.map(str::to_owned),
            unknown_words: parts.unknown_words.clone(),
            understood: after.understood.clone(),
            planner_steps: after.steps.len(),
            planner_token_agreement: parts.planner_token_agreement,
            anchors: parts.anchors.len(),
            unconditioned_anchors: after.unconditioned_anchors,
            unconditioned_because: parts.unconditioned_because.clone(),
            planner_conditioned: parts.conditioned,
            control_error_unconditioned_cm: alone.map(error),
            control_error_before_cm: error(before),
            control_error_after_cm: error(after),
            anchor_errors: parts.anchors.iter().map(errors).collect(),
            following: parts.following.clone(),
            timeline: after.spans.clone(),
            decoder_evaluations: after.refinement.map_or(0, |r| r.evaluations),
            decoder_gradients: after.refinement.map_or(0, |r| r.gradients),
            edit_rounds: edited.map(|edited| edited.rounds),
            loosened_anchors: edited.map_or(0, |edited| edited.loosened),
            strain: edited.map(|edited| edited.strain.value),
            strained_by: edited.map(|edited| edited.strain.anchor),
            jerk: metrics::jerk(&after.joints, f64::from(after.frame_rate)),
            jerk_before: metrics::jerk(&before.joints, f64::from(before.frame_rate)),
            foot_skating: metrics::foot_skating(&after.joints, 0.0),
            foot_skating_before: metrics::foot_skating(&before.joints, 0.0),
            refinement: parts.refined.then(|| parts.refinement.to_string()),
            bone_error_mm: 1e3 * metrics::bone_error(&after.joints, parts.skeleton.offsets()),
            foot_speed: metrics::foot_speed(&after.joints, f64::from(after.frame_rate)),
            du: session::distance(&after.u, &before.u),
            reference_mean_mm: parts.agreement.mean_mm,
            reference_max_mm: parts.agreement.max_mm,
            root_drift_mm: parts.agreement.end_drift_mm,
            arena_bytes: after.plan.arena_bytes,
            arena_high_water_bytes: after.high_water,
            ram_bytes: session::ram_bytes(&after.plan),
            blob_bytes: parts.blob_bytes,
            macs: after.plan.macs,
            instructions_estimate: (after.plan.macs as f64 * INSTRUCTIONS_PER_MAC) as u64,
            planning_ms: milliseconds(after.planning),
            refining_ms: milliseconds(after.refining),
            decoding_ms: milliseconds(after.decoding),
            reference_ms: parts.reference_ms,
            robot: parts.robot.clone(),
            motion_hash: format!("{:016x}", after.hash),
        }
    }
}
