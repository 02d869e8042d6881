//! Decoding a motion in segments, with the bits of [`Decoder::forward`] over the whole of it.
//!
//! Each layer keeps the end of its input, its tail: the quantised rows that its next outputs still depend on, and, for
//! a residual block, the f32 rows that its result will be added to. A chunk of tokens passes through the chain once; each
//! layer puts its tail in front of the rows that came, computes the rows that have thereby become final, hands those on,
//! and keeps the new end. Rows before the motion are zero rows with scale zero, which add exactly what a tap outside
//! the sequence does: nothing. The end of the motion is the same at the other side: layer by layer, once no rows
//! can come from above, as many zero rows as the layer looks ahead.
//!
//! Scales are per row, a row's taps are added in the same order, and no number depends on how many rows are computed at
//! a time: segments give the same bits as the whole. The output lags by [`Decoder::radius_frames`].

use super::decoder::{Check, Decoder, Interrupted};
use crate::arena::{Arena, ArenaTooSmall, bytes_of};
use crate::blob::{MAX_BLOCKS, MAX_STAGES};
use crate::nn::conv1d::{BLOCK, Conv1d, Rows, accumulators};
use crate::nn::output::{self, Channels, Output};
use crate::nn::residual::{self, Residual};
use crate::nn::{mask, quantise};

/// Tokens that pass through the decoder at a time, at most: weights are read once for so many.
pub const CHUNK: usize = 4;
/// Layers a decoder may have.
const MAX_LAYERS: usize = 3 + MAX_STAGES * (MAX_BLOCKS + 1);

/// A layer of the chain.
#[derive(Debug, Clone, Copy)]
enum Layer<'d, 'a> {
    /// Convolution, then ReLU.
    Convolution(&'d Conv1d<'a>),
    /// Residual block.
    Residual(&'d Residual<'a>),
    /// Every row twice, then convolution.
    Upsample(&'d Conv1d<'a>),
    /// The last convolution.
    Output(&'d Output<'a>),
}

impl Layer<'_, '_> {
    /// Input channels.
    const fn inputs(&self) -> usize {
        match self {
            Layer::Convolution(conv) | Layer::Upsample(conv) => conv.inputs(),
            Layer::Residual(block) => block.conv1.inputs(),
            Layer::Output(output) => output.inputs(),
        }
    }

    /// Input rows that must have come after a row before the layer's output there is final. The first output row is as
    /// far behind the first row of the layer's window.
    const fn ahead(&self) -> usize {
        match self {
            Layer::Convolution(conv) => conv.reach(),
            Layer::Residual(block) => block.conv1.reach(),
            // The second copy of a row looks at the first copy of the next.
            Layer::Upsample(_) => 1,
            Layer::Output(output) => output.reach(),
        }
    }

    /// Input rows that the next outputs still depend on.
    const fn kept(&self) -> usize {
        match self {
            Layer::Upsample(_) => self.ahead(),
            _ => 2 * self.ahead(),
        }
    }

    /// Input rows that the next outputs are added to.
    const fn skipped(&self) -> usize {
        match self {
            Layer::Residual(_) => self.ahead(),
            _ => 0,
        }
    }
}

/// The end of a layer's input.
#[derive(Debug, Default)]
struct Tail<'w> {
    /// Quantised rows, `[kept][K]`.
    q: &'w mut [i16],
    /// Their scales, `[kept]`.
    scales: &'w mut [f32],
    /// The rows as they were, `[skipped][K]`.
    rows: &'w mut [f32],
    /// Output rows still to come that lie before the motion.
    before: usize,
    /// Zero rows that will follow the motion's last row.
    behind: usize,
}

/// A motion being decoded: the tails, and the buffers that a chunk passes through. Its size depends on the decoder alone.
#[derive(Debug)]
pub struct Stream<'w> {
    /// One a layer, in order of execution; the rest is empty.
    tails: [Tail<'w>; MAX_LAYERS],
    /// The chunk, at its present layer.
    sequence: &'w mut [f32],
    work: Work<'w>,
    /// Rows of the chunk.
    rows: usize,
    /// Layer that the chunk is to enter next.
    layer: usize,
    /// No tokens will come after this chunk.
    ending: bool,
}

