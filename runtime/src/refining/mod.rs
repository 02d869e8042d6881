//! The anchor solver: bends a generated motion onto its anchors by optimising its token embeddings (RouteSolver of
//! AnchorRoute, EQUATIONS section 5).
//!
//! This layer knows a differentiable road from token embeddings to joint positions, [`MotionMap`], and nothing of what
//! lies behind it. It owns no memory: [`solve`] works in an arena of [`scratch_bytes`].
//!
//! # Layers
//! - [`methods`]: entry point and the two ways to step: RouteSolver as published, and the fast default, L-BFGS.
//! - [`terms`]: the objective `J(u)`, a list of terms: anchors, smoothness, feasibility, trust region.
//! - [`metric`]: what integration does to the anchors' residuals, undone; the reason why few evaluations suffice.
//! - [`basis`]: anchor intervals on the token grid, ridge projection, orthonormal coefficients.
//! - [`activity`]: how much correction each interval may receive.
//! - [`map`], [`grid`]: what is asked of the decoder; tokens and their frames.
//! - [`optimiser`]: Adam and L-BFGS over plain slices, without knowledge of motion.
//! - [`config`], [`report`]: what goes in, what comes out.
//!
//! # Numerics
//! `f32`, single IEEE operations in the order written, sums from first to last element, square roots by `libm`. A trial
//! whose objective or gradient is not finite is rejected, so no NaN leaves the solver.

pub mod activity;
pub mod basis;
pub mod config;
pub mod grid;
pub mod map;
pub mod methods;
pub mod metric;
pub mod optimiser;
pub mod report;
pub mod terms;
#[cfg(test)]
mod tests;
mod vector;

pub use crate::stop::Stop;
pub use config::{Activity, Basis, Config, Method, PerFamily};
pub use grid::TokenGrid;
pub use map::MotionMap;
pub use methods::{ProblemShape, scratch_bytes, solve};
pub use metric::Prior;
pub use report::{ControlError, Report, SolverError, StopReason};
pub(crate) use terms::most_joints;
pub use terms::{Objective, Term};
