//! `||u - u0||^2`: the trust region, which keeps the correction small in the embedding space.

/// The term with its weight.
#[derive(Clone, Copy, Debug)]
pub struct Trust {
    weight: f32,
}

impl Trust {
    /// With weight `g_tr`.
    #[must_use]
    pub const fn new(weight: f32) -> Self {
        Self { weight }
    }

    /// `g_tr moved`, with `moved = ||u - u0||^2`.
    #[must_use]
    pub const fn value(&self, moved: f32) -> f32 {
        self.weight * moved
    }

    /// `gradient += 2 g_tr (u - u0)`.
    pub(super) fn add_gradient(&self, gradient: &mut [f32], moved: impl Iterator<Item = f32>) {
        let scale = 2.0 * self.weight;
        for (slot, moved) in gradient.iter_mut().zip(moved) {
            *slot += scale * moved;
        }
    }
}
