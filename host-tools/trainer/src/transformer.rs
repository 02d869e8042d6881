//! Transformer layers on the framework, over named parameters that lie in one flat vector.
//!
//! Linear layers are `[out][in]` as torch stores them. Sequences are `[B, T, C]`, padded; padding is left out by an additive mask.

use std::collections::HashMap;

use burn::tensor::activation::{gelu, softmax};
use burn::tensor::{Device, Gradients, Int, Tensor, TensorData};
use serde::{Deserialize, Serialize};

use crate::convolution::add_gradients;
use crate::random::Random;
use crate::setting::{OutOfRange, require};
use crate::tensor_file::{self, TensorFile};

/// Added to the square of a norm's deviation.
pub const EPSILON: f64 = 1e-5;
/// Added to scores of padded keys.
const FAR: f32 = -1e9;

/// How a parameter begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// All zero: biases.
    Zero,
    /// All one: weights of norms.
    One,
    /// Normal with this deviation: weights and embeddings.
    Normal(f64),
}

/// One named parameter, a matrix; vectors have one row.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Name in a checkpoint.
    pub name: String,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Whether a checkpoint stores it without the dimension of its single row.
    pub vector: bool,
    /// How it begins.
    pub start: Start,
    /// Whether it stays as it begins.
    pub frozen: bool,
}

impl Parameter {
    /// Number of values.
    pub fn len(&self) -> usize {
        self.rows * self.columns
    }

    /// Whether it holds nothing.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Shape in a checkpoint.
    pub fn shape(&self) -> Vec<usize> {
        if self.vector { vec![self.columns] } else { vec![self.rows, self.columns] }
    }
}

/// Sizes of a stack of transformer blocks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sizes {
    /// Channels of the residual stream.
    pub width: usize,
    /// Attention heads; they share the width.
    pub heads: usize,
    /// Blocks.
    pub layers: usize,
    /// Channels between the two linear layers of a block.
    pub hidden: usize,
}

impl Sizes {
    /// Checks that there is such a stack, and that it is no larger than this trainer is meant for.
    ///
    /// # Errors
    /// [`OutOfRange`] about `field`.
    pub fn check(&self, field: &'static str) -> Result<(), OutOfRange> {
        let heads = self.heads > 0 && self.width.is_multiple_of(self.heads);
        let holds = heads && (1..=1024).contains(&self.width) && (1..=16).contains(&self.layers);
        let holds = holds && (1..=4096).contains(&self.hidden);
        let allowed = "width 1 to 1024, a multiple of heads; layers 1 to 16; hidden 1 to 4096";
        require(holds, field, format!("{self:?}"), allowed)
    }
}

/// Parameters in their order.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// One after another in the flat vector.
    pub parameters: Vec<Parameter>,
}

impl Layout {
    /// A table of embeddings.
    pub fn embedding(&mut self, name: &str, rows: usize, columns: usize, deviation: f64) {
        let name = format!("{name}.weight");
        self.push(name, rows, columns, Start::Normal(deviation));
    }

    /// A table that comes with the data and is not trained.
    pub fn constant(&mut self, name: &str, rows: usize, columns: usize) {
        self.push(format!("{name}.weight"), rows, columns, Start::Zero);
        self.parameters.iter_mut().last().into_iter().for_each(|parameter| parameter.frozen = true);
    }

    fn push(&mut self, name: String, rows: usize, columns: usize, start: Start) {
        self.parameters.push(Parameter { name, rows, columns, vector: false, start, frozen: false });
    }

    fn vector(&mut self, name: String, columns: usize, start: Start) {
        self.parameters.push(Parameter { name, rows: 1, columns, vector: true, start, frozen: false });
    }

    /// A linear layer whose outputs have the variance of its inputs times `gain` squared.
    ///
    /// A gain of 0 begins with zeros.
    pub fn linear(&mut self, name: &str, outputs: usize, inputs: usize, gain: f64) {
        self.embedding(name, outputs, inputs, gain / (inputs as f64).sqrt());
        self.bias(name, outputs);
    }

    /// A vector of biases.
    pub fn bias(&mut self, name: &str, outputs: usize) {
        self.vector(format!("{name}.bias"), outputs, Start::Zero);
    }

    /// A layer norm.
    pub fn norm(&mut self, name: &str, width: usize) {
        self.vector(format!("{name}.weight"), width, Start::One);
        self.bias(name, width);
    }

