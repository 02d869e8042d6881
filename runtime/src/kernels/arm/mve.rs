//! Armv8.1-M with MVE, floating point included: Cortex-M55, M85.
//!
//! MVE flushes what is not normal to zero. Where activations are rounded that changes no bit: their row's largest is
//! scaled to the range of int16, and so far below it all numbers become zeros.

use super::super::portable::{self, GROUP};
use core::arch::global_asm;

global_asm!(".cpu cortex-m55", include_str!("mve.s"), options(raw));

/// Rows and channels that a pass makes.
const ROWS: usize = 3;
const CHANNELS: usize = 2;
/// Widest row whose first eight a gathering load reaches.
const REACH: usize = u16::MAX as usize / 8;

/// What a kernel is given, in its order.
#[repr(C)]
struct Shape {
    x: *const i16,
    x_bytes: usize,
    w: *const u8,
    terms: usize,
    acc: *mut i32,
    acc_bytes: usize,
    pairs: usize,
    w_bytes: usize,
}

unsafe extern "C" {
    fn mtn_mve_dot3(shape: *const Shape);
    fn mtn_mve_dot3_s4(shape: *const Shape);
    fn mtn_mve_dot3_transposed(shape: *const Shape);
    fn mtn_mve_largest(x: *const f32, count: usize) -> u32;
    fn mtn_mve_round(x: *const f32, count: usize, factor: u32, q: *mut i16);
}

/// See [`portable::largest_magnitude`].
pub fn largest_magnitude(x: &[f32]) -> u32 {
    // SAFETY: so many numbers are read.
    unsafe { mtn_mve_largest(x.as_ptr(), x.len()) }
}

/// See [`portable::round_scaled`].
pub fn round_scaled(x: &[f32], factor: f32, q: &mut [i16]) {
    let count = if x.len() < q.len() { x.len() } else { q.len() };
    // SAFETY: so many numbers are read, and written.
    unsafe { mtn_mve_round(x.as_ptr(), count, factor.to_bits(), q.as_mut_ptr()) };
}

/// See [`portable::linear_s16s8`].
pub fn linear_s16s8(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    let Some(rows) = present(x, inputs, outputs, acc).filter(|_| outputs >= CHANNELS && w.len() >= inputs * outputs)
    else {
        return portable::linear_s16s8(x, w, inputs, outputs, acc);
    };
    each(x, w, [rows, inputs, outputs], acc, inputs, |channel| channel * inputs, mtn_mve_dot3);
}

/// See [`portable::linear_s16s4`].
pub fn linear_s16s4(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    let row = inputs / 2;
    let fits = outputs >= CHANNELS && inputs.is_multiple_of(GROUP) && w.len() >= row * outputs;
    let Some(rows) = present(x, inputs, outputs, acc).filter(|_| fits) else {
        return portable::linear_s16s4(x, w, inputs, outputs, acc);
    };
    each(x, w, [rows, inputs, outputs], acc, row, |channel| channel * row, mtn_mve_dot3_s4);
}

/// See [`portable::linear_transposed_s16s8`].
pub fn linear_transposed_s16s8(g: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    let fits = (CHANNELS..=REACH).contains(&inputs) && w.len() >= inputs * outputs;
    let Some(rows) = present(g, outputs, inputs, acc).filter(|_| fits) else {
        return portable::linear_transposed_s16s8(g, w, inputs, outputs, acc);
    };
    each(g, w, [rows, outputs, inputs], acc, inputs, |channel| channel, mtn_mve_dot3_transposed);
}

/// Rows of `x [..][terms]` for which `acc [..][channels]` has room.
fn present(x: &[i16], terms: usize, channels: usize, acc: &[i32]) -> Option<usize> {
    let (rows, there) = (x.len().checked_div(terms)?, acc.len().checked_div(channels)?);
    Some(if rows < there { rows } else { there }).filter(|rows| *rows > 0)
}

/// Calls `kernel` for every three rows, the last three overlapping those before, or for single rows; and for every two
/// channels, the last two likewise. `start` is where a channel's weights begin.
fn each<W>(
    x: &[i16],
    w: &[W],
    [rows, terms, channels]: [usize; 3],
    acc: &mut [i32],
    w_bytes: usize,
    start: impl Fn(usize) -> usize,
    kernel: unsafe extern "C" fn(*const Shape),
) {
    let step = if rows < ROWS { 1 } else { ROWS };
    for row in (0..rows).step_by(step) {
        let row = if row + step > rows { rows - step } else { row };
        let mut pass = |channel: usize, pairs: usize| {
            let acc_at = row * channels + channel;
            let (Some(x), Some(w), Some(acc)) =
                (x.get(row * terms..(row + step) * terms), w.get(start(channel)..), acc.get_mut(acc_at..))
            else {
                return;
            };
            // A single row is made three times over.
            let (x_bytes, acc_bytes) = if step == 1 { (0, 0) } else { (2 * terms, size_of::<i32>() * channels) };
            let (x, w, acc) = (x.as_ptr(), w.as_ptr().cast(), acc.as_mut_ptr());
            let shape = Shape { x, x_bytes, w, terms, acc, acc_bytes, pairs, w_bytes };
            // SAFETY: the caller has checked that `step` rows of x and of acc, and the weights of all channels, are there.
            unsafe { kernel(&raw const shape) };
        };
        pass(0, channels / CHANNELS);
        if !channels.is_multiple_of(CHANNELS) {
            pass(channels - CHANNELS, 1);
        }
    }
}
