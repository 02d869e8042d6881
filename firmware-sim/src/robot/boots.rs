//! Many starts, with resets and brown-outs in mid-motion, and what the servos' horns do meanwhile.

use std::fmt;

use anyhow::{Context, Result, ensure};
use clap::Args;
use motionette::numerics::hash::Stream;
use motionette::playback::{Bus, Robot, Start, When};
use motionette::representation::Pose;
use motionette::{Generator, Model, Request};
use motionette_host::blob::AlignedBlob;
use motionette_host::robot_file;

use super::faults::{Fault, Kind};
use super::hardware::Boot;
use super::simulation::{Event, Horns, Run, Scenario, run};
use crate::default_model;
use crate::sample_clips::SampleClips;

/// Horns may be faster than their limits by so much: motors follow, they do not obey.
const TOLERANCE: f64 = 1.05;
/// Microseconds after power came up at which a motion is ready: a robot that stands at neutral begins it at once.
const READY: u64 = 1_000_000;
/// Frames of a series' motion.
const FRAMES: usize = 60;
/// Microseconds that they last.
const LASTS: u32 = FRAMES as u32 * 1_000_000 / FRAME_RATE as u32;
/// Its frames a second.
const FRAME_RATE: u16 = 20;

/// Start simulated robots again and again, and say what their horns did.
///
/// Example: motionette-sim boots --count 1000
#[derive(Debug, Args)]
pub struct Cmd {
    /// Starts in each series.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,
    /// Seed of poses, loads and times.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl Cmd {
    /// Prints a line for each series.
    ///
    /// # Errors
    /// Some start was not as it must be.
    pub fn run(self) -> Result<()> {
        use std::io::Write;
        let motion = motion()?;
        let mut failed = Vec::new();
        let mut out = std::io::stdout();
        writeln!(out, "{}", Figures::HEAD)?;
        for series in Series::ALL {
            let figures = series.run(&motion, self.count, self.seed)?;
            writeln!(out, "{figures}")?;
            if figures.good < figures.count {
                failed.push(series.name());
            }
        }
        ensure!(failed.is_empty(), "not all starts were as they must be: {}", failed.join(", "));
        Ok(())
    }
}

/// Starts of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Series {
    /// STS3215 servos, booted in any pose, then a motion.
    Boots,
    /// STS3215 servos, the microcontroller reset in mid-motion, then another motion.
    Resets,
    /// STS3215 servos that lose their power in mid-motion.
    BrownOuts,
    /// STS3215 servos, booted in any pose, that lose their power while they start.
    BrownStarts,
    /// Servos on a PCA9685, booted in the pose that is stated.
    Pca9685Stated,
    /// Servos on pins, booted in the pose that is stated.
    PwmStated,
    /// Servos on a PCA9685, booted in another pose than is stated: the horns jump.
    Pca9685Wrong,
    /// Servos on pins, booted in another pose than is stated: the horns jump.
    PwmWrong,
}

impl Series {
    /// All of them.
    pub const ALL: [Series; 8] = [
        Series::Boots,
        Series::Resets,
        Series::BrownOuts,
        Series::BrownStarts,
        Series::Pca9685Stated,
        Series::PwmStated,
        Series::Pca9685Wrong,
        Series::PwmWrong,
    ];

