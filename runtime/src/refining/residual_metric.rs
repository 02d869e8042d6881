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
//! in metres, with t in units of 100 frames in the first two terms, `p_n` the observed joint at anchor n, `c_s` the root at frame
//! s, `'` a quarter turn on the ground. This is the shape of `J J^T` for the Jacobian J of the residuals; with `W = scale (A + floor I)^-1`
//! in place of the identity, `r^T W r` has the same zeros and far rounder level sets. Nothing here knows the decoder: the
//! numbers of [`Prior`] say how strongly a typical token acts through each road, chosen once on the val split.

use super::MotionMap;
use crate::perception::anchors::{AnchorSet, Family, MAX_ANCHORS, Observed};

/// Frames between the samples of the yaw sum.
const YAW_STRIDE: usize = 4;

/// Frames that count as one in the root and yaw terms.
const TIME_UNIT: f32 = 100.0;

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
    /// Frames over which local displacements are alike.
    pub range: f32,
    /// Share of the mean variance added to every residual: keeps the metric finite where the model says nothing moves.
    pub floor: f32,
}

impl Prior {
    /// Best of a grid on the val split of the `nano` model.
    pub const NANO: Self = Self { root: 1.0, yaw: 0.5, body: 1.0, height: 0.1, range: 6.0, floor: 0.01 };
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
    /// rounding left it indefinite: the identity serves then.
    pub fn new(anchors: &AnchorSet, map: &impl MotionMap, prior: &Prior, numbers: &'a mut [f32]) -> Option<Self> {
        let count = anchors.len();
        let (planar, height) = numbers.split_at_mut_checked(triangle(2 * count))?;
        let mut planar = Triangle { numbers: planar, rows: 2 * count };
        let mut height = Triangle { numbers: height, rows: count };
        let (mut trace, mut rows) = (0.0, 0.0);
        for (n, a) in anchors.iter().enumerate() {
            for (m, b) in anchors.iter().enumerate().take(n + 1) {
                let block = planar_block(a, b, map, prior);
                let upright = height_covariance(a, b, prior);
                for (row, line) in block.iter().enumerate() {
                    for (column, &value) in line.iter().enumerate() {
                        planar.set(2 * n + row, 2 * m + column, value);
                    }
                }
                height.set(n, m, upright);
                if n == m {
                    let [[xx, _], [_, zz]] = block;
                    trace += xx + zz;
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
fn likeness(a: &Observed, b: &Observed, prior: &Prior) -> f32 {
    let apart = f32::from(a.frame.abs_diff(b.frame));
    if prior.range > 0.0 { libm::expf(-apart / prior.range) } else { 0.0 }
}

fn is_root(anchor: &Observed) -> bool {
    !matches!(anchor.family, Family::BodyPoint) || anchor.joint == 0
}

fn planar_block(a: &Observed, b: &Observed, map: &impl MotionMap, prior: &Prior) -> [[f32; 2]; 2] {
    let first = if a.frame < b.frame { a.frame } else { b.frame };
    let mut diagonal = prior.root * f32::from(first) / TIME_UNIT;
    if a.joint == b.joint && !is_root(a) {
        diagonal += prior.body * likeness(a, b, prior);
    }
    let [px, _, pz] = map.position(a.joint, a.frame as usize);
    let [qx, _, qz] = map.position(b.joint, b.frame as usize);
    let [mut xx, mut xz, mut zx, mut zz] = [0.0; 4];
    let mut frame = YAW_STRIDE / 2;
    while frame < first as usize {
        let [cx, _, cz] = map.position(0, frame);
        let (ax, az, bx, bz) = (pz - cz, cx - px, qz - cz, cx - qx);
        xx += ax * bx;
        xz += ax * bz;
        zx += az * bx;
        zz += az * bz;
        frame += YAW_STRIDE;
    }
    let yaw = prior.yaw * YAW_STRIDE as f32 / TIME_UNIT;
    [[diagonal + yaw * xx, yaw * xz], [yaw * zx, diagonal + yaw * zz]]
}

/// Anchors without height have none: their row is left to the floor.
fn height_covariance(a: &Observed, b: &Observed, prior: &Prior) -> f32 {
    if a.joint != b.joint || !a.has_height() || !b.has_height() {
        return 0.0;
    }
    likeness(a, b, prior) * if is_root(a) { prior.height } else { prior.body }
}

/// A symmetric matrix by its lower triangle, row after row, and later its Cholesky factor with the inverse diagonal.
#[derive(Debug)]
struct Triangle<'a> {
    numbers: &'a mut [f32],
    rows: usize,
}

impl Triangle<'_> {
    /// Sets an element of the lower triangle; those above the diagonal are its mirror image and ignored.
    fn set(&mut self, row: usize, column: usize, value: f32) {
        if column <= row
            && let Some(slot) = self.numbers.get_mut(triangle(row) + column)
        {
            *slot = value;
        }
    }

    /// Row `row` up to and with its diagonal.
    fn row(&self, row: usize) -> &[f32] {
        self.numbers.get(triangle(row)..triangle(row + 1)).unwrap_or(&[])
    }

    /// `L` of `M / scale + floor I = L L^T` in place, `1 / L_ii` on the diagonal. False when a pivot is not positive.
    fn factorise(&mut self, scale: f32, floor: f32) -> bool {
        let inverse = 1.0 / scale;
        for i in 0..self.rows {
            let Some((done, rest)) = self.numbers.split_at_mut_checked(triangle(i)) else { return false };
            let Some((row, _)) = rest.split_at_mut_checked(i + 1) else { return false };
            let mut above: &[f32] = done;
            for j in 0..=i {
                let Some((head, tail)) = row.split_at_mut_checked(j) else { return false };
                let Some(element) = tail.first_mut() else { return false };
                let value = *element * inverse;
                if j < i {
                    let Some((other, more)) = above.split_at_checked(j + 1) else { return false };
                    above = more;
                    let Some((pivot, other)) = other.split_last() else { return false };
                    *element = (value - super::vector::dot(head, other)) * *pivot;
                } else {
                    let pivot = value + floor - super::vector::dot(head, head);
                    if !(pivot > 0.0) || !pivot.is_finite() {
                        return false;
                    }
                    *element = 1.0 / libm::sqrtf(pivot);
                }
            }
        }
        true
    }

    /// `v <- L^-1 v`; returns the square of its length.
    fn half_solve(&self, v: &mut [f32]) -> f32 {
        let mut square = 0.0;
        for i in 0..self.rows {
            let Some((head, tail)) = v.split_at_mut_checked(i) else { return square };
            let (Some(value), Some((pivot, row))) = (tail.first_mut(), self.row(i).split_last()) else { return square };
            *value = (*value - super::vector::dot(row, head)) * pivot;
            square += *value * *value;
        }
        square
    }

    /// `v <- L^-T v`.
    fn finish(&self, v: &mut [f32]) {
        for i in (0..self.rows).rev() {
            let Some((head, tail)) = v.split_at_mut_checked(i) else { return };
            let (Some(value), Some((pivot, row))) = (tail.first_mut(), self.row(i).split_last()) else { return };
            *value *= pivot;
            super::vector::axpy(head, -*value, row);
        }
    }
}
