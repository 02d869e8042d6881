//! The one allocator: a bump pointer over the caller's static bytes.
//!
//! A request carves its buffers in a fixed order and gives all of them back at once when it ends. Sizes are computed
//! by the same functions that [`Plan`](crate::Plan) uses, so what the plan says is what is taken.

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

/// Bytes that `count` values of `T` take in an arena, padding included.
#[must_use]
pub const fn bytes_of<T>(count: usize) -> usize {
    (count * size_of::<T>()).next_multiple_of(ALIGNMENT)
}

/// What is left of the caller's bytes.
#[derive(Debug)]
pub struct Arena<'a> {
    free: &'a mut [u8],
    used: usize,
}

impl<'a> Arena<'a> {
    /// An arena over `memory`; bytes before the first [`ALIGNMENT`] boundary are not used.
    #[must_use]
    pub fn new(memory: &'a mut [u8]) -> Self {
        let skip = memory.as_ptr().align_offset(ALIGNMENT);
        let free = memory.get_mut(skip..).unwrap_or(&mut []);
        Arena { free, used: 0 }
    }

    /// The same place once more, for a stage whose buffers the next stages take over when it is done.
    #[must_use]
    pub fn overlay(&mut self) -> Arena<'_> {
        Arena { free: &mut *self.free, used: self.used }
    }

    /// Takes so many bytes as an arena of its own.
    ///
    /// # Errors
    /// [`ArenaTooSmall`] when fewer are left.
    pub fn part(&mut self, bytes: usize) -> Result<Arena<'a>, ArenaTooSmall> {
        Ok(Arena { free: self.take(bytes)?, used: 0 })
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
    pub fn take<T: Pod>(&mut self, count: usize) -> Result<&'a mut [T], ArenaTooSmall> {
        let needed = bytes_of::<T>(count);
        let short = ArenaTooSmall { needed: self.used + needed, available: self.available() };
        let free = core::mem::take(&mut self.free);
        let (taken, free) = free.split_at_mut_checked(needed).ok_or(short)?;
        self.free = free;
        self.used += needed;
        taken.fill(0);
        let values: &mut [T] = bytemuck::try_cast_slice_mut(taken).map_err(|_| short)?;
        values.get_mut(..count).ok_or(short)
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
}
