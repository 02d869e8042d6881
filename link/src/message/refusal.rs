//! Why a request is refused.

use core::fmt;

use embedded_storage::nor_flash::NorFlashErrorKind;
use motionette::blob;
use serde::{Deserialize, Serialize};

use super::{Feature, Refinement, Start};

/// Why a request was not done. Nothing has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The device speaks another version of the protocol.
    Version {
        /// The version it speaks.
        supported: u8,
    },
    /// The session is not the current one: it was closed, the device has started anew, or another host has taken over.
    Session,
    /// A request that a later one has overtaken.
    Stale {
        /// Id of the last request that was handled.
        last: u32,
    },
    /// The body is none that this version knows, or exceeds a limit.
    Malformed,
    /// A job is under way.
    Busy {
        /// Id of its request.
        job: u32,
    },
    /// The body moves.
    Moving,
    /// The body was stopped and must go to the neutral pose first.
    Stopped,
    /// There is no motion to play.
    NothingToPlay,
    /// There is no motion to hold, or none is held.
    NotPlaying,
    /// A blob is being transferred.
    Transferring {
        /// Bytes that have come.
        next: u32,
        /// Bytes of the blob.
        length: u32,
    },
    /// No slot holds a model.
    NoModel,
    /// The device cannot store blobs.
    NoStorage,
    /// A blob was not taken.
    Update(UpdateFault),
    /// Another host has a session.
    Occupied {
        /// Milliseconds after which its session ends if it says nothing more; `None`: this device waits for it for ever.
        free_in_ms: Option<u32>,
    },
    /// The start of the robot stands so that no motion can begin.
    NotReady(Start),
    /// There is nothing to release.
    NotWaiting,
    /// The device does not know the refinement method.
    Refinement {
        /// Its number.
        found: u8,
    },
    /// The blob in the newest slot is not used: there is no model.
    Unusable(UpdateFault),
    /// Conditions were not taken, or are not there for a request that they belong to.
    Conditions(ConditionsFault),
}

/// Why conditions were not taken, or cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ConditionsFault {
    /// The firmware sets no memory aside for them.
    NoArea,
    /// They do not fit, or are no whole words.
    Length {
        /// Their bytes.
        length: u32,
        /// Most bytes there is room for.
        limit: u32,
    },
    /// None have been sent in this session.
    NotSent,
    /// Bytes are missing.
    Incomplete {
        /// Bytes that have come.
        next: u32,
        /// Bytes of the conditions.
        length: u32,
    },
    /// The bytes that came are not those that were announced; they have been given up.
    Checksum {
        /// CRC-32 of the bytes that came.
        computed: u32,
        /// CRC-32 that was announced.
        announced: u32,
    },
    /// They are not of the format that the device reads; they have been given up.
    Format {
        /// Offset of the bytes that make no sense.
        at: u32,
    },
}

/// Why a blob was not taken. The one that was active stays so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum UpdateFault {
    /// It is empty or does not fit a slot.
    Length {
        /// Its bytes.
        length: u32,
        /// Most bytes there is room for.
        limit: u32,
    },
    /// No transfer is under way.
    NoTransfer,
    /// Bytes are missing.
    Incomplete {
        /// Bytes that have come.
        next: u32,
        /// Bytes of the blob.
        length: u32,
    },
    /// The bytes in flash are not those that were announced.
    Checksum {
        /// CRC-32 of the bytes in flash.
        computed: u32,
        /// CRC-32 that was announced.
        announced: u32,
    },
    /// The runtime refuses the blob.
    Model(BlobFault),
    /// The device cannot run the model: it needs more memory than there is.
    Memory {
        /// Bytes it needs.
        needed: u32,
        /// Bytes there are.
        available: u32,
    },
    /// The flash failed.
    Flash(FlashFault),
    /// The slots do not fit the flash: a mistake in the firmware.
    Layout,
}

/// How flash fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FlashFault {
    /// An access off the flash's granularity.
    NotAligned,
    /// An access outside the flash.
    OutOfBounds,
    /// A failure of the part.
    Device,
    /// What was written does not read back.
    ReadBack,
}

