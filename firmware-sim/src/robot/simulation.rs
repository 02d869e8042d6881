//! A run of the robot: the firmware's own feeder, player and outputs on simulated wires, in virtual time.
//!
//! The timer interrupt runs [`Runner::tick`] at every tick; between ticks the firmware's thread does what is due: it puts motions
//! into the line when they are ready and gives the orders of the scenario. A tick that has not ended when the next one is due is
//! counted as missed.

use std::cell::RefCell;
use std::iter::Peekable;
use std::rc::Rc;

use motionette::playback::output::{Held, Lost, Output, Pca9685, Pwm, Runner, Sts3215, Time};
use motionette::playback::{Channel, Handles, MotionQueue, Player, Robot, Start, State, When};
use serde::Serialize;

use super::clock::Clock;
use super::faults::{Fault, Injector, Kind};
use super::hardware::{AWAKE, Boot, Hardware};
use super::wires::{Faulty, I2cWire, Pin, SerialWire};
use motionette::representation::Pose;

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
/// Microseconds from a reset of the microcontroller to its first tick.
const REBOOT: u64 = 300_000;
/// Microseconds in which a robot must be back after a fault, and after its servos have started again.
const RECOVERY: u64 = 500_000 + AWAKE;

/// What the firmware's thread does at some time.
#[derive(Debug, Clone)]
pub enum Event {
    /// A motion is ready.
    Ready {
        /// Joint positions, metres.
        frames: Vec<Pose>,
        /// Frames a second.
        frame_rate: u16,
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
    /// Servos that cannot say where they stand are released.
    Release,
    /// The microcontroller is reset and starts again; servos keep their power.
    Reset,
}

/// A run.
#[derive(Debug, Clone)]
pub struct Scenario<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// How power comes up.
    pub boot: Boot,
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
    /// Commands heard by a servo outside its limits, or faster than its speed, or than creeping before the robot was ready.
    pub limit_violations: u64,
    /// What the horns did, from power coming up to the end.
    pub horns: Horns,
    /// When the robot was ready for motions for the first time, seconds.
    pub ready: Option<f64>,
    /// How its start stood in the end.
    pub start: Start,
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

/// What the servos' horns themselves did, whatever they were told: differences over ticks.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Horns {
    /// Largest speed, in shares of the channel's limit.
    pub speed: f64,
    /// Largest acceleration, in shares of the channel's limit.
    pub acceleration: f64,
    /// Largest speed, degrees a second.
    pub degrees_a_second: f64,
}

impl Horns {
    /// The larger of both.
    #[must_use]
    pub const fn max(self, other: Horns) -> Horns {
        Horns {
            speed: self.speed.max(other.speed),
            acceleration: self.acceleration.max(other.acceleration),
            degrees_a_second: self.degrees_a_second.max(other.degrees_a_second),
        }
    }
}

type Chip = Pca9685<Faulty<I2cWire>>;
type Serial = Sts3215<Faulty<SerialWire>>;

/// All outputs of a robot.
pub struct Wiring {
    chips: Vec<Chip>,
    serial: Serial,
    pins: Pwm<Pin, PINS>,
}

/// Something on a bus failed; the firmware would print what.
#[derive(Debug, Clone, Copy)]
pub struct BusFailed(Option<Lost>);

impl BusFailed {
    /// Of an output's error.
    fn of<O: Output>(error: O::Error) -> Self {
        BusFailed(O::lost(&error))
    }
}

impl Output for Wiring {
    type Error = BusFailed;

    fn serves(&self, _: &Channel) -> bool {
        true
    }

    fn find(&mut self, channels: &[Channel], index: usize, time: &mut Time<'_>) -> Result<Option<u16>, BusFailed> {
        let channel = &channels[index];
        if let Some(chip) = self.chips.iter_mut().find(|chip| chip.serves(channel)) {
            return chip.find(channels, index, time).map_err(BusFailed::of::<Chip>);
        }
        if self.serial.serves(channel) {
            return self.serial.find(channels, index, time).map_err(BusFailed::of::<Serial>);
        }
        self.pins.find(channels, index, time).map_err(BusFailed::of::<Pwm<Pin, PINS>>)
    }

    fn hold(&mut self, channels: &[Channel], index: usize, slack: f32, time: &mut Time<'_>) -> Result<Held, BusFailed> {
        if !self.serial.serves(&channels[index]) {
            return Ok(Held::Unknown);
        }
        self.serial.hold(channels, index, slack, time).map_err(BusFailed::of::<Serial>)
    }

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), BusFailed> {
        let mut result = Ok(());
        for chip in &mut self.chips {
            result = result.and(chip.write(channels, commands, time).map_err(BusFailed::of::<Chip>));
        }
        result = result.and(self.serial.write(channels, commands, time).map_err(BusFailed::of::<Serial>));
        result.and(self.pins.write(channels, commands, time).map_err(BusFailed::of::<Pwm<Pin, PINS>>))
    }

    fn lost(error: &BusFailed) -> Option<Lost> {
        error.0
    }
}

