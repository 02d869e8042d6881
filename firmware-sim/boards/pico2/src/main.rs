//! A robot on a Raspberry Pi Pico 2.
//!
//! | priority | context | what it does |
//! |---|---|---|
//! | highest | alarm interrupt | [`servos`]: a tick of the player, commands over I2C |
//! | below | interrupt executor | [`usb`]: the device link, blobs into flash |
//! | lowest | thread | motions: text and anchors in, servo frames into the line |
//!
//! While the thread thinks, servos go on with what is in the line, or stand. A tick is never delayed by thinking or talking; only flash
//! that is written holds it up, which the link allows while nothing moves.
#![no_std]
#![no_main]

mod enable;
mod flash;
mod i2c;
mod servos;
mod shared;
mod usb;

use cortex_m_rt::entry;
use defmt_rtt as _;
use embassy_executor::InterruptExecutor;
use embassy_rp::flash::Flash;
use embassy_rp::interrupt::{self, InterruptExt, Priority};
use motionette::Model;
use motionette::playback::output::{Gate, Pca9685};
use motionette::playback::{Feeder, Handles, MotionQueue, Robot};
use motionette_link::thread::{self, JobHost, Note};
use motionette_link::{DeviceState, Preset, SharedFlags, Store};
use panic_probe as _;
use static_cell::{ConstStaticCell, StaticCell};

use flash::Slots;
use shared::Shared;

/// The robot: `motionette robot pack ROBOT -o robot.bin`.
const ROBOT: &[u8] = include_bytes!("../robot.bin");
/// Servo channels that the firmware has room for, and frames of a motion (9.8 s, with two more and one place).
const CHANNELS: usize = 16;
const FRAMES: usize = 200;
/// Memory in which motions are made: 49 tokens, text with guidance, 8 anchors (`motionette plan --anchors 8 --rows 24`), or six tracks
/// and obstacles.
const ARENA: usize = 368 * 1024;
/// Words of memory for the conditions of a request, 16 KiB: six joints over the longest motion, 16 of them over the preset's.
const AREA: usize = 4096;
/// Pulses a second.
const PULSES: u16 = 50;

static FLAGS: SharedFlags = SharedFlags::new();
static DEVICE_STATE: Shared<DeviceState<'static, Slots>> = Shared::new();
static LINK: InterruptExecutor = InterruptExecutor::new();

#[embassy_rp::interrupt]
unsafe fn SWI_IRQ_0() {
    // SAFETY: this is the interrupt that the executor was started with.
    unsafe { LINK.on_interrupt() }
}

#[entry]
fn main() -> ! {
    static ROBOT_CELL: StaticCell<Robot> = StaticCell::new();
    static LINE: ConstStaticCell<MotionQueue<CHANNELS, FRAMES>> = ConstStaticCell::new(MotionQueue::new());
    static ARENA_CELL: ConstStaticCell<Arena> = ConstStaticCell::new(Arena([0; ARENA]));
    static AREA_CELL: ConstStaticCell<[u32; AREA]> = ConstStaticCell::new([0; AREA]);

    let peripherals = embassy_rp::init(embassy_rp::config::Config::default());
    let robot = match Robot::open(ROBOT) {
        Ok(robot) => ROBOT_CELL.init(robot),
        Err(error) => {
            defmt::error!("robot.bin: {}", defmt::Debug2Format(&error));
            rest();
        }
    };
    let Ok(Handles { mut feeder, player, control }) = LINE.take().split(robot) else {
        defmt::error!("the robot has more than {} servos", CHANNELS);
        rest();
    };
    defmt::info!("{}: {} servos, {} ticks a second", robot.name.as_str(), robot.channels.len(), robot.tick_rate);

    let bus = i2c::Bus::new(peripherals.I2C0, peripherals.PIN_5, peripherals.PIN_4);
    let Some(enable) = enable::Enable::new(robot.output_enable) else {
        defmt::error!("output_enable: there is no such pin, or it is one of I2C");
        rest();
    };
    // No pulse is given before the link releases the servos.
    servos::start(player, Gate::new(Pca9685::new(bus, 0x40, PULSES), enable));

    let slots = Slots::new(Flash::new_blocking(peripherals.FLASH));
    let store = Store::open(&slots);
    let state = DeviceState::new(robot.name.as_str(), Preset::PICO2, control, &FLAGS, Some(slots), &store);
    let state = state.with_area(AREA_CELL.take());
    // SAFETY: the link's interrupt is not enabled yet.
    unsafe { DEVICE_STATE.set(state) };
    interrupt::SWI_IRQ_0.set_priority(Priority::P3);
    let spawner = LINK.start(interrupt::SWI_IRQ_0);
    match usb::serve(peripherals.USB, store, robot.finish_without_host) {
        Ok(task) => spawner.spawn(task),
        Err(_) => defmt::error!("the link could not be started"),
    }
    think(&mut feeder, &mut ARENA_CELL.take().0)
}

/// Memory on a boundary that the runtime likes.
#[repr(align(16))]
struct Arena([u8; ARENA]);

/// Makes motions with whichever blob is the newest.
fn think(feeder: &mut Feeder<'static, CHANNELS>, arena: &mut [u8]) -> ! {
    let mut jobs = Thread;
    loop {
        let blob = jobs.with(|state| state.blob()).and_then(flash::blob);
        match blob.map(Model::open) {
            None => defmt::warn!("no slot holds a blob: send one with `motionette device send-blob`"),
            Some(Err(error)) => defmt::error!("the blob is refused: {}", defmt::Debug2Format(&error)),
            Some(Ok(model)) => {
                if let Err(error) = thread::run(&model, arena, feeder, &mut jobs) {
                    defmt::error!("the runtime refuses to work: {}", defmt::Debug2Format(&error));
                }
                continue;
            }
        }
        // Until there is one.
        thread::wait_for_another(&mut jobs);
    }
}

/// The thread's side of the device's state.
struct Thread;

impl JobHost for Thread {
    type Storage = Slots;

    fn with<R>(&mut self, work: impl FnOnce(&mut DeviceState<'_, Slots>) -> R) -> R {
        // SAFETY: `Thread` is only used by `think`, in thread mode, and no work uses it again.
        match unsafe { DEVICE_STATE.in_thread(work) } {
            Some(result) => result,
            // It was set before the thread began to think.
            None => rest(),
        }
    }

    fn wait(&mut self) {
        // A servo tick, or the link, wakes it.
        cortex_m::asm::wfi();
    }

    fn note(&mut self, note: Note) {
        match note {
            Note::Proved { tested: true } => defmt::info!("self-test passed"),
            Note::Proved { tested: false } => defmt::warn!("the blob carries no self-test"),
            Note::Unproved => defmt::error!("self-test failed: the robot does not move"),
            Note::Made { frames } => defmt::info!("{} frames made", frames),
            Note::Failed(why) => defmt::warn!("failed: {}", defmt::Debug2Format(&why)),
            Note::DoesNotFit(full) => defmt::warn!("the motion does not fit: {}", full),
        }
    }
}

/// Nothing can be done any more: servos keep what they have.
fn rest() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
