//! One layer's step: rows enter, and those that have thereby become final leave.

use super::decoder::copy;
use super::layer::{Direction, Layer};
use crate::channels::Channels;
use crate::nn::conv1d::{Conv1d, GradientBlock, Rows};
use crate::nn::output;
use crate::nn::{mask, quantise, residual};

/// What has entered a layer: rows, and then zero rows behind the motion's last. All else follows from these.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Count {
    pub rows: usize,
    pub zeros: usize,
}

impl Count {
    const fn all(&self) -> usize {
        self.rows.saturating_add(self.zeros)
    }

    const fn add(&mut self, (rows, zeros): (usize, usize)) {
        // A stream's may run for ever; beyond what a layer looks back they make no difference.
        self.rows = self.rows.saturating_add(rows);
        self.zeros += zeros;
    }
}

/// The end of what entered a layer.
pub(super) struct Tail<'s> {
    /// Quantised rows, `[kept][K]`, of which the first are there.
    pub q: &'s mut [i16],
    /// Their scales, `[kept]`.
    pub scales: &'s mut [f32],
    /// Rows as they were, `[skipped][K]`.
    pub rows: &'s mut [f32],
    pub count: &'s mut Count,
}

/// Bits of the ReLUs.
#[derive(Debug)]
pub(super) struct ReluMask<'w> {
    /// `[R][words(W)]`, all layers' one after the other, or as many as a chunk has where nobody reads them.
    pub bits: &'w mut [u32],
    /// Words of a row.
    pub words: usize,
    /// Of how many tokens the motion is whose gradient is to follow; `None` where none is.
    pub kept: Option<usize>,
}

impl ReluMask<'_> {
    /// Of `count` rows, `from` a layer's first row on, the `row`-th there.
    fn of(&mut self, from: usize, row: usize, count: usize) -> &mut [u32] {
        let first = if self.kept.is_some() { from + row } else { 0 };
        part_mut!(self.bits, first * self.words..(first + count) * self.words)
    }
}

/// Buffers that a layer uses while it computes. The quantised rows of `scratch` are its window, `[kept + came][K]`.
#[derive(Debug)]
pub(super) struct Work<'w> {
    pub scratch: residual::ResidualScratch<'w>,
    /// Of the last layer's gradient.
    pub output_row: &'w mut [f32],
    pub output_q: &'w mut [i16],
    pub output_scales: &'w mut [f32],
    pub acc_low: &'w mut [i32],
}

/// What enters a layer, and where the rows that have become final are written.
pub(super) struct Chunk<'c> {
    /// The rows, in front.
    pub sequence: &'c mut [f32],
    pub rows: usize,
    /// Zero rows behind them.
    pub zeros: usize,
}

/// A layer's bits of the ReLUs: of its input from row `outer` on, of a residual block's hidden rows from `inner` on.
pub(super) struct Masks<'c, 'w> {
    pub mask: &'c mut ReluMask<'w>,
    pub outer: usize,
    pub inner: usize,
}

