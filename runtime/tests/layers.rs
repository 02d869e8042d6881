//! Linear, embedding, norm, activation, attention against f64 restatements, from tensors in a blob's own format.

use motionette::blob::{Activation, DType, Error, TensorEntry, Tensors};
use motionette::nn::attention::{self, Heads, Segment, SegmentMut, attend};
use motionette::nn::conv1d::Rows;
use motionette::nn::embedding::Embedding;
use motionette::nn::linear::{Linear, MOST_ROWS};
use motionette::nn::norm::LayerNorm;
use motionette::nn::{activation, quantise, softmax};
use motionette::numerics::hash::Stream;

/// A tensor table and its weight section.
#[derive(Default)]
struct Table {
    entries: Vec<u8>,
    weights: Vec<u8>,
    count: u16,
}

impl Table {
    fn push(&mut self, dtype: DType, shape: [u16; 3], bytes: Vec<u8>) {
        self.weights.resize(self.weights.len().next_multiple_of(16), 0);
        let entry = TensorEntry { name: "t", dtype, shape, offset: self.weights.len() as u32 };
        let mut room = [0u8; 64];
        self.entries.extend_from_slice(postcard::to_slice(&entry, &mut room).expect("an entry is small"));
        self.weights.extend(bytes);
        self.count += 1;
    }

    fn f32s(&mut self, values: &[f32]) {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.push(DType::F32, [1, 1, values.len() as u16], bytes);
    }

    fn bytes(&mut self, shape: [u16; 3], values: &[i8]) {
        self.push(DType::I8, shape, values.iter().map(|&v| v as u8).collect());
    }

    /// 4-bit weights `[outputs][inputs]`, packed as `FORMAT.md` says.
    fn nibbles(&mut self, shape: [u16; 3], values: &[i8]) {
        let half = |v: i8| (v + 8) as u8;
        let pack = |g: &[i8]| (0..8).map(|i| half(g[i]) | half(g[8 + i]) << 4).collect::<Vec<_>>();
        self.push(DType::I4, shape, values.chunks(16).flat_map(pack).collect());
    }

    /// Runs `read` on the table in aligned memory.
    fn read<T>(&self, read: impl FnOnce(&mut Tensors<'_>) -> T) -> T {
        let mut words = vec![0u128; self.weights.len().div_ceil(16)];
        bytemuck::cast_slice_mut::<u128, u8>(&mut words)[..self.weights.len()].copy_from_slice(&self.weights);
        let weights = &bytemuck::cast_slice::<u128, u8>(&words)[..self.weights.len()];
        read(&mut Tensors::new(&self.entries, weights, self.count))
    }
}

struct Random(Stream);

impl Random {
    fn signed(&mut self) -> f32 {
        2.0 * self.0.unit() - 1.0
    }

    fn f32s(&mut self, count: usize) -> Vec<f32> {
        (0..count).map(|_| self.signed()).collect()
    }

