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

use super::decoder::{Check, Decoder, Interrupted, copy};
use crate::arena::{Arena, ArenaTooSmall, bytes_of};
use crate::blob::{MAX_BLOCKS, MAX_STAGES};
use crate::nn::conv1d::{BLOCK, Conv1d, GradientBlock, Rows, accumulators};
use crate::nn::output::{self, Channels, Output, WINDOW};
use crate::nn::residual::{self, Residual};
use crate::nn::{mask, quantise};

/// Layers a decoder may have.
const MAX_LAYERS: usize = 3 + MAX_STAGES * (MAX_BLOCKS + 1);

/// Which way rows pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// From the embeddings to the features.
    Forward,
    /// Gradients, from the features to the embeddings.
    Back,
}

/// A layer of the chain.
#[derive(Debug, Clone, Copy)]
pub(super) enum Layer<'d, 'a> {
    /// Convolution, then ReLU.
    Convolution(&'d Conv1d<'a>),
    /// Residual block.
    Residual(&'d Residual<'a>),
    /// Every row twice, then convolution.
    Upsample(&'d Conv1d<'a>),
    /// The last convolution. It takes gradients from the features themselves: on the way back rows begin behind it.
    Output(&'d Output<'a>),
}

impl Layer<'_, '_> {
    /// Channels of the rows that enter.
    const fn width(&self, way: Way) -> usize {
        match (self, way) {
            (Layer::Convolution(conv) | Layer::Upsample(conv), Way::Forward) => conv.inputs(),
            (Layer::Convolution(conv) | Layer::Upsample(conv), Way::Back) => conv.outputs(),
            (Layer::Residual(block), _) => block.conv1.inputs(),
            (Layer::Output(output), _) => output.inputs(),
        }
    }

    /// Rows that must have come after a row before what leaves the layer there is final.
    pub(super) const fn ahead(&self) -> usize {
        match self {
            Layer::Convolution(conv) => conv.reach(),
            Layer::Residual(block) => block.conv1.reach(),
            // Forward the second copy of a row looks at the first copy of the next; back a row looks at the one behind its copies.
            Layer::Upsample(_) => 1,
            Layer::Output(output) => output.reach(),
        }
    }

    /// Quantised rows that the next results still depend on. The first result is [`Layer::ahead`] behind the first of them.
    const fn kept(&self, way: Way) -> usize {
        match (self, way) {
            (Layer::Upsample(_), Way::Forward) => self.ahead(),
            (Layer::Upsample(_), Way::Back) => 0,
            _ => 2 * self.ahead(),
        }
    }

    /// Rows as they were that the next results are added to or made of, at most.
    const fn skipped(&self, way: Way) -> usize {
        match (self, way) {
            (Layer::Residual(_), _) => self.ahead(),
            // A row before the next row's first copy, and that copy if the other is yet to come.
            (Layer::Upsample(_), Way::Back) => 3,
            _ => 0,
        }
    }

    /// Rows of ReLUs' bits for each row of the layer.
    const fn gates(&self) -> usize {
        match self {
            Layer::Convolution(_) => 1,
            // Its input's, then its hidden rows'.
            Layer::Residual(_) => 2,
            Layer::Upsample(_) | Layer::Output(_) => 0,
        }
    }
}

/// What has entered a layer: rows, and then zero rows behind the motion's last. All else follows from these.
#[derive(Debug, Clone, Copy, Default)]
struct Count {
    rows: usize,
    zeros: usize,
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
struct Tail<'s> {
    /// Quantised rows, `[kept][K]`, of which the first are there.
    q: &'s mut [i16],
    /// Their scales, `[kept]`.
    scales: &'s mut [f32],
    /// Rows as they were, `[skipped][K]`.
    rows: &'s mut [f32],
    count: &'s mut Count,
}

/// All layers' tails, one after the other in the order of the pass.
#[derive(Debug)]
struct Tails<'w> {
    q: &'w mut [i16],
    scales: &'w mut [f32],
    rows: &'w mut [f32],
}

