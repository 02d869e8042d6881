//! Anchor intervals on the token grid and the routed projection of an update onto them (EQUATIONS 5).
//!
//! Anchor frames and the sequence ends cut the motion into intervals `I_i = [tau_i, tau_{i+1}]`. Token l belongs to the
//! interval that holds the middle of its frames ([`TokenGrid::middle`]; one on a cut belongs to the right), so intervals own
//! consecutive runs of tokens. With `x = 2 s - 1` in normalised time s, an interval's correction is spanned by the first functions of
//! `1, x, (3 x^2 - 1) / 2, (5 x^3 - 3 x) / 2`, one coefficient a function and channel:
//!
//! ```text
//! alpha_i = (B_i^T B_i + (lambda (1 - a_i) + 1e-4) I)^-1 B_i^T Delta      P(Delta) = B alpha
//! ```
//!
//! Where the paper is silent: an interval without a token is dropped; one with fewer tokens than functions uses as many
//! functions as it has tokens (one token: transport only); when the functions of all intervals outnumber the tokens, every
//! token is a function of its own, `B = I`.

use super::config::Basis;
use super::grid::TokenGrid;
use super::vector::{axpy, broken, clear, dot, next_part, next_part_mut, rows, rows_mut};
use crate::kernels;
use crate::request::conditions::{AnchorSet, MAX_ANCHORS};

/// Most intervals: the anchor frames and both ends.
pub const MAX_INTERVALS: usize = MAX_ANCHORS + 1;

/// Most functions an interval can have.
pub const MAX_FUNCTIONS: usize = 4;

/// Part of the ridge that no activity removes; without it a fully active interval can be singular.
pub const RIDGE_FLOOR: f32 = 1e-4;

/// One interval that owns tokens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interval {
    /// Frame of the left end.
    pub left: u16,
    /// Frame of the right end.
    pub right: u16,
    /// Tokens it owns; they follow those of the interval before.
    pub tokens: u16,
    /// Coefficients a channel.
    pub functions: u16,
}

/// Intervals and the values of their functions at the tokens.
#[derive(Debug)]
pub struct IntervalBasis<'a> {
    intervals: [Interval; MAX_INTERVALS],
    len: usize,
    /// `[tokens][stride]`: value of every function of a token's interval. Empty for `B = I`.
    values: &'a mut [f32],
    /// 0 for `B = I`.
    stride: usize,
}

/// Numbers a basis needs for its function values.
pub const fn values_len(tokens: usize, basis: Basis) -> usize {
    tokens * basis.functions()
}

/// Most coefficients a channel that a basis over `tokens` tokens with `anchors` anchors can have.
pub const fn most_coefficients(tokens: usize, anchors: usize, basis: Basis) -> usize {
    let functions = (anchors + 1) * basis.functions();
    if functions == 0 || functions > tokens { tokens } else { functions }
}

impl<'a> IntervalBasis<'a> {
    /// Cuts the tokens of `grid` at the anchors and evaluates `basis` in `values`, of [`values_len`] numbers.
    pub fn new(anchors: &AnchorSet, grid: TokenGrid, basis: Basis, values: &'a mut [f32]) -> Self {
        let mut intervals = [Interval { left: 0, right: 0, tokens: 0, functions: 0 }; MAX_INTERVALS];
        let (tokens, end) = (grid.tokens, grid.frames().saturating_sub(1));
        let mut len = 0;
        let (mut left, mut owned) = (0, 0);
        let cuts = anchors.iter().map(|anchor| anchor.frame as usize).chain(core::iter::once(end));
        for right in cuts {
            // Tokens whose middle lies left of this cut; the last interval takes all that remain.
            let until = if right >= end { tokens } else { grid.first_token_from(right) };
            let count = until.saturating_sub(owned);
            if count > 0
                && let Some(slot) = intervals.get_mut(len)
            {
                let functions = basis.functions();
                let functions = if functions > count { count } else { functions };
                *slot = Interval {
                    left: left as u16,
                    right: right as u16,
                    tokens: count as u16,
                    functions: functions as u16,
                };
                len += 1;
                owned = until;
            }
            left = right;
        }
        let mut this = Self { intervals, len, values, stride: basis.functions() };
        if basis == Basis::Plain || len * basis.functions() > tokens {
            this.make_direct();
        }
        this.evaluate(basis, grid);
        this
    }

