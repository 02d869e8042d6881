//! Does the quantised planner propose what the f32 reference proposes?
//!
//! Both receive the same corrupted tokens `z_t` of real clips, at the same times and with the clip's caption. Compared is the most probable
//! token of every position, so that one evaluation is measured and not the random choices of a whole sampling run; how far two runs of
//! ten steps drift apart is reported separately. The same with anchors on the clips' own motion, of all families in turn.

use std::ops::ControlFlow;

use motionette::ROWS;
use motionette::Request;
use motionette::generation::tokens::{Fixed, Length, Planning, PlanningLimits, Session};
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::request::conditions::AnchorSet;
use motionette::request::prompt::Prompt;
use serde::Serialize;

use super::Error;
use crate::blob::BlobFile;
use crate::checkpoint::{ControlCheckpoint, PriorCheckpoint, TokenizerCheckpoint};
use crate::dataset::captioned::{CaptionedMotion, Place};
use crate::reference::Prior;
use crate::reference::bridge::runtime_anchors;
use crate::reference::tmd::Settings;
pub use crate::reference::transformer::first_largest as most_probable;

/// Times at which planners are compared.
pub const TIMES: [f64; 3] = [0.25, 0.5, 0.75];
/// Share of positions at which both must find the same token most probable.
pub const AGREEMENT_BUDGET: f64 = 0.98;

/// Agreement at one time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AtTime {
    /// The time.
    pub time: f64,
    /// Share of positions with the same most probable token.
    pub top1: f64,
    /// Mean Kullback-Leibler divergence of the other's distribution from the reference's, nats.
    pub divergence: f64,
}

/// Agreement of a planner with the reference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// Clips.
    pub clips: usize,
    /// Positions compared, of all times.
    pub positions: usize,
    /// Share of positions with the same most probable token, of all times.
    pub top1: f64,
    /// By time.
    pub times: Vec<AtTime>,
}

/// The planner against its budget.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Runtime against reference.
    pub runtime: Agreement,
    /// The runtime's weights in the reference's arithmetic against the reference.
    pub weights: Agreement,
    /// Share of equal tokens when both sample whole motions with the same random numbers and the runtime's defaults.
    pub free_running: f64,
    /// Least [`Agreement::top1`] of the runtime that is allowed.
    pub budget: f64,
    /// Whether it is kept.
    pub met: bool,
}

/// Compares the runtime's planner in `blob` with the reference of `prior`, and of its `control` if the cases have anchors. `progress` is
/// called three times a case.
///
/// # Errors
/// [`Error`].
pub fn verify(
    blob: &BlobFile,
    tokenizer: &TokenizerCheckpoint,
    prior: &PriorCheckpoint,
    control: Option<&ControlCheckpoint>,
    cases: &[CaptionedMotion],
    progress: impl Fn() + Sync,
) -> Result<Report, Error> {
    super::check_same_prior(blob, prior)?;
    let mut exact = Prior::<f32>::new(prior, tokenizer);
    let mut rounded = Prior::<f32>::new(&blob.dequantised_prior(prior)?, tokenizer);
    if let Some(control) = control {
        super::check_same_control(blob, control)?;
        exact = exact.controlled(control, tokenizer.config.fps);
        rounded = rounded.controlled(&blob.dequantised_control(control)?, tokenizer.config.fps);
    }
    let runtime = agreement(cases, &exact, |case, z, time| logits(blob, case, z, time), &progress)?;
    let rounded = |case: &CaptionedMotion, z: &[u16], time: f64| -> Result<Vec<f32>, Error> {
        Ok(rounded.logits(&case.guided(&rounded, 1.0), z, time, &[]))
    };
    let weights = agreement(cases, &exact, rounded, &progress)?;
    let planning = blob.model()?.default_planning();
    let settings = Settings { steps: usize::from(planning.steps), ..Settings::default() };
    let tokens = |case: &CaptionedMotion, settings: &Settings| -> Result<Vec<u16>, Error> {
        let length = Length::Tokens(case.tokens.len() as u16);
        let request = Request::text(&case.prompt).planned(Planning { length, seed: settings.seed, ..planning });
        // Seen by the planner, and nothing else: tokens are compared.
        Ok(super::run(blob, &case.id, &request.anchors(&runtime_anchors(&case.anchors)))?.tokens)
    };
    let free_running = free_running(cases, &exact, planning.guidance, &settings, tokens, &progress)?;
    let met = runtime.top1 >= AGREEMENT_BUDGET;
    Ok(Report { runtime, weights, free_running, budget: AGREEMENT_BUDGET, met })
}

/// The runtime's logits `[L][V]` for a case, its tokens corrupted and the time.
///
/// # Errors
/// [`Error::Blob`], [`Error::NoPlanner`], [`Error::Prompt`], [`Error::Anchors`].
pub fn logits(blob: &BlobFile, case: &CaptionedMotion, tokens: &[u16], time: f64) -> Result<Vec<f32>, Error> {
    let model = blob.model()?;
    let modules = model.planning().ok_or(Error::NoPlanner)?;
    let refused = |source| Error::Prompt { clip: case.id.clone(), source };
    let prompt = Prompt::Text(&case.prompt);
    let Place { given, start_open, end_open } = case.place;
    let fixed = tokens.iter().take(given).zip(0..).map(|(&token, position)| Fixed { position, token });
    let fixed: Vec<Fixed> = fixed.collect();
    let planning = Planning { guidance: 1.0, fixed: &fixed, start_open, end_open, ..Planning::default() };
    let words = modules.text.rows(&prompt).map_err(refused)?;
    let refused_anchors = |source| Error::Anchors { clip: case.id.clone(), source };
    let frames = tokens.len() * model.frames_per_token();
    let anchors = AnchorSet::new(&runtime_anchors(&case.anchors), frames).map_err(refused_anchors)?;
    let limits =
        PlanningLimits { words, steps: 1, guided: planning.guided(), anchors: !anchors.is_empty(), clauses: 1 };
    let mut memory = vec![0_u128; modules.bytes(tokens.len(), &limits, ROWS).all().div_ceil(16)];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
    let mut session = Session::new(modules, &mut arena, tokens.len(), &limits, ROWS).map_err(Error::Arena)?;
    let mut go_on = || ControlFlow::Continue(());
    // Nothing interrupts it.
    let _ = session.read(&prompt, &mut go_on).map_err(refused)?;
    let _ = session.anchor(&anchors, tokens.len(), &mut go_on);
    let _ = session.pass(tokens, time as f32, &planning, &mut go_on);
    Ok((0..tokens.len()).flat_map(|i| session.logits(i).to_vec()).collect())
}