/// Buffers that a layer uses while it computes. The quantised rows of `scratch` are its window, `[kept + came][K]`.
#[derive(Debug)]
struct Work<'w> {
    scratch: residual::Scratch<'w>,
    /// Of ReLUs; nobody reads them.
    masks: &'w mut [u32],
    acc_low: &'w mut [i32],
}

/// Elements of each buffer of a [`Stream`] beside the tails.
#[derive(Debug, Clone, Copy)]
struct Sizes {
    sequence: usize,
    q: usize,
    scales: usize,
    masks: usize,
    row: usize,
    /// Rows that a layer multiplies at a time: no more than a chunk becomes.
    block: usize,
    acc: usize,
    acc_low: usize,
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

    fn layers(&self) -> impl Iterator<Item = (usize, Layer<'_, 'a>)> {
        (0..MAX_LAYERS).map_while(|index| self.layer(index))
    }

    /// Frames by which the output lags behind the tokens: frame `t` is final when `(t + 1 + radius) / upsampling`
    /// tokens, rounded up, have come. For one motion the first frame comes with token [`Decoder::radius_tokens`], the
    /// token that the frame belongs to counted.
    #[must_use]
    pub fn radius_frames(&self) -> usize {
        self.layers().fold(0, |lag, (_, layer)| match layer {
            Layer::Upsample(_) => 2 * lag + 1,
            _ => lag + layer.ahead(),
        })
    }

    /// The same in tokens, rounded up: a token may change so many tokens' frames on either side.
    #[must_use]
    pub fn radius_tokens(&self) -> usize {
        self.radius_frames().div_ceil(self.upsampling().max(1))
    }

    /// Multiply-accumulates of one token that comes in chunks of `tokens`, between the ends of the motion; rounded up. A
    /// motion's ends cost nothing in addition.
    #[must_use]
    pub fn stream_macs(&self, tokens: usize, channels: &Channels) -> u64 {
        let tokens = if tokens == 0 { 1 } else { tokens as u64 };
        // The row that one chunk and the next both multiply in the upsampling convolutions, by one of three taps.
        let shared: u64 = self.stages.iter().map(|stage| (stage.upsample.macs()).div_ceil(3)).sum();
        self.macs(1, channels) + shared.div_ceil(tokens)
    }

    fn stream_sizes(&self, channels: usize) -> Sizes {
        let frames = CHUNK * self.upsampling();
        let block = frames.min(BLOCK);
        let mut sizes = Sizes {
            sequence: frames * channels,
            q: 0,
            scales: 0,
            masks: frames * mask::words(self.width),
            row: self.width,
            block,
            acc: accumulators(block, self.width.max(self.code_width()), self.width.max(channels)),
            acc_low: accumulators(block, self.width, channels.min(self.wide())),
        };
        for (stage, layer) in self.layers() {
            let rows = CHUNK << stage;
            let outputs = match layer {
                Layer::Upsample(_) => 2 * rows,
                _ => rows + layer.skipped(),
            };
            let widest = layer.inputs().max(self.width);
            sizes.sequence = sizes.sequence.max(outputs * widest);
            sizes.q = sizes.q.max((layer.kept() + rows) * layer.inputs());
            sizes.scales = sizes.scales.max(layer.kept() + rows);
        }
        sizes
    }

    /// Arena bytes of what [`Decoder::stream`] keeps from chunk to chunk.
    #[must_use]
    pub fn tail_bytes(&self) -> usize {
        self.layers().fold(0, |sum, (_, layer)| {
            sum + bytes_of::<i16>(layer.kept() * layer.inputs())
                + bytes_of::<f32>(layer.kept())
                + bytes_of::<f32>(layer.skipped() * layer.inputs())
        })
    }

