//! What is to be made.

use crate::perception::anchors::Anchor;
use crate::refining::Config;

/// Where the motion comes from.
#[derive(Debug, Clone, Copy)]
pub enum Source<'r> {
    /// Motion tokens, `[L][Q]` for `Q` quantizers.
    Tokens(&'r [u16]),
    /// Token embeddings `u [L][du]`, as an earlier motion or a solver left them.
    Embeddings(&'r [f32]),
}

/// One motion to be made. Quantities are SI; the motion starts at the origin facing +z, anchors are in that frame.
#[derive(Debug, Clone, Copy)]
pub struct Request<'r> {
    /// Where the motion comes from.
    pub source: Source<'r>,
    /// Where it must pass. Empty: no refinement.
    pub anchors: &'r [Anchor],
    /// How it is bent there; `None` leaves the motion as it is.
    pub refinement: Option<Config>,
}

impl<'r> Request<'r> {
    /// The motion of `tokens`, without anchors.
    #[must_use]
    pub const fn tokens(tokens: &'r [u16]) -> Self {
        Request { source: Source::Tokens(tokens), anchors: &[], refinement: None }
    }

    /// The motion of embeddings `u`, without anchors.
    #[must_use]
    pub const fn embeddings(u: &'r [f32]) -> Self {
        Request { source: Source::Embeddings(u), anchors: &[], refinement: None }
    }

    /// The same, bent onto `anchors` with the default refinement.
    #[must_use]
    pub fn through(self, anchors: &'r [Anchor]) -> Self {
        Request { anchors, refinement: Some(Config::default()), ..self }
    }

    /// The same with another refinement.
    #[must_use]
    pub const fn refined(self, refinement: Config) -> Self {
        Request { refinement: Some(refinement), ..self }
    }
}
