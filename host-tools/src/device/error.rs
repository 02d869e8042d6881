//! What can go wrong between host and device.

use std::io;
use std::time::Duration;

use motionette_link::conditions::Unfit;
use motionette_link::message::{
    ANCHORS, BlobFault, ConditionsFault, Failure, PROTOCOL, Refusal, Start, StartFault, TEXT_BYTES, UpdateFault,
};

/// Why something was not done, or why nobody knows whether it was.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The serial port cannot be opened, or the port's name is none.
    #[error("cannot open the port {port}")]
    Open {
        /// Its name, as given.
        port: String,
        /// What the system said.
        source: io::Error,
    },
    /// The host that the port names cannot be found.
    #[error("cannot find the host of {port}")]
    Resolve {
        /// The port, as given.
        port: String,
        /// What the system said.
        source: io::Error,
    },
    /// The host that the port names does not take the connection.
    #[error("cannot connect to {port}")]
    Connect {
        /// The port, as given.
        port: String,
        /// What the system said.
        source: io::Error,
    },
    /// The line broke.
    #[error("the connection to the device broke")]
    Broken(#[source] io::Error),
    /// No answer to a request, however often it was sent.
    #[error("the device does not answer: sent {attempts} times, waited {:.1} s each", wait.as_secs_f64())]
    Silent {
        /// How often it was sent.
        attempts: u32,
        /// How long each answer was waited for.
        wait: Duration,
        /// Whether the device has answered anything before.
        before: bool,
    },
    /// The device speaks another version of the protocol.
    #[error("the device speaks version {device} of the protocol, these tools speak version {PROTOCOL}: {}", older(*device))]
    Version {
        /// The device's.
        device: u8,
    },
    /// The device refuses.
    #[error("the device refuses: {0}")]
    Refused(Refusal),
    /// The job failed.
    #[error("the device could not do it: {0}")]
    Failed(Failure),
    /// The answer is one to another kind of request.
    #[error("the device gave an answer that does not fit the request, or that these tools do not know")]
    Unexpected,
    /// The device no longer knows of the job.
    #[error("the device does not know what became of request {job}")]
    JobLost {
        /// Id of its request.
        job: u32,
    },
    /// The robot was stopped before the movement's end.
    #[error("the robot was stopped: the movement did not come to its end")]
    Stopped,
    /// The motion is ready and the device does not begin to play it.
    #[error("the motion waits on the device, which does not begin to play it")]
    NotBegun,
    /// Whoever waited does not want to any more.
    #[error("interrupted")]
    Interrupted,
    /// The text does not fit a request.
    #[error("the text has {bytes} bytes, a request takes up to {TEXT_BYTES}")]
    LongText {
        /// Its bytes.
        bytes: usize,
    },
    /// The anchors do not fit a request.
    #[error("{anchors} anchors, a request takes up to {ANCHORS}")]
    ManyAnchors {
        /// How many there are.
        anchors: usize,
    },
    /// Tracks, obstacles, the timeline or the vector of the prompt do not fit a request.
    #[error("{0}")]
    Unfit(Unfit),
}

impl Error {
    /// What to do about it, where that is not plain from the error itself.
    #[must_use]
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Error::Open { source, .. } => match source.kind() {
                io::ErrorKind::NotFound => Some(
                    "is it plugged in, and does no other program hold it? serial ports are /dev/ttyACM0, COM3 and the like",
                ),
                io::ErrorKind::PermissionDenied => Some("serial ports belong to the group dialout (or uucp)"),
                io::ErrorKind::InvalidInput => Some("a port is a serial device or tcp:HOST:PORT"),
                _ => Some("another program may hold the port"),
            },
            Error::Resolve { .. } => Some("check the host's name, or give its address, as in tcp:192.168.1.20:7878"),
            Error::Connect { source, .. } => match source.kind() {
                io::ErrorKind::ConnectionRefused => Some("start the simulator first, or check its port"),
                _ => Some("is the device switched on, and in a network that this machine reaches?"),
            },
            Error::Broken(_) => {
                Some("was the device unplugged or reset? the robot does what its firmware says for a lost host")
            }
            Error::Silent { before: false, .. } => {
                Some("is it the right port and --baud, and does the firmware run the link?")
            }
            Error::Silent { before: true, .. } | Error::JobLost { .. } => {
                Some("`motionette device status` says how it stands")
            }
            Error::Stopped => Some("`motionette device neutral` ends a stop"),
            Error::NotBegun => {
                Some("`motionette device status` says how it stands, `motionette device play` tries again")
            }
            Error::Refused(refusal) => hint_of_refusal(refusal),
            Error::Failed(Failure::NotLinked { .. }) => {
                Some("add the feature to motionette's in the firmware's Cargo.toml and flash it")
            }
            _ => None,
        }
    }
}

