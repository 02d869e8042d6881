//! Rotations as the angles a BVH file holds.

use crate::motion::quaternion::{self as q, Quaternion};

/// Angles `[z, x, y]` in degrees with `R = Rz Rx Ry`, of all such triples the one nearest to `before`: curves stay continuous, so
/// programs that interpolate angles do not spin. Where x is +-90 degrees only the sum of z and y is determined and z takes all of it.
pub(super) fn zxy(rotation: Quaternion, before: [f64; 3]) -> [f64; 3] {
    let x_axis = q::rotate(rotation, [1.0, 0.0, 0.0]);
    let y_axis = q::rotate(rotation, [0.0, 1.0, 0.0]);
    let z_axis = q::rotate(rotation, [0.0, 0.0, 1.0]);
    let cos = y_axis[0].hypot(y_axis[1]);
    let x = y_axis[2].atan2(cos);
    let (z, y) = if cos < 1e-9 {
        (x_axis[1].atan2(x_axis[0]), 0.0)
    } else {
        ((-y_axis[0]).atan2(y_axis[1]), (-x_axis[2]).atan2(z_axis[2]))
    };
    let direct = [z, x, y].map(f64::to_degrees);
    let flipped = [direct[0] + 180.0, 180.0 - direct[1], direct[2] + 180.0];
    let [direct, flipped] = [direct, flipped].map(|angles| near(angles, before));
    if distance(flipped, before) < distance(direct, before) { flipped } else { direct }
}

/// Whole turns added to each angle so that it comes within half a turn of the one before.
fn near(angles: [f64; 3], before: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| angles[i] - 360.0 * ((angles[i] - before[i]) / 360.0).round())
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn compose([z, x, y]: [f64; 3]) -> Quaternion {
        let about = |axis, degrees: f64| q::about(axis, degrees.to_radians());
        q::multiply(about([0.0, 0.0, 1.0], z), q::multiply(about([1.0, 0.0, 0.0], x), about([0.0, 1.0, 0.0], y)))
    }

    #[test]
    fn angles_give_the_rotation_back_in_all_octants_and_at_the_pole() {
        for z in [-170.0, -60.0, 0.0, 45.0, 179.0] {
            for x in [-90.0, -89.999_999, -30.0, 0.0, 80.0, 90.0, 120.0] {
                for y in [-150.0, -20.0, 0.0, 100.0] {
                    let turn = compose([z, x, y]);
                    let found = compose(zxy(turn, [0.0; 3]));
                    let same: f64 = turn.iter().zip(found).map(|(a, b)| a * b).sum();
                    assert!(same.abs() > 1.0 - 1e-12, "{z} {x} {y}");
                }
            }
        }
    }

    #[test]
    fn angles_continue_past_half_a_turn_and_over_the_pole() {
        let mut before = [0.0; 3];
        for step in 1..=100 {
            let wanted = [10.0 * f64::from(step), 1.7 * f64::from(step), -4.0 * f64::from(step)];
            before = zxy(compose(wanted), before);
            for (found, wanted) in before.iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-9, "step {step}: {before:?}");
            }
        }
    }
}
