//! Two slots for blobs behind the firmware.

use embassy_rp::flash::{Blocking, ERASE_SIZE, Flash};
use embassy_rp::peripherals::FLASH;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use motionette_link::update::{Layout, Slot, Storage};

/// Bytes of the chip.
pub const BYTES: usize = 4 * 1024 * 1024;
/// Where the first slot begins: the end of what `memory.x` gives the firmware.
const FIRST: u32 = 448 * 1024;
/// Bytes of a slot: half of the rest.
const SLOT: u32 = (BYTES as u32 - FIRST) / 2;
/// Where flash is mapped.
const MAPPED: usize = 0x1000_0000;

const _: () = assert!(SLOT.is_multiple_of(ERASE_SIZE as u32) && FIRST.is_multiple_of(ERASE_SIZE as u32));

const LAYOUT: Layout = Layout { offsets: [FIRST, FIRST + SLOT], length: SLOT };

fn mapped(slot: Slot) -> &'static [u8] {
    let [a, b] = LAYOUT.offsets;
    let offset = match slot {
        Slot::A => a,
        Slot::B => b,
    };
    let start = (MAPPED + offset as usize) as *const u8;
    // SAFETY: the slot lies within the mapped flash, behind the firmware; nothing but [`NorFlash`] changes it, and that only while
    // nobody reads a blob there (the link writes to the slot that is not active).
    unsafe { core::slice::from_raw_parts(start, SLOT as usize) }
}

/// The flash as the link writes it.
pub struct Slots {
    flash: Flash<'static, FLASH, Blocking, BYTES>,
}

impl Slots {
    /// On this chip.
    pub const fn new(flash: Flash<'static, FLASH, Blocking, BYTES>) -> Self {
        Slots { flash }
    }
}

impl Storage for Slots {
    type Flash = Flash<'static, FLASH, Blocking, BYTES>;

    fn flash(&mut self) -> &mut Self::Flash {
        &mut self.flash
    }

    fn layout(&self) -> Layout {
        LAYOUT
    }

    fn mapped(&self, slot: Slot) -> &[u8] {
        mapped(slot)
    }
}

/// The slots for whoever only reads them.
pub struct ReadOnly {
    flash: NoFlash,
}

impl ReadOnly {
    /// The slots.
    pub const SLOTS: ReadOnly = ReadOnly { flash: NoFlash };

    /// The bytes of a blob that was found in a slot.
    pub fn blob(slot: Slot, length: usize) -> Option<&'static [u8]> {
        mapped(slot).get(ERASE_SIZE..)?.get(..length)
    }
}

impl Storage for ReadOnly {
    type Flash = NoFlash;

    fn flash(&mut self) -> &mut NoFlash {
        &mut self.flash
    }

    fn layout(&self) -> Layout {
        LAYOUT
    }

    fn mapped(&self, slot: Slot) -> &[u8] {
        mapped(slot)
    }
}

/// A flash that refuses everything.
pub struct NoFlash;

impl ErrorType for NoFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for NoFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, _: u32, _: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        Err(NorFlashErrorKind::Other)
    }

    fn capacity(&self) -> usize {
        BYTES
    }
}

impl NorFlash for NoFlash {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = ERASE_SIZE;

    fn erase(&mut self, _: u32, _: u32) -> Result<(), NorFlashErrorKind> {
        Err(NorFlashErrorKind::Other)
    }

    fn write(&mut self, _: u32, _: &[u8]) -> Result<(), NorFlashErrorKind> {
        Err(NorFlashErrorKind::Other)
    }
}
