//! What a player is told and what it tells, from any context, without locks.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use super::start::Start;

/// What a player does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum State {
    /// It stands, or slows down to stand, where it is.
    #[default]
    Holding,
    /// It plays a motion.
    Playing,
    /// It plays a motion whose next frame has not come in time, and waits for it.
    Starved,
    /// It goes to its neutral angles.
    Returning,
    /// It stands at its neutral angles.
    Neutral,
    /// It slows down after an emergency stop.
    Stopping,
    /// It stands after an emergency stop, until it is told to go on.
    Stopped,
}

impl State {
    const ALL: [State; 7] = [
        State::Holding,
        State::Playing,
        State::Starved,
        State::Returning,
        State::Neutral,
        State::Stopping,
        State::Stopped,
    ];
}

/// What a player is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wish {
    Run,
    Hold,
    Neutral,
    Stop,
}

/// What a player has counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// What it does.
    pub state: State,
    /// How its start stands.
    pub start: Start,
    /// Ticks since it was made.
    pub ticks: u32,
    /// Motions that it has begun.
    pub motions: u32,
    /// Of these, played to their end.
    pub finished: u32,
    /// Frames taken from the queue.
    pub frames: u32,
    /// Ticks in which a frame had not come in time.
    pub starved: u32,
    /// Ticks in which some servo could not be where the motion wanted it, because of its speed or acceleration.
    pub limited: u32,
}

/// Orders for a player and its answers. All of it may be used from interrupts and threads alike; orders take effect at the next tick.
#[derive(Debug, Default)]
pub struct Control {
    stop: AtomicBool,
    hold: AtomicBool,
    neutral: AtomicBool,
    release: AtomicBool,
    /// Number of the motion that was queued last, and that of the motion before which everything is thrown away.
    queued: AtomicU32,
    cut: AtomicU32,
    state: AtomicU8,
    start: AtomicU32,
    ticks: AtomicU32,
    motions: AtomicU32,
    finished: AtomicU32,
    frames: AtomicU32,
    starved: AtomicU32,
    limited: AtomicU32,
}

impl Control {
    /// Nothing ordered.
    #[must_use]
    pub const fn new() -> Self {
        Control {
            stop: AtomicBool::new(false),
            hold: AtomicBool::new(false),
            neutral: AtomicBool::new(false),
            release: AtomicBool::new(false),
            queued: AtomicU32::new(0),
            cut: AtomicU32::new(0),
            state: AtomicU8::new(State::Holding as u8),
            start: AtomicU32::new(Start::Reading.to_bits()),
            ticks: AtomicU32::new(0),
            motions: AtomicU32::new(0),
            finished: AtomicU32::new(0),
            frames: AtomicU32::new(0),
            starved: AtomicU32::new(0),
            limited: AtomicU32::new(0),
        }
    }

    /// Emergency stop: every servo brakes as hard as its acceleration allows and stands; what was queued is thrown away. Stays in force
    /// until [`Control::resume`], whatever else is ordered.
    pub fn stop(&self) {
        self.throw_away();
        self.stop.store(true, Ordering::Release);
    }

    /// The servos brake and stand; the motion waits.
    pub fn hold(&self) {
        self.hold.store(true, Ordering::Release);
    }

    /// The robot returns to its neutral angles; what was queued is thrown away.
    pub fn neutral(&self) {
        self.throw_away();
        self.neutral.store(true, Ordering::Release);
    }

    /// Takes back stop, hold and return: a held motion goes on, the next one can begin. What was queued during a stop or a return is
    /// thrown away.
    pub fn resume(&self) {
        if matches!(self.wish(), Wish::Stop | Wish::Neutral) {
            self.throw_away();
        }
        self.neutral.store(false, Ordering::Release);
        self.hold.store(false, Ordering::Release);
        self.stop.store(false, Ordering::Release);
    }

    /// Lets servos that cannot say where they stand have their first pulses: the robot has been brought to the pose that its
    /// description states for the start. Stays in force, unless they lose their power for so long that nobody knows where they are.
    pub fn release(&self) {
        self.release.store(true, Ordering::Release);
    }

    /// Whether [`Control::release`] was called.
    #[must_use]
    pub fn released(&self) -> bool {
        self.release.load(Ordering::Acquire)
    }

    /// It takes another [`Control::release`].
    pub(super) fn withdraw(&self) {
        self.release.store(false, Ordering::Release);
    }

    /// How the start stands.
    #[must_use]
    pub fn start(&self) -> Start {
        Start::from_bits(self.start.load(Ordering::Acquire))
    }

    /// What the player did last.
    #[must_use]
    pub fn status(&self) -> Status {
        let read = |counter: &AtomicU32| counter.load(Ordering::Acquire);
        let state = usize::from(self.state.load(Ordering::Acquire));
        Status {
            state: State::ALL.get(state).copied().unwrap_or_default(),
            start: self.start(),
            ticks: read(&self.ticks),
            motions: read(&self.motions),
            finished: read(&self.finished),
            frames: read(&self.frames),
            starved: read(&self.starved),
            limited: read(&self.limited),
        }
    }

    /// Everything queued so far is not to be played, nor is what is still to come of the motion that was begun last.
    pub(super) fn throw_away(&self) {
        self.cut.store(self.queued.load(Ordering::Acquire).wrapping_add(1), Ordering::Release);
    }

    /// Only the feeder says so: the motion of this number is queued from now on.
    pub(super) fn begin(&self, number: u32) {
        self.queued.store(number, Ordering::Release);
    }

    /// Number of the first motion that is not thrown away.
    pub(super) fn cut(&self) -> u32 {
        self.cut.load(Ordering::Acquire)
    }

    pub(super) fn wish(&self) -> Wish {
        if self.stop.load(Ordering::Acquire) {
            Wish::Stop
        } else if self.neutral.load(Ordering::Acquire) {
            Wish::Neutral
        } else if self.hold.load(Ordering::Acquire) {
            Wish::Hold
        } else {
            Wish::Run
        }
    }

    /// Only the player writes these.
    pub(super) fn publish(&self, status: &Status) {
        self.state.store(status.state as u8, Ordering::Release);
        self.start.store(status.start.to_bits(), Ordering::Release);
        let counters = [
            (&self.ticks, status.ticks),
            (&self.motions, status.motions),
            (&self.finished, status.finished),
            (&self.frames, status.frames),
            (&self.starved, status.starved),
            (&self.limited, status.limited),
        ];
        for (counter, value) in counters {
            counter.store(value, Ordering::Release);
        }
    }
}
