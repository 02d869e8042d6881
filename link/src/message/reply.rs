//! What a device says.

use motionette::playback;
use motionette::playback::output::BusStatus;
use serde::{Deserialize, Serialize};

use super::{Clearance, Failure, Name, Refusal, Start, Strain, Tracking, Understood, UpdateFault};
use crate::frame::Faults;

/// An answer to a request, or an event that nobody asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// Who answers.
    Hello(Hello),
    /// It is done, or has begun.
    Accepted,
    /// It is not done, and nothing has changed.
    Refused(Refusal),
    /// How things stand.
    Status(Status),
    /// Bytes of a blob, or of conditions, were taken, or not.
    Chunk {
        /// Offset of the byte that is expected next.
        next: u32,
    },
    /// The blob was verified and is the active one from now on.
    Committed(Blob),
    /// Something has happened; the header's id is 0.
    Event(Event),
}

/// Events. One may be lost on the line: [`Status`] tells the same afterwards.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// A motion has been made.
    Ready {
        /// Id of its request.
        job: u32,
        /// Frames of the motion.
        frames: u16,
        /// Mean distance from the anchors, metres.
        control_error: Option<f32>,
        /// What was understood of the prompt, if the device can say.
        understood: Option<Understood>,
        /// What the anchors ask of the motion, if it has some.
        strain: Option<Strain>,
        /// How far it is from its tracks, if it has some.
        tracking: Option<Tracking>,
        /// How far it keeps clear of its obstacles, if it has some.
        clearance: Option<Clearance>,
    },
    /// The motion was played to its end.
    Finished,
    /// A motion could not be made, or a self-test not be run.
    Failed {
        /// Id of its request.
        job: u32,
        /// Why.
        why: Failure,
    },
    /// A self-test has ended.
    SelfTest {
        /// Id of its request.
        job: u32,
        /// Whether the model gave the bits it should; `None`: the blob carries no self-test.
        passed: Option<bool>,
    },
    /// Nothing was heard of the host for too long.
    HostLost(LossAction),
    /// The robot's start has come to another point, or begins anew because servos have lost their power.
    Start(Start),
}

/// What the device did, or is to do, when the host is silent for too long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum LossAction {
    /// The motion goes on to its end.
    Finish,
    /// The device comes to rest where it is.
    Hold,
    /// A transfer was given up.
    Abort,
}

/// Who answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// Version of the crate `motionette-link` on the device.
    pub version: Name,
    /// The robot it is set up as.
    pub preset: Name,
    /// The model; `None` when no slot holds one.
    pub model: Option<ModelInfo>,
    /// The active blob; `None` when it cannot be replaced over the link, or no slot holds one.
    pub blob: Option<Blob>,
    /// A newer blob, which is not used, and why not.
    pub refused: Option<RefusedBlob>,
    /// What the device takes.
    pub limits: DeviceLimits,
}

/// A model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelInfo {
    /// Its name.
    pub name: Name,
    /// Frames a second.
    pub frame_rate: u16,
    /// Frames of the longest motion.
    pub frames: u16,
}

/// A blob in a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Blob {
    /// Slot, 0 or 1.
    pub slot: u8,
    /// How many blobs were made active before, plus one.
    pub sequence: u32,
    /// Bytes.
    pub length: u32,
    /// CRC-32 of all bytes.
    pub crc32: u32,
}

/// A blob that lies whole in its slot and is not used: another firmware wrote it, or it has rotted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedBlob {
    /// The blob, as its slot says.
    pub blob: Blob,
    /// Why it is not used.
    pub why: UpdateFault,
}

/// What a device takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceLimits {
    /// Bytes of a prompt.
    pub text_bytes: u16,
    /// Anchors of a request.
    pub anchors: u8,
    /// Bytes of a chunk.
    pub chunk_bytes: u16,
    /// Bytes of the largest blob; 0: blobs cannot be sent.
    pub blob_bytes: u32,
    /// Bytes of the conditions of a request, [`conditions`](crate::conditions); 0: it takes none.
    pub condition_bytes: u32,
    /// Spans of a timeline; 0: the firmware was built without.
    pub spans: u8,
    /// Silence of the host, milliseconds, after which `on_silence` is done; 0: never.
    pub silence_ms: u32,
    /// What is done then with a motion.
    pub on_silence: LossAction,
}

/// What the body does: [`playback::State`] on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum State {
    /// It stands, or slows down to stand, where it is.
    Holding,
    /// It plays a motion.
    Playing,
    /// It plays a motion whose next frame has not come in time.
    Starved,
    /// It goes to its neutral pose.
    Returning,
    /// It stands in its neutral pose.
    Neutral,
    /// It slows down after an emergency stop.
    Stopping,
    /// It stands after an emergency stop; `Neutral` ends that.
    Stopped,
}

