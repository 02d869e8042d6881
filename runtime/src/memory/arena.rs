//! The one allocator: a bump pointer over the caller's static bytes.
//!
//! A request carves its buffers in a fixed order and gives all of them back at once when it ends. The function that takes buffers is their
//! only declaration: over an arena that measures ([`Arena::measure`]) it takes nothing and counts, and that count is the plan.

use bytemuck::Pod;

/// Every buffer begins on such a boundary, bytes.
pub const ALIGNMENT: usize = 16;

/// The arena is too small for the request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ArenaTooSmall {
    /// Bytes the request needs, from an aligned start.
    pub needed: usize,
    /// Bytes the arena has from its first aligned byte.
    pub available: usize,
}

impl core::fmt::Display for ArenaTooSmall {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let ArenaTooSmall { needed, available } = self;
        write!(
            f,
            "the request needs an arena of {needed} bytes, this one has {available} (from its first 16-byte boundary)"
        )
    }
}

impl core::error::Error for ArenaTooSmall {}

/// Bytes that `count` values of `T` take in an arena, padding included; `usize::MAX` where there are no so many.
#[must_use]
pub const fn bytes_of<T>(count: usize) -> usize {
    match count.saturating_mul(size_of::<T>()).checked_next_multiple_of(ALIGNMENT) {
        Some(bytes) => bytes,
        None => usize::MAX,
    }
}

/// What is left of the caller's bytes.
#[derive(Debug)]
pub struct Arena<'a> {
    free: &'a mut [u8],
    used: usize,
    /// No memory, but as much of it as is asked for: every buffer is empty and counted.
    measures: bool,
}

impl<'a> Arena<'a> {
    /// An arena over `memory`; bytes before the first [`ALIGNMENT`] boundary are not used.
    #[must_use]
    pub fn new(memory: &'a mut [u8]) -> Self {
        let skip = memory.as_ptr().align_offset(ALIGNMENT);
        let free = memory.get_mut(skip..).unwrap_or(&mut []);
        Arena { free, used: 0, measures: false }
    }

    /// Arena bytes that `carve` takes, from an aligned start: it is run over an arena that has no memory, counts, and hands out empty
    /// buffers. `usize::MAX` when there are no so many.
    #[must_use]
    pub fn measure<T>(carve: impl FnOnce(&mut Arena<'static>) -> Result<T, ArenaTooSmall>) -> usize {
        let mut arena = Arena::measuring();
        let carved = carve(&mut arena);
        invariant!(carved.is_ok(), "an arena that measures refuses nothing");
        arena.used
    }

    /// An arena that measures.
    #[must_use]
    pub const fn measuring() -> Arena<'static> {
        Arena { free: &mut [], used: 0, measures: true }
    }

