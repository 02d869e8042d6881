//! candle, eager on one CPU thread.

use anyhow::{Context, Result};
use candle_core::{DType, Device, Tensor, Var};
use candle_nn::Module;
use motionette_host::checkpoint::Conv1d;
use motionette_host::checkpoint::prior::{LayerNorm, Linear};

use crate::decoder::Decoder;
use crate::engine::Engine;

/// How convolutions are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// The library's own operator over `[1][channels][T]`.
    Operator,
    /// One product of matrices over `[T][channels]`, the taps side by side.
    Product,
}

/// candle's tensors.
#[derive(Debug, Clone, Copy)]
pub struct Candle(pub Form);

/// Weights of a convolution.
pub struct Weights {
    /// `[outputs][inputs][kernel]` for the operator, `[kernel * inputs][outputs]` for the product.
    weight: Tensor,
    /// `[1][outputs][1]` for the operator, `[outputs]` for the product.
    bias: Option<Tensor>,
    kernel: usize,
    dilation: usize,
}

impl Candle {
    /// Frames `[T][channels]` in this form's layout.
    ///
    /// # Errors
    /// candle's.
    pub fn frames(self, values: &[f32], channels: usize) -> Result<Tensor> {
        let rows = Tensor::from_slice(values, (values.len() / channels, channels), &Device::Cpu)?;
        Ok(match self.0 {
            Form::Operator => rows.t()?.unsqueeze(0)?.contiguous()?,
            Form::Product => rows,
        })
    }

    /// Back to `[T][channels]`.
    ///
    /// # Errors
    /// candle's.
    pub fn values(self, frames: &Tensor) -> Result<Vec<f32>> {
        Ok(match self.0 {
            Form::Operator => frames.squeeze(0)?.t()?.flatten_all()?.to_vec1()?,
            Form::Product => frames.flatten_all()?.to_vec1()?,
        })
    }

    /// Forward pass and `dJ/dlatent` by candle's autograd, for `J = sum(features * gradient)`.
    ///
    /// # Errors
    /// candle's.
    pub fn autograd(&mut self, decoder: &Decoder<Self>, latent: &Var, gradient: &Tensor) -> Result<Tensor> {
        let pass = decoder.forward(self, latent.as_tensor())?;
        let gradients = (pass.features * gradient)?.sum_all()?.backward()?;
        gradients.get(latent.as_tensor()).cloned().context("candle gave no gradient of the latent")
    }
}

impl Engine for Candle {
    type Value = Tensor;
    type Conv = Weights;
    type Linear = candle_nn::Linear;
    type Norm = candle_nn::LayerNorm;

    fn conv_weights(&mut self, source: &Conv1d, dilation: usize) -> Result<Weights> {
        let Conv1d { outputs, inputs, kernel, .. } = *source;
        let weight = Tensor::from_slice(&source.weight, (outputs, inputs, kernel), &Device::Cpu)?;
        let bias = (!source.bias.is_empty()).then(|| Tensor::from_slice(&source.bias, outputs, &Device::Cpu));
        let bias = bias.transpose()?;
        Ok(match self.0 {
            Form::Operator => {
                let bias = bias.map(|bias| bias.reshape((1, outputs, 1))).transpose()?;
                Weights { weight, bias, kernel, dilation }
            }
            Form::Product => {
                let weight = weight.permute((2, 1, 0))?.contiguous()?.reshape((kernel * inputs, outputs))?;
                Weights { weight, bias, kernel, dilation }
            }
        })
    }

    fn conv(&mut self, weights: &Weights, x: &Tensor) -> Result<Tensor> {
        let Weights { weight, bias, kernel, dilation } = weights;
        let reach = dilation * (kernel / 2);
        let y = match self.0 {
            Form::Operator => x.conv1d(weight, reach, 1, *dilation, 1)?,
            Form::Product if *kernel == 1 => x.matmul(weight)?,
            Form::Product => {
                let padded = x.pad_with_zeros(0, reach, reach)?;
                let frames = x.dim(0)?;
                let taps =
                    (0..*kernel).map(|k| padded.narrow(0, k * dilation, frames)).collect::<Result<Vec<_>, _>>()?;
                Tensor::cat(&taps, 1)?.matmul(weight)?
            }
        };
        Ok(match bias {
            Some(bias) => y.broadcast_add(bias)?,
            None => y,
        })
    }

