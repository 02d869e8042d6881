//! `motionette generate`: a motion from text, made by the runtime.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{ArgGroup, Args, ValueEnum};
use motionette::perception::prompt::{Prompt, PromptError};
use motionette::perception::text::{UNKNOWN, Words};
use motionette::planning::{Length, Planning, Sampling, Schedule};
use motionette::{Anchor, Generator, Model, Request};
use serde_json::{Value, json};

use super::model::grouped;
use super::say;
use crate::anchors_file;
use crate::blob_file::BlobFile;
use crate::export::bvh;
use crate::metrics;
use crate::output::write_atomic;

/// Makes a motion from text with the runtime that devices run, bit for bit.
///
/// Example: motionette generate --blob nano.blob --text "a person waves the right hand" --seconds 5 --seed 7 -o motion.bvh
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("what").required(true).args(["text", "prompt"])))]
pub(super) struct Cmd {
    /// The blob.
    #[arg(long, value_name = "FILE")]
    blob: PathBuf,
    /// What the motion is to be.
    #[arg(long)]
    text: Option<String>,
    /// Name of a prompt that the blob stores, instead of a text.
    #[arg(long, value_name = "NAME")]
    prompt: Option<String>,
    /// How long it is to be, at least; else as long as the text suggests.
    #[arg(long)]
    seconds: Option<f64>,
    /// Seed of everything that is drawn.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Steps of the sampler.
    #[arg(long, default_value_t = Planning::DEFAULT.steps)]
    steps: u16,
    /// Times of the steps.
    #[arg(long, value_enum, default_value_t = Times::Uniform)]
    schedule: Times,
    /// How strongly the text guides; 1 is off and halves the work.
    #[arg(long, default_value_t = Planning::DEFAULT.guidance)]
    guidance: f32,
    /// How proposals are drawn.
    #[arg(long, value_enum, default_value_t = Draw::Sample)]
    sampling: Draw,
    /// Above 1 more variety, below 1 less.
    #[arg(long, default_value_t = 1.0)]
    temperature: f32,
    /// Only so many of the most probable tokens; 0 = all.
    #[arg(long, default_value_t = 0)]
    top_k: u16,
    /// Only the most probable tokens with this share of the whole; 1 = all.
    #[arg(long, default_value_t = 1.0)]
    top_p: f32,
    /// Where it must pass (docs/anchors.md).
    #[arg(long, value_name = "FILE")]
    anchors: Option<PathBuf>,
    /// Plan as if there were no anchors and only bend the motion onto them.
    #[arg(long, requires = "anchors")]
    unconditioned: bool,
    /// The motion to write, BVH.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Schedules by name.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Times {
    /// Steps of equal length.
    Uniform,
    /// Short steps first.
    Cosine,
}

