//! Transformer blocks: self-attention, optional cross-attention to a memory, feed-forward layer.
//!
//! Pre: `x += Out(attention(LN1 x))`, `x += CrossOut(attention(LNc x, memory))`, `x += F2(act(F1(LN2 x)))`.
//! Post: the same with each norm behind its sum instead: `x = LN1(x + Out(attention(x)))`, and so on.
//!
//! Keys and values of all rows come first; from there on a block works through its rows some at a time ([`Sizes::rows`]), in place,
//! so that nothing but keys and values is kept a row. A stack's blocks stay in the tensor table and are resolved one at a
//! time as they are run: a model costs no memory a layer.

use super::activation::{self, Activation};
use super::attention::{self, Heads, Segment, SegmentMut, attend};
use super::conv1d::{Rows, larger};
use super::linear::Linear;
use super::norm::{LayerNorm, MAX_INPUT};
use super::quantise;
use crate::blob::{Error, Tensors};
use crate::kernels::room;
use crate::memory::{Arena, ArenaTooSmall};
use heapless::Vec;
use serde::Serialize;

/// Segments that self-attention may read: a sequence's own rows and those that something else adds.
pub const MAX_SEGMENTS: usize = 2;

/// Where a transformer block normalises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Norm {
    /// What goes into each sublayer: `x += f(LN x)`.
    Pre,
    /// What comes out of each skip connection: `x = LN(x + f(x))`.
    Post,
}

/// Shape of a stack of transformer blocks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TransformerConfig {
    /// Width of a row.
    pub width: u16,
    /// Attention heads; they divide the width.
    pub heads: u8,
    /// Blocks.
    pub layers: u8,
    /// Width of the feed-forward layer.
    pub hidden: u16,
    /// Where blocks normalise.
    pub norm: Norm,
    /// Activation of the feed-forward layer.
    pub activation: Activation,
    /// Added to the variance under the root.
    pub epsilon: f32,
}

/// Cross-attention of a block.
#[derive(Debug, Clone, Copy)]
struct Cross<'a> {
    norm: LayerNorm<'a>,
    query: Linear<'a>,
    /// `dt` to `2 d`: keys, then values.
    keys_values: Linear<'a>,
    out: Linear<'a>,
}

/// One block in flash.
#[derive(Debug, Clone, Copy)]
pub struct Block<'a> {
    config: TransformerConfig,
    norm1: LayerNorm<'a>,
    /// `d` to `3 d`: queries, keys, values.
    qkv: Linear<'a>,
    out: Linear<'a>,
    cross: Option<Cross<'a>>,
    norm2: LayerNorm<'a>,
    up: Linear<'a>,
    down: Linear<'a>,
}

/// Sizes that a [`BlockScratch`] must serve.
#[derive(Debug, Clone, Copy, Default)]
pub struct Sizes {
    /// Most rows at a time, no more than [`MOST_ROWS`](super::linear::MOST_ROWS).
    pub rows: usize,
    /// Widest row.
    pub width: usize,
    /// Widest input of any linear layer.
    pub inputs: usize,
    /// Widest output of any linear layer that is not a feed-forward layer's.
    pub outputs: usize,
    /// Widest feed-forward layer.
    pub hidden: usize,
    /// Widest head.
    pub head: usize,
    /// Most keys that a row attends to.
    pub keys: usize,
}

impl Sizes {
    /// Sizes that serve both.
    #[must_use]
    pub fn with(self, other: Sizes) -> Sizes {
        let most = |a: usize, b: usize| if a > b { a } else { b };
        Sizes {
            rows: most(self.rows, other.rows),
            width: most(self.width, other.width),
            inputs: most(self.inputs, other.inputs),
            outputs: most(self.outputs, other.outputs),
            hidden: most(self.hidden, other.hidden),
            head: most(self.head, other.head),
            keys: most(self.keys, other.keys),
        }
    }

    const fn acc(&self) -> usize {
        let sums = most(&[self.outputs, self.width, self.hidden, self.keys, self.head]);
        self.rows * sums + room(self.rows, most(&[self.terms(), self.keys, self.head]))
    }

