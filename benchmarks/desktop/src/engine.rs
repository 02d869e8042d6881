//! What the networks need of a library. They are written once against it ([`crate::decoder`], [`crate::planner`]), so that every
//! library computes the same thing.

use anyhow::Result;
use motionette_host::checkpoint::Conv1d;
use motionette_host::checkpoint::prior::{LayerNorm, Linear};

/// A library that computes, at once or by noting down a graph. Matrices are `[rows][columns]`; in decoders rows are frames, and the
/// library lays them out as its convolution likes them.
pub trait Engine {
    /// A matrix.
    type Value: Clone;
    /// Weights of a convolution.
    type Conv;
    /// Weights of a linear.
    type Linear;
    /// Weights of a norm.
    type Norm;

    /// Makes weights ready: stride 1, as many frames out as in; an empty bias is none.
    fn conv_weights(&mut self, source: &Conv1d, dilation: usize) -> Result<Self::Conv>;
    /// The convolution over frames.
    fn conv(&mut self, weights: &Self::Conv, x: &Self::Value) -> Result<Self::Value>;
    /// `max(x, 0)`
    fn relu(&mut self, x: &Self::Value) -> Result<Self::Value>;
    /// `d` where `x > 0`, else 0.
    fn relu_gradient(&mut self, d: &Self::Value, x: &Self::Value) -> Result<Self::Value>;
    /// `a + b`
    fn add(&mut self, a: &Self::Value, b: &Self::Value) -> Result<Self::Value>;
    /// Every frame twice.
    fn twice(&mut self, x: &Self::Value) -> Result<Self::Value>;
    /// The sums of neighbouring pairs of frames.
    fn pair_sums(&mut self, x: &Self::Value) -> Result<Self::Value>;

    /// Makes weights ready.
    fn linear_weights(&mut self, source: &Linear) -> Result<Self::Linear>;
    /// `x W^T + b`
    fn linear(&mut self, weights: &Self::Linear, x: &Self::Value) -> Result<Self::Value>;
    /// Makes weights ready.
    fn norm_weights(&mut self, source: &LayerNorm, epsilon: f64) -> Result<Self::Norm>;
    /// The norm of every row.
    fn norm(&mut self, weights: &Self::Norm, x: &Self::Value) -> Result<Self::Value>;
    /// `x / 2 (1 + erf(x / sqrt 2))`
    fn gelu(&mut self, x: &Self::Value) -> Result<Self::Value>;
    /// A matrix known beforehand.
    fn constant(&mut self, values: &[f32], columns: usize) -> Result<Self::Value>;
    /// Rows from `first` on.
    fn rows_from(&mut self, x: &Self::Value, first: usize) -> Result<Self::Value>;
    /// `count` columns from `first` on.
    fn columns(&mut self, x: &Self::Value, first: usize, count: usize) -> Result<Self::Value>;
    /// `softmax(q k^T / sqrt(columns / heads)) v`, head by head.
    fn attend(&mut self, q: &Self::Value, k: &Self::Value, v: &Self::Value, heads: usize) -> Result<Self::Value>;
    /// `from + scale (to - from)`
    fn extrapolate(&mut self, from: &Self::Value, to: &Self::Value, scale: f32) -> Result<Self::Value>;
}
