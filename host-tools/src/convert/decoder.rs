//! The whole decoder, layer by layer in order of execution. Each layer is calibrated on the output of the quantised layers before it.

use crate::blob::QuantisedConv1d;
use crate::checkpoint;
use crate::reference::conv1d::{Conv1d, Geometry};

use super::conv1d::Options;
use super::moments::Moments;

/// Most observations a layer is calibrated with; more rows than that are thinned out evenly.
const MAX_OBSERVATIONS: usize = 12_000;

/// The decoder as a list of steps.
enum Step<'a> {
    Convolve(&'a checkpoint::Conv1d, Geometry),
    /// Remember the input of a residual block.
    Keep,
    Relu,
    /// Convolve, then add what was kept.
    ConvolveAndAdd(&'a checkpoint::Conv1d),
    /// Nearest x2 of rows of this width.
    Twice(usize),
}

fn steps(decoder: &checkpoint::Decoder) -> Vec<Step<'_>> {
    let mut right = decoder.right.iter().copied();
    // In the order of execution.
    let mut geometry =
        |dilation| Geometry::ahead(dilation, right.next().expect("one for each convolution with three taps"));
    let mut steps = vec![Step::Convolve(&decoder.input, geometry(1)), Step::Relu];
    for stage in &decoder.stages {
        for block in &stage.blocks {
            steps.extend([
                Step::Keep,
                Step::Relu,
                Step::Convolve(&block.conv1, geometry(block.dilation)),
                Step::Relu,
                Step::ConvolveAndAdd(&block.conv2),
            ]);
        }
        steps.extend([Step::Twice(stage.up.inputs), Step::Convolve(&stage.up, geometry(1))]);
    }
    steps.extend([
        Step::Convolve(&decoder.hidden, geometry(1)),
        Step::Relu,
        Step::Convolve(&decoder.output, geometry(1)),
    ]);
    steps
}

/// One calibration sequence on its way through both decoders.
#[derive(Clone)]
struct Sample {
    exact: Vec<f32>,
    quantised: Vec<f32>,
    kept_exact: Vec<f32>,
    kept_quantised: Vec<f32>,
}

/// Quantises every convolution of `decoder`, the first `wide` rows of its last in int16, calibrated on `latents` (may be empty).
///
/// `progress` is called before each layer with its name.
#[must_use]
pub fn quantise(
    decoder: &checkpoint::Decoder,
    wide: usize,
    options: &Options,
    latents: &[Vec<f32>],
    mut progress: impl FnMut(&str),
) -> Vec<QuantisedConv1d> {
    let latents = if options.needs_calibration() { latents } else { &[] };
    let mut samples: Vec<Sample> = latents
        .iter()
        .map(|u| Sample { exact: u.clone(), quantised: u.clone(), kept_exact: Vec::new(), kept_quantised: Vec::new() })
        .collect();
    let mut layers = Vec::new();
    let all = |conv: &checkpoint::Conv1d, wide: usize| if options.wide_layers { conv.outputs } else { wide };
    for step in steps(decoder) {
        match step {
            Step::Keep => {
                for s in &mut samples {
                    s.kept_exact.clone_from(&s.exact);
                    s.kept_quantised.clone_from(&s.quantised);
                }
            }
            Step::Relu => {
                for v in samples.iter_mut().flat_map(|s| s.exact.iter_mut().chain(&mut s.quantised)) {
                    *v = if *v > 0.0 { *v } else { 0.0 };
                }
            }
            Step::Twice(width) => {
                for s in &mut samples {
                    for x in [&mut s.exact, &mut s.quantised] {
                        *x = x.chunks_exact(width).flat_map(|row| [row, row]).flatten().copied().collect();
                    }
                }
            }
            Step::Convolve(conv, geometry) => {
                progress(&conv.name);
                let wide = if core::ptr::eq(conv, &raw const decoder.output) { wide.min(conv.outputs) } else { 0 };
                layers.push(layer(conv, geometry, all(conv, wide), options, &mut samples, false));
            }
            Step::ConvolveAndAdd(conv) => {
                progress(&conv.name);
                layers.push(layer(conv, Geometry::POINT, all(conv, 0), options, &mut samples, true));
            }
        }
    }
    layers
}

/// Quantises one layer and runs all samples through it. With `add` the kept input of the residual block is added to the output, and the
/// layer is fitted to compensate also for the difference between the inputs that the exact and the quantised decoder kept.
fn layer(
    conv: &checkpoint::Conv1d,
    geometry: Geometry,
    wide: usize,
    options: &Options,
    samples: &mut [Sample],
    add: bool,
) -> QuantisedConv1d {
    let exact = Conv1d::<f32>::new(conv, geometry);
    for s in samples.iter_mut() {
        s.exact = exact.forward(&s.exact);
        if add {
            s.exact.iter_mut().zip(&s.kept_exact).for_each(|(y, x)| *y += x);
        }
    }
    let moments = (!samples.is_empty()).then(|| observe(conv, geometry, samples, add));
    let result = QuantisedConv1d::new(conv, (wide, 8), options, moments.as_ref());
    let quantised = Conv1d::<f32>::new(&result.dequantised(), geometry);
    for s in samples.iter_mut() {
        s.quantised = quantised.forward(&s.quantised);
        if add {
            s.quantised.iter_mut().zip(&s.kept_quantised).for_each(|(y, x)| *y += x);
        }
    }
    result
}

/// Moments of the layer's input in the quantised decoder, and of the output that would cancel all error so far.
fn observe(conv: &checkpoint::Conv1d, geometry: Geometry, samples: &[Sample], add: bool) -> Moments {
    let (inputs, outputs, kernel) = (conv.inputs, conv.outputs, conv.kernel);
    let mut moments = Moments::new(inputs * kernel, outputs);
    let rows: usize = samples.iter().map(|s| s.exact.len() / outputs).sum();
    let every = rows.div_ceil(MAX_OBSERVATIONS).max(1);
    let mut x = vec![0.0; inputs * kernel];
    let mut seen = 0;
    for s in samples {
        let frames = s.quantised.len() / inputs;
        for (t, y) in s.exact.chunks_exact(outputs).enumerate() {
            seen += 1;
            if seen % every != 0 {
                continue;
            }
            for k in 0..kernel {
                let source = (t * geometry.stride + k * geometry.dilation).checked_sub(geometry.left);
                let row = source.filter(|&f| f < frames).map(|f| &s.quantised[f * inputs..(f + 1) * inputs]);
                for i in 0..inputs {
                    x[i * kernel + k] = row.map_or(0.0, |row| f64::from(row[i]));
                }
            }
            let kept = if add { &s.kept_quantised[t * outputs..(t + 1) * outputs] } else { &[] };
            let wanted: Vec<f64> =
                y.iter().enumerate().map(|(o, &y)| f64::from(y) - kept.get(o).map_or(0.0, |&k| f64::from(k))).collect();
            moments.add(&x, &wanted);
        }
    }
    moments
}

/// The decoder that the integers stand for, to run in the reference.
#[must_use]
pub fn dequantised(decoder: &checkpoint::Decoder, layers: &[QuantisedConv1d]) -> checkpoint::Decoder {
    let mut result = decoder.clone();
    for (to, from) in result.convolutions_mut().into_iter().zip(layers) {
        *to = from.dequantised();
    }
    result
}
