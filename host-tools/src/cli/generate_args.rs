//! What commands share that make a motion with the runtime: the options, and the motion.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{ArgGroup, Args, ValueEnum};
use motionette::generation::tokens::{Length, Planning, Sampling, Schedule};
use motionette::refining::Report;
use motionette::request::prompt::{Prompt, PromptError};
use motionette::{Anchor, Generator, Model, Obstacle, Request, Span, Track, TrackError};

use super::{Refinement, say};
use crate::anchors_file;
use crate::blob::BlobFile;
use crate::console;
use crate::followed::{self, Following};
use crate::import::npy;
use crate::metrics;
use crate::motion::Pose;
use crate::scene_file::{self, OwnedObstacle, OwnedSpan, OwnedTrack};
use crate::spans::{self, HeardSpan};

/// The motion that is asked for. Commands say which of these they need.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("places").multiple(true).args(["anchors", "tracks"])))]
pub(super) struct GenerateArgs {
    /// The blob.
    #[arg(long, value_name = "FILE")]
    blob: Option<PathBuf>,
    /// What the motion is to be.
    #[arg(long, requires = "blob")]
    pub text: Option<String>,
    /// Name of a prompt that the blob stores, instead of a text.
    #[arg(long, value_name = "NAME", requires = "blob")]
    pub prompt: Option<String>,
    /// A prompt as a vector in a .npy file, for models whose prompts are vectors (docs/published.md).
    #[arg(long, value_name = "FILE", requires = "blob")]
    pub prompt_vector: Option<PathBuf>,
    /// How long it is to be, at least; else as long as the text suggests.
    #[arg(long)]
    seconds: Option<f64>,
    /// Seed of everything that is drawn.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Steps of the sampler; else as many as the model is meant for.
    #[arg(long)]
    pub steps: Option<u16>,
    /// Times of the steps.
    #[arg(long, value_enum, default_value_t = Times::Uniform)]
    schedule: Times,
    /// How strongly the text guides; 1 is off and halves the work. Else as strongly as the model is meant for.
    #[arg(long)]
    pub guidance: Option<f32>,
    /// How proposals are drawn.
    #[arg(long, value_enum, default_value_t = Draw::Sample)]
    sampling: Draw,
    /// Above 1 more variety, below 1 less.
    #[arg(long, default_value_t = 1.0)]
    temperature: f32,
    /// Only so many of the most probable tokens; 0 = all. Else as many as the model is meant for.
    #[arg(long)]
    top_k: Option<u16>,
    /// Only the most probable tokens with this share of the whole; 1 = all.
    #[arg(long, default_value_t = 1.0)]
    top_p: f32,
    /// Where it must pass (docs/anchors.md).
    #[arg(long, value_name = "FILE")]
    anchors: Option<PathBuf>,
    /// Where joints are to be at many frames (docs/tracks.md).
    #[arg(long, value_name = "FILE", requires = "blob")]
    tracks: Option<PathBuf>,
    /// What the body keeps clear of (docs/obstacles.md).
    #[arg(long, value_name = "FILE", requires = "blob")]
    scene: Option<PathBuf>,
    /// What parts of the body do instead, each over a span of the motion (docs/timeline.md).
    #[arg(long, value_name = "FILE", requires = "blob")]
    timeline: Option<PathBuf>,
    /// Plan as if there were no anchors and tracks, and only bend the motion onto them.
    #[arg(long, requires = "places")]
    unconditioned: bool,
    /// How anchors are met: off, exact (edited behind the decoder, and feet stay where they stand, with anchors and without),
    /// exact:free-feet, fast:N (N decoder evaluations), fast:N+exact (both), rs200 (as published); docs/anchors.md says more.
    #[arg(long, default_value = Refinement::DEFAULT)]
    pub refinement: Refinement,
}

