//! tract: a graph is wired, optimised once and run on one thread.

use std::sync::Arc;

use anyhow::{Context, Result};
use motionette_host::checkpoint::Conv1d;
use motionette_host::checkpoint::prior::{LayerNorm, Linear};
use tract_core::internal::*;
use tract_core::ops::array::{MultiBroadcastTo, Slice};
use tract_core::ops::cnn::{Conv, KernelFormat, PaddingSpec, PoolSpec};
use tract_core::ops::einsum::EinSum;
use tract_core::ops::logic::{Iff, comp_gt};
use tract_core::ops::math;
use tract_core::ops::nn::{DataFormat, Reduce, Reducer, Softmax, SoftmaxKind, gelu_exact::gelu_exact};

use crate::engine::Engine;

/// A graph in the making. Frames are `[channels][T]`, other matrices `[rows][columns]`.
#[derive(Default)]
pub struct Tract {
    model: TypedModel,
    wired: usize,
}

/// An optimised graph.
pub type Runnable = Arc<TypedRunnableModel>;

/// Weights of a convolution.
pub struct Weights {
    kernel: OutletId,
    bias: OutletId,
    pool: PoolSpec,
}

impl Tract {
    /// An input of that shape.
    ///
    /// # Errors
    /// tract's.
    pub fn input(&mut self, shape: [usize; 2]) -> Result<OutletId> {
        let name = self.name();
        self.model.add_source(name, f32::fact(shape))
    }

    /// Optimises the graph of these outputs.
    ///
    /// # Errors
    /// tract's.
    pub fn finish(mut self, outputs: &[OutletId]) -> Result<Runnable> {
        self.model.select_output_outlets(outputs)?;
        let options = RunOptions { executor: Some(multithread::Executor::SingleThread), ..RunOptions::default() };
        self.model.into_optimized()?.into_runnable_with_options(&options)
    }

    fn name(&mut self) -> String {
        self.wired += 1;
        format!("n{}", self.wired)
    }

    fn wire(&mut self, op: impl Into<Box<dyn TypedOp>>, inputs: &[OutletId]) -> Result<OutletId> {
        let name = self.name();
        self.model.wire_node(name, op, inputs)?.first().copied().context("a tract operator without output")
    }

    fn weights(&mut self, values: &[f32], shape: &[usize]) -> Result<OutletId> {
        let name = self.name();
        self.model.add_const(name, Tensor::from_shape(shape, values)?)
    }

    fn shape(&self, x: OutletId) -> Result<[usize; 2]> {
        let shape = self.model.outlet_fact(x)?.shape.as_concrete().context("a shape that is not fixed")?;
        Ok(shape.try_into()?)
    }

    fn reshape(&mut self, x: OutletId, axis: usize, from: &[usize], to: &[usize]) -> Result<OutletId> {
        let dims = |extents: &[usize]| extents.iter().map(|&extent| extent.to_dim()).collect();
        self.wire(AxisOp::Reshape(axis, dims(from), dims(to)), &[x])
    }

    fn product(&mut self, axes: &str, inputs: &[OutletId]) -> Result<OutletId> {
        self.wire(EinSum::new(axes.parse()?, f32::datum_type()), inputs)
    }

    fn reduce(&mut self, reducer: Reducer, axis: usize, x: OutletId) -> Result<OutletId> {
        self.wire(Reduce::new(tvec![axis], reducer), &[x])
    }
}

/// Frames `[T][channels]` as tract's `[channels][T]`, and back with the extents changed over.
///
/// # Errors
/// When the values do not fill whole rows.
pub fn transposed(values: &[f32], columns: usize) -> Result<Tensor> {
    let rows = values.len() / columns;
    let mut turned = Vec::<f32>::with_capacity(values.len());
    for column in 0..columns {
        turned.extend(values.iter().skip(column).step_by(columns));
    }
    Tensor::from_shape(&[columns, rows], &turned)
}

impl Engine for Tract {
    type Value = OutletId;
    type Conv = Weights;
    type Linear = [OutletId; 2];
    type Norm = ([OutletId; 2], [OutletId; 2]);

    fn conv_weights(&mut self, source: &Conv1d, dilation: usize) -> Result<Weights> {
        let Conv1d { outputs, inputs, kernel, .. } = *source;
        let reach = dilation * (kernel / 2);
        let bias = if source.bias.is_empty() { &vec![0.0; outputs] } else { &source.bias };
        let pool = PoolSpec {
            data_format: DataFormat::CHW,
            kernel_shape: tvec![kernel],
            padding: PaddingSpec::Explicit(tvec![reach], tvec![reach]),
            dilations: Some(tvec![dilation]),
            strides: None,
            input_channels: inputs,
            output_channels: outputs,
        };
        let kernel = self.weights(&source.weight, &[outputs, inputs, kernel])?;
        Ok(Weights { kernel, bias: self.weights(bias, &[outputs])?, pool })
    }

    fn conv(&mut self, weights: &Weights, x: &OutletId) -> Result<OutletId> {
        let conv = Conv { pool_spec: weights.pool.clone(), kernel_fmt: KernelFormat::OIHW, group: 1, q_params: None };
        self.wire(conv, &[*x, weights.kernel, weights.bias])
    }

