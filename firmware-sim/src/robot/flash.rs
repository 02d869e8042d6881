//! NOR flash as it is: erasing sets whole sectors to ones, writing only clears bits, and both keep to their granularity.
//!
//! Its contents may be kept in a file, which is written as a whole when a slot gets its header: until then the file holds what was
//! there before, as the slot that is active does.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_write};
use motionette_link::update::{Layout, Slot, Storage};

/// Bytes of the chip: as on the Pico 2.
pub const BYTES: usize = 4 * 1024 * 1024;
const SECTOR: usize = 4096;

/// Why a file is not taken as the contents of the chip. It has not been touched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FileError {
    /// It cannot be read.
    #[error("cannot read the flash file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// It was not written by the simulator.
    #[error("{} is no flash file of the simulator: {why}; give one, or a path where there is no file yet", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// How that can be seen.
        why: Foreign,
    },
}

/// How a file shows that it is not the contents of the chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Foreign {
    /// A folder, a device, a pipe.
    #[error("it is no regular file")]
    Kind,
    /// Another size than the chip's.
    #[error("it has {bytes} bytes instead of {BYTES}")]
    Size {
        /// Its bytes.
        bytes: u64,
    },
    /// Something where nothing is ever written.
    #[error("byte {offset} holds something, where the simulator writes nothing")]
    Outside {
        /// Where, from the file's start.
        offset: usize,
    },
    /// A slot that begins neither erased nor with a slot's header.
    #[error("the slot at byte {offset} has no header of a slot")]
    Header {
        /// Where the slot begins.
        offset: usize,
    },
}

/// Whether `bytes` may be what the simulator has written.
fn recognise(bytes: &[u8]) -> Result<(), Foreign> {
    const ERASED: u8 = 0xFF;
    /// First bytes of a slot's header, and bytes of it.
    const HEADER: (&[u8], usize) = (b"MNTS", 24);
    if bytes.len() != BYTES {
        return Err(Foreign::Size { bytes: bytes.len() as u64 });
    }
    let slots = [Slot::A, Slot::B].map(|slot| Layout::PICO2.range(slot));
    for slot in slots.clone() {
        let sector = &bytes[slot.start..][..SECTOR];
        let empty = if sector.starts_with(HEADER.0) { &sector[HEADER.1..] } else { sector };
        if empty.iter().any(|&byte| byte != ERASED) {
            return Err(Foreign::Header { offset: slot.start });
        }
    }
    let written = |(offset, byte): (usize, &u8)| *byte != ERASED && !slots.iter().any(|slot| slot.contains(&offset));
    match bytes.iter().enumerate().position(written) {
        Some(offset) => Err(Foreign::Outside { offset }),
        None => Ok(()),
    }
}

/// A chip.
#[derive(Debug)]
pub struct Flash {
    /// Sixteen bytes each, so that blobs are aligned as in real flash.
    words: Vec<u128>,
    file: Option<PathBuf>,
}

impl Default for Flash {
    /// Erased.
    fn default() -> Self {
        Flash { words: vec![u128::MAX; BYTES / 16], file: None }
    }
}

impl Flash {
    /// A chip whose contents are kept in a file, which is read if it is there.
    ///
    /// # Errors
    /// [`FileError`].
    pub fn kept_in(path: &Path) -> Result<Self, FileError> {
        let read = |source| FileError::Read { path: path.to_owned(), source };
        let foreign = |why| FileError::Foreign { path: path.to_owned(), why };
        let mut flash = Flash { file: Some(path.to_owned()), ..Flash::default() };
        let found = match std::fs::metadata(path) {
            Ok(found) => found,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(flash),
            Err(error) => return Err(read(error)),
        };
        // Before it is read: it may be large, or never end.
        if !found.is_file() {
            return Err(foreign(Foreign::Kind));
        }
        if found.len() != BYTES as u64 {
            return Err(foreign(Foreign::Size { bytes: found.len() }));
        }
        let bytes = std::fs::read(path).map_err(read)?;
        recognise(&bytes).map_err(foreign)?;
        flash.bytes_mut().copy_from_slice(&bytes);
        Ok(flash)
    }

