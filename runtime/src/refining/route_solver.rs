//! RouteSolver: the entry point of refinement, and the method as published (AnchorRoute section 3.4, EQUATIONS 5).
//!
//! ```text
//! u <- u0
//! repeat n times:
//!     Delta <- AdamStep(u; J) - u
//!     a     <- activities of the intervals at D(u)
//!     u     <- u + P_{B,a}(Delta)
//! ```
//! Deviations: the best iterate by `J` is returned, not the last; the paper names no optimiser, Adam is ours.

use super::activity::{Random, activities};
use super::config::{Basis, Config, Method};
use super::interval_basis::{IntervalBasis, most_coefficients, values_len};
use super::objective::{Measured, Objective};
use super::optimiser::adam::Adam;
use super::report::{Ended, Report, SolverError, StopReason, stopped};
use super::residual_metric::{Prior, ResidualMetric, Residuals};
use super::vector::{all_finite, axpy, clear, copy, squared_distance};
use super::{MotionMap, Stop, quasi_newton};
use crate::perception::anchors::AnchorSet;

/// Most frames of a motion: anchors and intervals count them in 16 bits.
const MAX_FRAMES: usize = 1 << 16;

/// Numbers (`f32`) of scratch that [`solve`] uses for a motion of `tokens` tokens of `width` numbers and `anchors` distinct
/// anchors: exact, known before anything runs.
pub const fn scratch_len(tokens: usize, width: usize, anchors: usize, config: &Config) -> usize {
    let variable = tokens * width;
    match config.method {
        // Function values; u0, best u, gradient, and Adam's two moments.
        Method::Published => values_len(tokens, config.basis) + 5 * variable,
        Method::QuasiNewton => {
            let coefficients = most_coefficients(tokens, anchors, config.basis) * width;
            values_len(tokens, config.basis) + quasi_newton::scratch_len(variable, coefficients, anchors, config)
        }
    }
}

/// Moves the token embeddings `u [tokens][width]` (in: `u0`) so that the motion of `map` meets `anchors`, within
/// `config.evaluations` decoder evaluations. The best `u` found is left in `u`, also when the observer stops the work.
/// Unreachable anchors are approached as far as the budget allows; the report says what remains.
///
/// # Errors
/// [`SolverError`]; before the first evaluation unless aborted or not finite.
pub fn solve<M: MotionMap>(
    map: &mut M,
    u: &mut [f32],
    anchors: &AnchorSet,
    config: &Config,
    scratch: &mut [f32],
) -> Result<Report, SolverError> {
    let (grid, width) = (map.grid(), map.width());
    let (tokens, frames) = (grid.tokens, grid.frames());
    if frames == 0 || width == 0 || frames > MAX_FRAMES {
        let limit = MAX_FRAMES.checked_div(grid.frames_per_token).unwrap_or(0);
        return Err(SolverError::Tokens { tokens, limit });
    }
    if u.len() != tokens * width {
        return Err(SolverError::Shape { have: u.len(), need: tokens * width });
    }
    if let Some(frame) = anchors.last_frame()
        && frame as usize >= frames
    {
        return Err(SolverError::FrameOutOfRange { frame, frames });
    }
    let need = scratch_len(tokens, width, anchors.len(), config);
    let have = scratch.len();
    let too_short = SolverError::Scratch { have, need };
    let Some(scratch) = scratch.get_mut(..need) else { return Err(too_short) };
    // Results do not depend on what was here before, and the whole planned length is touched.
    clear(scratch);
    let Some((values, scratch)) = scratch.split_at_mut_checked(values_len(tokens, config.basis)) else {
        return Err(too_short);
    };

    let mut run = Run::new(map, anchors, config);
    if anchors.is_empty() {
        return Ok(run.report(StopReason::NoAnchors, 0.0));
    }
    let mut basis = IntervalBasis::new(anchors, grid, config.basis, values);
    let Some((origin, scratch)) = scratch.split_at_mut_checked(u.len()) else { return Err(too_short) };
    copy(origin, u);
    let reason = match config.method {
        Method::Published => published(&mut run, u, origin, &basis, scratch)?,
        Method::QuasiNewton => quasi_newton::descend(&mut run, u, origin, &mut basis, scratch)?,
    };
    let distance = libm::sqrtf(squared_distance(u, origin));
    Ok(run.report(reason, distance))
}

/// `J` and what it was made of at one point.
#[derive(Clone, Copy)]
pub(super) struct Point {
    /// `J(u)`, square metres.
    pub objective: f32,
    /// What is descended: `J(u)` with `r^T W r` for `L_anc` under a metric, `J(u)` without.
    pub descent: f32,
    /// Terms and errors.
    pub measured: Measured,
}

/// A solve in progress: the map, the objective and the books.
pub(super) struct Run<'a, M> {
    map: &'a mut M,
    pub objective: Objective<'a>,
    pub config: &'a Config,
    metric: Option<ResidualMetric<'a>>,
    evaluations: u16,
    gradients: u16,
    first: Option<Point>,
    best: Option<Point>,
    /// True when the map's last forward pass was at the best point.
    current: bool,
}

impl<'a, M: MotionMap> Run<'a, M> {
    fn new(map: &'a mut M, anchors: &'a AnchorSet, config: &'a Config) -> Self {
        let objective = Objective::new(anchors, config);
        Self {
            map,
            objective,
            config,
            metric: None,
            evaluations: 0,
            gradients: 0,
            first: None,
            best: None,
            current: false,
        }
    }

    pub fn width(&self) -> usize {
        self.map.width()
    }

    /// True when the budget of decoder evaluations is spent.
    pub fn spent(&self) -> bool {
        self.evaluations >= self.config.evaluations
    }

