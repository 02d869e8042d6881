//! 1-D convolution over time, channels last, and its input gradient.

use super::real::{Real, convert};
use crate::checkpoint;

/// How a convolution walks over time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Geometry {
    /// Frames between neighbouring outputs.
    pub stride: usize,
    /// Zero rows before the first frame: how far an output looks back.
    pub left: usize,
    /// Zero rows after the last frame: how far it looks ahead.
    pub right: usize,
    /// Frames between neighbouring taps.
    pub dilation: usize,
}

impl Geometry {
    /// Keeps the length of a three-tap convolution of that dilation; with `dilation` 0 taps, use [`Geometry::POINT`].
    #[must_use]
    pub const fn same(dilation: usize) -> Self {
        Self::ahead(dilation, dilation)
    }

    /// Keeps the length of a three-tap convolution of that dilation which looks so many frames ahead, at most twice the dilation.
    #[must_use]
    pub const fn ahead(dilation: usize, right: usize) -> Self {
        Self { stride: 1, left: 2 * dilation - right, right, dilation }
    }

    /// One tap.
    pub const POINT: Self = Self { stride: 1, left: 0, right: 0, dilation: 1 };

    /// Four taps, half the frames.
    pub const HALVE: Self = Self { stride: 2, left: 1, right: 1, dilation: 1 };
}

/// `y[t][o] = b[o] + sum_k sum_i w[o][i][k] x[t * stride + k * dilation - left][i]`, rows outside are zero.
#[derive(Debug, Clone)]
pub struct Conv1d<T> {
    /// Name in the checkpoint.
    pub name: String,
    /// Output channels.
    pub outputs: usize,
    /// Input channels.
    pub inputs: usize,
    /// Taps.
    pub kernel: usize,
    /// Walk over time.
    pub geometry: Geometry,
    /// `[kernel][inputs][outputs]`: the forward pass adds rows of outputs.
    forward: Vec<T>,
    /// `[kernel][outputs][inputs]`: the backward pass adds rows of inputs.
    backward: Vec<T>,
    bias: Vec<T>,
}

impl<T: Real> Conv1d<T> {
    /// From a checkpoint's weights.
    #[must_use]
    pub fn new(source: &checkpoint::Conv1d, geometry: Geometry) -> Self {
        Self::with_outputs(source, geometry, source.outputs)
    }

    /// From a checkpoint's weights, only the first `outputs` output channels.
    #[must_use]
    pub fn with_outputs(source: &checkpoint::Conv1d, geometry: Geometry, outputs: usize) -> Self {
        let checkpoint::Conv1d { inputs, kernel, .. } = *source;
        let outputs = outputs.min(source.outputs);
        let mut forward = vec![T::ZERO; kernel * inputs * outputs];
        let mut backward = vec![T::ZERO; kernel * inputs * outputs];
        for o in 0..outputs {
            for i in 0..inputs {
                for k in 0..kernel {
                    let w = T::from_f32(source.weight[(o * inputs + i) * kernel + k]);
                    forward[(k * inputs + i) * outputs + o] = w;
                    backward[(k * outputs + o) * inputs + i] = w;
                }
            }
        }
        let bias = convert(&source.bias[..outputs]);
        Self { name: source.name.clone(), outputs, inputs, kernel, geometry, forward, backward, bias }
    }

    /// Number of output frames for `frames` input frames.
    #[must_use]
    pub fn output_frames(&self, frames: usize) -> usize {
        let Geometry { stride, left, right, dilation } = self.geometry;
        (frames + left + right).checked_sub(dilation * (self.kernel - 1) + 1).map_or(0, |last| last / stride + 1)
    }

    /// `x` `[T][inputs]` to `[T'][outputs]`.
    #[must_use]
    pub fn forward(&self, x: &[T]) -> Vec<T> {
        let frames = x.len() / self.inputs;
        let mut y = Vec::with_capacity(self.output_frames(frames) * self.outputs);
        for t in 0..self.output_frames(frames) {
            let start = y.len();
            y.extend_from_slice(&self.bias);
            let row = &mut y[start..];
            for k in 0..self.kernel {
                let Some(s) = self.source_frame(t, k, frames) else { continue };
                let x = &x[s * self.inputs..][..self.inputs];
                let w = &self.forward[k * self.inputs * self.outputs..][..self.inputs * self.outputs];
                add_product(row, x, w);
            }
        }
        y
    }

    /// `dJ/dy` `[T'][outputs]` to `dJ/dx` `[frames][inputs]`.
    #[must_use]
    pub fn backward(&self, dy: &[T], frames: usize) -> Vec<T> {
        let mut dx = vec![T::ZERO; frames * self.inputs];
        for (t, dy) in dy.chunks_exact(self.outputs).enumerate() {
            for k in 0..self.kernel {
                let Some(s) = self.source_frame(t, k, frames) else { continue };
                let w = &self.backward[k * self.inputs * self.outputs..][..self.inputs * self.outputs];
                add_product(&mut dx[s * self.inputs..][..self.inputs], dy, w);
            }
        }
        dx
    }