    /// Everything in it.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.words)
    }

    fn bytes_mut(&mut self) -> &mut [u8] {
        bytemuck::cast_slice_mut(&mut self.words)
    }

    /// Writes the file, if there is one.
    ///
    /// # Errors
    /// What cannot be written.
    pub fn keep(&self) -> Result<(), motionette_host::output::Error> {
        let Some(path) = &self.file else { return Ok(()) };
        motionette_host::output::write_atomic(path, |file| file.write_all(self.bytes()))
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let from = self.bytes().get(offset as usize..).and_then(|rest| rest.get(..bytes.len()));
        bytes.copy_from_slice(from.ok_or(NorFlashErrorKind::OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        BYTES
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        self.bytes_mut()[from as usize..to as usize].fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let range = offset as usize..offset as usize + bytes.len();
        let before = self.bytes()[range.clone()].to_vec();
        for (cell, byte) in self.bytes_mut()[range.clone()].iter_mut().zip(bytes) {
            *cell &= byte;
        }
        let is_header = [Slot::A, Slot::B].iter().any(|slot| self.layout().range(*slot).start == range.start);
        if is_header && let Err(error) = self.keep() {
            // As flash that fails: the blob is not taken, and its host is told.
            let _ = writeln!(io::stderr(), "error: {error}");
            self.bytes_mut()[range].copy_from_slice(&before);
            return Err(NorFlashErrorKind::Other);
        }
        Ok(())
    }
}

impl Storage for Flash {
    type Flash = Flash;

    fn flash(&mut self) -> &mut Flash {
        self
    }

    fn layout(&self) -> Layout {
        Layout::PICO2
    }

    fn mapped(&self, slot: Slot) -> &[u8] {
        &self.bytes()[self.layout().range(slot)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_the_simulator_writes_is_recognised() {
        let erased = vec![0xFF; BYTES];
        assert_eq!(recognise(&erased), Ok(()));
        let [a, b] = [Slot::A, Slot::B].map(|slot| Layout::PICO2.range(slot).start);
        let mut written = erased.clone();
        written[a..a + 4].copy_from_slice(b"MNTS");
        // A blob, whole or not.
        written[a + SECTOR..a + SECTOR + 9999].fill(0x5A);
        written[b + SECTOR..].fill(0);
        assert_eq!(recognise(&written), Ok(()));
        for (at, why) in [
            (0, Foreign::Outside { offset: 0 }),
            (a - 1, Foreign::Outside { offset: a - 1 }),
            (a + 24, Foreign::Header { offset: a }),
            (b, Foreign::Header { offset: b }),
            (b + SECTOR - 1, Foreign::Header { offset: b }),
        ] {
            let mut damaged = written.clone();
            damaged[at] = 0;
            assert_eq!(recognise(&damaged), Err(why), "byte {at}");
        }
        assert_eq!(recognise(&written[1..]), Err(Foreign::Size { bytes: BYTES as u64 - 1 }));
        assert_eq!(recognise(&[]), Err(Foreign::Size { bytes: 0 }));
    }

    #[test]
    fn a_file_of_somebody_else_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("thesis.txt");
        for content in [&b""[..], b"years of work", &vec![0x20; BYTES]] {
            std::fs::write(&path, content).unwrap();
            assert!(matches!(Flash::kept_in(&path), Err(FileError::Foreign { .. })));
            assert!(std::fs::read(&path).unwrap() == content);
        }
        let folder_itself = Flash::kept_in(folder.path());
        assert!(matches!(folder_itself, Err(FileError::Foreign { why: Foreign::Kind, .. })));
    }

    #[test]
    fn a_file_that_cannot_be_written_fails_as_flash_does() {
        let folder = tempfile::tempdir().unwrap();
        let blocked = folder.path().join("file");
        std::fs::write(&blocked, b"in the way").unwrap();
        let mut flash = Flash { file: Some(blocked.join("flash.bin")), ..Flash::default() };
        let [header, blob] = [Layout::PICO2.range(Slot::B).start, Layout::PICO2.range(Slot::B).start + SECTOR];
        flash.write(blob as u32, &[1, 2, 3]).unwrap();
        assert_eq!(flash.write(header as u32, b"MNTS"), Err(NorFlashErrorKind::Other));
        assert_eq!(flash.bytes()[header..header + 4], [0xFF; 4]);
        assert_eq!(flash.bytes()[blob..blob + 3], [1, 2, 3]);
    }
}
