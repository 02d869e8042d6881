//! A temporary file beside the target, locked as long as somebody writes it.

use std::fs::{self, File, Metadata};
use std::io;
use std::path::Path;

use tempfile::NamedTempFile;

/// What the names of temporary files begin with.
const PREFIX: &str = ".motionette-";
/// And end with.
const SUFFIX: &str = ".tmp";

/// A file that takes its target's name at the end, or disappears.
pub(super) struct Temporary(NamedTempFile);

impl Temporary {
    /// An empty file in `folder`. What is new (`fresh`) has the mode that the umask leaves it; what replaces a file is nobody else's to read
    /// until it has that file's mode.
    pub(super) fn new(folder: &Path, fresh: bool) -> io::Result<Self> {
        loop {
            let file = builder(fresh).prefix(PREFIX).suffix(SUFFIX).tempfile_in(folder)?;
            // Waits only while another run looks whether this file is abandoned. Where files cannot be locked nobody removes it either.
            let _ = file.as_file().lock();
            if has_name(file.as_file())? {
                return Ok(Self(file));
            }
        }
    }

    /// The file to write to.
    pub(super) fn file(&mut self) -> &mut File {
        self.0.as_file_mut()
    }

    /// Puts it, with all it holds, into the place of `target`; it has the mode and, where that is allowed, the owner of the file that was
    /// there `before`.
    pub(super) fn replace(self, target: &Path, before: Option<&Metadata>) -> io::Result<()> {
        let file = self.0.as_file();
        if let Some(before) = before {
            take_owner(file, before);
            file.set_permissions(before.permissions())?;
        }
        // Some file systems report a full disk only here.
        file.sync_all()?;
        self.0.persist(target).map_err(|error| error.error)?;
        Ok(())
    }
}

/// Removes the temporary files in `folder` that no running process holds. What cannot be looked at is left alone.
pub(super) fn remove_abandoned(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let ours = name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX));
        if !ours || !entry.file_type().is_ok_and(|kind| kind.is_file()) {
            continue;
        }
        // Removed while it is locked: whoever has just made it sees that its name is gone and makes another.
        if let Ok(file) = File::open(entry.path())
            && file.try_lock().is_ok()
        {
            let _ = fs::remove_file(entry.path());
        }
    }
}

#[cfg(unix)]
fn builder(fresh: bool) -> tempfile::Builder<'static, 'static> {
    use std::os::unix::fs::PermissionsExt;
    let mut builder = tempfile::Builder::new();
    builder.permissions(fs::Permissions::from_mode(if fresh { 0o666 } else { 0o600 }));
    builder
}

#[cfg(not(unix))]
fn builder(_fresh: bool) -> tempfile::Builder<'static, 'static> {
    tempfile::Builder::new()
}

#[cfg(unix)]
fn has_name(file: &File) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt;
    Ok(file.metadata()?.nlink() > 0)
}

/// Elsewhere a file cannot be removed while it is open.
#[cfg(not(unix))]
fn has_name(_file: &File) -> io::Result<bool> {
    Ok(true)
}

/// Only the administrator may give files away; for others the file is theirs, as any file they write.
#[cfg(unix)]
fn take_owner(file: &File, before: &Metadata) {
    use std::os::unix::fs::{MetadataExt, fchown};
    let _ = fchown(file, Some(before.uid()), Some(before.gid()));
}

#[cfg(not(unix))]
fn take_owner(_file: &File, _before: &Metadata) {}
