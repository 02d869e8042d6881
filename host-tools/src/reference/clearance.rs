//! How near bones come to obstacles, judged in f64 by code of its own: on points along each bone, between frames as well.

use motionette::playback::interpolate::monotone_cubic;
use motionette::representation::skeleton::PARENTS;
use motionette::{Course, Obstacle, Shape};

use crate::motion::Pose;

/// Points along a bone are no farther apart than this, metres.
const SPACING: f64 = 0.05;
/// Moments a frame.
const MOMENTS: u8 = 4;

fn widened(a: [f32; 3]) -> [f64; 3] {
    a.map(f64::from)
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// How far a point is from the surface of an obstacle's shape around its middle, f64.
fn distance(shape: Shape, middle: [f64; 3], p: [f64; 3]) -> f64 {
    let [x, y, z] = [0, 1, 2].map(|i| p[i] - middle[i]);
    let boxed = |sides: &[f64]| {
        let outside = sides.iter().map(|s| s.max(0.0).powi(2)).sum::<f64>().sqrt();
        outside + sides.iter().copied().fold(f64::NEG_INFINITY, f64::max).min(0.0)
    };
    match shape {
        Shape::Sphere { radius } => (x * x + y * y + z * z).sqrt() - f64::from(radius),
        Shape::Capsule { half, radius } => {
            // The nearest of many points on the axis.
            let h = widened(half);
            let nearest = (0..=2000).map(|k| f64::from(k) / 1000.0 - 1.0).map(|s| apart([x, y, z], h.map(|h| s * h)));
            nearest.fold(f64::INFINITY, f64::min) - f64::from(radius)
        }
        Shape::Cylinder { radius, half_height } => {
            boxed(&[x.hypot(z) - f64::from(radius), y.abs() - f64::from(half_height)])
        }
        Shape::Box { half: [a, b, c] } => {
            boxed(&[x.abs() - f64::from(a), y.abs() - f64::from(b), z.abs() - f64::from(c)])
        }
        Shape::Plane { normal } => {
            let n = widened(normal);
            (x * n[0] + y * n[1] + z * n[2]) / apart(n, [0.0; 3])
        }
    }
}

/// Where an obstacle's middle is, at a frame and a share of the next.
fn middle(course: Course<'_>, at: f64, rate: f64) -> [f64; 3] {
    match course {
        Course::Still(place) => widened(place),
        Course::Moving { from, velocity } => [0, 1, 2].map(|i| f64::from(from[i]) + f64::from(velocity[i]) * at / rate),
        Course::Keyframes(keys) => {
            let (first, last) = (keys[0], keys[keys.len() - 1]);
            let at = at.clamp(f64::from(first.frame), f64::from(last.frame));
            for pair in keys.windows(2) {
                let [a, b] = [pair[0], pair[1]].map(|key| f64::from(key.frame));
                if at <= b {
                    let share = (at - a) / (b - a);
                    let place = |i: usize| {
                        f64::from(pair[0].position[i]) * (1.0 - share) + f64::from(pair[1].position[i]) * share
                    };
                    return [0, 1, 2].map(place);
                }
            }
            widened(last.position)
        }
    }
}

/// How near bones come to an obstacle's surface, metres, negative inside: a point every 5 cm, at four moments a frame of the cubic that a player goes
/// along. `frames`: metres, `frame_rate` a second.
#[must_use]
pub fn least(frames: &[Pose], obstacle: &Obstacle<'_>, frame_rate: f64) -> f64 {
    let mut least = f64::INFINITY;
    let at = |t: usize, joint: usize| frames[t.min(frames.len() - 1)][joint];
    for t in 0..frames.len() {
        for moment in 0..MOMENTS {
            if t + 1 == frames.len() && moment > 0 {
                break;
            }
            let share = f32::from(moment) / f32::from(MOMENTS);
            let mut pose: Pose = [[0.0; 3]; 22];
            for (joint, slot) in pose.iter_mut().enumerate() {
                for axis in 0..3 {
                    let points = [t.saturating_sub(1), t, t + 1, t + 2].map(|t| at(t, joint)[axis]);
                    slot[axis] = monotone_cubic(points, share);
                }
            }
            let place = middle(obstacle.course, t as f64 + f64::from(share), frame_rate);
            for joint in 1..22 {
                let (a, b) = (widened(pose[usize::from(PARENTS[joint])]), widened(pose[joint]));
                let steps = (apart(a, b) / SPACING).ceil().max(1.0) as usize;
                for step in 0..=steps {
                    let s = step as f64 / steps as f64;
                    let point = [0, 1, 2].map(|i| a[i] * (1.0 - s) + b[i] * s);
                    least = least.min(distance(obstacle.shape, place, point));
                }
            }
        }
    }
    least
}
