//! What to do next about an error.

use std::io;

use crate::device;
use crate::robot_file::Error;

/// A line of advice for errors whose own text cannot know the situation.
pub(super) fn of(error: &anyhow::Error) -> Option<&'static str> {
    if let Some(error) = error.chain().find_map(|cause| cause.downcast_ref::<device::Error>()) {
        return error.hint();
    }
    error.chain().find_map(|cause| {
        if let Some(error) = cause.downcast_ref() {
            return of_robot(error);
        }
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

fn of_robot(error: &Error) -> Option<&'static str> {
    match error {
        Error::Invalid(_) => {
            Some("docs/robot.md describes every key; `motionette robot show NAME --toml` prints a preset to begin with")
        }
        Error::NoSuchRobot { .. } => {
            Some("a file needs its ending (robot.toml); `motionette robot presets` lists the presets")
        }
        Error::Packed { .. } => Some("pack it again from its robot.toml with `motionette robot pack`"),
        // The cause says more.
        Error::Read { .. } | Error::NoStart { .. } => None,
    }
}
