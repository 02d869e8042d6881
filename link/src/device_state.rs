//! A [`Device`] made of what the runtime has: a playback line, and a thread that makes motions.
//!
//! The board and the simulator run this same code. It belongs to whoever serves the link; the thread that makes motions borrows it now
//! and then, for as long as a few assignments take: it takes a [`Task`], reports how far it is, and says how it ended. On a board both
//! do so in a critical section.
//!
//! While the thread thinks, servos stand at neutral, or play what was queued before: a motion is copied into the line when it begins to
//! play, so the next one can be made meanwhile.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use heapless::Deque;
use motionette::Planning;
use motionette::playback::output::BusStatus;
use motionette::playback::{self, Control};
use motionette::{Model, ROWS};

use crate::message::{
    Condition, ConditionsFault, Event, Failure, Generate, JobStage, Length, ModelInfo, Name, Refinement, Refusal,
    Start, State, Work, name,
};
use crate::server::{Description, Device, Job};
use crate::update::{Slot, Storage, Store};

/// Events that wait to be sent, at most; of more, the oldest are dropped, and the status tells how things stand.
const EVENTS: usize = 8;

/// What contexts tell each other without locks: whether work is to be given up, and what the servo tick counts.
#[derive(Debug, Default)]
pub struct SharedFlags {
    /// Set by an emergency stop; observers of the generator abort when it is.
    abort: AtomicBool,
    missed: AtomicU32,
    failed: AtomicU32,
}

impl SharedFlags {
    /// All well.
    #[must_use]
    pub const fn new() -> Self {
        SharedFlags { abort: AtomicBool::new(false), missed: AtomicU32::new(0), failed: AtomicU32::new(0) }
    }

    /// Whether whoever makes motions is to give up.
    #[must_use]
    pub fn aborted(&self) -> bool {
        self.abort.load(Ordering::Acquire)
    }

    /// Notes what the servo tick has counted: ticks that came too late, and what its bus says.
    pub fn tick(&self, missed: u32, bus: &BusStatus) {
        self.missed.store(missed, Ordering::Release);
        self.failed.store(bus.failed, Ordering::Release);
    }
}

/// What a device makes when a request leaves it to the device: what its processor manages in a time that people wait.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preset {
    /// Frames of a motion whose length is not said.
    pub frames: u16,
    /// Steps of the planner.
    pub steps: u16,
    /// Decoder evaluations of a refinement that is asked for by name and needs them.
    pub evaluations: u16,
    /// Rows that pass through a layer at a time, for which the generator's arena MUST have room
    /// ([`Generator::set_rows`](motionette::Generator::set_rows)).
    pub rows: usize,
}

impl Preset {
    /// Of a desktop: the runtime's own defaults, and lengths as the text suggests.
    pub const DESKTOP: Preset = Preset { frames: 0, steps: Planning::DEFAULT.steps, evaluations: 20, rows: ROWS };
    /// Of a Raspberry Pi Pico 2, 150 MHz: 4 s of motion; much at a time, since the memory is there and flash is slow.
    pub const PICO2: Preset = Preset { frames: 80, steps: 5, evaluations: 10, rows: 24 };

    /// `request` with what it leaves open.
    fn fill(&self, request: &Generate) -> Generate {
        let mut request = request.clone();
        if request.length == Length::Predicted && self.frames > 0 {
            request.length = Length::Frames(self.frames);
        }
        if request.steps == 0 {
            request.steps = self.steps;
        }
        if request.refinement == Refinement::DEVICE {
            request.refinement = Refinement::EXACT;
        }
        // The edit needs none: 0 of them are as good as meant.
        if request.evaluations == 0 && !request.refinement.edits() {
            request.evaluations = self.evaluations;
        }
        request
    }
}

