//! Encoder and decoder: MoMask's topology, channels last.
//!
//! Encoder: conv k3, ReLU, 2 x { conv k4 stride 2, residual blocks }, conv k3. Decoder: conv k3, ReLU, 2 x { residual blocks, every
//! sample twice, conv k3 }, conv k3, ReLU, conv k3. A residual block is `x + conv k1(relu(conv k3 dilated(relu(x))))`. The encoder looks
//! as far ahead as back, the decoder as far as [`Architecture::right`] says.
//!
//! All parameters live in one flat vector in the order of [`shapes`]; a [`Network`] is that vector laid out on a device for one
//! step. Clips that are shorter than the window are masked before every convolution with more than one tap, so that they see
//! the same zeros beyond their end as when they are decoded alone.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use super::config::{Architecture, DOWN_T, FEATURES};
use crate::convolution::{Convolution, Shape, add_gradients, upsample};
use crate::random::Random;

/// Shapes of all convolutions in checkpoint names and in the order in which they run; the encoder's come first.
pub fn shapes(architecture: &Architecture) -> Vec<Shape> {
    let mut shapes = encoder_shapes(architecture);
    shapes.extend(decoder_shapes(architecture));
    shapes
}

fn shape(name: String, inputs: usize, outputs: usize, kernel: usize, dilation: usize) -> Shape {
    Shape { name, inputs, outputs, kernel, dilation, right: dilation }
}

fn block_shapes(prefix: &str, width: usize, dilations: &[usize]) -> Vec<Shape> {
    let block = |(b, dilation): (usize, &usize)| {
        [
            shape(format!("{prefix}.model.{b}.conv1"), width, width, 3, *dilation),
            shape(format!("{prefix}.model.{b}.conv2"), width, width, 1, 1),
        ]
    };
    dilations.iter().enumerate().flat_map(block).collect()
}

fn encoder_shapes(a: &Architecture) -> Vec<Shape> {
    let width = a.encoder_width;
    let mut shapes = vec![shape("encoder.model.0".into(), FEATURES, width, 3, 1)];
    for stage in 2..2 + DOWN_T {
        shapes.push(shape(format!("encoder.model.{stage}.0"), width, width, 4, 1));
        shapes.extend(block_shapes(&format!("encoder.model.{stage}.1"), width, a.encoder_dilations()));
    }
    shapes.push(shape(format!("encoder.model.{}", 2 + DOWN_T), width, a.code_dim, 3, 1));
    shapes
}

fn decoder_shapes(a: &Architecture) -> Vec<Shape> {
    let width = a.width;
    let mut shapes = vec![shape("decoder.model.0".into(), a.code_dim, width, 3, 1)];
    for stage in 2..2 + DOWN_T {
        shapes.extend(block_shapes(&format!("decoder.model.{stage}.0"), width, &a.dilations));
        shapes.push(shape(format!("decoder.model.{stage}.2"), width, width, 3, 1));
    }
    shapes.push(shape(format!("decoder.model.{}", 2 + DOWN_T), width, width, 3, 1));
    shapes.push(shape(format!("decoder.model.{}", 4 + DOWN_T), width, FEATURES, 3, 1));
    for (shape, right) in shapes.iter_mut().filter(|shape| shape.kernel == 3).zip(a.decoder_right()) {
        shape.right = right;
    }
    shapes
}

/// Number of values in the flat parameter vector.
pub fn parameter_count(shapes: &[Shape]) -> usize {
    shapes.iter().map(Shape::parameters).sum()
}

/// Random start: uniform weights with the variance He et al. use before a ReLU, zero biases, and second convolutions of residual
/// blocks scaled down so that a deep stack starts near the identity.
pub fn initial_parameters(shapes: &[Shape], seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed, u64::MAX);
    let mut values = Vec::with_capacity(parameter_count(shapes));
    for shape in shapes {
        let gain = if shape.name.ends_with("conv2") { 0.5 } else { 1.0 };
        let bound = gain * (3.0 / (shape.kernel * shape.inputs) as f64).sqrt();
        values.extend((0..shape.weights()).map(|_| (bound * random.symmetric()) as f32));
        values.extend(std::iter::repeat_n(0.0, shape.outputs));
    }
    values
}

