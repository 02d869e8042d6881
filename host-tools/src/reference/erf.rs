//! The error function, from its derivatives at points of a table.
//!
//! `erf(x0 + h) = erf(x0) + 2 / sqrt(pi) exp(-x0^2) sum_k (-1)^k H_k(x0) h^(k+1) / (k+1)!` with Hermite's polynomials
//! `H_0 = 1, H_1 = 2 x, H_(k+1) = 2 x H_k - 2 k H_(k-1)` (Abramowitz and Stegun, 7.1.19). With points 1/16 apart and nine terms
//! what is left out is below 1e-13.

use std::sync::LazyLock;

/// Points a unit.
const PER_UNIT: f64 = 16.0;
/// From here on erf is 1 in double precision.
const END: f64 = 6.0;
/// Terms of the series.
const TERMS: usize = 9;

/// `erf` and its derivative at the points `k / PER_UNIT`.
static POINTS: LazyLock<Vec<(f64, f64)>> = LazyLock::new(|| {
    (0..=(END * PER_UNIT) as usize)
        .map(|k| {
            let x = k as f64 / PER_UNIT;
            (series(x), core::f64::consts::FRAC_2_SQRT_PI * (-x * x).exp())
        })
        .collect()
});

/// `erf(x) = 2 / sqrt(pi) exp(-x^2) sum_n 2^n x^(2n+1) / (1 3 ... (2n+1))`: all terms positive, so nothing cancels.
fn series(x: f64) -> f64 {
    let (mut sum, mut term, mut n) = (0.0, x, 0.0);
    while term > sum * 1e-18 {
        sum += term;
        n += 1.0;
        term *= 2.0 * x * x / (2.0 * n + 1.0);
    }
    core::f64::consts::FRAC_2_SQRT_PI * (-x * x).exp() * sum
}

/// `2 / sqrt(pi)` times the integral of `exp(-s^2)` from 0 to `x`.
#[must_use]
pub fn erf(x: f64) -> f64 {
    let size = x.abs();
    // Also the way out for NaN.
    if !(size < END) {
        return if x.is_nan() { x } else { 1.0_f64.copysign(x) };
    }
    let k = (size * PER_UNIT).round();
    let (value, slope) = POINTS[k as usize];
    let x0 = k / PER_UNIT;
    let h = size - x0;
    let (mut before, mut hermite) = (0.0, 1.0);
    let (mut sum, mut factor) = (0.0, h);
    for k in 0..TERMS {
        sum += hermite * factor;
        (before, hermite) = (hermite, 2.0 * x0 * hermite - 2.0 * k as f64 * before);
        factor *= -h / (k as f64 + 2.0);
    }
    (value + slope * sum).copysign(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_integral() {
        // Simpson's rule, 2000 steps to each place.
        for i in 0..=130 {
            let x = 0.05 * f64::from(i) - 0.013;
            let (steps, f) = (2000, |s: f64| (-s * s).exp());
            let h = x / f64::from(steps);
            let inner: f64 = (1..steps).map(|n| f(f64::from(n) * h) * if n % 2 == 1 { 4.0 } else { 2.0 }).sum();
            let expected = core::f64::consts::FRAC_2_SQRT_PI * h / 3.0 * (f(0.0) + inner + f(x));
            assert!((erf(x) - expected).abs() < 2e-12, "{x}: {} {expected}", erf(x));
            assert_eq!(erf(-x), -erf(x));
        }
        assert_eq!((erf(7.0), erf(f64::NEG_INFINITY), erf(0.0)), (1.0, -1.0, 0.0));
        assert!(erf(f64::NAN).is_nan());
    }
}
