//! Convolution along time on the tensor framework, channels last.
//!
//! Patches are gathered and multiplied (im2col): on the CPU backend that takes half the time of the framework's own convolution.

use burn::tensor::{Device, Gradients, Tensor, TensorData};

use crate::tensor_file::{self, TensorFile};

/// Shape of one convolution. Padding is zero: `2 * dilation` in all for kernel 3, one on both sides for kernel 4 with stride 2.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Name in the checkpoint, without `.weight` and `.bias`.
    pub name: String,
    /// Channels in.
    pub inputs: usize,
    /// Channels out.
    pub outputs: usize,
    /// Taps: 1, 3 (stride 1) or 4 (stride 2).
    pub kernel: usize,
    /// Distance of two taps in samples.
    pub dilation: usize,
    /// Samples of padding behind the end for kernel 3, which is how far it looks ahead: from 0, which is causal, to `dilation`, which is
    /// symmetrical. The rest of the padding lies before the beginning.
    pub right: usize,
}

impl Shape {
    /// Number of weights.
    pub fn weights(&self) -> usize {
        self.kernel * self.inputs * self.outputs
    }

    /// Number of weights and biases.
    pub fn parameters(&self) -> usize {
        self.weights() + self.outputs
    }
}

/// Order of the weights of a convolution in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// `[kernel][in][out]`, as in memory.
    InputsFirst,
    /// `[out][in][kernel]`, as torch stores them.
    Torch,
}

impl Shape {
    /// Shape of the weights in a file.
    fn stored(&self, order: Order) -> [usize; 3] {
        match order {
            Order::InputsFirst => [self.kernel, self.inputs, self.outputs],
            Order::Torch => [self.outputs, self.inputs, self.kernel],
        }
    }
}

/// Values `[a][b][c]` as `[c][b][a]`.
fn reversed(values: &[f32], [a, b, c]: [usize; 3]) -> Vec<f32> {
    let row = |k: usize, j: usize| (0..a).map(move |i| values[(i * b + j) * c + k]);
    (0..c).flat_map(|k| (0..b).flat_map(move |j| row(k, j))).collect()
}

/// Adds `<name>.weight` and `<name>.bias` of every convolution of a flat vector.
pub fn store(shapes: &[Shape], mut values: &[f32], order: Order, file: &mut TensorFile) {
    for shape in shapes {
        let (own, rest) = values.split_at(shape.parameters());
        values = rest;
        let (weight, bias) = own.split_at(shape.weights());
        let weight = match order {
            Order::InputsFirst => weight.to_vec(),
            Order::Torch => reversed(weight, shape.stored(Order::InputsFirst)),
        };
        file.insert(format!("{}.weight", shape.name), &shape.stored(order), weight);
        file.insert(format!("{}.bias", shape.name), &[shape.outputs], bias.to_vec());
    }
}

/// The flat vector that [`store`] took.
///
/// # Errors
/// [`tensor_file::Error`] naming the tensor that is missing or does not fit.
pub fn restore(shapes: &[Shape], order: Order, file: &TensorFile) -> Result<Vec<f32>, tensor_file::Error> {
    let mut values = Vec::with_capacity(shapes.iter().map(Shape::parameters).sum());
    for shape in shapes {
        let sizes = shape.stored(order);
        let weight = file.values(&format!("{}.weight", shape.name), &sizes)?;
        match order {
            Order::InputsFirst => values.extend(weight),
            Order::Torch => values.extend(reversed(weight, sizes)),
        }
        values.extend(file.values(&format!("{}.bias", shape.name), &[shape.outputs])?);
    }
    Ok(values)
}

/// For every value of a flat vector of these convolutions: whether weight decay applies (weights yes, biases no).
pub fn decay_mask(shapes: &[Shape]) -> Vec<bool> {
    let of = |s: &Shape| std::iter::repeat_n(true, s.weights()).chain(std::iter::repeat_n(false, s.outputs));
    shapes.iter().flat_map(of).collect()
}

/// One convolution, its parameters on a device.
#[derive(Clone, Debug)]
pub struct Convolution {
    /// `[kernel * inputs, outputs]`, the tap is the slow index of a row.
    pub weight: Tensor<2>,
    /// `[1, outputs]`.
    pub bias: Tensor<2>,
    shape: Shape,
}

