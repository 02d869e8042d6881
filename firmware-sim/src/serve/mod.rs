//! The simulated robot behind a TCP port: the device link as on a board, so that hosts can be tried without hardware.
//!
//! The same code runs as on the Pico 2, in the same three places: servo ticks (here a thread in real time, on simulated buses and
//! servos), the link, and the thread that makes motions.

mod hosts;

use std::cell::RefCell;
use std::io::Write;
use std::net::TcpListener;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::Args;
use motionette::Model;
use motionette::playback::output::Runner;
use motionette::playback::{Feeder, Handles, MotionQueue, Player, Robot};
use motionette_host::blob::AlignedBlob;
use motionette_host::robot_file;
use motionette_link::message::LossAction;
use motionette_link::server::Silence;
use motionette_link::thread::{self, JobHost, Note};
use motionette_link::update::blob_in;
use motionette_link::{DeviceState, Preset, Server, SharedFlags, Storage, Store};

use crate::default_model;
use crate::robot::clock::Clock;
use crate::robot::faults::Injector;
use crate::robot::flash::Flash;
use crate::robot::hardware::Hardware;
use crate::robot::simulation::{CHANNELS, FRAMES, wiring};
use hosts::Hosts;

/// Milliseconds without a word from the host after which it counts as gone.
const SILENCE: u32 = 5_000;
/// Bytes of the arena: 49 tokens, text with guidance, 32 anchors, or 8 of them with as much at a time as a Pico 2.
const ARENA: usize = 348 * 1024;
/// Words of memory for tracks, obstacles, timelines and vectors of prompts: all joints over the longest motion.
const AREA: usize = 16 * 1024;

/// Serve the device link of a simulated robot over TCP; `motionette device --port tcp:127.0.0.1:PORT` talks to it.
///
/// Example: motionette-sim serve --port 7878
#[derive(Debug, Args)]
pub struct Cmd {
    /// TCP port on this machine; 0 takes a free one, which is said on the first line.
    #[arg(long, default_value_t = 7878)]
    port: u16,
    /// The robot: a preset or a robot.toml.
    #[arg(long, default_value = "upper-body", value_name = "NAME|FILE")]
    robot: String,
    /// A file that keeps the flash with its two slots, made anew if there is none and refused if it is anything else; without one, the
    /// flash is new each time and holds the built-in model.
    #[arg(long, value_name = "FILE")]
    flash: Option<PathBuf>,
    /// Begin with empty slots instead of the built-in model.
    #[arg(long)]
    empty: bool,
    /// Wait for `motionette device release` where servos cannot say where they stand, as a robot does; else the simulated robot, which
    /// stands where its description says, is released at once.
    #[arg(long)]
    unreleased: bool,
    /// Leave to requests what a Pico 2 would make of them: shorter motions, fewer steps.
    #[arg(long)]
    pico2: bool,
}

impl Cmd {
    /// Serves until the process is ended.
    ///
    /// # Errors
    /// A robot that is refused, a flash file that is none or cannot be written, a port that is taken.
    pub fn run(self) -> Result<()> {
        let robot = robot_file::load(&self.robot).context("reading the robot")?;
        let mut flash = match &self.flash {
            Some(path) => Flash::kept_in(path)?,
            None => Flash::default(),
        };
        if !self.empty && Store::open(&flash).active().is_none() {
            install(&mut flash, default_model::BOARD_BLOB)?;
        }
        // A place that cannot be written is found out now, not when a host has sent its blob.
        flash.keep()?;
        let preset = if self.pico2 { Preset::PICO2 } else { Preset::DESKTOP };
        let listener = TcpListener::bind(("127.0.0.1", self.port))
            .with_context(|| format!("port {} is taken or not allowed: give another --port", self.port))?;
        let port = listener.local_addr()?.port();
        let mut out = std::io::stdout();
        writeln!(out, "{}: motionette device --port tcp:127.0.0.1:{port} status", robot.name)?;
        out.flush()?;
        serve(robot, preset, flash, listener, !self.unreleased)
    }
}

/// Puts `blob` into a slot, as a transfer would.
fn install(flash: &mut Flash, blob: &[u8]) -> Result<()> {
    let mut store = Store::open(flash);
    let crc = !motionette::blob::crc32(!0, blob);
    let failed = |fault| anyhow::anyhow!("the built-in model cannot be put into flash: {fault:?}");
    store.begin(flash, blob.len() as u32, crc).map_err(failed)?;
    for (index, chunk) in blob.chunks(240).enumerate() {
        store.write(flash, 240 * index as u32, chunk).map_err(failed)?;
    }
    store.commit(flash).map_err(failed)?;
    Ok(())
}

type Shared = Arc<Mutex<DeviceState<'static, Flash>>>;

