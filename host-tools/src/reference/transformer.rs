//! Linears, norms, attention and the blocks made of them; rows are `[n][width]`, row after row.
//!
//! Attention takes its keys and values as a list of segments with one softmax over all of them: a block's own rows are one, and
//! whoever wants a block to look at more hands further ones in.

use super::real::{Real, convert, dot};
use crate::checkpoint::prior::{self, Activation, Form, NormOrder};

/// Outputs computed side by side.
const LANES: usize = 8;
/// Rows computed side by side.
const ROWS: usize = 4;

/// `y = W x + b`.
#[derive(Debug, Clone)]
pub struct Linear<T> {
    /// Numbers in.
    pub inputs: usize,
    /// Numbers out.
    pub outputs: usize,
    /// `[outputs / LANES rounded up][inputs][LANES]`, zero behind the last output: inner loops run over neighbours.
    panels: Vec<[T; LANES]>,
    /// `[outputs / LANES rounded up][LANES]`
    bias: Vec<[T; LANES]>,
}

impl<T: Real> Linear<T> {
    /// From a checkpoint's weights.
    #[must_use]
    pub fn new(source: &prior::Linear) -> Self {
        let (inputs, outputs) = (source.inputs, source.outputs);
        let lane = |o: usize, value: &dyn Fn(usize) -> f32| {
            if o < outputs { T::from_f32(value(o)) } else { T::ZERO }
        };
        let mut panels = Vec::with_capacity(outputs.div_ceil(LANES) * inputs);
        let mut bias = Vec::with_capacity(outputs.div_ceil(LANES));
        for first in (0..outputs).step_by(LANES) {
            bias.push(core::array::from_fn(|l| lane(first + l, &|o| source.bias[o])));
            for i in 0..inputs {
                panels.push(core::array::from_fn(|l| lane(first + l, &|o| source.weight[o * inputs + i])));
            }
        }
        Self { inputs, outputs, panels, bias }
    }

    /// `x` `[n][inputs]` to `[n][outputs]`. Every sum begins with the bias and goes over the inputs in order.
    #[must_use]
    pub fn forward(&self, x: &[T]) -> Vec<T> {
        let mut y = vec![T::ZERO; x.len() / self.inputs * self.outputs];
        let blocks = x.chunks(ROWS * self.inputs).zip(y.chunks_mut(ROWS * self.outputs));
        for (x, y) in blocks {
            let last = x.len() / self.inputs - 1;
            // A short block computes its last row several times.
            let rows: [&[T]; ROWS] = core::array::from_fn(|r| &x[r.min(last) * self.inputs..][..self.inputs]);
            for (p, bias) in self.bias.iter().enumerate() {
                let sums = products(&self.panels[p * self.inputs..][..self.inputs], rows, *bias);
                for (y, sums) in y.chunks_exact_mut(self.outputs).zip(&sums) {
                    y[p * LANES..].iter_mut().zip(sums).for_each(|(y, &s)| *y = s);
                }
            }
        }
        y
    }
}

/// `ROWS` rows times one panel.
fn products<T: Real>(panel: &[[T; LANES]], [a, b, c, d]: [&[T]; ROWS], bias: [T; LANES]) -> [[T; LANES]; ROWS] {
    let mut sums = [bias; ROWS];
    for ((((w, &a), &b), &c), &d) in panel.iter().zip(a).zip(b).zip(c).zip(d) {
        for (sums, x) in sums.iter_mut().zip([a, b, c, d]) {
            for (sum, &w) in sums.iter_mut().zip(w) {
                *sum += x * w;
            }
        }
    }
    sums
}

/// A table with a row for every id.
#[derive(Debug, Clone)]
pub struct Embedding<T> {
    width: usize,
    table: Vec<T>,
}

impl<T: Real> Embedding<T> {
    /// From a checkpoint's weights.
    #[must_use]
    pub fn new(source: &prior::Embedding) -> Self {
        Self { width: source.width, table: convert(&source.weight) }
    }

    /// The rows of a linear, `[outputs][inputs]`, as a table.
    #[must_use]
    pub fn of_rows(source: &prior::Linear) -> Self {
        Self { width: source.inputs, table: convert(&source.weight) }
    }

    /// The row of an id.
    ///
    /// # Panics
    /// When there is none.
    #[must_use]
    pub fn row(&self, id: usize) -> &[T] {
        &self.table[id * self.width..][..self.width]
    }

    /// Adds the row of an id.
    ///
    /// # Panics
    /// When there is none.
    pub fn add(&self, id: usize, to: &mut [T]) {
        add(to, self.row(id));
    }
}

/// `(x - mean) / sqrt(variance + epsilon) * weight + bias`, the variance with divisor `width`.
#[derive(Debug, Clone)]
pub struct LayerNorm<T> {
    weight: Vec<T>,
    bias: Vec<T>,
    epsilon: T,
}

