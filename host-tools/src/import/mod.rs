//! Recordings in, dataset out.

pub mod npy;
pub mod pack;
mod summary;

pub use summary::{Count, Skipped, Summary};
