//! Motion encoder, text encoder and classification heads, channels last.
//!
//! Motion: three times { conv k4 stride 2, ReLU, x + conv k3(x), ReLU }, mean over time, linear, ReLU: the trunk. Text: words, conv k3,
//! ReLU, mean over words, linear, ReLU. A linear layer and unit length make an embedding of either; two linear layers on the motion's
//! trunk name content and style.
//!
//! All parameters live in one flat vector in the order of [`shapes`]. Padding is masked before every convolution with more than one
//! tap and left out of the means, so that a motion is judged the same alone and in a batch.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use motionette_host::motion::FEATURES;

use super::config::Config;
use super::corpus::Labels;
use crate::convolution::{Convolution, Shape, add_gradients};
use crate::random::Random;

/// Stages of the motion encoder; each halves the number of samples.
const STAGES: usize = 3;
/// Added to the squared length of an embedding before the root.
const TINY: f32 = 1e-12;

/// Shapes of all layers in checkpoint names and in the order in which they run.
pub fn shapes(config: &Config, labels: &Labels) -> Vec<Shape> {
    let layer = |name: String, inputs, outputs, kernel| Shape { name, inputs, outputs, kernel, dilation: 1, right: 1 };
    let Config { width, hidden, word_width, embedding, .. } = *config;
    let mut shapes = Vec::new();
    for stage in 0..STAGES {
        let inputs = if stage == 0 { FEATURES } else { width };
        shapes.push(layer(format!("motion.stages.{stage}.down"), inputs, width, 4));
        shapes.push(layer(format!("motion.stages.{stage}.block"), width, width, 3));
    }
    shapes.push(layer("motion.trunk".into(), width, hidden, 1));
    shapes.push(layer("motion.embedding".into(), hidden, embedding, 1));
    shapes.push(layer("motion.content".into(), hidden, labels.contents.len().max(1), 1));
    shapes.push(layer("motion.style".into(), hidden, labels.styles.len().max(1), 1));
    shapes.push(layer("text.words".into(), labels.vocabulary.words.len().max(2), word_width, 1));
    shapes.push(layer("text.context".into(), word_width, hidden, 3));
    shapes.push(layer("text.trunk".into(), hidden, hidden, 1));
    shapes.push(layer("text.embedding".into(), hidden, embedding, 1));
    shapes
}

/// Random start: uniform weights with the variance He et al. use before a ReLU, zero biases; blocks at half of that.
pub fn initial_parameters(shapes: &[Shape], seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed, u64::MAX);
    let mut values = Vec::new();
    for shape in shapes {
        // One word of a sentence's vocabulary is there at a time, whatever its size.
        let inputs = if shape.name == "text.words" { 3 } else { shape.kernel * shape.inputs };
        let gain = if shape.name.ends_with("block") { 0.5 } else { 1.0 };
        let bound = gain * (3.0 / inputs as f64).sqrt();
        values.extend((0..shape.weights()).map(|_| (bound * random.symmetric()) as f32));
        values.extend(std::iter::repeat_n(0.0, shape.outputs));
    }
    values
}

/// What the motion encoder says about a batch.
pub struct MotionOutput {
    /// `[B][embedding]`, unit length.
    pub embedding: Tensor<2>,
    /// `[B][contents]` logits.
    pub content: Tensor<2>,
    /// `[B][styles]` logits.
    pub style: Tensor<2>,
}

/// Channels a step leaves out, and the seeded choice of them.
pub struct Dropout<'a> {
    /// Share that is left out.
    pub share: f64,
    /// Where the choice comes from.
    pub random: &'a mut Random,
}

/// All networks on a device.
pub struct Network {
    layers: Vec<Convolution>,
    vocabulary: usize,
}

impl Network {
    /// Lays the flat parameters out as tensors, as leaves of a graph when `tracked`.
    pub fn new(shapes: &[Shape], values: &[f32], tracked: bool, device: &Device) -> Self {
        let mut rest = values;
        let place = |shape: &Shape| {
            let (own, after) = rest.split_at(shape.parameters());
            rest = after;
            Convolution::new(shape, own, tracked, device)
        };
        let vocabulary = shapes.iter().find(|shape| shape.name == "text.words").map_or(1, |shape| shape.inputs);
        Self { layers: shapes.iter().map(place).collect(), vocabulary }
    }

    fn motion_layers(&self) -> &[Convolution] {
        &self.layers[..2 * STAGES + 4]
    }

    fn text_layers(&self) -> &[Convolution] {
        &self.layers[2 * STAGES + 4..]
    }

