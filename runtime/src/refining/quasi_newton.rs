//! The fast default: L-BFGS in the coefficients of the orthonormal interval basis.
//!
//! With `u = u0 + B x`, `B` orthonormal over each interval's tokens, `J` is minimised over `x [coefficients][width]`:
//!
//! ```text
//! g <- B^T dJ/du + 2 g_tr x
//! d <- -H g                    H: L-BFGS, initial inverse Hessian gamma diag(1 / (1 + lambda (1 - a_i) + 1e-4))
//! t <- 1                       without history: J / -(g . d), the residual-scaled (Polyak) step
//! while J(x + t d) > J(x) + 1e-4 t g . d: shrink t by quadratic interpolation
//! x <- x + t d
//! ```
//! The activities of the published method thus shape the metric: the ridge damps an update in an orthonormal basis by
//! exactly that diagonal. When no step in the basis decreases `J` any more, the tokens are moved directly, from where the
//! basis ended.

use super::activity::{Random, activities};
use super::config::Config;
use super::interval_basis::IntervalBasis;
use super::optimiser::lbfgs::{Lbfgs, MAX_MEMORY, history_len};
use super::report::{Ended, SolverError, StopReason, stopped};
use super::route_solver::{Point, Run};
use super::vector::{all_finite, axpy, clear, copy, dot, squared_distance};
use super::{MotionMap, Stop};

/// Fraction of the predicted decrease that a step must reach.
const SUFFICIENT: f32 = 1e-4;

/// Line-search trials before a direction is given up.
const TRIALS: usize = 6;

/// Share of `J` that a step must remove not to count as slow, and the slow steps in a row that end a descent.
const SLOW: f32 = 0.005;
const SLOW_STEPS: usize = 3;

/// Pairs that are remembered at least when the tokens are moved directly.
const DIRECT_MEMORY: usize = 2;

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

/// Numbers for `u0`, the token gradient, `x`, `g`, `d` and the history, in coefficients or directly on the tokens.
pub(super) const fn scratch_len(variable: usize, coefficients: usize, config: &Config) -> usize {
    let routed = 3 * coefficients + history_len(coefficients, memory(config));
    let direct = 3 * variable + history_len(variable, DIRECT_MEMORY);
    2 * variable + if routed > direct { routed } else { direct }
}

/// Minimises `J` from `u = origin`; leaves the best iterate in `u`.
pub(super) fn descend<M: MotionMap>(
    run: &mut Run<'_, M>,
    u: &mut [f32],
    origin: &[f32],
    basis: &mut IntervalBasis<'_>,
    scratch: &mut [f32],
) -> Ended {
    if run.spent() {
        return Ok(StopReason::Budget);
    }
    let mut point = match run.evaluate(u, 0.0) {
        Ok(Some(point)) => point,
        Ok(None) => return Err(SolverError::NotFinite),
        Err(stop) => return stopped(stop),
    };
    run.keep(point);
    let shortage = SolverError::Scratch { have: scratch.len(), need: u.len() };
    let Some((tokens, work)) = scratch.split_at_mut_checked(u.len()) else { return Err(shortage) };

    basis.orthonormalise();
    let mut random = Random::new(run.config.seed);
    let mut differentiated = false;
    loop {
        let Some(mut state) = State::new(work, basis, run.config, u, origin) else { return Err(shortage) };
        let ended = state.descend(run, u, origin, basis, tokens, &mut point, &mut differentiated, &mut random);
        state.place(u, origin, basis, 0.0, run.width());
        match ended {
            Ok(StopReason::Stalled) if !basis.is_direct() => basis.make_direct(),
            ended => return ended,
        }
    }
}

/// Variables of one descent: coefficients, gradient, direction, history.
struct State<'a> {
    /// `x [n]`.
    x: &'a mut [f32],
    /// `dJ/dx` at `x`.
    gradient: &'a mut [f32],
    direction: &'a mut [f32],
    history: Lbfgs<'a>,
}