/// Runs a scenario to its end.
///
/// # Panics
/// When the robot has more channels than one can have: a checked one has not.
#[must_use]
pub fn run(scenario: &Scenario<'_>) -> Run {
    let robot = scenario.robot;
    let mut bench = Bench::new(scenario);
    // Each turn is a life of the firmware, from its start to a reset or to the end.
    while bench.live(robot) {}
    let well_after = |fault: &&Fault| {
        let time = fault.until..fault.until + RECOVERY;
        bench.healthy.iter().any(|(at, well)| time.contains(at) && *well)
    };
    let electrical = scenario.faults.iter().filter(|fault| fault.kind.is_electrical());
    bench.run.recovered = electrical.filter(well_after).map(|fault| fault.kind).collect();
    bench.run
}

/// What outlives the firmware: the robot's hardware, and who looks at it.
struct Bench<'a> {
    clock: Clock,
    hardware: Rc<RefCell<Hardware>>,
    injector: Rc<RefCell<Injector>>,
    watch: Watch,
    events: Peekable<std::slice::Iter<'a, (u64, Event)>>,
    /// Microseconds at which the last fault is over.
    last_fault: u64,
    browned_out: bool,
    tick: u64,
    /// Microseconds of ticks in which the robot moved, or was to.
    quiet_since: u64,
    /// Ticks, and whether every servo heard its commands.
    healthy: Vec<(u64, bool)>,
    run: Run,
}

