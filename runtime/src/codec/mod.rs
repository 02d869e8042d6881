//! Motion tokens to features: codebooks, decoders, and the gradient back to the embeddings.
//!
//! [`Decode`] is the seam for another decoder: refinement and pipeline work through it.

pub mod codebook;
pub mod vq;

use crate::channels::Channels;
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;

/// Token embeddings `u [L][du]` to normalised features `[T][C]` of the channels that are wanted, differentiably; `T` is `L` times
/// [`Decode::frames_per_token`].
pub trait Decode {
    /// Its buffers; between [`Decode::forward`] and [`Decode::backward`] they hold what the gradient needs.
    type Workspace<'w>;

    /// Numbers of a token embedding, `du`.
    fn code_width(&self) -> usize;

    /// Frames that a token becomes.
    fn frames_per_token(&self) -> usize;

    /// Decodes `u [L][du]` to `out [T][C]`. Breaks off when `check` says so; `out` is then undefined.
    fn forward(
        &self,
        u: &[f32],
        channels: &Channels,
        out: &mut [f32],
        work: &mut Self::Workspace<'_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop>;

    /// Carries `g = dJ/d(features) [T][C]` of the last [`Decode::forward`] back to `du = dJ/du [L][du]`, with the workspace of that
    /// pass. Breaks off when `check` says so; `du` is then undefined.
    fn backward(
        &self,
        g: &[f32],
        channels: &Channels,
        du: &mut [f32],
        work: &mut Self::Workspace<'_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop>;
}
