//! A run of the robot: the firmware's own feeder, player and outputs on simulated wires, in virtual time.
//!
//! The timer interrupt runs [`Runner::tick`] at every tick; between ticks the firmware's thread does what is due: it puts motions
//! into the line when they are ready and gives the orders of the scenario. A tick that has not ended when the next one is due is
//! counted as missed.

use std::cell::RefCell;
use std::rc::Rc;

use motionette::playback::output::{Output, Pca9685, Pwm, Runner, Sts3215, Time};
use motionette::playback::{Channel, Ends, Line, Player, Robot, State, When};
use serde::Serialize;

use super::clock::Clock;
use super::faults::{Fault, Injector, Kind};
use super::hardware::Hardware;
use super::wires::{Faulty, I2cWire, Pin, SerialWire};
use motionette::motion::Pose;

/// Servo channels and frames that the simulated firmware has room for.
pub const CHANNELS: usize = 32;
/// See [`CHANNELS`].
pub const FRAMES: usize = 256;
/// Pins by number, as many as a description can name.
const PINS: usize = 256;
/// Part of a tick that its attempts may take; one more may follow.
const BUDGET: f64 = 0.6;
/// Microseconds after a motion's end before the run ends.
const AFTERWARDS: u64 = 2_500_000;
/// Microseconds in which a robot must be back after a fault.
const RECOVERY: u64 = 500_000;

/// What the firmware's thread does at some time.
#[derive(Debug, Clone)]
pub enum Event {
    /// A motion is ready: joint positions at 20 frames a second.
    Ready {
        /// The frames, metres.
        frames: Vec<Pose>,
        /// When it is to begin.
        when: When,
    },
    /// Emergency stop.
    Stop,
    /// Hold.
    Hold,
    /// Go on.
    Resume,
    /// Return to neutral.
    Neutral,
}

/// A run.
#[derive(Debug, Clone)]
pub struct Scenario<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// What happens when, microseconds, in order.
    pub events: Vec<(u64, Event)>,
    /// What goes wrong.
    pub faults: Vec<Fault>,
    /// Seed of loads and of what the faults draw.
    pub seed: u64,
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum EndState {
    /// It stands at the end of its last motion.
    Finished,
    /// It stands somewhere else.
    Holding,
    /// It stands at its neutral angles.
    Neutral,
    /// It stands after an emergency stop.
    Stopped,
    /// It still moves.
    Moving,
}

/// A tick, for the viewer.
#[derive(Debug, Clone, Serialize)]
pub struct Moment {
    /// Seconds.
    pub time: f64,
    /// Degrees that the firmware commands.
    pub commanded: Vec<f32>,
    /// Degrees at which the servos stand.
    pub reached: Vec<f32>,
    /// What the player does.
    pub state: &'static str,
    /// Whether the bus was down.
    pub down: bool,
    /// Motions begun so far, and the frame of the last one that this tick showed.
    pub motion: u32,
    /// See [`Moment::motion`].
    pub frame: Option<f32>,
}

/// What a run gave.
#[derive(Debug, Clone)]
pub struct Run {
    /// Ticks.
    pub ticks: u64,
    /// Ticks that began late because the one before had not ended.
    pub missed_ticks: u64,
    /// Commands heard by a servo outside its limits, or faster than its speed.
    pub limit_violations: u64,
    /// Electrical faults after which every servo heard its commands again in time.
    pub recovered: Vec<Kind>,
    /// How it ended.
    pub end_state: EndState,
    /// Largest distance between where a servo should be and where it was, degrees.
    pub worst_tracking_deg: f64,
    /// Attempts on a bus that failed.
    pub bus_errors: u32,
    /// Ticks in which servos did not get their commands.
    pub failed_ticks: u32,
    /// Longest tick, microseconds.
    pub longest_tick_us: u64,
    /// Motions begun, and played to their end.
    pub motions: [u32; 2],
    /// Ticks in which a servo's limits kept it from where the motion wanted it.
    pub limited_ticks: u32,
    /// Time at which each motion began, seconds.
    pub began: Vec<f64>,
    /// Every tick.
    pub moments: Vec<Moment>,
}

