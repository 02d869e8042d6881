//! Armv7E-M and Armv8-M with the DSP extension: Cortex-M4, M7, M33.
//!
//! Rows go through panels of four, in the room behind the accumulators. Few rows meet the int8 weights as they lie in
//! flash (13 instructions for 16 products); for many, and for transposed weights, four channels at a time are widened to
//! int16 first (11, and 1.1 or 1.8 a weight). What does not come in fours of inputs and channels goes the portable way.
//! 4-bit weights are stored in the order in which masks find the pairs of a panel: 49 instructions for 64 products.
//!
//! Words are loaded from any address, so `CCR.UNALIGN_TRP` stays clear, as it is after a reset.

use super::super::portable::{self, GROUP};
use core::arch::global_asm;

// The assembler takes the DSP extension for granted on Armv7E-M only.
#[cfg(kernels_v8)]
global_asm!(".cpu cortex-m33", include_str!("dsp.s"), options(raw));
#[cfg(not(kernels_v8))]
global_asm!(include_str!("dsp.s"), options(raw));

/// Rows of a panel, channels of a wide tile, and inputs of a quad.
const FOUR: usize = 4;
/// Rows from which on widening weights costs less than it saves, and transposing them.
const MANY: usize = 12;
const FEW: usize = 3;

/// Numbers of a panel or a wide tile, a quad.
const PANEL: usize = 8;

/// A kernel of four rows: weights, panel, quads, accumulators, channels, bytes from row to row of accumulators.
type Dot4 = unsafe extern "C" fn(*const u8, *const i32, usize, *mut i32, usize, usize);

unsafe extern "C" {
    fn mtn_pack4(rows: *const [*const i16; FOUR], panel: *mut i32, quads: usize);
    fn mtn_pack1(row: *const i16, panel: *mut i32, quads: usize);
    fn mtn_widen4(w: *const i8, row_bytes: usize, quads: usize, tile: *mut i32);
    fn mtn_widen4_transposed(w: *const i8, row_bytes: usize, quads: usize, tile: *mut i32);
    fn mtn_dot4_s8(w: *const u8, panel: *const i32, quads: usize, acc: *mut i32, channels: usize, row_bytes: usize);
    fn mtn_dot4_s16(tile: *const i32, panels: *const i32, quads: usize, acc: *mut i32, groups: usize, row_bytes: usize);
    fn mtn_dot1_s8(w: *const i8, row: *const i32, steps: usize, acc: *mut i32, bytes: usize, row_bytes: usize);
    fn mtn_dot4_s4(w: *const u8, panel: *const i32, quads: usize, acc: *mut i32, channels: usize, row_bytes: usize);
    fn mtn_dot1_transposed(w: *const i8, row_bytes: usize, row: *const i16, pairs: usize, acc: *mut i32);
}

/// See [`portable::linear_s16s8`].
pub fn linear_s16s8(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if try_linear(x, w, inputs, outputs, acc).is_none() {
        portable::linear_s16s8(x, w, inputs, outputs, acc);
    }
}

/// See [`portable::linear_s16s4`].
pub fn linear_s16s4(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if try_linear_s4(x, w, inputs, outputs, acc).is_none() {
        portable::linear_s16s4(x, w, inputs, outputs, acc);
    }
}

/// See [`portable::linear_transposed_s16s8`].
pub fn linear_transposed_s16s8(g: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    if try_transposed(g, w, inputs, outputs, acc).is_none() {
        portable::linear_transposed_s16s8(g, w, inputs, outputs, acc);
    }
}

