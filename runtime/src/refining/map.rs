//! What the solver needs of a decoder: a differentiable road from token embeddings to joint positions.

use core::ops::ControlFlow;

use super::grid::TokenGrid;
use super::report::ControlError;
use crate::stop::Stop;

/// The differentiable road from token embeddings `u [tokens][width]` to joint positions.
///
/// Implementors MUST keep what one [`forward`](Self::forward) computed until the next: [`position`](Self::position) and
/// [`backward`](Self::backward) refer to it. The solver never asks for a gradient before the first forward pass, and for no other
/// joints than the objective reads ([`Objective::joints`](super::Objective::joints)) and the root.
pub trait MotionMap {
    /// Token embeddings the map takes, and the frames that each becomes.
    fn grid(&self) -> TokenGrid;

    /// Numbers in one token embedding.
    fn width(&self) -> usize;

    /// Decodes `u [tokens][width]`: one decoder evaluation. Breaks off when the work is to end here; positions are then those of no
    /// motion and must not be used.
    fn forward(&mut self, u: &[f32]) -> ControlFlow<Stop>;

    /// Told how far the motion of the last forward pass is from the anchors, for whoever watches; not when that is no number. Breaks
    /// off when the work is to end here.
    fn measured(&mut self, error: &ControlError) -> ControlFlow<Stop> {
        let _ = error;
        ControlFlow::Continue(())
    }

    /// Position of `joint` (SMPL order) at `frame`, metres, of the last forward pass.
    fn position(&self, joint: u8, frame: usize) -> [f32; 3];

    /// Sets the gathered `dJ/dposition` to zero.
    fn clear_gradient(&mut self);

    /// Adds `d` to `dJ/dposition` of `joint` at `frame`.
    fn add_gradient(&mut self, joint: u8, frame: usize, d: [f32; 3]);

    /// Writes `dJ/du [tokens][width]` of the gathered gradient at the point of the last forward pass. Breaks off when the work is to end
    /// here; `du` is then unspecified.
    fn backward(&mut self, du: &mut [f32]) -> ControlFlow<Stop>;
}