    fn relu(&mut self, x: &Tensor) -> Result<Tensor> {
        Ok(x.relu()?)
    }

    fn relu_gradient(&mut self, d: &Tensor, x: &Tensor) -> Result<Tensor> {
        Ok((d * x.gt(0.0)?.to_dtype(DType::F32)?)?)
    }

    fn add(&mut self, a: &Tensor, b: &Tensor) -> Result<Tensor> {
        Ok((a + b)?)
    }

    fn twice(&mut self, x: &Tensor) -> Result<Tensor> {
        Ok(match self.0 {
            Form::Operator => x.upsample_nearest1d(2 * x.dim(2)?)?,
            Form::Product => {
                let (frames, channels) = x.dims2()?;
                x.unsqueeze(1)?.broadcast_as((frames, 2, channels))?.reshape((2 * frames, channels))?
            }
        })
    }

    fn pair_sums(&mut self, x: &Tensor) -> Result<Tensor> {
        Ok(match self.0 {
            Form::Operator => {
                let (_, channels, frames) = x.dims3()?;
                x.reshape((1, channels, frames / 2, 2))?.sum(3)?
            }
            Form::Product => {
                let (frames, channels) = x.dims2()?;
                let pairs = x.reshape((frames / 2, 2 * channels))?;
                (pairs.narrow(1, 0, channels)? + pairs.narrow(1, channels, channels)?)?
            }
        })
    }

    fn linear_weights(&mut self, source: &Linear) -> Result<candle_nn::Linear> {
        let weight = Tensor::from_slice(&source.weight, (source.outputs, source.inputs), &Device::Cpu)?;
        let bias = Tensor::from_slice(&source.bias, source.outputs, &Device::Cpu)?;
        Ok(candle_nn::Linear::new(weight, Some(bias)))
    }

    fn linear(&mut self, weights: &candle_nn::Linear, x: &Tensor) -> Result<Tensor> {
        Ok(weights.forward(x)?)
    }

    fn norm_weights(&mut self, source: &LayerNorm, epsilon: f64) -> Result<candle_nn::LayerNorm> {
        let vector = |values: &[f32]| Tensor::from_slice(values, values.len(), &Device::Cpu);
        Ok(candle_nn::LayerNorm::new(vector(&source.weight)?, vector(&source.bias)?, epsilon))
    }

    fn norm(&mut self, weights: &candle_nn::LayerNorm, x: &Tensor) -> Result<Tensor> {
        Ok(weights.forward(x)?)
    }

    fn gelu(&mut self, x: &Tensor) -> Result<Tensor> {
        Ok(x.gelu_erf()?)
    }

    fn constant(&mut self, values: &[f32], columns: usize) -> Result<Tensor> {
        Ok(Tensor::from_slice(values, (values.len() / columns, columns), &Device::Cpu)?)
    }

    fn rows_from(&mut self, x: &Tensor, first: usize) -> Result<Tensor> {
        Ok(x.narrow(0, first, x.dim(0)? - first)?)
    }

    fn columns(&mut self, x: &Tensor, first: usize, count: usize) -> Result<Tensor> {
        Ok(x.narrow(1, first, count)?)
    }

    fn attend(&mut self, q: &Tensor, k: &Tensor, v: &Tensor, heads: usize) -> Result<Tensor> {
        let width = q.dim(1)?;
        let split = |x: &Tensor| -> Result<Tensor> {
            Ok(x.reshape((x.dim(0)?, heads, width / heads))?.transpose(0, 1)?.contiguous()?)
        };
        let scale = 1.0 / ((width / heads) as f64).sqrt();
        let shares = candle_nn::ops::softmax_last_dim(&(split(q)?.matmul(&split(k)?.t()?)? * scale)?)?;
        Ok(shares.matmul(&split(v)?)?.transpose(0, 1)?.reshape(q.shape())?)
    }

    fn extrapolate(&mut self, from: &Tensor, to: &Tensor, scale: f32) -> Result<Tensor> {
        Ok((from + ((to - from)? * f64::from(scale))?)?)
    }
}
