//! Pre-activation residual block: `x + conv2(relu(conv1(relu(x))))`.

use super::conv1d::{Conv1d, Geometry, relu, relu_backward};
use super::real::Real;
use crate::checkpoint;

/// A residual block. The ReLUs never touch the residual path.
#[derive(Debug, Clone)]
pub struct ResBlock<T> {
    /// Three taps, dilated.
    pub conv1: Conv1d<T>,
    /// One tap.
    pub conv2: Conv1d<T>,
}

/// What a block's gradient needs of its forward pass.
#[derive(Debug, Clone, Default)]
pub struct BlockTrace<T> {
    /// Input of the block.
    pub input: Vec<T>,
    /// Output of `conv1`.
    pub middle: Vec<T>,
}

impl<T: Real> ResBlock<T> {
    /// From a checkpoint's weights, looking so many frames ahead.
    #[must_use]
    pub fn new(source: &checkpoint::ResBlock, right: usize) -> Self {
        Self {
            conv1: Conv1d::new(&source.conv1, Geometry::ahead(source.dilation, right)),
            conv2: Conv1d::new(&source.conv2, Geometry::POINT),
        }
    }

    /// `x` `[T][C]` to `[T][C]`, with the trace.
    #[must_use]
    pub fn forward(&self, x: Vec<T>) -> (Vec<T>, BlockTrace<T>) {
        let middle = self.conv1.forward(&relu(&x));
        let mut y = self.conv2.forward(&relu(&middle));
        for (y, &x) in y.iter_mut().zip(&x) {
            *y += x;
        }
        (y, BlockTrace { input: x, middle })
    }

    /// `dJ/dy` to `dJ/dx`, both `[T][C]`.
    #[must_use]
    pub fn backward(&self, trace: &BlockTrace<T>, dy: &[T]) -> Vec<T> {
        let frames = dy.len() / self.conv1.inputs;
        let mut d = self.conv2.backward(dy, frames);
        relu_backward(&mut d, &trace.middle);
        let mut dx = self.conv1.backward(&d, frames);
        relu_backward(&mut dx, &trace.input);
        for (dx, &dy) in dx.iter_mut().zip(dy) {
            *dx += dy;
        }
        dx
    }
}