    /// The blocks `prefix.layers.{i}`; with cross-attention to rows of `memory` channels when there is one.
    pub fn blocks(&mut self, prefix: &str, sizes: &Sizes, memory: Option<usize>) {
        let d = sizes.width;
        // Outputs of the residual branches begin small, so that a deep stack begins near the identity.
        let branches = if memory.is_some() { 3 } else { 2 };
        let out = 1.0 / ((branches * sizes.layers) as f64).sqrt();
        for layer in 0..sizes.layers {
            let name = |part: &str| format!("{prefix}.layers.{layer}.{part}");
            self.norm(&name("norm1"), d);
            self.linear(&name("attention.qkv"), 3 * d, d, 1.0);
            self.linear(&name("attention.out"), d, d, out);
            if let Some(memory) = memory {
                self.norm(&name("norm_cross"), d);
                self.linear(&name("cross.q"), d, d, 1.0);
                self.linear(&name("cross.kv"), 2 * d, memory, 1.0);
                self.linear(&name("cross.out"), d, d, out);
            }
            self.norm(&name("norm2"), d);
            self.linear(&name("ffn.in"), sizes.hidden, d, 1.0);
            self.linear(&name("ffn.out"), d, sizes.hidden, out);
        }
    }

    /// Values in all.
    pub fn len(&self) -> usize {
        self.parameters.iter().map(Parameter::len).sum()
    }

    /// Whether there is no parameter.
    pub fn is_empty(&self) -> bool {
        self.parameters.is_empty()
    }

    /// A random start.
    pub fn initial(&self, seed: u64) -> Vec<f32> {
        let mut random = Random::new(seed, u64::MAX);
        let mut values = Vec::with_capacity(self.len());
        for parameter in &self.parameters {
            match parameter.start {
                Start::Zero => values.extend(std::iter::repeat_n(0.0, parameter.len())),
                Start::One => values.extend(std::iter::repeat_n(1.0, parameter.len())),
                Start::Normal(deviation) => {
                    values.extend((0..parameter.len()).map(|_| (deviation * random.normal()) as f32));
                }
            }
        }
        values
    }

    /// Puts `given` where the parameter called `name` lies in the flat vector; `false` where there is none of that size.
    pub fn fill(&self, values: &mut [f32], name: &str, given: &[f32]) -> bool {
        let mut begin = 0;
        for parameter in &self.parameters {
            if parameter.name == name && parameter.len() == given.len() {
                values[begin..][..given.len()].copy_from_slice(given);
                return true;
            }
            begin += parameter.len();
        }
        false
    }

    /// For every value whether it belongs to a parameter whose name `chosen` accepts.
    pub fn named(&self, chosen: impl Fn(&str) -> bool) -> Vec<bool> {
        self.parameters.iter().flat_map(|p| std::iter::repeat_n(chosen(&p.name), p.len())).collect()
    }

    /// For every value whether weight decay applies: trained matrices yes, biases and norms no.
    pub fn decayed(&self) -> Vec<bool> {
        self.parameters.iter().flat_map(|p| std::iter::repeat_n(!p.vector && !p.frozen, p.len())).collect()
    }

    /// Adds every parameter of the flat vector as a tensor of its name.
    pub fn store(&self, values: &[f32], file: &mut TensorFile) {
        for (parameter, values) in self.split(values) {
            file.insert(parameter.name.clone(), &parameter.shape(), values.to_vec());
        }
    }

    /// The flat vector that [`Self::store`] took.
    ///
    /// # Errors
    /// [`tensor_file::Error`] naming the tensor that is missing or does not fit.
    pub fn restore(&self, file: &TensorFile) -> Result<Vec<f32>, tensor_file::Error> {
        let mut values = Vec::with_capacity(self.len());
        for parameter in &self.parameters {
            values.extend(file.values(&parameter.name, &parameter.shape())?);
        }
        Ok(values)
    }

    /// Name and values of every parameter of the flat vector.
    pub fn split<'v>(&'v self, mut values: &'v [f32]) -> impl Iterator<Item = (&'v Parameter, &'v [f32])> {
        self.parameters.iter().map(move |parameter| {
            let (own, rest) = values.split_at(parameter.len());
            values = rest;
            (parameter, own)
        })
    }
}

/// Zeroes a share of activations and scales the others up, so that their mean stays.
#[derive(Debug)]
pub struct Dropout {
    share: f32,
    random: Random,
}

impl Dropout {
    /// Of this share, from this stream.
    pub fn new(share: f32, random: Random) -> Self {
        Self { share, random }
    }

    /// None at all, as when a network is used and not trained.
    pub fn off() -> Self {
        Self::new(0.0, Random::new(0, 0))
    }

