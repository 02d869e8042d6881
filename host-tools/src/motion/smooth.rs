//! Gaussian filter along time, as HumanML3D applies to facing directions.

/// Filters `[T][3]` along time with a Gaussian of standard deviation `sigma` frames.
///
/// `y[t] = sum_k w[k] x[clamp(t + k, 0, T-1)]`, `w[k] ~ exp(-k^2 / 2 sigma^2)` normalised over `|k| <= round(4 sigma)`: SciPy's
/// `gaussian_filter1d` with `mode='nearest'` and its default truncation.
pub fn gaussian(x: &[[f64; 3]], sigma: f64) -> Vec<[f64; 3]> {
    let radius = (4.0 * sigma + 0.5) as isize;
    let mut weights: Vec<f64> = (-radius..=radius).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    let last = x.len() as isize - 1;
    (0..=last)
        .map(|t| {
            let mut y = [0.0; 3];
            for (k, w) in (-radius..=radius).zip(&weights) {
                let sample = x[(t + k).clamp(0, last) as usize];
                for c in 0..3 {
                    y[c] += w * sample[c];
                }
            }
            y
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_stay_and_an_impulse_becomes_the_bell() {
        let flat = gaussian(&[[1.0, -2.0, 3.0]; 9], 20.0);
        assert!(
            flat.iter().all(|y| (y[0] - 1.0).abs() < 1e-12 && (y[1] + 2.0).abs() < 1e-12 && (y[2] - 3.0).abs() < 1e-12)
        );
        let mut impulse = vec![[0.0; 3]; 41];
        impulse[20] = [1.0, 0.0, 0.0];
        let bell = gaussian(&impulse, 2.0);
        // Ratio of neighbouring samples of a Gaussian: exp(-(2k+1) / 2 sigma^2).
        for k in 0..7 {
            let ratio = bell[20 + k + 1][0] / bell[20 + k][0];
            assert!((ratio - (-(2.0 * k as f64 + 1.0) / 8.0).exp()).abs() < 1e-12);
        }
        assert_eq!(bell[20 + 9][0], 0.0, "cut at four standard deviations");
    }
}
