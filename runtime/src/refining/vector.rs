//! Sums and updates over slices of one length, in one written order, without panics.

use core::mem::take;

/// Two sides of one operation.
#[track_caller]
fn same_length(a: &[f32], b: &[f32]) {
    invariant!(a.len() == b.len(), "{} numbers and {}", a.len(), b.len());
}

/// What a release goes on with where an invariant does not hold.
#[track_caller]
#[inline]
pub(crate) fn broken<T>(value: T) -> T {
    invariant!(false, "a buffer is shorter than it was planned");
    value
}

/// The first `count` numbers of `rest`, which is then what follows them.
#[track_caller]
pub(crate) fn next_part<'a>(rest: &mut &'a [f32], count: usize) -> &'a [f32] {
    let (part, tail) = rest.split_at_checked(count).unwrap_or_else(|| broken(Default::default()));
    *rest = tail;
    part
}

/// The first `count` numbers of `rest`, which is then what follows them, to be written.
#[track_caller]
pub(crate) fn next_part_mut<'a>(rest: &mut &'a mut [f32], count: usize) -> &'a mut [f32] {
    let (part, tail) = take(rest).split_at_mut_checked(count).unwrap_or_else(|| broken(Default::default()));
    *rest = tail;
    part
}

/// `sum a_i b_i`, first to last.
pub(crate) fn dot(a: &[f32], b: &[f32]) -> f32 {
    same_length(a, b);
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        sum += x * y;
    }
    sum
}

/// `a += scale * b`.
pub(crate) fn axpy(a: &mut [f32], scale: f32, b: &[f32]) {
    same_length(a, b);
    for (x, y) in a.iter_mut().zip(b) {
        *x += scale * y;
    }
}

/// `a = b`.
pub(crate) fn copy(a: &mut [f32], b: &[f32]) {
    same_length(a, b);
    for (x, y) in a.iter_mut().zip(b) {
        *x = *y;
    }
}

/// `a = 0`.
pub(crate) fn clear(a: &mut [f32]) {
    for x in a {
        *x = 0.0;
    }
}

/// `||a - b||^2`.
pub(crate) fn squared_distance(a: &[f32], b: &[f32]) -> f32 {
    same_length(a, b);
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        let d = x - y;
        sum += d * d;
    }
    sum
}

/// True when every element is a finite number.
pub(crate) fn all_finite(a: &[f32]) -> bool {
    a.iter().all(|x| x.is_finite())
}

/// The larger of two numbers; the first when they do not compare.
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// Bit `joint` of a set of joints.
pub(crate) const fn bit(joint: u8) -> u32 {
    1u32.wrapping_shl(joint as u32)
}

/// `||a||^2` in space.
pub(crate) fn squared_length([x, y, z]: [f32; 3]) -> f32 {
    x * x + y * y + z * z
}

/// `a - b` in space.
pub(crate) fn difference([ax, ay, az]: [f32; 3], [bx, by, bz]: [f32; 3]) -> [f32; 3] {
    [ax - bx, ay - by, az - bz]
}

/// `scale a` in space.
pub(crate) fn scaled([x, y, z]: [f32; 3], scale: f32) -> [f32; 3] {
    [scale * x, scale * y, scale * z]
}

/// Rows of `width` numbers, the last one whole. Unlike `chunks_exact` it never divides, so it cannot panic.
#[derive(Clone)]
pub(crate) struct Rows<'a> {
    rest: &'a [f32],
    width: usize,
}

impl<'a> Iterator for Rows<'a> {
    type Item = &'a [f32];

    fn next(&mut self) -> Option<&'a [f32]> {
        let (row, rest) = self.rest.split_at_checked(self.width)?;
        self.rest = rest;
        if row.is_empty() { None } else { Some(row) }
    }
}

/// Mutable [`Rows`].
pub(crate) struct RowsMut<'a> {
    rest: &'a mut [f32],
    width: usize,
}

impl<'a> Iterator for RowsMut<'a> {
    type Item = &'a mut [f32];

    fn next(&mut self) -> Option<&'a mut [f32]> {
        let (row, rest) = take(&mut self.rest).split_at_mut_checked(self.width)?;
        self.rest = rest;
        if row.is_empty() { None } else { Some(row) }
    }
}

/// Rows of `width` numbers; none for a width of 0.
pub(crate) const fn rows(a: &[f32], width: usize) -> Rows<'_> {
    Rows { rest: a, width }
}

/// Rows of `width` numbers, mutable.
pub(crate) const fn rows_mut(a: &mut [f32], width: usize) -> RowsMut<'_> {
    RowsMut { rest: a, width }
}