    fn evaluate(&mut self, basis: Basis, grid: TokenGrid) {
        if self.stride == 0 {
            return;
        }
        let mut token = 0;
        let mut values = rows_mut(self.values, self.stride);
        for interval in self.intervals.iter().take(self.len) {
            let span = f32::from(interval.right.saturating_sub(interval.left));
            for _ in 0..interval.tokens {
                let s = (grid.middle(token) - f32::from(interval.left)) / if span > 0.0 { span } else { 1.0 };
                let x = 2.0 * s - 1.0;
                let legendre = [1.0, x, 0.5 * (3.0 * x * x - 1.0), 0.5 * (5.0 * x * x * x - 3.0 * x)];
                let skipped = if basis == Basis::Slope { 1 } else { 0 };
                if let Some(row) = values.next() {
                    for (index, (value, function)) in row.iter_mut().zip(legendre.iter().skip(skipped)).enumerate() {
                        *value = if index < interval.functions as usize { *function } else { 0.0 };
                    }
                }
                token += 1;
            }
        }
    }

    /// Intervals that own tokens, in order of time.
    pub fn intervals(&self) -> &[Interval] {
        part!(self.intervals, ..self.len)
    }

    /// True when every token is a function of its own.
    pub fn is_direct(&self) -> bool {
        self.stride == 0
    }

    /// Tokens of the motion.
    pub fn tokens(&self) -> usize {
        let mut sum = 0;
        for interval in self.intervals() {
            sum += interval.tokens as usize;
        }
        sum
    }

    /// Turns to `B = I`.
    fn make_direct(&mut self) {
        for interval in self.intervals.iter_mut().take(self.len) {
            interval.functions = interval.tokens;
        }
        self.stride = 0;
    }

    /// Coefficients a channel, over all intervals.
    pub fn coefficients(&self) -> usize {
        let mut sum = 0;
        for interval in self.intervals() {
            sum += interval.functions as usize;
        }
        sum
    }

    /// Replaces `delta [tokens][width]` by `P(delta)` with one activity an interval and ridge weight `lambda`.
    pub fn project(&self, delta: &mut [f32], width: usize, activities: &[f32; MAX_INTERVALS], lambda: f32) {
        let mut rest = delta;
        let mut values: &[f32] = self.values;
        for (interval, activity) in self.intervals().iter().zip(activities) {
            let ridge = lambda * (1.0 - activity) + RIDGE_FLOOR;
            let tokens = interval.tokens as usize;
            let part = next_part_mut(&mut rest, tokens * width);
            if self.stride == 0 {
                for value in part {
                    *value /= 1.0 + ridge;
                }
                continue;
            }
            let functions = next_part(&mut values, tokens * self.stride);
            let system = Factor::new(functions, self.stride, ridge);
            for channel in 0..width {
                let mut right = [0.0; MAX_FUNCTIONS];
                for (row, function) in rows(part, width).zip(rows(functions, self.stride)) {
                    let value = row.get(channel).copied().unwrap_or_else(|| broken(0.0));
                    axpy(part_mut!(right, ..self.stride), value, function);
                }
                let alpha = system.solve(right);
                for (row, function) in rows_mut(part, width).zip(rows(functions, self.stride)) {
                    if let Some(value) = row.get_mut(channel) {
                        *value = dot(function, part!(alpha, ..self.stride));
                    }
                }
            }
        }
    }

    /// Scales coefficients `c [coefficients][width]` by `factor / (1 + lambda (1 - a_i) + 1e-4)`: what the ridge does to
    /// an update in an orthonormal basis.
    pub fn damp(&self, c: &mut [f32], width: usize, activities: &[f32; MAX_INTERVALS], lambda: f32, factor: f32) {
        let mut rest = c;
        for (interval, activity) in self.intervals().iter().zip(activities) {
            let scale = factor / (1.0 + (lambda * (1.0 - activity) + RIDGE_FLOOR));
            let count = interval.functions as usize * width;
            let part = next_part_mut(&mut rest, count);
            for value in part {
                *value *= scale;
            }
        }
    }

    /// Makes the functions of every interval orthonormal over its tokens (Gram-Schmidt, in order), so that coefficients
    /// have the length of the correction they stand for. A function that vanishes at the tokens becomes 0.
    pub fn orthonormalise(&mut self) {
        let stride = self.stride;
        let mut rest: &mut [f32] = self.values;
        for interval in self.intervals.iter().take(self.len) {
            let count = interval.tokens as usize * stride;
            let part = next_part_mut(&mut rest, count);
            for column in 0..stride {
                for earlier in 0..column {
                    let overlap = column_dot(part, stride, column, earlier);
                    for row in rows_mut(part, stride) {
                        let other = row.get(earlier).copied().unwrap_or(0.0);
                        if let Some(value) = row.get_mut(column) {
                            *value -= overlap * other;
                        }
                    }
                }
                let length = kernels::sqrt(column_dot(part, stride, column, column));
                let scale = if length > 1e-6 { 1.0 / length } else { 0.0 };
                for row in rows_mut(part, stride) {
                    if let Some(value) = row.get_mut(column) {
                        *value *= scale;
                    }
                }
            }
        }
    }

