//! Activations of feed-forward layers.

use crate::blob::Activation;
use crate::kernels;

/// `x <- f(x)`: ReLU, or GELU in its exact form `x/2 (1 + erf(x / sqrt 2))`.
#[inline(never)]
pub fn apply(activation: Activation, x: &mut [f32]) {
    match activation {
        Activation::Relu => {
            for x in x {
                *x = if *x > 0.0 { *x } else { 0.0 };
            }
        }
        Activation::Gelu => kernels::gelu(x),
    }
}
