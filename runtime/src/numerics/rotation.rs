//! Unit quaternions, active rotation of column vectors.

use super::vector::{Vector, add, cross, dot, scale, unit};
use crate::kernels;
use core::ops::Mul;

/// A unit quaternion `w + x i + y j + z k`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    w: f32,
    v: Vector,
}

impl Rotation {
    /// The rotation that changes nothing.
    pub const IDENTITY: Rotation = Rotation { w: 1.0, v: [0.0; 3] };

    /// By the angle whose half has this sine and cosine, about a unit axis.
    fn about(axis: Vector, (sin, cos): (f32, f32)) -> Self {
        Rotation { w: cos, v: scale(axis, sin) }
    }

    /// By `angle` radians, at most a turn, about a unit axis.
    #[cfg(any(test, feature = "playback"))]
    #[must_use]
    #[inline(never)]
    pub fn new(axis: Vector, angle: f32) -> Self {
        Self::about(axis, crate::numerics::angle::sin_cos(0.5 * angle))
    }

    /// The inverse.
    #[cfg(feature = "playback")]
    #[must_use]
    pub fn inverse(self) -> Self {
        Rotation { w: self.w, v: scale(self.v, -1.0) }
    }

    /// `v` rotated.
    #[must_use]
    #[inline(never)]
    pub fn apply(self, v: Vector) -> Vector {
        let t = scale(cross(self.v, v), 2.0);
        add(add(v, scale(t, self.w)), cross(self.v, t))
    }

    /// The shortest rotation that takes unit vector `from` to unit vector `to`; half a turn about any axis across when they
    /// are opposite.
    #[must_use]
    #[inline(never)]
    pub fn between(from: Vector, to: Vector) -> Self {
        let w = 1.0 + dot(from, to);
        if w < 1e-6 {
            let [x, ..] = from;
            let across = if x.abs() < 0.5 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
            return Self::about(unit(cross(from, across), [0.0, 0.0, 1.0]), (1.0, 0.0));
        }
        Rotation { w, v: cross(from, to) }.normalised()
    }

    /// The rotation that takes the unit vectors `from = (along, aside)`, perpendicular to each other, to the direction of
    /// `along` and, as nearly as it can then be, to that of `aside`.
    #[cfg(any(test, feature = "playback"))]
    #[must_use]
    #[inline(never)]
    pub fn aligning(from: (Vector, Vector), along: Vector, aside: Vector) -> Self {
        let first = Self::between(from.0, along);
        let turned = first.apply(from.1);
        let across = super::vector::subtract(aside, scale(along, dot(along, aside)));
        let angle = libm::atan2f(dot(along, cross(turned, across)), dot(turned, across));
        Self::new(along, angle) * first
    }

    /// The same rotation with its rounding errors taken out.
    fn normalised(self) -> Self {
        let Rotation { w, v } = self;
        let length = kernels::sqrt(w * w + dot(v, v));
        if length > 0.0 { Rotation { w: w / length, v: scale(v, 1.0 / length) } } else { Self::IDENTITY }
    }
}

impl Mul for Rotation {
    type Output = Rotation;

    /// `self` after `first`.
    #[inline(never)]
    fn mul(self, first: Rotation) -> Rotation {
        let v = add(add(scale(first.v, self.w), scale(self.v, first.w)), cross(self.v, first.v));
        Rotation { w: self.w * first.w - dot(self.v, first.v), v }.normalised()
    }
}
