//! Files that appear whole or not at all.
//!
//! Every file of the host tools goes through [`write_atomic`]: the bytes go to a temporary file in the target's folder, which
//! takes the target's name only after everything has been written and flushed. A failure on the way leaves what was there before.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Why a file could not be written. The target is as it was before.
#[derive(Debug, thiserror::Error)]
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
    /// No temporary file can be made beside the target, or writing to it failed.
    #[error("cannot write {}; check that its folder is writable and has room", path.display())]
    Write {
        /// The target.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
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
    if path.file_name().is_none() || path.is_dir() {
        return Err(Error::NotAFile { path: path.to_path_buf() });
    }
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(folder).map_err(|source| Error::Folder { folder: folder.to_path_buf(), source })?;
    let mut temporary =
        tempfile::Builder::new().prefix(".motionette-").suffix(".tmp").tempfile_in(folder).map_err(failed)?;
    {
        let mut writer = BufWriter::with_capacity(1 << 20, temporary.as_file_mut());
        write(&mut writer).map_err(failed)?;
        writer.flush().map_err(failed)?;
    }
    readable_by_default(temporary.as_file()).map_err(failed)?;
    temporary.persist(path).map_err(|error| failed(error.error))?;
    Ok(())
}

/// Temporary files are made for their owner only; results should have the permissions any new file has.
#[cfg(unix)]
fn readable_by_default(file: &fs::File) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn readable_by_default(_file: &fs::File) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(folder: &Path) -> usize {
        fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn writes_the_whole_file_and_makes_folders() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/out.bin");
        write_atomic(&path, |w| w.write_all(b"whole")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(entries(path.parent().unwrap()), 1);
    }

    #[test]
    fn a_failing_writer_leaves_the_old_file_and_no_rest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        fs::write(&path, b"old").unwrap();
        let error = write_atomic(&path, |w| {
            w.write_all(b"half")?;
            Err(io::Error::other("disk gone"))
        })
        .unwrap_err();
        assert!(matches!(error, Error::Write { .. }), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(entries(folder.path()), 1);
    }

    #[test]
    fn a_folder_or_a_file_in_the_way_is_a_typed_error() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(write_atomic(folder.path(), |_| Ok(())), Err(Error::NotAFile { .. })));
        let file = folder.path().join("file");
        fs::write(&file, b"x").unwrap();
        assert!(matches!(write_atomic(file.join("below"), |_| Ok(())), Err(Error::Folder { .. })));
        assert_eq!(entries(folder.path()), 1);
    }
}
