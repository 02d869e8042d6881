//! Latent vectors to normalised features, with everything kept that the input gradient and the golden stages need.

use super::conv1d::{Conv1d, Geometry, relu, relu_backward};
use super::real::Real;
use super::resblock::{BlockTrace, ResBlock};
use crate::checkpoint;

/// Residual blocks, nearest x2, convolution.
#[derive(Debug, Clone)]
struct Stage<T> {
    blocks: Vec<ResBlock<T>>,
    up: Conv1d<T>,
}

/// The decoder of a tokenizer.
#[derive(Debug, Clone)]
pub struct Decoder<T> {
    input: Conv1d<T>,
    stages: Vec<Stage<T>>,
    hidden: Conv1d<T>,
    output: Conv1d<T>,
}

/// One forward pass, kept. All arrays `[T of that stage][channels]`.
#[derive(Debug, Clone, Default)]
pub struct Trace<T> {
    /// Output of the first convolution, before its ReLU (`decoder.model.0`).
    pub input: Vec<T>,
    /// Output of every stage (`decoder.model.2`, `.3`).
    pub stages: Vec<Vec<T>>,
    /// Output of the convolution before the last, before its ReLU (`decoder.model.4`).
    pub hidden: Vec<T>,
    /// Normalised features `[T][channels]` (`decoder.model.6`).
    pub features: Vec<T>,
    blocks: Vec<Vec<BlockTrace<T>>>,
}

impl<T: Real> Decoder<T> {
    /// From a checkpoint's weights; only the first `channels` features are computed.
    #[must_use]
    pub fn new(source: &checkpoint::Decoder, channels: usize) -> Self {
        let mut right = source.right.iter().copied();
        // In the order of execution.
        let mut right = || right.next().expect("one for each convolution with three taps");
        let input = Conv1d::new(&source.input, Geometry::ahead(1, right()));
        let mut stage = |s: &checkpoint::DecoderStage| Stage {
            blocks: s.blocks.iter().map(|block| ResBlock::new(block, right())).collect(),
            up: Conv1d::new(&s.up, Geometry::ahead(1, right())),
        };
        let stages = source.stages.iter().map(&mut stage).collect();
        Self {
            input,
            stages,
            hidden: Conv1d::new(&source.hidden, Geometry::ahead(1, right())),
            output: Conv1d::with_outputs(&source.output, Geometry::ahead(1, right()), channels),
        }
    }

    /// Feature channels computed.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.output.outputs
    }

    /// Code width du.
    #[must_use]
    pub fn width(&self) -> usize {
        self.input.inputs
    }

    /// Frames a token.
    #[must_use]
    pub fn frames_per_token(&self) -> usize {
        1 << self.stages.len()
    }

    /// Latent `[L][du]` to normalised features `[L r][channels]`.
    #[must_use]
    pub fn forward(&self, latent: &[T]) -> Trace<T> {
        let mut trace = Trace { input: self.input.forward(latent), ..Trace::default() };
        let mut x = relu(&trace.input);
        for stage in &self.stages {
            let mut blocks = Vec::with_capacity(stage.blocks.len());
            for block in &stage.blocks {
                let (y, kept) = block.forward(x);
                blocks.push(kept);
                x = y;
            }
            x = stage.up.forward(&twice(&x, stage.up.inputs));
            trace.blocks.push(blocks);
            trace.stages.push(x.clone());
        }
        trace.hidden = self.hidden.forward(&x);
        trace.features = self.output.forward(&relu(&trace.hidden));
        trace
    }

    /// `dJ/dfeatures` `[L r][channels]` at the pass `trace` to `dJ/dlatent` `[L][du]`.
    #[must_use]
    pub fn backward(&self, trace: &Trace<T>, gradient: &[T]) -> Vec<T> {
        let mut frames = gradient.len() / self.output.outputs;
        let mut d = self.output.backward(gradient, frames);
        relu_backward(&mut d, &trace.hidden);
        d = self.hidden.backward(&d, frames);
        for (stage, blocks) in self.stages.iter().zip(&trace.blocks).rev() {
            d = once(&stage.up.backward(&d, frames), stage.up.inputs);
            frames /= 2;
            for (block, kept) in stage.blocks.iter().zip(blocks).rev() {
                d = block.backward(kept, &d);
            }
        }
        relu_backward(&mut d, &trace.input);
        self.input.backward(&d, frames)
    }
}

/// Nearest x2: every row twice.
fn twice<T: Real>(x: &[T], channels: usize) -> Vec<T> {
    x.chunks_exact(channels).flat_map(|row| [row, row]).flatten().copied().collect()
}

/// Gradient of [`twice`]: the sum of each pair of rows.
fn once<T: Real>(d: &[T], channels: usize) -> Vec<T> {
    d.chunks_exact(2 * channels)
        .flat_map(|pair| {
            let (first, second) = pair.split_at(channels);
            first.iter().zip(second).map(|(&a, &b)| a + b)
        })
        .collect()
}