    /// Arena bytes of [`Decoder::stream`] in all.
    #[must_use]
    pub fn stream_bytes(&self, channels: usize) -> usize {
        let s = self.stream_sizes(channels);
        self.tail_bytes()
            + bytes_of::<f32>(s.sequence)
            + bytes_of::<i16>(s.q)
            + bytes_of::<f32>(s.scales)
            + bytes_of::<f32>(s.row)
            + bytes_of::<f32>(s.block * self.width)
            + bytes_of::<i16>(s.block * self.width)
            + bytes_of::<f32>(s.block)
            + bytes_of::<i32>(s.acc)
            + bytes_of::<u32>(s.masks)
            + bytes_of::<i32>(s.acc_low)
    }

    /// Takes the buffers for a motion of any length with at most `channels` output channels, before its first token.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn stream<'w>(&self, arena: &mut Arena<'w>, channels: usize) -> Result<Stream<'w>, ArenaTooSmall> {
        let mut tails: [Tail<'w>; MAX_LAYERS] = Default::default();
        for (tail, (_, layer)) in tails.iter_mut().zip(self.layers()) {
            *tail = Tail {
                q: arena.take(layer.kept() * layer.inputs())?,
                scales: arena.take(layer.kept())?,
                rows: arena.take(layer.skipped() * layer.inputs())?,
                before: layer.ahead(),
                behind: layer.ahead(),
            };
        }
        let s = self.stream_sizes(channels);
        Ok(Stream {
            tails,
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
                masks: arena.take(s.masks)?,
                acc_low: arena.take(s.acc_low)?,
            },
            rows: 0,
            layer: 0,
            ending: false,
        })
    }
}

impl<'w> Stream<'w> {
    /// The rows `[tokens][du]` that the next chunk is to be written to, at most [`CHUNK`]. Empty while a chunk
    /// that was interrupted waits to be carried on, and when the motion has ended.
    pub fn begin(&mut self, decoder: &Decoder<'_>, tokens: usize) -> &mut [f32] {
        if self.layer != 0 || self.rows != 0 || self.ending {
            return &mut [];
        }
        self.rows = tokens.min(CHUNK);
        self.sequence.get_mut(..self.rows * decoder.code_width()).unwrap_or(&mut [])
    }

    /// Says that no tokens will come any more: each [`Stream::advance`] from now on brings the rest of the motion nearer.
    /// A chunk that waits is still part of it.
    pub const fn end(&mut self) {
        self.ending = true;
    }

    /// Whether a chunk waits to be carried on.
    #[must_use]
    pub const fn waiting(&self) -> bool {
        self.layer != 0 || self.rows != 0
    }

    /// Whether the whole motion has come out.
    #[must_use]
    pub fn ended(&self) -> bool {
        self.ending && !self.waiting() && self.tails.iter().all(|tail| tail.behind == 0)
    }

    /// Passes the chunk through the decoder. Returns the frames that have become final, normalised features `[n][C]`, at
    /// most [`CHUNK`] times the upsampling; none is an answer as good as any.
    ///
    /// `channels` must be the same from the first chunk to the last.
    ///
    /// # Errors
    /// [`Interrupted`] when `check`, asked before every layer, says so. Nothing is lost: the next call carries on there.
    pub fn advance(
        &mut self,
        decoder: &Decoder<'_>,
        channels: &Channels,
        check: Check<'_>,
    ) -> Result<&mut [f32], Interrupted> {
        let Stream { tails, sequence, work, rows, layer: next, ending } = self;
        let begun = tails.iter().take(*next);
        let mut complete = *ending && begun.map(|tail| tail.behind).all(|behind| behind == 0);
        for ((stage, layer), tail) in decoder.layers().zip(tails.iter_mut()).skip(*next) {
            check()?;
            // Rows behind the motion, as far as they are due and there is room.
            let zeros = if complete { tail.behind.min((CHUNK << stage).saturating_sub(*rows)) } else { 0 };
            tail.behind -= zeros;
            complete &= tail.behind == 0;
            *rows = layer.step(tail, *rows, zeros, channels, sequence, work);
            *next += 1;
        }
        let count = *rows * channels.count();
        (*rows, *next) = (0, 0);
        Ok(sequence.get_mut(..count).unwrap_or(&mut []))
    }
}

