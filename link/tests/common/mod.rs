//! A robot without a body: flash that keeps NOR's rules, jobs that end when the test says so.
#![allow(dead_code)]

pub mod host;

use std::collections::VecDeque;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use motionette_link::conditions::{Conditions, Given};
use motionette_link::message::{
    Clearance, Condition, Event, Failure, Generate, JobStage, Measure, ModelInfo, Refusal, Start, State, Strain,
    Tracking, Understood, UpdateFault, Work, name,
};
use motionette_link::server::{Description, Device, Job, Sink};
use motionette_link::update::{Layout, Slot, Storage, Store};

/// A small blob that the runtime takes, and another one.
pub const BLOB: &[u8] = include_bytes!("../../../tests/corpus/planner.blob");
pub const OTHER: &[u8] = include_bytes!("../../../tests/corpus/anchors.blob");

pub fn crc(bytes: &[u8]) -> u32 {
    !motionette::blob::crc32(!0, bytes)
}

/// Seeded numbers, xorshift64*.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    pub fn below(&mut self, bound: usize) -> usize {
        ((self.bits() >> 32) as usize) % bound
    }

    /// True once in `n` times.
    pub fn once_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    pub fn bytes(&mut self, length: usize) -> Vec<u8> {
        (0..length).map(|_| self.bits() as u8).collect()
    }
}

const SECTOR: usize = 1024;
const SLOT: usize = 16 * SECTOR;

/// NOR flash of two slots that panics when its rules are broken, and loses power when told.
#[derive(Clone)]
#[repr(C, align(16))]
pub struct Flash {
    bytes: [u8; 2 * SLOT],
    /// Words that were written since their sector was erased.
    written: Vec<bool>,
    /// Operations, and after how many of them power is lost.
    pub operations: usize,
    pub power_for: usize,
    /// Bytes of memory the device has for a model.
    pub memory: u32,
    /// What else is wrong with every model.
    pub fault: Option<UpdateFault>,
}

impl Default for Flash {
    fn default() -> Self {
        // What a part holds that nobody has erased yet.
        Flash {
            bytes: [0xA5; 2 * SLOT],
            written: vec![true; 2 * SLOT / Self::WRITE_SIZE],
            operations: 0,
            power_for: usize::MAX,
            memory: 12_000,
            fault: None,
        }
    }
}

impl Flash {
    /// Counts an operation; false when power is lost in its middle.
    fn powered(&mut self) -> Result<bool, NorFlashErrorKind> {
        if self.operations > self.power_for {
            return Err(NorFlashErrorKind::Other);
        }
        self.operations += 1;
        Ok(self.operations <= self.power_for)
    }

