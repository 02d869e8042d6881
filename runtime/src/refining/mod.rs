//! Two ways to bring a generated motion onto its anchors: bending its token embeddings through the decoder (RouteSolver of AnchorRoute,
//! EQUATIONS section 5), and editing the joints behind it ([`motion_space`]). One, the other or both, as [`Config`] says.
//!
//! The first knows a differentiable road from token embeddings to joint positions, [`MotionMap`], and nothing of what
//! lies behind it. It owns no memory: [`solve`] works in an arena of [`scratch_bytes`].
//!
//! # Layers
//! - `motion_space`: the edit behind the decoder, without a gradient.
//! - `methods`: entry point and the two ways to step: RouteSolver as published, and the fast default, L-BFGS.
//! - `terms`: the objective `J(u)`, a list of terms: anchors, smoothness, feasibility, trust region.
//! - `metric`: what integration does to the anchors' residuals, undone; the reason why few evaluations suffice.
//! - `basis`: anchor intervals on the token grid, ridge projection, orthonormal coefficients.
//! - `activity`: how much correction each interval may receive.
//! - `map`, `grid`: what is asked of the decoder; tokens and their frames.
//! - `optimiser`: Adam and L-BFGS over plain slices, without knowledge of motion.
//! - `config`, `report`: what goes in, what comes out.
//!
//! # Numerics
//! `f32`, single IEEE operations in the order written, sums from first to last element, square roots by `libm`. A trial
//! whose objective or gradient is not finite is rejected, so no NaN leaves the solver.

#[doc(hidden)]
pub mod activity;
#[doc(hidden)]
pub mod basis;
#[doc(hidden)]
pub mod config;
#[doc(hidden)]
pub mod grid;
#[doc(hidden)]
pub mod map;
#[doc(hidden)]
pub mod methods;
#[doc(hidden)]
pub mod metric;
#[doc(hidden)]
pub mod motion_space;
#[doc(hidden)]
pub mod optimiser;
#[doc(hidden)]
pub mod report;
#[doc(hidden)]
pub mod terms;
#[cfg(test)]
mod tests;
mod vector;

#[doc(hidden)]
pub use crate::stop::Stop;
pub use config::{Activity, Basis, Config, Method, PerFamily};
#[doc(hidden)]
pub use grid::TokenGrid;
#[doc(hidden)]
pub use map::MotionMap;
#[doc(hidden)]
pub use methods::{ProblemShape, scratch_bytes, solve};
pub use metric::Prior;
pub use motion_space::{Clearance, Edited, Exact, Followed, Strain, TrackingError};
pub use report::{ControlError, Report, SolverError, StopReason};
pub(crate) use terms::most_joints;
#[doc(hidden)]
pub use terms::{Objective, Term};
