//! Activations of feed-forward layers.

use super::exp::gelu;
use crate::kernels::wide;
use serde::Serialize;

/// Activation of a feed-forward layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Activation {
    /// `max(x, 0)`
    Relu,
    /// `x/2 (1 + erf(x / sqrt 2))`
    Gelu,
}

/// `x <- f(x)`: ReLU, or GELU `x/2 (1 + erf(x / sqrt 2))`.
#[inline(never)]
pub fn apply(activation: Activation, x: &mut [f32]) {
    match activation {
        Activation::Relu => {
            for x in x {
                *x = if *x > 0.0 { *x } else { 0.0 };
            }
        }
        Activation::Gelu => wide!({
            for x in x {
                *x = gelu(*x);
            }
        }),
    }
}