impl<T: Real> LayerNorm<T> {
    /// From a checkpoint's weights.
    #[must_use]
    pub fn new(source: &prior::LayerNorm, epsilon: f64) -> Self {
        Self { weight: convert(&source.weight), bias: convert(&source.bias), epsilon: T::from_f64(epsilon) }
    }

    /// Every row of `x` `[n][width]`.
    #[must_use]
    pub fn forward(&self, x: &[T]) -> Vec<T> {
        let width = self.weight.len();
        let count = T::from_f64(width as f64);
        let mut y = Vec::with_capacity(x.len());
        for row in x.chunks_exact(width) {
            let mean = row.iter().fold(T::ZERO, |s, &v| s + v) / count;
            let variance = row.iter().fold(T::ZERO, |s, &v| s + (v - mean) * (v - mean)) / count;
            let scale = T::ONE / (variance + self.epsilon).sqrt();
            y.extend(row.iter().zip(&self.weight).zip(&self.bias).map(|((&v, &w), &b)| (v - mean) * scale * w + b));
        }
        y
    }
}

/// Keys and values that attention looks at: rows of a buffer in which both stand somewhere.
#[derive(Debug, Clone, Copy)]
pub struct Segment<'a, T> {
    /// `[n][stride]`
    pub rows: &'a [T],
    /// Numbers a row.
    pub stride: usize,
    /// Where in a row the keys begin, d of them.
    pub keys: usize,
    /// Where in a row the values begin, d of them.
    pub values: usize,
}

/// Which of a block's own rows its rows see.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sight {
    /// All of them.
    All,
    /// So many from the first on; the others are padding.
    First(usize),
    /// Those before it, and itself.
    Causal,
}

impl Sight {
    /// Rows that a row sees, from the first on.
    const fn of(self, row: usize) -> usize {
        match self {
            Sight::All => usize::MAX,
            Sight::First(count) => count,
            Sight::Causal => row + 1,
        }
    }
}

/// `softmax(q k / sqrt(dh)) v` head by head over the rows of all `segments`, of the first those that `sight` says. `queries` `[n][stride]`, of
/// which the first `width` numbers a row count; gives `[n][width]`.
fn attend<T: Real>(
    queries: &[T],
    (stride, width, heads): (usize, usize, usize),
    segments: &[Segment<'_, T>],
    sight: Sight,
) -> Vec<T> {
    let head_width = width / heads;
    let scale = T::ONE / T::from_f64(head_width as f64).sqrt();
    let mut out = Vec::with_capacity(queries.len() / stride * width);
    let mut shares = Vec::new();
    for (row, query) in queries.chunks_exact(stride).enumerate() {
        let rows = || {
            let seen = segments.iter().zip([sight.of(row)].into_iter().chain(core::iter::repeat(usize::MAX)));
            seen.flat_map(|(s, count)| s.rows.chunks_exact(s.stride).take(count).map(move |row| (s, row)))
        };
        for head in 0..heads {
            let columns = head * head_width..(head + 1) * head_width;
            let q = &query[columns.clone()];
            let keys = rows().map(|(s, row)| &row[s.keys..]);
            shares.clear();
            shares.extend(keys.map(|k| dot(q, &k[columns.clone()]) * scale));
            softmax(&mut shares);
            let start = out.len();
            out.resize(start + head_width, T::ZERO);
            let values = rows().map(|(s, row)| &row[s.values..]);
            for (v, &p) in values.zip(&shares) {
                out[start..].iter_mut().zip(&v[columns.clone()]).for_each(|(o, &v)| *o += p * v);
            }
        }
    }
    out
}

/// `exp(x - max) / sum`, in place.
pub(super) fn softmax<T: Real>(x: &mut [T]) {
    let largest = x.iter().skip(1).fold(x.first().copied().unwrap_or_default(), |m, &v| m.larger(v));
    let mut sum = T::ZERO;
    for v in x.iter_mut() {
        *v = (*v - largest).exp();
        sum += *v;
    }
    x.iter_mut().for_each(|v| *v = *v / sum);
}

/// Place of the largest number, the first of equals; 0 without numbers.
pub fn first_largest<T: Real>(values: &[T]) -> usize {
    let mut best = 0;
    for (place, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = place;
        }
    }
    best
}

pub(super) fn add<T: Real>(to: &mut [T], from: &[T]) {
    to.iter_mut().zip(from).for_each(|(to, &from)| *to += from);
}

pub(super) fn activate<T: Real>(x: &mut [T], activation: Activation) {
    match activation {
        Activation::Relu => x.iter_mut().for_each(|v| *v = v.relu()),
        Activation::Gelu => x.iter_mut().for_each(|v| {
            let wide = v.to_f64();
            *v = T::from_f64(0.5 * wide * (1.0 + libm::erf(wide * core::f64::consts::FRAC_1_SQRT_2)));
        }),
    }
}

