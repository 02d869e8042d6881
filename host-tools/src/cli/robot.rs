//! `motionette robot`: robots listed, shown, checked, packed, and tried on motions.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::{ArgGroup, Args, Subcommand};
use motionette::Joint;
use motionette::playback::robot::{MAGIC, Source as Followed};
use motionette::playback::{Axis, Bus, Channel, Rest, Robot};
use serde_json::{Value, json};

use super::export::{Moved, Source};
use super::say;
use crate::input;
use crate::output::write_atomic;
use crate::robot_file::{self, PRESETS};
use crate::servos::Fit;

/// Robots: what their servos are, what each of them follows, and what it may do (docs/robot.md).
#[derive(Debug, Args)]
pub(super) struct Cmd {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Presets,
    Show(Show),
    Check(Check),
    Pack(Pack),
    Fit(Box<FitCmd>),
}

/// Prints a robot's servos, or with --toml the text of its robot.toml: a preset's is one to begin with.
#[derive(Debug, Args)]
struct Show {
    /// A preset, a robot.toml or a packed robot.
    #[arg(value_name = "NAME|FILE")]
    robot: String,
    /// Print the robot as it was written.
    #[arg(long)]
    toml: bool,
}

/// Says everything that is wrong with a robot.toml, line by line.
#[derive(Debug, Args)]
struct Check {
    /// A robot.toml, a packed robot or a preset.
    #[arg(value_name = "FILE|NAME")]
    robot: String,
}

/// Packs a robot for firmware.
///
/// Example: motionette robot pack robot.toml -o robot.bin
#[derive(Debug, Args)]
struct Pack {
    /// A preset, a robot.toml or a packed robot, also one of version 1.
    #[arg(value_name = "NAME|FILE")]
    robot: String,
    /// Where the servos of a packed robot of version 1 stand when power comes up, which it does not say.
    #[arg(long, value_enum, value_name = "POSE")]
    start: Option<StartPose>,
    /// The packed robot to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// A pose for the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum StartPose {
    /// Every servo at its neutral angle.
    Neutral,
}

/// Says how well a robot can do a motion: what each servo is asked for, and how far the body is off.
///
/// Example: motionette robot fit desk --blob nano.blob --text "a person waves the right hand"
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("source").required(true).args(["text", "prompt", "bvh"])))]
struct FitCmd {
    /// A preset, a robot.toml or a packed robot.
    #[arg(value_name = "NAME|FILE")]
    robot: String,
    #[command(flatten)]
    source: Source,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        match self.what {
            What::Presets => Ok(presets()),
            What::Show(cmd) => cmd.run(),
            What::Check(cmd) => cmd.run(),
            What::Pack(cmd) => cmd.run(),
            What::Fit(cmd) => cmd.run(),
        }
    }
}

fn presets() -> Value {
    for preset in PRESETS {
        say(&format!("{:12} {}", preset.name, preset.about));
    }
    json!({"presets": PRESETS.map(|preset| json!({"name": preset.name, "about": preset.about}))})
}

impl Show {
    fn run(self) -> Result<Value> {
        let robot = robot_file::load(&self.robot)?;
        match self.toml {
            true => written(&self.robot)?.lines().for_each(say),
            false => table(&robot),
        }
        Ok(serde_json::to_value(&robot)?)
    }
}

/// The text that a robot comes from.
fn written(name: &str) -> Result<String> {
    if let Some(preset) = robot_file::preset(name) {
        return Ok(preset.text.to_owned());
    }
    let bytes = input::read(Path::new(name), input::WRITTEN).with_context(|| format!("reading {name}"))?;
    ensure!(
        !bytes.starts_with(&MAGIC),
        "{name} is a packed robot, which holds no text; --toml prints a preset or the robot.toml it was packed from"
    );
    String::from_utf8(bytes).with_context(|| format!("reading {name}"))
}

