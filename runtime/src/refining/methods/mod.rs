//! Entry point of refinement, the books of a solve, and the two ways to step.

mod published;
pub mod quasi_newton;

use crate::kernels;
use core::ops::ControlFlow;

use super::basis::{IntervalBasis, values_len};
use super::config::{Config, Method};
use super::metric::{Prior, ResidualMetric};
use super::report::{Report, SolverError, StopReason};
use super::terms::{Objective, Point};
use super::vector::{copy, squared_distance};
use super::{MotionMap, Stop};
use crate::memory::{Arena, ArenaTooSmall};
use crate::request::conditions::AnchorSet;

/// Most frames of a motion: anchors and intervals count them in 16 bits.
const MAX_FRAMES: usize = 1 << 16;

/// ProblemShape of a problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProblemShape {
    /// Tokens of the motion.
    pub tokens: usize,
    /// Numbers of a token embedding.
    pub width: usize,
    /// Distinct anchors.
    pub anchors: usize,
}

impl ProblemShape {
    /// Numbers of all embeddings.
    const fn variables(&self) -> usize {
        self.tokens.saturating_mul(self.width)
    }
}

/// What a solve works in, declared once.
struct Buffers<'s> {
    /// Function values of the basis.
    values: &'s mut [f32],
    /// `u0`.
    origin: &'s mut [f32],
    /// Of the method.
    steps: Steps<'s>,
}

enum Steps<'s> {
    Published(published::Buffers<'s>),
    QuasiNewton(quasi_newton::Buffers<'s>),
}

impl<'s> Buffers<'s> {
    fn take(arena: &mut Arena<'s>, shape: ProblemShape, config: &Config) -> Result<Self, ArenaTooSmall> {
        Ok(Buffers {
            values: arena.take(values_len(shape.tokens, config.basis))?,
            origin: arena.take(shape.variables())?,
            steps: match config.method {
                Method::Published => Steps::Published(published::Buffers::take(arena, shape)?),
                Method::QuasiNewton => Steps::QuasiNewton(quasi_newton::Buffers::take(arena, shape, config)?),
            },
        })
    }
}

/// Arena bytes that [`solve`] takes for a problem of this shape: exact, known before anything runs.
#[must_use]
pub fn scratch_bytes(shape: ProblemShape, config: &Config) -> usize {
    Arena::measure(|arena| Buffers::take(arena, shape, config))
}

/// Moves the token embeddings `u [tokens][width]` (in: `u0`) so that the motion of `map` meets `objective`, within
/// `config.evaluations` decoder evaluations, in [`scratch_bytes`] of `arena`. The best `u` found is left in `u`, also when the observer stops the work.
/// Unreachable anchors are approached as far as the budget allows; the report says what remains.
///
/// # Errors
/// [`SolverError`]; before the first evaluation unless aborted or not finite.
pub fn solve<M: MotionMap>(
    map: &mut M,
    u: &mut [f32],
    objective: &Objective<'_>,
    config: &Config,
    mut arena: Arena<'_>,
) -> Result<Report, SolverError> {
    let anchors = objective.anchors();
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
    let Buffers { values, origin, steps } =
        Buffers::take(&mut arena, ProblemShape { tokens, width, anchors: anchors.len() }, config)
            .map_err(SolverError::Arena)?;
    let mut run = Run::new(map, objective, config);
    if objective.is_empty() {
        return Ok(run.report(StopReason::NoAnchors, 0.0));
    }
    let mut basis = IntervalBasis::new(anchors, grid, config.basis, values);
    copy(origin, u);
    let reason = match steps {
        Steps::Published(buffers) => published::descend(&mut run, u, origin, &basis, buffers)?,
        Steps::QuasiNewton(buffers) => quasi_newton::descend(&mut run, u, origin, &mut basis, buffers)?,
    };
    let distance = kernels::sqrt(squared_distance(u, origin));
    Ok(run.report(reason, distance))
}

/// A solve in progress: the map, the objective and the books.
struct Run<'a, M> {
    map: &'a mut M,
    objective: &'a Objective<'a>,
    config: &'a Config,
    metric: Option<ResidualMetric<'a>>,
    evaluations: u16,
    gradients: u16,
    first: Option<Point>,
    best: Option<Point>,
    /// True when the map's last forward pass was at the best point.
    current: bool,
}

impl<'a, M: MotionMap> Run<'a, M> {
    fn new(map: &'a mut M, objective: &'a Objective<'a>, config: &'a Config) -> Self {
        let (first, best) = (None, None);
        Self { map, objective, config, metric: None, evaluations: 0, gradients: 0, first, best, current: false }
    }

    fn anchors(&self) -> &'a AnchorSet {
        self.objective.anchors()
    }

    fn width(&self) -> usize {
        self.map.width()
    }

    /// True when the budget of decoder evaluations is spent.
    fn spent(&self) -> bool {
        self.evaluations >= self.config.evaluations
    }

    /// One decoder evaluation at `u`, `moved` being `||u - u0||^2`. Not finite: `None`.
    fn evaluate(&mut self, u: &[f32], moved: f32) -> ControlFlow<Stop, Option<Point>> {
        self.evaluations = self.evaluations.saturating_add(1);
        self.current = false;
        self.map.forward(u)?;
        let point = self.measure(moved);
        let error = point.distances.control_error(self.anchors());
        if error.mean.is_finite() {
            self.map.measured(&error)?;
        }
        let finite = point.objective.is_finite() && point.descent.is_finite();
        ControlFlow::Continue(if finite { Some(point) } else { None })
    }

    /// The point of the last evaluation.
    fn measure(&self, moved: f32) -> Point {
        self.objective.measure(self.map, moved, self.metric.as_ref())
    }

    /// Builds the metric around the motion of the last evaluation, at `moved = ||u - u0||^2`, and returns that point under
    /// it; `None` when there is no metric to be had.
    fn adopt_metric(&mut self, prior: &Prior, numbers: &'a mut [f32], moved: f32) -> Option<Point> {
        self.metric = ResidualMetric::new(self.anchors(), self.map, prior, numbers);
        let point = self.measure(moved);
        if self.metric.is_some() && point.descent.is_finite() {
            return Some(point);
        }
        self.metric = None;
        None
    }

    /// Takes the point of the last evaluation for the best so far when none had a smaller `J`.
    fn consider(&mut self, point: Point) -> bool {
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

    /// Gradient with respect to u of what is descended, without the terms that act on u itself, at the point of the last evaluation.
    fn gradient(&mut self, du: &mut [f32]) -> ControlFlow<Stop> {
        self.gradients = self.gradients.saturating_add(1);
        self.objective.gather(self.map, self.metric.as_ref());
        self.map.backward(du)
    }

    /// True when there are anchors, and the best point, which is what a solve returns, is as near to each as it takes to end.
    fn satisfied(&self) -> bool {
        let worst = |best: Point| best.distances.control_error(self.anchors()).worst;
        !self.anchors().is_empty() && self.best.is_some_and(|best| worst(best) <= self.config.stop_error)
    }

    fn report(&self, reason: StopReason, distance: f32) -> Report {
        let error = |point: Point| point.distances.control_error(self.anchors());
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
            edited: None,
        }
    }
}