/// Masks of a batch with padded crops, one for each sampling rate from frames to tokens, each `[B, T, 1]` of ones and zeros.
pub struct Masks {
    rates: Vec<Tensor<3>>,
}

impl Masks {
    /// Masks for crops of `lengths` frames (multiples of 4) in a window of `window` frames; none when nothing is padded.
    pub fn new(lengths: &[usize], window: usize, device: &Device) -> Option<Self> {
        if lengths.iter().all(|length| *length == window) {
            return None;
        }
        let mask = |rate: usize| {
            let samples = window >> rate;
            let row = |length: &usize| {
                let valid = *length >> rate;
                (0..samples).map(move |t| if t < valid { 1.0f32 } else { 0.0 })
            };
            let values: Vec<f32> = lengths.iter().flat_map(row).collect();
            Tensor::from_data(TensorData::new(values, [lengths.len(), samples, 1]), device)
        };
        Some(Self { rates: (0..=DOWN_T).map(mask).collect() })
    }
}

fn masked(x: Tensor<3>, masks: Option<&Masks>, rate: usize) -> Tensor<3> {
    match masks {
        Some(masks) => x * masks.rates[rate].clone(),
        None => x,
    }
}

/// Both networks on a device.
pub struct Network {
    encoder: Vec<Convolution>,
    decoder: Vec<Convolution>,
    encoder_blocks: usize,
    decoder_blocks: usize,
}

impl Network {
    /// Lays the flat parameters out as tensors, as leaves of a graph when `tracked`.
    pub fn new(architecture: &Architecture, values: &[f32], tracked: bool, device: &Device) -> Self {
        let mut rest = values;
        let mut lay = |shapes: Vec<Shape>| -> Vec<Convolution> {
            let place = |shape: &Shape| {
                let (own, after) = rest.split_at(shape.parameters());
                rest = after;
                Convolution::new(shape, own, tracked, device)
            };
            shapes.iter().map(place).collect()
        };
        Self {
            encoder: lay(encoder_shapes(architecture)),
            decoder: lay(decoder_shapes(architecture)),
            encoder_blocks: architecture.encoder_dilations().len(),
            decoder_blocks: architecture.dilations.len(),
        }
    }

    /// The decoder alone, of the first `features` channels, frozen.
    pub fn frozen_decoder(architecture: &Architecture, values: &[f32], features: usize, device: &Device) -> Self {
        let mut rest = &values[parameter_count(&encoder_shapes(architecture))..];
        let place = |shape: &Shape| {
            let (own, after) = rest.split_at(shape.parameters());
            rest = after;
            if shape.outputs != FEATURES {
                return Convolution::new(shape, own, false, device);
            }
            // Biases lie behind the weights as one row more.
            let kept: Vec<f32> = own.chunks_exact(FEATURES).flat_map(|row| &row[..features]).copied().collect();
            Convolution::new(&Shape { outputs: features, ..shape.clone() }, &kept, false, device)
        };
        let decoder = decoder_shapes(architecture).iter().map(place).collect();
        Self { encoder: Vec::new(), decoder, encoder_blocks: 0, decoder_blocks: architecture.dilations.len() }
    }

    /// Normalised features `[B, T, F]`, zero where padded, to latents `[B, T / 4, code_dim]`.
    pub fn encode(&self, x: Tensor<3>, masks: Option<&Masks>) -> Tensor<3> {
        let mut layers = self.encoder.iter();
        let mut next = || layers.next().expect("the encoder has a layer for every step");
        let mut x = masked(relu(next().forward(x)), masks, 0);
        for rate in 1..=DOWN_T {
            x = next().forward(x);
            for _ in 0..self.encoder_blocks {
                x = residual(x, next(), next(), masks, rate);
            }
            x = masked(x, masks, rate);
        }
        next().forward(x)
    }

