//! The anchor solver: bends a generated motion onto its anchors by optimising its token embeddings (RouteSolver of
//! AnchorRoute, EQUATIONS section 5).
//!
//! This layer knows a differentiable road from token embeddings to joint positions, [`MotionMap`], and nothing of what
//! lies behind it. It owns no memory: [`solve`] works in one slice of [`scratch_len`] numbers.
//!
//! # Layers
//! - [`route_solver`]: entry point; RouteSolver as published, `u <- u + P(Adam step)`, and the last steps both methods share.
//! - [`quasi_newton`]: the fast default, L-BFGS in the coefficients of the interval basis.
//! - [`objective`]: `J(u)`, its gradient with respect to joint positions, control errors.
//! - [`residual_metric`]: what integration does to the anchors' residuals, undone; the reason why few evaluations suffice.
//! - [`grid`]: tokens and their frames.
//! - [`interval_basis`]: anchor intervals on the token grid, ridge projection, orthonormal coefficients.
//! - [`activity`]: how much correction each interval may receive.
//! - [`optimiser`]: Adam and L-BFGS over plain slices, without knowledge of motion.
//! - [`config`], [`report`]: what goes in, what comes out.
//!
//! # Numerics
//! `f32`, single IEEE operations in the order written, sums from first to last element, square roots by `libm`. A trial
//! whose objective or gradient is not finite is rejected, so no NaN leaves the solver.

pub mod activity;
pub mod config;
pub mod grid;
pub mod interval_basis;
pub mod objective;
pub mod optimiser;
pub mod quasi_newton;
pub mod report;
pub mod residual_metric;
pub mod route_solver;
mod vector;

pub use config::{Activity, Basis, Config, Method, PerFamily};
pub use grid::TokenGrid;
pub use report::{ControlError, Report, SolverError, StopReason};
pub use residual_metric::Prior;
pub use route_solver::{scratch_len, solve};

/// Wish of whoever watches the work, delivered through a [`MotionMap`] in the middle of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stop {
    /// Stop at once; the result is not wanted. [`solve`] returns [`SolverError::Aborted`].
    Abort,
    /// Stop at once and return the best so far.
    Finish,
}

/// The differentiable road from token embeddings `u [tokens][width]` to joint positions.
///
/// Implementors MUST keep what one [`forward`](Self::forward) computed until the next: [`position`](Self::position) and
/// [`backward`](Self::backward) refer to it. The solver never asks for a gradient before the first forward pass.
pub trait MotionMap {
    /// Token embeddings the map takes, and the frames that each becomes.
    fn grid(&self) -> TokenGrid;

    /// Numbers in one token embedding.
    fn width(&self) -> usize;

    /// Decodes `u [tokens][width]`: one decoder evaluation.
    ///
    /// # Errors
    /// [`Stop`] when the work is to end here; positions are then those of no motion and must not be used.
    fn forward(&mut self, u: &[f32]) -> Result<(), Stop>;

    /// Position of `joint` (SMPL order) at `frame`, metres, of the last forward pass.
    fn position(&self, joint: u8, frame: usize) -> [f32; 3];

    /// Sets the gathered `dJ/dposition` to zero.
    fn clear_gradient(&mut self);

    /// Adds `d` to `dJ/dposition` of `joint` at `frame`.
    fn add_gradient(&mut self, joint: u8, frame: usize, d: [f32; 3]);

    /// Writes `dJ/du [tokens][width]` of the gathered gradient at the point of the last forward pass.
    ///
    /// # Errors
    /// [`Stop`] when the work is to end here; `du` is then unspecified.
    fn backward(&mut self, du: &mut [f32]) -> Result<(), Stop>;
}