impl<'a> Bench<'a> {
    fn new(scenario: &'a Scenario<'_>) -> Self {
        let robot = scenario.robot;
        let hardware = Hardware::booted(robot, &scenario.boot, scenario.seed);
        let run = Run {
            ticks: 0,
            missed_ticks: 0,
            limit_violations: 0,
            horns: Horns::default(),
            ready: None,
            start: Start::Reading,
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
        Bench {
            clock: Clock::default(),
            watch: Watch::new(robot, &hardware),
            hardware: Rc::new(RefCell::new(hardware)),
            injector: Rc::new(RefCell::new(Injector::new(&scenario.faults, scenario.seed))),
            events: scenario.events.iter().peekable(),
            last_fault: scenario.faults.iter().map(|fault| fault.until).max().unwrap_or(0),
            browned_out: false,
            tick: 0,
            quiet_since: 0,
            healthy: Vec::new(),
            run,
        }
    }

    /// The firmware lives until the run ends, or until it is reset: then there is another life.
    fn live(&mut self, robot: &Robot) -> bool {
        let mut line = Box::new(MotionQueue::<CHANNELS, FRAMES>::new());
        let Handles { mut feeder, player, control } = line.split(robot).expect("a robot has at most 32 channels");
        let mut runner = Runner::new(player, wiring(&self.hardware, &self.injector, &self.clock));
        let period = 1_000_000 / u64::from(robot.tick_rate);
        let budget = (BUDGET * period as f64) as u32;
        let mut waiting: Vec<&Event> = Vec::new();
        // Motions played to their end when the last one began.
        let mut played_before = 0;
        let reset = loop {
            let due = self.tick * period;
            self.tick += 1;
            self.run.missed_ticks += u64::from(self.clock.now() > due);
            self.clock.pass_until(due);
            let mut reset = false;
            while let Some((_, event)) = self.events.next_if(|(at, _)| *at <= due) {
                match event {
                    Event::Ready { .. } => waiting.push(event),
                    Event::Stop => control.stop(),
                    Event::Hold => control.hold(),
                    Event::Resume => control.resume(),
                    Event::Neutral => control.neutral(),
                    Event::Release => control.release(),
                    Event::Reset => reset = true,
                }
            }
            self.power(due);
            if reset {
                self.without_firmware(robot, due, due + REBOOT, period);
                break true;
            }
            while let Some(Event::Ready { frames, frame_rate, when }) = waiting.first() {
                if feeder.play_frames(frames, *frame_rate, *when).is_err() {
                    break;
                }
                waiting.remove(0);
            }
            let clock = self.clock.clone();
            let began = runner.player().status().motions;
            let ticked = runner.tick(&mut || clock.now() as u32, budget);
            let status = *runner.player().status();
            if status.motions > began {
                self.run.began.push(due as f64 / 1e6);
                played_before = status.finished;
            }
            if status.start == Start::Ready {
                self.run.ready.get_or_insert(due as f64 / 1e6);
            }
            self.run.longest_tick_us = self.run.longest_tick_us.max(self.clock.now() - due);
            let down = runner.bus().down;
            let mut hardware = self.hardware.borrow_mut();
            hardware.advance(due + period);
            let heard = (0..robot.channels.len()).all(|channel| hardware.heard(channel).is_some());
            self.healthy.push((due, heard && !down));
            self.run.ticks += 1;
            self.run.limit_violations += self.watch.look(&hardware, robot, status.start == Start::Ready);
            let moment = moment(due, runner.player(), &hardware, ticked.state, down);
            for (commanded, reached) in moment.commanded.iter().zip(&moment.reached) {
                // Before the start nothing is commanded.
                if matches!(status.start, Start::Creeping | Start::Ready) {
                    self.run.worst_tracking_deg =
                        self.run.worst_tracking_deg.max(f64::from((commanded - reached).abs()));
                }
            }
            self.run.moments.push(moment);
            drop(hardware);

            let moving = matches!(ticked.state, State::Playing | State::Starved | State::Returning | State::Stopping);
            let starting = matches!(status.start, Start::Reading | Start::Creeping) && ticked.state != State::Stopped;
            let busy = moving || starting || !waiting.is_empty() || self.events.peek().is_some() || down;
            if busy || due < self.last_fault + RECOVERY {
                self.quiet_since = due;
            }
            if due > self.quiet_since + AFTERWARDS || due > 600_000_000 {
                self.run.end_state = match ticked.state {
                    _ if !waiting.is_empty() => EndState::Moving,
                    State::Neutral => EndState::Neutral,
                    State::Stopped => EndState::Stopped,
                    State::Holding if status.finished > played_before => EndState::Finished,
                    State::Holding => EndState::Holding,
                    _ => EndState::Moving,
                };
                break false;
            }
        };
        let status = runner.player().status();
        self.run.motions = [self.run.motions[0] + status.motions, self.run.motions[1] + status.finished];
        (self.run.limited_ticks, self.run.start) = (self.run.limited_ticks + status.limited, status.start);
        self.run.bus_errors += runner.bus().errors;
        self.run.failed_ticks += runner.bus().failed;
        self.run.horns = self.watch.horns;
        reset
    }

    /// Power goes and comes as the faults have it.
    fn power(&mut self, now: u64) {
        let brownout = self.injector.borrow().active(Kind::Brownout, now);
        if brownout != self.browned_out {
            self.hardware.borrow_mut().power(!brownout);
        }
        self.browned_out = brownout;
    }

    /// Nobody talks to the servos for a while.
    fn without_firmware(&mut self, robot: &Robot, from: u64, until: u64, period: u64) {
        for due in (from..until).step_by(period as usize) {
            self.power(due);
            let mut hardware = self.hardware.borrow_mut();
            hardware.advance(due + period);
            self.run.limit_violations += self.watch.look(&hardware, robot, true);
        }
        self.tick += (until - from) / period;
    }
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

/// Looks at what servos hear, as an oscilloscope would, and at what their horns do, as a camera would.
struct Watch {
    heard: Vec<Option<f64>>,
    /// Where each horn was, degrees, and how fast, degrees a second; at rest as power comes up.
    horn: Vec<(f64, f64)>,
    horns: Horns,
}

impl Watch {
    fn new(robot: &Robot, hardware: &Hardware) -> Self {
        let count = robot.channels.len();
        let horn = (0..count).map(|index| (hardware.reached(index), 0.0)).collect();
        Watch { heard: vec![None; count], horn, horns: Horns::default() }
    }

    /// How many servos hear what they must not: a command outside its limits, or one that is farther from the last than the speed
    /// allows, or creeping before the robot is `ready`. To be called once a tick.
    fn look(&mut self, hardware: &Hardware, robot: &Robot, ready: bool) -> u64 {
        let rate = f64::from(robot.tick_rate);
        let mut violations = 0;
        for (index, channel) in robot.channels.iter().enumerate() {
            let (at, speed) = self.horn[index];
            let reached = hardware.reached(index);
            let now = (reached - at) * rate;
            self.horn[index] = (reached, now);
            self.horns = self.horns.max(Horns {
                speed: now.abs() / f64::from(channel.speed),
                acceleration: (now - speed).abs() * rate / f64::from(channel.acceleration),
                degrees_a_second: now.abs(),
            });

            let heard = hardware.heard(index);
            let before = std::mem::replace(&mut self.heard[index], heard);
            let Some(heard) = heard else { continue };
            let [first, last] = channel.command.map(f64::from);
            let resolution = hardware.resolution(index);
            let [low, high] = channel.range.map(f64::from);
            let fastest = if ready { channel.speed } else { channel.speed.min(robot.creep) };
            let most = f64::from(fastest) / rate * (last - first) / (high - low) + 1.5 * resolution;
            let outside = heard < first - 1e-6 || heard > last + 1e-6;
            let jumped = before.is_some_and(|before| (heard - before).abs() > most);
            violations += u64::from(outside || jumped);
        }
        violations
    }
}