impl Convolution {
    /// Takes `shape.parameters()` values: weights `[kernel][inputs][outputs]`, then biases. They become leaves of a graph when
    /// `tracked` and the device differentiates.
    pub fn new(shape: &Shape, values: &[f32], tracked: bool, device: &Device) -> Self {
        let (weight, bias) = values.split_at(shape.weights());
        let rows = shape.kernel * shape.inputs;
        let leaf = |tensor: Tensor<2>| if tracked { tensor.require_grad() } else { tensor };
        Self {
            weight: leaf(Tensor::from_data(TensorData::new(weight.to_vec(), [rows, shape.outputs]), device)),
            bias: leaf(Tensor::from_data(TensorData::new(bias.to_vec(), [1, shape.outputs]), device)),
            shape: shape.clone(),
        }
    }

    /// `[B, T, inputs]` to `[B, T, outputs]`, or `[B, T / 2, outputs]` for kernel 4; T must be even there.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [batch, time, channels] = x.dims();
        assert_eq!(channels, self.shape.inputs, "{}: wrong number of channels", self.shape.name);
        let (patches, length) = match self.shape.kernel {
            1 => (x, time),
            3 => (taps3(x, self.shape.dilation, self.shape.right), time),
            4 => (taps4(x), time / 2),
            kernel => panic!("{}: kernel {kernel} has no gather", self.shape.name),
        };
        let rows = patches.reshape([batch * length, self.shape.kernel * channels]);
        (rows.matmul(self.weight.clone()) + self.bias.clone()).reshape([batch, length, self.shape.outputs])
    }
}

/// Adds the gradients of `tensors` to a flat vector in which they lie one behind the other.
pub fn add_gradients<'t>(tensors: impl Iterator<Item = &'t Tensor<2>>, gradients: &Gradients, flat: &mut [f32]) {
    let mut offset = 0;
    for tensor in tensors {
        let [rows, columns] = tensor.dims();
        if let Some(gradient) = tensor.grad(gradients) {
            let gradient = gradient.into_data();
            let gradient = gradient.as_slice::<f32>().expect("parameters are f32");
            for (sum, g) in flat[offset..].iter_mut().zip(gradient) {
                *sum += g;
            }
        }
        offset += rows * columns;
    }
}

/// Patches of kernel 3 of which the last tap is `right` samples ahead, at most `dilation`: `[B, T, C]` to `[B, T, 3 C]`.
fn taps3(x: Tensor<3>, dilation: usize, right: usize) -> Tensor<3> {
    let (first, middle) = (later(x.clone(), 2 * dilation - right), later(x.clone(), dilation - right));
    Tensor::cat(vec![first, middle, earlier(x, right)], 2)
}

/// The sequence `shift` samples later: zeros come in at its beginning.
fn later(x: Tensor<3>, shift: usize) -> Tensor<3> {
    let [batch, time, channels] = x.dims();
    if shift == 0 {
        return x;
    }
    let shift = shift.min(time);
    let zeros = Tensor::<3>::zeros([batch, shift, channels], &x.device());
    if shift == time { zeros } else { Tensor::cat(vec![zeros, x.narrow(1, 0, time - shift)], 1) }
}

/// The sequence `shift` samples earlier: zeros come in at its end.
fn earlier(x: Tensor<3>, shift: usize) -> Tensor<3> {
    let [batch, time, channels] = x.dims();
    if shift == 0 {
        return x;
    }
    let shift = shift.min(time);
    let zeros = Tensor::<3>::zeros([batch, shift, channels], &x.device());
    if shift == time { zeros } else { Tensor::cat(vec![x.narrow(1, shift, time - shift), zeros], 1) }
}

/// Patches of kernel 4, stride 2, padding 1: `[B, T, C]` to `[B, T / 2, 4 C]`, row t holds samples 2 t - 1 .. 2 t + 2.
fn taps4(x: Tensor<3>) -> Tensor<3> {
    let [batch, time, channels] = x.dims();
    let zeros = Tensor::<3>::zeros([batch, 1, channels], &x.device());
    let padded = Tensor::cat(vec![zeros.clone(), x, zeros], 1);
    let half = time / 2;
    let pairs = padded.reshape([batch, half + 1, 2 * channels]);
    Tensor::cat(vec![pairs.clone().narrow(1, 0, half), pairs.narrow(1, 1, half)], 2)
}

