//! Why timelines are refused, on the wire.

use motionette::{BodyParts, TimelineError};

use super::PromptFault;
use super::fault::{Sent, fault};

fault! {
    /// [`motionette::TimelineError`] on the wire: why a timeline was refused. Indices count in the request's list, from 0.
    TimelineFault of TimelineError {
        /// More spans than a request may have.
        TooMany {
            /// Spans given.
            spans: u32,
            /// Most spans allowed.
            limit: u32,
        },
        /// A span without parts.
        NoParts {
            /// Span at fault.
            index: u8,
        },
        /// A span of too few frames.
        TooShort {
            /// Span at fault.
            index: u8,
            /// Its frames.
            frames: u16,
        },
        /// A span that ends behind the end of the motion.
        OutOfRange {
            /// Span at fault.
            index: u8,
            /// The frame behind its last.
            end: u32,
            /// Frames of the motion.
            frames: u32,
        },
        /// Two spans that move one part at one frame.
        Overlap {
            /// The earlier span of the two.
            first: u8,
            /// The later one.
            second: u8,
            /// The parts that both move, as [`BodyParts::bits`](motionette::BodyParts::bits).
            parts: u8,
        },
        /// A span whose prompt was refused.
        Prompt {
            /// Span at fault.
            index: u8,
            /// Why.
            error: PromptFault,
        },
    }
}

impl Sent<u8> for BodyParts {
    fn sent(self) -> u8 {
        self.bits()
    }
}

impl Sent<BodyParts> for u8 {
    fn sent(self) -> BodyParts {
        // None of what no device sends.
        BodyParts::from_bits(self).unwrap_or(BodyParts::NONE)
    }
}
