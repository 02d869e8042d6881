//! Integer inner loops: int16 activations times int8 or 4-bit weights, int32 accumulators; and the square root.
//!
//! The portable implementation is the specification and what every other target runs. Cortex-M cores with the DSP extension
//! or MVE have loops in assembly, with MVE for the rounding of activations, too. x86-64 has AVX2, AVX-VNNI and AVX-512 variants,
//! of which the best that processor and system support is chosen at the first call; there the loops over f32 around the integers
//! gain from wide registers as well: [`widened`].
//! Callers guarantee by the range of the activations ([`crate::nn::quantise::limit`]) that no accumulator can overflow,
//! and all variants wrap where one does, so every order of summation gives the same bits.
//!
//! `acc` may be longer than the accumulators: what lies behind them is a variant's to work in, [`room`] numbers of it if
//! it shall not be slowed down, and holds anything afterwards.

#[cfg(any(kernels, fpu))]
mod arm;
#[cfg(any(test, feature = "check-kernels"))]
pub mod check;
#[cfg(feature = "count")]
pub mod count;
mod portable;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use chosen::{largest_magnitude, round_scaled, sqrt};
#[cfg(not(feature = "count"))]
pub use chosen::{linear_s16s4, linear_s16s8, linear_transposed_s16s8};
#[cfg(feature = "count")]
pub use count::{linear_s16s4, linear_s16s8, linear_transposed_s16s8};
#[cfg(not(target_arch = "x86_64"))]
pub use portable::widened;
pub use portable::{GROUP, GROUP_BYTES, relu, round, unpacked};
#[cfg(target_arch = "x86_64")]
pub use x86::widened;

/// [`relu`] of a word's numbers.
#[inline(always)]
pub fn relu_word(x: &mut [f32; 32]) -> u32 {
    #[cfg(target_arch = "x86_64")]
    return x86::relu_word(x);
    #[cfg(not(target_arch = "x86_64"))]
    relu(x)
}

/// Runs an elementwise loop, compiled for the widest registers of the machine: [`widened`] of a body that the compiler cannot leave
/// outside, where it would be compiled for any machine.
macro_rules! wide {
    ($body:expr) => {
        $crate::kernels::widened(
            #[inline(always)]
            || $body,
        )
    };
}
pub(crate) use wide;

/// What this target runs.
mod chosen {
    #[cfg(fpu)]
    pub use super::arm::sqrt;
    #[cfg(kernels = "mve")]
    pub use super::arm::{largest_magnitude, round_scaled};
    #[cfg(kernels)]
    pub use super::arm::{linear_s16s4, linear_s16s8, linear_transposed_s16s8};
    #[cfg(not(fpu))]
    pub use super::portable::sqrt;
    #[cfg(not(kernels = "mve"))]
    pub use super::portable::{largest_magnitude, round_scaled};
    #[cfg(not(any(kernels, target_arch = "x86_64")))]
    pub use super::portable::{linear_s16s4, linear_s16s8, linear_transposed_s16s8};
    #[cfg(target_arch = "x86_64")]
    pub use super::x86::{linear_s16s4, linear_s16s8, linear_transposed_s16s8};
}

/// Numbers behind the accumulators with which every variant is as fast as it can be, for `rows` rows of `terms` terms a
/// sum: `inputs`, or `outputs` where the weights are transposed. The same on all targets, so that a plan holds on all.
#[must_use]
pub const fn room(rows: usize, terms: usize) -> usize {
    // Cortex-M DSP packs rows by four as int16, and as much of the weights.
    if rows == 0 { 0 } else { 2 * (rows.div_ceil(4) + 1) * 4 * terms.div_ceil(4) }
}