    fn int8(&mut self, count: usize) -> Vec<i8> {
        (0..count).map(|_| (self.0.below(255) as i32 - 127) as i8).collect()
    }
}

fn worst(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    got.iter().zip(want).map(|(g, w)| (f64::from(*g) - w).abs()).fold(0.0, f64::max)
}

#[test]
fn linear_is_a_matrix_product_with_a_bias() {
    for (rows, inputs, outputs) in [(1usize, 5usize, 7usize), (4, 12, 3), (9, 33, 20), (6, 128, 10)] {
        linear(rows, inputs, outputs, DType::I8);
    }
    for (rows, inputs, outputs) in [(1usize, 16usize, 7usize), (4, 48, 3), (9, 32, 20), (6, 128, 10)] {
        linear(rows, inputs, outputs, DType::I4);
    }
}

fn linear(rows: usize, inputs: usize, outputs: usize, dtype: DType) {
    let mut random = Random(Stream::new((rows * inputs) as u64));
    let (mut weights, x) = (random.int8(inputs * outputs), random.f32s(rows * inputs));
    let (levels, shape) = (if dtype == DType::I4 { 7.0 } else { 127.0 }, [1, outputs as u16, inputs as u16]);
    let mut table = Table::default();
    if dtype == DType::I4 {
        weights.iter_mut().for_each(|w| *w %= 8);
        table.nibbles(shape, &weights);
    } else {
        table.bytes(shape, &weights);
    }
    let scales: Vec<f32> = (0..outputs).map(|_| (0.5 + random.0.unit()) / levels).collect();
    let biases = random.f32s(outputs);
    table.f32s(&scales);
    table.f32s(&biases);
    let want = |from: usize, to: usize| {
        let mut y = Vec::new();
        for r in 0..rows {
            for n in from..to {
                let dot: f64 =
                    (0..inputs).map(|k| f64::from(weights[n * inputs + k]) * f64::from(x[r * inputs + k])).sum();
                y.push(dot * f64::from(scales[n]) + f64::from(biases[n]));
            }
        }
        y
    };
    table.read(|tensors| {
        let layer = Linear::open(tensors, inputs as u16, outputs as u16).unwrap();
        let (mut q, mut row_scales) = (vec![0i16; rows * inputs], vec![0.0; rows]);
        quantise::rows(&x, inputs, quantise::limit(inputs), &mut q, &mut row_scales);
        let input = Rows { q: &q, scales: &row_scales };
        let mut acc = vec![0; rows * outputs];
        let mut y = vec![0.0; rows * outputs];
        layer.forward(input, &mut y, &mut acc);
        // int16 activations: half a step of 2^-15 an input, at most.
        let error = inputs as f64 / 65534.0 * 1.5 + 1e-6;
        assert!(worst(&y, &want(0, outputs)) < error, "{rows} x {inputs} x {outputs}");
        let (first, count) = (1, outputs - 2);
        let mut y = vec![0.0; rows * count];
        layer.part(first, count).forward(input, &mut y, &mut acc);
        assert!(worst(&y, &want(first, first + count)) < error);
        let most = want(0, outputs).iter().fold(0.0f64, |m, v| m.max(v.abs()));
        assert!(f64::from(layer.bound(1.0)) >= most);
        assert!(f64::from(layer.bound(1.0)) < 2.0 * inputs as f64 + 1.0);
    });
}

/// What a reader refuses of 4-bit weights: rows that are no whole groups, another shape, bytes that are not there.
#[test]
fn malformed_four_bit_weights_are_refused() {
    let with = |shape: [u16; 3]| {
        let count = shape.iter().map(|&d| usize::from(d)).product::<usize>();
        let mut bytes = vec![0x88u8; count.div_ceil(2)];
        // A weight of -7 and one of 7, all others 0.
        bytes[17] = 0xF1;
        let mut table = Table::default();
        table.push(DType::I4, shape, bytes);
        table.f32s(&[0.5; 3]);
        table.f32s(&[0.0; 3]);
        table
    };
    let open = |table: &Table, inputs| table.read(|tensors| Linear::open(tensors, inputs, 3).map(|l| l.bound(1.0)));
    let shape = |found, expected| Error::TensorShape { index: 0, found, expected };
    let whole = with([1, 3, 32]);
    assert_eq!(open(&whole, 32), Ok(7.0));
    assert_eq!(open(&with([1, 3, 24]), 24), Err(shape(72, 96)));
    assert_eq!(open(&whole, 48), Err(shape(96, 144)));
    assert_eq!(
        whole.read(|tensors| tensors.take().and_then(|t| t.bytes([1, 3, 32]).map(<[i8]>::len))),
        Err(shape(96, 96))
    );
    let mut short = whole;
    short.weights.truncate(40);
    assert_eq!(open(&short, 32), Err(Error::TensorRange { index: 0 }));
}

#[test]
fn embedding_rows_are_added() {
    let mut random = Random(Stream::new(2));
    let weights = random.int8(5 * 3);
    let scales = [0.01f32, 0.5, 1e-3, 0.2, 0.03];
    let mut table = Table::default();
    table.bytes([1, 5, 3], &weights);
    table.f32s(&scales);
    table.read(|tensors| {
        let embedding = Embedding::open(tensors, 5, 3).unwrap();
        assert_eq!(embedding.rows(), 5);
        for row in 0..5 {
            let mut x = [1.0f32, -2.0, 3.0];
            embedding.add(row, &mut x);
            for (k, (x, before)) in x.iter().zip([1.0, -2.0, 3.0]).enumerate() {
                assert_eq!(*x, before + f32::from(weights[3 * row + k]) * scales[row]);
            }
        }
        let mut x = [1.0f32; 3];
        embedding.add(5, &mut x);
        assert_eq!(x, [1.0; 3], "a row that is not there adds nothing");
        let mut sizes: Vec<f32> =
            weights.iter().enumerate().map(|(i, w)| f32::from(*w).abs() * scales[i / 3]).collect();
        sizes.sort_by(f32::total_cmp);
        assert_eq!(Some(&embedding.bound()), sizes.last());
    });
}

#[test]
fn norm_follows_its_formula() {
    let mut random = Random(Stream::new(3));
    let (weight, bias, x) = (random.f32s(37), random.f32s(37), random.f32s(5 * 37));
    let x: Vec<f32> = x.iter().enumerate().map(|(i, v)| 10f32.powi(i as i32 / 37 - 2) * (v + 0.5)).collect();
    let mut table = Table::default();
    table.f32s(&weight);
    table.f32s(&bias);
    let epsilon = 1e-5;
    let want: Vec<f64> = x
        .chunks(37)
        .flat_map(|row| {
            let mean = row.iter().map(|v| f64::from(*v)).sum::<f64>() / 37.0;
            let var = row.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / 37.0;
            let each = row.iter().zip(weight.iter().zip(&bias));
            each.map(|(v, (w, b))| (f64::from(*v) - mean) / (var + 1e-5).sqrt() * f64::from(*w) + f64::from(*b))
                .collect::<Vec<_>>()
        })
        .collect();
    table.read(|tensors| {
        let norm = LayerNorm::open(tensors, 37, epsilon).unwrap();
        let mut y = vec![0.0; x.len()];
        norm.forward(&x, &mut y);
        assert!(worst(&y, &want) < 1e-5);
        let mut z = x.clone();
        norm.forward_in_place(&mut z);
        assert_eq!(y, z);
        assert!(want.iter().all(|v| v.abs() <= f64::from(norm.bound())));
        // A row without spread, and one at the limit of the range.
        let mut flat = vec![4.0f32; 37];
        norm.forward_in_place(&mut flat);
        assert_eq!(flat, bias);
        let mut far: Vec<f32> = x[..37].iter().map(|v| v * 1e17).collect();
        norm.forward_in_place(&mut far);
        assert!(far.iter().all(|v| v.is_finite() && v.abs() <= norm.bound()));
    });
}

#[test]
fn activations_have_known_values() {
    let mut x = [-1.5f32, 0.0, 2.5, -1e20];
    activation::apply(Activation::Relu, &mut x);
    assert_eq!(x, [0.0, 0.0, 2.5, 0.0]);
    // x/2 (1 + erf(x / sqrt 2)) from tables of the normal distribution.
    let cases =
        [(0.0f32, 0.0f64), (1.0, 0.841_344_746), (-1.0, -0.158_655_254), (2.0, 1.954_499_736), (-3.0, -0.004_049_694)];
    for (x, want) in cases {
        let mut y = [x];
        activation::apply(Activation::Gelu, &mut y);
        assert!((f64::from(y[0]) - want).abs() < 1e-6, "gelu({x}) = {}", y[0]);
    }
    let mut far = [1e16f32, -1e16];
    activation::apply(Activation::Gelu, &mut far);
    assert_eq!(far, [1e16, 0.0]);
}

#[test]
fn softmax_is_a_distribution_in_proportion() {
    let mut x = [1.0f32, 3.0, -2.0, 3.0];
    softmax::softmax(&mut x);
    let e: Vec<f64> = [1.0f64, 3.0, -2.0, 3.0].iter().map(|v| v.exp()).collect();
    let want: Vec<f64> = e.iter().map(|v| v / e.iter().sum::<f64>()).collect();
    assert!(worst(&x, &want) < 1e-6);
    let mut far = [-1e30f32, 1e30, 0.0];
    softmax::softmax(&mut far);
    assert_eq!(far, [0.0, 1.0, 0.0]);
}

/// Keys and values of a segment, as they are stored and what they stand for.
struct Stored {
    rows: usize,
    keys: Vec<i8>,
    key_scales: Vec<f32>,
    values: Vec<i8>,
    value_scales: Vec<f32>,
    /// Low planes; empty where numbers have 8 bits.
    low_keys: Vec<i8>,
    low_values: Vec<i8>,
}

impl Stored {
    fn new(heads: Heads, rows: usize, wide: bool, random: &mut Random) -> Self {
        let width = heads.count * heads.width;
        let mut s = Stored {
            rows,
            keys: vec![0; rows * width],
            key_scales: vec![0.0; rows * heads.count],
            values: vec![0; rows * width],
            value_scales: vec![0.0; rows * heads.count],
            low_keys: vec![0; if wide { rows * width } else { 0 }],
            low_values: vec![0; if wide { rows * width } else { 0 }],
        };
        let mut segment = SegmentMut {
            rows,
            keys: &mut s.keys,
            key_scales: &mut s.key_scales,
            values: &mut s.values,
            value_scales: &mut s.value_scales,
            low: (&mut s.low_keys, &mut s.low_values),
        };
        for row in 0..rows {
            let (key, value) = (random.f32s(width), random.f32s(width));
            let key: Vec<f32> = key.iter().map(|k| 3.0 * k).collect();
            segment.put_key(heads, row, &key);
            segment.put_value(heads, row, &value);
            // What was put comes back, to half a step of 127, or 32512, a head.
            for (c, want) in key.iter().enumerate() {
                let (at, place) = (c / heads.width * rows + row, c % heads.width);
                let high = f32::from(segment.keys[at * heads.width + place]);
                let number = match wide {
                    true => 256.0 * high + f32::from(segment.low.0[at * heads.width + place]),
                    false => high,
                };
                let got = number * segment.key_scales[at];
                let allowed = if wide { 3.0 / 65_000.0 } else { 3.0 / 253.0 };
                assert!((got - want).abs() <= allowed, "{got} instead of {want}");
            }
        }
        s
    }

