//! Solid bodies: how far points are from them, and the way out.

use crate::kernels;
use crate::numerics::vector::{Vector, add, dot, length, scale, subtract, unit};

/// A way straight away from a surface is looked for no farther than this, metres.
const FARTHEST: f32 = 10.0;
/// Steps along a way out at most; each is as long as what is still missing.
const STEPS: usize = 24;
/// It is out when no more than this is missing, metres.
const OUT: f32 = 0.0005;

/// The form of a body, around its middle.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Shape {
    /// All points no farther from the middle than `radius`, metres.
    Sphere {
        /// Metres.
        radius: f32,
    },
    /// All points no farther than `radius` from the stretch that reaches from the middle by `half` both ways.
    Capsule {
        /// From the middle to one end, metres.
        half: Vector,
        /// Metres.
        radius: f32,
    },
    /// A pillar that stands upright.
    Cylinder {
        /// Metres.
        radius: f32,
        /// Half of its height, metres.
        half_height: f32,
    },
    /// A box with sides along the axes.
    Box {
        /// Half of each side, metres.
        half: Vector,
    },
    /// All that lies behind a plane through the middle.
    Plane {
        /// Which way is free; of any length but none.
        normal: Vector,
    },
}

/// A body at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    /// Its form.
    pub shape: Shape,
    /// Its middle, metres.
    pub middle: Vector,
    /// Others keep so far away from its surface, metres.
    pub margin: f32,
}

impl Solid {
    /// How far a point is from the surface, metres; negative inside. Never changes by more than the point moves.
    pub fn distance(&self, point: Vector) -> f32 {
        let [x, y, z] = subtract(point, self.middle);
        let larger = |a: f32, b: f32| if a > b { a } else { b };
        match self.shape {
            Shape::Sphere { radius } => length([x, y, z]) - radius,
            Shape::Capsule { half, radius } => {
                let square = dot(half, half);
                let along = if square > 0.0 { dot([x, y, z], half) / square } else { 0.0 };
                let along = if along > 1.0 { 1.0 } else { larger(along, -1.0) };
                length(subtract([x, y, z], scale(half, along))) - radius
            }
            Shape::Cylinder { radius, half_height } => {
                boxed([kernels::sqrt(x * x + z * z) - radius, libm::fabsf(y) - half_height, -1e9])
            }
            Shape::Box { half: [a, b, c] } => boxed([libm::fabsf(x) - a, libm::fabsf(y) - b, libm::fabsf(z) - c]),
            Shape::Plane { normal } => dot([x, y, z], unit(normal, [0.0, 1.0, 0.0])),
        }
    }

    /// How far a point is beyond the margin, metres; negative where it is too near.
    pub fn clearance(&self, point: Vector) -> f32 {
        self.distance(point) - self.margin
    }

    /// The direction in which the distance grows most.
    pub fn away(&self, point: Vector) -> Vector {
        const STEP: f32 = 1e-3;
        let change = |by: Vector| self.distance(add(point, by)) - self.distance(subtract(point, by));
        unit([change([STEP, 0.0, 0.0]), change([0.0, STEP, 0.0]), change([0.0, 0.0, STEP])], [0.0, 1.0, 0.0])
    }

    /// How far a point goes in a direction until it is clear, metres; `None` where that is farther than `most`.
    pub fn way_out(&self, point: Vector, direction: Vector, most: f32) -> Option<f32> {
        let mut way = 0.0;
        for _ in 0..STEPS {
            let missing = -self.clearance(add(point, scale(direction, way)));
            if missing <= OUT {
                return Some(way);
            }
            way += missing;
            if way > most {
                break;
            }
        }
        None
    }

    /// What takes a point out of the body and its margin, metres: along `side` for no more than `most`, or straight away where that leads nowhere.
    pub fn push(&self, point: Vector, side: Vector, most: f32) -> Vector {
        if self.clearance(point) >= -OUT {
            return [0.0; 3];
        }
        if let Some(way) = self.way_out(point, side, most) {
            return scale(side, way);
        }
        let away = self.away(point);
        scale(away, self.way_out(point, away, FARTHEST).unwrap_or(0.0))
    }
}

/// The distance from a box, of how far a point is beyond its sides on each axis.
fn boxed([a, b, c]: Vector) -> f32 {
    let above = |v: f32| if v > 0.0 { v } else { 0.0 };
    let outside = length([above(a), above(b), above(c)]);
    let mut inside = if a > b { a } else { b };
    inside = if inside > c { inside } else { c };
    outside + if inside < 0.0 { inside } else { 0.0 }
}