/// A motion, and how it came about.
pub(super) struct Made {
    /// Joint positions, metres.
    pub frames: Vec<Pose>,
    /// Frames a second.
    pub frame_rate: u16,
    /// What it was to pass through.
    pub anchors: Vec<Anchor>,
    /// What was decoded.
    pub tokens: Vec<u16>,
    /// Steps of the sampler; `None` where tokens came one at a time.
    pub steps: Option<u16>,
    /// How strongly the text guided.
    pub guidance: f32,
    /// Words of the prompt, and how many of them the model does not know.
    pub words: [usize; 2],
    /// These.
    pub unknown: Vec<String>,
    /// What the prompt was understood as, of a model that was taught it.
    pub understood: Option<String>,
    /// How many anchors the planner did not see, and why; `None` when it saw all of them.
    pub unconditioned: Option<(u16, String)>,
    /// What the refinement did.
    pub refinement: Option<Report>,
    /// What came of tracks and obstacles; `None` without them.
    pub following: Option<Following>,
    /// Whether the planner saw places of the tracks; `None` without tracks.
    pub saw_tracks: Option<bool>,
    /// What was understood of each span of the timeline.
    pub timeline: Vec<HeardSpan>,
    /// How far the bone that is farthest from its length is from it, metres.
    pub bone_error: f64,
    /// Multiply-accumulates at most, of planning and of all.
    pub macs: [u64; 2],
    /// Bytes.
    pub arena_used: usize,
    /// The motion's own.
    pub hash: u64,
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

impl GenerateArgs {
    /// Makes the motion; says what it could not take into account.
    pub fn make(&self) -> Result<Made> {
        let blob = BlobFile::open(self.blob.as_deref().context("a motion from text needs a model: give --blob")?)?;
        let model = blob.model()?;
        let length = self.length(&model)?;
        let anchors = self.anchors(model.frame_rate())?;
        let frames = match length {
            Length::Frames(frames) => usize::from(frames).next_multiple_of(model.frames_per_token()),
            // As long as the anchors need it.
            _ => model.max_tokens() * model.frames_per_token(),
        };
        anchors_file::check_at(&anchors, frames, model.frame_rate()).context("checking the anchors")?;
        warn_of_far(&anchors, model.frame_rate());
        let anchors = anchors_file::distinct(&anchors);
        let vector = self.prompt_vector.as_deref().map(npy::vector).transpose().context("reading the prompt")?;
        let tracks = self.tracks(model.frame_rate())?;
        let tracks: Vec<Track<'_>> = tracks.iter().map(OwnedTrack::borrowed).collect();
        let obstacles = self.obstacles(model.frame_rate())?;
        let obstacles: Vec<Obstacle<'_>> = obstacles.iter().map(OwnedObstacle::borrowed).collect();
        let request = self.request(&model, length, (&anchors, vector.as_deref()));
        let timeline = self.timeline(model.frame_rate())?;
        let timeline: Vec<Span<'_>> = timeline.iter().map(OwnedSpan::borrowed).collect();
        let request = request.tracks(&tracks).obstacles(&obstacles).timeline(&timeline);

        // An arena of exactly the size that the request takes.
        let plan = Generator::new(blob.model()?, &mut [])
            .and_then(|generator| generator.plan(&request))
            .map_err(|error| self.refused(&model, error))?;
        let mut arena = vec![0_u128; plan.arena_bytes.div_ceil(16)];
        let mut generator = Generator::new(blob.model()?, bytemuck::cast_slice_mut(&mut arena))?;
        let motion = generator.generate(&request, &mut ()).map_err(|error| self.refused(&model, error))?;
        let unknown = self.text.as_ref().map_or_else(Vec::new, |text| console::unknown_words(&model, text));
        if !unknown.is_empty() {
            say(&format!("note: words the vocabulary does not have: {}", unknown.join(", ")));
        }
        let understood = console::understood(&model, &motion);
        if let Some(understood) = &understood {
            say(&format!("understood as: {understood}"));
        }
        let heard = HeardSpan::of_all(&model, &timeline, motion.spans());
        for (index, span) in heard.iter().enumerate() {
            say(&format!("span {index}: {}", span.line(motion.frame_rate())));
        }
        let unconditioned = self.unconditioned(&blob, (motion.unconditioned_anchors(), motion.parted()))?;
        if let Some((count, why)) = &unconditioned {
            say(&format!("note: the planner did not see {count} of the anchors: {why}"));
        }
        let saw_tracks = plan.planning.anchors > 0 && !motion.parted();
        let saw_tracks = (!tracks.is_empty()).then_some(saw_tracks);
        if saw_tracks == Some(false) && unconditioned.is_none() {
            let why = match followed::unseen_because(&tracks) {
                Some(why) if !self.unconditioned => why.to_owned(),
                _ => self.unseen_because(&blob, motion.parted())?,
            };
            say(&format!("note: the planner did not see the tracks: {why}"));
        }
        let edited = motion.refinement.and_then(|report| report.edited);
        let followed = edited.as_ref().and_then(|edited| edited.followed.as_ref());
        let frames = motion.frames().len();
        let following = Following::of(followed, (&tracks, &obstacles), frames, motion.frame_rate());
        if let Some(following) = &following {
            following.lines().iter().for_each(|(of, text)| say(&format!("{of} {text}")));
            following.notes().iter().for_each(|note| say(note));
        }
        Ok(Made {
            following,
            saw_tracks,
            timeline: heard,
            frames: motion.frames().to_vec(),
            frame_rate: motion.frame_rate(),
            tokens: motion.tokens().to_vec(),
            steps: Some(request.planning.steps).filter(|_| !model.planner().is_some_and(|p| p.in_turn())),
            guidance: request.planning.guidance,
            words: [motion.words(), motion.unknown_words()].map(usize::from),
            refinement: motion.refinement,
            bone_error: metrics::bone_error(motion.frames(), model.skeleton().offsets()),
            macs: [plan.planning_macs, plan.macs],
            arena_used: motion.arena_used,
            hash: motion.hash(),
            unknown,
            understood,
            unconditioned,
            anchors,
        })
    }

