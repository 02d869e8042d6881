//! Activations of feed-forward layers.

use crate::blob::Activation;

/// `x <- f(x)`: ReLU, or GELU in its exact form `x/2 (1 + erf(x / sqrt 2))`.
#[inline(never)]
pub fn apply(activation: Activation, x: &mut [f32]) {
    match activation {
        Activation::Relu => {
            for x in x {
                *x = if *x > 0.0 { *x } else { 0.0 };
            }
        }
        Activation::Gelu => {
            for x in x {
                *x = 0.5 * *x * (1.0 + libm::erff(*x * core::f32::consts::FRAC_1_SQRT_2));
            }
        }
    }
}
