//! One convolution to integers.

use nalgebra::{Cholesky, DMatrix, DVectorViewMut};

use crate::blob::QuantisedConv1d;
use crate::blob::layer::{WIDE, levels};
use crate::checkpoint::Conv1d;

use super::moments::Moments;
use super::rounding::{Metric, Rounding, round_row};

/// How a layer is quantised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Rounding of int8 rows. (int16 rows are always rounded to nearest.)
    pub rounding: Rounding,
    /// Let every layer make up for what the layers before it lost: its weights are refitted to the unquantised output.
    pub refit: bool,
    /// Correct biases so that the mean output stays.
    pub bias_correction: bool,
    /// Ridge of the covariance, as a share of its mean diagonal.
    pub ridge: f64,
    /// Layers of the planner's blocks whose weights have four bits. The text encoder, the planner's first and last linear, its tables and the
    /// anchor control keep 8; so do linears whose inputs do not come in whole groups of [`motionette::kernels::GROUP`].
    pub four_bits: FourBits,
    /// All weights of the decoder have 16 bits, those of its hidden layers too: twice the work and the bytes, for models that were never
    /// meant for 8.
    pub wide_layers: bool,
    /// Those of a published planner likewise, but for [`Options::four_bits`].
    pub wide_planner: bool,
}

/// Which layers of the planner's blocks have weights of four bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FourBits(u8);

impl FourBits {
    /// Names of the layers, as a checkpoint has them behind the number of the block.
    pub const LAYERS: [&str; 7] =
        ["attention.qkv", "attention.out", "cross.q", "cross.kv", "cross.out", "ffn.in", "ffn.out"];
    /// None.
    pub const NONE: Self = Self(0);
    /// All of them.
    pub const ALL: Self = Self((1 << Self::LAYERS.len()) - 1);

    /// The same with a layer of that name; `None` where no layer has it.
    #[must_use]
    pub fn with(self, name: &str) -> Option<Self> {
        Self::LAYERS.iter().position(|layer| *layer == name).map(|place| Self(self.0 | 1 << place))
    }

    /// Their names.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::LAYERS.into_iter().enumerate().filter(move |(place, _)| self.0 >> place & 1 == 1).map(|(_, name)| name)
    }

    /// Bits of a linear of the planner by its name in a checkpoint.
    #[must_use]
    pub fn of(self, name: &str) -> u8 {
        let layer = name.strip_prefix("planner.layers.").and_then(|name| Some(name.split_once('.')?.1));
        if layer.is_some_and(|layer| self.names().any(|name| name == layer)) { 4 } else { 8 }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            rounding: Rounding::Feedback,
            refit: true,
            bias_correction: true,
            ridge: 0.03,
            four_bits: FourBits::NONE,
            wide_layers: false,
            wide_planner: false,
        }
    }
}

impl Options {
    /// Plain rounding to nearest, nothing corrected: what everything else is measured against.
    pub const PLAIN: Self = Self {
        rounding: Rounding::Nearest,
        refit: false,
        bias_correction: false,
        ridge: 0.0,
        four_bits: FourBits::NONE,
        wide_layers: false,
        wide_planner: false,
    };

    /// Whether captioned motions are of use.
    #[must_use]
    pub fn calibrates_planner(&self) -> bool {
        self.four_bits != FourBits::NONE && self.needs_calibration()
    }

    /// Whether calibration data is of use.
    #[must_use]
    pub fn needs_calibration(&self) -> bool {
        self.rounding != Rounding::Nearest || self.refit || self.bias_correction
    }
}