    /// One decoder evaluation at `u`, `squared` being `||u - u0||^2`. Not finite: `None`.
    pub fn evaluate(&mut self, u: &[f32], squared: f32) -> Result<Option<Point>, Stop> {
        self.evaluations = self.evaluations.saturating_add(1);
        self.current = false;
        self.map.forward(u)?;
        let point = self.measure(squared);
        Ok(if point.objective.is_finite() && point.descent.is_finite() { Some(point) } else { None })
    }

    /// The point of the last evaluation.
    fn measure(&self, squared: f32) -> Point {
        let measured = self.objective.measure(self.map);
        let rest = self.config.trust * squared;
        let objective = self.objective.weighted(&measured) + rest;
        let descent = match &self.metric {
            Some(metric) => {
                let mut residuals = Residuals::of(self.objective.anchors, self.map);
                let terms = Measured { anchors: metric.apply(&mut residuals), ..measured };
                self.objective.weighted(&terms) + rest
            }
            None => objective,
        };
        Point { objective, descent, measured }
    }

    /// Builds the metric around the motion of the last evaluation, at `squared = ||u - u0||^2`, and returns that point under
    /// it; `None` when there is no metric to be had.
    pub fn adopt_metric(&mut self, prior: &Prior, numbers: &'a mut [f32], squared: f32) -> Option<Point> {
        self.metric = ResidualMetric::new(self.objective.anchors, self.map, prior, numbers);
        let point = self.measure(squared);
        if self.metric.is_some() && point.descent.is_finite() {
            return Some(point);
        }
        self.metric = None;
        None
    }

    /// Takes the point of the last evaluation for the best so far when none had a smaller `J`.
    pub fn consider(&mut self, point: Point) -> bool {
        let better = self.best.is_none_or(|best| point.objective < best.objective);
        if better {
            self.best = Some(point);
            self.current = true;
        }
        if self.first.is_none() {
            self.first = Some(point);
        }
        better
    }

    /// Gradient with respect to u of what is descended, without the trust-region term, at the point of the last evaluation.
    pub fn gradient(&mut self, du: &mut [f32]) -> Result<(), Stop> {
        self.gradients = self.gradients.saturating_add(1);
        let mut dual = Residuals::of(self.objective.anchors, self.map);
        if let Some(metric) = &self.metric {
            metric.apply(&mut dual);
        }
        self.objective.gather_dual(self.map, &dual);
        self.map.backward(du)
    }

    /// True when every anchor of the best point, which is what a solve returns, is within the error at which it may end.
    pub fn satisfied(&self) -> bool {
        let worst = |best: Point| best.measured.control_error(self.objective.anchors).worst;
        self.best.is_some_and(|best| worst(best) <= self.config.stop_error)
    }

    fn report(&self, reason: StopReason, distance: f32) -> Report {
        let error = |point: Point| point.measured.control_error(self.objective.anchors);
        Report {
            evaluations: self.evaluations,
            gradients: self.gradients,
            before: self.first.map(error),
            after: self.best.map(error),
            objective_before: self.first.map_or(0.0, |point| point.objective),
            objective_after: self.best.map_or(0.0, |point| point.objective),
            distance,
            reason,
            current: self.current,
        }
    }
}

/// The published method on `scratch` of 4 variables: best `u`, gradient, two moments.
fn published<M: MotionMap>(
    run: &mut Run<'_, M>,
    u: &mut [f32],
    origin: &[f32],
    basis: &IntervalBasis<'_>,
    scratch: &mut [f32],
) -> Ended {
    let mut parts = super::vector::rows_mut(scratch, u.len());
    let (Some(best), Some(delta), Some(first), Some(second)) = (parts.next(), parts.next(), parts.next(), parts.next())
    else {
        return Err(SolverError::Scratch { have: 0, need: 4 * u.len() });
    };
    copy(best, u);
    let ended = adam_steps(run, u, origin, basis, best, delta, Adam::new(first, second));
    copy(u, best);
    ended
}

fn adam_steps<M: MotionMap>(
    run: &mut Run<'_, M>,
    u: &mut [f32],
    origin: &[f32],
    basis: &IntervalBasis<'_>,
    best: &mut [f32],
    delta: &mut [f32],
    mut adam: Adam<'_>,
) -> Ended {
    let (width, config) = (run.width(), run.config);
    let rate = config.learning_rate.smallest(run.objective.anchors);
    let mut random = Random::new(config.seed);
    if run.spent() {
        return Ok(StopReason::Budget);
    }
    loop {
        let point = match run.evaluate(u, squared_distance(u, origin)) {
            Ok(Some(point)) => point,
            Ok(None) if run.best.is_none() => return Err(SolverError::NotFinite),
            // The step is rejected; Adam's moments would only repeat it.
            Ok(None) => return Ok(StopReason::Stalled),
            Err(stop) => return stopped(stop),
        };
        if run.consider(point) {
            copy(best, u);
        }
        if run.satisfied() {
            return Ok(StopReason::Tolerance);
        }
        if run.spent() {
            return Ok(StopReason::Budget);
        }
        if let Err(stop) = run.gradient(delta) {
            return stopped(stop);
        }
        for ((g, x), x0) in delta.iter_mut().zip(u.iter()).zip(origin) {
            *g += 2.0 * config.trust * (x - x0);
        }
        if !all_finite(delta) {
            return Ok(StopReason::Stalled);
        }
        adam.step(delta, rate);
        if config.basis != Basis::Plain {
            let anchors = run.objective.anchors;
            let activity = activities(config.activity, basis, anchors, &point.measured, &config.tolerance, &mut random);
            basis.project(delta, width, &activity, config.ridge);
        }
        axpy(u, 1.0, delta);
    }
}
