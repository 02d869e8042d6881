//! Anchors as frame features of the planner's anchor context (EQUATIONS section 2).
//!
//! Controlled components: the pelvis on the ground plane (x and z), its height, and joints 1 to 21 in space; 66 values in all, value
//! `3 joint + axis`. Each component has its own knots: the anchors that fix it. Between them runs the interpolation prior `p`,
//! defined from the first knot to the last: a natural cubic spline through four knots or more, straight lines through fewer.
//!
//! `c[t] = [ma a | mp p | rate dp | mp | ma]`, values as `(metres - mean) / std`, differences as metres a second by `std`, all three kept
//! within [`LIMIT`] (nothing that a planner was trained on lies beyond). At a knot `p` is the anchor's value to the bit.

use super::anchors::Anchor;
use super::real::Real;
pub use crate::checkpoint::anchors::{COMPONENTS, Statistics, VALUES, WIDTH};

/// Largest magnitude of a feature.
pub const LIMIT: f64 = 16.0;

/// Values of a component: place of the first and distance to the next, how many.
fn values_of(component: usize) -> Vec<usize> {
    match component {
        0 => vec![0, 2],
        1 => vec![1],
        joint => (0..3).map(|axis| 3 * (joint - 1) + axis).collect(),
    }
}

/// Frames and values of a component's knots.
struct Knots {
    frames: Vec<usize>,
    /// One row a value of the component.
    values: Vec<Vec<f64>>,
}

fn knots(anchors: &[Anchor], component: usize) -> Knots {
    let holds = |anchor: &&Anchor| match component {
        0 => anchor.joint() == 0,
        1 => anchor.joint() == 0 && anchor.fixes_height(),
        joint => anchor.joint() == joint - 1,
    };
    let mut holding: Vec<&Anchor> = anchors.iter().filter(holds).collect();
    holding.sort_by_key(|anchor| anchor.frame);
    holding.dedup_by_key(|anchor| anchor.frame);
    let value = |place: usize| holding.iter().map(|anchor| anchor.position()[place % 3]).collect();
    Knots {
        frames: holding.iter().map(|anchor| anchor.frame).collect(),
        values: values_of(component).into_iter().map(value).collect(),
    }
}

/// The curve through `(frames, values)` at every frame from the first knot to the last.
pub fn interpolate(frames: &[usize], values: &[f64]) -> Vec<f64> {
    let bends = second_derivatives(frames, values);
    let mut curve = Vec::new();
    for i in 1..frames.len() {
        let h = (frames[i] - frames[i - 1]) as f64;
        for t in frames[i - 1]..frames[i] {
            let b = (t - frames[i - 1]) as f64 / h;
            let a = 1.0 - b;
            let bend = (a * a * a - a) * bends[i - 1] + (b * b * b - b) * bends[i];
            let straight = if b == 0.0 { values[i - 1] } else { a * values[i - 1] + b * values[i] };
            curve.push(straight + bend * h * h / 6.0);
        }
    }
    curve.extend(values.last());
    curve
}

/// Second derivatives at the knots of a natural cubic spline; zero with fewer than four.
fn second_derivatives(frames: &[usize], values: &[f64]) -> Vec<f64> {
    let n = frames.len();
    let mut bends = vec![0.0; n];
    if n < 4 {
        return bends;
    }
    let h: Vec<f64> = frames.windows(2).map(|f| (f[1] - f[0]) as f64).collect();
    let slope: Vec<f64> = values.windows(2).zip(&h).map(|(v, h)| (v[1] - v[0]) / h).collect();
    // h[i-1] m[i-1] + 2 (h[i-1] + h[i]) m[i] + h[i] m[i+1] = 6 (slope[i] - slope[i-1]), eliminated downwards.
    let (mut diagonal, mut right) = (vec![1.0; n], vec![0.0; n]);
    for i in 1..n - 1 {
        let factor = if i == 1 { 0.0 } else { h[i - 1] / diagonal[i - 1] };
        diagonal[i] = 2.0 * (h[i - 1] + h[i]) - factor * h[i - 1];
        right[i] = 6.0 * (slope[i] - slope[i - 1]) - factor * right[i - 1];
    }
    for i in (1..n - 1).rev() {
        bends[i] = (right[i] - h[i] * bends[i + 1]) / diagonal[i];
    }
    bends
}

