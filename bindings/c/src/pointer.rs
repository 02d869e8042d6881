//! What can be checked of a pointer from C, and storage that knows whether it was opened.

use core::mem::MaybeUninit;

use crate::error::{mtn_error, mtn_result};

/// `pointer` as a place for one `T`, if it is neither null nor misaligned. `argument`: its position, for the error.
pub(crate) fn place<T>(pointer: *const T, argument: u32) -> Result<*const T, mtn_result> {
    let remainder = pointer.addr() % align_of::<T>();
    if pointer.is_null() {
        Err(mtn_result { index: argument, ..mtn_error::NullPointer.into() })
    } else if remainder != 0 {
        let (found, limit) = (clamped(remainder), clamped(align_of::<T>()));
        Err(mtn_result { index: argument, found, limit, ..mtn_error::Misaligned.into() })
    } else {
        Ok(pointer)
    }
}

/// `count` values at `pointer`; null will do when there are none.
///
/// # Safety
/// The values MUST be initialised and stay unchanged for `'a`, unless the pointer is refused.
pub(crate) unsafe fn slice<'a, T>(pointer: *const T, count: usize, argument: u32) -> Result<&'a [T], mtn_result> {
    if count == 0 {
        return Ok(&[]);
    }
    let pointer = place(pointer, argument)?;
    check_extent(pointer, count, argument)?;
    // SAFETY: not null, aligned, its extent lies inside the address space; the caller vouches for the values.
    Ok(unsafe { core::slice::from_raw_parts(pointer, count) })
}

/// The same for values that are written.
///
/// # Safety
/// The values MUST be initialised and used by nobody else for `'a`, unless the pointer is refused.
pub(crate) unsafe fn slice_mut<'a, T>(pointer: *mut T, count: usize, argument: u32) -> Result<&'a mut [T], mtn_result> {
    if count == 0 {
        return Ok(&mut []);
    }
    check_extent(place(pointer, argument)?, count, argument)?;
    // SAFETY: not null, aligned, its extent lies inside the address space; the caller vouches for the values.
    Ok(unsafe { core::slice::from_raw_parts_mut(pointer, count) })
}

/// Refuses lengths that run over the end of the address space.
fn check_extent<T>(pointer: *const T, count: usize, argument: u32) -> Result<(), mtn_result> {
    let bytes = count.checked_mul(size_of::<T>()).filter(|&bytes| bytes <= isize::MAX as usize);
    match bytes.and_then(|bytes| pointer.addr().checked_add(bytes)) {
        Some(_) => Ok(()),
        None => Err(mtn_result { index: argument, found: clamped(count), ..mtn_error::Length.into() }),
    }
}

/// `number` as C is told it: the largest stands for all that are larger.
pub(crate) fn clamped(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

/// What lies in a caller's storage. The tag depends on the address, so that zeroed, foreign and copied storage is told apart
/// from opened one. It is the first field, so that a pointer to the storage is one to it.
#[repr(C)]
pub(crate) struct Slot<T> {
    tag: usize,
    value: MaybeUninit<T>,
}

const OPEN: usize = 0x6D74_6E01;
const BUSY: usize = 0x6D74_6E02;

impl<T> Slot<T> {
    /// Fills the storage at `slot`.
    ///
    /// # Safety
    /// `slot` MUST be aligned, writable and in use by nobody else.
    pub(crate) unsafe fn open(slot: *mut Self, value: T) {
        let opened = Slot { tag: OPEN ^ slot.addr(), value: MaybeUninit::new(value) };
        // SAFETY: the caller vouches for the place.
        unsafe { slot.write(opened) }
    }

    /// Marks the storage as empty, whatever it holds.
    ///
    /// # Safety
    /// As of [`Slot::open`].
    pub(crate) unsafe fn close(slot: *mut Self) {
        // SAFETY: the caller vouches for the place.
        unsafe { slot.cast::<usize>().write(0) }
    }

    /// What was opened.
    ///
    /// # Safety
    /// `slot` MUST be aligned, readable, and not be changed for `'a`.
    pub(crate) unsafe fn get<'a>(slot: *const Self, argument: u32) -> Result<&'a T, mtn_result> {
        // SAFETY: the caller vouches for the place.
        unsafe { Self::check(slot, argument) }?;
        // SAFETY: the caller vouches for the place.
        let value = unsafe { &(*slot).value };
        // SAFETY: the tag says that a value was written there.
        Ok(unsafe { value.assume_init_ref() })
    }

    /// Runs `work` on what was opened; until it returns, others are told [`mtn_error::Busy`].
    ///
    /// # Safety
    /// `slot` MUST be aligned, writable, and used by no other thread while this runs.
    pub(crate) unsafe fn with<R>(
        slot: *mut Self,
        argument: u32,
        work: impl FnOnce(&mut T) -> Result<R, mtn_result>,
    ) -> Result<R, mtn_result> {
        // SAFETY: the caller vouches for the place.
        unsafe { Self::check(slot, argument) }?;
        // SAFETY: as above; the tag tells whoever else comes to keep away from the value.
        let value = unsafe { &mut (*slot).value };
        // SAFETY: the tag says that a value was written there.
        let value = unsafe { value.assume_init_mut() };
        let tag = slot.cast::<usize>();
        // SAFETY: the first field of a writable place; no reference to it exists.
        unsafe { tag.write(BUSY ^ slot.addr()) };
        let result = work(value);
        // SAFETY: as above.
        unsafe { tag.write(OPEN ^ slot.addr()) };
        result
    }

    /// # Safety
    /// `slot` MUST be aligned and readable.
    unsafe fn check(slot: *const Self, argument: u32) -> Result<(), mtn_result> {
        // SAFETY: the caller vouches for the place; any bits are a tag.
        let tag = unsafe { slot.cast::<usize>().read() };
        let error = match tag ^ slot.addr() {
            OPEN => return Ok(()),
            BUSY => mtn_error::Busy,
            _ => mtn_error::NotOpened,
        };
        Err(mtn_result { index: argument, ..error.into() })
    }
}
