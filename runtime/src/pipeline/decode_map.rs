//! The road from embeddings to joints that the solver works through, whatever decodes and whatever the features mean.

use super::observer::Watch;
use crate::channels::Channels;
use crate::codec::Decode;
use crate::refining::{ControlError, MotionMap, TokenGrid};
use crate::representation::{Features, Recover};
use crate::stop::Stop;
use core::ops::ControlFlow;

/// A decoder and the recovery of joints as the solver sees them.
pub(super) struct DecoderMap<'s, 'w, 'o, C: Decode, R: Recover> {
    /// Embeddings to features.
    pub decoder: &'s C,
    /// Features to joints.
    pub recovery: R,
    /// Feature channels that the objective's joints depend on.
    pub channels: &'s Channels,
    /// Normalised features `[T][C]`.
    pub values: &'s mut [f32],
    /// Their gradient `[T][C]`, or more room.
    pub gradient: &'s mut [f32],
    /// What is integrated over the motion, and its gradient.
    pub path: &'s mut R::Path<'w>,
    /// The decoder's buffers.
    pub work: &'s mut C::Workspace<'w>,
    /// Asked at layer boundaries.
    pub watch: Watch<'o>,
    /// Tokens of the motion.
    pub tokens: usize,
    /// Largest magnitude of an embedding's numbers for which the model guarantees anything.
    pub limit: f32,
    /// False when the last point lay beyond; its positions are infinite then.
    pub in_range: bool,
}

impl<C: Decode, R: Recover> DecoderMap<'_, '_, '_, C, R> {
    fn features(&self) -> Features<'_> {
        Features { values: self.values, channels: self.channels }
    }
}

impl<C: Decode, R: Recover> MotionMap for DecoderMap<'_, '_, '_, C, R> {
    fn grid(&self) -> TokenGrid {
        TokenGrid { tokens: self.tokens, frames_per_token: self.decoder.frames_per_token() }
    }

    fn width(&self) -> usize {
        self.decoder.code_width()
    }

    fn forward(&mut self, u: &[f32]) -> ControlFlow<Stop> {
        self.watch.evaluation = self.watch.evaluation.saturating_add(1);
        self.in_range = u.iter().all(|v| v.abs() <= self.limit);
        if !self.in_range {
            return self.watch.ask();
        }
        let watch = &mut self.watch;
        self.decoder.forward(u, self.channels, self.values, self.work, &mut || watch.ask())?;
        self.recovery.integrate(Features { values: self.values, channels: self.channels }, self.path);
        ControlFlow::Continue(())
    }

    fn measured(&mut self, error: &ControlError) -> ControlFlow<Stop> {
        self.watch.report(Some(error.mean))
    }

    fn position(&self, joint: u8, frame: usize) -> [f32; 3] {
        if !self.in_range {
            return [f32::INFINITY; 3];
        }
        self.recovery.position(self.features(), self.path, usize::from(joint), frame)
    }

    fn clear_gradient(&mut self) {
        self.gradient.fill(0.0);
        self.recovery.clear_gradient(self.path);
    }

    fn add_gradient(&mut self, joint: u8, frame: usize, d: [f32; 3]) {
        let features = Features { values: self.values, channels: self.channels };
        self.recovery.add_gradient(features, self.path, self.gradient, (usize::from(joint), frame), d);
    }

    fn backward(&mut self, du: &mut [f32]) -> ControlFlow<Stop> {
        let gradient = part_mut!(self.gradient, ..self.values.len());
        let features = Features { values: self.values, channels: self.channels };
        self.recovery.integrate_gradient(features, self.path, gradient);
        let watch = &mut self.watch;
        self.decoder.backward(gradient, self.channels, du, self.work, &mut || watch.ask())
    }
}