impl Layer<'_, '_> {
    /// Takes the rows of `chunk`, and writes those that have become final in front of its sequence. Returns how many.
    pub(super) fn step(
        &self,
        way: Direction,
        tail: Tail<'_>,
        chunk: Chunk<'_>,
        masks: Masks<'_, '_>,
        channels: &Channels,
        work: &mut Work<'_>,
    ) -> usize {
        let Chunk { sequence, rows, zeros } = chunk;
        if rows + zeros == 0 {
            return 0;
        }
        let Masks { mask: gates, outer, inner } = masks;
        if let (Layer::Upsample(conv), Direction::Back) = (self, way) {
            return downsample(conv, tail, (rows, zeros), sequence, work);
        }
        let Work { scratch: residual::ResidualScratch { q, scales, row, block }, acc_low, .. } = work;
        let rows_per_block = block.scales.len();
        let (width, ahead, skipped) = (self.width(way), self.ahead(way), self.skipped(way));
        let (came, copies) = (rows + zeros, if let Layer::Upsample(_) = self { 2 } else { 1 });
        // Results before the motion's first row and behind its last are left out.
        let Tail { q: kept_q, scales: kept_scales, rows: kept_rows, count } = tail;
        let kept = self.kept(way);
        let (entered, gone) = (count.rows, count.all().saturating_mul(copies));
        // Of zero rows as many as are kept lie before the motion; those behind it are in no window either.
        let (lead, held) = (kept.saturating_sub(count.all()), entered.min(kept.saturating_sub(count.zeros)));
        let (left, before) = (gone.saturating_sub(ahead), ahead.saturating_sub(gone).min(copies * came));
        let results = (copies * came - before).saturating_sub((copies - 1) * zeros);
        // Results begin so many rows behind the window's first.
        let first = (self.behind(way) + before).saturating_sub(copies * lead);
        count.add((rows, zeros));

        if skipped > 0 {
            // What the results are added to begins before the rows that came.
            shift_back(sequence, rows * width, skipped * width);
            copy(kept_rows, sequence);
        }
        let x = part_mut!(sequence, skipped * width..(skipped + rows) * width);
        let all = held + rows;
        copy(part!(kept_q, ..held * width), q);
        copy(part!(kept_scales, ..held), scales);
        let new_q = part_mut!(q, held * width..all * width);
        let new_scales = part_mut!(scales, held..all);
        match (self, way) {
            (Layer::Residual(layer), Direction::Forward) => {
                layer.activate(x, new_q, new_scales, row, gates.of(outer, entered, rows));
            }
            (Layer::Residual(layer), Direction::Back) => {
                layer.enter_gradient(x, new_q, new_scales, row, block, gates.of(inner, entered, rows));
            }
            (Layer::Convolution(conv), Direction::Back) => {
                mask::gate_rows(x, gates.of(outer, entered, rows), width);
                conv.quantise_gradient(x, new_q, new_scales, row);
            }
            _ => quantise::rows(x, width, quantise::limit(width), new_q, new_scales),
        }
        // As many rows are done with as came, zero rows first.
        let done = came.saturating_sub(lead).min(all);
        copy(part!(q, done * width..all * width), kept_q);
        copy(part!(scales, done..all), kept_scales);
        copy(part!(sequence, came * width..), kept_rows);
        let window = Rows { q: part!(q, ..all * width), scales: part!(scales, ..all) };

        match (self, way) {
            (Layer::Convolution(conv), Direction::Forward) => {
                let y = part_mut!(sequence, ..results * conv.outputs());
                conv.forward(window, first, y, rows_per_block, block.acc);
                mask::relu_rows(y, gates.of(outer, left, results), conv.outputs());
            }
            (Layer::Convolution(conv), Direction::Back) => {
                let dx = part_mut!(sequence, ..results * conv.inputs());
                conv.backward(window, first, dx, rows_per_block, block.acc);
            }
            (Layer::Residual(layer), _) => {
                let x = part_mut!(sequence, ..came * width);
                let to = part_mut!(x, before * width..);
                match way {
                    Direction::Forward => layer.add(window, first, to, block, gates.of(inner, left, results)),
                    Direction::Back => layer.add_gradient(window, first, to, block, gates.of(outer, left, results)),
                }
                shift_forward(x, before * width);
            }
            (Layer::Upsample(conv), _) => {
                let y = part_mut!(sequence, ..results * conv.outputs());
                conv.forward_upsampled(window, first, y, rows_per_block, block.acc);
            }
            (Layer::Output(output), _) => {
                let y = part_mut!(sequence, ..results * channels.count());
                let acc = &mut *block.acc;
                let mut scratch =
                    output::OutputScratch { row: &mut [], q: &mut [], scales: &mut [], rows_per_block, acc, acc_low };
                output.forward(window, first, channels, y, &mut scratch);
            }
        }
        results
    }
}

/// The way back through an upsampling: a row for two, as [`Layer::step`] otherwise.
fn downsample(
    conv: &Conv1d<'_>,
    tail: Tail<'_>,
    (rows, zeros): (usize, usize),
    sequence: &mut [f32],
    work: &mut Work<'_>,
) -> usize {
    let residual::ResidualScratch { row, block, .. } = &mut work.scratch;
    let width = conv.outputs();
    // Two copies and the rows beside them, two in all, make a result, and the next begins two rows later; zero rows come first.
    let results_of = |count: &Count| count.all().saturating_sub(conv.left()) / 2;
    let before = results_of(tail.count);
    let held = (conv.right() + tail.count.all()).saturating_sub(2 * before);
    tail.count.add((rows, zeros));
    let (all, results) = (held + rows + zeros, results_of(tail.count) - before);
    shift_back(sequence, rows * width, held * width);
    copy(part!(tail.rows, ..held * width), sequence);
    part_mut!(sequence, (held + rows) * width..all * width).fill(0.0);
    copy(part!(sequence, 2 * results * width..all * width), tail.rows);
    let mut block_of = GradientBlock { row, sums: &mut *block.rows, q: &mut *block.q, scales: &mut *block.scales };
    let window = part_mut!(sequence, ..2 * (results + 1) * width);
    conv.backward_upsampled(window, &mut block_of, block.acc);
    results
}

/// Moves the first `count` values `by` places back, so many at a time. Not by `copy_within`, which takes a kilobyte and a half of
/// flash.
fn shift_back(x: &mut [f32], count: usize, by: usize) {
    for first in (0..count).step_by(by.max(1)).rev() {
        let (from, to) = x.split_at_mut_checked(first + by).unwrap_or_default();
        copy(part!(from, first..count.min(first + by)), to);
    }
}

/// Moves all values `by` places to the front, likewise; the first are lost.
fn shift_forward(x: &mut [f32], by: usize) {
    if by > 0 {
        for first in (by..x.len()).step_by(by) {
            let (to, from) = x.split_at_mut_checked(first).unwrap_or_default();
            copy(from.get(..by).unwrap_or(from), part_mut!(to, first - by..));
        }
    }
}
