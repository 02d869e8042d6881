//! Conditions of a request that do not fit its message: tracks, obstacles, a timeline, and the vector of a prompt.
//!
//! They come in pieces into memory that the firmware sets aside, words of 32 bits, and are used where they lie: numbers stand on the wire
//! as they stand in memory, so that a device computes with the same bits as a desktop. `PROTOCOL.md` specifies their format.
//!
//! - [`Given`]: the host's side, what is to be sent.
//! - [`Staged`]: how far they have come.
//! - [`Conditions`]: what lies in the memory, checked, in the runtime's types.

mod read;
mod staged;
mod write;

pub use read::Conditions;
pub use staged::Staged;
pub use write::{Given, Unfit};

/// Most keyframes of all obstacles of a request together.
pub const KEYFRAMES: usize = 64;
/// Bytes of the shortest conditions, which say nothing.
pub const LEAST_BYTES: usize = 4 * HEADER;

/// Version of the format.
const FORMAT: u8 = 2;
/// Words in front of all others: length; format, tracks, obstacles, spans; numbers of the vector.
const HEADER: usize = 3;
/// Words in front of a track's positions: joint, flags, first frame; positions; tolerance.
const TRACK: usize = 3;
/// Words in front of an obstacle's shape: shape, course, keyframes; joints; margin.
const OBSTACLE: usize = 3;
/// Words of a keyframe: frame; position.
const KEYFRAME: usize = 4;
/// Words in front of a span's prompt: parts, kind of the prompt, its bytes or numbers; first frame, frames.
const SPAN: usize = 2;

/// Flag of a track that has a mask; the three below it are its axes.
const MASKED: u8 = 1 << 3;

// Numbers of shapes, of courses, and of kinds of prompts.
const SPHERE: u8 = 0;
const CAPSULE: u8 = 1;
const CYLINDER: u8 = 2;
const BOX: u8 = 3;
const PLANE: u8 = 4;
const STILL: u8 = 0;
const MOVING: u8 = 1;
const WITH_KEYFRAMES: u8 = 2;
const TEXT: u8 = 0;
const STORED: u8 = 1;
const VECTOR: u8 = 2;