impl<'s> Tails<'s> {
    /// Takes a layer's from the front.
    fn next(&mut self, layer: &Layer<'_, '_>, way: Way, count: &'s mut Count) -> Tail<'s> {
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
    let (taken, others) = core::mem::take(rest).split_at_mut_checked(count).unwrap_or_default();
    *rest = others;
    taken
}

/// Bits of the ReLUs.
#[derive(Debug)]
pub(super) struct Gates<'w> {
    /// `[R][words(W)]`, all layers' one after the other, or as many as a chunk has where `kept` is false.
    pub bits: &'w mut [u32],
    /// Words of a row.
    pub words: usize,
    /// Whether they are for a gradient, of a motion of so many tokens.
    pub kept: Option<usize>,
}

impl Gates<'_> {
    /// Of `count` rows, `from` a layer's first row on, the `row`-th there.
    fn of(&mut self, from: usize, row: usize, count: usize) -> &mut [u32] {
        let first = if self.kept.is_some() { from + row } else { 0 };
        self.bits.get_mut(first * self.words..(first + count) * self.words).unwrap_or(&mut [])
    }
}

/// Where the last layer's quantised input goes, `[T][K]` and `[T]`, as far as there is room.
#[derive(Debug, Default)]
pub(super) struct Last<'w> {
    pub q: &'w mut [i16],
    pub scales: &'w mut [f32],
}

/// Rows being passed: the tails, and the buffers that a chunk passes through. Its size depends on decoder and chunk alone.
#[derive(Debug)]
pub(super) struct Chain<'w> {
    way: Way,
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

/// Buffers that a layer uses while it computes. The quantised rows of `scratch` are its window, `[kept + came][K]`.
#[derive(Debug)]
struct Work<'w> {
    scratch: residual::Scratch<'w>,
    /// Of the last layer's gradient.
    output_row: &'w mut [f32],
    output_q: &'w mut [i16],
    acc_low: &'w mut [i32],
}

/// Elements of each buffer of a [`Chain`].
#[derive(Debug, Clone, Copy)]
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
}

impl<'a> Decoder<'a> {
    /// Layer `index` in order of execution, and the upsampling stages that lie before it.
    #[inline(never)]
    fn layer(&self, index: usize) -> Option<(usize, Layer<'_, 'a>)> {
        let Some(mut at) = index.checked_sub(1) else { return Some((0, Layer::Convolution(&self.input))) };
        for (stage, layers) in self.stages.iter().enumerate() {
            if let Some(block) = layers.blocks.get(at) {
                return Some((stage, Layer::Residual(block)));
            }
            if at == layers.blocks.len() {
                return Some((stage, Layer::Upsample(&layers.upsample)));
            }
            at -= layers.blocks.len() + 1;
        }
        match at {
            0 => Some((self.stages.len(), Layer::Convolution(&self.middle))),
            1 => Some((self.stages.len(), Layer::Output(&self.output))),
            _ => None,
        }
    }

    /// Layers in order of execution, each with the upsampling stages before it.
    pub(super) fn layers(&self) -> impl Iterator<Item = (usize, Layer<'_, 'a>)> {
        (0..MAX_LAYERS).map_while(|index| self.layer(index))
    }

    /// The layer that rows pass at this place, and by how much they are doubled there.
    fn passed(&self, way: Way, place: usize) -> Option<(usize, Layer<'_, 'a>)> {
        match way {
            Way::Forward => self.layer(place),
            Way::Back => {
                let (stage, layer) = self.layer(self.behind_output().checked_sub(place)?)?;
                Some((stage + usize::from(matches!(layer, Layer::Upsample(_))), layer))
            }
        }
    }

    /// Index of the layer before the last.
    fn behind_output(&self) -> usize {
        self.layers().count().saturating_sub(2)
    }

    fn all_passed(&self, way: Way) -> impl Iterator<Item = (usize, Layer<'_, 'a>)> {
        (0..MAX_LAYERS).map_while(move |place| self.passed(way, place))
    }

    /// Rows of ReLUs' bits of a motion of so many tokens.
    pub(super) fn gates(&self, tokens: usize) -> usize {
        self.layers().fold(0, |sum, (stage, layer)| sum + layer.gates() * (tokens << stage))
    }