type Chip = Pca9685<Faulty<I2cWire>>;

/// All outputs of a robot.
pub struct Wiring {
    chips: Vec<Chip>,
    serial: Sts3215<Faulty<SerialWire>>,
    pins: Pwm<Pin, PINS>,
}

/// Something on a bus failed; the firmware would print what.
#[derive(Debug, Clone, Copy)]
pub struct BusFailed;

impl Output for Wiring {
    type Error = BusFailed;

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), BusFailed> {
        let mut result = Ok(());
        for chip in &mut self.chips {
            result = result.and(chip.write(channels, commands, time).map_err(|_| BusFailed));
        }
        result = result.and(self.serial.write(channels, commands, time).map_err(|_| BusFailed));
        result.and(self.pins.write(channels, commands, time).map_err(|_| BusFailed))
    }
}

/// Runs a scenario to its end.
///
/// # Panics
/// When the robot has more channels than one can have: a checked one has not.
#[must_use]
pub fn run(scenario: &Scenario<'_>) -> Run {
    let robot = scenario.robot;
    let mut line = Box::new(Line::<CHANNELS, FRAMES>::new());
    let Ends { mut feeder, player, control } = line.split(robot).expect("a robot has at most 32 channels");
    let clock = Clock::default();
    let hardware = Rc::new(RefCell::new(Hardware::new(robot, scenario.seed)));
    let injector = Rc::new(RefCell::new(Injector::new(&scenario.faults, scenario.seed)));
    let mut runner = Runner::new(player, wiring(&hardware, &injector, &clock));

    let period = 1_000_000 / u64::from(robot.tick_rate);
    let budget = (BUDGET * period as f64) as u32;
    let mut watch = Watch::new(robot);
    let mut events = scenario.events.iter().peekable();
    let mut waiting: Vec<&Event> = Vec::new();
    let last_fault = scenario.faults.iter().map(|fault| fault.until).max().unwrap_or(0);
    let mut out = Run {
        ticks: 0,
        missed_ticks: 0,
        limit_violations: 0,
        recovered: Vec::new(),
        end_state: EndState::Moving,
        worst_tracking_deg: 0.0,
        bus_errors: 0,
        failed_ticks: 0,
        longest_tick_us: 0,
        motions: [0; 2],
        limited_ticks: 0,
        began: Vec::new(),
        moments: Vec::new(),
    };
    let (mut quiet_since, mut browned_out) = (0, false);
    let mut healthy = Vec::new();
    // Motions played to their end when the last one began.
    let mut played_before = 0;
    for tick in 0u64.. {
        let due = tick * period;
        out.missed_ticks += u64::from(clock.now() > due);
        clock.pass_until(due);
        while let Some((_, event)) = events.next_if(|(at, _)| *at <= due) {
            match event {
                Event::Ready { .. } => waiting.push(event),
                Event::Stop => control.stop(),
                Event::Hold => control.hold(),
                Event::Resume => control.resume(),
                Event::Neutral => control.neutral(),
            }
        }
        while let Some(Event::Ready { frames, when }) = waiting.first() {
            if feeder.play_frames(frames, 20, *when).is_err() {
                break;
            }
            waiting.remove(0);
        }
        let brownout = injector.borrow().active(Kind::Brownout, due);
        if brownout && !browned_out {
            hardware.borrow_mut().reset();
        }
        browned_out = brownout;

        let began = runner.player().status().motions;
        let ticked = runner.tick(&mut || clock.now() as u32, budget);
        let status = *runner.player().status();
        if status.motions > began {
            out.began.push(due as f64 / 1e6);
            played_before = status.finished;
        }
        out.longest_tick_us = out.longest_tick_us.max(clock.now() - due);
        out.ticks += 1;
        let mut hardware = hardware.borrow_mut();
        hardware.advance(due + period);
        let down = runner.bus().down;
        out.limit_violations += watch.look(&hardware, robot);
        let moment = moment(due, runner.player(), &hardware, ticked.state, down);
        for (commanded, reached) in moment.commanded.iter().zip(&moment.reached) {
            out.worst_tracking_deg = out.worst_tracking_deg.max(f64::from((commanded - reached).abs()));
        }
        let heard = (0..robot.channels.len()).all(|channel| hardware.heard(channel).is_some());
        healthy.push((due, heard && !down));
        out.moments.push(moment);

        let moving = matches!(ticked.state, State::Playing | State::Starved | State::Returning | State::Stopping);
        if moving || !waiting.is_empty() || events.peek().is_some() || due < last_fault + RECOVERY || down {
            quiet_since = due;
        }
        if due > quiet_since + AFTERWARDS || due > 600_000_000 {
            out.end_state = match ticked.state {
                _ if !waiting.is_empty() => EndState::Moving,
                State::Neutral => EndState::Neutral,
                State::Stopped => EndState::Stopped,
                State::Holding if status.finished > played_before => EndState::Finished,
                State::Holding => EndState::Holding,
                _ => EndState::Moving,
            };
            break;
        }
    }
    let status = runner.player().status();
    (out.motions, out.limited_ticks) = ([status.motions, status.finished], status.limited);
    (out.bus_errors, out.failed_ticks) = (runner.bus().errors, runner.bus().failed);
    let well_after = |fault: &&Fault| {
        let time = fault.until..fault.until + RECOVERY;
        healthy.iter().any(|(at, well)| time.contains(at) && *well)
    };
    let electrical = scenario.faults.iter().filter(|fault| fault.kind.is_electrical());
    out.recovered = electrical.filter(well_after).map(|fault| fault.kind).collect();
    out
}

