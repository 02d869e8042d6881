//! Our own exponential and error function: without branches or tables, so that one loop serves every target and the compiler
//! computes as many at a time as a machine has lanes, always with the same operations in the same order.

/// `log2 e`.
const LOG2_E: f32 = core::f32::consts::LOG2_E;
/// Adding this to `|v| < 2^22` leaves the nearest integer in the low mantissa bits.
const ROUND: f32 = 12_582_912.0;
/// Below this the result is 0; the powers of two that remain are normal numbers.
const LEAST: f32 = -87.0;

/// `e^x` for finite `x <= 0`, at most 6e-6 off relatively (7e-7 for `x > -1`); 0 below -87.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let inside = if x < LEAST { LEAST } else { x };
    // e^x = 2^n 2^r, |r| <= 1/2, and a polynomial for 2^r that is 1 at 0.
    let power = inside * LOG2_E;
    let rounded = power + ROUND;
    let r = power - (rounded - ROUND);
    let y = 1.112_550_8e-3;
    let y = y * r + 9.666_283e-3;
    let y = y * r + 5.557_400_5e-2;
    let y = y * r + 2.402_235e-1;
    let y = y * r + 6.931_428e-1;
    let y = y * r + 1.0;
    // The low bits of `rounded` hold n; shifted to the exponent's place, everything above them falls off.
    let y = f32::from_bits(y.to_bits().wrapping_add(rounded.to_bits() << 23));
    if x < LEAST { 0.0 } else { y }
}

/// `x/2 (1 + erf(x / sqrt 2))`, at most 4e-7 `|x|` off (Abramowitz and Stegun, Handbook of Mathematical Functions, 7.1.26).
#[inline(always)]
pub fn gelu(x: f32) -> f32 {
    let z = f32::from_bits(x.to_bits() & 0x7FFF_FFFF) * core::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let y = 1.061_405_4;
    let y = y * t - 1.453_152;
    let y = y * t + 1.421_413_7;
    let y = y * t - 0.284_496_74;
    let y = y * t + 0.254_829_6;
    // Half of 1 - erf |z|, which is what negative numbers keep and positive ones lose.
    let tail = 0.5 * (y * t) * exp(-z * z);
    if x > 0.0 { x - x * tail } else { x * tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(from: f32, to: f32) -> impl Iterator<Item = f32> {
        (0..=200_000).map(move |i| from + (to - from) * (i as f32 / 200_000.0))
    }

    #[test]
    fn exp_is_as_close_as_it_says() {
        for (from, allowed) in [(-87.0, 6e-6), (-1.0, 7e-7)] {
            for x in numbers(from, 0.0) {
                let want = f64::from(x).exp();
                assert!((f64::from(exp(x)) / want - 1.0).abs() < allowed, "exp({x}) = {}", exp(x));
            }
        }
        assert_eq!(exp(0.0), 1.0);
        for x in [-87.1, -1e3, -1e30, f32::MIN, f32::NEG_INFINITY] {
            assert_eq!(exp(x), 0.0);
        }
    }

    #[test]
    fn gelu_is_as_close_as_it_says() {
        for x in numbers(-12.0, 12.0) {
            let wide = f64::from(x);
            let want = 0.5 * wide * (1.0 + libm::erf(wide * core::f64::consts::FRAC_1_SQRT_2));
            assert!((f64::from(gelu(x)) - want).abs() <= 4e-7 * wide.abs() + 1e-12, "gelu({x}) = {}", gelu(x));
        }
        for (x, want) in [(0.0, 0.0), (1e15, 1e15), (-1e15, 0.0)] {
            assert_eq!(gelu(x), want);
        }
    }
}