/// What the thread is to do next.
// Lives on the thread's stack while it is worked on.
#[allow(clippy::large_enum_variant)]
#[derive(Debug, PartialEq)]
pub enum Task {
    /// Make a motion.
    Generate {
        /// Id of the request.
        job: u32,
        /// The request.
        request: Generate,
        /// The memory in which its conditions lie, if it has some: the thread's until [`DeviceState::returned`].
        area: Option<Area>,
    },
    /// Run the blob's self-test.
    SelfTest {
        /// Id of the request.
        job: u32,
    },
    /// Put the motion that was made into the line.
    Play,
    /// Open the blob anew: another one is active.
    Reopen,
}

/// Memory for conditions, words of 32 bits. Link and thread hand it to each other; a board's lives for ever.
pub type Area = &'static mut [u32];

/// What was ordered, and the tick before which the player cannot have heard of it.
#[derive(Debug, Clone, Copy)]
struct Ordered {
    state: State,
    ticks: u32,
}

/// The device's state between link and thread.
#[derive(Debug)]
pub struct DeviceState<'a, S> {
    robot: Name,
    preset: Preset,
    control: &'a Control,
    flags: &'a SharedFlags,
    storage: Option<S>,
    /// The memory for conditions, unless the thread has it.
    area: Option<Area>,
    /// Its bytes.
    condition_bytes: u32,
    /// Where the active blob lies, and its bytes.
    blob: Option<(Slot, usize)>,
    model: Option<ModelInfo>,
    work: Option<Work>,
    waiting: Option<Task>,
    /// Frames of the motion that can be played.
    ready: Option<u16>,
    /// The motion is on its way into the line.
    playing: bool,
    /// The job's motion is to be played by itself.
    play_when_ready: bool,
    reopen: bool,
    stopped: bool,
    held: bool,
    ordered: Option<Ordered>,
    queued: u16,
    finished: u32,
    /// What was last said of the start.
    start: Start,
    /// What has happened and not been sent.
    events: Deque<Event, EVENTS>,
}

impl<'a, S> DeviceState<'a, S> {
    /// A robot of that name whose blobs lie in `storage` as `store` says; the thread has not opened one yet.
    #[must_use]
    pub fn new(
        robot: &str,
        preset: Preset,
        control: &'a Control,
        flags: &'a SharedFlags,
        storage: Option<S>,
        store: &Store,
    ) -> Self {
        DeviceState {
            robot: name(robot),
            preset,
            control,
            flags,
            storage,
            area: None,
            condition_bytes: 0,
            blob: store.place(),
            model: None,
            work: None,
            waiting: None,
            ready: None,
            playing: false,
            play_when_ready: false,
            reopen: false,
            stopped: false,
            held: false,
            ordered: None,
            queued: 0,
            finished: control.status().finished,
            start: control.start().into(),
            events: Deque::new(),
        }
    }

    /// The same with memory for the conditions of requests; without, all that have some are refused.
    #[must_use]
    pub fn with_area(self, area: Area) -> Self {
        let condition_bytes = u32::try_from(size_of_val(&*area)).unwrap_or(u32::MAX);
        DeviceState { area: Some(area), condition_bytes, ..self }
    }

    /// For the thread: where the active blob lies, which has been verified, and its bytes; see [`blob_in`](crate::update::blob_in).
    #[must_use]
    pub const fn blob(&self) -> Option<(Slot, usize)> {
        self.blob
    }

    /// For the thread: how much it is to pass through a layer at a time.
    pub(crate) const fn rows(&self) -> usize {
        self.preset.rows
    }

    /// The flash.
    pub const fn flash(&mut self) -> Option<&mut S> {
        self.storage.as_mut()
    }

    /// For the thread: what to do next. What it is working on is over with [`DeviceState::done`].
    pub fn task(&mut self) -> Option<Task> {
        if core::mem::take(&mut self.reopen) {
            return Some(Task::Reopen);
        }
        if self.playing && self.ready.is_some() {
            return Some(Task::Play);
        }
        self.waiting.take()
    }

    /// For the thread: whether to give up what it works on.
    #[must_use]
    pub fn aborted(&self) -> bool {
        self.flags.aborted()
    }

