//! A model blob into one of two slots of NOR flash.
//!
//! ```text
//! slot: │ header sector │ blob, from a sector boundary ... │
//! ```
//! A new blob goes to the slot that is not active, is verified there, and becomes the active one by its header, which is
//! written last. The header of the slot is erased first: power loss at any point leaves the other slot's blob active. At
//! start the newest slot whose blob is whole wins.
//!
//! Sectors are erased as bytes arrive, not all at once: no step blocks for longer than a sector's erasure, except
//! [`Store::commit`], which reads the blob twice.

use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashError};
use heapless::Vec;
use motionette::Model;
use motionette::blob::{ALIGNMENT, crc32};

use crate::message::{Blob, FlashFault, RefusedBlob, Transfer, UpdateFault};

/// Bytes that are written at a time; the flash's write size must divide it.
pub const PAGE: usize = 256;

/// One of the two slots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slot {
    /// The first.
    A,
    /// The second.
    B,
}

impl Slot {
    /// 0 or 1.
    #[must_use]
    pub const fn index(self) -> u8 {
        match self {
            Slot::A => 0,
            Slot::B => 1,
        }
    }

    /// The other one.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Slot::A => Slot::B,
            Slot::B => Slot::A,
        }
    }
}

/// Where the slots lie in flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Offsets of slot A and B from the flash's start, bytes, on sector boundaries.
    pub offsets: [u32; 2],
    /// Bytes of a slot with its header sector, whole sectors.
    pub length: u32,
}

impl Layout {
    /// Of a Raspberry Pi Pico 2: 4 MiB, 448 KiB of them the firmware's, the rest in two halves.
    pub const PICO2: Layout = Layout { offsets: [0x07_0000, 0x23_8000], length: 0x1C_8000 };

    /// Where a slot begins.
    const fn offset(&self, slot: Slot) -> u32 {
        let [a, b] = self.offsets;
        match slot {
            Slot::A => a,
            Slot::B => b,
        }
    }

    /// Where a slot lies in the flash.
    #[must_use]
    pub const fn range(&self, slot: Slot) -> Range<usize> {
        let start = self.offset(slot) as usize;
        start..start + self.length as usize
    }
}

/// The blob of so many bytes in the bytes of a slot.
#[must_use]
pub fn blob_in<S: Storage>(slot: &[u8], length: usize) -> Option<&[u8]> {
    slot.get(sector::<S>() as usize..)?.get(..length)
}

/// The flash that holds the slots.
pub trait Storage {
    /// Its driver.
    type Flash: NorFlash;

    /// The driver.
    fn flash(&mut self) -> &mut Self::Flash;

    /// Where the slots lie.
    fn layout(&self) -> Layout;

    /// The bytes of a slot, header sector included, as they are in flash now. MUST begin on a 16-byte boundary and MUST
    /// show what the driver wrote before (no stale cache).
    fn mapped(&self, slot: Slot) -> &[u8];

    /// Whether the device can run a model that has been verified; by default it can.
    ///
    /// # Errors
    /// Why not, most likely [`UpdateFault::Memory`].
    fn fits(&self, model: &Model<'_>) -> Result<(), UpdateFault> {
        let _ = model;
        Ok(())
    }
}

type FlashError<S> = <<S as Storage>::Flash as ErrorType>::Error;

/// Bytes of the header sector, which is also where the blob begins.
fn sector<S: Storage>() -> u32 {
    const {
        assert!(S::Flash::ERASE_SIZE.is_multiple_of(ALIGNMENT), "blobs must begin on a 16-byte boundary");
        assert!(PAGE.is_multiple_of(S::Flash::WRITE_SIZE), "the flash's write size must divide a page of 256 bytes");
        assert!(S::Flash::ERASE_SIZE >= S::Flash::WRITE_SIZE && S::Flash::ERASE_SIZE >= SlotHeader::BYTES);
        S::Flash::ERASE_SIZE as u32
    }
}

fn flash_fault<S: Storage>(error: FlashError<S>) -> UpdateFault {
    UpdateFault::Flash(error.kind().into())
}

