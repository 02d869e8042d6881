//! Files that appear whole or not at all.
//!
//! Every file of the host tools goes through [`write_atomic`]: the bytes go to a temporary file in the target's folder, which
//! takes the target's name only after everything has been written and has reached the disk. A failure on the way leaves what was
//! there before. Links are written through, a file that is replaced keeps its mode and owner, a new one has the mode that the umask
//! leaves it. Character devices and pipes have nothing to replace: they are written to as they are.
//!
//! A run that is killed leaves its temporary file behind. It held a lock on it, and the system has released that lock: the next run
//! that writes into the folder removes every such file that nobody holds.

mod temporary;
#[cfg(test)]
mod tests;

use std::fs::{self, Metadata, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use temporary::Temporary;

/// Links that are followed before they count as a circle, as Linux does.
const MOST_LINKS: usize = 40;
/// Bytes that are collected before they are written.
const BUFFER: usize = 1 << 20;

/// Why a file could not be written. The target is as it was before, unless it is a device or a pipe.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The folder of the target does not exist and cannot be made.
    #[error("cannot make the folder {}; choose another output path", folder.display())]
    Folder {
        /// The folder that was to be made.
        folder: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The target names a folder, or nothing at all.
    #[error("{} is not a file name; give the path of a file", path.display())]
    NotAFile {
        /// The path as given.
        path: PathBuf,
    },
    /// The target is a disk or a socket.
    #[error("{} is a {what}, which is not written to; give the path of a file", path.display())]
    Special {
        /// The path as given.
        path: PathBuf,
        /// What it is.
        what: &'static str,
    },
    /// The target may not be written by anybody.
    #[error("{} is read-only and is left as it is; make it writable or choose another output path", path.display())]
    ReadOnly {
        /// The path as given.
        path: PathBuf,
    },
    /// No temporary file can be made beside the target, or writing failed.
    #[error("cannot write {}; check that its folder is writable and has room", path.display())]
    Write {
        /// The path as given.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// Where the bytes go.
enum Target {
    /// To a device or a pipe, as it is.
    Stream,
    /// Into the place of a file, which is there or not.
    File { path: PathBuf, before: Option<Metadata> },
}

/// Writes a file through a temporary beside it, then renames.
///
/// Folders that are missing on the way are made. `write` receives a buffered writer; when it fails, the temporary is removed and a
/// file that stood at `path` is untouched.
///
/// # Errors
/// [`Error`], with the path and the system's reason.
pub fn write_atomic(path: impl AsRef<Path>, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), Error> {
    let path = path.as_ref();
    let failed = |source| Error::Write { path: path.to_path_buf(), source };
    let (target, before) = match target(path)? {
        Target::Stream => {
            let stream = OpenOptions::new().append(true).open(path).map_err(failed)?;
            return buffered(stream, write).map_err(failed);
        }
        Target::File { path, before } => (path, before),
    };
    let folder = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(folder).map_err(|source| Error::Folder { folder: folder.to_path_buf(), source })?;
    temporary::remove_abandoned(folder);
    let mut temporary = Temporary::new(folder, before.is_none()).map_err(failed)?;
    buffered(temporary.file(), write).map_err(failed)?;
    temporary.replace(&target, before.as_ref()).map_err(failed)
}

fn buffered(file: impl Write, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let mut writer = BufWriter::with_capacity(BUFFER, file);
    write(&mut writer)?;
    writer.flush()
}

/// What stands at `path`, links followed, if it can be written.
fn target(path: &Path) -> Result<Target, Error> {
    let given = || path.to_path_buf();
    if path.file_name().is_none() {
        return Err(Error::NotAFile { path: given() });
    }
    // What cannot be looked at is not there; making or writing it says why not.
    let Ok(before) = fs::metadata(path) else {
        return Ok(Target::File { path: behind_links(path)?.unwrap_or_else(given), before: None });
    };
    if before.is_dir() {
        return Err(Error::NotAFile { path: given() });
    }
    if !before.is_file() {
        return match unwritable(&before) {
            Some(what) => Err(Error::Special { path: given(), what }),
            None => Ok(Target::Stream),
        };
    }
    if before.permissions().readonly() {
        return Err(Error::ReadOnly { path: given() });
    }
    Ok(behind_links(path)?.map_or(Target::Stream, |path| Target::File { path, before: Some(before) }))
}

/// The path that `path` leads to, whether something is there or not; `None` for a file that this process has opened
/// (`/dev/stdout`), whose link says no path that could be renamed over.
fn behind_links(path: &Path) -> Result<Option<PathBuf>, Error> {
    let mut at = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        if !fs::symlink_metadata(&at).is_ok_and(|found| found.is_symlink()) {
            return Ok(Some(at));
        }
        let folder = at.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if folder.canonicalize().is_ok_and(|folder| folder.starts_with("/proc")) {
            return Ok(None);
        }
        let link = fs::read_link(&at).map_err(|source| Error::Write { path: path.to_path_buf(), source })?;
        at = folder.join(link);
    }
    Err(Error::Write { path: path.to_path_buf(), source: io::Error::other("its links lead round in a circle") })
}

/// What kind of thing this is, if bytes must not or cannot be written into it.
#[cfg(unix)]
fn unwritable(found: &Metadata) -> Option<&'static str> {
    use std::os::unix::fs::FileTypeExt;
    let kind = found.file_type();
    if kind.is_block_device() {
        return Some("disk");
    }
    kind.is_socket().then_some("socket")
}

#[cfg(not(unix))]
fn unwritable(_found: &Metadata) -> Option<&'static str> {
    None
}
