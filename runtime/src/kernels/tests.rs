//! Every variant that this machine can run, against the portable one.

use super::check::{Buffers, CHOSEN, Variant, run};
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
            transposed: |g, w, k, n, acc| Isa::Avx2.linear_transposed_s16s8(g, w, k, n, acc),
        };
        let avx512 = Variant {
            linear: |x, w, k, n, acc| Isa::Avx512.linear_s16s8(x, w, k, n, acc),
            transposed: |g, w, k, n, acc| Isa::Avx512.linear_transposed_s16s8(g, w, k, n, acc),
        };
        for (isa, variant) in [(Isa::Avx2, avx2), (Isa::Avx512, avx512)] {
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
        assert!(cases > 30_000);
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
    assert_eq!((mismatch.transposed, mismatch.shape), (false, [1, 16, 33]));
}