    fn view(&self) -> Segment<'_> {
        Segment {
            rows: self.rows,
            keys: &self.keys,
            key_scales: &self.key_scales,
            values: &self.values,
            value_scales: &self.value_scales,
            room: self.rows,
            low: (&self.low_keys, &self.low_values),
        }
    }

    fn number(&self, heads: Heads, value: bool, row: usize, head: usize, c: usize) -> f64 {
        let (high, low, scales) = match value {
            true => (&self.values, &self.low_values, &self.value_scales),
            false => (&self.keys, &self.low_keys, &self.key_scales),
        };
        let at = head * self.rows + row;
        let high = f64::from(high[at * heads.width + c]);
        let number = low.get(at * heads.width + c).map_or(high, |low| 256.0 * high + f64::from(*low));
        number * f64::from(scales[at])
    }
}

/// Attention of queries over the dequantised rows of all segments.
fn expected(heads: Heads, q: &[f32], segments: &[&Stored]) -> Vec<f64> {
    let width = heads.count * heads.width;
    let mut out = Vec::new();
    for q in q.chunks(width) {
        for head in 0..heads.count {
            let (mut scores, mut values) = (Vec::new(), Vec::new());
            for s in segments {
                for row in 0..s.rows {
                    let key = |c| s.number(heads, false, row, head, c);
                    let dot: f64 = (0..heads.width).map(|c| f64::from(q[head * heads.width + c]) * key(c)).sum();
                    scores.push((dot / (heads.width as f64).sqrt()).exp());
                    let value = |c| s.number(heads, true, row, head, c);
                    values.push((0..heads.width).map(value).collect::<Vec<_>>());
                }
            }
            let sum: f64 = scores.iter().sum();
            for c in 0..heads.width {
                out.push(scores.iter().zip(&values).map(|(p, v)| p / sum * v[c]).sum());
            }
        }
    }
    out
}

