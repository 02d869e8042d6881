//! The kernels with their multiply-accumulates counted, in one counter for all threads: what a [`Plan`](crate::Plan) is
//! compared with.

use super::chosen;
use core::sync::atomic::{AtomicU64, Ordering};

static TOTAL: AtomicU64 = AtomicU64::new(0);

/// Begins at 0 again.
pub fn reset() {
    TOTAL.store(0, Ordering::Relaxed);
}

/// Multiply-accumulates since the last [`reset`].
#[must_use]
pub fn total() -> u64 {
    TOTAL.load(Ordering::Relaxed)
}

/// Counts `macs` made outside the kernels.
pub(crate) fn add(macs: usize) {
    TOTAL.fetch_add(macs as u64, Ordering::Relaxed);
}

/// `rows * inputs * outputs` of complete rows: `from` numbers a row of `x`, `to` a row of `acc`.
fn add_rows(x: &[i16], from: usize, acc: &[i32], to: usize) {
    let rows = (x.len() / from.max(1)).min(acc.len() / to.max(1));
    add(rows * from * to);
}

/// `portable::linear_s16s8`, counted.
pub fn linear_s16s8(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    add_rows(x, inputs, acc, outputs);
    chosen::linear_s16s8(x, w, inputs, outputs, acc);
}

/// `portable::linear_s16s4`, counted.
pub fn linear_s16s4(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    add_rows(x, inputs, acc, outputs);
    chosen::linear_s16s4(x, w, inputs, outputs, acc);
}

/// `portable::linear_transposed_s16s8`, counted.
pub fn linear_transposed_s16s8(g: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    add_rows(g, outputs, acc, inputs);
    chosen::linear_transposed_s16s8(g, w, inputs, outputs, acc);
}