/// Ways of sampling by name.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Draw {
    /// The most probable token.
    Greedy,
    /// One draw from the distribution, cut by --top-k and --top-p.
    Sample,
    /// The most probable token behind Gumbel noise.
    Gumbel,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let blob = BlobFile::open(&self.blob)?;
        let model = blob.model()?;
        let length = self.length(&model)?;
        let anchors = self.anchors.as_deref().map(anchors_file::read).transpose().context("reading the anchors")?;
        let anchors = anchors.unwrap_or_default();
        if let Length::Frames(frames) = length {
            let frames = usize::from(frames).next_multiple_of(model.frames_per_token());
            anchors_file::check(&anchors, frames).context("checking the anchors")?;
        }
        let request = self.request(length, &anchors);

        // An arena of exactly the size that the request takes.
        let plan = Generator::new(blob.model()?, &mut [])
            .and_then(|generator| generator.plan(&request))
            .map_err(|error| self.refused(&model, error))?;
        let mut arena = vec![0_u128; plan.arena_bytes.div_ceil(16)];
        let mut generator = Generator::new(blob.model()?, bytemuck::cast_slice_mut(&mut arena))?;
        let motion = generator.generate(&request, &mut ()).map_err(|error| self.refused(&model, error))?;

        let joints = motion.frames();
        let rate = f64::from(motion.frame_rate());
        write_atomic(&self.output, |w| bvh::write_bvh(joints, 1.0 / rate, w)).context("writing the motion")?;
        let unknown = self.unknown_words(&model);
        if !unknown.is_empty() {
            say(&format!("note: words the vocabulary does not have: {}", unknown.join(", ")));
        }
        let seconds = joints.len() as f64 / rate;
        say(&format!(
            "{} frames, {seconds} s, {} tokens to {}",
            joints.len(),
            motion.tokens().len(),
            self.output.display()
        ));
        let unconditioned = self.unconditioned(&blob, motion.unconditioned_anchors())?;
        if let Some((count, why)) = &unconditioned {
            say(&format!("note: the planner did not see {count} of the anchors: {why}"));
        }
        let report = motion.refinement;
        let control = metrics::control_error(joints, &anchors);
        if let (Some(error), Some(before)) = (control, report.and_then(|r| r.before)) {
            let (count, before) = (anchors.len(), 100.0 * before.mean);
            say(&format!("{count} anchors: {before:.1} cm off before, {:.1} cm after", 100.0 * error));
        }
        say(&format!(
            "{} planner steps, at most {} MAC, {} arena bytes",
            self.steps,
            grouped(plan.macs),
            grouped(motion.arena_used as u64)
        ));
        Ok(json!({
            "output": self.output,
            "prompt": self.text.as_ref().or(self.prompt.as_ref()),
            "words": motion.words(),
            "unknown_words": motion.unknown_words(),
            "unknown": unknown,
            "frames": joints.len(),
            "seconds": seconds,
            "tokens": motion.tokens(),
            "seed": self.seed,
            "planner_steps": self.steps,
            "guidance": self.guidance,
            "planning_macs": plan.planning_macs,
            "macs": plan.macs,
            "arena_bytes": motion.arena_used,
            "anchors": anchors.len(),
            "unconditioned_anchors": unconditioned.as_ref().map_or(0, |(count, _)| *count),
            "unconditioned_because": unconditioned.map(|(_, why)| why),
            "control_error_m": control,
            "hash": format!("{:016x}", motion.hash()),
        }))
    }

    fn length(&self, model: &Model<'_>) -> Result<Length> {
        let Some(seconds) = self.seconds else { return Ok(Length::Predicted) };
        let rate = f64::from(model.frame_rate());
        let longest = (model.max_tokens() * model.frames_per_token()) as f64 / rate;
        // A hair of room for seconds that are no binary fraction.
        let frames = (seconds * rate - 1e-6).ceil();
        ensure!(
            seconds.is_finite() && frames >= 1.0 && seconds <= longest + 1e-6,
            "a motion of {seconds} s cannot be made, this model makes up to {longest} s; give --seconds in between"
        );
        Ok(Length::Frames(frames as u16))
    }

    fn request<'r>(&'r self, length: Length, anchors: &'r [Anchor]) -> Request<'r> {
        let schedule = match self.schedule {
            Times::Uniform => Schedule::Uniform,
            Times::Cosine => Schedule::Cosine,
        };
        let (temperature, top_k, top_p) = (self.temperature, self.top_k, self.top_p);
        let sampling = match self.sampling {
            Draw::Greedy => Sampling::Greedy,
            Draw::Sample => Sampling::Sample { temperature, top_k, top_p },
            Draw::Gumbel => Sampling::Gumbel { temperature },
        };
        let (seed, steps, guidance) = (self.seed, self.steps, self.guidance);
        let planning = Planning { length, seed, steps, schedule, guidance, sampling, ..Planning::DEFAULT };
        let prompt = match (&self.text, &self.prompt) {
            (None, Some(name)) => Prompt::Bank(name),
            (text, _) => Prompt::Text(text.as_deref().unwrap_or_default()),
        };
        let request = Request::prompt(prompt).planned(planning);
        let request = if self.unconditioned { request.unconditioned() } else { request };
        if anchors.is_empty() { request } else { request.through(anchors) }
    }

    /// How many anchors the planner did not see, and why; `None` when it saw all of them.
    fn unconditioned(&self, blob: &BlobFile, count: u16) -> Result<Option<(u16, String)>> {
        if count == 0 {
            return Ok(None);
        }
        let why = if self.unconditioned { "--unconditioned".to_owned() } else { blob.unconditioned_because()? };
        Ok(Some((count, why)))
    }

    /// A refusal with what could be asked for instead.
    fn refused(&self, model: &Model<'_>, error: motionette::Error) -> anyhow::Error {
        let stored: Vec<&str> = model.text().map(|t| t.bank().names().collect()).unwrap_or_default();
        let instead = match error {
            motionette::Error::Prompt(PromptError::NoEncoder { .. }) if !stored.is_empty() => {
                format!("; give --prompt with one of {}", stored.join(", "))
            }
            motionette::Error::Prompt(PromptError::NotStored { .. }) if !stored.is_empty() => {
                format!("; it stores {}", stored.join(", "))
            }
            motionette::Error::Prompt(PromptError::OnlyUnknownWords { .. }) => {
                "; `motionette inspect --vocabulary` lists the words it knows".to_owned()
            }
            motionette::Error::Planning(motionette::planning::PlanningError::NoPlanner) => {
                "; convert it with --prior".to_owned()
            }
            _ => String::new(),
        };
        anyhow::Error::new(error).context(format!("the runtime refuses the request{instead}"))
    }

    /// The words of the text that the model does not know.
    fn unknown_words(&self, model: &Model<'_>) -> Vec<String> {
        let (Some(text), Some(encoder)) = (&self.text, model.text().and_then(|t| t.encoder())) else {
            return Vec::new();
        };
        let unknown = Words::new(text).filter(|word| encoder.vocabulary().id(word) == UNKNOWN);
        unknown.map(|word| word.as_str().to_owned()).collect()
    }
}
