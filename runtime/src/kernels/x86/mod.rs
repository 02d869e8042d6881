//! x86-64: AVX2, AVX2 with AVX-VNNI, and AVX-512 with VNNI.
#![allow(unsafe_code)]

mod avx2;
mod avx512;
mod detect;
mod panel;
mod rows;

use super::portable;
use core::arch::x86_64::*;
pub use detect::Isa;

/// `portable::linear_s16s8`, as fast as this machine can.
#[inline]
pub fn linear_s16s8(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    Isa::best().linear_s16s8(x, w, inputs, outputs, acc);
}

/// `portable::linear_s16s4`, as fast as this machine can.
#[inline]
pub fn linear_s16s4(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    Isa::best().linear_s16s4(x, w, inputs, outputs, acc);
}

/// `portable::linear_transposed_s16s8`, as fast as this machine can.
#[inline]
pub fn linear_transposed_s16s8(g: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    Isa::best().linear_transposed_s16s8(g, w, inputs, outputs, acc);
}

/// Runs an elementwise loop, compiled for the widest registers of the machine. The compiler neither reorders nor joins
/// floating-point operations, so the bits do not depend on the width.
#[inline(always)]
pub fn widened<R>(body: impl FnOnce() -> R) -> R {
    match Isa::best() {
        Isa::Portable => body(),
        // SAFETY: `best` returns only what processor and system support, and AVX-512 includes AVX2.
        Isa::Avx2 | Isa::AvxVnni | Isa::Avx512 => unsafe { avx2::widened(body) },
    }
}

/// `portable::relu` of a word's numbers: what the compiler makes of that takes four times as long.
#[inline(always)]
pub fn relu_word(x: &mut [f32; 32]) -> u32 {
    // SAFETY: every x86-64 processor has SSE.
    unsafe { relu_word_sse(x) }
}

#[inline]
#[target_feature(enable = "sse")]
fn relu_word_sse(x: &mut [f32; 32]) -> u32 {
    let mut bits = 0;
    for (i, four) in x.as_chunks_mut::<4>().0.iter_mut().enumerate() {
        // SAFETY: the array has the 16 bytes that are read.
        let v = unsafe { _mm_loadu_ps(four.as_ptr()) };
        let positive = _mm_cmpgt_ps(v, _mm_setzero_ps());
        let kept = _mm_and_ps(v, positive);
        // SAFETY: the array has the 16 bytes that are written.
        unsafe { _mm_storeu_ps(four.as_mut_ptr(), kept) };
        bits |= (_mm_movemask_ps(positive) as u32) << (4 * i);
    }
    bits
}

impl Isa {
    /// `portable::linear_s16s8` by these instructions, or by the best that there are if these are missing.
    pub fn linear_s16s8(self, x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
        match self.supported() {
            Isa::Portable => portable::linear_s16s8(x, w, inputs, outputs, acc),
            // SAFETY: `supported` returns only what processor and system support.
            Isa::Avx2 => unsafe { avx2::linear_s16s8::<false>(x, w, inputs, outputs, acc) },
            // SAFETY: as above.
            Isa::AvxVnni => unsafe { avx2::linear_s16s8::<true>(x, w, inputs, outputs, acc) },
            // SAFETY: as above.
            Isa::Avx512 => unsafe { avx512::linear_s16s8(x, w, inputs, outputs, acc) },
        }
    }

    /// `portable::linear_s16s4` by these instructions, or by the best that there are if these are missing.
    pub fn linear_s16s4(self, x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
        match self.supported() {
            Isa::Portable => portable::linear_s16s4(x, w, inputs, outputs, acc),
            // SAFETY: `supported` returns only what processor and system support.
            Isa::Avx2 | Isa::AvxVnni => unsafe { avx2::linear_s16s4(x, w, inputs, outputs, acc) },
            // SAFETY: as above.
            Isa::Avx512 => unsafe { avx512::linear_s16s4(x, w, inputs, outputs, acc) },
        }
    }

    /// `portable::linear_transposed_s16s8` by these instructions, or by the best that there are if these are missing.
    pub fn linear_transposed_s16s8(self, g: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
        match self.supported() {
            Isa::Portable => portable::linear_transposed_s16s8(g, w, inputs, outputs, acc),
            // SAFETY: `supported` returns only what processor and system support.
            Isa::Avx2 => unsafe { avx2::linear_transposed_s16s8::<false>(g, w, inputs, outputs, acc) },
            // SAFETY: as above.
            Isa::AvxVnni => unsafe { avx2::linear_transposed_s16s8::<true>(g, w, inputs, outputs, acc) },
            // SAFETY: as above.
            Isa::Avx512 => unsafe { avx512::linear_transposed_s16s8(g, w, inputs, outputs, acc) },
        }
    }
}