    /// The input frame that tap `k` of output frame `t` meets, `None` in the padding.
    fn source_frame(&self, t: usize, k: usize, frames: usize) -> Option<usize> {
        let at = (t * self.geometry.stride + k * self.geometry.dilation).checked_sub(self.geometry.left)?;
        (at < frames).then_some(at)
    }
}

/// `y += x w`, `w` `[x.len()][y.len()]`. Half of what follows a ReLU is zero, and is skipped.
fn add_product<T: Real>(y: &mut [T], x: &[T], w: &[T]) {
    for (&x, w) in x.iter().zip(w.chunks_exact(y.len())) {
        if x != T::ZERO {
            for (y, &w) in y.iter_mut().zip(w) {
                *y += x * w;
            }
        }
    }
}

/// `max(x, 0)` of every element.
pub(crate) fn relu<T: Real>(x: &[T]) -> Vec<T> {
    x.iter().map(|v| v.relu()).collect()
}

/// Gradient through a ReLU: `d` where its input `x` was positive, else 0.
pub(crate) fn relu_backward<T: Real>(d: &mut [T], x: &[T]) {
    for (d, &x) in d.iter_mut().zip(x) {
        if x <= T::ZERO {
            *d = T::ZERO;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conv(outputs: usize, inputs: usize, kernel: usize) -> checkpoint::Conv1d {
        let weight = (0..outputs * inputs * kernel).map(|i| ((i * 37 % 23) as f32 - 11.0) / 7.0).collect();
        let bias = (0..outputs).map(|i| i as f32 * 0.25 - 0.5).collect();
        checkpoint::Conv1d { name: "c".into(), outputs, inputs, kernel, weight, bias }
    }

    /// The definition, element by element.
    fn naive(c: &checkpoint::Conv1d, g: Geometry, x: &[f64], frames: usize, outputs: usize) -> Vec<f64> {
        let mut y = Vec::new();
        let mut t = 0;
        while t * g.stride + g.dilation * (c.kernel - 1) < frames + g.left + g.right {
            for o in 0..outputs {
                let mut sum = f64::from(c.bias[o]);
                for i in 0..c.inputs {
                    for k in 0..c.kernel {
                        let s = (t * g.stride + k * g.dilation) as isize - g.left as isize;
                        if s >= 0 && (s as usize) < frames {
                            sum +=
                                f64::from(c.weight[(o * c.inputs + i) * c.kernel + k]) * x[s as usize * c.inputs + i];
                        }
                    }
                }
                y.push(sum);
            }
            t += 1;
        }
        y
    }

    #[test]
    fn forward_is_the_definition_and_backward_its_transpose() {
        for (outputs, inputs, kernel, g, frames) in [
            (2, 3, 3, Geometry::same(1), 5),
            (3, 2, 3, Geometry::same(9), 7),
            (3, 2, 3, Geometry::ahead(1, 0), 5),
            (2, 3, 3, Geometry::ahead(3, 1), 8),
            (2, 3, 3, Geometry::ahead(9, 0), 7),
            (4, 5, 1, Geometry::POINT, 3),
            (2, 3, 4, Geometry::HALVE, 8),
            (2, 3, 4, Geometry::HALVE, 9),
            (2, 2, 4, Geometry::HALVE, 1),
        ] {
            let source = conv(outputs, inputs, kernel);
            for kept in [outputs, 1] {
                let c = Conv1d::<f64>::with_outputs(&source, g, kept);
                let x: Vec<f64> = (0..frames * inputs).map(|i| (i * 29 % 17) as f64 / 5.0 - 1.0).collect();
                let y = c.forward(&x);
                let expected = naive(&source, g, &x, frames, kept);
                assert_eq!(y.len(), expected.len(), "{g:?} {frames}");
                for (a, b) in y.iter().zip(&expected) {
                    assert!((a - b).abs() < 1e-12, "{a} {b}");
                }
                // <dy, y(x) - y(0)> == <dx, x> for a linear map.
                let dy: Vec<f64> = (0..y.len()).map(|i| (i * 31 % 13) as f64 / 3.0 - 2.0).collect();
                let zero = c.forward(&vec![0.0; x.len()]);
                let left: f64 = dy.iter().zip(y.iter().zip(&zero)).map(|(d, (y, z))| d * (y - z)).sum();
                let right: f64 = c.backward(&dy, frames).iter().zip(&x).map(|(d, x)| d * x).sum();
                assert!((left - right).abs() < 1e-9, "{left} {right}");
            }
        }
    }
}