    /// The same place once more, for a stage whose buffers the next stages take over when it is done.
    #[must_use]
    pub fn overlay(&mut self) -> Arena<'_> {
        Arena { free: &mut *self.free, used: self.used, measures: self.measures }
    }

    /// Takes so many bytes as an arena of its own.
    ///
    /// # Errors
    /// [`ArenaTooSmall`] when fewer are left.
    pub fn part(&mut self, bytes: usize) -> Result<Arena<'a>, ArenaTooSmall> {
        Ok(Arena { free: self.take(bytes)?, used: 0, measures: self.measures })
    }

    /// Bytes there are in all, those taken included.
    #[must_use]
    pub const fn available(&self) -> usize {
        self.used + self.free.len()
    }

    /// Bytes taken so far.
    #[must_use]
    pub const fn used(&self) -> usize {
        self.used
    }

    /// Takes `count` values of `T`, all zero.
    ///
    /// # Errors
    /// [`ArenaTooSmall`] when fewer bytes are left.
    // Inlined, its checks would stand at each of some sixty places.
    #[inline(never)]
    pub fn take<T: Pod>(&mut self, count: usize) -> Result<&'a mut [T], ArenaTooSmall> {
        let needed = bytes_of::<T>(count);
        let short = ArenaTooSmall { needed: self.used.saturating_add(needed), available: self.available() };
        let taken = self.claim(needed).ok_or(short)?;
        if self.measures {
            return Ok(&mut []);
        }
        // Without the padding, of which there need not be a whole number of values.
        let taken = taken.get_mut(..count.saturating_mul(size_of::<T>())).ok_or(short)?;
        bytemuck::try_cast_slice_mut(taken).map_err(|_| short)
    }

    /// Takes so many bytes, all zero; none where there are fewer.
    fn claim(&mut self, bytes: usize) -> Option<&'a mut [u8]> {
        if self.measures {
            self.used = self.used.saturating_add(bytes);
            return Some(&mut []);
        }
        let free = core::mem::take(&mut self.free);
        let (taken, free) = free.split_at_mut_checked(bytes)?;
        self.free = free;
        self.used += bytes;
        taken.fill(0);
        Some(taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_aligned_zeroed_disjoint_buffers_and_counts_them() {
        let mut memory = [0xA5u8; 257];
        let mut arena = Arena::new(&mut memory[1..]);
        let a = arena.take::<f32>(3).unwrap();
        let b = arena.take::<i16>(5).unwrap();
        assert!(a.iter().all(|&v| v == 0.0) && b.iter().all(|&v| v == 0));
        assert_eq!(a.as_ptr() as usize % ALIGNMENT, 0);
        assert_eq!(b.as_ptr() as usize % ALIGNMENT, 0);
        assert_eq!(arena.used(), bytes_of::<f32>(3) + bytes_of::<i16>(5));
        a.fill(1.0);
        assert!(b.iter().all(|&v| v == 0));
        assert_eq!(arena.take::<[f32; 3]>(3).map(|rows| rows.len()), Ok(3), "36 bytes in 48");
    }

    #[test]
    fn an_overlay_gives_its_bytes_back() {
        let mut memory = [0u8; 200];
        let mut arena = Arena::new(&mut memory);
        let kept = arena.take::<u8>(16).unwrap();
        let mut overlay = arena.overlay();
        let lent = overlay.take::<u8>(64).unwrap();
        lent.fill(7);
        let place = lent.as_ptr();
        assert_eq!(overlay.used(), 80);
        assert_eq!(arena.used(), 16);
        let again = arena.take::<u8>(32).unwrap();
        assert_eq!(again.as_ptr(), place);
        assert!(again.iter().all(|&v| v == 0));
        kept.fill(1);
        assert!(again.iter().all(|&v| v == 0));
    }

    #[test]
    fn too_small_names_both_numbers() {
        let mut memory = [0u8; 64];
        let mut arena = Arena::new(&mut memory);
        let _ = arena.take::<u8>(16);
        let available = 16 + arena.free.len();
        assert_eq!(arena.take::<f32>(100).unwrap_err(), ArenaTooSmall { needed: 416, available });
    }

    #[test]
    fn what_is_measured_is_what_is_taken() {
        fn carve<'a>(arena: &mut Arena<'a>) -> Result<[&'a mut [f32]; 2], ArenaTooSmall> {
            let first = arena.take::<f32>(3)?;
            arena.overlay().take::<u16>(1000)?;
            Ok([first, arena.part(48)?.take::<f32>(10)?])
        }
        assert_eq!(Arena::measure(|arena| carve(arena)), 16 + 48);
        let mut memory = [0u128; 140];
        let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
        let [_, _] = carve(&mut arena).unwrap();
        assert_eq!(arena.used(), 16 + 48);
        assert_eq!(Arena::measure(|arena| arena.take::<f32>(usize::MAX / 2)), usize::MAX);
        assert_eq!(Arena::measure(|arena| arena.take::<f32>(7).and_then(|_| arena.take::<u8>(usize::MAX))), usize::MAX);
    }
}