/// Frame features `c [frames][WIDTH]` of anchors inside the motion.
pub fn features<T: Real>(anchors: &[Anchor], frames: usize, rate: f64, statistics: &Statistics) -> Vec<T> {
    let mut c = vec![T::ZERO; frames * WIDTH];
    let limited = |x: f64| T::from_f64(x.clamp(-LIMIT, LIMIT));
    for component in 0..COMPONENTS {
        let Knots { frames: at, values } = knots(anchors, component);
        let (Some(&first), Some(&last)) = (at.first(), at.last()) else { continue };
        for (place, values) in values_of(component).into_iter().zip(&values) {
            let (mean, std) = (f64::from(statistics.mean[place]), f64::from(statistics.std[place]));
            let curve = interpolate(&at, values);
            for (i, p) in curve.iter().enumerate() {
                let row = &mut c[(first + i) * WIDTH..][..WIDTH];
                row[VALUES + place] = limited((p - mean) / std);
                let before = if i == 0 { *p } else { curve[i - 1] };
                row[2 * VALUES + place] = limited(rate * (p - before) / std);
            }
            for (t, value) in at.iter().zip(values) {
                c[t * WIDTH + place] = limited((value - mean) / std);
            }
        }
        for t in first..=last {
            c[t * WIDTH + 3 * VALUES + component] = T::ONE;
        }
        for t in at {
            c[t * WIDTH + 3 * VALUES + COMPONENTS + component] = T::ONE;
        }
    }
    c
}

#[cfg(test)]
mod tests {
    use super::super::anchors::Target;
    use super::*;

    fn root(frame: usize, position: [f64; 3]) -> Anchor {
        Anchor { frame, target: Target::Root(position) }
    }

    /// A dense solve of the conditions that make a cubic spline: values, continuous slopes and bends, no bend at the ends.
    #[test]
    fn curves_are_natural_cubic_splines() {
        let (frames, values) = ([3usize, 7, 8, 20, 31], [0.3f64, -0.4, 0.1, 2.0, 1.0]);
        let n = frames.len() - 1;
        let unknowns = 4 * n;
        let mut rows: Vec<(Vec<f64>, f64)> = Vec::new();
        let power = |x: f64, derivative: usize| -> [f64; 4] {
            match derivative {
                0 => [1.0, x, x * x, x * x * x],
                1 => [0.0, 1.0, 2.0 * x, 3.0 * x * x],
                _ => [0.0, 0.0, 2.0, 6.0 * x],
            }
        };
        let mut condition = |parts: &[(usize, f64, usize, f64)], right: f64| {
            let mut row = vec![0.0; unknowns];
            for &(piece, x, derivative, sign) in parts {
                for (k, p) in power(x - frames[piece] as f64, derivative).into_iter().enumerate() {
                    row[4 * piece + k] += sign * p;
                }
            }
            rows.push((row, right));
        };
        for i in 0..n {
            condition(&[(i, frames[i] as f64, 0, 1.0)], values[i]);
            condition(&[(i, frames[i + 1] as f64, 0, 1.0)], values[i + 1]);
        }
        for i in 1..n {
            let x = frames[i] as f64;
            condition(&[(i - 1, x, 1, 1.0), (i, x, 1, -1.0)], 0.0);
            condition(&[(i - 1, x, 2, 1.0), (i, x, 2, -1.0)], 0.0);
        }
        condition(&[(0, frames[0] as f64, 2, 1.0)], 0.0);
        condition(&[(n - 1, frames[n] as f64, 2, 1.0)], 0.0);
        // Gauss with row exchange.
        for k in 0..unknowns {
            let pivot = (k..unknowns).max_by(|a, b| rows[*a].0[k].abs().total_cmp(&rows[*b].0[k].abs())).unwrap();
            rows.swap(k, pivot);
            let (row, right) = rows[k].clone();
            for (other, value) in rows.iter_mut().skip(k + 1) {
                let factor = other[k] / row[k];
                other.iter_mut().zip(&row).for_each(|(o, r)| *o -= factor * r);
                *value -= factor * right;
            }
        }
        let mut solved = vec![0.0; unknowns];
        for k in (0..unknowns).rev() {
            let known: f64 = (k + 1..unknowns).map(|j| rows[k].0[j] * solved[j]).sum();
            solved[k] = (rows[k].1 - known) / rows[k].0[k];
        }
        for (i, found) in interpolate(&frames, &values).into_iter().enumerate() {
            let t = frames[0] + i;
            let piece = (0..n).rfind(|p| frames[*p] <= t).unwrap().min(n - 1);
            let x = (t - frames[piece]) as f64;
            let wanted: f64 = power(x, 0).iter().enumerate().map(|(k, p)| solved[4 * piece + k] * p).sum();
            assert!((wanted - found).abs() < 1e-9, "frame {t}: {found} {wanted}");
        }
    }

