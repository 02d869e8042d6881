//! Body motion: the skeleton, features to joints with the gradient back (EQUATIONS section 1), and bodies of rigid bones.
//!
//! [`Recover`] is the seam for another representation: refinement works through it.

pub mod humanml3d;
pub mod limbs;
pub mod posture;
pub mod rigid;
pub mod skeleton;

use crate::channels::Channels;

/// Joint positions of one frame, metres.
pub type Pose = [[f32; 3]; crate::JOINTS];

/// Normalised features of some channels, as a codec makes them.
#[derive(Debug, Clone, Copy)]
pub struct Features<'a> {
    /// `[T][C]`
    pub values: &'a [f32],
    /// The `C` channels.
    pub channels: &'a Channels,
}

/// Features to joint positions, differentiably.
///
/// What a position depends on beyond its frame's own features, a path integrated over time, is computed once by [`Recover::integrate`] and
/// kept by the caller, with its gradient.
pub trait Recover {
    /// What is integrated over the motion, and its gradient.
    type Path<'w>;

    /// The channels that positions of the joints whose bit is set in `joints` depend on.
    fn channels(&self, joints: u32) -> Channels;

    /// Fills `path` from all frames.
    fn integrate(&self, features: Features<'_>, path: &mut Self::Path<'_>);

    /// Position of a joint at a frame, metres. A joint whose channels were not selected, or a frame out of range, gives zeros.
    fn position(&self, features: Features<'_>, path: &Self::Path<'_>, joint: usize, frame: usize) -> [f32; 3];

    /// Sets the gradient that `path` holds to zero.
    fn clear_gradient(&self, path: &mut Self::Path<'_>);

    /// Adds `d = dJ/dposition` at `place`, a joint and a frame, to `g = dJ/d(features) [T][C]`, and what goes through the path to the gradient there.
    fn add_gradient(
        &self,
        features: Features<'_>,
        path: &mut Self::Path<'_>,
        g: &mut [f32],
        place: (usize, usize),
        d: [f32; 3],
    );

    /// Carries the path's gradient back through time into `g [T][C]`.
    fn integrate_gradient(&self, features: Features<'_>, path: &Self::Path<'_>, g: &mut [f32]);
}
