//! A metric on the anchors' residuals that undoes what integration does to them.
//!
//! The root's position is a sum of velocities, turned by a sum of yaw velocities: late anchors feel every token before them,
//! neighbours feel nearly the same ones, and `||r||^2` is badly conditioned in the tokens. If each token moves the motion at
//! its own time by an independent amount, the displacements at the anchors have the covariance
//!
//! ```text
//! planar:  A_nm = root min(t_n, t_m) I + yaw sum_{s < t_n, t_m} (p_n - c_s)' (p_m - c_s)'^T + [n, m on one joint] body k(t_n, t_m) I
//! height:  A_nm = [n, m on one joint] (height or body) k(t_n, t_m)          k(t, t') = exp(-|t - t'| / range)
//! ```
//! in metres, with t in tokens, in units of 25 of them in the first two terms, `p_n` the observed joint at anchor n, `c_s` the root at
//! the middle of token s, `'` a quarter turn on the ground. This is the shape of `J J^T` for the Jacobian J of the residuals; with `W = scale (A + floor I)^-1`
//! in place of the identity, `r^T W r` has the same zeros and far rounder level sets. Nothing here knows the decoder: the
//! numbers of [`Prior`] say how strongly a typical token acts through each road, chosen once on the val split.

use super::MotionMap;
use super::vector::{axpy, broken, clear, dot};
use crate::kernels;
use crate::request::conditions::{AnchorSet, Family, MAX_ANCHORS, Observed};

/// Tokens that count as one in the root and yaw terms.
const TIME_UNIT: f32 = 25.0;

/// Relative strengths of the roads from a token to an anchor. Only ratios matter.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Prior {
    /// Planar root displacement, accumulated over time.
    pub root: f32,
    /// Turning: displacement by the lever between an earlier root position and the anchor, accumulated over time.
    pub yaw: f32,
    /// A joint's position relative to the root, and its height.
    pub body: f32,
    /// The root's height.
    pub height: f32,
    /// Tokens over which local displacements are alike.
    pub range: f32,
    /// Share of the mean variance added to every residual: keeps the metric finite where the model says nothing moves.
    pub floor: f32,
}

impl Prior {
    /// Best of a grid on the val split of the `nano` model.
    pub const NANO: Self = Self { root: 1.0, yaw: 0.5, body: 1.0, height: 0.1, range: 1.5, floor: 0.01 };
}

/// Numbers the factor takes: lower triangles over 2 planar rows an anchor and over 1 height row an anchor.
pub const fn factor_len(anchors: usize) -> usize {
    triangle(2 * anchors) + triangle(anchors)
}

const fn triangle(rows: usize) -> usize {
    rows * (rows + 1) / 2
}

/// Residuals or their duals: two planar components an anchor, one height.
#[derive(Clone, Copy, Debug)]
pub struct Residuals {
    planar: [f32; 2 * MAX_ANCHORS],
    height: [f32; MAX_ANCHORS],
}

impl Residuals {
    /// `r_n` of every anchor at the motion of the last forward pass.
    pub fn of(anchors: &AnchorSet, map: &impl MotionMap) -> Self {
        let mut this = Self { planar: [0.0; 2 * MAX_ANCHORS], height: [0.0; MAX_ANCHORS] };
        let (pairs, _) = this.planar.as_chunks_mut::<2>();
        for ((anchor, pair), height) in anchors.iter().zip(pairs).zip(&mut this.height) {
            let [x, y, z] = anchor.residual(map.position(anchor.joint, anchor.frame as usize));
            (*pair, *height) = ([x, z], y);
        }
        this
    }

    /// `[x, y, z]` of every anchor, in the order of the set.
    pub fn vectors(&self) -> impl Iterator<Item = [f32; 3]> {
        let (pairs, _) = self.planar.as_chunks::<2>();
        pairs.iter().zip(&self.height).map(|(&[x, z], &y)| [x, y, z])
    }
}