    /// `out [coefficients][width] = B^T v` for `v [tokens][width]`.
    pub fn analyse(&self, v: &[f32], width: usize, out: &mut [f32]) {
        if self.stride == 0 {
            super::vector::copy(out, v);
            return;
        }
        clear(out);
        let mut tokens = rows(v, width).zip(rows(self.values, self.stride));
        let mut rest = out;
        for interval in self.intervals() {
            let count = interval.functions as usize * width;
            let part = next_part_mut(&mut rest, count);
            for (row, function) in tokens.by_ref().take(interval.tokens as usize) {
                for (coefficients, &value) in rows_mut(part, width).zip(function) {
                    axpy(coefficients, value, row);
                }
            }
        }
    }

    /// `out [tokens][width] += B (x + t d)` for `x, d [coefficients][width]`. The same `x + t d` gives the same bits, however
    /// it is split; with `t = 0`, `d` is not read.
    pub fn add_synthesis(&self, x: &[f32], t: f32, d: &[f32], width: usize, out: &mut [f32]) {
        if self.stride == 0 {
            add_combination(out, 1.0, x, t, d);
            return;
        }
        let mut tokens = rows_mut(out, width).zip(rows(self.values, self.stride));
        let (mut x, mut d) = (x, d);
        for interval in self.intervals() {
            let count = interval.functions as usize * width;
            let (points, steps) = (next_part(&mut x, count), next_part(&mut d, count));
            for (row, function) in tokens.by_ref().take(interval.tokens as usize) {
                for ((point, step), &value) in rows(points, width).zip(rows(steps, width)).zip(function) {
                    add_combination(row, value, point, t, step);
                }
            }
        }
    }
}

/// `out += value (x + t d)`.
fn add_combination(out: &mut [f32], value: f32, x: &[f32], t: f32, d: &[f32]) {
    if t == 0.0 {
        axpy(out, value, x);
        return;
    }
    for ((out, x), d) in out.iter_mut().zip(x).zip(d) {
        *out += value * (x + t * d);
    }
}

fn column_dot(part: &[f32], stride: usize, a: usize, b: usize) -> f32 {
    let mut sum = 0.0;
    for row in rows(part, stride) {
        sum += row.get(a).copied().unwrap_or(0.0) * row.get(b).copied().unwrap_or(0.0);
    }
    sum
}

/// `L D L^T` of `B_i^T B_i + ridge I`, padded with the identity to four functions.
struct Factor {
    /// `L`, unit lower triangle, below the diagonal.
    lower: [[f32; MAX_FUNCTIONS]; MAX_FUNCTIONS],
    /// `1 / D`.
    inverse: [f32; MAX_FUNCTIONS],
}

impl Factor {
    fn new(functions: &[f32], stride: usize, ridge: f32) -> Self {
        let mut lower = [[0.0; MAX_FUNCTIONS]; MAX_FUNCTIONS];
        let (mut pivots, mut inverse) = ([0.0; MAX_FUNCTIONS], [0.0; MAX_FUNCTIONS]);
        for j in 0..MAX_FUNCTIONS {
            let mut pivot = if j < stride { column_dot(functions, stride, j, j) + ridge } else { 1.0 };
            for k in 0..j {
                pivot -= lower[j][k] * lower[j][k] * pivots[k];
            }
            // Positive up to rounding, thanks to the ridge; a lost pivot drops its function.
            pivots[j] = pivot;
            inverse[j] = if pivot > 0.0 { 1.0 / pivot } else { 0.0 };
            for i in j + 1..MAX_FUNCTIONS {
                let mut value = if i < stride { column_dot(functions, stride, i, j) } else { 0.0 };
                for k in 0..j {
                    value -= lower[i][k] * lower[j][k] * pivots[k];
                }
                lower[i][j] = value * inverse[j];
            }
        }
        Self { lower, inverse }
    }

    fn solve(&self, right: [f32; MAX_FUNCTIONS]) -> [f32; MAX_FUNCTIONS] {
        let mut x = right;
        for i in 0..MAX_FUNCTIONS {
            for k in 0..i {
                x[i] -= self.lower[i][k] * x[k];
            }
        }
        for (value, inverse) in x.iter_mut().zip(&self.inverse) {
            *value *= inverse;
        }
        for i in (0..MAX_FUNCTIONS).rev() {
            for k in i + 1..MAX_FUNCTIONS {
                x[i] -= self.lower[k][i] * x[k];
            }
        }
        x
    }
}