impl From<playback::State> for State {
    fn from(state: playback::State) -> Self {
        match state {
            playback::State::Holding => State::Holding,
            playback::State::Playing => State::Playing,
            playback::State::Starved => State::Starved,
            playback::State::Returning => State::Returning,
            playback::State::Neutral => State::Neutral,
            playback::State::Stopping => State::Stopping,
            playback::State::Stopped => State::Stopped,
        }
    }
}

impl State {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            State::Holding => "holding",
            State::Playing => "playing",
            State::Starved => "starved",
            State::Returning => "returning",
            State::Neutral => "neutral",
            State::Stopping => "stopping",
            State::Stopped => "stopped",
        }
    }

    /// Whether the body moves.
    #[must_use]
    pub const fn moves(self) -> bool {
        matches!(self, State::Playing | State::Starved | State::Returning | State::Stopping)
    }
}

/// What a job is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum JobStage {
    /// Not begun yet.
    Waiting,
    /// Reading the prompt.
    Reading,
    /// Planning tokens.
    Planning,
    /// Bending the motion onto its anchors.
    Refining,
    /// Decoding the motion.
    Decoding,
    /// Running the self-test.
    Testing,
}

impl From<motionette::Stage> for JobStage {
    fn from(stage: motionette::Stage) -> Self {
        match stage {
            motionette::Stage::Reading => JobStage::Reading,
            motionette::Stage::Planning => JobStage::Planning,
            motionette::Stage::Refining => JobStage::Refining,
            motionette::Stage::Decoding => JobStage::Decoding,
        }
    }
}

/// A generation or self-test that is under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Work {
    /// Id of its request.
    pub job: u32,
    /// Stage.
    pub stage: JobStage,
    /// Steps or evaluations begun in this stage.
    pub step: u16,
    /// Steps or evaluations it may take.
    pub steps: u16,
}

/// How the device stands: what a [`Device`](crate::Device) reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Condition {
    /// How the robot's start stands.
    pub start: Start,
    /// What the body does.
    pub state: State,
    /// What is being made.
    pub work: Option<Work>,
    /// Frames of the motion that waits to be played, or of what is left of the one that plays.
    pub frames_queued: u16,
    /// Servo ticks since start.
    pub ticks: u32,
    /// Ticks that came too late or not at all.
    pub missed_ticks: u32,
    /// Ticks for which no frame had come in time.
    pub starved_ticks: u32,
    /// Ticks at which a servo limit changed what the motion asked for.
    pub limited_ticks: u32,
    /// Ticks whose commands did not reach the servos.
    pub bus_faults: u32,
}

impl Condition {
    /// Whether the body moves, or will as soon as its start goes on.
    #[must_use]
    pub const fn moves(&self) -> bool {
        self.state.moves() || matches!(self.start, Start::Creeping)
    }

    /// What a player and its bus report; work, frames and missed ticks are the caller's to say.
    #[must_use]
    pub fn of(player: &playback::Status, bus: &BusStatus) -> Self {
        Condition {
            start: player.start.into(),
            state: player.state.into(),
            work: None,
            frames_queued: 0,
            ticks: player.ticks,
            missed_ticks: 0,
            starved_ticks: player.starved,
            limited_ticks: player.limited,
            bus_faults: bus.failed,
        }
    }
}

/// Who has the session: the one host that may do more than look and stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Owner {
    /// The host that asks.
    You,
    /// Another host.
    Another,
    /// None.
    Nobody,
}

/// A transfer that is under way, or conditions that are staged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transfer {
    /// Offset of the byte that is expected next.
    pub next: u32,
    /// Bytes of the blob, or of the conditions.
    pub length: u32,
}

/// How things stand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Who has the session.
    pub owner: Owner,
    /// The device.
    pub device: Condition,
    /// How the last job ended: `Ready`, `Failed` or `SelfTest`.
    pub outcome: Option<Event>,
    /// A newer blob than the active one, which is not used, and why not.
    pub refused: Option<RefusedBlob>,
    /// The transfer of a blob.
    pub transfer: Option<Transfer>,
    /// The conditions that are staged, whole when all their bytes have come.
    pub staged: Option<Transfer>,
    /// What was done about a silent host since the session's last status.
    pub host_lost: Option<LossAction>,
    /// What the device's receiver skipped of this line.
    pub skipped: Faults,
    /// Replies and events that found no room on their way out.
    pub unsent: u32,
}