    /// Normalised features `[B][window][263]`, zero beyond the `lengths`; the window is a multiple of 8.
    pub fn motion(
        &self,
        features: Vec<f32>,
        lengths: &[usize],
        dropout: Option<&mut Dropout<'_>>,
        device: &Device,
    ) -> MotionOutput {
        let batch = lengths.len();
        let window = features.len() / (batch * FEATURES);
        let mut x = Tensor::<3>::from_data(TensorData::new(features, [batch, window, FEATURES]), device);
        let layers = self.motion_layers();
        let mut lengths = lengths.to_vec();
        for stage in layers[..2 * STAGES].chunks_exact(2) {
            lengths.iter_mut().for_each(|length| *length = length.div_ceil(2));
            x = relu(stage[0].forward(x));
            let mask = mask(&lengths, x.dims()[1], device);
            x = x * mask.clone();
            x = relu(x.clone() + stage[1].forward(x)) * mask;
        }
        let trunk = relu(layers[2 * STAGES].forward(thinned(mean(x, &lengths, device), dropout)));
        let flat = |x: Tensor<3>| -> Tensor<2> {
            let [batch, _, channels] = x.dims();
            x.reshape([batch, channels])
        };
        MotionOutput {
            embedding: unit(flat(layers[2 * STAGES + 1].forward(trunk.clone()))),
            content: flat(layers[2 * STAGES + 2].forward(trunk.clone())),
            style: flat(layers[2 * STAGES + 3].forward(trunk)),
        }
    }

    /// Embeddings `[B][embedding]` of unit length of sentences with at least one word.
    pub fn text(&self, sentences: &[Vec<usize>], dropout: Option<&mut Dropout<'_>>, device: &Device) -> Tensor<2> {
        let batch = sentences.len();
        let longest = sentences.iter().map(Vec::len).max().unwrap_or(0);
        let mut chosen = vec![0.0f32; batch * longest * self.vocabulary];
        for (row, sentence) in chosen.chunks_exact_mut((longest * self.vocabulary).max(1)).zip(sentences) {
            for (word, number) in row.chunks_exact_mut(self.vocabulary).zip(sentence) {
                word[*number] = 1.0;
            }
        }
        let lengths: Vec<usize> = sentences.iter().map(Vec::len).collect();
        let mask = mask(&lengths, longest, device);
        let x = Tensor::<3>::from_data(TensorData::new(chosen, [batch, longest, self.vocabulary]), device);
        let layers = self.text_layers();
        let x = layers[0].forward(x) * mask.clone();
        let x = relu(layers[1].forward(x)) * mask;
        let trunk = relu(layers[2].forward(thinned(mean(x, &lengths, device), dropout)));
        let embedding = layers[3].forward(trunk);
        let [batch, _, channels] = embedding.dims();
        unit(embedding.reshape([batch, channels]))
    }

    /// Adds the gradients of the parameters to a flat vector in the order of [`shapes`].
    pub fn collect_gradients(&self, gradients: &Gradients, flat: &mut [f32]) {
        let layers = self.layers.iter();
        add_gradients(layers.flat_map(|layer| [&layer.weight, &layer.bias]), gradients, flat);
    }
}

/// `[B, samples, 1]`: one within a length, zero beyond.
fn mask(lengths: &[usize], samples: usize, device: &Device) -> Tensor<3> {
    let row = |length: &usize| {
        let length = *length;
        (0..samples).map(move |t| if t < length { 1.0f32 } else { 0.0 })
    };
    let values: Vec<f32> = lengths.iter().flat_map(row).collect();
    Tensor::from_data(TensorData::new(values, [lengths.len(), samples, 1]), device)
}

/// Means over the valid samples, `[B, 1, C]`; what is beyond them must be zero.
fn mean(x: Tensor<3>, lengths: &[usize], device: &Device) -> Tensor<3> {
    let shares: Vec<f32> = lengths.iter().map(|length| 1.0 / (*length).max(1) as f32).collect();
    x.sum_dim(1) * Tensor::<3>::from_data(TensorData::new(shares, [lengths.len(), 1, 1]), device)
}

/// Leaves channels out and scales the others so that the mean stays.
fn thinned(x: Tensor<3>, dropout: Option<&mut Dropout<'_>>) -> Tensor<3> {
    let Some(Dropout { share, random }) = dropout else { return x };
    let kept = (1.0 / (1.0 - *share)) as f32;
    let [batch, samples, channels] = x.dims();
    let values: Vec<f32> =
        (0..batch * samples * channels).map(|_| if random.unit() < *share { 0.0 } else { kept }).collect();
    let mask = Tensor::<3>::from_data(TensorData::new(values, [batch, samples, channels]), &x.device());
    x * mask
}

/// Rows of unit length.
fn unit(x: Tensor<2>) -> Tensor<2> {
    let length = (x.clone() * x.clone()).sum_dim(1).add_scalar(TINY).sqrt();
    x / length
}