    /// The anchors that the motion, of `frame_rate` frames a second, is to pass through.
    pub fn anchors(&self, frame_rate: u16) -> Result<Vec<Anchor>> {
        let read = |path| anchors_file::read(path, frame_rate);
        let anchors = self.anchors.as_deref().map(read).transpose().context("reading the anchors")?;
        Ok(anchors.unwrap_or_default())
    }

    /// Where joints are to be at many frames of a motion of `frame_rate` frames a second.
    fn tracks(&self, frame_rate: u16) -> Result<Vec<OwnedTrack>> {
        let read = |path| scene_file::read_tracks(path, frame_rate);
        let tracks = self.tracks.as_deref().map(read).transpose().context("reading the tracks")?;
        Ok(tracks.unwrap_or_default())
    }

    /// What the body keeps clear of.
    fn obstacles(&self, frame_rate: u16) -> Result<Vec<OwnedObstacle>> {
        let read = |path| scene_file::read_scene(path, frame_rate);
        let obstacles = self.scene.as_deref().map(read).transpose().context("reading the scene")?;
        Ok(obstacles.unwrap_or_default())
    }

    /// What parts of the body do instead.
    fn timeline(&self, frame_rate: u16) -> Result<Vec<OwnedSpan>> {
        let read = |path| scene_file::read_timeline(path, frame_rate);
        let timeline = self.timeline.as_deref().map(read).transpose().context("reading the timeline")?;
        Ok(timeline.unwrap_or_default())
    }

    fn length(&self, model: &Model<'_>) -> Result<Length> {
        let Some(seconds) = self.seconds else { return Ok(Length::Predicted) };
        let most = model.max_tokens() * model.frames_per_token();
        Ok(Length::Frames(frames_of(seconds, model.frame_rate(), most, "model")?))
    }

