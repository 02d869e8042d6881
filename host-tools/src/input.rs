//! Reading that ends: whole files, no larger than such a file can be.

use std::fs::{self, File};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// For files that may have any length.
pub const ANY: u64 = u64::MAX;
/// For files that a person writes: anchors, robots, prompts.
pub const WRITTEN: u64 = 64 << 20;
/// Most that is taken from a pipe, whose length nobody knows before its end.
const PIPED: u64 = 256 << 20;

/// The bytes of a file, or of a pipe to its end.
///
/// # Errors
/// Those of the system; [`ErrorKind::InvalidInput`] for a device (`/dev/zero` has no end), [`ErrorKind::FileTooLarge`] for more than
/// `limit` bytes.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let found = fs::metadata(path)?;
    // Before it is opened, since opening alone can start something on a device.
    let limit = match found.is_file() || found.is_dir() {
        true => limit,
        false if is_pipe(&found) => limit.min(PIPED),
        false => return Err(Error::new(ErrorKind::InvalidInput, "it is a device or a socket, not a file")),
    };
    let too_large = |what: &str| {
        let message = format!("{what}; such a file has at most {limit}");
        Err(Error::new(ErrorKind::FileTooLarge, message))
    };
    if found.len() > limit {
        return too_large(&format!("it has {} bytes", found.len()));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(found.len()).unwrap_or_default());
    // Files may grow, and some (`/proc`) say that they are empty.
    File::open(path)?.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { too_large("it has more bytes than that") } else { Ok(bytes) }
}

/// The same as text.
///
/// # Errors
/// Those of [`read`], and [`ErrorKind::InvalidData`] where it is no UTF-8.
pub fn read_text(path: &Path, limit: u64) -> Result<String> {
    String::from_utf8(read(path, limit)?).map_err(|error| Error::new(ErrorKind::InvalidData, error))
}

#[cfg(unix)]
fn is_pipe(found: &fs::Metadata) -> bool {
    use std::os::unix::fs::FileTypeExt;
    found.file_type().is_fifo()
}

#[cfg(not(unix))]
fn is_pipe(_found: &fs::Metadata) -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_limit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, b"12345").unwrap();
        assert_eq!(read(&path, 5).unwrap(), b"12345");
        let error = read(&path, 4).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
        assert!(error.to_string().contains("5 bytes") && error.to_string().contains("at most 4"), "{error}");
        assert_eq!(read_text(&path, ANY).unwrap(), "12345");
        fs::write(&path, [b'a', 0xFF]).unwrap();
        assert_eq!(read_text(&path, ANY).unwrap_err().kind(), ErrorKind::InvalidData);
        assert_eq!(read(&folder.path().join("none"), ANY).unwrap_err().kind(), ErrorKind::NotFound);
        assert!(read(folder.path(), ANY).is_err());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_has_no_end_is_refused() {
        assert_eq!(read(Path::new("/dev/zero"), ANY).unwrap_err().kind(), ErrorKind::InvalidInput);
        // Says that it is empty.
        assert!(!read(Path::new("/proc/self/status"), ANY).unwrap().is_empty());
    }
}
