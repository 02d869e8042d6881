//! Rows on their way through the decoder's layers, a chunk at a time: forward, and the gradient back.
//!
//! Each layer keeps the end of its input, its tail: the quantised rows that its next outputs still depend on, and, for
//! a residual block, the f32 rows that its result will be added to. A chunk passes through the layers once; each
//! puts its tail in front of the rows that came, computes the rows that have thereby become final, hands those on,
//! and keeps the new end. It counts as if zero rows lay before the motion, and, layer by layer, once no rows can come from
//! above, as many behind it as the layer looks ahead; they are in no window, so taps outside the sequence cost nothing.
//!
//! Scales are per row, a row's taps are added in the same order, and no number depends on how many rows are computed at
//! a time: chunks of any length give the same bits. Of what lies between the layers nothing is kept for longer than that, so memory does
//! not grow with the motion but for the ReLUs' bits, if the gradient is to follow. The gradient of a convolution is one, too: it
//! passes from the last layer to the first in the same way, from the motion's beginning to its end.

use super::decoder::{ChunkShape, Decoder};
use super::layer::{Direction, Layer, MAX_LAYERS};
use super::step::{Chunk, Count, Masks, ReluMask, Tail, Work};
use crate::channels::Channels;
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::conv1d::accumulators;
use crate::nn::output::{self, window};
use crate::nn::residual;
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;

/// All layers' tails, one after the other in the order of the pass.
#[derive(Debug)]
struct Tails<'w> {
    q: &'w mut [i16],
    scales: &'w mut [f32],
    rows: &'w mut [f32],
}

impl<'s> Tails<'s> {
    fn take(arena: &mut Arena<'s>, s: &Sizes) -> Result<Self, ArenaTooSmall> {
        let (q, scales, rows) = (arena.take(s.tails_q)?, arena.take(s.tails_scales)?, arena.take(s.tails_rows)?);
        Ok(Tails { q, scales, rows })
    }

    /// Takes a layer's from the front.
    fn next(&mut self, layer: &Layer<'_, '_>, way: Direction, count: &'s mut Count) -> Tail<'s> {
        let (kept, skipped, width) = (layer.kept(way), layer.skipped(way), layer.width(way));
        Tail {
            q: front(&mut self.q, kept * width),
            scales: front(&mut self.scales, kept),
            rows: front(&mut self.rows, skipped * width),
            count,
        }
    }
}

/// Takes the first `count` values.
fn front<'s, T>(rest: &mut &'s mut [T], count: usize) -> &'s mut [T] {
    invariant!(rest.len() >= count, "{count} of {} values of the tails", rest.len());
    let (taken, others) = core::mem::take(rest).split_at_mut_checked(count).unwrap_or_default();
    *rest = others;
    taken
}

/// Rows being passed: the tails, and the buffers that a chunk passes through. Its size depends on decoder and chunk alone.
#[derive(Debug)]
pub(super) struct Chain<'w> {
    way: Direction,
    /// Tokens that pass at a time, at most.
    chunk: usize,
    tails: Tails<'w>,
    /// One a layer, in the order of the pass; nothing passes the others.
    counts: [Count; MAX_LAYERS],
    /// The chunk, at its present layer.
    sequence: &'w mut [f32],
    work: Work<'w>,
    /// Rows of the chunk.
    rows: usize,
    /// Layers that the chunk has passed.
    layer: usize,
    /// No rows will come after this chunk.
    ending: bool,
    /// All zero rows have entered the last layer.
    complete: bool,
}

/// Elements of each buffer of a [`Chain`].
#[derive(Debug, Clone, Copy, Default)]
struct Sizes {
    tails_q: usize,
    tails_scales: usize,
    tails_rows: usize,
    sequence: usize,
    q: usize,
    scales: usize,
    row: usize,
    /// Rows that a layer multiplies at a time: no more than a chunk becomes.
    block: usize,
    acc: usize,
    acc_low: usize,
    output_row: usize,
    output_q: usize,
    output_scales: usize,
}

impl<'a> Decoder<'a> {
    fn chain_sizes(&self, way: Direction, portion: ChunkShape, channels: usize) -> Sizes {
        let ChunkShape { tokens: chunk, rows } = portion;
        let frames = chunk * self.upsampling();
        let block = frames.min(rows);
        let (width, codes, wide) = (self.width, self.code_width(), channels.min(self.wide()));
        let (most, widest) = (width.max(channels), width.max(codes));
        let both = Sizes { row: width, block, ..Sizes::default() };
        let mut sizes = match way {
            Direction::Forward => Sizes {
                sequence: frames * channels,
                acc: accumulators(block, widest, most),
                acc_low: accumulators(block, width, wide),
                ..both
            },
            Direction::Back => Sizes {
                sequence: frames * width,
                acc: accumulators(block, most, widest),
                acc_low: accumulators(block, wide, width),
                output_row: channels,
                output_q: window(block) * channels,
                output_scales: 2 * window(block),
                ..both
            },
        };
        for (stage, layer) in self.passed(way) {
            let rows = chunk << stage;
            let outputs = match (layer, way) {
                (Layer::Upsample(_), Direction::Forward) => 2 * rows,
                _ => rows + layer.skipped(way),
            };
            let inputs = layer.width(way);
            sizes.tails_q += layer.kept(way) * inputs;
            sizes.tails_scales += layer.kept(way);
            sizes.tails_rows += layer.skipped(way) * inputs;
            let results = match (layer, way) {
                // The last one back is as wide as a code.
                (Layer::Convolution(conv), Direction::Back) => conv.inputs(),
                _ => width,
            };
            sizes.sequence = sizes.sequence.max(outputs * inputs.max(results));
            sizes.q = sizes.q.max((layer.kept(way) + rows) * inputs);
            sizes.scales = sizes.scales.max(layer.kept(way) + rows);
        }
        sizes
    }

