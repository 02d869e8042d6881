//! Recordings in, dataset out; constraint files in, anchors out.

pub mod actions;
pub mod bvh;
pub mod captions;
pub mod collect;
pub mod humanml;
pub mod kimodo;
pub mod npy;
pub mod pack;
pub mod packs;
pub mod phrases;
pub mod recordings;
mod summary;
pub mod table;

pub use summary::{Count, Note, Skipped, Summary};

/// An error and its causes on one line, for lists of what was left out.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text.push_str(": ");
        text.push_str(&error.to_string());
        cause = error.source();
    }
    text
}
