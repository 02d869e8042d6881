//! Bodies that are led elsewhere turn to where they go.

use crate::kernels;
use crate::numerics::vector::{Vector, add, subtract};
use crate::representation::Pose;

/// Directions of the path are means over so many frames to either side.
const WINDOW: usize = 15;
/// Bodies slower than about this do not turn, metres a frame.
const SLOW: f32 = 0.008;
/// Bodies step aside by as much as this without turning: cosine and sine of .2 radians.
const ASIDE: Turn = [0.980_066_6, 0.198_669_33];
/// And turn all of the way from twice as much on: its cosine.
const WHOLE: f32 = 0.921_061;
/// No body turns by more from a frame to the next: cosine and sine of .1 radians, 115 degrees a second.
const FASTEST: Turn = [0.995_004_2, 0.099_833_42];

/// A turn about the vertical axis: cosine and sine.
type Turn = [f32; 2];

/// Turns each pose about its pelvis by as much as the direction of its path has turned with what `path` adds to it. Who walks backwards or
/// sideways goes on doing so; who stands stays as it was.
pub fn turn(poses: &mut [Pose], path: &[Vector]) {
    let root = |pose: Option<&Pose>| pose.and_then(|pose| pose.first()).copied().unwrap_or_default();
    // From the way that was generated to the edited one, both over the floor, from frame t - 1 to t.
    let steps = |poses: &[Pose], t: usize| {
        let (Some(last), true) = (t.checked_sub(1), t < poses.len()) else { return [[0.0; 3]; 2] };
        let was = subtract(root(poses.get(t)), root(poses.get(last)));
        let at = |t: usize| path.get(t).copied().unwrap_or_default();
        [was, add(was, subtract(at(t), at(last)))]
    };
    // At the first frame a body faces where it was generated to.
    let mut last: Turn = [1.0, 0.0];
    for t in 1..poses.len() {
        let mut sum: Turn = [SLOW * SLOW * WINDOW as f32, 0.0];
        for offset in 0..=2 * WINDOW {
            let Some(at) = (t + offset).checked_sub(WINDOW) else { continue };
            let away = offset.abs_diff(WINDOW);
            let weight = 1.0 - away as f32 / (WINDOW + 1) as f32;
            let [[ax, _, az], [bx, _, bz]] = steps(poses, at);
            let [c, s] = &mut sum;
            *c += weight * (ax * bx + az * bz);
            *s += weight * (az * bx - ax * bz);
        }
        let [c, s] = sum;
        let length = kernels::sqrt(c * c + s * s);
        if !(length > 1e-9) || !length.is_finite() {
            continue;
        }
        let turn = near(last, taken([c / length, s / length]));
        last = turn;
        if let Some(pose) = poses.get_mut(t) {
            let pelvis = root(Some(pose));
            for joint in pose.iter_mut() {
                *joint = add(pelvis, turned(subtract(*joint, pelvis), turn));
            }
        }
    }
}

/// What bodies turn of a turn of their path.
fn taken([c, s]: Turn) -> Turn {
    let [most, side] = ASIDE;
    if c >= most {
        return [1.0, 0.0];
    }
    if c <= WHOLE {
        return [c, s];
    }
    // Twice of what is beyond the step aside.
    let side = if s < 0.0 { -side } else { side };
    let [c, s] = [c * most + s * side, s * most - c * side];
    [c * c - s * s, 2.0 * c * s]
}

/// `turn`, or as near to it as may be from the frame before.
fn near([a, b]: Turn, [c, s]: Turn) -> Turn {
    let (along, across) = (a * c + b * s, a * s - b * c);
    let [most, side] = FASTEST;
    if along >= most {
        return [c, s];
    }
    let side = if across < 0.0 { -side } else { side };
    [a * most - b * side, b * most + a * side]
}

/// A vector turned about the vertical axis, from +z towards +x.
fn turned([x, y, z]: Vector, [c, s]: Turn) -> Vector {
    [c * x + s * z, y, c * z - s * x]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// A figure that looks where it goes, or somewhere else: its head lies before its pelvis.
    fn figure(at: Vector, looks: Vector) -> Pose {
        let mut pose = [at; 22];
        pose[15] = add(at, looks);
        pose
    }

    #[test]
    fn bodies_look_where_they_are_led() {
        // Straight ahead in +z, led around a circle to the left, +x, in 8 s: 6.3 m of way.
        let (frames, radius) = (160, 1.0);
        for looks in [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]] {
            let mut poses: Vec<Pose> = (0..frames).map(|t| figure([0.0, 1.0, 0.04 * t as f32], looks)).collect();
            let angle = |t: usize| core::f32::consts::TAU * t as f32 / frames as f32;
            let path: Vec<Vector> = (0..frames)
                .map(|t| {
                    let to = [radius * (1.0 - angle(t).cos()), 0.0, radius * angle(t).sin()];
                    subtract(to, [0.0, 0.0, 0.04 * t as f32])
                })
                .collect();
            let before = poses.clone();
            turn(&mut poses, &path);
            for t in 0..frames {
                let seen = subtract(poses[t][15], poses[t][0]);
                assert_eq!(poses[t][0], before[t][0], "the pelvis stays");
                let want = turned(looks, [angle(t).cos(), angle(t).sin()]);
                let off = subtract(seen, want).iter().map(|v| v * v).sum::<f32>().sqrt();
                assert!(!(30..130).contains(&t) || off < 0.12, "frame {t}: {seen:?}, {want:?}");
                assert!((seen.iter().map(|v| v * v).sum::<f32>().sqrt() - 1.0).abs() < 1e-5);
            }
            assert_eq!(poses[0], before[0]);
        }
    }

    #[test]
    fn who_stands_or_goes_on_stays_as_it_was() {
        let mut poses: Vec<Pose> = (0..60).map(|_| figure([0.0, 1.0, 0.0], [0.0, 0.0, 1.0])).collect();
        let before = poses.clone();
        let path: Vec<Vector> = (0..60).map(|t| [0.02 * t as f32, 0.0, 0.0]).collect();
        turn(&mut poses, &path);
        assert_eq!(poses, before);
        let mut poses: Vec<Pose> = (0..60).map(|t| figure([0.0, 1.0, 0.05 * t as f32], [0.0, 0.0, 1.0])).collect();
        let before = poses.clone();
        turn(&mut poses, &[[0.0; 3]; 60]);
        assert_eq!(poses, before);
        turn(&mut poses, &[[f32::INFINITY; 3]; 60]);
        assert!(poses.as_flattened().as_flattened().iter().all(|v| v.is_finite()));
    }
}