/// Compares `logits` (`[L][V]`, for a case, its tokens corrupted and the time) with those of `exact`. `progress` is called once a case.
///
/// # Errors
/// What `logits` fails with.
pub fn agreement<E: Send>(
    cases: &[CaptionedMotion],
    exact: &Prior<f32>,
    logits: impl Fn(&CaptionedMotion, &[u16], f64) -> Result<Vec<f32>, E> + Sync,
    progress: impl Fn() + Sync,
) -> Result<Agreement, E> {
    let numbered: Vec<(usize, &CaptionedMotion)> = cases.iter().enumerate().collect();
    let sums = crate::parallel::map(&numbered, |&(seed, case)| -> Result<_, E> {
        let guided = case.guided(exact, 1.0);
        let mut stream = Stream::new(seed as u64);
        let mut sums = [(0_usize, 0.0); TIMES.len()];
        for (sum, time) in sums.iter_mut().zip(TIMES) {
            let z = exact.sampler.corrupt(&case.tokens, time, &mut stream);
            let (a, b) = (exact.logits(&guided, &z, time, &[]), logits(case, &z, time)?);
            let rows = a.chunks_exact(exact.planner.codes).zip(b.chunks_exact(exact.planner.codes));
            for (a, b) in rows {
                sum.0 += usize::from(most_probable(a) == most_probable(b));
                sum.1 += divergence(a, b);
            }
        }
        progress();
        Ok(sums)
    });
    let positions: usize = cases.iter().map(|c| c.tokens.len()).sum();
    let share = 1.0 / positions.max(1) as f64;
    let mut times = TIMES.map(|time| AtTime { time, top1: 0.0, divergence: 0.0 });
    for sums in sums {
        for (to, (same, divergence)) in times.iter_mut().zip(sums?) {
            to.top1 += share * same as f64;
            to.divergence += share * divergence;
        }
    }
    let top1 = times.iter().map(|t| t.top1).sum::<f64>() / TIMES.len() as f64;
    Ok(Agreement { clips: cases.len(), positions: TIMES.len() * positions, top1, times: times.into() })
}

/// Share of equal tokens when both sample whole motions of the same lengths with the same random numbers; `tokens` gives the other's.
///
/// # Errors
/// What `tokens` fails with.
pub fn free_running<E: Send>(
    cases: &[CaptionedMotion],
    exact: &Prior<f32>,
    guidance: f32,
    settings: &Settings,
    tokens: impl Fn(&CaptionedMotion, &Settings) -> Result<Vec<u16>, E> + Sync,
    progress: impl Fn() + Sync,
) -> Result<f64, E> {
    let numbered: Vec<(usize, &CaptionedMotion)> = cases.iter().enumerate().collect();
    let same = crate::parallel::map(&numbered, |&(seed, case)| -> Result<usize, E> {
        let settings = Settings { seed: seed as u64, ..settings.clone() };
        let own = exact.sample(&case.guided(exact, guidance), case.tokens.len(), &settings).pop().unwrap_or_default();
        let other = tokens(case, &settings)?;
        progress();
        Ok(own.iter().zip(&other).filter(|(a, b)| a == b).count())
    });
    let same: usize = same.into_iter().sum::<Result<usize, E>>()?;
    Ok(same as f64 / cases.iter().map(|c| c.tokens.len()).sum::<usize>().max(1) as f64)
}

/// `sum_i p_i (ln p_i - ln q_i)` of the softmaxes of two rows of logits.
fn divergence(p: &[f32], q: &[f32]) -> f64 {
    let log_sum = |x: &[f32]| {
        let largest = x.iter().fold(f64::NEG_INFINITY, |m, &v| m.max(f64::from(v)));
        largest + x.iter().map(|&v| (f64::from(v) - largest).exp()).sum::<f64>().ln()
    };
    let (p_sum, q_sum) = (log_sum(p), log_sum(q));
    p.iter()
        .zip(q)
        .map(|(&p, &q)| {
            let p = f64::from(p) - p_sum;
            p.exp() * (p - (f64::from(q) - q_sum))
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn divergence_of_known_distributions() {
        // (1/2, 1/2) from (1/4, 3/4): ln 2 / 2 + ln(2/3) / 2.
        let (p, q) = ([1.0, 1.0], [0.0, 3.0_f32.ln()]);
        assert!((divergence(&p, &q) - 0.5 * (2.0_f64.ln() + (2.0_f64 / 3.0).ln())).abs() < 1e-7);
        assert!(divergence(&q, &[5.0, 5.0 + 3.0_f32.ln()]).abs() < 1e-7);
        assert_eq!(most_probable(&[0.5, 2.0, 2.0, -1.0]), 1);
    }
}
