//! Every variant that this machine can run, against the portable one.

use super::check::{Buffers, CHOSEN, Kernel, Variant, Which, run};
use std::boxed::Box;
use std::string::String;
use std::vec::Vec;

fn variants() -> Vec<(String, Variant)> {
    let mut variants: Vec<(String, Variant)> = std::vec![("chosen".into(), CHOSEN)];
    #[cfg(target_arch = "x86_64")]
    {
        use super::x86::Isa;
        let avx2 = Variant {
            linear: |x, w, k, n, acc| Isa::Avx2.linear_s16s8(x, w, k, n, acc),
            linear4: |x, w, k, n, acc| Isa::Avx2.linear_s16s4(x, w, k, n, acc),
            transposed: |g, w, k, n, acc| Isa::Avx2.linear_transposed_s16s8(g, w, k, n, acc),
            ..CHOSEN
        };
        let avx512 = Variant {
            linear: |x, w, k, n, acc| Isa::Avx512.linear_s16s8(x, w, k, n, acc),
            linear4: |x, w, k, n, acc| Isa::Avx512.linear_s16s4(x, w, k, n, acc),
            transposed: |g, w, k, n, acc| Isa::Avx512.linear_transposed_s16s8(g, w, k, n, acc),
            ..CHOSEN
        };
        let vnni = Variant {
            linear: |x, w, k, n, acc| Isa::AvxVnni.linear_s16s8(x, w, k, n, acc),
            linear4: |x, w, k, n, acc| Isa::AvxVnni.linear_s16s4(x, w, k, n, acc),
            transposed: |g, w, k, n, acc| Isa::AvxVnni.linear_transposed_s16s8(g, w, k, n, acc),
            ..CHOSEN
        };
        for (isa, variant) in [(Isa::Avx2, avx2), (Isa::AvxVnni, vnni), (Isa::Avx512, avx512)] {
            if isa.supported() == isa {
                variants.push((std::format!("{isa:?}"), variant));
            }
        }
    }
    variants
}

#[test]
fn variants_agree_with_the_portable_kernels() {
    let mut buffers = Box::new(Buffers::new());
    for (name, variant) in variants() {
        let cases = run(&variant, &mut buffers).unwrap_or_else(|mismatch| panic!("{name}: {mismatch:?}"));
        assert!(cases > 50_000);
    }
}

/// Longer sums than the runner's, up to where a variant has no more room for them and beyond.
#[test]
fn variants_agree_on_long_sums() {
    let mut stream = crate::numerics::hash::Stream::new(5);
    for (rows, terms) in [
        (4, 34),
        (5, 66),
        (7, 98),
        (8, 98),
        (9, 126),
        (12, 130),
        (23, 190),
        (24, 192),
        (8, 254),
        (11, 256),
        (13, 258),
        (24, 512),
    ] {
        for sums in [1, 15, 16, 49, 96] {
            let x: Vec<i16> = (0..rows * terms).map(|_| stream.below(1 << 16) as i16).collect();
            let w: Vec<i8> = (0..sums * terms).map(|_| stream.below(1 << 8) as i8).collect();
            let acc = std::vec![3; rows * sums + super::room(rows, terms)];
            for (name, variant) in variants() {
                let kernels: [(Kernel, Kernel, usize, usize); 2] = [
                    (variant.linear, super::portable::linear_s16s8, terms, sums),
                    (variant.transposed, super::portable::linear_transposed_s16s8, sums, terms),
                ];
                for (kernel, portable, inputs, outputs) in kernels {
                    let (mut got, mut want) = (acc.clone(), acc.clone());
                    kernel(&x, &w, inputs, outputs, &mut got);
                    portable(&x, &w, inputs, outputs, &mut want);
                    assert_eq!(
                        got[..rows * sums],
                        want[..rows * sums],
                        "{name}: {rows} rows, {terms} terms, {sums} sums"
                    );
                }
            }
        }
    }
}

/// Weights in -7..=7 are those of the int8 kernel in another packing, whatever the width.
#[test]
fn four_bits_are_packed_as_they_are_said_to_be() {
    let (inputs, outputs) = (48, 5);
    let weight = |n: usize, k: usize| ((n * 31 + k * 7) % 15) as i8 - 7;
    let plain: Vec<i8> = (0..outputs * inputs).map(|i| weight(i / inputs, i % inputs)).collect();
    let byte = |i: usize| {
        let (n, k) = (i / (inputs / 2), i % (inputs / 2) / 8 * 16 + i % 8);
        (weight(n, k) + 8) as u8 | ((weight(n, k + 8) + 8) as u8) << 4
    };
    let packed: Vec<u8> = (0..outputs * inputs / 2).map(byte).collect();
    let x: Vec<i16> = (0..3 * inputs).map(|i| (i * 7919 % 60_001) as i16).collect();
    let (mut want, mut got) = ([0; 15], [1; 15]);
    super::linear_s16s8(&x, &plain, inputs, outputs, &mut want);
    super::portable::linear_s16s4(&x, &packed, inputs, outputs, &mut got);
    assert_eq!(want, got);
}

#[test]
fn relu_of_a_word_agrees_with_the_portable_one() {
    let odd = [0.0, -0.0, f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-45, -1e-45, 3.5, -3.5];
    for first in 0..odd.len() {
        let x: [f32; 32] = core::array::from_fn(|i| odd[(first + i * i) % odd.len()]);
        let (mut want, mut got) = (x, x);
        assert_eq!(super::relu_word(&mut got), super::portable::relu(&mut want));
        assert_eq!(got.map(f32::to_bits), want.map(f32::to_bits));
        assert_eq!(got, x.map(|v| if v > 0.0 { v } else { 0.0 }));
    }
}

/// A kernel that forgets one product is found.
#[test]
fn the_runner_finds_a_wrong_kernel() {
    let wrong = Variant {
        linear: |x, w, k, n, acc| {
            super::linear_s16s8(x, w, k, n, acc);
            if let (33, 16, Some(sum)) = (n, k, acc.get_mut(20)) {
                *sum = sum.wrapping_sub(1);
            }
        },
        ..CHOSEN
    };
    let mismatch = run(&wrong, &mut Box::new(Buffers::new())).expect_err("it differs");
    assert_eq!((mismatch.which, mismatch.shape), (Which::Linear, [1, 16, 33]));
    let truncating =
        Variant { round: |x, factor, q| q.iter_mut().zip(x).for_each(|(q, x)| *q = (x * factor) as i16), ..CHOSEN };
    let mismatch = run(&truncating, &mut Box::new(Buffers::new())).expect_err("it differs");
    assert_eq!(mismatch.which, Which::Round);
}
