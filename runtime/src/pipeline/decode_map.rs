//! The road from embeddings to joints that the solver works through.

use super::observer::Watch;
use crate::codec::vq::decoder::Workspace;
use crate::model::Model;
use crate::nn::output::Channels;
use crate::refining::{ControlError, MotionMap, TokenGrid};
use crate::representation::humanml3d::{Features, Path};
use crate::stop::Stop;
use core::ops::ControlFlow;

/// The decoder and the recovery of joints as the solver sees them.
pub(super) struct DecoderMap<'s, 'm, 'w, 'o> {
    /// The model.
    pub model: &'s Model<'m>,
    /// Feature channels that the objective's joints depend on.
    pub channels: &'s Channels,
    /// Normalised features `[T][C]`.
    pub values: &'s mut [f32],
    /// Their gradient `[T][C]`.
    pub gradient: &'s mut [f32],
    /// Root path and its gradient.
    pub path: &'s mut Path<'w>,
    /// The decoder's buffers.
    pub work: &'s mut Workspace<'w>,
    /// Asked at layer boundaries.
    pub watch: Watch<'o>,
    /// Tokens of the motion.
    pub tokens: usize,
    /// False when the last point lay where the model guarantees nothing; its positions are infinite then.
    pub in_range: bool,
}

impl DecoderMap<'_, '_, '_, '_> {
    fn features(&self) -> Features<'_> {
        Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() }
    }
}

impl MotionMap for DecoderMap<'_, '_, '_, '_> {
    fn grid(&self) -> TokenGrid {
        TokenGrid { tokens: self.tokens, frames_per_token: self.model.frames_per_token() }
    }

    fn width(&self) -> usize {
        self.model.decoder().code_width()
    }

    fn forward(&mut self, u: &[f32]) -> ControlFlow<Stop> {
        self.watch.evaluation = self.watch.evaluation.saturating_add(1);
        let limit = self.model.embedding_limit();
        self.in_range = u.iter().all(|v| v.abs() <= limit);
        if !self.in_range {
            return self.watch.ask();
        }
        let (decoder, channels) = (self.model.decoder(), self.channels);
        let (values, work) = (&mut *self.values, &mut *self.work);
        let watch = &mut self.watch;
        decoder.forward(u, channels, values, work, &mut || watch.ask())?;
        let features =
            Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() };
        features.integrate(self.path);
        ControlFlow::Continue(())
    }

    fn measured(&mut self, error: &ControlError) -> ControlFlow<Stop> {
        self.watch.report(Some(error.mean))
    }

    fn position(&self, joint: u8, frame: usize) -> [f32; 3] {
        if self.in_range { self.features().position(self.path, usize::from(joint), frame) } else { [f32::INFINITY; 3] }
    }

    fn clear_gradient(&mut self) {
        self.gradient.fill(0.0);
        self.path.d_angle.fill(0.0);
        self.path.d_x.fill(0.0);
        self.path.d_z.fill(0.0);
    }

    fn add_gradient(&mut self, joint: u8, frame: usize, d: [f32; 3]) {
        let features =
            Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() };
        features.add_gradient(self.path, self.gradient, usize::from(joint), frame, d);
    }

    fn backward(&mut self, du: &mut [f32]) -> ControlFlow<Stop> {
        let features =
            Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() };
        let used = self.values.len();
        let gradient = part_mut!(self.gradient, ..used);
        features.integrate_gradient(self.path, gradient);
        let (decoder, channels, work) = (self.model.decoder(), self.channels, &mut *self.work);
        let gradient = &*gradient;
        let watch = &mut self.watch;
        decoder.backward(gradient, channels, du, work, &mut || watch.ask())
    }
}
