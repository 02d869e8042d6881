//! What to do next about an error.

use std::io;

use crate::device;

/// A line of advice for errors whose own text cannot know the situation.
pub(super) fn of(error: &anyhow::Error) -> Option<&'static str> {
    if let Some(error) = error.chain().find_map(|cause| cause.downcast_ref::<device::Error>()) {
        return error.hint();
    }
    error.chain().find_map(|cause| {
        let kind = cause.downcast_ref::<io::Error>()?.kind();
        match kind {
            io::ErrorKind::NotFound => Some("check the path; it is taken relative to the current folder"),
            io::ErrorKind::PermissionDenied => Some("check who may read or write there (ls -l)"),
            io::ErrorKind::ReadOnlyFilesystem => Some("that place is read-only; give another output path with -o"),
            io::ErrorKind::StorageFull => Some("make room or give another output path with -o"),
            io::ErrorKind::InvalidData => {
                Some("the file is not what its name says, or is damaged; fetch or make it again")
            }
            io::ErrorKind::UnexpectedEof => Some("the file is shorter than it says; fetch or make it again"),
            _ => None,
        }
    })
}
