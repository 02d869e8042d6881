//! The fast default: L-BFGS in the coefficients of the orthonormal interval basis, under a metric of the residuals.
//!
//! With `u = u0 + B x`, `B` orthonormal over each interval's tokens, `f` is descended over `x [coefficients][width]`; f is `J`
//! with `r^T W r` for `L_anc` ([`ResidualMetric`](crate::refining::metric::ResidualMetric)), which has the same zeros:
//!
//! ```text
//! g <- B^T df/du + 2 g_tr x
//! d <- -H g                    H: L-BFGS, initial inverse Hessian gamma diag(1 / (1 + lambda (1 - a_i) + 1e-4))
//! t <- 1                       without history: f / -(g . d), the residual-scaled (Polyak) step
//! while f(x + t d) > f(x) + 1e-4 t g . d: shrink t by quadratic interpolation
//! x <- x + t d
//! ```
//! The activities of the published method thus shape the metric: the ridge damps an update in an orthonormal basis by
//! exactly that diagonal. The iterate with the smallest `J` itself is returned.

use core::ops::ControlFlow;

use super::super::activity::{Random, activities};
use super::super::basis::{IntervalBasis, most_coefficients};
use super::super::config::Config;
use super::super::metric::factor_len;
use super::super::optimiser::lbfgs::{Lbfgs, MAX_MEMORY};
use super::super::report::{Ended, SolverError, StopReason, stopped};
use super::super::terms::{Objective, Point};
use super::super::vector::{all_finite, axpy, copy, dot, squared_distance};
use super::super::{MotionMap, Stop};
use super::{ProblemShape, Run};
use crate::memory::{Arena, ArenaTooSmall};

/// Fraction of the predicted decrease that a step must reach.
const SUFFICIENT: f32 = 1e-4;

/// Line-search trials before a direction is given up.
const TRIALS: usize = 6;

/// Share of `f` that a step must remove not to count as slow, and the slow steps in a row that end a descent.
const SLOW: f32 = 0.005;
const SLOW_STEPS: usize = 3;

const fn memory(config: &Config) -> usize {
    let memory = config.memory as usize;
    if memory == 0 {
        1
    } else if memory > MAX_MEMORY {
        MAX_MEMORY
    } else {
        memory
    }
}

/// What the method works in.
pub(super) struct Buffers<'s> {
    /// Gradient with respect to the embeddings.
    tokens: &'s mut [f32],
    /// The metric's factor.
    metric: &'s mut [f32],
    /// `x`, the best `x`, gradient and direction: as many coefficients each as there may be.
    coefficients: [&'s mut [f32]; 4],
    /// Steps and changes of the history.
    history: [&'s mut [f32]; 2],
}

impl<'s> Buffers<'s> {
    pub(super) fn take(arena: &mut Arena<'s>, shape: ProblemShape, config: &Config) -> Result<Self, ArenaTooSmall> {
        let tokens = arena.take(shape.variables())?;
        let metric = arena.take(if config.prior.is_some() { factor_len(shape.anchors) } else { 0 })?;
        let n = most_coefficients(shape.tokens, shape.anchors, config.basis).saturating_mul(shape.width);
        let coefficients = [arena.take(n)?, arena.take(n)?, arena.take(n)?, arena.take(n)?];
        let pairs = n.saturating_mul(memory(config));
        Ok(Buffers { tokens, metric, coefficients, history: [arena.take(pairs)?, arena.take(pairs)?] })
    }
}

/// Descends from `u = origin`; leaves the best iterate by `J` in `u`.
pub(super) fn descend<'a, M: MotionMap>(
    run: &mut Run<'a, M>,
    u: &mut [f32],
    origin: &[f32],
    basis: &mut IntervalBasis<'_>,
    buffers: Buffers<'a>,
) -> Ended {
    let Buffers { tokens, metric, coefficients, history } = buffers;
    basis.orthonormalise();
    let n = basis.coefficients() * run.width();
    let mut state = State::new(coefficients, history, n, memory(run.config));

    if run.spent() {
        return Ok(StopReason::Budget);
    }
    let mut point = match run.evaluate(u, 0.0) {
        ControlFlow::Continue(Some(point)) => point,
        ControlFlow::Continue(None) => return Err(SolverError::NotFinite),
        ControlFlow::Break(stop) => return stopped(stop),
    };
    run.consider(point);
    if let Some(prior) = run.config.prior
        && let Some(under_metric) = run.adopt_metric(&prior, metric, 0.0)
    {
        point = under_metric;
    }
    let ended = state.descend(run, u, origin, basis, tokens, point);
    copy(state.x, state.best);
    state.place(u, origin, basis, 0.0, run.width());
    ended
}

/// Variables of one descent: coefficients, gradient, direction, history.
struct State<'a> {
    /// `x [n]`.
    x: &'a mut [f32],
    /// The `x` with the smallest `J`.
    best: &'a mut [f32],
    /// Gradient at `x` of what is descended.
    gradient: &'a mut [f32],
    direction: &'a mut [f32],
    history: Lbfgs<'a>,
}

