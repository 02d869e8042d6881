//! 95 % intervals by drawing again from what was measured (Efron 1979, percentile intervals).
//!
//! Why not a library: it is one loop over seeded draws, and those draws are part of the published tables.

use motionette_host::parallel;

use crate::random::Random;

/// Times the units are drawn again.
pub const REPLICATES: usize = 400;

/// Half the width of the interval that holds 95 % of the values `statistic` takes on `units` draws with replacement from
/// `0..units`.
pub fn half_width(units: usize, seed: u64, statistic: impl Fn(&[usize]) -> f64 + Sync) -> f64 {
    if units == 0 {
        return 0.0;
    }
    let replicates: Vec<u64> = (0..REPLICATES as u64).collect();
    let mut values = parallel::map(&replicates, |replicate| {
        let mut random = Random::new(seed, *replicate);
        let draws: Vec<usize> = (0..units).map(|_| random.below(units)).collect();
        statistic(&draws)
    });
    values.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let place = share * (values.len() - 1) as f64;
        let below = place.floor() as usize;
        let above = (below + 1).min(values.len() - 1);
        values[below] + (place - below as f64) * (values[above] - values[below])
    };
    0.5 * (at(0.975) - at(0.025))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Uniform numbers: the interval of their mean covers the true one in about 95 of 100 experiments, and has the width that the
    /// normal distribution gives.
    #[test]
    fn covers_a_known_mean() {
        let (units, trials) = (80, 300);
        let (mut covered, mut widths) = (0, 0.0);
        for trial in 0..trials {
            let mut random = Random::new(77, trial);
            let values: Vec<f64> = (0..units).map(|_| random.unit()).collect();
            let mean =
                |members: &mut dyn Iterator<Item = usize>| members.map(|i| values[i]).sum::<f64>() / units as f64;
            let half = half_width(units, trial, |draws| mean(&mut draws.iter().copied()));
            covered += usize::from((mean(&mut (0..units)) - 0.5).abs() <= half);
            widths += half / trials as f64;
        }
        // 0.95 less what 80 units cost; three standard deviations of 300 experiments are 0.04.
        let share = covered as f64 / trials as f64;
        assert!((0.90..=0.98).contains(&share), "{share}");
        let expected = 1.96 * (1.0 / 12.0 / units as f64).sqrt();
        assert!((widths / expected - 1.0).abs() < 0.05, "{widths} {expected}");
    }

    #[test]
    fn nothing_to_draw_from_and_nothing_to_vary() {
        assert_eq!(half_width(0, 1, |_| f64::NAN), 0.0);
        assert_eq!(half_width(9, 1, |_| 3.0), 0.0);
    }
}