/// `None` where the fast way does not suit; `acc` may then hold anything.
fn try_linear(x: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) -> Option<()> {
    let quads = inputs / FOUR;
    let rows = x.len().checked_div(inputs)?;
    if !inputs.is_multiple_of(FOUR) || outputs == 0 {
        return None;
    }
    let w = w.get(..outputs * inputs)?;
    let (acc, room) = acc.split_at_mut_checked(rows * outputs)?;
    if rows >= MANY && outputs >= FOUR {
        let (tile, panels) = room.split_at_mut_checked(PANEL * quads)?;
        pack(x, rows, inputs, panels)?;
        for first in fours(outputs) {
            widen4(w.get(first * inputs..)?, inputs, quads, tile)?;
            dot_rows(tile, panels, quads, rows, acc.get_mut(first..)?, outputs)?;
        }
        return Some(());
    }
    if rows >= FOUR {
        return by_fours(mtn_dot4_s8, x, (bytemuck::cast_slice(w), inputs), [rows, inputs, outputs], acc, room);
    }
    let whole = outputs & !1;
    for (x, acc) in x.chunks_exact(inputs.max(1)).zip(acc.chunks_exact_mut(outputs.max(1))) {
        pack1(x, quads, room)?;
        dot1_s8(w, room, quads, acc.get_mut(..whole)?)?;
        let (w, acc) = (w.get(whole * inputs..)?, acc.get_mut(whole..)?);
        portable::linear_s16s8(x, w, inputs, acc.len(), acc);
    }
    Some(())
}

/// `None` where the fast way does not suit; `acc` may then hold anything.
fn try_linear_s4(x: &[i16], w: &[u8], inputs: usize, outputs: usize, acc: &mut [i32]) -> Option<()> {
    let rows = x.len().checked_div(inputs)?;
    // It loads weights as words.
    if !inputs.is_multiple_of(GROUP) || !w.as_ptr().addr().is_multiple_of(FOUR) {
        return None;
    }
    // Four rows are made of fewer as well, the others in the room.
    let (acc, room) = acc.split_at_mut_checked(rows.max(FOUR) * outputs)?;
    by_fours(mtn_dot4_s4, x, (w, inputs / 2), [rows, inputs, outputs], acc, room)
}

/// `acc [rows][outputs]`, at least four rows, by a kernel that reads rows of `stride` bytes of weights.
#[inline(never)]
fn by_fours(
    kernel: Dot4,
    x: &[i16],
    (w, stride): (&[u8], usize),
    [rows, inputs, outputs]: [usize; 3],
    acc: &mut [i32],
    room: &mut [i32],
) -> Option<()> {
    let quads = inputs / FOUR;
    if w.len() < outputs * stride || quads == 0 || outputs == 0 {
        return None;
    }
    for first in fours(rows) {
        pack4(four(x, first, rows, inputs)?, quads, room)?;
        let acc = acc.get_mut(first * outputs..(first + FOUR) * outputs)?;
        let row_bytes = size_of::<i32>() * outputs;
        // SAFETY: it reads so many weights and the panel, and writes four rows of `outputs` numbers, which are there.
        unsafe { kernel(w.as_ptr(), room.as_ptr(), quads, acc.as_mut_ptr(), outputs, row_bytes) };
    }
    Some(())
}

/// `None` where the fast way does not suit; `acc` may then hold anything.
fn try_transposed(g: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) -> Option<()> {
    let quads = outputs.div_ceil(FOUR);
    let rows = g.len().checked_div(outputs)?;
    if inputs < FOUR {
        return None;
    }
    let w = w.get(..outputs * inputs)?;
    let (acc, room) = acc.split_at_mut_checked(rows * inputs)?;
    if rows < FEW {
        for (g, acc) in g.chunks_exact(outputs.max(1)).zip(acc.chunks_exact_mut(inputs)) {
            for first in fours(inputs) {
                dot1_transposed(w.get(first..)?, inputs, g, acc.get_mut(first..)?)?;
            }
        }
        return Some(());
    }
    let (tile, panels) = room.split_at_mut_checked(PANEL * quads)?;
    pack(g, rows, outputs, panels)?;
    for first in fours(inputs) {
        widen4_transposed(w.get(first..)?, inputs, outputs, tile)?;
        dot_rows(tile, panels, quads, rows, acc.get_mut(first..)?, inputs)?;
    }
    Some(())
}

/// Where fours begin that cover `count`, the last one overlapping the one before where they do not come out even; one
/// that is too long when there are fewer.
fn fours(count: usize) -> impl Iterator<Item = usize> {
    let last = count.saturating_sub(FOUR);
    (0..count).step_by(FOUR).map(move |first| if first < last { first } else { last })
}

