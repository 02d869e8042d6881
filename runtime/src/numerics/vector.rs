//! Vectors `[x, y, z]`.

use crate::kernels;

/// Metres or a direction.
pub type Vector = [f32; 3];

pub(crate) fn subtract(a: Vector, b: Vector) -> Vector {
    let ([ax, ay, az], [bx, by, bz]) = (a, b);
    [ax - bx, ay - by, az - bz]
}

pub(crate) fn add(a: Vector, b: Vector) -> Vector {
    let ([ax, ay, az], [bx, by, bz]) = (a, b);
    [ax + bx, ay + by, az + bz]
}

pub(crate) fn scale(a: Vector, by: f32) -> Vector {
    a.map(|a| a * by)
}

pub(crate) fn dot(a: Vector, b: Vector) -> f32 {
    let ([ax, ay, az], [bx, by, bz]) = (a, b);
    ax * bx + ay * by + az * bz
}

pub(crate) fn cross(a: Vector, b: Vector) -> Vector {
    let ([ax, ay, az], [bx, by, bz]) = (a, b);
    [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
}

/// Euclidean length.
pub(crate) fn length(a: Vector) -> f32 {
    kernels::sqrt(dot(a, a))
}

/// The vector with length 1, or `otherwise` when it has none.
#[inline(never)]
pub(crate) fn unit(a: Vector, otherwise: Vector) -> Vector {
    let length = length(a);
    if length > 1e-6 { scale(a, 1.0 / length) } else { otherwise }
}