    fn relu(&mut self, x: &OutletId) -> Result<OutletId> {
        let zero = self.weights(&[0.0], &[1, 1])?;
        self.wire(math::max(), &[*x, zero])
    }

    fn relu_gradient(&mut self, d: &OutletId, x: &OutletId) -> Result<OutletId> {
        let zero = self.weights(&[0.0], &[1, 1])?;
        let positive = self.wire(tract_core::ops::binary::TypedBinOp(comp_gt(), None), &[*x, zero])?;
        self.wire(Iff, &[positive, *d, zero])
    }

    fn add(&mut self, a: &OutletId, b: &OutletId) -> Result<OutletId> {
        self.wire(math::add(), &[*a, *b])
    }

    fn twice(&mut self, x: &OutletId) -> Result<OutletId> {
        let [channels, frames] = self.shape(*x)?;
        let x = self.wire(AxisOp::Add(2), &[*x])?;
        let x = self.wire(MultiBroadcastTo { shape: ShapeFact::from_dims([channels, frames, 2]) }, &[x])?;
        self.reshape(x, 1, &[frames, 2], &[2 * frames])
    }

    fn pair_sums(&mut self, x: &OutletId) -> Result<OutletId> {
        let [_, frames] = self.shape(*x)?;
        let x = self.reshape(*x, 1, &[frames], &[frames / 2, 2])?;
        let x = self.reduce(Reducer::Sum, 2, x)?;
        self.wire(AxisOp::Rm(2), &[x])
    }

    fn linear_weights(&mut self, source: &Linear) -> Result<[OutletId; 2]> {
        let weight = self.weights(&source.weight, &[source.outputs, source.inputs])?;
        Ok([weight, self.weights(&source.bias, &[1, source.outputs])?])
    }

    fn linear(&mut self, [weight, bias]: &[OutletId; 2], x: &OutletId) -> Result<OutletId> {
        let product = self.product("ti,oi->to", &[*x, *weight])?;
        self.wire(math::add(), &[product, *bias])
    }

    fn norm_weights(&mut self, source: &LayerNorm, epsilon: f64) -> Result<Self::Norm> {
        let width = source.weight.len();
        let scale_shift = [self.weights(&source.weight, &[1, width])?, self.weights(&source.bias, &[1, width])?];
        let share = self.weights(&[1.0 / width as f32], &[1, 1])?;
        Ok((scale_shift, [share, self.weights(&[epsilon as f32], &[1, 1])?]))
    }

    fn norm(&mut self, ([scale, shift], [share, epsilon]): &Self::Norm, x: &OutletId) -> Result<OutletId> {
        let sum = self.reduce(Reducer::Sum, 1, *x)?;
        let mean = self.wire(math::mul(), &[sum, *share])?;
        let centred = self.wire(math::sub(), &[*x, mean])?;
        let variance = self.reduce(Reducer::MeanOfSquares, 1, centred)?;
        let variance = self.wire(math::add(), &[variance, *epsilon])?;
        let inverse = self.wire(math::rsqrt(), &[variance])?;
        let normal = self.wire(math::mul(), &[centred, inverse])?;
        let scaled = self.wire(math::mul(), &[normal, *scale])?;
        self.wire(math::add(), &[scaled, *shift])
    }

    fn gelu(&mut self, x: &OutletId) -> Result<OutletId> {
        self.wire(gelu_exact(), &[*x])
    }

    fn constant(&mut self, values: &[f32], columns: usize) -> Result<OutletId> {
        self.weights(values, &[values.len() / columns, columns])
    }

    fn rows_from(&mut self, x: &OutletId, first: usize) -> Result<OutletId> {
        let [rows, _] = self.shape(*x)?;
        self.wire(Slice::new(0, first, rows), &[*x])
    }

    fn columns(&mut self, x: &OutletId, first: usize, count: usize) -> Result<OutletId> {
        self.wire(Slice::new(1, first, first + count), &[*x])
    }

    fn attend(&mut self, q: &OutletId, k: &OutletId, v: &OutletId, heads: usize) -> Result<OutletId> {
        let [_, width] = self.shape(*q)?;
        let each = width / heads;
        let [q, k, v] = [*q, *k, *v].map(|x| self.reshape(x, 1, &[width], &[heads, each]));
        let scores = self.product("ihc,jhc->hij", &[q?, k?])?;
        let scale = self.weights(&[1.0 / (each as f32).sqrt()], &[1, 1, 1])?;
        let scores = self.wire(math::mul(), &[scores, scale])?;
        let shares = self.wire(Softmax::new(tvec![2], None, SoftmaxKind::Softmax), &[scores])?;
        let y = self.product("hij,jhc->ihc", &[shares, v?])?;
        self.reshape(y, 1, &[heads, each], &[width])
    }

    fn extrapolate(&mut self, from: &OutletId, to: &OutletId, scale: f32) -> Result<OutletId> {
        let scale = self.weights(&[scale], &[1, 1])?;
        let step = self.wire(math::sub(), &[*to, *from])?;
        let step = self.wire(math::mul(), &[step, scale])?;
        self.wire(math::add(), &[*from, step])
    }
}
