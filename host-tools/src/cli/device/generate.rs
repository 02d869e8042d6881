//! `motionette device generate`: a motion made by the device.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{ArgGroup, Args, ValueEnum};
use motionette::generation::tokens::Planning;
use motionette::{Obstacle, Track};
use motionette_link::conditions::Given;
use motionette_link::message::{Command, Generate, Hello, Length, Refinement, Status};
use serde_json::{Value, json};

use super::{Interrupt, Session, broken_off, model, report, rest};
use crate::anchors_file;
use crate::cli::generate_args::frames_of;
use crate::cli::{bar, say, shown};
use crate::device::Error;
use crate::import::npy;
use crate::scene_file::{self, OwnedObstacle, OwnedTrack};

/// Has the device make a motion from text, and play it with --play.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("what").required(true).args(["text", "prompt_vector"])))]
pub(super) struct Cmd {
    /// What the motion is to be.
    #[arg(long)]
    text: Option<String>,
    /// The same as a vector in a .npy file, for models whose prompts are vectors (docs/published.md).
    #[arg(long, value_name = "FILE")]
    prompt_vector: Option<PathBuf>,
    /// How long it is to be, at least; else what the device prefers, or what the text suggests.
    #[arg(long)]
    seconds: Option<f64>,
    /// Seed of everything that is drawn.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Steps of the sampler; 0 leaves it to the device.
    #[arg(long, default_value_t = 0)]
    steps: u16,
    /// How strongly the text guides; 1 is off and halves the work.
    #[arg(long, default_value_t = Planning::DEFAULT.guidance)]
    guidance: f32,
    /// How it is bent onto its anchors.
    #[arg(long, value_enum, default_value_t = Method::Device)]
    refinement: Method,
    /// Decoder evaluations of the refinement; 0 leaves it to the device.
    #[arg(long, default_value_t = 0)]
    evaluations: u16,
    /// Where it must pass (docs/anchors.md).
    #[arg(long, value_name = "FILE")]
    anchors: Option<PathBuf>,
    /// Where joints are to be at many frames (docs/tracks.md).
    #[arg(long, value_name = "FILE")]
    tracks: Option<PathBuf>,
    /// What the body keeps clear of (docs/obstacles.md).
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Play it as soon as it is ready, and wait for its end.
    #[arg(long)]
    play: bool,
}

/// Refinement methods by name.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Method {
    /// The one that the device prefers.
    Device,
    /// None: the planner alone sees the anchors.
    None,
    /// Quasi-Newton steps, for a few tens of decoder evaluations.
    Fast,
    /// RouteSolver as published, for hundreds of them.
    Published,
    /// Edited behind the decoder until the anchors are met, feet planted; with --evaluations, after so many of them.
    Exact,
    /// The same with feet as they were decoded.
    ExactFreeFeet,
}

impl From<Method> for Refinement {
    fn from(method: Method) -> Self {
        match method {
            Method::Device => Refinement::DEVICE,
            Method::None => Refinement::NONE,
            Method::Fast => Refinement::FAST,
            Method::Published => Refinement::PUBLISHED,
            Method::Exact => Refinement::EXACT,
            Method::ExactFreeFeet => Refinement::EXACT_FREE_FEET,
        }
    }
}

impl Cmd {
    pub(super) fn run(self, client: &mut Session, hello: &Hello) -> Result<Value> {
        let request = self.request(hello)?;
        let vector = self.prompt_vector.as_deref().map(npy::vector).transpose().context("reading the prompt")?;
        let rate = model(hello)?.frame_rate;
        let tracks = self.tracks.as_deref().map(|path| scene_file::read_tracks(path, rate)).transpose();
        let tracks = tracks.context("reading the tracks")?.unwrap_or_default();
        let obstacles = self.scene.as_deref().map(|path| scene_file::read_scene(path, rate)).transpose();
        let obstacles = obstacles.context("reading the scene")?.unwrap_or_default();
        let tracks: Vec<Track<'_>> = tracks.iter().map(OwnedTrack::borrowed).collect();
        let obstacles: Vec<Obstacle<'_>> = obstacles.iter().map(OwnedObstacle::borrowed).collect();
        let given = Given { vector: vector.as_deref(), tracks: &tracks, obstacles: &obstacles, timeline: &[] };
        let conditions = client.stage(hello, &given, &mut |_| {})?;
        let request = Generate { conditions, ..request };
        let interrupt = Interrupt::watch()?;
        let bar = bar(0, "steps");
        let made = client.generate(&request, &mut |status: &Status| {
            if let Some(work) = status.device.work {
                bar.set_length(u64::from(work.steps));
                bar.set_position(u64::from(work.step));
                bar.set_message(report::stage(work.stage));
            }
            interrupt.flow()
        });
        bar.finish_and_clear();
        // What is to play by itself does not, once it is told to hold.
        let made = made.or_else(|error| broken_off(client, error, &Command::Hold))?;
        let seconds = f64::from(made.frames) / f64::from(model(hello)?.frame_rate.max(1));
        say(&format!("{} frames, {seconds} s, ready on the device", made.frames));
        if let Some(error) = made.control_error {
            say(&format!("{} anchors: {:.2} cm off", request.anchors.len(), 100.0 * error));
        }
        let followed = report::followed(made.tracking, made.clearance);
        for line in report::made(made.understood.as_ref(), made.strain).chain(followed) {
            say(&line);
        }
        let played = if self.play { Some(rest(client, &interrupt, &Command::Play)?) } else { None };
        Ok(json!({
            "text": self.text,
            "prompt_vector": self.prompt_vector.as_deref().map(shown),
            "seed": self.seed,
            "frames": made.frames,
            "seconds": seconds,
            "anchors": request.anchors.len(),
            "tracks": tracks.len(),
            "obstacles": obstacles.len(),
            "control_error_m": made.control_error,
            "understood": made.understood.as_ref().map(report::understood),
            "strain": made.strain.map(report::strain),
            "tracking": made.tracking.map(report::tracking),
            "clearance": made.clearance.map(report::clearance),
            "played": played,
            "repeated_requests": client.repeated(),
            "skipped_frames": client.skipped().total(),
        }))
    }

    fn request(&self, hello: &Hello) -> Result<Generate> {
        let model = model(hello)?;
        let text = self.text.as_deref().unwrap_or_default();
        let bytes = text.len();
        let text = text.try_into().map_err(|_| Error::LongText { bytes })?;
        let length = match self.seconds {
            None => Length::Predicted,
            Some(seconds) => Length::Frames(frames_of(seconds, model.frame_rate, model.frames.into(), "device")?),
        };
        let read = |path| anchors_file::read(path, model.frame_rate);
        let anchors = self.anchors.as_deref().map(read).transpose().context("reading the anchors")?.unwrap_or_default();
        // How long the motion becomes is known to the device alone; it is no longer than this.
        anchors_file::check_at(&anchors, usize::from(model.frames), model.frame_rate)
            .context("checking the anchors")?;
        let count = anchors.len();
        let mut wire = heapless::Vec::new();
        for anchor in anchors {
            wire.push(anchor.into()).map_err(|_| Error::ManyAnchors { anchors: count })?;
        }
        Ok(Generate {
            length,
            seed: self.seed,
            steps: self.steps,
            guidance: self.guidance,
            refinement: self.refinement.into(),
            evaluations: self.evaluations,
            anchors: wire,
            play_when_ready: self.play,
            ..Generate::new(text)
        })
    }
}