    fn apply(&mut self, x: Tensor<3>) -> Tensor<3> {
        if self.share <= 0.0 {
            return x;
        }
        let dims = x.dims();
        let threshold = (f64::from(self.share) * 65536.0) as u64;
        let kept = 1.0 / (1.0 - self.share);
        let mut bits = 0;
        let mask: Vec<f32> = (0..dims.iter().product::<usize>())
            .map(|i| {
                if i % 4 == 0 {
                    bits = self.random.bits();
                }
                let draw = bits & 0xFFFF;
                bits >>= 16;
                if draw < threshold { 0.0 } else { kept }
            })
            .collect();
        let mask = Tensor::from_data(TensorData::new(mask, dims), &x.device());
        x * mask
    }
}

/// Additive mask `[B, 1, 1, T]` that hides the padding behind `lengths`; none when nothing is padded.
pub fn padding(lengths: &[usize], window: usize, device: &Device) -> Option<Tensor<4>> {
    if lengths.iter().all(|length| *length == window) {
        return None;
    }
    let values: Vec<f32> =
        lengths.iter().flat_map(|length| (0..window).map(move |t| if t < *length { 0.0 } else { FAR })).collect();
    Some(Tensor::from_data(TensorData::new(values, [lengths.len(), 1, 1, window]), device))
}

/// Rows that cross-attention looks at.
#[derive(Clone, Copy)]
pub struct Rows<'t> {
    /// `[B, S, C]`.
    pub rows: &'t Tensor<3>,
    /// The additive mask of their padding.
    pub mask: Option<&'t Tensor<4>>,
}

/// What the blocks of a stack attend to.
#[derive(Clone, Copy)]
pub struct Attended<'t> {
    /// The additive mask of the padding of their own rows.
    pub mask: Option<&'t Tensor<4>>,
    /// The rows of another network.
    pub memory: Option<Rows<'t>>,
}

impl<'t> Attended<'t> {
    /// Their own rows alone.
    pub fn own(mask: Option<&'t Tensor<4>>) -> Self {
        Self { mask, memory: None }
    }
}

/// Keys and values that a guest puts beside those of a block's self-attention.
pub struct KeysValues {
    /// Keys, then values, `[B, S, 2 d]`.
    pub rows: Tensor<3>,
    /// Additive mask, `[B, 1, 1, S]`.
    pub mask: Tensor<4>,
}

/// A further network that has a say in a stack of blocks. What it leaves alone stays as it is.
pub trait Guest {
    /// The rows before the first block.
    fn before(&mut self, x: Tensor<3>, _attended: Attended<'_>) -> Tensor<3> {
        x
    }

    /// Further keys and values of a block's self-attention.
    fn keys_values(&mut self, _layer: usize) -> Option<KeysValues> {
        None
    }

    /// The rows behind a block.
    fn behind(&mut self, _layer: usize, x: Tensor<3>) -> Tensor<3> {
        x
    }
}

impl Guest for () {}

/// Parameters on a device.
pub struct Weights {
    tensors: Vec<Tensor<2>>,
    places: HashMap<String, usize>,
    device: Device,
}