impl<'a> State<'a> {
    /// Starts at `x = 0`.
    fn new(coefficients: [&'a mut [f32]; 4], [steps, changes]: [&'a mut [f32]; 2], n: usize, memory: usize) -> Self {
        let [x, best, gradient, direction] = coefficients;
        Self {
            x: part_mut!(x, ..n),
            best: part_mut!(best, ..n),
            gradient: part_mut!(gradient, ..n),
            direction: part_mut!(direction, ..n),
            history: Lbfgs::new(part_mut!(steps, ..n * memory), part_mut!(changes, ..n * memory), n, memory),
        }
    }

    /// `u = u0 + B (x + t d)`.
    fn place(&self, u: &mut [f32], origin: &[f32], basis: &IntervalBasis<'_>, t: f32, width: usize) {
        copy(u, origin);
        basis.add_synthesis(self.x, t, self.direction, width, u);
    }

    /// `dJ/dx` from the token gradient; false when it is not finite.
    fn take_gradient(
        &mut self,
        tokens: &[f32],
        basis: &IntervalBasis<'_>,
        objective: &Objective<'_>,
        width: usize,
    ) -> bool {
        basis.analyse(tokens, width, self.gradient);
        objective.add_direct(self.gradient, self.x.iter().copied());
        all_finite(self.gradient)
    }

    /// Descends from `point` until something ends it. `tokens` takes the gradient with respect to u.
    fn descend<M: MotionMap>(
        &mut self,
        run: &mut Run<'_, M>,
        u: &mut [f32],
        origin: &[f32],
        basis: &IntervalBasis<'_>,
        tokens: &mut [f32],
        start: Point,
    ) -> Ended {
        let (width, config, anchors) = (run.width(), run.config, run.anchors());
        let mut random = Random::new(config.seed);
        let mut point = start;
        let mut slow = 0;
        loop {
            if run.satisfied() {
                return Ok(StopReason::Tolerance);
            }
            if run.spent() {
                return Ok(StopReason::Budget);
            }
            if let ControlFlow::Break(stop) = run.gradient(tokens) {
                return stopped(stop);
            }
            if !self.take_gradient(tokens, basis, run.objective, width) {
                return Ok(StopReason::Stalled);
            }
            self.history.complete(self.gradient);
            let activity =
                activities(config.activity, basis, anchors, &point.distances, &config.tolerance, &mut random);
            let before = point.descent;
            let accepted = loop {
                copy(self.direction, self.gradient);
                self.history.direction(self.direction, |d, gamma| {
                    basis.damp(d, width, &activity, config.ridge, gamma);
                });
                match self.search(run, u, origin, basis, &mut point) {
                    ControlFlow::Continue(true) => break true,
                    ControlFlow::Continue(false) if run.spent() || self.history.is_empty() => break false,
                    ControlFlow::Continue(false) => self.history.reset(),
                    ControlFlow::Break(stop) => return stopped(stop),
                }
            };
            if !accepted {
                return Ok(if run.spent() { StopReason::Budget } else { StopReason::Stalled });
            }
            slow = if before - point.descent < SLOW * before { slow + 1 } else { 0 };
            if slow >= SLOW_STEPS {
                return Ok(StopReason::Stalled);
            }
        }
    }

    /// Backtracks along the direction; true when a step was taken, which then is the map's last evaluation.
    fn search<M: MotionMap>(
        &mut self,
        run: &mut Run<'_, M>,
        u: &mut [f32],
        origin: &[f32],
        basis: &IntervalBasis<'_>,
        point: &mut Point,
    ) -> ControlFlow<Stop, bool> {
        let slope = dot(self.gradient, self.direction);
        // Not a descent direction, or not finite.
        if !(slope < 0.0) || !slope.is_finite() {
            return ControlFlow::Continue(false);
        }
        let mut t = if self.history.is_empty() { point.descent / -slope } else { 1.0 };
        for _ in 0..TRIALS {
            if run.spent() || !t.is_finite() {
                return ControlFlow::Continue(false);
            }
            self.place(u, origin, basis, t, run.width());
            let trial = run.evaluate(u, squared_distance(u, origin))?;
            t = match trial {
                Some(trial) if trial.descent <= point.descent + SUFFICIENT * t * slope => {
                    self.history.begin(self.direction, t, self.gradient);
                    axpy(self.x, t, self.direction);
                    *point = trial;
                    if run.consider(trial) {
                        copy(self.best, self.x);
                    }
                    return ControlFlow::Continue(true);
                }
                Some(trial) => {
                    let curvature = trial.descent - point.descent - t * slope;
                    let best = -slope * t * t / (2.0 * curvature);
                    if best > 0.5 * t {
                        0.5 * t
                    } else if best > 0.1 * t {
                        best
                    } else {
                        0.1 * t
                    }
                }
                None => 0.1 * t,
            };
        }
        ControlFlow::Continue(false)
    }
}
