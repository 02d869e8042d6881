//! `motionette generate`: a motion from text, made by the runtime.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{ArgGroup, Args};
use motionette::refining::Strain;
use serde_json::{Value, json};

use super::generate_args::GenerateArgs;
use super::model::grouped;
use super::say;
use crate::console::strained;
use crate::export::bvh;
use crate::followed::Following;
use crate::metrics;
use crate::output::write_atomic;

/// Makes a motion from text with the runtime that devices run, bit for bit.
///
/// Example: motionette generate --blob nano.blob --text "a person waves the right hand" --seconds 5 --seed 7 -o motion.bvh
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("what").required(true).args(["text", "prompt", "prompt_vector"])))]
#[command(group(ArgGroup::new("model").required(true).args(["blob"])))]
pub(super) struct Cmd {
    #[command(flatten)]
    args: GenerateArgs,
    /// The motion to write, BVH; its bones are rigid, and how far they leave the joints is printed.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let GenerateArgs { text, prompt, prompt_vector, seed, .. } = &self.args;
        let made = self.args.make()?;
        let steps = made.steps;
        let (joints, rate) = (&made.frames, f64::from(made.frame_rate));
        write_atomic(&self.output, |w| bvh::write_bvh(joints, 1.0 / rate, w)).context("writing the motion")?;
        let seconds = joints.len() as f64 / rate;
        say(&format!(
            "{} frames, {seconds} s, {} tokens to {}",
            joints.len(),
            made.tokens.len(),
            self.output.display()
        ));
        let rigid = bvh::rigid_deviation(joints);
        say(&rigid.to_string());
        let anchors = &made.anchors;
        let control = metrics::control_error(joints, anchors);
        if let (Some(error), Some(before)) = (control, made.refinement.and_then(|r| r.before)) {
            let (count, before) = (anchors.len(), 100.0 * before.mean);
            say(&format!("{count} anchors: {before:.1} cm off before, {:.1} cm after", 100.0 * error));
        }
        let edited = made.refinement.and_then(|report| report.edited);
        let loosened = edited.map_or(0, |edited| edited.loosened);
        if loosened > 0 {
            say(&format!(
                "note: {loosened} anchors ask for more speed than a body adds, and are met as far as it allows"
            ));
        }
        let asked = !anchors.is_empty() || made.following.is_some();
        let strain = edited.filter(|_| asked).map(|edited| edited.strain);
        if let Some(strain) = strain.filter(|strain| strain.warns()) {
            let anchor = made.anchors.get(usize::from(strain.anchor)).map(|anchor| anchor.frame);
            let frame = anchor.or(made.following.as_ref().and_then(Following::hardest)).unwrap_or_default();
            say(&format!("strain {}", strained(strain.value, &format!("frame {frame}"))));
        }
        let [planning_macs, macs] = made.macs;
        say(&format!(
            "{}, at most {} MAC, {} arena bytes",
            steps.map_or_else(|| "a token at a time".to_owned(), |steps| format!("{steps} planner steps")),
            grouped(macs),
            grouped(made.arena_used as u64)
        ));
        Ok(json!({
            "output": super::shown(&self.output),
            "prompt": text.as_ref().or(prompt.as_ref()),
            "prompt_vector": prompt_vector.as_deref().map(super::shown),
            "words": made.words[0],
            "unknown_words": made.words[1],
            "unknown": made.unknown,
            "understood": made.understood,
            "frames": joints.len(),
            "seconds": seconds,
            "tokens": made.tokens,
            "seed": seed,
            "planner_steps": steps,
            "guidance": made.guidance,
            "planning_macs": planning_macs,
            "macs": macs,
            "arena_bytes": made.arena_used,
            "anchors": anchors.len(),
            "unconditioned_anchors": made.unconditioned.as_ref().map_or(0, |(count, _)| *count),
            "unconditioned_because": made.unconditioned.map(|(_, why)| why),
            "control_error_m": control,
            "refinement": self.args.refinement.to_string(),
            "bone_error_mm": 1e3 * made.bone_error,
            "foot_speed": metrics::foot_speed(joints, rate),
            "strain": strain.map(|Strain { value, anchor }| json!({"value": value, "anchor": anchor})),
            "edit_rounds": edited.map(|edited| edited.rounds),
            "loosened_anchors": loosened,
            "following": made.following,
            "planner_saw_tracks": made.saw_tracks,
            "timeline": made.timeline,
            "rigid_mean_cm": 100.0 * rigid.mean,
            "rigid_largest_cm": 100.0 * rigid.largest,
            "hash": format!("{:016x}", made.hash),
        }))
    }
}
