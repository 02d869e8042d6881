//! Interval activities: where correction is concentrated (AnchorRoute eq. 32).
//!
//! ```text
//! a_i = clip(max(e_left, e_right) / rho_f, 0, 1)
//! ```
//! `e` is the control error at an interval's end: 0 at a sequence end without an anchor, the largest `e / rho_f` where
//! several anchors share a frame.

use core::mem::swap;

use super::basis::{IntervalBasis, MAX_INTERVALS};
use super::config::{Activity, PerFamily};
use super::terms::anchors::Distances;
use super::vector::{broken, larger};
use crate::request::conditions::AnchorSet;

/// Small seeded generator (xorshift32) for the shuffled ablation.
#[derive(Clone, Copy, Debug)]
pub struct Random(u32);

impl Random {
    /// Generator for a seed; every seed gives a different, non-zero state.
    pub const fn new(seed: u32) -> Self {
        let state = seed.wrapping_mul(2).wrapping_add(1);
        Self(state ^ 0x9E37_79B8)
    }

    /// Next 32 bits.
    pub fn next_bits(&mut self) -> u32 {
        let mut x = self.0;
        x ^= x << 13;
        x ^= x >> 17;
        x ^= x << 5;
        self.0 = x;
        x
    }

    /// Number below `bound` (0 for a bound of 0), by the high bits of a product.
    pub fn below(&mut self, bound: usize) -> usize {
        ((u64::from(self.next_bits()) * bound as u64) >> 32) as usize
    }
}

/// Activities of the intervals of `basis` at the motion that is so far from the anchors; entries behind the last interval are 0.
pub fn activities(
    kind: Activity,
    basis: &IntervalBasis<'_>,
    anchors: &AnchorSet,
    distances: &Distances,
    tolerance: &PerFamily,
    random: &mut Random,
) -> [f32; MAX_INTERVALS] {
    let mut result = [0.0; MAX_INTERVALS];
    let count = basis.intervals().len();
    for (interval, slot) in basis.intervals().iter().zip(&mut result) {
        *slot = match kind {
            Activity::Uniform => 1.0,
            Activity::Residual | Activity::Shuffled => {
                let mut largest = 0.0;
                for (anchor, &error) in anchors.iter().zip(&distances.errors) {
                    if anchor.frame == interval.left || anchor.frame == interval.right {
                        let rho = tolerance.get(anchor.family);
                        largest = larger(largest, if rho > 0.0 { error / rho } else { 1.0 });
                    }
                }
                if largest < 1.0 { largest } else { 1.0 }
            }
        };
    }
    if kind == Activity::Shuffled {
        shuffle(&mut result, count, random);
    }
    result
}

/// Fisher-Yates over the first `count` values.
fn shuffle(values: &mut [f32; MAX_INTERVALS], count: usize, random: &mut Random) {
    for last in (1..count).rev() {
        let other = random.below(last + 1);
        let Some((head, tail)) = values.split_at_mut_checked(last) else { return broken(()) };
        // `other == last` leaves the value where it is.
        if let (Some(a), Some(b)) = (head.get_mut(other), tail.first_mut()) {
            swap(a, b);
        }
    }
}
