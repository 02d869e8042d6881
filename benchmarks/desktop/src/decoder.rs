//! The decoder and its input gradient over any [`Engine`].

use anyhow::Result;
use motionette_host::checkpoint::{self, Conv1d};

use crate::engine::Engine;

/// A convolution and the convolution that carries gradients back through it.
struct Layer<E: Engine> {
    forward: E::Conv,
    backward: E::Conv,
}

struct Stage<E: Engine> {
    blocks: Vec<[Layer<E>; 2]>,
    up: Layer<E>,
}

/// A decoder with its weights in an engine.
pub struct Decoder<E: Engine> {
    input: Layer<E>,
    stages: Vec<Stage<E>>,
    hidden: Layer<E>,
    output: Layer<E>,
}

/// What the gradient needs of a pass.
pub struct Pass<E: Engine> {
    input: E::Value,
    /// Input and middle of every block of every stage.
    blocks: Vec<Vec<[E::Value; 2]>>,
    hidden: E::Value,
    /// Normalised features `[T][channels]`.
    pub features: E::Value,
}

impl<E: Engine> Decoder<E> {
    /// Makes a checkpoint's weights ready.
    ///
    /// # Errors
    /// The library's.
    pub fn new(engine: &mut E, source: &checkpoint::Decoder) -> Result<Self> {
        let mut layer = |conv: &Conv1d, dilation| -> Result<Layer<E>> {
            Ok(Layer {
                forward: engine.conv_weights(conv, dilation)?,
                backward: engine.conv_weights(&transposed(conv), dilation)?,
            })
        };
        let mut stages = Vec::new();
        for stage in &source.stages {
            let mut blocks = Vec::new();
            for block in &stage.blocks {
                blocks.push([layer(&block.conv1, block.dilation)?, layer(&block.conv2, 1)?]);
            }
            stages.push(Stage { blocks, up: layer(&stage.up, 1)? });
        }
        let (input, hidden) = (layer(&source.input, 1)?, layer(&source.hidden, 1)?);
        Ok(Self { input, stages, hidden, output: layer(&source.output, 1)? })
    }

    /// Latent `[L][du]` to features.
    ///
    /// # Errors
    /// The library's.
    pub fn forward(&self, engine: &mut E, latent: &E::Value) -> Result<Pass<E>> {
        let input = engine.conv(&self.input.forward, latent)?;
        let mut x = engine.relu(&input)?;
        let mut blocks = Vec::new();
        for stage in &self.stages {
            let mut kept = Vec::new();
            for [conv1, conv2] in &stage.blocks {
                let h = engine.relu(&x)?;
                let middle = engine.conv(&conv1.forward, &h)?;
                let h = engine.relu(&middle)?;
                let h = engine.conv(&conv2.forward, &h)?;
                let y = engine.add(&h, &x)?;
                kept.push([x, middle]);
                x = y;
            }
            let h = engine.twice(&x)?;
            x = engine.conv(&stage.up.forward, &h)?;
            blocks.push(kept);
        }
        let hidden = engine.conv(&self.hidden.forward, &x)?;
        let h = engine.relu(&hidden)?;
        let features = engine.conv(&self.output.forward, &h)?;
        Ok(Pass { input, blocks, hidden, features })
    }

    /// `dJ/dfeatures` at a pass to `dJ/dlatent`.
    ///
    /// # Errors
    /// The library's.
    pub fn backward(&self, engine: &mut E, pass: &Pass<E>, gradient: &E::Value) -> Result<E::Value> {
        let mut d = engine.conv(&self.output.backward, gradient)?;
        d = engine.relu_gradient(&d, &pass.hidden)?;
        d = engine.conv(&self.hidden.backward, &d)?;
        for (stage, kept) in self.stages.iter().zip(&pass.blocks).rev() {
            d = engine.conv(&stage.up.backward, &d)?;
            d = engine.pair_sums(&d)?;
            for ([conv1, conv2], [x, middle]) in stage.blocks.iter().zip(kept).rev() {
                let h = engine.conv(&conv2.backward, &d)?;
                let h = engine.relu_gradient(&h, middle)?;
                let h = engine.conv(&conv1.backward, &h)?;
                let h = engine.relu_gradient(&h, x)?;
                d = engine.add(&h, &d)?;
            }
        }
        d = engine.relu_gradient(&d, &pass.input)?;
        engine.conv(&self.input.backward, &d)
    }
}

/// The convolution that carries a gradient back: inputs and outputs change places, taps run the other way.
fn transposed(conv: &Conv1d) -> Conv1d {
    let Conv1d { outputs, inputs, kernel, .. } = *conv;
    let mut weight = vec![0.0; conv.weight.len()];
    for o in 0..outputs {
        for i in 0..inputs {
            for k in 0..kernel {
                weight[(i * outputs + o) * kernel + kernel - 1 - k] = conv.weight[(o * inputs + i) * kernel + k];
            }
        }
    }
    Conv1d { name: conv.name.clone(), outputs: inputs, inputs: outputs, kernel, weight, bias: Vec::new() }
}