    /// For the thread: the model that was opened and has proved itself.
    pub fn opened(&mut self, model: &Model<'_>) {
        self.model = Some(ModelInfo {
            name: name(model.card().name),
            frame_rate: model.frame_rate(),
            frames: (model.max_tokens() * model.frames_per_token()) as u16,
        });
    }

    /// For the thread: how far the job is.
    pub const fn progress(&mut self, stage: JobStage, step: u16, steps: u16) {
        if let Some(work) = &mut self.work {
            work.stage = stage;
            work.step = step;
            work.steps = steps;
        }
    }

    /// For the thread: it reads the conditions no more, and returns their memory. MUST come before [`DeviceState::done`].
    pub const fn returned(&mut self, area: Area) {
        self.area = Some(area);
    }

    /// For the thread: how the job ended.
    pub fn done(&mut self, event: Event) {
        self.work = None;
        match event {
            Event::Ready { job, .. } if self.flags.aborted() => self.tell(Event::Failed { job, why: Failure::Aborted }),
            Event::Ready { frames, .. } => {
                self.ready = Some(frames);
                self.playing = self.play_when_ready && !self.stopped;
                if self.playing {
                    self.begin();
                }
                self.tell(event);
            }
            _ => self.tell(event),
        }
        self.play_when_ready = false;
    }

    /// For the thread: the motion is in the line, or will never be.
    pub fn played(&mut self) {
        self.playing = false;
        if self.waiting.is_some() {
            // Its memory is the next one's.
            self.ready = None;
        }
    }

    /// How many frames wait in the line.
    pub const fn queued(&mut self, frames: usize) {
        self.queued = if frames > u16::MAX as usize { u16::MAX } else { frames as u16 };
    }

    fn tell(&mut self, event: Event) {
        if self.events.is_full() {
            let _ = self.events.pop_front();
        }
        let _ = self.events.push_back(event);
    }

    /// Orders are taken back so that a motion can begin.
    fn begin(&mut self) {
        self.held = false;
        self.control.resume();
        self.order(State::Playing);
    }

    fn order(&mut self, state: State) {
        self.ordered = Some(Ordered { state, ticks: self.control.status().ticks });
    }

    /// Whether a motion may begin, as far as stop and start are concerned.
    fn may_play(&self) -> Result<(), Refusal> {
        if self.stopped {
            return Err(Refusal::Stopped);
        }
        match self.control.start().into() {
            Start::Reading | Start::Creeping | Start::Ready => Ok(()),
            start @ (Start::Waiting | Start::Refused { .. }) => Err(Refusal::NotReady(start)),
        }
    }

    /// What the body does, or will do as soon as the player hears of it.
    fn state(&self) -> State {
        let status = self.control.status();
        let state = State::from(status.state);
        if self.stopped {
            return if state == State::Stopped { state } else { State::Stopping };
        }
        match self.ordered {
            // One tick may have been under way when the order came.
            Some(Ordered { state, ticks }) if self.playing || status.ticks.wrapping_sub(ticks) < 2 => state,
            _ => state,
        }
    }
}

