//! The oracle: the decoder and the recovery of joints in f64, written as the formulas stand in EQUATIONS, with explicit
//! upsampling, no quantisation, and gradients by central differences only.

use crate::tiny::{Layer, Tiny};

/// A sequence `[rows][channels]`.
type Sequence = Vec<Vec<f64>>;

fn convolve(layer: &Layer, x: &Sequence) -> Sequence {
    let left = ((layer.taps - 1) * layer.dilation - layer.right) as isize;
    (0..x.len() as isize)
        .map(|t| {
            (0..layer.outputs)
                .map(|n| {
                    let mut sum = layer.biases[n];
                    for tap in 0..layer.taps {
                        let source = t + (tap * layer.dilation) as isize - left;
                        if let Some(row) = usize::try_from(source).ok().and_then(|s| x.get(s)) {
                            for (k, v) in row.iter().enumerate() {
                                sum += v * layer.weights[(tap * layer.outputs + n) * layer.inputs + k];
                            }
                        }
                    }
                    sum
                })
                .collect()
        })
        .collect()
}

fn relu(x: &Sequence) -> Sequence {
    x.iter().map(|row| row.iter().map(|&v| if v > 0.0 { v } else { 0.0 }).collect()).collect()
}

/// Normalised features `[T][263]` of embeddings `u [L][du]`.
#[must_use]
pub fn decode(model: &Tiny, u: &[f64]) -> Vec<Vec<f64>> {
    let mut layers = model.layers.iter();
    let mut next = || layers.next().expect("as many layers as the shape says");
    let mut x: Sequence = u.chunks(usize::from(model.shape.code_width)).map(<[f64]>::to_vec).collect();
    x = relu(&convolve(next(), &x));
    for _ in 0..model.shape.stages {
        for _ in &model.shape.dilations {
            let hidden = relu(&convolve(next(), &relu(&x)));
            let delta = convolve(next(), &hidden);
            for (x, d) in x.iter_mut().flatten().zip(delta.iter().flatten()) {
                *x += d;
            }
        }
        let doubled: Sequence = x.iter().flat_map(|row| [row.clone(), row.clone()]).collect();
        x = convolve(next(), &doubled);
    }
    x = relu(&convolve(next(), &x));
    convolve(next(), &x)
}

/// Joint positions `[T][22][3]` of normalised features.
#[must_use]
pub fn joints(model: &Tiny, features: &[Vec<f64>]) -> Vec<[[f64; 3]; 22]> {
    let (mut angle, mut x, mut z) = (0.0f64, 0.0, 0.0);
    let mut previous: Option<[f64; 3]> = None;
    features
        .iter()
        .map(|row| {
            let f = |c: usize| row[c] * model.std[c] + model.mean[c];
            if let Some([w, vx, vz]) = previous {
                angle += w;
                let (sin, cos) = (2.0 * angle).sin_cos();
                x += vx * cos - vz * sin;
                z += vx * sin + vz * cos;
            }
            previous = Some([f(0), f(1), f(2)]);
            let (sin, cos) = (2.0 * angle).sin_cos();
            std::array::from_fn(|j| {
                if j == 0 {
                    return [x, f(3), z];
                }
                let (lx, ly, lz) = (f(3 * j + 1), f(3 * j + 2), f(3 * j + 3));
                [lx * cos - lz * sin + x, ly, lx * sin + lz * cos + z]
            })
        })
        .collect()
}

/// The same from embeddings.
#[must_use]
pub fn motion(model: &Tiny, u: &[f64]) -> Vec<[[f64; 3]; 22]> {
    joints(model, &decode(model, u))
}