impl<'a> State<'a> {
    /// Starts at `u`, which is `origin` when `basis` has functions; `None` when `work` is too short.
    fn new(work: &'a mut [f32], basis: &IntervalBasis<'_>, config: &Config, u: &[f32], origin: &[f32]) -> Option<Self> {
        let tokens = basis.tokens();
        let n = basis.coefficients() * u.len().checked_div(tokens).unwrap_or(0);
        let (x, work) = work.split_at_mut_checked(n)?;
        let (gradient, work) = work.split_at_mut_checked(n)?;
        let (direction, work) = work.split_at_mut_checked(n)?;
        let fitting = if n > 0 { work.len() / (2 * n) } else { 0 };
        let memory = if fitting < memory(config) { fitting } else { memory(config) };
        clear(x);
        if basis.is_direct() {
            copy(x, u);
            axpy(x, -1.0, origin);
        }
        Some(Self { x, gradient, direction, history: Lbfgs::new(work, n, memory) })
    }

    /// `u = u0 + B (x + t d)`.
    fn place(&self, u: &mut [f32], origin: &[f32], basis: &IntervalBasis<'_>, t: f32, width: usize) {
        copy(u, origin);
        basis.add_synthesis(self.x, t, self.direction, width, u);
    }

    /// `dJ/dx` from the token gradient; false when it is not finite.
    fn take_gradient(&mut self, tokens: &[f32], basis: &IntervalBasis<'_>, config: &Config, width: usize) -> bool {
        basis.analyse(tokens, width, self.gradient);
        axpy(self.gradient, 2.0 * config.trust, self.x);
        all_finite(self.gradient)
    }

    /// Descends until something ends it. `tokens` holds `dJ/du` of the point last differentiated.
    fn descend<M: MotionMap>(
        &mut self,
        run: &mut Run<'_, M>,
        u: &mut [f32],
        origin: &[f32],
        basis: &IntervalBasis<'_>,
        tokens: &mut [f32],
        point: &mut Point,
        differentiated: &mut bool,
        random: &mut Random,
    ) -> Ended {
        let (width, config, anchors) = (run.width(), run.config, run.objective.anchors);
        let mut slow = 0;
        loop {
            if run.satisfied(point) {
                return Ok(StopReason::Tolerance);
            }
            if run.spent() {
                return Ok(StopReason::Budget);
            }
            if !*differentiated {
                if let Err(stop) = run.gradient(tokens) {
                    return stopped(stop);
                }
                *differentiated = true;
            }
            if !self.take_gradient(tokens, basis, config, width) {
                return Ok(StopReason::Stalled);
            }
            self.history.complete(self.gradient);
            let activity = activities(config.activity, basis, anchors, &point.measured, &config.tolerance, random);
            let before = point.objective;
            let accepted = loop {
                copy(self.direction, self.gradient);
                self.history.direction(self.direction, |d, gamma| {
                    basis.damp(d, width, &activity, config.ridge, gamma);
                });
                match self.search(run, u, origin, basis, point) {
                    Ok(true) => break true,
                    Ok(false) if run.spent() || self.history.is_empty() => break false,
                    Ok(false) => self.history.reset(),
                    Err(stop) => return stopped(stop),
                }
            };
            if !accepted {
                return Ok(if run.spent() { StopReason::Budget } else { StopReason::Stalled });
            }
            *differentiated = false;
            slow = if before - point.objective < SLOW * before { slow + 1 } else { 0 };
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
    ) -> Result<bool, Stop> {
        let slope = dot(self.gradient, self.direction);
        // Not a descent direction, or not finite.
        if !(slope < 0.0) || !slope.is_finite() {
            return Ok(false);
        }
        let mut t = if self.history.is_empty() { point.objective / -slope } else { 1.0 };
        for _ in 0..TRIALS {
            if run.spent() || !t.is_finite() {
                return Ok(false);
            }
            self.place(u, origin, basis, t, run.width());
            let trial = run.evaluate(u, squared_distance(u, origin))?;
            t = match trial {
                Some(trial) if trial.objective <= point.objective + SUFFICIENT * t * slope => {
                    self.history.begin(self.direction, t, self.gradient);
                    axpy(self.x, t, self.direction);
                    *point = trial;
                    run.keep(trial);
                    return Ok(true);
                }
                Some(trial) => {
                    let curvature = trial.objective - point.objective - t * slope;
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
        Ok(false)
    }
}
