//! NOR flash as it is: erasing sets whole sectors to ones, writing only clears bits, and both keep to their granularity.

use std::path::{Path, PathBuf};

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_write};
use motionette_link::update::{Layout, Slot, Storage};

/// Bytes of the chip: as on the Pico 2.
pub const BYTES: usize = 4 * 1024 * 1024;
const SECTOR: usize = 4096;

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
    /// What the system says of the file.
    pub fn kept_in(path: &Path) -> std::io::Result<Self> {
        let mut flash = Flash { file: Some(path.to_owned()), ..Flash::default() };
        if path.exists() {
            let bytes = std::fs::read(path)?;
            let count = bytes.len().min(BYTES);
            flash.bytes_mut()[..count].copy_from_slice(&bytes[..count]);
        }
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
        let offset = offset as usize;
        for (cell, byte) in self.bytes_mut()[offset..offset + bytes.len()].iter_mut().zip(bytes) {
            *cell &= byte;
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