impl Weights {
    /// Lays the flat vector out, as leaves of a graph when `tracked`.
    pub fn new(layout: &Layout, values: &[f32], tracked: bool, device: &Device) -> Self {
        let lay = |(parameter, values): (&Parameter, &[f32])| {
            let data = TensorData::new(values.to_vec(), [parameter.rows, parameter.columns]);
            let tensor = Tensor::from_data(data, device);
            if tracked && !parameter.frozen { tensor.require_grad() } else { tensor }
        };
        let names = layout.parameters.iter().enumerate();
        Self {
            tensors: layout.split(values).map(lay).collect(),
            places: names.map(|(index, parameter)| (parameter.name.clone(), index)).collect(),
            device: device.clone(),
        }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Adds the gradients to a flat vector.
    pub fn collect_gradients(&self, gradients: &Gradients, flat: &mut [f32]) {
        add_gradients(self.tensors.iter(), gradients, flat);
    }

    /// Whether there is a parameter called `name`.
    pub fn has(&self, name: &str) -> bool {
        self.places.contains_key(name)
    }

    /// The parameter called `name`.
    pub fn get(&self, name: &str) -> Tensor<2> {
        let place = *self.places.get(name).unwrap_or_else(|| panic!("no parameter is called {name}"));
        self.tensors[place].clone()
    }

    /// Rows `ids` of an embedding table, `[ids, columns]`.
    pub fn rows(&self, name: &str, ids: &[usize]) -> Tensor<2> {
        let ids: Vec<i64> = ids.iter().map(|id| *id as i64).collect();
        let count = ids.len();
        let ids: Tensor<1, Int> = Tensor::from_data(TensorData::new(ids, [count]), &self.device);
        self.get(&format!("{name}.weight")).select(0, ids)
    }

    /// A linear layer.
    pub fn linear(&self, name: &str, x: Tensor<3>) -> Tensor<3> {
        let [batch, time, channels] = x.dims();
        let weight = self.get(&format!("{name}.weight"));
        let outputs = weight.dims()[0];
        let rows = x.reshape([batch * time, channels]);
        (rows.matmul(weight.transpose()) + self.get(&format!("{name}.bias"))).reshape([batch, time, outputs])
    }

    /// A layer norm.
    pub fn norm(&self, name: &str, x: Tensor<3>) -> Tensor<3> {
        let centred = x.clone() - x.mean_dim(2);
        let variance = (centred.clone() * centred.clone()).mean_dim(2);
        let scaled = centred / (variance + EPSILON).sqrt();
        let width = scaled.dims()[2];
        let vector = |part: &str| self.get(&format!("{name}.{part}")).reshape([1, 1, width]);
        scaled * vector("weight") + vector("bias")
    }

    /// Blocks `prefix.layers.{i}`.
    pub fn blocks(
        &self,
        prefix: &str,
        sizes: &Sizes,
        x: Tensor<3>,
        attended: Attended<'_>,
        guest: &mut dyn Guest,
        dropout: &mut Dropout,
    ) -> Tensor<3> {
        let mut x = guest.before(x, attended);
        for layer in 0..sizes.layers {
            let extra = guest.keys_values(layer);
            x = self.block(&format!("{prefix}.layers.{layer}"), sizes.heads, x, attended, extra, dropout);
            x = guest.behind(layer, x);
        }
        x
    }

    /// The block called `name`, norms before its branches; self-attention looks at `extra` as well.
    pub fn block(
        &self,
        name: &str,
        heads: usize,
        mut x: Tensor<3>,
        Attended { mask, memory }: Attended<'_>,
        extra: Option<KeysValues>,
        dropout: &mut Dropout,
    ) -> Tensor<3> {
        let [batch, rows, d] = x.dims();
        let name = |part: &str| format!("{name}.{part}");
        let h = self.norm(&name("norm1"), x.clone());
        let qkv = self.linear(&name("attention.qkv"), h);
        let part = |i: usize| qkv.clone().narrow(2, i * d, d);
        let h = match extra {
            None => attention(part(0), part(1), part(2), heads, mask),
            Some(extra) => {
                let more = |i: usize| Tensor::cat(vec![part(1 + i), extra.rows.clone().narrow(2, i * d, d)], 1);
                let own = mask.cloned().unwrap_or_else(|| Tensor::zeros([batch, 1, 1, rows], &self.device));
                attention(part(0), more(0), more(1), heads, Some(&Tensor::cat(vec![own, extra.mask], 3)))
            }
        };
        x = x + dropout.apply(self.linear(&name("attention.out"), h));
        if let Some(memory) = memory {
            x = x.clone() + dropout.apply(self.cross(&name("norm_cross"), &name("cross"), heads, x, memory));
        }
        let h = self.norm(&name("norm2"), x.clone());
        let h = gelu(self.linear(&name("ffn.in"), h));
        x + dropout.apply(self.linear(&name("ffn.out"), h))
    }

    /// Attention of the normed rows `x` to the rows of a memory, `cross.{q, kv, out}`.
    pub fn cross(&self, norm: &str, cross: &str, heads: usize, x: Tensor<3>, memory: Rows<'_>) -> Tensor<3> {
        let d = x.dims()[2];
        let q = self.linear(&format!("{cross}.q"), self.norm(norm, x));
        let kv = self.linear(&format!("{cross}.kv"), memory.rows.clone());
        let h = attention(q, kv.clone().narrow(2, 0, d), kv.narrow(2, d, d), heads, memory.mask);
        self.linear(&format!("{cross}.out"), h)
    }
}

/// `softmax(q k^T / sqrt(width of a head)) v`, `[B, T, d]` and `[B, S, d]` to `[B, T, d]`.
fn attention(q: Tensor<3>, k: Tensor<3>, v: Tensor<3>, heads: usize, mask: Option<&Tensor<4>>) -> Tensor<3> {
    let [batch, time, width] = q.dims();
    let each = width / heads;
    let split = |x: Tensor<3>| {
        let rows = x.dims()[1];
        x.reshape([batch, rows, heads, each]).swap_dims(1, 2)
    };
    let scores = split(q * (1.0 / (each as f64).sqrt())).matmul(split(k).swap_dims(2, 3));
    let scores = match mask {
        Some(mask) => scores + mask.clone(),
        None => scores,
    };
    softmax(scores, 3).matmul(split(v)).swap_dims(1, 2).reshape([batch, time, width])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(count: usize, stream: u64) -> Vec<f32> {
        let mut random = Random::new(23, stream);
        (0..count).map(|_| random.symmetric() as f32).collect()
    }

    fn layout(sizes: &Sizes) -> Layout {
        let mut layout = Layout::default();
        layout.blocks("p", sizes, Some(4));
        layout
    }

    const SIZES: Sizes = Sizes { width: 6, heads: 2, layers: 2, hidden: 5 };

    fn run(values: &[f32], lengths: &[usize], x: &[f32], memory: &[f32], device: &Device) -> (Weights, Tensor<3>) {
        let weights = Weights::new(&layout(&SIZES), values, true, device);
        let (batch, window) = (lengths.len(), x.len() / lengths.len() / SIZES.width);
        let rows = memory.len() / batch / 4;
        let x = Tensor::from_data(TensorData::new(x.to_vec(), [batch, window, SIZES.width]), device);
        let memory = Tensor::from_data(TensorData::new(memory.to_vec(), [batch, rows, 4]), device);
        let mask = padding(lengths, window, device);
        let mut off = Dropout::off();
        let attended = Attended { mask: mask.as_ref(), memory: Some(Rows { rows: &memory, mask: None }) };
        let y = weights.blocks("p", &SIZES, x, attended, &mut (), &mut off);
        (weights, y)
    }

    fn start() -> Vec<f32> {
        let layout = layout(&SIZES);
        let mut values = layout.initial(3);
        for (value, moved) in values.iter_mut().zip(noise(layout.len(), 8)) {
            *value += 0.1 * moved;
        }
        values
    }

    #[test]
    fn padding_changes_nothing() {
        let device = Device::flex().autodiff();
        let (x, memory) = (noise(2 * 5 * 6, 1), noise(2 * 3 * 4, 2));
        let values = start();
        let (_, both) = run(&values, &[5, 2], &x, &memory, &device);
        let both: Vec<f32> = both.into_data().try_into_vec().unwrap();
        let (_, alone) = run(&values, &[2], &x[5 * 6..7 * 6], &memory[12..], &device);
        let alone: Vec<f32> = alone.into_data().try_into_vec().unwrap();
        for (a, b) in both[5 * 6..].iter().zip(&alone) {
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
    }

    #[test]
    fn gradients_agree_with_differences() {
        let device = Device::flex().autodiff();
        let (x, memory, weights) = (noise(5 * 6, 1), noise(3 * 4, 2), noise(5 * 6, 3));
        let objective = |values: &[f32]| {
            let (network, y) = run(values, &[5], &x, &memory, &device);
            let by = Tensor::from_data(TensorData::new(weights.clone(), [1, 5, 6]), &device);
            (network, (y * by).sum())
        };
        let values = start();
        let (network, total) = objective(&values);
        let mut gradient = vec![0.0; values.len()];
        network.collect_gradients(&total.backward(), &mut gradient);
        let value = |values: &[f32]| f64::from(objective(values).1.into_scalar::<f32>());
        let mut offset = 0;
        for parameter in layout(&SIZES).parameters {
            let index = offset + parameter.len() / 2;
            let slope = crate::testing::slope(value, &values, index, 2e-3);
            let error = (slope - f64::from(gradient[index])).abs();
            assert!(error < 0.01 + 0.03 * slope.abs(), "{}: {slope} {}", parameter.name, gradient[index]);
            offset += parameter.len();
        }
    }

    #[test]
    fn dropout_keeps_the_mean() {
        let device = Device::flex();
        let ones = Tensor::<3>::ones([4, 50, 50], &device);
        let dropped = Dropout::new(0.25, Random::new(5, 5)).apply(ones);
        let values: Vec<f32> = dropped.into_data().try_into_vec().unwrap();
        let zeros = values.iter().filter(|v| **v == 0.0).count() as f64 / values.len() as f64;
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64;
        assert!((zeros - 0.25).abs() < 0.02 && (mean - 1.0).abs() < 0.03, "{zeros} {mean}");
    }
}
