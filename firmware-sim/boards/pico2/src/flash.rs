//! Two slots for blobs behind the firmware.

use embassy_rp::flash::{Blocking, Flash};
use embassy_rp::peripherals::FLASH;
use motionette_link::update::{Layout, Slot, Storage, blob_in};

/// Bytes of the chip.
pub const BYTES: usize = 4 * 1024 * 1024;
/// Where flash is mapped.
const MAPPED: usize = 0x1000_0000;

fn mapped(slot: Slot) -> &'static [u8] {
    let range = Layout::PICO2.range(slot);
    let start = (MAPPED + range.start) as *const u8;
    // SAFETY: the slot lies within the mapped flash, behind the firmware; nothing but the link changes it, and that only while
    // nobody reads a blob there (it writes to the slot that is not active).
    unsafe { core::slice::from_raw_parts(start, range.len()) }
}

/// The bytes of a blob in a slot.
pub fn blob((slot, length): (Slot, usize)) -> Option<&'static [u8]> {
    blob_in::<Slots>(mapped(slot), length)
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
        Layout::PICO2
    }

    fn mapped(&self, slot: Slot) -> &[u8] {
        mapped(slot)
    }
}
