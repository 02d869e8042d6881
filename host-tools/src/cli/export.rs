//! `motionette export`: a motion in files for servos, robots' software, firmware and viewers.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};
use clap::{ArgGroup, Args, ValueEnum};
use motionette::Anchor;
use motionette::playback::Robot;
use serde_json::{Value, json};

use super::generate_args::GenerateArgs;
use super::say;
use crate::export::{bvh, glb, servo};
use crate::motion::{FPS, Pose};
use crate::output::write_atomic;
use crate::servos::Timeline;
use crate::{anchors_file, import, metrics, robot_file};

/// Makes a motion, or reads one, and writes it as servo commands or for viewers.
///
/// Servo files hold what the device's own player makes of the motion: speeds, accelerations and fades are those of the robot. Formats go
/// by the ending: .csv (angles and commands a tick), .json (ROS trajectory_msgs/JointTrajectory), .rs (an array for firmware), .bvh and
/// .glb (the body).
///
/// Example: motionette export --blob nano.blob --text "a person bows" --robot upper-body -o bow.csv -o bow.glb
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("source").required(true).args(["text", "prompt", "bvh"])))]
pub(super) struct Cmd {
    #[command(flatten)]
    source: Source,
    /// The robot: a preset (motionette robot presets) or a file (docs/robot.md). Needed for servo files.
    #[arg(long, value_name = "NAME|FILE")]
    robot: Option<String>,
    /// A file to write; give it several times for several files.
    #[arg(short, long = "output", value_name = "FILE", required = true)]
    outputs: Vec<PathBuf>,
    /// Format of the files, whatever their endings.
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Write the place of every joint into .bvh files, which gives the joints back exactly. Without it bones are rigid, as animation
    /// programs expect, and how far they leave the joints is printed.
    #[arg(long)]
    positions: bool,
}

/// Where a motion comes from.
#[derive(Debug, Args)]
#[command(
    mut_arg("mapping", |arg| arg.conflicts_with_all(["text", "prompt"])),
    mut_arg("unit", |arg| arg.conflicts_with_all(["text", "prompt"]))
)]
pub(super) struct Source {
    #[command(flatten)]
    args: GenerateArgs,
    /// A recording to read instead of making a motion; brought to 20 frames a second.
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "blob", "seconds", "seed", "steps", "schedule", "guidance", "sampling", "temperature", "top_k", "top_p", "unconditioned",
        "tracks", "scene", "timeline"
    ])]
    bvh: Option<PathBuf>,
    #[command(flatten)]
    recording: super::RecordingOptions,
}

/// File formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Servo angles and commands, a row a tick.
    Csv,
    /// A ROS JointTrajectory of the servos.
    Json,
    /// A Rust array of servo commands.
    Rs,
    /// Biovision hierarchy.
    Bvh,
    /// Binary glTF.
    Glb,
}

/// A motion from wherever.
pub(super) struct Moved {
    /// Joint positions, metres.
    pub frames: Vec<Pose>,
    /// Frames a second.
    pub frame_rate: u16,
    /// Where it is to pass.
    pub anchors: Vec<Anchor>,
}

impl Source {
    /// Makes or reads the motion.
    pub fn motion(&self) -> Result<Moved> {
        let Some(path) = &self.bvh else {
            let made = self.args.make()?;
            return Ok(Moved { frames: made.frames, frame_rate: made.frame_rate, anchors: made.anchors });
        };
        let import::bvh::Recording { joints: frames, mapping, notes, .. } =
            import::bvh::load(path, &self.recording.reading()?)?;
        say(&format!("{}: joints by the mapping {mapping}", path.display()));
        notes.iter().for_each(|note| say(&format!("note: {note}")));
        let frame_rate = FPS as u16;
        let anchors = self.args.anchors(frame_rate)?;
        anchors_file::check(&anchors, frames.len()).context("checking the anchors")?;
        Ok(Moved { frames, frame_rate, anchors })
    }
}

impl Format {
    fn of(path: &Path) -> Result<Self> {
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        Self::from_str(&ending, false).map_err(|_| {
            let path = path.display();
            anyhow!("the ending of {path} names no format: use .csv, .json, .rs, .bvh or .glb, or give --format")
        })
    }

    const fn is_for_servos(self) -> bool {
        matches!(self, Format::Csv | Format::Json | Format::Rs)
    }
}