impl From<NorFlashErrorKind> for FlashFault {
    fn from(kind: NorFlashErrorKind) -> Self {
        match kind {
            NorFlashErrorKind::NotAligned => FlashFault::NotAligned,
            NorFlashErrorKind::OutOfBounds => FlashFault::OutOfBounds,
            _ => FlashFault::Device,
        }
    }
}

/// [`blob::Error`] on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum BlobFault {
    /// The slot is not aligned: a mistake in the firmware.
    Misaligned {
        /// Address modulo [`blob::ALIGNMENT`].
        remainder: u8,
    },
    /// Shorter than its header says.
    Truncated {
        /// Bytes that are needed.
        needed: u32,
        /// Bytes that are there.
        available: u32,
    },
    /// No motionette blob.
    NotABlob,
    /// Another major format version.
    Version {
        /// Of the blob.
        found: u16,
        /// Of the device.
        supported: u16,
    },
    /// The blob's own checksum does not match.
    Checksum,
    /// A value of its configuration is out of its limits.
    Config {
        /// The value.
        found: u32,
        /// The largest, or only, value allowed.
        limit: u32,
    },
    /// A tensor is missing, misplaced, or holds what it may not.
    Tensor {
        /// Index in the tensor table.
        index: u16,
    },
    /// Header or manifest make no sense.
    Structure,
    /// A section of its manifest is of a kind that the device does not know.
    Unknown {
        /// Format version of the blob, major: a device that reads it knows the kind.
        major: u16,
        /// The same, minor.
        minor: u16,
    },
    /// It needs a family that was left out of the device's firmware.
    NotLinked {
        /// The cargo feature that links it.
        feature: Feature,
    },
}

impl From<blob::Error> for BlobFault {
    fn from(error: blob::Error) -> Self {
        match error {
            blob::Error::Misaligned { remainder } => BlobFault::Misaligned { remainder },
            blob::Error::Truncated { needed, available } => BlobFault::Truncated { needed, available },
            blob::Error::NotABlob { .. } => BlobFault::NotABlob,
            blob::Error::Version { found, supported } => BlobFault::Version { found, supported },
            blob::Error::Checksum { .. } => BlobFault::Checksum,
            blob::Error::Config { found, limit, .. } => BlobFault::Config { found, limit },
            blob::Error::TensorRange { index }
            | blob::Error::TensorShape { index, .. }
            | blob::Error::TensorMissing { index }
            | blob::Error::TensorValue { index, .. }
            | blob::Error::Unbounded { index } => BlobFault::Tensor { index },
            // Of another major version nothing behind the header is read.
            blob::Error::Unknown { minor, .. } => BlobFault::Unknown { major: blob::MAJOR, minor },
            blob::Error::NotLinked { feature } => BlobFault::NotLinked { feature: Feature::new(feature) },
            _ => BlobFault::Structure,
        }
    }
}

impl From<ConditionsFault> for Refusal {
    fn from(fault: ConditionsFault) -> Self {
        Refusal::Conditions(fault)
    }
}

impl From<UpdateFault> for Refusal {
    fn from(fault: UpdateFault) -> Self {
        Refusal::Update(fault)
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Refusal::Version { supported } => write!(f, "the device speaks version {supported} of the protocol"),
            Refusal::Session => {
                write!(f, "this session is over: the device has started anew, or talks to another host")
            }
            Refusal::Stale { last } => write!(f, "the request came after a later one (number {last})"),
            Refusal::Malformed => write!(f, "the device does not understand the request, or it exceeds a limit"),
            Refusal::Busy { job } => write!(f, "the device works on request {job}"),
            Refusal::Moving => write!(f, "the robot moves"),
            Refusal::Stopped => write!(f, "the robot was stopped"),
            Refusal::NothingToPlay => write!(f, "there is no motion to play"),
            Refusal::NotPlaying => write!(f, "there is no motion to hold or to go on with"),
            Refusal::Transferring { next, length } => {
                write!(f, "a blob is being transferred, {next} of {length} bytes have come")
            }
            Refusal::NoModel => write!(f, "the device has no model"),
            Refusal::NoStorage => write!(f, "the device cannot store blobs"),
            Refusal::Update(fault) => fault.fmt(f),
            Refusal::Occupied { free_in_ms: Some(ms) } => {
                write!(f, "another host has the robot, for {} s more if it falls silent now", ms.div_ceil(1000))
            }
            Refusal::Occupied { free_in_ms: None } => {
                write!(f, "another host has the robot, and this device does not watch whether it is silent")
            }
            Refusal::NotReady(start) => start.fmt(f),
            Refusal::NotWaiting => write!(f, "the robot does not wait for a release"),
            Refusal::Refinement { found } => {
                write!(f, "the device does not know refinement method {found}, only 0 to {}", Refinement::EXACT.0)
            }
            Refusal::Unusable(fault) => write!(f, "the device has no model that it can use: {fault}"),
            Refusal::Conditions(fault) => fault.fmt(f),
        }
    }
}