/// Which side is to be updated.
const fn older(device: u8) -> &'static str {
    if device < PROTOCOL { "update the device's firmware" } else { "update these tools" }
}

/// What to do about a start that does not go on by itself.
#[must_use]
pub const fn advice_for_start(start: Start) -> Option<&'static str> {
    match start {
        Start::Reading | Start::Creeping | Start::Ready => None,
        Start::Waiting => Some(
            "bring the robot to the start pose that its robot.toml states, stand clear, then `motionette device release`",
        ),
        Start::Refused { why: StartFault::Silent, .. } => {
            Some("check that servo's power, wiring and id; the start goes on by itself when it answers")
        }
        Start::Refused { why: StartFault::OutOfRange { .. }, .. } => Some(
            "turn it into its range by hand, or correct the range in robot.toml; the start goes on by itself when it is inside",
        ),
    }
}

fn hint_of_refusal(refusal: &Refusal) -> Option<&'static str> {
    match refusal {
        Refusal::Session => Some("one host at a time; else the device was reset: begin again"),
        Refusal::Occupied { .. } => {
            Some("wait for its end; `motionette device --take-over` ends it now; stop and status work all the same")
        }
        Refusal::NotReady(start) => advice_for_start(*start),
        Refusal::NotWaiting => Some("`motionette device status` says how its start stands"),
        Refusal::Refinement { .. } => Some("leave the method to the device, or update its firmware"),
        Refusal::Unusable(UpdateFault::Model(BlobFault::Version { found, supported })) if found < supported => Some(
            "lift it with `motionette convert OLD.blob -o NEW.blob`, then bring it with `motionette device send-blob`",
        ),
        Refusal::Unusable(UpdateFault::Model(BlobFault::Version { .. } | BlobFault::Unknown { .. })) => {
            Some("update the device's firmware, or bring a blob that it reads with `motionette device send-blob`")
        }
        Refusal::Update(UpdateFault::Model(BlobFault::Unknown { .. })) => {
            Some("update the device's firmware first; the blob that was active stays so")
        }
        Refusal::Unusable(UpdateFault::Model(BlobFault::NotLinked { .. })) => Some(
            "add the feature to motionette's in the firmware's Cargo.toml and flash it, or bring another blob with `motionette device send-blob`",
        ),
        Refusal::Update(UpdateFault::Model(BlobFault::NotLinked { .. })) => Some(
            "add the feature to motionette's in the firmware's Cargo.toml and flash it; the blob that was active stays so",
        ),
        Refusal::Unusable(_) => Some("`motionette device send-blob` brings another"),
        Refusal::Busy { .. } | Refusal::Moving => Some("wait for its end, or `motionette device stop`"),
        Refusal::Stopped => Some("`motionette device neutral` ends a stop"),
        Refusal::NothingToPlay => Some("`motionette device generate` makes one"),
        Refusal::Transferring { .. } => Some("it ends by itself when its sender is gone"),
        Refusal::NoModel => Some("`motionette device send-blob` brings one"),
        Refusal::Update(_) => Some("the blob that was active stays so"),
        Refusal::Conditions(ConditionsFault::NoArea) => Some(
            "firmware gives its device's state memory for them with `DeviceState::with_area`, and `motionette` its features",
        ),
        Refusal::Conditions(ConditionsFault::Length { .. }) => Some(
            "a position of a track takes 12 bytes: leave out what need not be followed, or give the firmware more memory for them",
        ),
        Refusal::Conditions(ConditionsFault::Format { .. }) => {
            Some("firmware and tools are of different versions: update the older one")
        }
        _ => None,
    }
}