    /// Longest input of any linear layer.
    const fn terms(&self) -> usize {
        most(&[self.inputs, self.width, self.hidden])
    }

    const fn q(&self) -> usize {
        self.rows * self.terms()
    }
}

/// The largest.
const fn most(mut numbers: &[usize]) -> usize {
    let mut most = 0;
    while let [first, others @ ..] = numbers {
        if *first > most {
            most = *first;
        }
        numbers = others;
    }
    most
}

/// One block of rows on its way through the layers.
#[derive(Debug)]
pub struct BlockScratch<'w> {
    /// `[rows][d]`
    a: &'w mut [f32],
    /// `[rows][d]`
    b: &'w mut [f32],
    /// `[rows][hidden]`
    hidden: &'w mut [f32],
    /// `[rows][K]`
    q: &'w mut [i16],
    /// `[rows]`
    scales: &'w mut [f32],
    attention: attention::AttentionScratch<'w>,
}

/// What a stack of blocks works in.
#[derive(Debug)]
pub struct StackScratch<'o, 's> {
    /// Keys and values of the rows that pass, as many as they are.
    pub own: SegmentMut<'o>,
    /// One block of rows.
    pub block: &'o mut BlockScratch<'s>,
}

impl<'w> BlockScratch<'w> {
    /// Takes the buffers.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn new(arena: &mut Arena<'w>, sizes: &Sizes) -> Result<Self, ArenaTooSmall> {
        Ok(BlockScratch {
            a: arena.take(sizes.rows * sizes.width)?,
            b: arena.take(sizes.rows * sizes.width)?,
            hidden: arena.take(sizes.rows * sizes.hidden)?,
            q: arena.take(sizes.q())?,
            scales: arena.take(sizes.rows)?,
            attention: attention::AttentionScratch {
                q: arena.take(sizes.rows * sizes.head)?,
                scales: arena.take(sizes.rows)?,
                scores: arena.take(sizes.rows * sizes.keys)?,
                p: arena.take(sizes.rows * sizes.keys)?,
                acc: arena.take(sizes.acc())?,
            },
        })
    }

    /// Rows there is room for.
    const fn rows(&self) -> usize {
        self.scales.len()
    }

    /// `out [R][N]` of `x [R][K]`, no more rows than there is room for.
    #[inline(never)]
    pub fn linear(&mut self, layer: &Linear<'_>, x: &[f32], out: &mut [f32]) {
        let rows = quantised(x, layer.inputs(), self.q, self.scales);
        layer.forward(rows, out, self.attention.acc);
    }

    /// `x [R][K]` becomes what the layer makes of it, as wide as it was.
    #[cfg(feature = "masked")]
    pub fn replace(&mut self, layer: &Linear<'_>, x: &mut [f32]) {
        let made = core::mem::take(&mut self.b);
        for x in x.chunks_mut((self.rows() * layer.inputs()).max(1)) {
            let made = part_mut!(made, ..x.len());
            self.linear(layer, x, made);
            for (to, from) in x.iter_mut().zip(made) {
                *to = *from;
            }
        }
        self.b = made;
    }

    /// Adds that to `out`.
    #[inline(never)]
    fn add_linear(&mut self, layer: &Linear<'_>, x: &[f32], out: &mut [f32]) {
        let rows = quantised(x, layer.inputs(), self.q, self.scales);
        layer.add(rows, out, self.attention.acc);
    }
}

/// Quantises rows, at most as many as there is room for.
#[inline(never)]
fn quantised<'q>(x: &[f32], width: usize, q: &'q mut [i16], scales: &'q mut [f32]) -> Rows<'q> {
    quantise::rows(x, width, quantise::limit(width), q, scales);
    let rows = x.len() / width.max(1);
    Rows { q: part!(q, ..rows * width), scales: part!(scales, ..rows) }
}