/// Cholesky factors of `(A + floor) / scale`, planar and height apart (the model has no term between them).
#[derive(Debug)]
pub struct ResidualMetric<'a> {
    planar: Triangle<'a>,
    height: Triangle<'a>,
}

impl<'a> ResidualMetric<'a> {
    /// The metric of `anchors` around the motion of the last forward pass, in a slice of [`factor_len`] numbers. `None` when
    /// rounding left it indefinite: the identity serves then. Asks the map for one position an anchor and at most one a token.
    pub fn new(anchors: &AnchorSet, map: &impl MotionMap, prior: &Prior, numbers: &'a mut [f32]) -> Option<Self> {
        let (count, frames_per_token) = (anchors.len(), map.grid().frames_per_token);
        let (planar, height) = numbers.split_at_mut_checked(triangle(2 * count))?;
        let mut planar = Triangle { numbers: planar, rows: 2 * count };
        let mut height = Triangle { numbers: height, rows: count };
        planar.sum_levers(anchors, map);
        let unit = TIME_UNIT * frames_per_token as f32;
        let yaw = prior.yaw * frames_per_token as f32 / unit;
        let (mut trace, mut rows) = (0.0, 0.0);
        for (n, a) in anchors.iter().enumerate() {
            for (m, b) in anchors.iter().enumerate().take(n + 1) {
                let same = a.joint == b.joint;
                let likeness = if same { likeness(a, b, prior, frames_per_token) } else { 0.0 };
                // The anchors stand in order of time: b is not later.
                let mut diagonal = prior.root * f32::from(b.frame) / unit;
                if same && !is_root(a) {
                    diagonal += prior.body * likeness;
                }
                let mut squares = 0.0;
                for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    if let Some(value) = planar.element(2 * n + row, 2 * m + column) {
                        *value = if row == column { diagonal + yaw * *value } else { yaw * *value };
                        if row == column {
                            squares += *value;
                        }
                    }
                }
                // Anchors without height have no covariance there: their row is left to the floor.
                let heights = same && a.has_height() && b.has_height();
                let upright = if heights { likeness * if is_root(a) { prior.height } else { prior.body } } else { 0.0 };
                if let Some(value) = height.element(n, m) {
                    *value = upright;
                }
                if n == m {
                    trace += squares;
                    rows += 2.0;
                    if a.has_height() {
                        trace += upright;
                        rows += 1.0;
                    }
                }
            }
        }
        let scale = trace / rows;
        if !(scale > 0.0) || !scale.is_finite() {
            return None;
        }
        let sound = planar.factorise(scale, prior.floor) && height.factorise(scale, prior.floor);
        if sound { Some(Self { planar, height }) } else { None }
    }

    /// Replaces `r` by `W r` and returns `r^T W r`, summed as squares.
    pub fn apply(&self, r: &mut Residuals) -> f32 {
        let square = self.planar.half_solve(&mut r.planar) + self.height.half_solve(&mut r.height);
        self.planar.finish(&mut r.planar);
        self.height.finish(&mut r.height);
        square
    }
}

/// Local likeness of two frames.
fn likeness(a: &Observed, b: &Observed, prior: &Prior, frames_per_token: usize) -> f32 {
    let (apart, range) = (f32::from(a.frame.abs_diff(b.frame)), prior.range * frames_per_token as f32);
    if range > 0.0 { libm::expf(-apart / range) } else { 0.0 }
}

fn is_root(anchor: &Observed) -> bool {
    !matches!(anchor.family, Family::BodyPoint) || anchor.joint == 0
}

/// A symmetric matrix by its lower triangle, row after row, and later its Cholesky factor with the inverse diagonal.
#[derive(Debug)]
struct Triangle<'a> {
    numbers: &'a mut [f32],
    rows: usize,
}