    /// What it is called.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Series::Boots => "STS3215, any pose",
            Series::Resets => "STS3215, reset in mid-motion",
            Series::BrownOuts => "STS3215, brown-out in mid-motion",
            Series::BrownStarts => "STS3215, brown-out while starting",
            Series::Pca9685Stated => "PCA9685, stated pose",
            Series::PwmStated => "PWM, stated pose",
            Series::Pca9685Wrong => "PCA9685, wrongly stated pose",
            Series::PwmWrong => "PWM, wrongly stated pose",
        }
    }

    const fn serial(self) -> bool {
        matches!(self, Series::Boots | Series::Resets | Series::BrownOuts | Series::BrownStarts)
    }

    /// Whether horns keep their limits: not where nobody can know where they are.
    const fn keeps_limits(self) -> bool {
        !matches!(self, Series::Pca9685Wrong | Series::PwmWrong)
    }

    /// The robot: a preset, with its servos on pins where that is asked for.
    fn robot(self) -> Result<Robot> {
        let mut robot = robot_file::load(if self.serial() { "desk" } else { "upper-body" })?;
        if matches!(self, Series::PwmStated | Series::PwmWrong) {
            for (pin, channel) in (0..).zip(&mut robot.channels) {
                channel.bus = Bus::Pwm { pin };
            }
        }
        Ok(robot)
    }

    /// Runs `count` of them; `motion` is played where one is.
    ///
    /// # Errors
    /// When a preset is missing.
    pub fn run(self, motion: &[Pose], count: u32, seed: u64) -> Result<Figures> {
        let robot = self.robot()?;
        let mut figures = Figures { series: self, count, good: 0, horns: Horns::default(), outside: 0, slowest: 0.0 };
        for number in 0..count {
            let run = self.one(&robot, motion, &mut Stream::new(seed.wrapping_mul(1_000_003) + u64::from(number)));
            let played = match self {
                Series::Resets => run.motions[1] == 1 && run.motions[0] == 2,
                _ => run.motions == if self.serial() { [1, 1] } else { [0, 0] },
            };
            let limits = run.horns.speed <= TOLERANCE && run.horns.acceleration <= TOLERANCE;
            let sound = run.start == Start::Ready && run.limit_violations == 0 && run.missed_ticks == 0;
            figures.good += u32::from(sound && played && (limits || !self.keeps_limits()));
            figures.outside += run.limit_violations;
            figures.horns = figures.horns.max(run.horns);
            figures.slowest = figures.slowest.max(run.ready.unwrap_or(f64::INFINITY));
        }
        Ok(figures)
    }

    /// One of them.
    fn one(self, robot: &Robot, motion: &[Pose], random: &mut Stream) -> Run {
        let mut robot = robot.clone();
        let mut draw = |channel: &motionette::playback::Channel| {
            let [low, high] = channel.range.map(f64::from);
            low + (high - low) * f64::from(random.below(1001)) / 1000.0
        };
        let pose: Vec<f64> = robot.channels.iter().map(&mut draw).collect();
        let ready = |at: u64| (at, Event::Ready { frames: motion.to_vec(), frame_rate: FRAME_RATE, when: When::Then });
        let mut boot = Boot { pose: Vec::new(), held: !self.serial() };
        let (mut events, mut faults) = (Vec::new(), Vec::new());
        let mut brown_out = |random: &mut Stream, from: u64, within: u32| {
            let from = from + u64::from(random.below(within));
            let until = from + 30_000 + u64::from(random.below(220_000));
            faults.push(Fault { kind: Kind::Brownout, from, until });
        };
        match self {
            Series::Boots => {
                boot.pose = pose;
                events.push(ready(READY));
            }
            Series::Resets => {
                let at = READY + 50_000 + u64::from(random.below(LASTS - 100_000));
                events.extend([ready(READY), (at, Event::Reset), ready(at + 400_000)]);
            }
            Series::BrownOuts => {
                events.push(ready(READY));
                brown_out(random, READY, LASTS);
            }
            Series::BrownStarts => {
                boot.pose = pose;
                events.push(ready(READY));
                brown_out(random, 0, 4_000_000);
            }
            Series::Pca9685Stated | Series::PwmStated => {
                for (channel, angle) in robot.channels.iter_mut().zip(&pose) {
                    channel.start = Some(*angle as f32);
                }
                boot.pose = pose;
                events.push((u64::from(random.below(1_000_000)), Event::Release));
            }
            Series::Pca9685Wrong | Series::PwmWrong => {
                boot.pose = pose;
                events.push((u64::from(random.below(1_000_000)), Event::Release));
            }
        }
        run(&Scenario { robot: &robot, boot, events, faults, seed: u64::from(random.below(u32::MAX)) })
    }
}

/// What a series gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figures {
    /// Which.
    pub series: Series,
    /// Starts.
    pub count: u32,
    /// Of these, those in which every command kept its limits, the robot was ready and played what it should, no tick was missed, and,
    /// but for wrongly stated poses, the horns kept their limits within 5 %.
    pub good: u32,
    /// Commands outside limits, or faster than creeping before the robot was ready.
    pub outside: u64,
    /// The most that any horn did.
    pub horns: Horns,
    /// Seconds until the slowest was ready.
    pub slowest: f64,
}

impl Figures {
    /// What the columns are.
    pub const HEAD: &'static str =
        "series                                  good  outside  horns: speed  acceleration   deg/s  ready after";
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Figures { series, count, good, outside, horns, slowest } = self;
        write!(
            f,
            "{:34} {good:>4}/{count:<4}  {outside:>7}  {:>12.3}  {:>12.3}  {:>6.0}  {slowest:>9.1} s",
            series.name(),
            horns.speed,
            horns.acceleration,
            horns.degrees_a_second
        )
    }
}

/// The beginning of a recorded motion, as the runtime decodes it.
///
/// # Errors
/// When the built-in bundle or blob is damaged.
pub fn motion() -> Result<Vec<Pose>> {
    let clip = SampleClips::built_in()?.clips.into_iter().next().context("the bundle is empty")?;
    let blob = AlignedBlob::new(default_model::BLOB);
    let model = Model::open(blob.bytes())?;
    let request = Request::tokens(&clip.tokens);
    let plan = Generator::new(model.clone(), &mut [])?.plan(&request)?;
    let mut arena = vec![0u128; plan.arena_bytes.div_ceil(16)];
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut arena))?;
    let mut frames = generator.generate(&request, &mut ())?.frames().to_vec();
    frames.truncate(FRAMES);
    Ok(frames)
}