impl<'a> Block<'a> {
    /// Reads a block from the next tensors; with `memory`, the width of the rows that it attends to, it has
    /// cross-attention.
    #[inline(never)]
    fn open(tensors: &mut Tensors<'a>, config: TransformerConfig, memory: Option<u16>) -> Result<Self, Error> {
        let TransformerConfig { width, hidden, epsilon, .. } = config;
        let norm1 = LayerNorm::open(tensors, width, epsilon)?;
        let qkv = Linear::open(tensors, width, width.saturating_mul(3))?;
        let out = Linear::open(tensors, width, width)?;
        let cross = match memory {
            None => None,
            Some(memory) => Some(Cross {
                norm: LayerNorm::open(tensors, width, epsilon)?,
                query: Linear::open(tensors, width, width)?,
                keys_values: Linear::open(tensors, memory, width.saturating_mul(2))?,
                out: Linear::open(tensors, width, width)?,
            }),
        };
        let norm2 = LayerNorm::open(tensors, width, epsilon)?;
        let up = Linear::open(tensors, width, hidden)?;
        let down = Linear::open(tensors, hidden, width)?;
        Ok(Block { config, norm1, qkv, out, cross, norm2, up, down })
    }

    const fn width(&self) -> usize {
        self.config.width as usize
    }

    /// A bound of `|x|` behind the block when `|x| <= bound` before it, `|memory| <= memory`, and keys and values that
    /// self-attention reads beside its own are at most `extra`; `None` where a number on the way could leave the range that its
    /// successor takes.
    #[inline(never)]
    fn bound(&self, bound: f32, memory: f32, extra: f32) -> Option<f32> {
        let within = |bound: f32| if bound < MAX_INPUT { Some(bound) } else { None };
        let post = self.config.norm == Norm::Post;
        let into = |norm: &LayerNorm<'_>, x: f32| if post { x } else { norm.bound() };
        let onward = |norm: &LayerNorm<'_>, x: f32| if post { norm.bound() } else { x };
        // Attention averages: what comes out of it is no larger than its values, but for their rounding.
        let mut x = within(bound)?;
        let values = within(larger(self.qkv.bound(within(into(&self.norm1, x))?), extra))?;
        x = onward(&self.norm1, within(x + self.out.bound(1.01 * values))?);
        if let Some(cross) = &self.cross {
            within(cross.query.bound(within(into(&cross.norm, x))?))?;
            let values = within(cross.keys_values.bound(within(memory)?))?;
            x = onward(&cross.norm, within(x + cross.out.bound(1.01 * values))?);
        }
        let hidden = within(self.up.bound(within(into(&self.norm2, x))?))?;
        x = onward(&self.norm2, within(x + self.down.bound(hidden))?);
        within(x)
    }

    /// Keys and values of `memory [n][dt]` for the cross-attention of this block, into `segment`.
    pub fn read_memory(&self, memory: &[f32], segment: &mut SegmentMut<'_>, scratch: &mut BlockScratch<'_>) {
        let Some(cross) = &self.cross else { return };
        let inputs = cross.keys_values.inputs().max(1);
        let rows_per_block = scratch.rows();
        for (block, rows) in memory.chunks((rows_per_block * inputs).max(1)).enumerate() {
            project(self.heads(), &cross.keys_values, 0, rows, block * rows_per_block, segment, scratch);
        }
    }

    /// Keys and values of all rows of `x [n][d]` into `own`, behind its first `at` rows.
    fn read_own(&self, x: &[f32], at: usize, own: &mut SegmentMut<'_>, scratch: &mut BlockScratch<'_>) {
        let width = self.width().max(1);
        let rows_per_block = scratch.rows();
        for (block, x) in x.chunks((rows_per_block * width).max(1)).enumerate() {
            let at = at + block * rows_per_block;
            match self.config.norm {
                Norm::Post => project(self.heads(), &self.qkv, width, x, at, own, scratch),
                Norm::Pre => {
                    let normed = core::mem::take(&mut scratch.a);
                    if let Some(rows) = normed.get_mut(..x.len()) {
                        self.norm1.forward(x, rows);
                        project(self.heads(), &self.qkv, width, rows, at, own, scratch);
                    }
                    scratch.a = normed;
                }
            }
        }
    }

