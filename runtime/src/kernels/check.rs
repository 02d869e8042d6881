//! The one runner that compares kernels with the portable ones, on any machine: shapes and their remainders, extreme values,
//! odd addresses, buffers that are too long or too short.

use super::{portable, room};
use crate::blob::Aligned;
use crate::numerics::hash::Stream;

/// A kernel: rows, weights, inputs, outputs, accumulators.
pub type Kernel = fn(&[i16], &[i8], usize, usize, &mut [i32]);

/// The same with 4-bit weights.
pub type Kernel4 = fn(&[i16], &[u8], usize, usize, &mut [i32]);

/// Largest magnitude of a row.
pub type Largest = fn(&[f32]) -> u32;

/// Rounding of a row: numbers, factor, integers.
pub type Round = fn(&[f32], f32, &mut [i16]);

/// A square root.
pub type Root = fn(f32) -> f32;

/// A variant of all kernels.
#[derive(Debug, Clone, Copy)]
pub struct Variant {
    /// Of [`super::linear_s16s8`].
    pub linear: Kernel,
    /// Of [`super::linear_s16s4`].
    pub linear4: Kernel4,
    /// Of [`super::linear_transposed_s16s8`].
    pub transposed: Kernel,
    /// Of [`super::largest_magnitude`].
    pub largest: Largest,
    /// Of [`super::round_scaled`].
    pub round: Round,
    /// Of [`super::sqrt`].
    pub root: Root,
}

/// One of a variant's kernels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Which {
    /// [`Variant::linear`].
    Linear,
    /// [`Variant::linear4`].
    Linear4,
    /// [`Variant::transposed`].
    Transposed,
    /// [`Variant::largest`].
    Largest,
    /// [`Variant::round`].
    Round,
    /// [`Variant::root`]: the argument's bits are the first number of the shape.
    Root,
}

/// What this target runs.
pub const CHOSEN: Variant = Variant {
    linear: super::linear_s16s8,
    linear4: super::linear_s16s4,
    transposed: super::linear_transposed_s16s8,
    largest: super::largest_magnitude,
    round: super::round_scaled,
    root: super::sqrt,
};
/// The specification.
pub const PORTABLE: Variant = Variant {
    linear: portable::linear_s16s8,
    linear4: portable::linear_s16s4,
    transposed: portable::linear_transposed_s16s8,
    largest: portable::largest_magnitude,
    round: portable::round_scaled,
    root: portable::sqrt,
};

const ROWS: [usize; 12] = [0, 1, 2, 3, 4, 5, 7, 11, 12, 13, 16, 19];
const INPUTS: [usize; 20] = [0, 1, 2, 3, 4, 7, 8, 12, 15, 16, 17, 31, 32, 33, 36, 48, 64, 65, 96, 129];
const OUTPUTS: [usize; 10] = [0, 1, 2, 3, 4, 5, 8, 17, 33, 67];
const WIDEST: usize = 129;
/// Elements of a buffer that a case leaves before or behind.
const SLACK: usize = 4;
const LONGEST: usize = 19 * WIDEST + 2 * SLACK;
const HEAVIEST: usize = 67 * WIDEST + 2 * SLACK;
/// What accumulators hold before.
const UNTOUCHED: i32 = -77;

/// Memory of [`run`].
#[derive(Debug)]
pub struct Buffers {
    x: [i16; LONGEST],
    // Kernels may have a way of their own for weights on a boundary.
    w: Aligned<[i8; HEAVIEST]>,
    want: [i32; LONGEST + room(19, WIDEST)],
    got: [i32; LONGEST + room(19, WIDEST)],
}

impl Buffers {
    /// All zeros.
    #[must_use]
    pub const fn new() -> Self {
        Buffers {
            x: [0; LONGEST],
            w: Aligned([0; HEAVIEST]),
            want: [0; LONGEST + room(19, WIDEST)],
            got: [0; LONGEST + room(19, WIDEST)],
        }
    }
}

impl Default for Buffers {
    fn default() -> Self {
        Self::new()
    }
}

/// How numbers are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Values {
    /// All of their range.
    Random,
    /// Only the ends of both ranges: sums wrap, which the specification does as well.
    Extreme,
}

/// The case in which a variant differs from the portable kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mismatch {
    /// Which kernel.
    pub which: Which,
    /// Rows, inputs, outputs.
    pub shape: [usize; 3],
    /// How numbers were drawn.
    pub values: Values,
    /// Elements by which all buffers were off their alignment.
    pub skew: usize,
    /// Elements that the rows and the weights were longer than they need be; negative: shorter.
    pub extra: isize,
    /// Whether there was [`room`] behind the accumulators.
    pub roomy: bool,
}

/// Compares `variant` with the portable kernels; returns the number of cases.
///
/// # Errors
/// The first [`Mismatch`].
pub fn run(variant: &Variant, buffers: &mut Buffers) -> Result<u32, Mismatch> {
    let mut cases = 0;
    for (rows, inputs, outputs) in shapes() {
        for which in [Which::Linear, Which::Linear4, Which::Transposed] {
            for values in [Values::Random, Values::Extreme] {
                for (skew, extra, roomy) in [(0, 0, true), (1, 0, true), (3, 1, false), (0, -1, true)] {
                    let case = Mismatch { which, shape: [rows, inputs, outputs], values, skew, extra, roomy };
                    if !agrees(variant, &case, buffers) {
                        return Err(case);
                    }
                    cases += 1;
                }
            }
        }
    }
    for inputs in INPUTS {
        for values in [Values::Random, Values::Extreme] {
            for skew in 0..SLACK {
                let [largest, round] = [Which::Largest, Which::Round].map(|which| {
                    let shape = [1, inputs, 0];
                    Mismatch { which, shape, values, skew, extra: 0, roomy: false }
                });
                rounds_alike(variant, &largest, &round)?;
                cases += 2;
            }
        }
    }
    roots_alike(variant)?;
    Ok(cases + ROOTS)
}