/// The robot's outputs on simulated wires.
pub fn wiring(hardware: &Rc<RefCell<Hardware>>, injector: &Rc<RefCell<Injector>>, clock: &Clock) -> Wiring {
    let faulty = |wire| Faulty::new(wire, injector.clone(), clock.clone());
    let addresses: Vec<u8> = hardware.borrow().chips.keys().copied().collect();
    let i2c = || I2cWire { hardware: hardware.clone(), clock: clock.clone() };
    let chips = addresses.into_iter().map(|address| Pca9685::new(faulty(i2c()), address, 50)).collect();
    let wire = SerialWire { hardware: hardware.clone(), clock: clock.clone() };
    let serial = Sts3215::new(Faulty::new(wire, injector.clone(), clock.clone()));
    let pins = std::array::from_fn(|number| Pin { hardware: hardware.clone(), number: number as u8 });
    Wiring { chips, serial, pins: Pwm::new(pins, 20_000) }
}

fn moment(due: u64, player: &Player<'_, CHANNELS>, hardware: &Hardware, state: State, down: bool) -> Moment {
    let reached = (0..player.channels().len()).map(|channel| hardware.reached(channel) as f32).collect();
    let state = motionette_link::message::State::from(state).name();
    let (commanded, motion, frame) = (player.angles().collect(), player.status().motions, player.frame());
    Moment { time: due as f64 / 1e6, commanded, reached, state, down, motion, frame }
}

/// Looks at what servos hear, as an oscilloscope would.
struct Watch {
    before: Vec<Option<f64>>,
}

impl Watch {
    fn new(robot: &Robot) -> Self {
        Watch { before: vec![None; robot.channels.len()] }
    }

    /// How many servos hear what they must not: a command outside its limits, or one that is farther from the last than the speed allows.
    fn look(&mut self, hardware: &Hardware, robot: &Robot) -> u64 {
        let mut violations = 0;
        for (index, (channel, before)) in robot.channels.iter().zip(&mut self.before).enumerate() {
            let Some(heard) = hardware.heard(index) else { continue };
            let [first, last] = channel.command.map(f64::from);
            let resolution = hardware.resolution(index);
            let [low, high] = channel.range.map(f64::from);
            let most = f64::from(channel.speed) / f64::from(robot.tick_rate) * (last - first) / (high - low)
                + 1.5 * resolution;
            let outside = heard < first - 1e-6 || heard > last + 1e-6;
            let jumped = before.is_some_and(|before| (heard - before).abs() > most);
            violations += u64::from(outside || jumped);
            *before = Some(heard);
        }
        violations
    }
}
