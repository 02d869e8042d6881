//! A layer in integers, as the blob stores it.

use motionette::kernels::GROUP;

use crate::checkpoint::Conv1d;

/// Largest weight of so many bits.
#[must_use]
pub const fn levels(bits: u8) -> i32 {
    (1 << (bits - 1)) - 1
}

/// Largest int16 weight: `256 hi + lo` with `hi` in -127..=127 reaches further, but symmetric ranges need no more.
pub const WIDE: i32 = 127 * 256;

/// A quantised convolution. `weight = value * scale[output]`.
#[derive(Debug, Clone, PartialEq)]
pub struct QuantisedConv1d {
    /// Name in the checkpoint.
    pub name: String,
    /// Output channels.
    pub outputs: usize,
    /// Input channels.
    pub inputs: usize,
    /// Taps.
    pub kernel: usize,
    /// Leading output channels in int16.
    pub wide: usize,
    /// Bits of the others, 8 or 4.
    pub bits: u8,
    /// `[outputs][inputs][kernel]`; the first `wide` rows within ±[`WIDE`], the others within ±[`levels`] of their bits.
    pub values: Vec<i32>,
    /// `[outputs]`, positive.
    pub scales: Vec<f32>,
    /// `[outputs]`
    pub bias: Vec<f32>,
}

impl QuantisedConv1d {
    /// The real weights that the integers stand for.
    #[must_use]
    pub fn dequantised(&self) -> Conv1d {
        let n = self.inputs * self.kernel;
        let weight = self
            .values
            .chunks_exact(n)
            .zip(&self.scales)
            .flat_map(|(row, &scale)| row.iter().map(move |&v| (f64::from(v) * f64::from(scale)) as f32))
            .collect();
        Conv1d {
            name: self.name.clone(),
            outputs: self.outputs,
            inputs: self.inputs,
            kernel: self.kernel,
            weight,
            bias: self.bias.clone(),
        }
    }

    /// Rows `from..to` as the blob wants them: `[kernel][rows][inputs]`.
    #[must_use]
    pub fn planes(&self, from: usize, to: usize) -> Vec<i32> {
        let n = self.inputs * self.kernel;
        let mut out = Vec::with_capacity((to - from) * n);
        for k in 0..self.kernel {
            for o in from..to {
                out.extend((0..self.inputs).map(|i| self.values[o * n + i * self.kernel + k]));
            }
        }
        out
    }
}

/// 4-bit weights in the packing of a blob, a multiple of [`GROUP`] of them.
#[must_use]
pub fn pack(weights: &[i32]) -> Vec<u8> {
    let half = |v: i32| (v + 8) as u8;
    let group = |g: &[i32]| {
        let (low, high) = g.split_at(GROUP / 2);
        low.iter().zip(high).map(|(&a, &b)| half(a) | half(b) << 4).collect::<Vec<_>>()
    };
    weights.chunks_exact(GROUP).flat_map(group).collect()
}

/// An int16 weight as two int8: `v = 256 hi + lo`, `hi` in -127..=127, `lo` in -128..=127.
#[must_use]
pub fn split(v: i32) -> (i8, i8) {
    let low = (v & 0xff) as u8 as i8;
    (((v - i32::from(low)) >> 8) as i8, low)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_hold_every_int16_weight() {
        for v in -WIDE..=WIDE {
            let (high, low) = split(v);
            assert!(high != i8::MIN);
            assert_eq!(256 * i32::from(high) + i32::from(low), v);
        }
    }

    #[test]
    fn packing_is_what_the_runtime_unpacks() {
        let weights: Vec<i32> = (0..3 * GROUP).map(|i| (i * 7 % 15) as i32 - 7).collect();
        let packed = pack(&weights);
        let groups = packed.as_chunks().0.iter();
        assert_eq!(groups.flat_map(motionette::kernels::unpacked).map(i32::from).collect::<Vec<_>>(), weights);
    }
}
