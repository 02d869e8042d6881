//! What a host can ask for.

use heapless::{String, Vec};
use motionette::Planning;
use serde::{Deserialize, Serialize};

use super::{ANCHORS, Anchor, CHUNK_BYTES, Refinement, TEXT_BYTES};

/// A request. The reply says which kinds of answer there are; any request may be [refused](super::Refusal).
// Lives on the stack while it is handled; there is no heap to put the large variant on.
#[allow(clippy::large_enum_variant)]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Begins a session. Reply: [`Hello`](super::Hello). Refused while another host has one that it has neither closed nor fallen
    /// silent in.
    Hello {
        /// Ends another host's session. The robot goes on with what it does.
        take_over: bool,
    },
    /// Makes a motion. Reply: accepted; then event `Ready` or `Failed`.
    Generate(Generate),
    /// Plays the motion that is ready. Reply: accepted; then event `Finished`.
    Play,
    /// Emergency stop: movement and work end at once. Never refused, whatever the session. The device moves again only after `Neutral`.
    Stop,
    /// Comes to rest where it is, as fast as the servo limits allow.
    Hold,
    /// Goes on after `Hold`.
    Resume,
    /// Moves to the neutral pose.
    Neutral,
    /// Reply: [`Status`](super::Status), whatever the session.
    Status,
    /// Has the model prove itself. Reply: accepted; then event `SelfTest` or `Failed`.
    SelfTest,
    /// Begins the transfer of a blob; one that was under way is given up. Reply: `Chunk` with offset 0.
    BlobBegin {
        /// Its bytes.
        length: u32,
        /// CRC-32 (IEEE 802.3) of all its bytes.
        crc32: u32,
    },
    /// The next bytes of the blob. Reply: `Chunk` with the offset that is expected next; bytes at any other offset are not
    /// taken.
    BlobChunk {
        /// Where they stand in the blob.
        offset: u32,
        /// The bytes.
        bytes: Vec<u8, CHUNK_BYTES>,
    },
    /// Verifies the blob and makes it the active one. Reply: `Committed`.
    BlobCommit,
    /// Gives the transfer up. Reply: accepted, also when there is none.
    BlobAbort,
    /// Says that the host is alive.
    KeepAlive,
    /// Lets servos that cannot say where they stand have their first pulses: the robot has been brought to the pose that its description
    /// states for the start. Reply: accepted.
    Release,
    /// Ends the session, so that another host need not wait; a transfer is given up, what moves or is made goes on. Reply: accepted.
    Close,
    /// Begins to stage conditions of requests, [`conditions`](crate::conditions); what was staged before is given up. Reply: `Chunk` with
    /// offset 0.
    ConditionsBegin {
        /// Their bytes, a multiple of four.
        length: u32,
        /// CRC-32 (IEEE 802.3) of all their bytes.
        crc32: u32,
    },
    /// The next bytes of the conditions. Reply: `Chunk` with the offset that is expected next; bytes at any other offset are not taken.
    ConditionsChunk {
        /// Where they stand in the conditions.
        offset: u32,
        /// The bytes.
        bytes: Vec<u8, CHUNK_BYTES>,
    },
}

/// How long a motion becomes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Length {
    /// At least so many frames, to the next whole token.
    Frames(u16),
    /// What the text suggests.
    Predicted,
}

/// A motion to be made. Limits and meaning are those of [`motionette::Request`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Generate {
    /// What it is to be; not read where the conditions have a prompt's vector.
    pub text: String<TEXT_BYTES>,
    /// How long.
    pub length: Length,
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Steps of the planner; 0: as many as the device prefers.
    pub steps: u16,
    /// How strongly the text guides; 1 is off.
    pub guidance: f32,
    /// How it is bent onto its anchors, and whether feet stay where they stand.
    pub refinement: Refinement,
    /// Decoder evaluations of the refinement; 0: none before an exact one, as many as the device prefers of the others.
    pub evaluations: u16,
    /// Where the motion must pass.
    pub anchors: Vec<Anchor, ANCHORS>,
    /// Plays it as soon as it is ready, without a `Play`.
    pub play_when_ready: bool,
    /// Whether the conditions that are staged belong to it.
    pub conditions: bool,
}

impl Generate {
    /// A motion of `text` with the runtime's defaults, of predicted length, without anchors and conditions.
    #[must_use]
    pub fn new(text: String<TEXT_BYTES>) -> Self {
        Generate {
            text,
            length: Length::Predicted,
            seed: Planning::DEFAULT.seed,
            steps: Planning::DEFAULT.steps,
            guidance: Planning::DEFAULT.guidance,
            refinement: Refinement::DEVICE,
            evaluations: 0,
            anchors: Vec::new(),
            play_when_ready: false,
            conditions: false,
        }
    }

    /// The anchors as the runtime takes them.
    #[must_use]
    pub fn anchors(&self) -> Vec<motionette::Anchor, ANCHORS> {
        self.anchors.iter().copied().map(Into::into).collect()
    }

    /// The request that the runtime is to run, with [`Generate::anchors`] put in a place of the caller's, and without staged conditions.
    #[must_use]
    pub fn request<'r>(&'r self, anchors: &'r [motionette::Anchor]) -> motionette::Request<'r> {
        let length = match self.length {
            Length::Frames(frames) => motionette::Length::Frames(frames),
            Length::Predicted => motionette::Length::Predicted,
        };
        let request = motionette::Request::text(&self.text)
            .length(length)
            .seed(self.seed)
            .steps(self.steps)
            .guidance(self.guidance);
        motionette::Request { refinement: self.refinement.config(self.evaluations), ..request.anchors(anchors) }
    }
}
