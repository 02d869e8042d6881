//! Integer inner loops: int16 activations times int8 weights, int32 accumulators.
//!
//! The portable implementation is the specification and what every other target runs. x86-64 adds AVX2 and AVX-512
//! variants, of which the best that processor and system support is chosen at the first call. There the loops over f32
//! around the integers gain from wide registers as well: [`wide`], [`exponentials`], [`gelu`].
//! Callers guarantee by the range of the activations ([`crate::nn::quantise::limit`]) that no accumulator can overflow,
//! and all variants wrap where one does, so every order of summation gives the same bits.

mod portable;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(not(target_arch = "x86_64"))]
pub use portable::{exponentials, gelu, linear_s16s8, linear_transposed_s16s8, wide};
#[cfg(target_arch = "x86_64")]
pub use x86::{exponentials, gelu, linear_s16s8, linear_transposed_s16s8, wide};