impl QuantisedConv1d {
    /// Quantises `source`, all but the first `wide` rows with so many bits; `moments` are those of its input (`[inputs][kernel]` order) and of the output wanted, where known.
    #[must_use]
    pub fn new(source: &Conv1d, (wide, bits): (usize, u8), options: &Options, moments: Option<&Moments>) -> Self {
        let n = source.inputs * source.kernel;
        let mut weights: Vec<f64> = source.weight.iter().map(|&w| f64::from(w)).collect();
        let mut bias: Vec<f64> = source.bias.iter().map(|&b| f64::from(b)).collect();
        let covariance = moments.filter(|m| m.count() > 0).map(Moments::covariance);
        let mut metric = None;
        if let Some(c) = &covariance {
            let ridge = options.ridge * (0..n).map(|i| c.xx[i * n + i]).sum::<f64>() / n as f64 + f64::MIN_POSITIVE;
            let mut cost = c.xx.clone();
            for i in 0..n {
                cost[i * n + i] += ridge;
            }
            if options.refit
                && let Some(factor) = Cholesky::new(DMatrix::from_row_slice(n, n, &cost))
            {
                // (C_yx + ridge W) (C_xx + ridge I)^-1: least squares that stays near the trained weights.
                for (row, yx) in weights.chunks_exact_mut(n).zip(c.yx.chunks_exact(n)) {
                    for (w, yx) in row.iter_mut().zip(yx) {
                        *w = *w * ridge + yx;
                    }
                    factor.solve_mut(&mut DVectorViewMut::from_slice(row, n));
                }
            }
            metric = Metric::new(&cost, n);
        }
        let mut values = Vec::with_capacity(weights.len());
        let mut scales = Vec::with_capacity(source.outputs);
        for (o, row) in weights.chunks_exact(n).enumerate() {
            let rounded = if o < wide {
                round_row(row, WIDE, Rounding::Nearest, None)
            } else {
                round_row(row, levels(bits), options.rounding, metric.as_ref())
            };
            // A refit is a fit around the means: the bias belongs to it.
            if (options.bias_correction || options.refit)
                && let Some(c) = &covariance
            {
                let product: f64 =
                    rounded.values.iter().zip(&c.x).map(|(&v, x)| f64::from(v) * rounded.scale * x).sum();
                bias[o] = c.y[o] - product;
            }
            values.extend(rounded.values);
            scales.push(rounded.scale as f32);
        }
        Self {
            name: source.name.clone(),
            outputs: source.outputs,
            inputs: source.inputs,
            kernel: source.kernel,
            wide,
            bits,
            values,
            scales,
            bias: bias.iter().map(|&b| b as f32).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layout_and_round_trip() {
        let source = Conv1d {
            name: "c".into(),
            outputs: 3,
            inputs: 2,
            kernel: 3,
            weight: (0..18).map(|i| (i as f32 - 8.5) / 10.0).collect(),
            bias: vec![0.5, -0.25, 0.0],
        };
        let q = QuantisedConv1d::new(&source, (1, 8), &Options::PLAIN, None);
        let back = q.dequantised();
        assert_eq!(back.bias, source.bias);
        for (i, (a, b)) in back.weight.iter().zip(&source.weight).enumerate() {
            let step = q.scales[i / 6];
            assert!((a - b).abs() <= 0.5001 * step, "{i}");
        }
        assert!(q.scales[0] * 50.0 < q.scales[1], "the first row is wide");
        // [kernel][rows][inputs] of row 1..3: first tap of row 1, inputs 0 and 1, ...
        let p = q.planes(1, 3);
        assert_eq!(p[..4], [q.values[6], q.values[9], q.values[12], q.values[15]]);
        assert_eq!(p.len(), 12);
    }

    #[test]
    fn bias_correction_keeps_the_mean() {
        let source = Conv1d {
            name: "c".into(),
            outputs: 2,
            inputs: 3,
            kernel: 1,
            weight: vec![0.31, -0.72, 0.111, 0.05, 0.9, -0.33],
            bias: vec![0.1, 0.2],
        };
        let mut moments = Moments::new(3, 2);
        for t in 0..50 {
            let x = [1.0 + (t % 7) as f64, (t % 3) as f64, (t % 5) as f64 - 4.0];
            let y: Vec<f64> = (0..2)
                .map(|o| {
                    (0..3).map(|i| f64::from(source.weight[o * 3 + i]) * x[i]).sum::<f64>() + f64::from(source.bias[o])
                })
                .collect();
            moments.add(&x, &y);
        }
        let options = Options { bias_correction: true, ridge: 0.01, ..Options::PLAIN };
        let back = QuantisedConv1d::new(&source, (0, 8), &options, Some(&moments)).dequantised();
        let c = moments.covariance();
        for o in 0..2 {
            let mean: f64 =
                (0..3).map(|i| f64::from(back.weight[o * 3 + i]) * c.x[i]).sum::<f64>() + f64::from(back.bias[o]);
            assert!((mean - c.y[o]).abs() < 1e-6);
        }
    }
}
