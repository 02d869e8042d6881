//! The caller's bytes: one static buffer, and how it is shared out.

pub mod arena;

pub use arena::{ALIGNMENT, Arena, ArenaTooSmall, bytes_of};