fn table(robot: &Robot) {
    let after = match robot.after {
        Rest::Hold => "holds",
        Rest::Neutral => "returns to neutral",
    };
    say(&format!(
        "{}: {} servos at {} Hz, fades {} s, returns in {} s, {after} afterwards",
        robot.name,
        robot.channels.len(),
        robot.tick_rate,
        robot.fade,
        robot.return_time
    ));
    let enable = robot.output_enable.map_or(String::new(), |pin| format!("; pin {pin} enables its outputs"));
    say(&format!("creeps at {} degrees a second until it is known to stand where it should{enable}", robot.creep));
    say(&format!(
        "{:24} {:19} {:>8} {:>8} {:>6} {:>14} {:>12} {:>7} {:>9}  connected",
        "servo", "follows", "neutral", "start", "gain", "range", "commands", "deg/s", "deg/s^2"
    ));
    for Channel { name, source, neutral, start, gain, range, command, speed, acceleration, bus } in &robot.channels {
        let follows = match source {
            Followed::Joint(joint, axis) => {
                let axis = match axis {
                    Axis::X => "x",
                    Axis::Y => "y",
                    Axis::Z => "z",
                };
                format!("{} {axis}", Joint::try_from(*joint).map(Joint::name).unwrap_or_default())
            }
            Followed::Heading => "heading".to_owned(),
            Followed::Height => "height".to_owned(),
            Followed::Still => "nothing".to_owned(),
        };
        let start = start.map_or("read".to_owned(), |start| start.to_string());
        let connected = match bus {
            Bus::Pwm { pin } => format!("pin {pin}"),
            Bus::Pca9685 { address, output } => format!("PCA9685 {address:#04x} output {output}"),
            Bus::Sts3215 { id } => format!("STS3215 {id}"),
        };
        let [range, command] = [range.map(|end| end.to_string()), command.map(|end| end.to_string())];
        let [range, command] = [range, command].map(|ends| ends.join(" to "));
        say(&format!(
            "{name:24} {follows:19} {neutral:>8} {start:>8} {gain:>6} {range:>14} {command:>12} {speed:>7} {acceleration:>9}  {connected}"
        ));
    }
}

impl Check {
    fn run(self) -> Result<Value> {
        let robot = robot_file::load(&self.robot)?;
        let (name, channels) = (&robot.name, robot.channels.len());
        say(&format!("{}: {name}, {channels} servos, nothing wrong", self.robot));
        Ok(json!({"robot": name, "channels": channels}))
    }
}

impl Pack {
    fn run(self) -> Result<Value> {
        let path = PathBuf::from(&self.robot);
        let lifted = if path.is_file() { robot_file::lift(&path, self.start.is_some())? } else { None };
        let (robot, taken) = match lifted {
            Some(robot_file::Lifted { robot, taken }) => (robot, taken),
            None => (robot_file::load(&self.robot)?, Vec::new()),
        };
        for taken in &taken {
            say(&format!("version 1: {taken}"));
        }
        let bytes = robot_file::pack(&robot)?;
        write_atomic(&self.output, |w| w.write_all(&bytes)).context("writing the packed robot")?;
        say(&format!("{} bytes to {}", bytes.len(), self.output.display()));
        Ok(json!({"output": super::shown(&self.output), "bytes": bytes.len(), "taken": taken}))
    }
}

impl FitCmd {
    fn run(self) -> Result<Value> {
        let robot = robot_file::load(&self.robot)?;
        let Moved { frames, frame_rate, .. } = self.source.motion()?;
        let fit = Fit::of(&robot, &frames, frame_rate)?;
        say(&format!("{}: {} frames, {} s", robot.name, frames.len(), frames.len() as f64 / f64::from(frame_rate)));
        say(&format!(
            "{:24} {:>16} {:>14} {:>8} {:>13} {:>15} {:>8}",
            "servo", "used", "range", "clipped", "deg/s", "deg/s^2", "beyond"
        ));
        for c in &fit.channels {
            let percent = |share: f64| format!("{:.1} %", 100.0 * share);
            let [low, high] = c.used;
            say(&format!(
                "{:24} {:>16} {:>14} {:>8} {:>13} {:>15} {:>8}",
                c.name,
                format!("{low:.1} to {high:.1}"),
                format!("{} to {}", c.range[0], c.range[1]),
                percent(c.clipped),
                format!("{:.0} of {}", c.speed, c.speed_limit),
                format!("{:.0} of {}", c.acceleration, c.acceleration_limit),
                percent(c.beyond)
            ));
        }
        say(&format!(
            "joints off, axes and ranges alone: mean {:.1} mm, largest {:.0} mm",
            fit.reached.mean_mm, fit.reached.max_mm
        ));
        say(&format!(
            "joints off, as played: mean {:.1} mm, largest {:.0} mm; some servo behind in {:.1} % of ticks",
            fit.played.mean_mm,
            fit.played.max_mm,
            100.0 * fit.limited
        ));
        Ok(serde_json::to_value(&fit)?)
    }
}
