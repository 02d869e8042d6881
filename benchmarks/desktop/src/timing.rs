//! Paired timings: contenders run in turn, round after round, so that whatever else the machine does meets all of them alike.
//! What counts is the time that the process spends on a processor, on all its threads together: contenders compute on one thread,
//! and others who want that processor do not show.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use cpu_time::ProcessTime;

/// A sample is repeated until it takes this long.
const SAMPLE: Duration = Duration::from_millis(2);
/// Fewest rounds.
const ROUNDS: usize = 41;

/// Something that is timed.
pub struct Contender<'c> {
    /// Name in the report.
    pub name: &'static str,
    /// One run.
    pub run: Box<dyn FnMut() -> Result<()> + 'c>,
}

impl<'c> Contender<'c> {
    /// Names a run.
    pub fn new(name: &'static str, run: impl FnMut() -> Result<()> + 'c) -> Self {
        Self { name, run: Box::new(run) }
    }
}

/// Processor seconds a run, `[contender][round]`, of rounds that take `budget` on the clock together, [`ROUNDS`] at least.
///
/// # Errors
/// That of a run.
pub fn race(contenders: &mut [Contender<'_>], budget: Duration) -> Result<Vec<Vec<f64>>> {
    let mut repeats = Vec::new();
    for contender in contenders.iter_mut() {
        // The first run allocates and chooses kernels.
        (contender.run)()?;
        let fastest = (0..3).map(|_| time(contender, 1)).collect::<Result<Vec<_>>>()?;
        let fastest = fastest.into_iter().reduce(f64::min).context("nothing was timed")?;
        // A clock that stood still must not be divided by.
        let fastest = fastest.max(1e-6);
        repeats.push((SAMPLE.as_secs_f64() / fastest).ceil().max(1.0) as u32);
    }
    let mut seconds = vec![Vec::new(); contenders.len()];
    let start = Instant::now();
    for round in 0.. {
        if round >= ROUNDS && start.elapsed() >= budget {
            break;
        }
        for turn in 0..contenders.len() {
            // Forwards and backwards in turn, from another one every time: nobody always has the same predecessor.
            let i = (round / 2 + turn) % contenders.len();
            let i = if round % 2 == 0 { i } else { contenders.len() - 1 - i };
            seconds[i].push(time(&mut contenders[i], repeats[i])?);
        }
    }
    Ok(seconds)
}

fn time(contender: &mut Contender<'_>, repeats: u32) -> Result<f64> {
    let start = ProcessTime::try_now()?;
    for _ in 0..repeats {
        (contender.run)()?;
    }
    Ok(start.try_elapsed()?.as_secs_f64() / f64::from(repeats))
}

/// The value below which the share `p` of `values` lies, interpolated; NaN of none.
#[must_use]
pub fn quantile(values: &[f64], p: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let at = p.clamp(0.0, 1.0) * last as f64;
    let (below, above) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    below + (at - at.floor()) * (above - below)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile(&[0.0, 10.0], 0.025), 0.25);
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn every_contender_runs_once_a_round() -> Result<()> {
        for count in 1..6 {
            let mut contenders: Vec<Contender<'_>> = (0..count)
                .map(|_| {
                    Contender::new("busy", || {
                        std::hint::black_box((0..10_000u64).map(std::hint::black_box).sum::<u64>());
                        Ok(())
                    })
                })
                .collect();
            let seconds = race(&mut contenders, Duration::ZERO)?;
            assert!(seconds.iter().all(|s| s.len() == ROUNDS), "{count} contenders");
        }
        Ok(())
    }
}
