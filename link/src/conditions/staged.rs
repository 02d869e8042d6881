//! Conditions on their way into the memory that the firmware sets aside for them.

use motionette::blob::crc32;

use super::{Conditions, LEAST_BYTES};
use crate::message::{ConditionsFault, Transfer};

/// What was announced, and how much of it has come.
#[derive(Debug, Clone, Copy)]
struct Incoming {
    length: u32,
    crc32: u32,
    next: u32,
}

/// How far the conditions of a session have come. The memory is the device's, who hands it over each time.
#[derive(Debug, Default)]
pub struct Staged {
    incoming: Option<Incoming>,
}

impl Staged {
    /// Nothing has come.
    pub const EMPTY: Self = Staged { incoming: None };

    /// Bytes that have come, and all bytes.
    #[must_use]
    pub fn transfer(&self) -> Option<Transfer> {
        self.incoming.map(|it| Transfer { next: it.next, length: it.length })
    }

    /// Begins anew, with conditions of `length` bytes.
    ///
    /// # Errors
    /// [`ConditionsFault::Length`]; what was staged before stays.
    pub fn begin(&mut self, area: &[u32], length: u32, crc32: u32) -> Result<(), ConditionsFault> {
        let limit = limit(area);
        if (length as usize) < LEAST_BYTES || length > limit || !length.is_multiple_of(4) {
            return Err(ConditionsFault::Length { length, limit });
        }
        self.incoming = Some(Incoming { length, crc32, next: 0 });
        Ok(())
    }

    /// Takes the bytes at `offset` if these are the ones that are expected next. The offset that is expected then comes back.
    ///
    /// # Errors
    /// [`ConditionsFault::NotSent`] without a beginning; [`ConditionsFault::Length`] for bytes behind the end, which are not taken.
    pub fn write(&mut self, area: &mut [u32], offset: u32, bytes: &[u8]) -> Result<u32, ConditionsFault> {
        let incoming = self.incoming.as_mut().ok_or(ConditionsFault::NotSent)?;
        if offset != incoming.next {
            return Ok(incoming.next);
        }
        let limit = incoming.length;
        let end = u32::try_from(bytes.len()).ok().and_then(|count| offset.checked_add(count)).unwrap_or(u32::MAX);
        let whole: &mut [u8] = bytemuck::try_cast_slice_mut(area).unwrap_or_default();
        match whole.get_mut(offset as usize..end as usize) {
            Some(room) if end <= limit => room.copy_from_slice(bytes),
            _ => return Err(ConditionsFault::Length { length: end, limit }),
        }
        incoming.next = end;
        Ok(end)
    }

    /// The conditions, if they have come whole and are of the format that is read.
    ///
    /// # Errors
    /// [`ConditionsFault::NotSent`]; [`ConditionsFault::Incomplete`], after which the rest may come; [`ConditionsFault::Checksum`] and
    /// [`ConditionsFault::Format`], after which they have to be sent anew.
    pub fn whole<'c>(&mut self, area: &'c [u32]) -> Result<Conditions<'c>, ConditionsFault> {
        let Incoming { length, crc32: announced, next } = self.incoming.ok_or(ConditionsFault::NotSent)?;
        if next < length {
            return Err(ConditionsFault::Incomplete { next, length });
        }
        let opened = check(area, length, announced);
        if opened.is_err() {
            self.abort();
        }
        opened
    }

    /// Gives up what is staged.
    pub const fn abort(&mut self) {
        self.incoming = None;
    }
}

/// Bytes of `area`.
fn limit(area: &[u32]) -> u32 {
    u32::try_from(size_of_val(area)).unwrap_or(u32::MAX)
}

fn check(area: &[u32], length: u32, announced: u32) -> Result<Conditions<'_>, ConditionsFault> {
    let limit = limit(area);
    let bytes: &[u8] = bytemuck::try_cast_slice(area).unwrap_or_default();
    // Another memory than the bytes went to.
    let bytes = bytes.get(..length as usize).ok_or(ConditionsFault::Length { length, limit })?;
    let computed = !crc32(!0, bytes);
    if computed != announced {
        return Err(ConditionsFault::Checksum { computed, announced });
    }
    let conditions = Conditions::open(area)?;
    if conditions.bytes() == length as usize { Ok(conditions) } else { Err(ConditionsFault::Format { at: 0 }) }
}
