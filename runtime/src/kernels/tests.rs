//! Every variant that this machine can run, against the portable one.

use super::portable;
use crate::hash::Stream;
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

type Kernel = fn(&[i16], &[i8], usize, usize, &mut [i32]);

/// A variant and its two kernels.
struct Variant {
    name: String,
    linear: Kernel,
    transposed: Kernel,
}

fn variants() -> Vec<Variant> {
    let mut variants = vec![Variant {
        name: "chosen".into(),
        linear: super::linear_s16s8,
        transposed: super::linear_transposed_s16s8,
    }];
    #[cfg(target_arch = "x86_64")]
    {
        use super::x86::Isa;
        let all: [(Isa, Kernel, Kernel); 2] = [
            (
                Isa::Avx2,
                |x, w, k, n, acc| Isa::Avx2.linear_s16s8(x, w, k, n, acc),
                |g, w, k, n, acc| Isa::Avx2.linear_transposed_s16s8(g, w, k, n, acc),
            ),
            (
                Isa::Avx512,
                |x, w, k, n, acc| Isa::Avx512.linear_s16s8(x, w, k, n, acc),
                |g, w, k, n, acc| Isa::Avx512.linear_transposed_s16s8(g, w, k, n, acc),
            ),
        ];
        for (isa, linear, transposed) in all {
            if isa.supported() == isa {
                variants.push(Variant { name: format!("{isa:?}"), linear, transposed });
            }
        }
    }
    variants
}

/// How numbers are drawn.
#[derive(Debug, Clone, Copy)]
enum Values {
    Random,
    /// Only the ends of both ranges: sums wrap, which the specification does as well.
    Extreme,
}

fn draw(stream: &mut Stream, values: Values, count: usize) -> (Vec<i16>, Vec<i8>) {
    let mut numbers = || match values {
        Values::Random => stream.below(1 << 16) as i16,
        Values::Extreme => [i16::MIN, i16::MAX, -128, 0x7F][stream.below(4) as usize],
    };
    let x = (0..count).map(|_| numbers()).collect();
    let w = (0..count).map(|_| numbers() as i8).collect();
    (x, w)
}

/// Compares a kernel with the portable one on `rows` rows of `from`, giving rows of `to`, everything `skew` elements
/// off its alignment, and buffers that are `extra` longer or shorter than whole rows.
fn compare(name: &str, kernel: Kernel, portable: Kernel, shape: [usize; 3], from: usize, to: usize, values: Values) {
    let [rows, inputs, outputs] = shape;
    let mut stream = Stream::new((rows * 131 + inputs * 17 + outputs) as u64);
    for (skew, extra) in [(0usize, 0isize), (1, 1), (3, -1)] {
        let len = |whole: usize| skew + whole.saturating_add_signed(extra);
        let (x, w) = draw(&mut stream, values, len(rows * from).max(len(inputs * outputs)));
        let x = &x[skew..len(rows * from).max(skew)];
        let w = &w[skew..len(inputs * outputs).max(skew)];
        let mut want = vec![-77; len(rows * to) + skew];
        let mut got = want.clone();
        portable(x, w, inputs, outputs, &mut want[skew..]);
        kernel(x, w, inputs, outputs, &mut got[skew..]);
        assert_eq!(got, want, "{name}: {shape:?} {values:?}, {skew} off, {extra} more");
    }
}

#[test]
fn variants_agree_with_the_portable_kernels() {
    let sizes = [1, 2, 3, 4, 7, 15, 16, 17, 31, 32, 33, 50, 64, 65, 96, 97, 129];
    for variant in variants() {
        for rows in 0..=9 {
            for inputs in sizes {
                for outputs in sizes {
                    let shape = [rows, inputs, outputs];
                    for values in [Values::Random, Values::Extreme] {
                        let Variant { name, linear, transposed } = &variant;
                        compare(name, *linear, portable::linear_s16s8, shape, inputs, outputs, values);
                        let portable = portable::linear_transposed_s16s8;
                        compare(name, *transposed, portable, shape, outputs, inputs, values);
                    }
                }
            }
        }
    }
}

#[test]
fn widths_of_zero_do_nothing() {
    for variant in variants() {
        for (inputs, outputs) in [(0, 3), (3, 0), (0, 0)] {
            for kernel in [variant.linear, variant.transposed] {
                let mut acc = [-77; 9];
                kernel(&[1; 9], &[1; 9], inputs, outputs, &mut acc);
                assert_eq!(acc, [-77; 9], "{} {inputs} {outputs}", variant.name);
            }
        }
    }
}