/// Four rows of `x [rows][width]` from `first` on; those that are missing repeat the last.
fn four(x: &[i16], first: usize, rows: usize, width: usize) -> Option<[&[i16]; FOUR]> {
    let row = |r: usize| {
        let r = if first + r < rows { first + r } else { rows - 1 };
        x.get(r * width..(r + 1) * width)
    };
    Some([row(0)?, row(1)?, row(2)?, row(3)?])
}

/// Packs `x [rows][width]` into panels where [`fours`] says; rows that are missing repeat the last, inputs are 0.
fn pack(x: &[i16], rows: usize, width: usize, panels: &mut [i32]) -> Option<()> {
    let (quads, rest) = (width / FOUR, width % FOUR);
    let all = PANEL * width.div_ceil(FOUR);
    for (first, panel) in fours(rows).zip(panels.chunks_exact_mut(all.max(1))) {
        let four = four(x, first, rows, width)?;
        pack4(four, quads, panel)?;
        if rest > 0 {
            let mut ends = [[0i16; FOUR]; FOUR];
            for (end, row) in ends.iter_mut().zip(four) {
                for (to, from) in end.iter_mut().zip(row.get(width - rest..)?) {
                    *to = *from;
                }
            }
            let [a, b, c, d] = &ends;
            pack4([a, b, c, d], 1, panel.get_mut(PANEL * quads..)?)?;
        }
    }
    if panels.len() < rows.div_ceil(FOUR) * all { None } else { Some(()) }
}

/// The four columns of `acc [rows][width]` that a wide tile makes.
fn dot_rows(tile: &[i32], panels: &[i32], quads: usize, rows: usize, acc: &mut [i32], width: usize) -> Option<()> {
    if rows < FOUR {
        let mut sums = [0; FOUR * FOUR];
        dot4_s16(tile, panels, quads, 1, &mut sums, FOUR)?;
        for (acc, sums) in acc.chunks_mut(width.max(1)).zip(sums.as_chunks::<FOUR>().0).take(rows) {
            *acc.first_chunk_mut()? = *sums;
        }
        return Some(());
    }
    let groups = rows / FOUR;
    dot4_s16(tile, panels, quads, groups, acc, width)?;
    if !rows.is_multiple_of(FOUR) {
        let panel = panels.get(groups * PANEL * quads..)?;
        dot4_s16(tile, panel, quads, 1, acc.get_mut((rows - FOUR) * width..)?, width)?;
    }
    Some(())
}

/// Four rows of `4 quads` inputs to a panel.
fn pack4(rows: [&[i16]; FOUR], quads: usize, panel: &mut [i32]) -> Option<()> {
    if panel.len() < PANEL * quads || rows.iter().any(|row| row.len() < FOUR * quads) {
        return None;
    }
    if quads > 0 {
        let rows = rows.map(<[i16]>::as_ptr);
        // SAFETY: it reads 4 quads numbers of each row and writes 8 quads numbers, which are there.
        unsafe { mtn_pack4(&raw const rows, panel.as_mut_ptr(), quads) };
    }
    Some(())
}

/// One row of `4 quads` inputs to half a panel.
fn pack1(row: &[i16], quads: usize, panel: &mut [i32]) -> Option<()> {
    if panel.len() < 2 * quads || row.len() < FOUR * quads || quads == 0 {
        return None;
    }
    // SAFETY: it reads 4 quads numbers and writes 2 quads numbers, which are there.
    unsafe { mtn_pack1(row.as_ptr(), panel.as_mut_ptr(), quads) };
    Some(())
}

/// The first four channels of `w [..][inputs]`, `inputs = 4 quads`.
fn widen4(w: &[i8], inputs: usize, quads: usize, tile: &mut [i32]) -> Option<()> {
    if w.len() < FOUR * inputs || tile.len() < PANEL * quads || quads == 0 {
        return None;
    }
    // SAFETY: it reads four rows of `inputs` weights and writes 8 quads numbers, which are there.
    unsafe { mtn_widen4(w.as_ptr(), inputs, quads, tile.as_mut_ptr()) };
    Some(())
}