/// Every sample twice: `[B, T, C]` to `[B, 2 T, C]`.
pub fn upsample(x: Tensor<3>) -> Tensor<3> {
    let [batch, time, channels] = x.dims();
    Tensor::cat(vec![x.clone(), x], 2).reshape([batch, 2 * time, channels])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn noise(n: usize, stream: u64) -> Vec<f32> {
        let mut random = Random::new(11, stream);
        (0..n).map(|_| random.symmetric() as f32).collect()
    }

    /// Plain loops over the definition.
    fn direct(shape: &Shape, values: &[f32], x: &[f32], time: usize) -> Vec<f32> {
        let (stride, padding) = match shape.kernel {
            4 => (2, 1),
            3 => (1, 2 * shape.dilation - shape.right),
            _ => (1, 0),
        };
        let length = time / stride;
        let mut y = vec![0.0; length * shape.outputs];
        for t in 0..length {
            for o in 0..shape.outputs {
                let mut sum = values[shape.weights() + o];
                for tap in 0..shape.kernel {
                    let source = (t * stride + tap * shape.dilation) as isize - padding as isize;
                    if source < 0 || source >= time as isize {
                        continue;
                    }
                    for c in 0..shape.inputs {
                        sum += values[(tap * shape.inputs + c) * shape.outputs + o]
                            * x[source as usize * shape.inputs + c];
                    }
                }
                y[t * shape.outputs + o] = sum;
            }
        }
        y
    }

    #[test]
    fn agrees_with_plain_loops() {
        let device = Device::flex();
        let symmetrical = [(1, 1, 6), (3, 1, 8), (3, 3, 8), (3, 9, 8), (3, 9, 4), (3, 3, 10), (4, 1, 8), (4, 1, 2)];
        let symmetrical = symmetrical.map(|(kernel, dilation, time)| (kernel, dilation, dilation, time));
        let others = [(1, 0, 8), (3, 0, 8), (3, 1, 8), (3, 2, 4), (3, 1, 1), (4, 0, 4), (9, 5, 4), (2, 1, 3)];
        let others = others.map(|(dilation, right, time)| (3, dilation, right, time));
        for (kernel, dilation, right, time) in symmetrical.into_iter().chain(others) {
            let shape = Shape { name: "test".into(), inputs: 3, outputs: 5, kernel, dilation, right };
            let values = noise(shape.parameters(), kernel as u64);
            let x = noise(2 * time * 3, 99);
            let convolution = Convolution::new(&shape, &values, false, &device);
            let y = convolution.forward(Tensor::from_data(TensorData::new(x.clone(), [2, time, 3]), &device));
            let y = y.into_data().try_to_vec::<f32>().unwrap();
            let expected: Vec<f32> = x.chunks(time * 3).flat_map(|x| direct(&shape, &values, x, time)).collect();
            assert_eq!(y.len(), expected.len());
            for (a, b) in y.iter().zip(&expected) {
                assert!((a - b).abs() < 1e-5, "kernel {kernel} dilation {dilation} {right} time {time}: {a} != {b}");
            }
        }
    }

    #[test]
    fn both_orders_of_a_file_give_the_weights_back() {
        let shape = Shape { name: "test".into(), inputs: 2, outputs: 3, kernel: 4, dilation: 1, right: 1 };
        let values = noise(shape.parameters(), 5);
        for order in [Order::InputsFirst, Order::Torch] {
            let mut file = TensorFile::default();
            store(std::slice::from_ref(&shape), &values, order, &mut file);
            assert_eq!(restore(std::slice::from_ref(&shape), order, &file).unwrap(), values);
            // Output 2, input 1, tap 3, by the definition of the order.
            let (sizes, stored) = &file.tensors["test.weight"];
            let at = if order == Order::Torch { [2, 1, 3] } else { [3, 1, 2] };
            let place = (at[0] * sizes[1] + at[1]) * sizes[2] + at[2];
            assert_eq!(stored[place], values[(3 * 2 + 1) * 3 + 2], "{order:?}");
        }
    }

    #[test]
    fn upsample_repeats_samples() {
        let x = Tensor::<3>::from_data(TensorData::new(vec![1.0f32, 2.0, 3.0, 4.0], [1, 2, 2]), &Device::flex());
        let y = upsample(x).into_data().try_to_vec::<f32>().unwrap();
        assert_eq!(y, [1.0, 2.0, 1.0, 2.0, 3.0, 4.0, 3.0, 4.0]);
    }
}