    /// Code vectors `[B, T / 4, code_dim]`, zero where padded, to normalised features `[B, T, F]`; frames beyond a crop's end hold
    /// anything.
    pub fn decode(&self, u: Tensor<3>, masks: Option<&Masks>) -> Tensor<3> {
        let mut layers = self.decoder.iter();
        let mut next = || layers.next().expect("the decoder has a layer for every step");
        let mut x = relu(next().forward(u));
        for rate in (0..DOWN_T).rev() {
            for _ in 0..self.decoder_blocks {
                x = residual(x, next(), next(), masks, rate + 1);
            }
            x = next().forward(masked(upsample(x), masks, rate));
        }
        x = masked(relu(next().forward(masked(x, masks, 0))), masks, 0);
        next().forward(x)
    }

    /// Adds the gradients of the parameters to a flat vector in the order of [`shapes`].
    pub fn collect_gradients(&self, gradients: &Gradients, flat: &mut [f32]) {
        let layers = self.encoder.iter().chain(&self.decoder);
        add_gradients(layers.flat_map(|layer| [&layer.weight, &layer.bias]), gradients, flat);
    }
}

fn residual(x: Tensor<3>, conv1: &Convolution, conv2: &Convolution, masks: Option<&Masks>, rate: usize) -> Tensor<3> {
    let inner = conv1.forward(masked(relu(x.clone()), masks, rate));
    x + conv2.forward(relu(inner))
}

#[cfg(test)]
mod tests {
    use super::super::config::FRAMES_PER_TOKEN;
    use super::*;

    fn architecture() -> Architecture {
        Architecture {
            width: 6,
            encoder_width: 5,
            code_dim: 3,
            codes: 4,
            dilations: vec![3, 1],
            encoder_dilations: Vec::new(),
            right: Vec::new(),
        }
    }

    /// Some of its convolutions look ahead, none as far as back but two; the encoder has a block more.
    fn mostly_causal() -> Architecture {
        let right = vec![1, 2, 0, 1, 0, 1, 0, 0, 0];
        Architecture { encoder_dilations: vec![2, 1, 1], right, ..architecture() }
    }

    fn noise(n: usize, stream: u64) -> Vec<f32> {
        let mut random = Random::new(17, stream);
        (0..n).map(|_| random.symmetric() as f32).collect()
    }

    /// Parameters with biases that are not zero, so that padding would show.
    fn parameters(architecture: &Architecture) -> Vec<f32> {
        let mut values = initial_parameters(&shapes(architecture), 3);
        for (value, bias) in values.iter_mut().zip(noise(1 << 20, 4)) {
            *value += 0.1 * bias;
        }
        values
    }

    fn tensor(values: Vec<f32>, shape: [usize; 3], device: &Device) -> Tensor<3> {
        Tensor::from_data(TensorData::new(values, shape), device)
    }

    fn values(tensor: Tensor<3>) -> Vec<f32> {
        tensor.into_data().try_into_vec().unwrap()
    }

    #[test]
    fn a_padded_crop_is_coded_as_if_it_were_alone() {
        for architecture in [architecture(), mostly_causal()] {
            check_padded_crops(&architecture);
        }
    }