    fn chain_sizes(&self, way: Way, chunk: usize, channels: usize) -> Sizes {
        let frames = chunk * self.upsampling();
        let block = frames.min(BLOCK);
        let (width, codes, wide) = (self.width, self.code_width(), channels.min(self.wide()));
        let (most, widest) = (width.max(channels), width.max(codes));
        let mut sizes = match way {
            Way::Forward => Sizes {
                tails_q: 0,
                tails_scales: 0,
                tails_rows: 0,
                sequence: frames * channels,
                q: 0,
                scales: 0,
                row: width,
                block,
                acc: accumulators(block, widest, most),
                acc_low: accumulators(block, width, wide),
                output_row: 0,
                output_q: 0,
            },
            Way::Back => Sizes {
                tails_q: 0,
                tails_scales: 0,
                tails_rows: 0,
                sequence: frames * width,
                q: 0,
                scales: 0,
                row: width,
                block,
                acc: accumulators(block, most, widest),
                acc_low: accumulators(block, wide, width),
                output_row: channels,
                output_q: (WINDOW - BLOCK + block) * channels,
            },
        };
        for (stage, layer) in self.all_passed(way) {
            let rows = chunk << stage;
            let outputs = match (layer, way) {
                (Layer::Upsample(_), Way::Forward) => 2 * rows,
                _ => rows + layer.skipped(way),
            };
            let inputs = layer.width(way);
            sizes.tails_q += layer.kept(way) * inputs;
            sizes.tails_scales += layer.kept(way);
            sizes.tails_rows += layer.skipped(way) * inputs;
            sizes.sequence = sizes.sequence.max(outputs * inputs.max(width));
            sizes.q = sizes.q.max((layer.kept(way) + rows) * inputs);
            sizes.scales = sizes.scales.max(layer.kept(way) + rows);
        }
        sizes
    }

    /// Arena bytes of what a [`Chain`] keeps from chunk to chunk.
    pub(super) fn tails_bytes(&self, way: Way) -> usize {
        let s = self.chain_sizes(way, 1, 1);
        bytes_of::<i16>(s.tails_q) + bytes_of::<f32>(s.tails_scales) + bytes_of::<f32>(s.tails_rows)
    }

    /// Arena bytes of [`Decoder::chain`].
    pub(super) fn chain_bytes(&self, way: Way, chunk: usize, channels: usize) -> usize {
        let s = self.chain_sizes(way, chunk, channels);
        self.tails_bytes(way)
            + bytes_of::<f32>(s.sequence)
            + bytes_of::<i16>(s.q)
            + bytes_of::<f32>(s.scales)
            + bytes_of::<f32>(s.row)
            + bytes_of::<f32>(s.block * self.width)
            + bytes_of::<i16>(s.block * self.width)
            + bytes_of::<f32>(s.block)
            + bytes_of::<i32>(s.acc)
            + bytes_of::<f32>(s.output_row)
            + bytes_of::<i16>(s.output_q)
            + bytes_of::<i32>(s.acc_low)
    }