/// Square roots that are compared.
const ROOTS: u32 = 4096;

/// Compares square roots of any numbers: of all exponents, both signs, infinite ones, of no number.
fn roots_alike(variant: &Variant) -> Result<(), Mismatch> {
    let mut stream = Stream::new(5);
    for case in 0..ROOTS {
        // A sixteenth has no bits below the exponent; all others, any.
        let fraction = if case % 16 == 0 { 0 } else { stream.below(1 << 23) };
        let sign = u32::from(stream.below(8) == 0);
        let bits = sign << 31 | (case % 256) << 23 | fraction;
        let [want, got] = [(PORTABLE.root)(f32::from_bits(bits)), (variant.root)(f32::from_bits(bits))];
        if want.to_bits() != got.to_bits() && !(want.is_nan() && got.is_nan()) {
            let shape = [bits as usize, 0, 0];
            return Err(Mismatch {
                which: Which::Root,
                shape,
                values: Values::Random,
                skew: 0,
                extra: 0,
                roomy: false,
            });
        }
    }
    Ok(())
}

/// Compares how a row is quantised: its largest magnitude, then its integers by that.
fn rounds_alike(variant: &Variant, largest: &Mismatch, round: &Mismatch) -> Result<(), Mismatch> {
    let ([_, count, _], lent) = (largest.shape, largest.skew..largest.skew + largest.shape[1]);
    let mut stream = Stream::new((7 * count + largest.skew) as u64);
    // Any finite number, or numbers of like size.
    let mut x = [0.0; WIDEST + SLACK];
    for x in &mut x {
        let exponent = match largest.values {
            Values::Random => 100 + stream.below(40),
            Values::Extreme => stream.below(255),
        };
        *x = f32::from_bits(stream.below(2) << 31 | exponent << 23 | stream.below(1 << 23));
    }
    let x = x.get(lent.clone()).unwrap_or(&[]);
    let magnitude = (PORTABLE.largest)(x);
    if (variant.largest)(x) != magnitude {
        return Err(*largest);
    }
    let top = f32::from_bits(magnitude >> 1);
    let factor = f32::from(i16::MAX) / if top > 1e-30 { top } else { 1.0 };
    let (mut want, mut got) = ([7; WIDEST + SLACK], [7; WIDEST + SLACK]);
    (PORTABLE.round)(x, factor, want.get_mut(lent.clone()).unwrap_or(&mut []));
    (variant.round)(x, factor, got.get_mut(lent).unwrap_or(&mut []));
    if want == got { Ok(()) } else { Err(*round) }
}

fn shapes() -> impl Iterator<Item = (usize, usize, usize)> {
    let each = |rows| INPUTS.into_iter().flat_map(move |k| OUTPUTS.into_iter().map(move |n| (rows, k, n)));
    ROWS.into_iter().flat_map(each)
}

/// True when the accumulators are those of the portable kernel.
fn agrees(variant: &Variant, case: &Mismatch, buffers: &mut Buffers) -> bool {
    let [rows, inputs, outputs] = case.shape;
    let (from, to) = if case.which == Which::Transposed { (outputs, inputs) } else { (inputs, outputs) };
    let mut stream = Stream::new((rows * 131 + inputs * 17 + outputs) as u64);
    let mut number = || match case.values {
        Values::Random => stream.below(1 << 16) as i16,
        Values::Extreme => [i16::MIN, i16::MAX, -128, 0x7F].get(stream.below(4) as usize).copied().unwrap_or(0),
    };
    let behind = if case.roomy { room(rows, from) } else { 0 };
    let lent = case.skew..case.skew + rows * to + behind;
    buffers.x.iter_mut().take(rows * from + SLACK).for_each(|x| *x = number());
    buffers.w.0.iter_mut().take(inputs * outputs + SLACK).for_each(|w| *w = number() as i8);
    for sums in [&mut buffers.want, &mut buffers.got] {
        sums.iter_mut().take(lent.end + SLACK).for_each(|sum| *sum = UNTOUCHED);
    }
    let part = |whole: usize| case.skew..case.skew + whole.saturating_add_signed(case.extra);
    let weights = if case.which == Which::Linear4 { inputs / 2 * outputs } else { inputs * outputs };
    let (Some(x), Some(w)) = (buffers.x.get(part(rows * from)), buffers.w.0.get(part(weights))) else {
        return false;
    };
    let (Some(want), Some(got)) = (buffers.want.get_mut(lent.clone()), buffers.got.get_mut(lent.clone())) else {
        return false;
    };
    for (variant, acc) in [(&PORTABLE, want), (variant, got)] {
        match case.which {
            Which::Largest | Which::Round | Which::Root => return false,
            Which::Linear => (variant.linear)(x, w, inputs, outputs, acc),
            Which::Linear4 => (variant.linear4)(x, bytemuck::cast_slice(w), inputs, outputs, acc),
            Which::Transposed => (variant.transposed)(x, w, inputs, outputs, acc),
        }
    }
    // A short row of x has no sums; what is behind the others belongs to the kernel.
    let whole = x.len().checked_div(from).unwrap_or(0).min(rows) * to;
    // Nothing may have changed before and behind what was lent.
    let outside = buffers.got.iter().take(lent.end + SLACK).enumerate();
    let intact = outside.into_iter().all(|(i, sum)| lent.contains(&i) || *sum == UNTOUCHED);
    let sums = case.skew..case.skew + whole;
    intact && buffers.want.get(sums.clone()) == buffers.got.get(sums)
}
