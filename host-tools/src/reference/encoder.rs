//! Normalised features to latent vectors: conv k3, ReLU, stages { conv k4 stride 2, blocks }, conv k3.

use super::conv1d::{Conv1d, Geometry, relu};
use super::real::Real;
use super::resblock::ResBlock;
use crate::checkpoint;

/// The encoder of a tokenizer.
#[derive(Debug, Clone)]
pub struct Encoder<T> {
    input: Conv1d<T>,
    stages: Vec<(Conv1d<T>, Vec<ResBlock<T>>)>,
    output: Conv1d<T>,
}

impl<T: Real> Encoder<T> {
    /// From a checkpoint's weights.
    #[must_use]
    pub fn new(source: &checkpoint::Encoder) -> Self {
        let stage = |s: &checkpoint::EncoderStage| {
            (Conv1d::new(&s.down, Geometry::HALVE), s.blocks.iter().map(|b| ResBlock::new(b, b.dilation)).collect())
        };
        Self {
            input: Conv1d::new(&source.input, Geometry::same(1)),
            stages: source.stages.iter().map(stage).collect(),
            output: Conv1d::new(&source.output, Geometry::same(1)),
        }
    }

    /// Normalised features `[T][F]` to latent `[L][du]`, `L` = T halved (rounding down) once a stage.
    #[must_use]
    pub fn forward(&self, features: &[T]) -> Vec<T> {
        let mut x = relu(&self.input.forward(features));
        for (down, blocks) in &self.stages {
            x = down.forward(&x);
            for block in blocks {
                x = block.forward(x).0;
            }
        }
        self.output.forward(&x)
    }
}
