//! Integer inner loops: int16 activations times int8 weights, int32 accumulators.
//!
//! The portable implementation is the specification. Callers guarantee by the range of the activations
//! ([`crate::nn::quantise::limit`]) that no accumulator can overflow, so every order of summation gives the same bits.

mod portable;

pub use portable::{linear_s16s8, linear_transposed_s16s8};