/// The first four columns of `w [outputs][inputs]`, whose last row may be cut short behind them.
fn widen4_transposed(w: &[i8], inputs: usize, outputs: usize, tile: &mut [i32]) -> Option<()> {
    let (quads, rest) = (outputs / FOUR, outputs % FOUR);
    if w.len() < (outputs - 1) * inputs + FOUR || tile.len() < PANEL * outputs.div_ceil(FOUR) {
        return None;
    }
    if quads > 0 {
        // SAFETY: it reads four weights of each of 4 quads rows and writes 8 quads numbers, which are there.
        unsafe { mtn_widen4_transposed(w.as_ptr(), inputs, quads, tile.as_mut_ptr()) };
    }
    if rest > 0 {
        let mut ends = [[0i8; FOUR]; FOUR];
        for (end, row) in ends.iter_mut().zip(w.chunks(inputs.max(1)).skip(FOUR * quads)) {
            *end = *row.first_chunk()?;
        }
        let tile = tile.get_mut(PANEL * quads..)?;
        // SAFETY: it reads the 4 x 4 bytes of `ends` and writes eight numbers, which were asked for above.
        unsafe { mtn_widen4_transposed(ends.as_ptr().cast(), FOUR, 1, tile.as_mut_ptr()) };
    }
    Some(())
}

/// Four columns of `acc [4 groups][width]`, which may end behind the last of them.
fn dot4_s16(tile: &[i32], panels: &[i32], quads: usize, groups: usize, acc: &mut [i32], width: usize) -> Option<()> {
    let fits = tile.len() >= PANEL * quads
        && panels.len() >= groups * PANEL * quads
        && acc.len() >= (FOUR * groups).saturating_sub(1) * width + FOUR;
    if !fits || quads == 0 || groups == 0 {
        return None;
    }
    let row_bytes = size_of::<i32>() * width;
    // SAFETY: it reads the tile and the panels, and writes four numbers of each row, which are there.
    unsafe { mtn_dot4_s16(tile.as_ptr(), panels.as_ptr(), quads, acc.as_mut_ptr(), groups, row_bytes) };
    Some(())
}

/// The first four columns of one row of sums: `acc[k] = sum_n g[n] w[n][k]`.
fn dot1_transposed(w: &[i8], inputs: usize, g: &[i16], acc: &mut [i32]) -> Option<()> {
    let pairs = g.len() / 2;
    let sums: &mut [i32; FOUR] = acc.first_chunk_mut()?;
    if w.len() < g.len().saturating_sub(1) * inputs + FOUR {
        return None;
    }
    *sums = [0; FOUR];
    if pairs > 0 {
        // SAFETY: it reads four weights of each of 2 pairs rows and as many gradients, and writes four numbers.
        unsafe { mtn_dot1_transposed(w.as_ptr(), inputs, g.as_ptr(), pairs, sums.as_mut_ptr()) };
    }
    if let (false, Some(g)) = (g.len().is_multiple_of(2), g.last()) {
        let last = w.get(2 * pairs * inputs..)?;
        for (sum, w) in sums.iter_mut().zip(last) {
            *sum = sum.wrapping_add(i32::from(*g) * i32::from(*w));
        }
    }
    Some(())
}

/// `acc [outputs]`, an even number, of a packed row and `w [outputs][4 quads]`, words.
fn dot1_s8(w: &[i8], row: &[i32], quads: usize, acc: &mut [i32]) -> Option<()> {
    let (outputs, inputs) = (acc.len(), FOUR * quads);
    let fits = w.len() >= outputs * inputs && row.len() >= 2 * quads && outputs.is_multiple_of(2);
    // It loads two quads at a time, as words.
    if !fits || !quads.is_multiple_of(2) || quads == 0 || !w.as_ptr().addr().is_multiple_of(FOUR) {
        return None;
    }
    if outputs > 0 {
        // SAFETY: it reads so many weights and the row, and writes `outputs` numbers, which are there.
        unsafe { mtn_dot1_s8(w.as_ptr(), row.as_ptr(), quads / 2, acc.as_mut_ptr(), size_of_val(acc), inputs) };
    }
    Some(())
}