    pub fn damage(&mut self, at: usize) {
        self.bytes[at] ^= 0x10;
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        check_read(self, offset, bytes.len())?;
        bytes.copy_from_slice(&self.bytes[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 16;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        check_erase(self, from, to).expect("erasure on sector boundaries");
        let whole = self.powered()?;
        let (from, to) = (from as usize, to as usize);
        // Cut short, the first half is erased, the second keeps its bits.
        let end = if whole { to } else { from + (to - from) / 2 };
        self.bytes[from..end].fill(0xFF);
        self.written[from / Self::WRITE_SIZE..end / Self::WRITE_SIZE].fill(false);
        if whole { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        check_write(self, offset, bytes.len()).expect("writes on word boundaries");
        let whole = self.powered()?;
        let count = if whole { bytes.len() } else { bytes.len() / 2 };
        for (at, &byte) in (offset as usize..).zip(&bytes[..count]) {
            if at.is_multiple_of(Self::WRITE_SIZE) {
                let word = &mut self.written[at / Self::WRITE_SIZE];
                assert!(!*word, "byte {at} is written twice without an erasure");
                *word = true;
            }
            self.bytes[at] &= byte;
        }
        if whole { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }
}

impl Storage for Flash {
    type Flash = Self;

    fn flash(&mut self) -> &mut Self {
        self
    }

    fn layout(&self) -> Layout {
        Layout { offsets: [0, SLOT as u32], length: SLOT as u32 }
    }

    fn mapped(&self, slot: Slot) -> &[u8] {
        &self.bytes[usize::from(slot.index()) * SLOT..][..SLOT]
    }

    fn fits(&self, model: &motionette::Model<'_>) -> Result<(), UpdateFault> {
        let (needed, available) = (model.bytes().len() as u32, self.memory);
        if needed > available {
            return Err(UpdateFault::Memory { needed, available });
        }
        self.fault.map_or(Ok(()), Err)
    }
}

/// A flash in which `blobs` stand in the slots A and B, newest last, whatever they are.
pub fn flash_with(blobs: &[&[u8]]) -> Flash {
    let mut flash = Flash::default();
    for (slot, (blob, sequence)) in blobs.iter().zip(1u32..).enumerate() {
        let mut words = *b"MNTS____________________";
        for (at, word) in [(4, 1), (8, sequence), (12, blob.len() as u32), (16, crc(blob))] {
            words[at..at + 4].copy_from_slice(&u32::to_le_bytes(word));
        }
        let check = crc(&words[..20]);
        words[20..].copy_from_slice(&check.to_le_bytes());
        flash.bytes[slot * SLOT..][..24].copy_from_slice(&words);
        flash.bytes[slot * SLOT + SECTOR..][..blob.len()].copy_from_slice(blob);
    }
    flash
}

/// The robot.
#[derive(Clone)]
pub struct Robot {
    pub flash: Flash,
    pub condition: Condition,
    pub play_when_ready: bool,
    /// A motion waits to go on.
    pub held: bool,
    pub events: VecDeque<Event>,
    /// What was asked of it, in order.
    pub calls: Vec<&'static str>,
    pub last: Option<Generate>,
    pub activations: usize,
    /// Frames of the motions that it makes.
    pub frames: u16,
    /// It has a model.
    pub model: bool,
    /// Ids of all jobs.
    pub jobs: Vec<u32>,
    /// Memory for conditions, and whether there is any.
    pub area: Vec<u32>,
    /// Tracks, obstacles and spans of the job, and numbers of its prompt's vector.
    pub given: [usize; 4],
}

/// Bytes of the robot's memory for conditions.
pub const CONDITION_BYTES: usize = 4096;

/// Conditions as they are sent.
pub fn sent(given: &Given<'_>) -> Vec<u8> {
    let mut bytes = Vec::new();
    given.write(&mut bytes).unwrap();
    assert_eq!(given.bytes(), Ok(bytes.len() as u32));
    bytes
}

impl Default for Robot {
    fn default() -> Self {
        let condition = Condition {
            start: Start::Ready,
            state: State::Holding,
            work: None,
            frames_queued: 0,
            ticks: 7,
            missed_ticks: 0,
            starved_ticks: 0,
            limited_ticks: 0,
            bus_faults: 0,
        };
        Robot {
            flash: Flash::default(),
            condition,
            play_when_ready: false,
            held: false,
            events: VecDeque::new(),
            calls: Vec::new(),
            last: None,
            activations: 0,
            frames: 3,
            model: true,
            jobs: Vec::new(),
            area: vec![0xA5A5_A5A5; CONDITION_BYTES / 4],
            given: [0; 4],
        }
    }
}

/// How the robot says that a motion is ready.
pub fn ready(job: u32, anchored: bool) -> Event {
    Event::Ready {
        job,
        frames: 3,
        control_error: anchored.then_some(0.25),
        understood: Some(Understood { phrase: "person bows".try_into().unwrap(), score: 0.5 }),
        strain: anchored.then_some(Strain { measure: Measure::DISTANCE, value: 0.75, anchor: 2 }),
        tracking: None,
        clearance: None,
    }
}

/// The same of a motion with tracks and obstacles.
pub fn ready_under(job: u32, anchored: bool, [tracks, obstacles, ..]: [usize; 4]) -> Event {
    let mut event = ready(job, anchored);
    if let Event::Ready { tracking, clearance, .. } = &mut event {
        *tracking = (tracks > 0).then_some(Tracking { mean: 0.125, worst: 0.5, track: 1, frame: 7, hurried: 3 });
        *clearance =
            (obstacles > 0).then_some(Clearance { least: -0.25, missing: 0.25, obstacle: 1, joint: 21, frame: 9 });
    }
    event
}

impl Robot {
    fn may_play(&self) -> Result<(), Refusal> {
        match (self.condition.state, self.condition.start) {
            (State::Stopped, _) => Err(Refusal::Stopped),
            (_, start @ (Start::Waiting | Start::Refused { .. })) => Err(Refusal::NotReady(start)),
            _ => Ok(()),
        }
    }

    /// What its own clock does: work goes on, a motion plays on.
    pub fn advance(&mut self) {
        self.condition.ticks += 1;
        if let Some(work) = &mut self.condition.work {
            work.stage = if self.last.is_some() { JobStage::Planning } else { JobStage::Testing };
            work.step += 1;
            if work.step > work.steps {
                let job = work.job;
                self.condition.work = None;
                match self.last.take() {
                    Some(request) => {
                        self.condition.frames_queued = self.frames;
                        self.events.push_back(ready_under(job, !request.anchors.is_empty(), self.given));
                        if self.play_when_ready {
                            self.condition.state = State::Playing;
                        }
                    }
                    None => self.events.push_back(Event::SelfTest { job, passed: Some(true) }),
                }
            }
        }
        match self.condition.state {
            State::Playing if self.condition.frames_queued > 0 => self.condition.frames_queued -= 1,
            State::Playing => {
                self.condition.state = State::Holding;
                self.events.push_back(Event::Finished);
            }
            State::Returning => self.condition.state = State::Neutral,
            _ => {}
        }
    }
}

impl Device for Robot {
    type Storage = Flash;

    fn describe(&self) -> Description {
        let model = self.model.then(|| ModelInfo { name: name("nano"), frame_rate: 20, frames: 196 });
        Description { preset: name("table-top"), model, condition_bytes: 4 * self.area.len() as u32 }
    }

    fn condition(&self) -> Condition {
        self.condition
    }

    fn start(&mut self, job: u32, work: Job<'_>) -> Result<(), Refusal> {
        assert!(self.condition.work.is_none(), "two jobs at once");
        if !self.model {
            return Err(Refusal::NoModel);
        }
        if self.condition.state.moves() {
            return Err(Refusal::Moving);
        }
        if matches!(work, Job::Generate(request) if request.play_when_ready) {
            self.may_play()?;
        }
        self.calls.push("start");
        self.jobs.push(job);
        self.last = match work {
            Job::Generate(request) => Some(request.clone()),
            Job::SelfTest => None,
        };
        self.given = [0; 4];
        if self.last.as_ref().is_some_and(|request| request.conditions) {
            let conditions = Conditions::open(&self.area).expect("whole conditions");
            let keyframes = conditions.keyframes();
            let (tracks, obstacles) = (conditions.tracks(), conditions.obstacles(&keyframes));
            let (spans, numbers) = (conditions.timeline().len(), conditions.vector().map_or(0, <[f32]>::len));
            self.given = [tracks.len(), obstacles.len(), spans, numbers];
        }
        self.play_when_ready = self.last.as_ref().is_some_and(|r| r.play_when_ready);
        self.condition.work = Some(Work { job, stage: JobStage::Waiting, step: 0, steps: 2 });
        Ok(())
    }

    fn play(&mut self) -> Result<(), Refusal> {
        self.may_play()?;
        match self.condition.state {
            state if state.moves() => Err(Refusal::Moving),
            _ if self.condition.frames_queued == 0 => Err(Refusal::NothingToPlay),
            _ => {
                self.calls.push("play");
                self.condition.state = State::Playing;
                Ok(())
            }
        }
    }

    fn stop(&mut self) {
        self.calls.push("stop");
        if let Some(work) = self.condition.work.take() {
            self.last = None;
            self.events.push_back(Event::Failed { job: work.job, why: Failure::Aborted });
        }
        self.condition.state = State::Stopped;
        self.condition.frames_queued = 0;
        self.held = false;
    }

    fn hold(&mut self) -> Result<(), Refusal> {
        self.play_when_ready = false;
        if self.condition.state != State::Playing {
            return Err(Refusal::NotPlaying);
        }
        self.calls.push("hold");
        self.condition.state = State::Holding;
        self.held = true;
        Ok(())
    }

    fn resume(&mut self) -> Result<(), Refusal> {
        if !core::mem::take(&mut self.held) {
            return Err(Refusal::NotPlaying);
        }
        self.calls.push("resume");
        self.condition.state = State::Playing;
        Ok(())
    }

    fn neutral(&mut self) -> Result<(), Refusal> {
        if self.condition.state.moves() {
            return Err(Refusal::Moving);
        }
        self.calls.push("neutral");
        self.condition.state = State::Returning;
        Ok(())
    }

    fn release(&mut self) -> Result<(), Refusal> {
        if self.condition.start != Start::Waiting {
            return Err(Refusal::NotWaiting);
        }
        self.calls.push("release");
        self.condition.start = Start::Creeping;
        Ok(())
    }

    fn event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    fn storage(&mut self) -> Option<&mut Flash> {
        Some(&mut self.flash)
    }

    fn area(&mut self) -> Option<&mut [u32]> {
        let free = self.condition.work.is_none() && !self.area.is_empty();
        free.then_some(&mut self.area[..])
    }

    fn activated(&mut self, store: &Store) {
        let bytes = store.bytes(&self.flash).expect("an active blob");
        motionette::Model::open(bytes).expect("an active blob that opens");
        self.activations += 1;
        self.model = true;
    }
}

/// A line with room without end.
#[derive(Clone, Default)]
pub struct Line(pub Vec<u8>);

impl Sink for Line {
    fn room(&self) -> usize {
        usize::MAX
    }

    fn send(&mut self, frame: &[u8]) {
        self.0.extend_from_slice(frame);
    }
}

/// Bytes as they are, without a length in front.
pub struct Raw<'a>(pub &'a [u8]);

impl serde::Serialize for Raw<'_> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeTuple;
        let mut tuple = serializer.serialize_tuple(self.0.len())?;
        for byte in self.0 {
            tuple.serialize_element(byte)?;
        }
        tuple.end()
    }
}