impl Triangle<'_> {
    /// An element of the lower triangle; those above the diagonal are its mirror image and not kept.
    fn element(&mut self, row: usize, column: usize) -> Option<&mut f32> {
        if column > row {
            return None;
        }
        let element = self.numbers.get_mut(triangle(row) + column);
        invariant!(element.is_some(), "row {row} of {}", self.rows);
        element
    }

    /// Fills in `sum_s (p_n - c_s)' (p_m - c_s)'^T` over the middles s of tokens before both anchors, two rows an anchor.
    fn sum_levers(&mut self, anchors: &AnchorSet, map: &impl MotionMap) {
        clear(self.numbers);
        let mut places = [[0.0; 2]; MAX_ANCHORS];
        for (place, anchor) in places.iter_mut().zip(anchors.iter()) {
            let [x, _, z] = map.position(anchor.joint, anchor.frame as usize);
            *place = [x, z];
        }
        let grid = map.grid();
        let last = anchors.last_frame().unwrap_or(0) as usize;
        for token in 0..grid.tokens {
            let frame = token * grid.frames_per_token + grid.frames_per_token / 2;
            if frame >= last {
                return;
            }
            let [cx, _, cz] = map.position(0, frame);
            let levers = places.map(|[x, z]| [z - cz, cx - x]);
            let later = anchors.iter().zip(&levers).enumerate().filter(|(_, (a, _))| frame < a.frame as usize);
            for (n, (_, lever)) in later.clone() {
                for (m, (_, other)) in later.clone().take_while(|(m, _)| *m <= n) {
                    for (row, &a) in lever.iter().enumerate() {
                        for (column, &b) in other.iter().enumerate() {
                            if let Some(sum) = self.element(2 * n + row, 2 * m + column) {
                                *sum += a * b;
                            }
                        }
                    }
                }
            }
        }
    }

    /// Row `row` up to and with its diagonal.
    fn row(&self, row: usize) -> &[f32] {
        part!(self.numbers, triangle(row)..triangle(row + 1))
    }

    /// `L` of `M / scale + floor I = L L^T` in place, `1 / L_ii` on the diagonal. False when a pivot is not positive.
    fn factorise(&mut self, scale: f32, floor: f32) -> bool {
        let inverse = 1.0 / scale;
        for i in 0..self.rows {
            let Some((done, rest)) = self.numbers.split_at_mut_checked(triangle(i)) else { return broken(false) };
            let Some((row, _)) = rest.split_at_mut_checked(i + 1) else { return broken(false) };
            let mut above: &[f32] = done;
            for j in 0..=i {
                let Some((head, tail)) = row.split_at_mut_checked(j) else { return broken(false) };
                let Some(element) = tail.first_mut() else { return broken(false) };
                let value = *element * inverse;
                if j < i {
                    let Some((other, more)) = above.split_at_checked(j + 1) else { return broken(false) };
                    above = more;
                    let Some((pivot, other)) = other.split_last() else { return broken(false) };
                    *element = (value - dot(head, other)) * *pivot;
                } else {
                    let pivot = value + floor - dot(head, head);
                    if !(pivot > 0.0) || !pivot.is_finite() {
                        return false;
                    }
                    *element = 1.0 / kernels::sqrt(pivot);
                }
            }
        }
        true
    }

    /// `v <- L^-1 v`; returns the square of its length.
    fn half_solve(&self, v: &mut [f32]) -> f32 {
        let mut square = 0.0;
        for i in 0..self.rows {
            let Some((head, tail)) = v.split_at_mut_checked(i) else { return broken(square) };
            let (Some(value), Some((pivot, row))) = (tail.first_mut(), self.row(i).split_last()) else {
                return broken(square);
            };
            *value = (*value - dot(row, head)) * pivot;
            square += *value * *value;
        }
        square
    }

    /// `v <- L^-T v`.
    fn finish(&self, v: &mut [f32]) {
        for i in (0..self.rows).rev() {
            let Some((head, tail)) = v.split_at_mut_checked(i) else { return broken(()) };
            let (Some(value), Some((pivot, row))) = (tail.first_mut(), self.row(i).split_last()) else {
                return broken(());
            };
            *value *= pivot;
            axpy(head, -*value, row);
        }
    }
}