#[test]
fn attention_averages_values_by_softmax_over_all_segments() {
    for (heads, own, extra, rows, wide) in [
        (Heads { count: 1, width: 4 }, 1usize, 0usize, 1usize, false),
        (Heads { count: 3, width: 5 }, 7, 0, 4, false),
        (Heads { count: 2, width: 8 }, 50, 11, 3, false),
        (Heads { count: 4, width: 32 }, 13, 1, 4, false),
        (Heads { count: 3, width: 5 }, 7, 0, 4, true),
        (Heads { count: 2, width: 24 }, 50, 11, 3, true),
    ] {
        let mut random = Random(Stream::new((own * 31 + rows) as u64));
        let width = heads.count * heads.width;
        let first = Stored::new(heads, own, wide, &mut random);
        let second = Stored::new(heads, extra, wide, &mut random);
        let q = random.f32s(rows * width);
        let keys = own + extra;
        let (mut hq, mut scales) = (vec![0; MOST_ROWS * heads.width], vec![0.0; MOST_ROWS]);
        // Larger buffers than needed must not matter.
        let (mut scores, mut p) = (vec![9.0; MOST_ROWS * (keys + 3)], vec![7; MOST_ROWS * keys + 2]);
        let mut acc = vec![3; MOST_ROWS * keys.max(heads.width) + 5];
        let mut scratch = attention::AttentionScratch {
            q: &mut hq,
            scales: &mut scales,
            scores: &mut scores,
            p: &mut p,
            acc: &mut acc,
        };
        let mut out = vec![5.0; rows * width];
        let (views, all) = ([first.view(), second.view()], [&first, &second]);
        let used = if extra == 0 { 1 } else { 2 };
        attend(heads, &q, &views[..used], &mut out, &mut scratch);
        let want = expected(heads, &q, &all[..used]);
        let error = worst(&out, &want);
        assert!(error < 5e-4, "{heads:?}, {own} and {extra} keys: {error}");
        if extra > 0 {
            let alone = expected(heads, &q, &all[..1]);
            assert!(worst(&out, &alone) > 5e-3, "the second segment is looked at");
        }
    }
}