/// The header of a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct SlotHeader {
    sequence: u32,
    length: u32,
    crc32: u32,
}

impl SlotHeader {
    const MAGIC: u32 = u32::from_le_bytes(*b"MNTS");
    const VERSION: u32 = 1;
    /// Magic, version, sequence, length, CRC-32 of the blob, CRC-32 of the header up to here, little-endian.
    const BYTES: usize = 24;

    fn emit(&self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        let words = [Self::MAGIC, Self::VERSION, self.sequence, self.length, self.crc32];
        let (fields, crc) = bytes.split_at_mut(Self::BYTES - 4);
        for (to, word) in fields.iter_mut().zip(words.iter().flat_map(|word| word.to_le_bytes())) {
            *to = word;
        }
        for (to, byte) in crc.iter_mut().zip((!crc32(!0, fields)).to_le_bytes()) {
            *to = byte;
        }
        bytes
    }

    fn parse(slot: &[u8]) -> Option<Self> {
        let bytes = slot.first_chunk::<{ Self::BYTES }>()?;
        let word = |index: usize| {
            let chunk = bytes.get(4 * index..)?.first_chunk::<4>()?;
            Some(u32::from_le_bytes(*chunk))
        };
        let header = SlotHeader { sequence: word(2)?, length: word(3)?, crc32: word(4)? };
        (header.emit() == *bytes).then_some(header)
    }

    /// The blob that it speaks of, in figures.
    const fn blob(&self, slot: Slot) -> Blob {
        Blob { slot: slot.index(), sequence: self.sequence, length: self.length, crc32: self.crc32 }
    }

    fn newer_than(&self, other: &Self) -> bool {
        self.sequence.wrapping_sub(other.sequence).cast_signed() > 0
    }
}

/// The blob that `header` speaks of, verified: its length, its CRC-32, and that the runtime takes it.
fn verified<'s, S: Storage>(storage: &'s S, slot: Slot, header: &SlotHeader) -> Result<&'s [u8], UpdateFault> {
    let SlotHeader { length, crc32: announced, .. } = *header;
    let room = storage.mapped(slot).get(sector::<S>() as usize..).unwrap_or(&[]);
    let limit = u32::try_from(room.len()).unwrap_or(u32::MAX);
    let blob = room.get(..length as usize).ok_or(UpdateFault::Length { length, limit })?;
    let computed = !crc32(!0, blob);
    if computed != announced {
        return Err(UpdateFault::Checksum { computed, announced });
    }
    let model = Model::open(blob).map_err(|error| UpdateFault::Model(error.into()))?;
    storage.fits(&model)?;
    Ok(blob)
}

/// A blob on its way.
#[derive(Debug)]
struct Incoming {
    slot: Slot,
    length: u32,
    crc32: u32,
    /// Bytes that have come.
    next: u32,
    /// Bytes that are in flash; the rest is in `page`.
    written: u32,
    /// Bytes behind the header sector that have been erased.
    erased: u32,
    page: Vec<u8, PAGE>,
}

impl Incoming {
    /// Takes bytes; whole pages go to flash.
    fn take<S: Storage>(&mut self, storage: &mut S, bytes: &[u8]) -> Result<(), UpdateFault> {
        for &byte in bytes {
            // A full page has been written and emptied below.
            let _ = self.page.push(byte);
            self.next += 1;
            if self.page.is_full() {
                self.write_page(storage)?;
            }
        }
        Ok(())
    }

    /// Writes what the page holds, filled up to the flash's granularity, and erases as far as that needs.
    fn write_page<S: Storage>(&mut self, storage: &mut S) -> Result<(), UpdateFault> {
        if self.page.is_empty() {
            return Ok(());
        }
        while !self.page.len().is_multiple_of(S::Flash::WRITE_SIZE) {
            let _ = self.page.push(0xFF);
        }
        let sector = sector::<S>();
        let start = base(storage, self.slot) + sector;
        let end = self.written + self.page.len() as u32;
        while self.erased < end {
            let from = start + self.erased;
            storage.flash().erase(from, from + sector).map_err(flash_fault::<S>)?;
            self.erased += sector;
        }
        storage.flash().write(start + self.written, &self.page).map_err(flash_fault::<S>)?;
        self.written = end;
        self.page.clear();
        Ok(())
    }
}

