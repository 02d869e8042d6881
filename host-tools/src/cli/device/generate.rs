//! `motionette device generate`: a motion made by the device.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use motionette::planning::Planning;
use motionette_link::message::{Generate, Hello, Length, Status};
use serde_json::{Value, json};

use super::{Session, model, report, rest};
use crate::anchors_file;
use crate::cli::{bar, say};
use crate::device::Error;

/// Has the device make a motion from text, and play it with --play.
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// What the motion is to be.
    #[arg(long)]
    text: String,
    /// How long it is to be, at least; else what the device prefers, or what the text suggests.
    #[arg(long)]
    seconds: Option<f64>,
    /// Seed of everything that is drawn.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Steps of the sampler; 0 leaves it to the device.
    #[arg(long, default_value_t = 0)]
    steps: u16,
    /// How strongly the text guides; 1 is off and halves the work.
    #[arg(long, default_value_t = Planning::DEFAULT.guidance)]
    guidance: f32,
    /// Decoder evaluations of the refinement; 0 leaves it to the device.
    #[arg(long, default_value_t = 0)]
    evaluations: u16,
    /// Where it must pass (docs/anchors.md).
    #[arg(long, value_name = "FILE")]
    anchors: Option<PathBuf>,
    /// Play it as soon as it is ready, and wait for its end.
    #[arg(long)]
    play: bool,
}

impl Cmd {
    pub(super) fn run(self, client: &mut Session, hello: &Hello) -> Result<Value> {
        let request = self.request(hello)?;
        let bar = bar(0, "steps");
        let made = client.generate(&request, &mut |status: &Status| {
            if let Some(work) = status.device.work {
                bar.set_length(u64::from(work.steps));
                bar.set_position(u64::from(work.step));
                bar.set_message(report::stage(work.stage));
            }
        });
        bar.finish_and_clear();
        let made = made?;
        let seconds = f64::from(made.frames) / f64::from(model(hello)?.frame_rate.max(1));
        say(&format!("{} frames, {seconds} s, ready on the device", made.frames));
        if let Some(error) = made.control_error {
            say(&format!("{} anchors: {:.2} cm off", request.anchors.len(), 100.0 * error));
        }
        let played = if self.play { Some(rest(client)?) } else { None };
        Ok(json!({
            "text": self.text,
            "seed": self.seed,
            "frames": made.frames,
            "seconds": seconds,
            "anchors": request.anchors.len(),
            "control_error_m": made.control_error,
            "played": played,
            "repeated_requests": client.repeated(),
            "skipped_frames": client.skipped().total(),
        }))
    }

    fn request(&self, hello: &Hello) -> Result<Generate> {
        let model = model(hello)?;
        let bytes = self.text.len();
        let text = self.text.as_str().try_into().map_err(|_| Error::LongText { bytes })?;
        let length = match self.seconds {
            None => Length::Predicted,
            Some(seconds) => {
                let rate = f64::from(model.frame_rate);
                let longest = f64::from(model.frames) / rate;
                // A hair of room for seconds that are no binary fraction.
                let frames = (seconds * rate - 1e-6).ceil();
                ensure!(
                    seconds.is_finite() && frames >= 1.0 && seconds <= longest + 1e-6,
                    "a motion of {seconds} s cannot be made, this device makes up to {longest} s; give --seconds in between"
                );
                Length::Frames(frames as u16)
            }
        };
        let anchors = self.anchors.as_deref().map(anchors_file::read).transpose().context("reading the anchors")?;
        let anchors = anchors.unwrap_or_default();
        // How long the motion becomes is known to the device alone; it is no longer than this.
        anchors_file::check(&anchors, usize::from(model.frames)).context("checking the anchors")?;
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
            evaluations: self.evaluations,
            anchors: wire,
            play_when_ready: self.play,
            ..Generate::new(text)
        })
    }
}