impl<S: Storage> Device for DeviceState<'_, S> {
    type Storage = S;

    fn describe(&self) -> Description {
        Description { preset: self.robot.clone(), model: self.model.clone(), condition_bytes: self.condition_bytes }
    }

    fn condition(&self) -> Condition {
        let status: playback::Status = self.control.status();
        let waiting = if self.state().moves() { self.queued } else { self.ready.unwrap_or(0) };
        Condition {
            state: self.state(),
            work: self.work,
            frames_queued: waiting,
            missed_ticks: self.flags.missed.load(Ordering::Acquire),
            bus_faults: self.flags.failed.load(Ordering::Acquire),
            ..Condition::of(&status, &BusStatus::default())
        }
    }

    fn start(&mut self, job: u32, work: Job<'_>) -> Result<(), Refusal> {
        if self.model.is_none() {
            return Err(Refusal::NoModel);
        }
        if matches!(work, Job::Generate(request) if request.play_when_ready) {
            self.may_play()?;
        }
        let conditioned = matches!(work, Job::Generate(request) if request.conditions);
        if conditioned && self.area.is_none() {
            return Err(Refusal::Conditions(ConditionsFault::NoArea));
        }
        self.flags.abort.store(false, Ordering::Release);
        if !self.playing {
            self.ready = None;
        }
        self.work = Some(Work { job, stage: JobStage::Waiting, step: 0, steps: 0 });
        self.waiting = Some(match work {
            Job::Generate(request) => {
                self.play_when_ready = request.play_when_ready;
                let area = if conditioned { self.area.take() } else { None };
                Task::Generate { job, request: self.preset.fill(request), area }
            }
            Job::SelfTest => Task::SelfTest { job },
        });
        Ok(())
    }

    fn play(&mut self) -> Result<(), Refusal> {
        self.may_play()?;
        if self.ready.is_none() {
            return Err(Refusal::NothingToPlay);
        }
        if self.state().moves() {
            return Err(Refusal::Moving);
        }
        self.playing = true;
        self.begin();
        Ok(())
    }

    fn stop(&mut self) {
        self.control.stop();
        self.flags.abort.store(true, Ordering::Release);
        // The thread has not seen it and never will.
        let unseen = match self.waiting.take() {
            Some(Task::Generate { job, area, .. }) => {
                if area.is_some() {
                    self.area = area;
                }
                Some(job)
            }
            Some(Task::SelfTest { job }) => Some(job),
            _ => None,
        };
        if let (Some(job), Some(_)) = (unseen, self.work) {
            self.work = None;
            self.tell(Event::Failed { job, why: Failure::Aborted });
        }
        (self.stopped, self.held, self.playing, self.play_when_ready) = (true, false, false, false);
    }

    fn hold(&mut self) -> Result<(), Refusal> {
        let waits = core::mem::take(&mut self.play_when_ready);
        if self.stopped || !(self.state().moves() || waits) {
            return Err(Refusal::NotPlaying);
        }
        if self.state().moves() {
            self.control.hold();
            self.held = true;
            self.order(State::Holding);
        }
        Ok(())
    }

    fn resume(&mut self) -> Result<(), Refusal> {
        if self.stopped {
            return Err(Refusal::Stopped);
        }
        if !core::mem::take(&mut self.held) {
            return Err(Refusal::NotPlaying);
        }
        self.begin();
        Ok(())
    }

    fn neutral(&mut self) -> Result<(), Refusal> {
        if !self.stopped && self.state().moves() {
            return Err(Refusal::Moving);
        }
        (self.stopped, self.held) = (false, false);
        self.control.resume();
        self.control.neutral();
        self.order(State::Returning);
        Ok(())
    }

    fn release(&mut self) -> Result<(), Refusal> {
        if self.stopped {
            return Err(Refusal::Stopped);
        }
        if self.control.start() != playback::Start::Waiting {
            return Err(Refusal::NotWaiting);
        }
        self.control.release();
        Ok(())
    }

    fn event(&mut self) -> Option<Event> {
        let finished = self.control.status().finished;
        if finished != self.finished {
            self.finished = finished;
            return Some(Event::Finished);
        }
        let start = Start::from(self.control.start());
        if !start.is_as(self.start) {
            self.start = start;
            return Some(Event::Start(start));
        }
        self.events.pop_front()
    }

    fn storage(&mut self) -> Option<&mut S> {
        self.storage.as_mut()
    }

    fn area(&mut self) -> Option<&mut [u32]> {
        self.area.as_deref_mut()
    }

    fn activated(&mut self, store: &Store) {
        self.blob = store.place();
        self.reopen = true;
        // Nothing is made or played before the new one has proved itself.
        (self.model, self.ready) = (None, None);
    }
}