    /// Takes the buffers for motions of any length with at most `channels` features, of which so many tokens pass at a time.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub(super) fn chain<'w>(
        &self,
        arena: &mut Arena<'w>,
        way: Way,
        chunk: usize,
        channels: usize,
    ) -> Result<Chain<'w>, ArenaTooSmall> {
        let s = self.chain_sizes(way, chunk, channels);
        Ok(Chain {
            way,
            chunk,
            tails: Tails {
                q: arena.take(s.tails_q)?,
                scales: arena.take(s.tails_scales)?,
                rows: arena.take(s.tails_rows)?,
            },
            counts: [Count::default(); MAX_LAYERS],
            sequence: arena.take(s.sequence)?,
            work: Work {
                scratch: residual::Scratch {
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
        self.sequence.get_mut(..self.rows * decoder.code_width()).unwrap_or(&mut [])
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
        let Work { scratch, output_row, output_q, acc_low } = &mut self.work;
        let mut last = output::Scratch { row: output_row, q: output_q, acc: scratch.block.acc, acc_low };
        let dx = self.sequence.get_mut(..frames * decoder.width).unwrap_or(&mut []);
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
    /// # Errors
    /// [`Interrupted`] when `check`, asked before every layer, says so. Nothing is lost: the next call carries on there.
    pub(super) fn pass(
        &mut self,
        decoder: &Decoder<'_>,
        channels: &Channels,
        gates: &mut Gates<'_>,
        last: &mut Last<'_>,
        check: Check<'_>,
    ) -> Result<&mut [f32], Interrupted> {
        let Chain { way, chunk, tails, counts, sequence, work, rows, layer: begun, ending, .. } = self;
        let mut complete = *ending;
        let mut width = match way {
            Way::Forward => channels.count(),
            Way::Back => decoder.code_width(),
        };
        let mut tails = Tails { q: &mut *tails.q, scales: &mut *tails.scales, rows: &mut *tails.rows };
        let tokens = gates.kept.unwrap_or(0);
        let mut gate = if *way == Way::Forward { 0 } else { decoder.gates(tokens) };
        for (place, (count, (stage, layer))) in counts.iter_mut().zip(decoder.all_passed(*way)).enumerate() {
            let tail = tails.next(&layer, *way, count);
            let own = layer.gates() * (tokens << stage);
            // Forward they lie in the order of the pass.
            let at = if *way == Way::Forward { gate } else { gate - own };
            gate = if *way == Way::Forward { gate + own } else { at };
            let due = layer.ahead().saturating_sub(tail.count.zeros);
            if place < *begun {
                complete &= due == 0;
                continue;
            }
            check()?;
            // Rows behind the motion, as far as they are due and there is room.
            let zeros = if complete { due.min((*chunk << stage).saturating_sub(*rows)) } else { 0 };
            complete &= due == zeros;
            let came = (*rows, zeros);
            *rows = match (layer, *way) {
                (Layer::Upsample(conv), Way::Back) => downsample(conv, tail, came, sequence, work),
                _ => {
                    // A residual block's hidden rows come behind its input's.
                    let at = (at, at + (tokens << stage));
                    layer.step(*way, tail, came, channels, sequence, (gates, at), last, work)
                }
            };
            *begun += 1;
        }
        self.complete = complete;
        width *= *rows;
        (*rows, *begun) = (0, 0);
        Ok(sequence.get_mut(..width).unwrap_or(&mut []))
    }
}

impl Layer<'_, '_> {
    /// Takes `rows` rows from the front of `sequence` and `zeros` zero rows behind them; writes the rows that have become
    /// final there. Returns how many.
    fn step(
        &self,
        way: Way,
        tail: Tail<'_>,
        (rows, zeros): (usize, usize),
        channels: &Channels,
        sequence: &mut [f32],
        (gates, (outer, inner)): (&mut Gates<'_>, (usize, usize)),
        last: &mut Last<'_>,
        work: &mut Work<'_>,
    ) -> usize {
        let Work { scratch: residual::Scratch { q, scales, row, block }, acc_low, .. } = work;
        let (width, ahead, skipped) = (self.width(way), self.ahead(), self.skipped(way));
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
        let first = (ahead + before).saturating_sub(copies * lead);
        count.add((rows, zeros));

        if skipped > 0 {
            // What the results are added to begins before the rows that came.
            shift_back(sequence, rows * width, skipped * width);
            copy(kept_rows, sequence);
        }
        let x = sequence.get_mut(skipped * width..(skipped + rows) * width).unwrap_or(&mut []);
        let all = held + rows;
        copy(kept_q.get(..held * width).unwrap_or(&[]), q);
        copy(kept_scales.get(..held).unwrap_or(&[]), scales);
        let new_q = q.get_mut(held * width..all * width).unwrap_or(&mut []);
        let new_scales = scales.get_mut(held..all).unwrap_or(&mut []);
        match (self, way) {
            (Layer::Residual(layer), Way::Forward) => {
                layer.activate(x, new_q, new_scales, row, gates.of(outer, entered, rows));
            }
            (Layer::Residual(layer), Way::Back) => {
                layer.enter_gradient(x, new_q, new_scales, row, block, gates.of(inner, entered, rows));
            }
            (Layer::Convolution(conv), Way::Back) => {
                mask::gate_rows(x, gates.of(outer, entered, rows), width);
                conv.quantise_gradient(x, new_q, new_scales, row);
            }
            _ => quantise::rows(x, width, quantise::limit(width), new_q, new_scales),
        }
        if let Layer::Output(_) = self {
            copy(new_q, last.q.get_mut(entered * width..).unwrap_or(&mut []));
            copy(new_scales, last.scales.get_mut(entered..).unwrap_or(&mut []));
        }
        // As many rows are done with as came, zero rows first.
        let done = came.saturating_sub(lead).min(all);
        copy(q.get(done * width..all * width).unwrap_or(&[]), kept_q);
        copy(scales.get(done..all).unwrap_or(&[]), kept_scales);
        copy(sequence.get(came * width..).unwrap_or(&[]), kept_rows);
        let window = Rows { q: q.get(..all * width).unwrap_or(&[]), scales: scales.get(..all).unwrap_or(&[]) };

        match (self, way) {
            (Layer::Convolution(conv), Way::Forward) => {
                let y = sequence.get_mut(..results * conv.outputs()).unwrap_or(&mut []);
                conv.forward(window, first, y, block.acc);
                mask::relu_rows(y, gates.of(outer, left, results), conv.outputs());
            }
            (Layer::Convolution(conv), Way::Back) => {
                let dx = sequence.get_mut(..results * conv.inputs()).unwrap_or(&mut []);
                conv.backward(window, first, dx, block.acc);
            }
            (Layer::Residual(layer), _) => {
                let x = sequence.get_mut(..came * width).unwrap_or(&mut []);
                let to = x.get_mut(before * width..).unwrap_or(&mut []);
                match way {
                    Way::Forward => layer.add(window, first, to, block, gates.of(inner, left, results)),
                    Way::Back => layer.add_gradient(window, first, to, block, gates.of(outer, left, results)),
                }
                shift_forward(x, before * width);
            }
            (Layer::Upsample(conv), _) => {
                let y = sequence.get_mut(..results * conv.outputs()).unwrap_or(&mut []);
                conv.forward_upsampled(window, first, y, block.acc);
            }
            (Layer::Output(output), _) => {
                let y = sequence.get_mut(..results * channels.count()).unwrap_or(&mut []);
                let mut scratch = output::Scratch { row: &mut [], q: &mut [], acc: block.acc, acc_low };
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
    let residual::Scratch { row, block, .. } = &mut work.scratch;
    let width = conv.outputs();
    // Two copies and a row on either side of them make a result, and the next begins two rows later; a zero row comes first.
    let results_of = |count: &Count| count.all().div_ceil(2).saturating_sub(1);
    let before = results_of(tail.count);
    let held = 1 + tail.count.all() - 2 * before;
    tail.count.add((rows, zeros));
    let (all, results) = (held + rows + zeros, results_of(tail.count) - before);
    shift_back(sequence, rows * width, held * width);
    copy(tail.rows.get(..held * width).unwrap_or(&[]), sequence);
    sequence.get_mut((held + rows) * width..all * width).unwrap_or(&mut []).fill(0.0);
    copy(sequence.get(2 * results * width..all * width).unwrap_or(&[]), tail.rows);
    let mut block_of = GradientBlock { row, sums: &mut *block.rows, q: &mut *block.q, scales: &mut *block.scales };
    let window = sequence.get_mut(..2 * (results + 1) * width).unwrap_or(&mut []);
    conv.backward_upsampled(window, &mut block_of, block.acc);
    results
}

/// Moves the first `count` values `by` places back.
fn shift_back(x: &mut [f32], count: usize, by: usize) {
    if let Some(x) = x.get_mut(..count + by)
        && count <= x.len()
        && by <= x.len() - count
    {
        x.copy_within(..count, by);
    }
}

/// Moves all values `by` places to the front.
fn shift_forward(x: &mut [f32], by: usize) {
    if by == 0 {
        return;
    }
    for at in 0..x.len().saturating_sub(by) {
        if let Some(&value) = x.get(at + by)
            && let Some(to) = x.get_mut(at)
        {
            *to = value;
        }
    }
}
