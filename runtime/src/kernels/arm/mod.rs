//! Cortex-M: the DSP extension's two multiply-accumulates an instruction, or MVE's eight; the FPU's square root.
#![allow(unsafe_code)]

#[cfg(kernels = "dsp")]
mod dsp;
#[cfg(fpu)]
mod fpu;
#[cfg(kernels = "mve")]
mod mve;

#[cfg(kernels = "dsp")]
pub use dsp::{linear_s16s4, linear_s16s8, linear_transposed_s16s8};
#[cfg(fpu)]
pub use fpu::sqrt;
#[cfg(kernels = "mve")]
pub use mve::{largest_magnitude, linear_s16s4, linear_s16s8, linear_transposed_s16s8, round_scaled};