/// A robot and what its servos do.
struct Played {
    robot: Robot,
    timeline: Timeline,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let format = |path: &PathBuf| Ok((path.clone(), self.format.map_or_else(|| Format::of(path), Ok)?));
        let outputs: Vec<(PathBuf, Format)> = self.outputs.iter().map(format).collect::<Result<_>>()?;
        let robot = self.robot.as_deref().map(robot_file::load).transpose()?;
        if let (Some((path, _)), None) = (outputs.iter().find(|(_, format)| format.is_for_servos()), &robot) {
            let presets = robot_file::preset_names();
            return Err(anyhow!("{} is for servos: give --robot ({presets}, or a file)", path.display()));
        }
        let writes_bvh = outputs.iter().any(|(_, format)| *format == Format::Bvh);
        ensure!(writes_bvh || !self.positions, "--positions is for .bvh files, and none is to be written");
        let motion = self.source.motion()?;
        let Moved { frames, frame_rate, anchors } = &motion;
        let seconds = frames.len() as f64 / f64::from(*frame_rate);
        say(&format!("{} frames, {seconds} s", frames.len()));
        let played =
            robot.map(|robot| Timeline::of(&robot, frames, *frame_rate).map(|timeline| Played { robot, timeline }));
        let played = played.transpose().context("playing the motion")?;
        for (path, format) in &outputs {
            write(path, *format, &motion, played.as_ref(), self.positions)?;
            say(&format!("{}", path.display()));
        }
        let centimetres = |metres: f64| 100.0 * metres;
        let rigid = (writes_bvh && !self.positions).then(|| bvh::rigid_deviation(frames));
        if let Some(deviation) = rigid {
            say(&deviation.to_string());
        }
        let control = metrics::control_error(frames, anchors).map(centimetres);
        let mut report = json!({
            "outputs": self.outputs.iter().map(|path| super::shown(path)).collect::<Vec<_>>(),
            "frames": frames.len(),
            "seconds": seconds,
            "anchors": anchors.len(),
            "control_error_cm": control,
            "rigid_mean_cm": rigid.map(|deviation| centimetres(deviation.mean)),
            "rigid_largest_cm": rigid.map(|deviation| centimetres(deviation.largest)),
        });
        if let Some(Played { robot, timeline }) = &played {
            let servo = timeline.control_error(robot, frames, *frame_rate, anchors).map(centimetres);
            say(&format!(
                "{}: {} servos, {} ticks at {} Hz, {} of them behind the motion for speed or acceleration",
                robot.name,
                timeline.names.len(),
                timeline.angles.len(),
                timeline.tick_rate,
                timeline.limited
            ));
            if let (Some(control), Some(servo)) = (control, servo) {
                say(&format!("{} anchors: the motion is {control:.1} cm off, the servos {servo:.1} cm", anchors.len()));
            }
            let figures = json!({
                "robot": robot.name,
                "tick_rate": timeline.tick_rate,
                "ticks": timeline.angles.len(),
                "motion_ticks": timeline.motion_ticks,
                "limited_ticks": timeline.limited,
                "servo_control_error_cm": servo,
            });
            if let (Value::Object(report), Value::Object(figures)) = (&mut report, figures) {
                report.extend(figures);
            }
        }
        Ok(report)
    }
}

fn write(path: &Path, format: Format, motion: &Moved, played: Option<&Played>, positions: bool) -> Result<()> {
    let frame_time = 1.0 / f64::from(motion.frame_rate);
    let result = match (format, played) {
        (Format::Bvh, _) if positions => write_atomic(path, |w| bvh::write_positions(&motion.frames, frame_time, w)),
        (Format::Bvh, _) => write_atomic(path, |w| bvh::write_bvh(&motion.frames, frame_time, w)),
        (Format::Glb, _) => write_atomic(path, |w| glb::write_glb(&motion.frames, frame_time, w)),
        (_, None) => return Err(anyhow!("{} is for servos: give --robot", path.display())),
        (Format::Csv, Some(played)) => write_atomic(path, |w| servo::write_csv(&played.timeline, w)),
        (Format::Rs, Some(played)) => write_atomic(path, |w| servo::write_rust(&played.timeline, w)),
        (Format::Json, Some(Played { robot, timeline })) => {
            let neutral: Vec<f32> = robot.channels.iter().map(|channel| channel.neutral).collect();
            write_atomic(path, |w| servo::write_trajectory(timeline, &neutral, w))
        }
    };
    result.with_context(|| format!("writing {}", path.display()))
}
