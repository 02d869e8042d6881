//! How much stack was used: the start-up code paints it, a scan finds the lowest word that is no longer paint.

use core::ptr;

use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    /// First byte above the stack; from the linker script.
    static _stack_start: u32;
    /// Lowest byte the stack may reach; from the linker script.
    static _stack_end: u32;
}

/// Bytes of stack used since reset, this function's frame included.
#[must_use]
pub fn high_water() -> usize {
    let top = &raw const _stack_start;
    let mut lowest = &raw const _stack_end;
    while lowest < top {
        // SAFETY: the words from `_stack_end` to `_stack_start` are RAM that the linker script reserves for the stack; a
        // volatile read of one is defined whatever it holds.
        let word = unsafe { ptr::read_volatile(lowest) };
        if word != STACK_PAINT_VALUE {
            break;
        }
        lowest = lowest.wrapping_add(1);
    }
    top.addr() - lowest.addr()
}