    const fn heads(&self) -> Heads {
        heads(&self.config)
    }

    /// Runs the block over `x [n][d]` in place. `own` has room for `n` rows; self-attention reads `extra` beside them;
    /// `memory` holds what [`Block::read_memory`] made.
    pub fn forward(
        &self,
        x: &mut [f32],
        own: &mut SegmentMut<'_>,
        extra: Option<Segment<'_>>,
        memory: Option<Segment<'_>>,
        scratch: &mut BlockScratch<'_>,
    ) {
        self.read_own(x, 0, own, scratch);
        self.attend(x, own.view(), extra, memory, scratch);
    }

    /// Runs the block over one more row `x [d]` in place: it attends to the `at` rows whose keys and values are in `own` and to itself, and
    /// leaves its own keys and values there. `own` has room for all rows there may be.
    #[cfg(feature = "autoregressive")]
    pub fn append(&self, x: &mut [f32], at: usize, own: &mut SegmentMut<'_>, scratch: &mut BlockScratch<'_>) {
        self.read_own(x, at, own, scratch);
        self.attend(x, own.view().first(at + 1), None, None, scratch);
    }

    /// What follows once keys and values of the rows are there.
    fn attend(
        &self,
        x: &mut [f32],
        own: Segment<'_>,
        extra: Option<Segment<'_>>,
        memory: Option<Segment<'_>>,
        scratch: &mut BlockScratch<'_>,
    ) {
        let mut segments: Vec<Segment<'_>, MAX_SEGMENTS> = Vec::new();
        let _ = segments.push(own);
        if let Some(extra) = extra {
            let _ = segments.push(extra);
        }
        let width = self.width().max(1);
        let heads = self.heads();
        for x in x.chunks_mut((scratch.rows() * width).max(1)) {
            let queries = self.qkv.part(0, width);
            self.sublayer(&self.norm1, x, scratch, |rows, other, x, scratch| {
                add_attention(heads, &queries, &self.out, &segments, (rows, other), x, scratch);
            });
            if let (Some(cross), Some(memory)) = (&self.cross, memory) {
                self.sublayer(&cross.norm, x, scratch, |rows, other, x, scratch| {
                    add_attention(heads, &cross.query, &cross.out, &[memory], (rows, other), x, scratch);
                });
            }
            self.sublayer(&self.norm2, x, scratch, |rows, _, x, scratch| {
                add_feed_forward(self.config.activation, &self.up, &self.down, rows, x, scratch);
            });
        }
    }

