//! What the robot's stage of the main job gives: figures, lines for people, and what the viewer shows.

use motionette::JOINTS;
use motionette::playback::{Bus, Robot, reach};
use motionette::representation::Pose;
use motionette_host::metrics;
use serde::Serialize;

use super::faults::{Fault, Kind};
use super::firmware::Boot;
use super::simulation::{EndState, Moment, Run};
use super::stage::Stage;

/// Figures of the simulated robot. Names are stable: `--json` prints this as `robot`.
#[derive(Debug, Clone, Serialize)]
pub struct RobotReport {
    /// Its name.
    pub name: String,
    /// Servos.
    pub channels: usize,
    /// Ticks a second.
    pub tick_rate: u16,
    /// Ticks of the run.
    pub ticks: u64,
    /// Ticks that began late because the one before had not ended.
    pub missed_ticks: u64,
    /// Commands heard by a servo outside its limits, or faster than its speed.
    pub limit_violations: u64,
    /// Faults injected.
    pub faults_injected: usize,
    /// Of these, those after which the robot did what it should again.
    pub faults_recovered: usize,
    /// The faults, with their times in microseconds.
    pub faults: Vec<Fault>,
    /// How it ended.
    pub end_state: EndState,
    /// Largest distance between where a servo should be and where it was, degrees.
    pub worst_tracking_deg: f64,
    /// Mean distance from the anchors of what the commanded angles make of the body, centimetres; null without anchors.
    pub servo_control_error_cm: Option<f64>,
    /// The same of the angles that the servos reached.
    pub reached_control_error_cm: Option<f64>,
    /// Attempts on a bus that failed.
    pub bus_errors: u32,
    /// Ticks in which servos did not get their commands.
    pub failed_ticks: u32,
    /// Ticks in which a servo's limits kept it from where the motion wanted it.
    pub limited_ticks: u32,
    /// Longest tick, microseconds.
    pub longest_tick_us: u64,
    /// Motions begun.
    pub motions: u32,
    /// What the firmware logged at its start.
    pub log: Vec<String>,
}