/// Cross-attention of a block.
#[derive(Debug, Clone)]
struct CrossAttention<T> {
    norm: LayerNorm<T>,
    query: Linear<T>,
    key_value: Linear<T>,
    output: Linear<T>,
}

/// One layer.
#[derive(Debug, Clone)]
pub struct Block<T> {
    norm1: LayerNorm<T>,
    qkv: Linear<T>,
    output: Linear<T>,
    cross: Option<CrossAttention<T>>,
    norm2: LayerNorm<T>,
    expand: Linear<T>,
    contract: Linear<T>,
    heads: usize,
    order: NormOrder,
    activation: Activation,
}

impl<T: Real> Block<T> {
    /// From a checkpoint's weights.
    #[must_use]
    pub fn new(source: &prior::Block, heads: usize, form: Form) -> Self {
        let norm = |n: &prior::LayerNorm| LayerNorm::new(n, form.epsilon);
        Self {
            norm1: norm(&source.norm1),
            qkv: Linear::new(&source.qkv),
            output: Linear::new(&source.output),
            cross: source.cross.as_ref().map(|c| CrossAttention {
                norm: norm(&c.norm),
                query: Linear::new(&c.query),
                key_value: Linear::new(&c.key_value),
                output: Linear::new(&c.output),
            }),
            norm2: norm(&source.norm2),
            expand: Linear::new(&source.expand),
            contract: Linear::new(&source.contract),
            heads,
            order: form.norm,
            activation: form.activation,
        }
    }

    /// What cross-attention looks at in a memory `[n][dt]`: keys and values `[n][2 d]`; empty without cross-attention.
    #[must_use]
    pub fn remember(&self, memory: &[T]) -> Vec<T> {
        self.cross.as_ref().map(|c| c.key_value.forward(memory)).unwrap_or_default()
    }

    /// The rows `x` `[n][d]` after this layer. `memory` is what [`Block::remember`] gave; `extra` are further segments for the
    /// self-attention.
    pub fn forward(&self, x: &mut Vec<T>, memory: &[T], extra: &[Segment<'_, T>]) {
        self.layer(x, memory, (extra, Sight::All), &mut |_, _| ());
    }

    /// The same without memory and further segments, where a row does not see all others.
    pub fn forward_seeing(&self, x: &mut Vec<T>, sight: Sight) {
        self.layer(x, &[], (&[], sight), &mut |_, _| ());
    }

    /// The same; `see` is told what each linear reads, by its name within the layer.
    pub fn observe(
        &self,
        x: &mut Vec<T>,
        memory: &[T],
        extra: &[Segment<'_, T>],
        see: &mut dyn FnMut(&'static str, &[T]),
    ) {
        self.layer(x, memory, (extra, Sight::All), see);
    }

    fn layer(
        &self,
        x: &mut Vec<T>,
        memory: &[T],
        (extra, sight): (&[Segment<'_, T>], Sight),
        see: &mut dyn FnMut(&'static str, &[T]),
    ) {
        self.sublayer(x, &self.norm1, |h| {
            let width = self.output.outputs;
            see("attention.qkv", h);
            let qkv = self.qkv.forward(h);
            let own = Segment { rows: &qkv, stride: 3 * width, keys: width, values: 2 * width };
            let segments: Vec<Segment<'_, T>> = core::iter::once(own).chain(extra.iter().copied()).collect();
            let attended = attend(&qkv, (3 * width, width, self.heads), &segments, sight);
            see("attention.out", &attended);
            self.output.forward(&attended)
        });
        if let Some(cross) = &self.cross {
            self.sublayer(x, &cross.norm, |h| {
                let width = cross.output.outputs;
                let memory = Segment { rows: memory, stride: 2 * width, keys: 0, values: width };
                see("cross.q", h);
                let attended = attend(&cross.query.forward(h), (width, width, self.heads), &[memory], Sight::All);
                see("cross.out", &attended);
                cross.output.forward(&attended)
            });
        }
        self.sublayer(x, &self.norm2, |h| {
            see("ffn.in", h);
            let mut hidden = self.expand.forward(h);
            activate(&mut hidden, self.activation);
            see("ffn.out", &hidden);
            self.contract.forward(&hidden)
        });
    }

    /// `x + f(norm(x))` or `norm(x + f(x))`.
    fn sublayer(&self, x: &mut Vec<T>, norm: &LayerNorm<T>, f: impl FnOnce(&[T]) -> Vec<T>) {
        match self.order {
            NormOrder::Pre => {
                let delta = f(&norm.forward(x));
                add(x, &delta);
            }
            NormOrder::Post => {
                let delta = f(x);
                add(x, &delta);
                *x = norm.forward(x);
            }
        }
    }
}