fn base<S: Storage>(storage: &S, slot: Slot) -> u32 {
    storage.layout().offset(slot)
}

/// The two slots: which one is active, and what is on its way to the other.
#[derive(Debug, Default)]
pub struct Store {
    active: Option<(Slot, SlotHeader)>,
    /// A newer one that is not used.
    refused: Option<(Slot, SlotHeader, UpdateFault)>,
    incoming: Option<Incoming>,
}

impl Store {
    /// A store without a blob, for devices that have none.
    pub const EMPTY: Self = Store { active: None, refused: None, incoming: None };

    /// Looks for the newest slot that holds a whole blob which the runtime takes. Reads both blobs at worst.
    #[must_use]
    pub fn open<S: Storage>(storage: &S) -> Self {
        let header = |slot: Slot| SlotHeader::parse(storage.mapped(slot)).map(|header| (slot, header));
        let (a, b) = (header(Slot::A), header(Slot::B));
        let b_first = matches!((&a, &b), (Some((_, a)), Some((_, b))) if b.newer_than(a));
        let candidates = if b_first { [b, a] } else { [a, b] };
        let mut store = Store::EMPTY;
        for (slot, header) in candidates.into_iter().flatten() {
            match verified(storage, slot, &header) {
                Ok(_) => {
                    store.active = Some((slot, header));
                    break;
                }
                // The newest counts.
                Err(why) => store.refused = store.refused.or(Some((slot, header, why))),
            }
        }
        store
    }

    /// The active slot.
    #[must_use]
    pub fn slot(&self) -> Option<Slot> {
        self.active.map(|(slot, _)| slot)
    }

    /// The active blob in figures.
    #[must_use]
    pub fn active(&self) -> Option<Blob> {
        self.active.map(|(slot, header)| header.blob(slot))
    }

    /// The blob of the newest slot if it is not the active one, and why it is not.
    #[must_use]
    pub fn refused(&self) -> Option<RefusedBlob> {
        self.refused.map(|(slot, header, why)| RefusedBlob { blob: header.blob(slot), why })
    }

    /// Where the active blob lies, and its bytes.
    #[must_use]
    pub fn place(&self) -> Option<(Slot, usize)> {
        self.active.map(|(slot, header)| (slot, header.length as usize))
    }

