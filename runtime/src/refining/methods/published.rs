//! RouteSolver as published (AnchorRoute section 3.4, EQUATIONS 5).
//!
//! ```text
//! u <- u0
//! repeat n times:
//!     Delta <- AdamStep(u; J) - u
//!     a     <- activities of the intervals at D(u)
//!     u     <- u + P_{B,a}(Delta)
//! ```
//! Deviations: the best iterate by `J` is returned, not the last; the paper names no optimiser, Adam is ours.

use core::ops::ControlFlow;

use super::super::MotionMap;
use super::super::activity::{Random, activities};
use super::super::basis::IntervalBasis;
use super::super::config::Basis;
use super::super::optimiser::adam::Adam;
use super::super::report::{Ended, SolverError, StopReason, stopped};
use super::super::vector::{all_finite, axpy, copy, squared_distance};
use super::{ProblemShape, Run};
use crate::memory::{Arena, ArenaTooSmall};

/// What the method works in, as many numbers each as the embeddings have.
pub(super) struct Buffers<'s> {
    best: &'s mut [f32],
    /// Gradient, then step.
    delta: &'s mut [f32],
    first_moment: &'s mut [f32],
    second_moment: &'s mut [f32],
}

impl<'s> Buffers<'s> {
    pub(super) fn take(arena: &mut Arena<'s>, shape: ProblemShape) -> Result<Self, ArenaTooSmall> {
        let n = shape.variables();
        let [best, delta] = [arena.take(n)?, arena.take(n)?];
        Ok(Buffers { best, delta, first_moment: arena.take(n)?, second_moment: arena.take(n)? })
    }
}

/// Steps from `u = origin` on. Leaves the best iterate by `J` in `u`.
pub(super) fn descend<M: MotionMap>(
    run: &mut Run<'_, M>,
    u: &mut [f32],
    origin: &[f32],
    basis: &IntervalBasis<'_>,
    buffers: Buffers<'_>,
) -> Ended {
    let Buffers { best, delta, first_moment, second_moment } = buffers;
    copy(best, u);
    let ended = adam_steps(run, u, origin, basis, best, delta, Adam::new(first_moment, second_moment));
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
    let rate = config.learning_rate.smallest(run.anchors());
    let mut random = Random::new(config.seed);
    if run.spent() {
        return Ok(StopReason::Budget);
    }
    loop {
        let point = match run.evaluate(u, squared_distance(u, origin)) {
            ControlFlow::Continue(Some(point)) => point,
            ControlFlow::Continue(None) if run.best.is_none() => return Err(SolverError::NotFinite),
            // The step is rejected; Adam's moments would only repeat it.
            ControlFlow::Continue(None) => return Ok(StopReason::Stalled),
            ControlFlow::Break(stop) => return stopped(stop),
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
        if let ControlFlow::Break(stop) = run.gradient(delta) {
            return stopped(stop);
        }
        run.objective.add_direct(delta, u.iter().zip(origin).map(|(x, x0)| x - x0));
        if !all_finite(delta) {
            return Ok(StopReason::Stalled);
        }
        adam.step(delta, rate);
        if config.basis != Basis::Plain {
            let activity =
                activities(config.activity, basis, run.anchors(), &point.distances, &config.tolerance, &mut random);
            basis.project(delta, width, &activity, config.ridge);
        }
        axpy(u, 1.0, delta);
    }
}
