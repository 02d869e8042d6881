//! The FPU's own square root: one instruction where the loop over bits takes a hundred.

use core::arch::global_asm;

// The compiler gives floating-point registers to no inline assembly of these targets; their ABI passes numbers in them.
global_asm!(
    // The least of the units that such a target has.
    ".fpu fpv4-sp-d16",
    ".section .text.mtn_sqrt, \"ax\", %progbits",
    ".p2align 1",
    ".global mtn_sqrt",
    ".type mtn_sqrt, %function",
    ".thumb_func",
    "mtn_sqrt:",
    "vsqrt.f32 s0, s0",
    "bx lr",
    ".size mtn_sqrt, . - mtn_sqrt",
    ".text",
);

unsafe extern "C" {
    fn mtn_sqrt(x: f32) -> f32;
}

/// See [`super::super::portable::sqrt`]. Both round correctly, so both give the same bits.
#[inline(always)]
#[must_use]
pub fn sqrt(x: f32) -> f32 {
    // SAFETY: it touches nothing but the register of its argument, for any number.
    unsafe { mtn_sqrt(x) }
}