    /// `x += f(LN x)` or `x = LN(x + f(x))` for as many rows as `scratch` has room for. `f` takes rows that it may overwrite, as many others to write to,
    /// and adds to the third.
    fn sublayer(
        &self,
        norm: &LayerNorm<'_>,
        x: &mut [f32],
        scratch: &mut BlockScratch<'_>,
        f: impl Fn(&mut [f32], &mut [f32], &mut [f32], &mut BlockScratch<'_>),
    ) {
        let (a, b) = (core::mem::take(&mut scratch.a), core::mem::take(&mut scratch.b));
        if let (Some(rows), Some(other)) = (a.get_mut(..x.len()), b.get_mut(..x.len())) {
            match self.config.norm {
                Norm::Pre => norm.forward(x, rows),
                Norm::Post => {
                    for (to, from) in rows.iter_mut().zip(x.iter()) {
                        *to = *from;
                    }
                }
            }
            f(rows, other, x, scratch);
            if self.config.norm == Norm::Post {
                norm.forward_in_place(x);
            }
        }
        (scratch.a, scratch.b) = (a, b);
    }
}

/// Keys and values of as many rows as `scratch` has room for, by the outputs of `layer` from `first` on.
fn project(
    heads: Heads,
    layer: &Linear<'_>,
    first: usize,
    rows: &[f32],
    at: usize,
    segment: &mut SegmentMut<'_>,
    scratch: &mut BlockScratch<'_>,
) {
    let width = (heads.count * heads.width).max(1);
    let count = rows.len() / layer.inputs().max(1);
    let x = quantised(rows, layer.inputs(), scratch.q, scratch.scales);
    let out = part_mut!(scratch.b, ..count * width);
    layer.part(first, width).forward(x, out, scratch.attention.acc);
    for (row, key) in out.chunks_exact(width).enumerate() {
        segment.put_key(heads, at + row, key);
    }
    layer.part(first + width, width).forward(x, out, scratch.attention.acc);
    for (row, value) in out.chunks_exact(width).enumerate() {
        segment.put_value(heads, at + row, value);
    }
}

/// Keys and values of low rank, `kv(down x)` of `x [n][d]`, for the self-attention of a block of width `H dh`, into `segment`.
pub fn project_low_rank(
    heads: Heads,
    down: &Linear<'_>,
    kv: &Linear<'_>,
    x: &[f32],
    segment: &mut SegmentMut<'_>,
    scratch: &mut BlockScratch<'_>,
) {
    let inputs = down.inputs().max(1);
    let rows_per_block = scratch.rows();
    for (block, x) in x.chunks((rows_per_block * inputs).max(1)).enumerate() {
        let low = core::mem::take(&mut scratch.a);
        if let Some(rows) = low.get_mut(..x.len() / inputs * down.outputs()) {
            scratch.linear(down, x, rows);
            project(heads, kv, 0, rows, block * rows_per_block, segment, scratch);
        }
        scratch.a = low;
    }
}

/// `x += Out(attention(Query rows))`.
fn add_attention(
    heads: Heads,
    query: &Linear<'_>,
    out: &Linear<'_>,
    segments: &[Segment<'_>],
    (rows, other): (&mut [f32], &mut [f32]),
    x: &mut [f32],
    scratch: &mut BlockScratch<'_>,
) {
    scratch.linear(query, rows, other);
    attend(heads, other, segments, rows, &mut scratch.attention);
    scratch.add_linear(out, rows, x);
}

/// `x += F2(act(F1 rows))`.
fn add_feed_forward(
    kind: Activation,
    up: &Linear<'_>,
    down: &Linear<'_>,
    rows: &[f32],
    x: &mut [f32],
    scratch: &mut BlockScratch<'_>,
) {
    let hidden = core::mem::take(&mut scratch.hidden);
    let count = rows.len() / up.inputs().max(1);
    if let Some(wide) = hidden.get_mut(..count * up.outputs()) {
        scratch.linear(up, rows, wide);
        activation::apply(kind, wide);
        scratch.add_linear(down, wide, x);
    }
    scratch.hidden = hidden;
}

/// How a stack's width is split.
#[must_use]
pub const fn heads(config: &TransformerConfig) -> Heads {
    let count = if config.heads == 0 { 1 } else { config.heads as usize };
    Heads { count, width: config.width as usize / count }
}

/// A stack of blocks, left in the tensor table.
#[derive(Debug, Clone, Copy)]
pub struct Stack<'a> {
    config: TransformerConfig,
    memory: Option<u16>,
    /// Its layers have weights of 16 bits.
    #[cfg(feature = "wide-layers")]
    wide: bool,
    first: Tensors<'a>,
}

impl<'a> Stack<'a> {
    /// Checks the blocks in the next tensors and remembers where they are.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor.
    pub fn open(tensors: &mut Tensors<'a>, config: TransformerConfig, memory: Option<u16>) -> Result<Self, Error> {
        let first = tensors.trusted();
        #[cfg(feature = "wide-layers")]
        let mut wide = false;
        for _ in 0..config.layers {
            let _block = Block::open(tensors, config, memory)?;
            #[cfg(feature = "wide-layers")]
            {
                wide |= _block.qkv.wide();
            }
        }
        Ok(Stack {
            config,
            memory,
            #[cfg(feature = "wide-layers")]
            wide,
            first,
        })
    }

