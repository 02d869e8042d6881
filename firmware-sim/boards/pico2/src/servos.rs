//! The servo tick: an alarm interrupt above everything else.

use core::cell::RefCell;

use critical_section::Mutex;
use embassy_rp::interrupt::{self, InterruptExt, Priority};
use embassy_rp::pac;
use motionette::playback::Player;
use motionette::playback::output::{Gate, Pca9685, Runner};

use crate::enable::Enable;
use crate::i2c::Bus;
use crate::{CHANNELS, FLAGS};

/// Part of a tick in which attempts on the bus may begin.
const BUDGET: u32 = 10_000;
/// The alarm of timer 0 that ticks; the HAL's time driver has the first.
const ALARM: usize = 1;

/// The servos' chip, and the pin that lets it give pulses.
pub type Chip = Gate<Pca9685<Bus>, Enable>;

/// The servos, the alarm's time, and how often it came too late.
struct Ticker {
    runner: Runner<'static, Chip, CHANNELS>,
    period: u32,
    due: u32,
    missed: u32,
}

static TICKER: Mutex<RefCell<Option<Ticker>>> = Mutex::new(RefCell::new(None));

/// A free-running count of microseconds.
pub fn microseconds() -> u32 {
    pac::TIMER0.timerawl().read()
}

/// Begins to tick.
pub fn start(player: Player<'static, CHANNELS>, chip: Chip) {
    let period = 1_000_000 / u32::from(player.tick_rate());
    let due = microseconds().wrapping_add(period);
    let ticker = Ticker { runner: Runner::new(player, chip), period, due, missed: 0 };
    critical_section::with(|cs| {
        TICKER.borrow_ref_mut(cs).replace(ticker);
        pac::TIMER0.inte().modify(|w| w.set_alarm(ALARM, true));
        pac::TIMER0.alarm(ALARM).write_value(due);
    });
    let alarm = interrupt::TIMER0_IRQ_1;
    alarm.set_priority(Priority::P0);
    // SAFETY: the handler takes all it needs from `TICKER`, which is set.
    unsafe { alarm.enable() };
}

#[embassy_rp::interrupt]
fn TIMER0_IRQ_1() {
    pac::TIMER0.intr().write(|w| w.set_alarm(ALARM, true));
    critical_section::with(|cs| {
        let mut ticker = TICKER.borrow_ref_mut(cs);
        let Some(ticker) = ticker.as_mut() else { return };
        let ticked = ticker.runner.tick(&mut microseconds, BUDGET);
        if let Some(error) = ticked.failed {
            defmt::warn!("servos hold: {}", defmt::Debug2Format(&error));
        }
        // The next tick that can still be met; those in between are missed.
        loop {
            ticker.due = ticker.due.wrapping_add(ticker.period);
            if ticker.due.wrapping_sub(microseconds()) <= ticker.period {
                break;
            }
            ticker.missed = ticker.missed.wrapping_add(1);
        }
        FLAGS.tick(ticker.missed, ticker.runner.bus());
        pac::TIMER0.alarm(ALARM).write_value(ticker.due);
    });
}
