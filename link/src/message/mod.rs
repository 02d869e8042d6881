//! Messages: requests, replies, events and refusals.
//!
//! A message is a [`Header`] and a body: [`Command`] from the host, [`Reply`] from the device. The order of fields and of
//! variants is the wire format; new variants go to the end.

mod anchor;
mod command;
mod failure;
mod fault;
mod feature;
mod made;
mod obstacle_fault;
mod prompt_fault;
mod refinement;
mod refusal;
mod reply;
mod start;
mod timeline_fault;
mod track_fault;

pub use anchor::{Anchor, Target};
pub use command::{Command, Generate, Length};
pub use failure::Failure;
pub use feature::Feature;
pub use made::{Clearance, Measure, Phrase, Strain, Tracking, Understood};
pub use obstacle_fault::ObstacleFault;
pub use prompt_fault::PromptFault;
pub use refinement::Refinement;
pub use refusal::{BlobFault, ConditionsFault, FlashFault, Refusal, UpdateFault};
pub use reply::{
    Blob, Condition, DeviceLimits, Event, Hello, JobStage, LossAction, ModelInfo, Owner, RefusedBlob, Reply, State,
    Status, Transfer, Work,
};
pub use start::{Start, StartFault};
pub use timeline_fault::TimelineFault;
pub use track_fault::TrackFault;

use serde::{Deserialize, Serialize};

use crate::frame::{CRC_BYTES, frame_bytes};

/// Version of the protocol, below 128. Readers refuse other versions and name their own.
pub const PROTOCOL: u8 = 4;
/// Set in the version of what a device sends, so that an echo on the line is no request.
pub const FROM_DEVICE: u8 = 0x80;
/// Longest prompt, of a request or of a span, bytes of UTF-8.
pub const TEXT_BYTES: usize = 192;
/// Most anchors of a request.
pub const ANCHORS: usize = motionette::MAX_ANCHORS;
/// Most bytes of a blob, or of conditions, in one message.
pub const CHUNK_BYTES: usize = 240;
/// Longest name, bytes of UTF-8.
pub const NAME_BYTES: usize = 32;
/// Longest phrase in which a device says what it understood, bytes of UTF-8.
pub const PHRASE_BYTES: usize = 64;
/// Longest name of a cargo feature, bytes of UTF-8.
pub const FEATURE_BYTES: usize = 24;
/// Bytes of the longest request with its checksum.
pub const REQUEST_BYTES: usize = 832 + CRC_BYTES;
/// Bytes of the longest reply with its checksum.
pub const REPLY_BYTES: usize = 288 + CRC_BYTES;
/// Bytes of the longest frame from the host.
pub const REQUEST_FRAME: usize = frame_bytes(REQUEST_BYTES);
/// Bytes of the longest frame from the device.
pub const REPLY_FRAME: usize = frame_bytes(REPLY_BYTES);

/// A name; [`name`] makes one.
pub type Name = heapless::String<NAME_BYTES>;

/// As much of `text` as fits a name, cut between characters.
#[must_use]
pub fn name(text: &str) -> Name {
    let mut name = Name::new();
    for character in text.chars() {
        if name.push(character).is_err() {
            break;
        }
    }
    name
}

/// What stands in front of every body. Its layout is the same in all versions of the protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// [`PROTOCOL`] of the sender, a device with [`FROM_DEVICE`] set.
    pub version: u8,
    /// Number of the session, chosen at random by the host when it says hello.
    pub session: u32,
    /// Number of the request in the session, rising from 1; a reply carries that of its request, an event 0.
    pub id: u32,
}

impl Header {
    /// A host's header.
    #[must_use]
    pub const fn new(session: u32, id: u32) -> Self {
        Header { version: PROTOCOL, session, id }
    }

    /// A device's header.
    #[must_use]
    pub const fn reply(session: u32, id: u32) -> Self {
        Header { version: PROTOCOL | FROM_DEVICE, session, id }
    }

    /// Whether a device sent it.
    #[must_use]
    pub const fn from_device(&self) -> bool {
        self.version & FROM_DEVICE != 0
    }
}