    fn check_padded_crops(architecture: &Architecture) {
        let device = Device::flex();
        let network = Network::new(architecture, &parameters(architecture), false, &device);
        let (window, lengths) = (24, [24, 8, 16]);
        let mut features = vec![0.0; lengths.len() * window * FEATURES];
        for (b, length) in lengths.iter().enumerate() {
            let valid = length * FEATURES;
            features[b * window * FEATURES..][..valid].copy_from_slice(&noise(valid, b as u64));
        }
        let masks = Masks::new(&lengths, window, &device).expect("two crops are padded");
        let latents = network.encode(tensor(features, [3, window, FEATURES], &device), Some(&masks));
        let latents = values(latents);
        let mut u = vec![0.0; latents.len()];
        let tokens = window / 4;
        for (b, length) in lengths.iter().enumerate() {
            let row = b * tokens * 3;
            u[row..][..length / 4 * 3].copy_from_slice(&latents[row..][..length / 4 * 3]);
        }
        let decoded = values(network.decode(tensor(u, [3, tokens, 3], &device), Some(&masks)));
        for (b, length) in lengths.iter().enumerate() {
            let alone = tensor(noise(length * FEATURES, b as u64), [1, *length, FEATURES], &device);
            let alone = network.encode(alone, None);
            let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-5);
            let z = values(alone.clone());
            assert!(close(&latents[b * tokens * 3..][..z.len()], &z), "latents of crop {b}");
            let y = values(network.decode(alone, None));
            assert!(close(&decoded[b * window * FEATURES..][..y.len()], &y), "output of crop {b}");
        }
    }

    #[test]
    fn a_frozen_decoder_gives_the_first_channels() {
        let device = Device::flex();
        let u = || tensor(noise(5 * 3, 8), [1, 5, 3], &device);
        let a = mostly_causal();
        let whole = values(Network::new(&a, &parameters(&a), false, &device).decode(u(), None));
        let part = values(Network::frozen_decoder(&a, &parameters(&a), 67, &device).decode(u(), None));
        for (whole, part) in whole.chunks_exact(FEATURES).zip(part.chunks_exact(67)) {
            assert!(whole.iter().zip(part).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }

    /// The look-ahead is where the frames begin that a code changes.
    #[test]
    fn a_code_reaches_as_far_as_the_decoder_looks_ahead() {
        let device = Device::flex();
        let causal = Architecture { right: vec![0; 9], ..architecture() };
        for (a, frames) in [(architecture(), 33), (mostly_causal(), 16), (causal, 0)] {
            let network = Network::new(&a, &parameters(&a), false, &device);
            let (tokens, changed) = (24, 12);
            let u = noise(tokens * 3, 8);
            let mut other = u.clone();
            other[changed * 3..][..3].copy_from_slice(&[2.0, -3.0, 1.0]);
            let decode = |u| values(network.decode(tensor(u, [1, tokens, 3], &device), None));
            let (y, other) = (decode(u), decode(other));
            let first = y.iter().zip(&other).position(|(a, b)| a != b).expect("a code changes frames") / FEATURES;
            assert_eq!(FRAMES_PER_TOKEN * changed - first, frames);
            assert_eq!(a.look_ahead_frames(), frames);
        }
    }

    /// Order and values of the flat gradient: every convolution's weights and biases against differences.
    #[test]
    fn gradients_agree_with_differences() {
        for architecture in [architecture(), mostly_causal()] {
            check_gradients(&architecture);
        }
    }

    fn check_gradients(a: &Architecture) {
        let start = parameters(a);
        let frames = 12;
        let features = noise(frames * FEATURES, 6);
        let weights = noise(frames * FEATURES, 7);
        let run = |values: &[f32], device: &Device| {
            let network = Network::new(a, values, true, device);
            let x = tensor(features.clone(), [1, frames, FEATURES], device);
            let y = network.decode(network.encode(x, None), None);
            (network, (y * tensor(weights.clone(), [1, frames, FEATURES], device)).sum())
        };
        let tracked = Device::flex().autodiff();
        let (network, objective) = run(&start, &tracked);
        let mut gradient = vec![0.0; start.len()];
        network.collect_gradients(&objective.backward(), &mut gradient);
        let value = |values: &[f32]| f64::from(run(values, &tracked).1.into_scalar::<f32>());
        let mut offset = 0;
        for shape in shapes(a) {
            for index in [offset, offset + shape.weights() / 2, offset + shape.parameters() - 1] {
                let slope = crate::testing::slope(value, &start, index, 1e-3);
                let error = (slope - f64::from(gradient[index])).abs();
                assert!(error < 0.05 + 0.03 * slope.abs(), "{} {index}: {slope} {}", shape.name, gradient[index]);
            }
            offset += shape.parameters();
        }
        assert_eq!(offset, start.len());
    }
}
