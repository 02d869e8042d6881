//! The robot's stage of the main job: the firmware starts with the robot at neutral and released, the motion is played, and what was asked to go wrong goes wrong.

use anyhow::Result;
use motionette::playback::{Robot, When};
use motionette::representation::Pose;
use motionette::{Anchor, Model, Request};

use super::faults::{self, Fault, Kind};
use super::firmware;
use super::hardware::Boot;
use super::report::{self, RobotReport, ShownRobot};
use super::simulation::{self, Event, Run, Scenario};

/// Microseconds after power came up at which the motion is ready: the time that thinking takes is left out.
const READY: u64 = 200_000;
/// Microseconds between the end of a motion and an overdue one.
const OVERDUE: u64 = 1_200_000;

/// What the stage needs.
#[derive(Debug)]
pub struct Stage<'s> {
    /// The robot.
    pub robot: &'s Robot,
    /// The model.
    pub model: &'s Model<'s>,
    /// The request that made the motion.
    pub request: &'s Request<'s>,
    /// The motion.
    pub frames: &'s [Pose],
    /// Its anchors.
    pub anchors: &'s [Anchor],
    /// What is to go wrong.
    pub faults: &'s [Kind],
    /// Seed of everything that is drawn.
    pub seed: u64,
}

/// What the stage gives.
#[derive(Debug)]
pub struct Played {
    /// Figures.
    pub report: RobotReport,
    /// For the viewer.
    pub shown: ShownRobot,
    /// The body as the servos moved it, frame by frame.
    pub body: Vec<Pose>,
}

impl Stage<'_> {
    /// Plays.
    ///
    /// # Errors
    /// When the blob fails its self-test or a request is refused.
    pub fn run(&self) -> Result<Played> {
        let mut boot = firmware::start(self.model.bytes(), self.faults, self.seed)?;
        if self.faults.contains(&Kind::Arena) {
            firmware::in_too_small_an_arena(self.model, self.request, &mut boot)?;
        }
        let frame_rate = self.model.frame_rate();
        let end = READY + self.frames.len() as u64 * 1_000_000 / u64::from(frame_rate);
        let mut events = vec![
            (0, Event::Release),
            (READY, Event::Ready { frames: self.frames.to_vec(), frame_rate, when: When::Then }),
        ];
        let electrical: Vec<Kind> = self.faults.iter().copied().filter(|kind| kind.is_electrical()).collect();
        let mut faults = faults::schedule(&electrical, self.seed, [READY + 300_000, end.max(READY + 600_000)]);
        for &kind in self.faults.iter().filter(|kind| !kind.is_electrical()) {
            faults.push(match kind {
                Kind::Overrun => Fault { kind, from: end, until: end + OVERDUE },
                _ => Fault { kind, from: 0, until: 0 },
            });
        }
        if self.faults.contains(&Kind::Overrun) {
            let frames = firmware::with_a_deadline(self.model, self.request)?;
            boot.log.push(format!(
                "deadline: {} frames with the best so far, {} ms late",
                frames.len(),
                OVERDUE / 1000
            ));
            events.push((end + OVERDUE, Event::Ready { frames, frame_rate, when: When::Then }));
        }
        let run: Run = simulation::run(&Scenario {
            robot: self.robot,
            boot: Boot::default(),
            events,
            faults: faults.clone(),
            seed: self.seed,
        });
        Ok(Played {
            report: RobotReport::new(self, &run, &boot, &faults),
            shown: ShownRobot::new(self.robot, &run, &faults),
            body: report::body(self.robot, &run, self.frames, frame_rate),
        })
    }
}
