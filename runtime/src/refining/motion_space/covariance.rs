//! How far edits at different frames go together: three tables over the distance of frames.
//!
//! * an edit of the root's path is the sum of edits of its velocity, `d(t) = sum_{s < t} u(s)`, `cov(u_s, u_s') = N(s - s'; 0, 4) / 100`. The
//!   variance of such a sum over n frames, `V(n)`, says all: `cov(d(a), d(b)) = (V(a) + V(b) - V(|a - b|)) / 2`;
//! * heights: Matern 3/2 of length 6 frames;
//! * a limb's own way: Gaussian of 6 frames.

use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::exp::exp;

/// Width of the velocity's covariance, frames.
const VELOCITY: f32 = 4.0;
/// Length of the other two, frames.
const LENGTH: f32 = 6.0;

/// The tables, one entry a distance of 0 to T frames.
#[derive(Debug)]
pub struct Covariance<'a> {
    variance: &'a [f32],
    height: &'a [f32],
    limb: &'a [f32],
}

impl<'a> Covariance<'a> {
    /// For motions of `frames` frames.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn take(frames: usize, arena: &mut Arena<'a>) -> Result<Self, ArenaTooSmall> {
        let count = frames.saturating_add(1);
        let (variance, height, limb) = (arena.take(count)?, arena.take(count)?, arena.take(count)?);
        // N(0; 0, 4) / 100, square metres a frame squared.
        let density = 0.01 * 0.398_942_3 / VELOCITY;
        let gaussian = |x: f32, length: f32| exp(-0.5 * (x / length) * (x / length));
        // From n frames to n + 1 a sum gains its new term's variance and twice its covariance with those before.
        let (mut sum, mut step) = (0.0, density);
        for (x, value) in variance.iter_mut().enumerate() {
            *value = sum;
            sum += step;
            step += 2.0 * density * gaussian((x + 1) as f32, VELOCITY);
        }
        for (x, (height, limb)) in height.iter_mut().zip(limb.iter_mut()).enumerate() {
            let r = 1.732_050_8 * x as f32 / LENGTH;
            *height = (1.0 + r) * exp(-r);
            *limb = gaussian(x as f32, LENGTH);
        }
        Ok(Covariance { variance, height, limb })
    }

    /// `cov(d(a), d(b))`, square metres, of the root's path at two frames.
    #[must_use]
    pub fn path(&self, a: usize, b: usize) -> f32 {
        0.5 * (at(self.variance, a) + at(self.variance, b) - at(self.variance, a.abs_diff(b)))
    }

    /// Of heights at two frames, 1 at one and the same.
    #[must_use]
    pub fn height(&self, a: usize, b: usize) -> f32 {
        at(self.height, a.abs_diff(b))
    }

    /// Of a limb's way at two frames, 1 at one and the same.
    #[must_use]
    pub fn limb(&self, a: usize, b: usize) -> f32 {
        at(self.limb, a.abs_diff(b))
    }
}

fn at(table: &[f32], distance: usize) -> f32 {
    let value = table.get(distance);
    invariant!(value.is_some(), "frame {distance} behind a motion of {}", table.len());
    value.copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    /// Against the double sum in f64.
    #[test]
    fn the_path_is_the_sum_of_its_velocities() {
        let mut memory = vec![0u128; 1024];
        let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
        let covariance = Covariance::take(196, &mut arena).unwrap();
        let kernel = |x: f64| 0.01 * (-0.5 * (x / 4.0).powi(2)).exp() / (4.0 * (2.0 * std::f64::consts::PI).sqrt());
        for (a, b) in [(0, 0), (0, 57), (1, 1), (3, 1), (20, 21), (5, 196), (196, 196), (100, 140)] {
            let pairs = (0..a).flat_map(|s| (0..b).map(move |r| (s, r)));
            let want: f64 = pairs.map(|(s, r): (i32, i32)| kernel(f64::from(s - r))).sum();
            let got = f64::from(covariance.path(a as usize, b as usize));
            assert!((got - want).abs() < 1e-6 * (1.0 + want), "{a} {b}: {got} {want}");
        }
        assert_eq!((covariance.height(7, 7), covariance.limb(9, 9)), (1.0, 1.0));
        assert!((f64::from(covariance.limb(3, 9)) - (-0.5f64).exp()).abs() < 1e-6);
        let r = 3f64.sqrt() * 1.5;
        assert!((f64::from(covariance.height(12, 3)) - (1.0 + r) * (-r).exp()).abs() < 1e-6);
    }
}