    fn request<'r>(
        &'r self,
        model: &Model<'_>,
        length: Length,
        (anchors, vector): (&'r [Anchor], Option<&'r [f32]>),
    ) -> Request<'r> {
        let meant = model.default_planning();
        let most = if let Sampling::Sample { top_k, .. } = meant.sampling { top_k } else { 0 };
        let schedule = match self.schedule {
            Times::Uniform => Schedule::Uniform,
            Times::Cosine => Schedule::Cosine,
        };
        let (temperature, top_k, top_p) = (self.temperature, self.top_k.unwrap_or(most), self.top_p);
        let sampling = match self.sampling {
            Draw::Greedy => Sampling::Greedy,
            Draw::Sample => Sampling::Sample { temperature, top_k, top_p },
            Draw::Gumbel => Sampling::Gumbel { temperature },
        };
        let (steps, guidance) = (self.steps.unwrap_or(meant.steps), self.guidance.unwrap_or(meant.guidance));
        let seed = self.seed;
        let planning = Planning { length, seed, steps, schedule, guidance, sampling, ..Planning::DEFAULT };
        let prompt = match (&self.text, &self.prompt, vector) {
            (None, Some(name), _) => Prompt::Bank(name),
            (None, None, Some(vector)) => Prompt::Vector(vector),
            (text, ..) => Prompt::Text(text.as_deref().unwrap_or_default()),
        };
        let request = Request::prompt(prompt).planned(planning);
        let request = if self.unconditioned { request.unconditioned() } else { request };
        Request { refinement: self.refinement.0, ..request.anchors(anchors) }
    }

    /// How many anchors the planner did not see, and why; `None` when it saw all of them.
    fn unconditioned(&self, blob: &BlobFile, (count, parted): (u16, bool)) -> Result<Option<(u16, String)>> {
        if count == 0 {
            return Ok(None);
        }
        Ok(Some((count, self.unseen_because(blob, parted)?)))
    }

    /// Why the planner did not see what the motion is to pass through.
    fn unseen_because(&self, blob: &BlobFile, parted: bool) -> Result<String> {
        Ok(if self.unconditioned { "--unconditioned".to_owned() } else { blob.unconditioned_because(parted)? })
    }

    /// A refusal with what could be asked for instead.
    fn refused(&self, model: &Model<'_>, error: motionette::Error) -> anyhow::Error {
        let stored: Vec<&str> = model.text().map(|t| t.bank().names().collect()).unwrap_or_default();
        let instead = match error {
            motionette::Error::Prompt(PromptError::NoEncoder { .. }) if !stored.is_empty() => {
                format!("; give --prompt with one of {}", stored.join(", "))
            }
            motionette::Error::Prompt(PromptError::Vectors { .. }) if stored.is_empty() => {
                "; give --prompt-vector with a .npy file (docs/published.md)".to_owned()
            }
            motionette::Error::Prompt(PromptError::Vectors { .. }) => {
                format!("; give --prompt-vector with a .npy file, or --prompt with one of {}", stored.join(", "))
            }
            motionette::Error::Prompt(PromptError::NotStored { .. }) if !stored.is_empty() => {
                format!("; it stores {}", stored.join(", "))
            }
            motionette::Error::Prompt(PromptError::OnlyUnknownWords { .. }) => {
                "; `motionette inspect --vocabulary` lists what it knows".to_owned()
            }
            motionette::Error::Planning(motionette::generation::tokens::PlanningError::NoPlanner) => {
                "; convert it with --prior".to_owned()
            }
            motionette::Error::Tracks(TrackError::NotExact) => {
                "; leave --refinement out, or give one that ends in exact".to_owned()
            }
            motionette::Error::Timeline(error) => spans::instead(model, error, true),
            _ => String::new(),
        };
        anyhow::Error::new(error).context(format!("the runtime refuses the request{instead}"))
    }
}

/// Frames of a motion of `--seconds`. The `maker`, a model or a device, makes `frame_rate` a second and `most` in all.
pub(super) fn frames_of(seconds: f64, frame_rate: u16, most: usize, maker: &str) -> Result<u16> {
    let rate = f64::from(frame_rate);
    let longest = most as f64 / rate;
    // A little more is allowed for seconds that are no binary fraction.
    let frames = (seconds * rate - 1e-6).ceil();
    ensure!(
        seconds.is_finite() && frames >= 1.0 && seconds <= longest + 1e-6,
        "a motion of {seconds} s cannot be made, this {maker} makes up to {longest} s; give --seconds in between"
    );
    Ok(frames as u16)
}

/// Says which anchors no body can reach in the time: a slip, most of the time.
pub(super) fn warn_of_far(anchors: &[Anchor], frame_rate: u16) {
    for far in anchors_file::out_of_reach(anchors, frame_rate) {
        say(&format!("warning: {far}"));
    }
}