    /// The bytes of the active blob.
    #[must_use]
    pub fn bytes<'s, S: Storage>(&self, storage: &'s S) -> Option<&'s [u8]> {
        let (slot, length) = self.place()?;
        blob_in::<S>(storage.mapped(slot), length)
    }

    /// Bytes of the largest blob.
    #[must_use]
    pub fn capacity<S: Storage>(storage: &S) -> u32 {
        storage.layout().length.saturating_sub(sector::<S>())
    }

    /// The transfer that is under way.
    #[must_use]
    pub fn transfer(&self) -> Option<Transfer> {
        self.incoming.as_ref().map(|incoming| Transfer { next: incoming.next, length: incoming.length })
    }

    /// Begins the transfer of a blob into the slot that is not active, whose header is erased. One that was under way is
    /// given up. When no slot is active, a blob that is refused stays, for the firmware that can use it.
    ///
    /// # Errors
    /// [`UpdateFault::Length`], [`UpdateFault::Layout`] or [`UpdateFault::Flash`].
    pub fn begin<S: Storage>(&mut self, storage: &mut S, length: u32, crc32: u32) -> Result<(), UpdateFault> {
        self.incoming = None;
        let sector = sector::<S>();
        let Layout { offsets: [a, b], length: room } = storage.layout();
        let whole = [a, b, room].iter().all(|value| value.is_multiple_of(sector)) && room > sector;
        let apart = a.checked_add(room).zip(b.checked_add(room)).is_some_and(|(end_a, end_b)| {
            let end = if end_a > end_b { end_a } else { end_b };
            (end_a <= b || end_b <= a) && end as usize <= flash_bytes(storage)
        });
        if !whole || !apart {
            return Err(UpdateFault::Layout);
        }
        let limit = Self::capacity(storage);
        if length == 0 || length > limit {
            return Err(UpdateFault::Length { length, limit });
        }
        let refused = self.refused.map(|(slot, ..)| slot);
        let slot = self.slot().or(refused).map_or(Slot::A, Slot::other);
        let start = base(storage, slot);
        storage.flash().erase(start, start + sector).map_err(flash_fault::<S>)?;
        // It may have been the one that is gone now.
        self.refused = self.refused.filter(|(refused, ..)| *refused != slot);
        self.incoming = Some(Incoming { slot, length, crc32, next: 0, written: 0, erased: 0, page: Vec::new() });
        Ok(())
    }

    /// Takes the bytes at `offset` if these are the ones that are expected next. The offset that is expected then comes
    /// back.
    ///
    /// # Errors
    /// [`UpdateFault::NoTransfer`]; [`UpdateFault::Length`] for bytes behind the blob's end, which are not taken;
    /// [`UpdateFault::Flash`], which ends the transfer.
    pub fn write<S: Storage>(&mut self, storage: &mut S, offset: u32, bytes: &[u8]) -> Result<u32, UpdateFault> {
        let incoming = self.incoming.as_mut().ok_or(UpdateFault::NoTransfer)?;
        if offset != incoming.next {
            return Ok(incoming.next);
        }
        let limit = incoming.length;
        let end = u32::try_from(bytes.len()).ok().and_then(|count| offset.checked_add(count)).unwrap_or(u32::MAX);
        if end > limit {
            return Err(UpdateFault::Length { length: end, limit });
        }
        let result = incoming.take(storage, bytes);
        let next = incoming.next;
        if result.is_err() {
            self.incoming = None;
        }
        result.map(|()| next)
    }

    /// Verifies the blob and makes it the active one.
    ///
    /// # Errors
    /// [`UpdateFault::NoTransfer`]; [`UpdateFault::Incomplete`], after which the transfer goes on; else why the blob is
    /// refused, which ends the transfer. The blob that was active stays so.
    pub fn commit<S: Storage>(&mut self, storage: &mut S) -> Result<Blob, UpdateFault> {
        let mut incoming = self.incoming.take().ok_or(UpdateFault::NoTransfer)?;
        let Incoming { slot, length, crc32, next, .. } = incoming;
        if next < length {
            self.incoming = Some(incoming);
            return Err(UpdateFault::Incomplete { next, length });
        }
        incoming.write_page(storage)?;
        // Newer than the one that is refused, too: it is the newest from now on.
        let before = self.refused.map(|(_, header, _)| header).or(self.active.map(|(_, header)| header));
        let sequence = before.map_or(1, |header| header.sequence.wrapping_add(1));
        let header = SlotHeader { sequence, length, crc32 };
        verified(storage, slot, &header)?;

        let mut page: Vec<u8, PAGE> = header.emit().into_iter().collect();
        while !page.len().is_multiple_of(S::Flash::WRITE_SIZE) {
            let _ = page.push(0xFF);
        }
        let start = base(storage, slot);
        storage.flash().write(start, &page).map_err(flash_fault::<S>)?;
        if SlotHeader::parse(storage.mapped(slot)) != Some(header) {
            return Err(UpdateFault::Flash(FlashFault::ReadBack));
        }
        (self.active, self.refused) = (Some((slot, header)), None);
        Ok(header.blob(slot))
    }

    /// Gives the transfer up.
    pub fn abort(&mut self) {
        self.incoming = None;
    }
}

fn flash_bytes<S: Storage>(storage: &mut S) -> usize {
    use embedded_storage::nor_flash::ReadNorFlash;
    storage.flash().capacity()
}
