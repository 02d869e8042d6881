//! Where the shared test data lies.

use std::path::PathBuf;

/// `../shared/<relative>` beside the workspace, or below `MOTIONETTE_SHARED`; says so on standard error when it is absent.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let root = std::env::var_os("MOTIONETTE_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: ../shared/{relative} not found");
    None
}
