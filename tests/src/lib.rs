//! Support code of the cross-crate tests: small random models, and an oracle that shares nothing with the runtime.

pub mod fuzz;
pub mod naive;
pub mod naive_prior;
pub mod naive_scaffold;
pub mod published;
pub mod standard_request;
pub mod tiny;

use std::path::PathBuf;

/// `../shared/<path>` beside the workspace (or under `MOTIONETTE_SHARED`); `None`, with a visible message, where it is
/// absent.
#[must_use]
pub fn shared(path: &str) -> Option<PathBuf> {
    let root = std::env::var_os("MOTIONETTE_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared")), PathBuf::from);
    let found = root.join(path);
    if found.exists() {
        return Some(found);
    }
    eprintln!("skipped: ../shared/{path} not found");
    None
}
