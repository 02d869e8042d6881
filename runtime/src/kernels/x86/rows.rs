//! Rows and windows of matrices, whatever their ends.

/// Row `r` of `x [..][width]`; nothing behind the last.
#[inline(always)]
pub fn row<T>(x: &[T], r: usize, width: usize) -> &[T] {
    x.get(r * width..(r + 1) * width).unwrap_or(&[])
}

/// The first `steps` windows of `row`.
#[inline(always)]
pub fn in_steps<T, const N: usize>(row: &[T], steps: usize) -> &[[T; N]] {
    row.as_chunks().0.get(..steps).unwrap_or(&[])
}

/// `acc[r][n] = tile(x[r], w[n])` for `R` rows, `N` outputs at a time; a row of `w` is `stride` long. A tile gets whole rows;
/// at the end its last output is repeated.
#[inline(always)]
pub fn tiles<const R: usize, const N: usize, W>(
    x: &[i16],
    (w, stride): (&[W], usize),
    inputs: usize,
    outputs: usize,
    acc: &mut [i32],
    tile: impl Fn([&[i16]; R], [&[W]; N]) -> [[i32; N]; R],
) {
    let count = present(w, stride, outputs);
    let mut x_rows: [&[i16]; R] = [&[]; R];
    for (r, x_row) in x_rows.iter_mut().enumerate() {
        *x_row = row(x, r, inputs);
    }
    let (mut rest, mut last): (&[W], &[W]) = (w, &[]);
    for first in (0..count).step_by(N) {
        let mut w_rows: [&[W]; N] = [&[]; N];
        for w_row in &mut w_rows {
            (last, rest) = rest.split_at_checked(stride).unwrap_or((last, &[]));
            *w_row = last;
        }
        for (r, sums) in tile(x_rows, w_rows).iter().enumerate() {
            put(acc.get_mut(r * outputs..r * outputs + count).unwrap_or(&mut []), first, sums);
        }
    }
}

/// Rows of `w [outputs][stride]` that there are.
#[inline(always)]
pub fn present<W>(w: &[W], stride: usize, outputs: usize) -> usize {
    let present = w.len() / stride;
    if present < outputs { present } else { outputs }
}

/// The `N` values of `row` from `at` on, with zeros behind its end.
#[cold]
#[inline(never)]
pub fn padded<T: Copy + Default, const N: usize>(row: &[T], at: usize) -> [T; N] {
    let mut padded = [T::default(); N];
    for (to, from) in padded.iter_mut().zip(row.get(at..).unwrap_or(&[])) {
        *to = *from;
    }
    padded
}

/// Writes `values` to `row` from `at` on, as far as it goes.
#[inline(always)]
pub fn put<const N: usize>(row: &mut [i32], at: usize, values: &[i32; N]) {
    let rest = row.get_mut(at..).unwrap_or(&mut []);
    match rest.first_chunk_mut() {
        Some(to) => *to = *values,
        None => put_some(rest, values),
    }
}

/// Writes as many `values` as `rest` takes. Apart from [`put`]: joined, both ways become one call of `memcpy`.
#[cold]
#[inline(never)]
fn put_some(rest: &mut [i32], values: &[i32]) {
    for (to, from) in rest.iter_mut().zip(values) {
        *to = *from;
    }
}

/// Two int16 as one int32.
#[inline(always)]
pub fn pair(low: i16, high: i16) -> i32 {
    i32::from(high) << 16 | i32::from(low as u16)
}

/// Calls `$block::<R>` for every four rows of `$x [..][$width]` and `$acc [..][$to]`, `R` the rows there are; incomplete
/// rows are left out.
macro_rules! by_rows {
    ($block:ident, $x:expr, $width:expr, $acc:expr, $to:expr, $w:expr) => {
        let (x, acc) = ($x, $acc);
        if $width == 0 || $to == 0 {
            return;
        }
        for (x, acc) in x.chunks(4 * $width).zip(acc.chunks_mut(4 * $to)) {
            let (rows, there) = (x.len() / $width, acc.len() / $to);
            match if rows < there { rows } else { there } {
                0 => {}
                1 => $block::<1>(x, $w, $width, $to, acc),
                2 => $block::<2>(x, $w, $width, $to, acc),
                3 => $block::<3>(x, $w, $width, $to, acc),
                _ => $block::<4>(x, $w, $width, $to, acc),
            }
        }
    };
}
pub(super) use by_rows;
