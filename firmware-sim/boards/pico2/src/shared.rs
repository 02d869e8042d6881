//! What the link's interrupt and the thread share.

use core::cell::UnsafeCell;

use cortex_m::peripheral::NVIC;
use embassy_rp::interrupt::Interrupt;

/// A value that the interrupt [`Shared::INTERRUPT`] and the thread share: the thread keeps the interrupt out while it works with it.
pub struct Shared<T> {
    value: UnsafeCell<Option<T>>,
}

// SAFETY: there is one core; the two contexts that reach the value exclude each other, see `in_thread` and `in_interrupt`.
unsafe impl<T: Send> Sync for Shared<T> {}

impl<T> Shared<T> {
    /// The interrupt in which the link runs.
    pub const INTERRUPT: Interrupt = Interrupt::SWI_IRQ_0;

    /// Nothing yet.
    pub const fn new() -> Self {
        Shared { value: UnsafeCell::new(None) }
    }

    /// Puts the value in.
    ///
    /// # Safety
    /// Nobody else uses it yet: the interrupt is not enabled.
    pub unsafe fn set(&self, value: T) {
        // SAFETY: the caller says that nobody else has a reference.
        let slot = unsafe { &mut *self.value.get() };
        *slot = Some(value);
    }

    /// Works with the value in thread mode; the interrupt waits meanwhile.
    ///
    /// # Safety
    /// Called in thread mode only, and `work` does not call it again.
    pub unsafe fn in_thread<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        NVIC::mask(Self::INTERRUPT);
        cortex_m::asm::dsb();
        cortex_m::asm::isb();
        // SAFETY: thread mode is what runs, and the interrupt cannot.
        let value = unsafe { &mut *self.value.get() };
        let result = value.as_mut().map(work);
        // SAFETY: it was enabled before the first call, and nothing here depends on its being masked.
        unsafe { NVIC::unmask(Self::INTERRUPT) };
        result
    }

    /// Works with the value in the interrupt.
    ///
    /// # Safety
    /// Called in that interrupt only, and `work` does not call it again.
    pub unsafe fn in_interrupt<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        // SAFETY: the thread does not run while the interrupt does, and has no reference while the interrupt is not masked.
        let value = unsafe { &mut *self.value.get() };
        value.as_mut().map(work)
    }
}