/// The moment nearest to a frame of the first motion.
fn at_frame(run: &Run, frame: f32) -> Option<&Moment> {
    let first = run.moments.iter().filter(|moment| moment.motion == 1);
    let distance = |moment: &Moment| moment.frame.map_or(f32::INFINITY, |shown| (shown - frame).abs());
    first.min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// Poses that the robot made of the first motion, frame by frame: by the angles it was commanded, or reached.
fn poses(robot: &Robot, run: &Run, frames: &[Pose], angles: impl Fn(&Moment) -> &[f32]) -> Vec<Pose> {
    let pose = |(index, pose): (usize, &Pose)| {
        at_frame(run, index as f32).map_or(*pose, |moment| reach(robot, pose, angles(moment)))
    };
    frames.iter().enumerate().map(pose).collect()
}

impl RobotReport {
    /// Of a run of `stage`.
    #[must_use]
    pub fn new(stage: &Stage<'_>, run: &Run, boot: &Boot, faults: &[Fault]) -> Self {
        let &Stage { robot, frames, anchors, .. } = stage;
        // A generator that came too late is forgiven when its motion was played to the end all the same.
        let overrun = faults.iter().any(|fault| fault.kind == Kind::Overrun) && run.motions == [2, 2];
        let error = |poses: Vec<Pose>| metrics::control_error(&poses, anchors).map(|metres| 100.0 * metres);
        RobotReport {
            name: robot.name.as_str().to_owned(),
            channels: robot.channels.len(),
            tick_rate: robot.tick_rate,
            ticks: run.ticks,
            missed_ticks: run.missed_ticks,
            limit_violations: run.limit_violations,
            faults_injected: faults.len(),
            faults_recovered: run.recovered.len() + boot.recovered.len() + usize::from(overrun),
            faults: faults.to_vec(),
            end_state: run.end_state,
            worst_tracking_deg: run.worst_tracking_deg,
            servo_control_error_cm: error(poses(robot, run, frames, |moment| &moment.commanded)),
            reached_control_error_cm: error(poses(robot, run, frames, |moment| &moment.reached)),
            bus_errors: run.bus_errors,
            failed_ticks: run.failed_ticks,
            limited_ticks: run.limited_ticks,
            longest_tick_us: run.longest_tick_us,
            motions: run.motions[0],
            log: boot.log.clone(),
        }
    }

    /// The lines a person reads.
    #[must_use]
    pub fn lines(&self) -> Vec<(String, String)> {
        let line = |label: &str, value: String| (label.to_owned(), value);
        let end = match self.end_state {
            EndState::Finished => "finished, holding its last pose",
            EndState::Holding => "holding",
            EndState::Neutral => "back at neutral",
            EndState::Stopped => "stopped",
            EndState::Moving => "still moving",
        };
        let mut lines = vec![
            line("robot", format!("{}, {} servos at {} Hz: {end}", self.name, self.channels, self.tick_rate)),
            line(
                "ticks",
                format!(
                    "{}, {} missed, longest {:.1} ms; {} commands outside limits",
                    self.ticks,
                    self.missed_ticks,
                    self.longest_tick_us as f64 / 1e3,
                    self.limit_violations
                ),
            ),
            line(
                "servos",
                format!(
                    "at most {:.1} degrees behind; held back by their limits in {} ticks",
                    self.worst_tracking_deg, self.limited_ticks
                ),
            ),
        ];
        if let (Some(commanded), Some(reached)) = (self.servo_control_error_cm, self.reached_control_error_cm) {
            lines.push(line("servo control error", format!("{commanded:.2} cm commanded, {reached:.2} cm reached")));
        }
        if self.faults_injected > 0 {
            let names: Vec<&str> = self.faults.iter().map(|fault| fault.kind.name()).collect();
            let (recovered, injected) = (self.faults_recovered, self.faults_injected);
            lines.push(line(
                "faults",
                format!(
                    "{}: {recovered} of {injected} recovered; {} bus errors, {} ticks without commands",
                    names.join(", "),
                    self.bus_errors,
                    self.failed_ticks
                ),
            ));
        }
        lines.extend(self.log.iter().map(|text| line("firmware", text.clone())));
        lines
    }
}

/// A servo in the viewer.
#[derive(Debug, Serialize)]
pub struct ShownServo {
    /// Its name.
    pub name: String,
    /// Its bus.
    pub bus: String,
    /// Smallest and largest angle, degrees.
    pub range: [f32; 2],
    /// Degrees commanded, tick by tick.
    pub commanded: Vec<f32>,
    /// Degrees reached.
    pub reached: Vec<f32>,
}

/// The robot in the viewer.
#[derive(Debug, Serialize)]
pub struct ShownRobot {
    /// Its name.
    pub name: String,
    /// Ticks a second.
    pub tick_rate: u16,
    /// When the motion began, seconds.
    pub began: f64,
    /// Seconds of each tick's state other than the ones before: `[from, state]`.
    pub states: Vec<(f64, &'static str)>,
    /// Faults, seconds.
    pub faults: Vec<(&'static str, f64, f64)>,
    /// Its servos.
    pub servos: Vec<ShownServo>,
}

fn rounded(angle: f32) -> f32 {
    (angle * 100.0).round() / 100.0
}

impl ShownRobot {
    /// Of a run.
    #[must_use]
    pub fn new(robot: &Robot, run: &Run, faults: &[Fault]) -> Self {
        let servos = robot.channels.iter().enumerate().map(|(index, channel)| ShownServo {
            name: channel.name.as_str().replace('_', " "),
            bus: match channel.bus {
                Bus::Pwm { pin } => format!("pin {pin}"),
                Bus::Pca9685 { address, output } => format!("PCA9685 {address:#04x}, output {output}"),
                Bus::Sts3215 { id } => format!("STS3215 {id}"),
            },
            range: channel.range,
            commanded: run.moments.iter().map(|moment| rounded(moment.commanded[index])).collect(),
            reached: run.moments.iter().map(|moment| rounded(moment.reached[index])).collect(),
        });
        let mut states: Vec<(f64, &'static str)> = Vec::new();
        for moment in &run.moments {
            let state = if moment.down { "bus down" } else { moment.state };
            if states.last().is_none_or(|(_, last)| *last != state) {
                states.push((moment.time, state));
            }
        }
        let shown = |fault: &Fault| (fault.kind.name(), fault.from as f64 / 1e6, fault.until as f64 / 1e6);
        ShownRobot {
            name: robot.name.as_str().to_owned(),
            tick_rate: robot.tick_rate,
            began: run.began.first().copied().unwrap_or(0.0),
            states,
            faults: faults.iter().filter(|fault| fault.kind.is_electrical()).map(shown).collect(),
            servos: servos.collect(),
        }
    }
}

/// The body as the servos moved it, at each frame of the motion's own time.
#[must_use]
pub fn body(robot: &Robot, run: &Run, frames: &[Pose], frame_rate: u16) -> Vec<[[f32; 3]; JOINTS]> {
    let began = run.began.first().copied().unwrap_or(0.0);
    let pose = |(index, pose): (usize, &Pose)| {
        let time = began + index as f64 / f64::from(frame_rate);
        let tick = (time * f64::from(robot.tick_rate)).round() as usize;
        // Where the motion was held up, the frame that was shown last stays.
        let shown = run.moments.get(..=tick).unwrap_or(&run.moments);
        let frame = shown.iter().rev().find_map(|moment| moment.frame).map_or(index, |frame| frame.round() as usize);
        let source = frames.get(frame.min(index)).unwrap_or(pose);
        run.moments.get(tick).map_or(*pose, |moment| reach(robot, source, &moment.reached))
    };
    frames.iter().enumerate().map(pose).collect()
}