/// The job host's side of the device's state.
struct Thread {
    state: Shared,
}

impl JobHost for Thread {
    type Storage = Flash;

    fn with<R>(&mut self, work: impl FnOnce(&mut DeviceState<'_, Flash>) -> R) -> R {
        work(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn wait(&mut self) {
        std::thread::sleep(Duration::from_millis(2));
    }

    fn note(&mut self, note: Note) {
        say(&match note {
            Note::Proved { tested: true } => "self-test passed".to_owned(),
            Note::Proved { tested: false } => "the blob carries no self-test".to_owned(),
            Note::Unproved => "self-test failed: the robot does not move".to_owned(),
            Note::Made { frames } => format!("{frames} frames made"),
            Note::Failed(why) => format!("failed: {why}"),
            Note::DoesNotFit(full) => format!("the motion cannot be played: {full}"),
        });
    }
}

/// A line of the log. Nobody may listen.
fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Serves until the process ends.
///
/// # Errors
/// When the runtime refuses to work.
fn serve(robot: Robot, preset: Preset, flash: Flash, listener: TcpListener, released: bool) -> Result<()> {
    // They live as long as the process, as in firmware.
    let robot: &'static Robot = Box::leak(Box::new(robot));
    let line: &'static mut MotionQueue<CHANNELS, FRAMES> = Box::leak(Box::default());
    let flags: &'static SharedFlags = Box::leak(Box::default());
    let Handles { mut feeder, player, control } = line.split(robot)?;
    if released {
        control.release();
    }
    let store = Store::open(&flash);
    let state = DeviceState::new(&robot.name, preset, control, flags, Some(flash), &store);
    let state = state.with_area(Box::leak(vec![0; AREA].into_boxed_slice()));
    let state: Shared = Arc::new(Mutex::new(state));

    std::thread::spawn(move || tick(robot, player, flags));
    let link = Arc::clone(&state);
    std::thread::spawn(move || {
        if let Err(error) = talk(listener, &link, store, robot) {
            // Without the link nobody can ask for anything.
            say(&format!("error: the link has failed: {error:#}"));
            std::process::exit(1);
        }
    });
    think(&mut feeder, state)
}

/// Servo ticks in real time.
fn tick(robot: &'static Robot, player: Player<'static, CHANNELS>, flags: &SharedFlags) {
    let clock = Clock::default();
    let hardware = Rc::new(RefCell::new(Hardware::new(robot, 1)));
    let injector = Rc::new(RefCell::new(Injector::new(&[], 1)));
    let mut runner = Runner::new(player, wiring(&hardware, &injector, &clock));
    let period = 1_000_000 / u64::from(robot.tick_rate);
    let started = Instant::now();
    let mut missed = 0;
    for tick in 0u64.. {
        let due = Duration::from_micros(tick * period);
        if let Some(wait) = due.checked_sub(started.elapsed()) {
            std::thread::sleep(wait);
        }
        // The simulated bus takes virtual time; this machine's own delays are not the robot's.
        missed += u32::from(clock.now() > tick * period);
        clock.pass_until(tick * period);
        runner.tick(&mut || clock.now() as u32, (period / 2) as u32);
        hardware.borrow_mut().advance((tick + 1) * period);
        flags.tick(missed, runner.bus());
    }
}

/// Serves all hosts.
fn talk(listener: TcpListener, state: &Shared, store: Store, robot: &Robot) -> Result<()> {
    let action = if robot.finish_without_host { LossAction::Finish } else { LossAction::Hold };
    let mut hosts = Hosts::new(listener, Server::new(store, Silence { after_ms: SILENCE, action }))?;
    loop {
        let mut device = state.lock().unwrap_or_else(PoisonError::into_inner);
        let busy = hosts.serve(&mut *device).context("accepting a host")?;
        drop(device);
        if !busy {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// Makes motions with whichever blob is the newest.
fn think(feeder: &mut Feeder<'static, CHANNELS>, state: Shared) -> Result<()> {
    let mut jobs = Thread { state };
    let mut arena = vec![0u128; ARENA / 16];
    loop {
        let blob = jobs.with(|state| {
            let (slot, length) = state.blob()?;
            blob_in::<Flash>(state.flash()?.mapped(slot), length).map(AlignedBlob::new)
        });
        match blob.as_ref().map(|blob| Model::open(blob.bytes())) {
            Some(Ok(model)) => {
                thread::run(&model, bytemuck::cast_slice_mut(&mut arena), feeder, &mut jobs)?;
                continue;
            }
            Some(Err(error)) => say(&format!("the blob is refused: {error}")),
            None => say("no slot holds a blob: send one with `motionette device send-blob`"),
        }
        thread::wait_for_another(&mut jobs);
    }
}