    /// Whether keys and values have 16 bits, as its weights.
    #[cfg(feature = "wide-layers")]
    #[must_use]
    pub const fn wide(&self) -> bool {
        self.wide
    }

    /// A bound of the rows behind the last block when rows and memory before the first are bounded so, and keys and values
    /// that self-attention reads beside its own.
    ///
    /// # Errors
    /// [`Error::Unbounded`] where numbers could leave the range that a layer takes.
    pub fn bound(&self, rows: f32, memory: f32, extra: f32) -> Result<f32, Error> {
        let mut tensors = self.first;
        let mut bound = rows;
        for _ in 0..self.config.layers {
            let index = tensors.index();
            let block = Block::open(&mut tensors, self.config, self.memory)?;
            bound = block.bound(bound, memory, extra).ok_or(Error::Unbounded { index })?;
        }
        Ok(bound)
    }

    /// The configuration.
    #[must_use]
    pub const fn config(&self) -> &TransformerConfig {
        &self.config
    }

    /// How the width is split.
    #[must_use]
    pub const fn heads(&self) -> Heads {
        heads(&self.config)
    }

    /// The blocks in order of execution.
    pub fn blocks(&self) -> impl Iterator<Item = Block<'a>> + use<'a> {
        let Stack { config, memory, mut first, .. } = *self;
        // They opened once, so they open again.
        (0..config.layers).map_while(move |_| Block::open(&mut first, config, memory).ok())
    }

    /// What a [`BlockScratch`] must serve for so many rows, keys beside them, and rows of memory.
    #[must_use]
    pub fn sizes(&self, rows: usize, extra: usize, memory: usize) -> Sizes {
        sizes(&self.config, usize::from(self.memory.unwrap_or(0)), rows + extra, memory)
    }

    /// Multiply-accumulates of a pass over `rows` rows with `extra` keys beside them and `memory` rows of memory, without
    /// making the latter two.
    #[must_use]
    pub fn macs(&self, rows: usize, extra: usize, memory: usize) -> u64 {
        let macs = macs(&self.config, rows, rows + extra, self.memory.map(|_| memory));
        // Weights, keys and values come in two planes.
        #[cfg(feature = "wide-layers")]
        let macs = if self.wide { 2 * macs } else { macs };
        macs
    }

    /// Multiply-accumulates of reading `memory` rows of memory in all blocks.
    #[must_use]
    pub fn memory_macs(&self, memory: usize) -> u64 {
        let TransformerConfig { width, layers, .. } = self.config;
        let each = u64::from(self.memory.unwrap_or(0)) * 2 * u64::from(width);
        u64::from(layers) * memory as u64 * each
    }
}

/// What a [`BlockScratch`] must serve for blocks whose rows attend to so many keys, and to `memory` rows of width `inputs`.
#[must_use]
pub fn sizes(config: &TransformerConfig, inputs: usize, keys: usize, memory: usize) -> Sizes {
    let width = usize::from(config.width);
    Sizes {
        rows: 0,
        width,
        inputs: if inputs > width { inputs } else { width },
        outputs: width,
        hidden: usize::from(config.hidden),
        head: heads(config).width,
        keys: if memory > keys { memory } else { keys },
    }
}

/// Multiply-accumulates of blocks over `rows` rows that attend to so many keys and, with cross-attention, rows of memory.
#[must_use]
pub fn macs(config: &TransformerConfig, rows: usize, keys: usize, memory: Option<usize>) -> u64 {
    let (width, hidden) = (u64::from(config.width), u64::from(config.hidden));
    let attention = |keys: usize| attention::macs(heads(config), keys);
    let own = 4 * width * width + attention(keys);
    let cross = memory.map_or(0, |memory| 2 * width * width + attention(memory));
    u64::from(config.layers) * rows as u64 * (own + cross + 2 * width * hidden)
}

/// Refuses a bound that is not below `limit`, naming the tensor.
pub(crate) fn below(bound: f32, limit: f32, index: u16) -> Result<f32, Error> {
    if bound < limit { Ok(bound) } else { Err(Error::Unbounded { index }) }
}
