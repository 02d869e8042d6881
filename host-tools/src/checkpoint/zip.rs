//! The zip archives that `torch.save` writes, read with the crate `zip`: entries are stored, never compressed.
//!
//! Anything but a stored entry is refused, so no entry is larger than the file it lies in. Names are plain keys that never touch the
//! file system, and the CRC-32 of an entry is verified when it is read.

use std::io::{Cursor, Read as _};

use ::zip::result::ZipError;
use ::zip::{CompressionMethod, ZipArchive};

use super::error::{ErrorKind, Result};

/// A stored zip archive in memory.
#[derive(Debug)]
pub struct Archive<'a> {
    entries: ZipArchive<Cursor<&'a [u8]>>,
}

impl<'a> Archive<'a> {
    /// Reads the central directory.
    ///
    /// # Errors
    /// [`ErrorKind::Zip`] when it is damaged or cut short.
    pub fn open(bytes: &'a [u8]) -> Result<Self> {
        let entries = ZipArchive::new(Cursor::new(bytes))
            .map_err(|e| bad(format!("its directory cannot be read ({})", reason(&e))))?;
        Ok(Self { entries })
    }

    /// Entry names that are UTF-8, in the order of the directory.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.file_names_raw().filter_map(|name| core::str::from_utf8(name).ok())
    }

    /// The bytes of an entry, `None` when there is no entry of that name.
    ///
    /// # Errors
    /// [`ErrorKind::Zip`] when the entry is compressed or encrypted, lies outside the file, or does not match its CRC-32.
    pub fn read(&mut self, name: &str) -> Result<Option<Vec<u8>>> {
        let failed = |what: String| bad(format!("entry `{name}` cannot be read ({what})"));
        let mut entry = match self.entries.by_name(name) {
            Err(ZipError::FileNotFound) => return Ok(None),
            found => found.map_err(|e| failed(reason(&e)))?,
        };
        let (method, promised) = (entry.compression(), entry.size());
        if method != CompressionMethod::Stored {
            return Err(failed(format!("it is compressed ({method:?}), expected stored")));
        }
        // Not reserved beforehand: the length is the file's word, and not yet checked.
        let mut data = Vec::new();
        entry.read_to_end(&mut data).map_err(|e| failed(e.to_string()))?;
        if data.len() as u64 != promised {
            return Err(failed(format!("it has {} bytes, its directory says {promised}", data.len())));
        }
        Ok(Some(data))
    }
}

fn bad(what: impl Into<String>) -> ErrorKind {
    ErrorKind::Zip { what: what.into() }
}

/// What the crate says, without its repetition of what this is about.
fn reason(error: &ZipError) -> String {
    match error {
        ZipError::InvalidArchive(what) => what.to_string(),
        ZipError::UnsupportedArchive(what) => (*what).to_owned(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rubbish_is_refused() {
        for bytes in [&b""[..], b"PK\x03\x04", &[0_u8; 100], b"PK\x05\x06aaaaaaaaaaaaaaaaaaaaaa"] {
            let error = Archive::open(bytes).expect_err("rubbish was opened");
            assert!(matches!(error, ErrorKind::Zip { .. }), "{error}");
        }
    }
}
