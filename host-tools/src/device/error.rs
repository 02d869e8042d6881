//! What can go wrong between host and device.

use std::io;
use std::time::Duration;

use motionette_link::message::{ANCHORS, Failure, PROTOCOL, Refusal, TEXT_BYTES};

/// Why something was not done, or why nobody knows whether it was.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The port cannot be opened.
    #[error("cannot open the port {port}")]
    Open {
        /// Its name, as given.
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
    #[error("the device speaks version {device} of the protocol, these tools speak version {PROTOCOL}")]
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
                io::ErrorKind::ConnectionRefused => Some("start the simulator first, or check its port"),
                _ => Some("another program may hold the port"),
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
            Error::Version { .. } => Some("use tools and firmware of one version"),
            Error::Refused(refusal) => hint_of_refusal(refusal),
            _ => None,
        }
    }
}

fn hint_of_refusal(refusal: &Refusal) -> Option<&'static str> {
    match refusal {
        Refusal::Session => Some("one host at a time; else the device was reset: begin again"),
        Refusal::Busy { .. } | Refusal::Moving => Some("wait for its end, or `motionette device stop`"),
        Refusal::Stopped => Some("`motionette device neutral` ends a stop"),
        Refusal::NothingToPlay => Some("`motionette device generate` makes one"),
        Refusal::Transferring { .. } => Some("it ends by itself when its sender is gone"),
        Refusal::NoModel => Some("`motionette device send-blob` brings one"),
        Refusal::Update(_) => Some("the blob that was active stays so"),
        _ => None,
    }
}