    /// Arena bytes of what a [`Chain`] keeps from chunk to chunk.
    pub(super) fn tails_bytes(&self, way: Direction) -> usize {
        let s = self.chain_sizes(way, ChunkShape { tokens: 1, rows: 1 }, 1);
        Arena::measure(|arena| Tails::take(arena, &s))
    }

    /// Takes the buffers for motions of any length with at most `channels` features, of which such portions pass at a time.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub(super) fn chain<'w>(
        &self,
        arena: &mut Arena<'w>,
        way: Direction,
        portion: ChunkShape,
        channels: usize,
    ) -> Result<Chain<'w>, ArenaTooSmall> {
        let s = self.chain_sizes(way, portion, channels);
        Ok(Chain {
            way,
            chunk: portion.tokens,
            tails: Tails::take(arena, &s)?,
            counts: [Count::default(); MAX_LAYERS],
            sequence: arena.take(s.sequence)?,
            work: Work {
                scratch: residual::ResidualScratch {
                    q: arena.take(s.q)?,
                    scales: arena.take(s.scales)?,
                    row: arena.take(s.row)?,
                    block: residual::Block {
                        rows: arena.take(s.block * self.width)?,
                        q: arena.take(s.block * self.width)?,
                        scales: arena.take(s.block)?,
                        acc: arena.take(s.acc)?,
                    },
                },
                output_row: arena.take(s.output_row)?,
                output_q: arena.take(s.output_q)?,
                output_scales: arena.take(s.output_scales)?,
                acc_low: arena.take(s.acc_low)?,
            },
            rows: 0,
            layer: 0,
            ending: false,
            complete: false,
        })
    }
}

impl Chain<'_> {
    /// Where the next chunk of embeddings is to be written to, `[tokens][du]`. Empty while a chunk that was interrupted waits to
    /// be carried on, and when the motion has ended.
    pub(super) fn begin(&mut self, decoder: &Decoder<'_>, tokens: usize) -> &mut [f32] {
        if self.waiting() || self.ending {
            return &mut [];
        }
        self.rows = tokens.min(self.chunk);
        part_mut!(self.sequence, ..self.rows * decoder.code_width())
    }

    /// Begins the next chunk of gradients: that of the last layer's input in `frames` frames from `first` on, of the features'
    /// gradient `g [T][C]`.
    pub(super) fn begin_gradient(
        &mut self,
        decoder: &Decoder<'_>,
        g: &[f32],
        channels: &Channels,
        first: usize,
        frames: usize,
    ) {
        let Work { scratch, output_row, output_q, output_scales, acc_low } = &mut self.work;
        let rows_per_block = scratch.block.scales.len();
        let acc = &mut *scratch.block.acc;
        let mut last =
            output::OutputScratch { row: output_row, q: output_q, scales: output_scales, rows_per_block, acc, acc_low };
        let dx = part_mut!(self.sequence, ..frames * decoder.width);
        decoder.output.backward(g, channels, first, dx, &mut last);
        self.rows = frames;
    }

    /// Says that no rows will come any more: each [`Chain::pass`] from now on brings the rest of the motion nearer.
    /// A chunk that waits is still part of it.
    pub(super) const fn end(&mut self) {
        self.ending = true;
    }

    /// Whether a chunk waits to be carried on.
    pub(super) const fn waiting(&self) -> bool {
        self.layer != 0 || self.rows != 0
    }

    /// Whether the whole motion has come out.
    pub(super) const fn ended(&self) -> bool {
        self.complete && !self.waiting()
    }

    /// Passes the chunk through the layers. Returns the rows that have become final, which may be none.
    ///
    /// Breaks off when `check`, asked before every layer, says so. Nothing is lost: the next call carries on there.
    pub(super) fn pass(
        &mut self,
        decoder: &Decoder<'_>,
        channels: &Channels,
        gates: &mut ReluMask<'_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop, &mut [f32]> {
        let Chain { way, chunk, tails, counts, sequence, work, rows, layer: begun, ending, .. } = self;
        let mut complete = *ending;
        let mut width = match way {
            Direction::Forward => channels.count(),
            Direction::Back => decoder.code_width(),
        };
        let mut tails = Tails { q: &mut *tails.q, scales: &mut *tails.scales, rows: &mut *tails.rows };
        let tokens = gates.kept.unwrap_or(0);
        let mut gate = if *way == Direction::Forward { 0 } else { decoder.gates(tokens) };
        for (place, (count, (stage, layer))) in counts.iter_mut().zip(decoder.passed(*way)).enumerate() {
            let tail = tails.next(&layer, *way, count);
            let own = layer.gates() * (tokens << stage);
            // Forward they lie in the order of the pass.
            let at = if *way == Direction::Forward { gate } else { gate - own };
            gate = if *way == Direction::Forward { gate + own } else { at };
            let due = layer.ahead(*way).saturating_sub(tail.count.zeros);
            if place < *begun {
                complete &= due == 0;
                continue;
            }
            check()?;
            // Rows behind the motion, as far as they are due and there is room.
            let zeros = if complete { due.min((*chunk << stage).saturating_sub(*rows)) } else { 0 };
            complete &= due == zeros;
            let chunk = Chunk { sequence, rows: *rows, zeros };
            // A residual block's hidden rows come behind its input's.
            let masks = Masks { mask: &mut *gates, outer: at, inner: at + (tokens << stage) };
            *rows = layer.step(*way, tail, chunk, masks, channels, work);
            *begun += 1;
        }
        self.complete = complete;
        width *= *rows;
        (*rows, *begun) = (0, 0);
        ControlFlow::Continue(part_mut!(sequence, ..width))
    }
}