impl Layer<'_, '_> {
    /// Takes `rows` rows from the front of `sequence` and `zeros` zero rows behind them; writes the rows that have become
    /// final there. Returns how many.
    fn step(
        &self,
        tail: &mut Tail<'_>,
        rows: usize,
        zeros: usize,
        channels: &Channels,
        sequence: &mut [f32],
        work: &mut Work<'_>,
    ) -> usize {
        let Work { scratch: residual::Scratch { q, scales, row, block }, masks, acc_low } = work;
        let (width, ahead, skipped) = (self.inputs(), self.ahead(), self.skipped());
        let (came, copies) = (rows + zeros, if let Layer::Upsample(_) = self { 2 } else { 1 });
        // Outputs before the motion's first row and behind its last are left out.
        let before = tail.before.min(copies * came);
        tail.before -= before;
        let outputs = (copies * came - before).saturating_sub((copies - 1) * zeros);
        let first = ahead + before;

        if skipped > 0 {
            // What the results are added to begins before the rows that came.
            shift_back(sequence, rows * width, skipped * width);
            copy(tail.rows, sequence);
        }
        let x = sequence.get(skipped * width..(skipped + rows) * width).unwrap_or(&[]);
        let kept = tail.scales.len();
        copy(tail.q, q);
        copy(tail.scales, scales);
        let new_q = q.get_mut(kept * width..(kept + came) * width).unwrap_or(&mut []);
        let new_scales = scales.get_mut(kept..kept + came).unwrap_or(&mut []);
        if let Layer::Residual(block) = self {
            block.activate(x, new_q, new_scales, row, masks);
        } else {
            quantise::rows(x, width, quantise::limit(width), new_q, new_scales);
        }
        new_q.get_mut(rows * width..).unwrap_or(&mut []).fill(0);
        new_scales.get_mut(rows..).unwrap_or(&mut []).fill(0.0);
        copy(q.get(came * width..).unwrap_or(&[]), tail.q);
        copy(scales.get(came..).unwrap_or(&[]), tail.scales);
        copy(sequence.get(came * width..).unwrap_or(&[]), tail.rows);
        let window =
            Rows { q: q.get(..(kept + came) * width).unwrap_or(&[]), scales: scales.get(..kept + came).unwrap_or(&[]) };

        match self {
            Layer::Convolution(conv) => {
                let y = sequence.get_mut(..outputs * conv.outputs()).unwrap_or(&mut []);
                conv.forward(window, first, y, block.acc);
                let words = mask::words(conv.outputs()).max(1);
                for (y, mask) in y.chunks_exact_mut(conv.outputs().max(1)).zip(masks.chunks_exact_mut(words)) {
                    mask::relu(y, mask);
                }
            }
            Layer::Residual(layer) => {
                let x = sequence.get_mut(..came * width).unwrap_or(&mut []);
                layer.add(window, first, x.get_mut(before * width..).unwrap_or(&mut []), block, masks);
                shift_forward(x, before * width);
            }
            Layer::Upsample(conv) => {
                let y = sequence.get_mut(..outputs * conv.outputs()).unwrap_or(&mut []);
                conv.forward_upsampled(window, first, y, block.acc);
            }
            Layer::Output(output) => {
                let y = sequence.get_mut(..outputs * channels.count()).unwrap_or(&mut []);
                let mut scratch = output::Scratch { row: &mut [], q: &mut [], acc: block.acc, acc_low };
                output.forward(window, first, channels, y, &mut scratch);
            }
        }
        outputs
    }
}

/// Copies as many values as both have.
fn copy<T: Copy>(from: &[T], to: &mut [T]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}

/// Moves the first `count` values `by` places back.
fn shift_back(x: &mut [f32], count: usize, by: usize) {
    for at in (0..count).rev() {
        if let Some(&value) = x.get(at)
            && let Some(to) = x.get_mut(at + by)
        {
            *to = value;
        }
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