impl core::error::Error for Refusal {}

impl fmt::Display for ConditionsFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ConditionsFault::NoArea => {
                write!(
                    f,
                    "the device's firmware sets no memory aside for tracks, obstacles, timelines and vectors of prompts"
                )
            }
            ConditionsFault::Length { length, limit } => {
                write!(f, "conditions of {length} bytes, the device takes up to {limit}, a multiple of four")
            }
            ConditionsFault::NotSent => write!(f, "no conditions have been sent for the request"),
            ConditionsFault::Incomplete { next, length } => {
                write!(f, "only {next} of {length} bytes of the request's conditions have come")
            }
            ConditionsFault::Checksum { computed, announced } => write!(
                f,
                "the conditions that came have CRC-32 {computed:08x}, announced was {announced:08x}: send them again"
            ),
            ConditionsFault::Format { at } => {
                write!(f, "the conditions make no sense to the device at byte {at}")
            }
        }
    }
}

impl core::error::Error for ConditionsFault {}

impl fmt::Display for UpdateFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            UpdateFault::Length { length, limit } => {
                write!(f, "a blob of {length} bytes does not fit, a slot holds 1 to {limit}")
            }
            UpdateFault::NoTransfer => write!(f, "no transfer is under way"),
            UpdateFault::Incomplete { next, length } => write!(f, "only {next} of {length} bytes have come"),
            UpdateFault::Checksum { computed, announced } => {
                write!(f, "the bytes in flash have CRC-32 {computed:08x}, announced was {announced:08x}")
            }
            UpdateFault::Model(fault) => fault.fmt(f),
            UpdateFault::Memory { needed, available } => {
                write!(f, "the model needs {needed} bytes of memory, the device has {available}")
            }
            UpdateFault::Flash(fault) => fault.fmt(f),
            UpdateFault::Layout => write!(f, "the firmware's slots do not fit its flash"),
        }
    }
}

impl core::error::Error for UpdateFault {}

impl fmt::Display for FlashFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = match self {
            FlashFault::NotAligned => "an access off its granularity",
            FlashFault::OutOfBounds => "an access beyond its end",
            FlashFault::Device => "a failure of the part",
            FlashFault::ReadBack => "what was written does not read back",
        };
        write!(f, "the device's flash failed: {what}")
    }
}

impl fmt::Display for BlobFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the device refuses the blob: ")?;
        match self {
            BlobFault::Misaligned { remainder } => {
                write!(f, "its slot begins {remainder} bytes off a {}-byte boundary", blob::ALIGNMENT)
            }
            BlobFault::Truncated { needed, available } => write!(f, "{available} of {needed} bytes are there"),
            BlobFault::NotABlob => write!(f, "it is no motionette blob"),
            BlobFault::Version { found, supported } => {
                write!(f, "its format is version {found}, the device reads version {supported}")
            }
            BlobFault::Checksum => write!(f, "its checksum does not match"),
            BlobFault::Config { found, limit } => write!(f, "it is configured for {found}, allowed is {limit}"),
            BlobFault::Tensor { index } => write!(f, "tensor {index} is not usable"),
            BlobFault::Structure => write!(f, "its header or manifest makes no sense"),
            BlobFault::Unknown { major, minor } => {
                write!(
                    f,
                    "it holds what the device does not know, which needs firmware that reads format {major}.{minor}"
                )
            }
            BlobFault::NotLinked { feature } => write!(
                f,
                "it needs `{feature}`, which the device's firmware was built without: build it with that cargo feature"
            ),
        }
    }
}