    #[test]
    fn few_knots_give_lines_and_knots_are_met() {
        assert_eq!(interpolate(&[4], &[0.7]), [0.7]);
        assert_eq!(interpolate(&[2, 4], &[0.0, 1.0]), [0.0, 0.5, 1.0]);
        assert_eq!(interpolate(&[2, 4, 5], &[0.0, 1.0, 0.0]), [0.0, 0.5, 1.0, 0.0]);
        let (frames, values) = ([0usize, 3, 9, 10, 40], [0.1, 0.7, -0.3, 0.2, 0.9]);
        let curve = interpolate(&frames, &values);
        for (t, value) in frames.iter().zip(values) {
            assert_eq!(curve[*t], value);
        }
    }

    #[test]
    fn features_say_what_is_fixed_and_where() {
        let statistics = Statistics { mean: vec![0.5; VALUES], std: vec![2.0; VALUES] };
        let anchors = [
            root(2, [1.5, 0.9, 2.5]),
            Anchor { frame: 4, target: Target::PlanarRoot([2.5, 4.5]) },
            Anchor { frame: 4, target: Target::Joint { joint: 20, position: [100.0, 1.0, 0.5] } },
        ];
        let c: Vec<f64> = features(&anchors, 6, 20.0, &statistics);
        let at = |t: usize, feature: usize| c[t * WIDTH + feature];
        let masks = 3 * VALUES;
        // The ground plane is known from 2 to 4, the height at 2 alone.
        assert_eq!([0, 1, 2, 3, 4, 5].map(|t| at(t, masks)), [0.0, 0.0, 1.0, 1.0, 1.0, 0.0]);
        assert_eq!([1, 2, 3].map(|t| at(t, masks + 1)), [0.0, 1.0, 0.0]);
        assert_eq!([2, 3, 4].map(|t| at(t, masks + COMPONENTS)), [1.0, 0.0, 1.0]);
        assert_eq!([2, 3, 4].map(|t| at(t, 2)), [1.0, 0.0, 2.0]);
        assert_eq!([2, 3, 4].map(|t| at(t, VALUES + 2)), [1.0, 1.5, 2.0]);
        assert_eq!([2, 3, 4, 5].map(|t| at(t, 2 * VALUES + 2)), [0.0, 10.0, 10.0, 0.0]);
        assert_eq!((at(2, 1), at(4, 1)), (0.2, 0.0));
        assert_eq!((at(4, 60), at(4, 61), at(4, masks + 21)), (LIMIT, 0.25, 1.0));
        // Nothing is said of what no anchor holds.
        assert!((0..6).all(|t| (3..60).chain(63..66).all(|place| at(t, place) == 0.0 && at(t, VALUES + place) == 0.0)));
    }
}
