//! The road from embeddings to joints that the solver works through.

use super::observer::Watch;
use crate::decoding::decoder::{Interrupted, Workspace};
use crate::model::Model;
use crate::motion::humanml3d::{Features, Path};
use crate::nn::output::Channels;
use crate::perception::anchors::AnchorSet;
use crate::refining::{MotionMap, Stop};

/// The decoder and the recovery of joints as the solver sees them.
pub(super) struct DecoderMap<'s, 'm, 'w, 'o> {
    /// The model.
    pub model: &'s Model<'m>,
    /// Feature channels that the anchored joints depend on.
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
    /// The anchors, to report how far each evaluation is from them.
    pub anchors: &'s AnchorSet,
    /// Frames of the motion.
    pub frames: usize,
    /// False when the last point lay where the model guarantees nothing; its positions are infinite then.
    pub in_range: bool,
}

impl DecoderMap<'_, '_, '_, '_> {
    fn features(&self) -> Features<'_> {
        Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() }
    }

    /// Mean distance from the anchors, metres.
    fn control_error(&self) -> f32 {
        let (mut sum, mut count) = (0.0, 0.0);
        for anchor in self.anchors.iter() {
            let [x, y, z] = anchor.residual(self.position(anchor.joint, usize::from(anchor.frame)));
            sum += libm::sqrtf(x * x + y * y + z * z);
            count += 1.0;
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }
}

/// Runs a decoder pass with the observer asked at its layer boundaries.
fn watched(
    watch: &mut Watch<'_>,
    pass: impl FnOnce(&mut dyn FnMut() -> Result<(), Interrupted>) -> Result<(), Interrupted>,
) -> Result<(), Stop> {
    let mut stop = Stop::Abort;
    let mut check = || {
        watch.ask().map_err(|wish| {
            stop = wish;
            Interrupted
        })
    };
    let result = pass(&mut check);
    result.map_err(|Interrupted| stop)
}

impl MotionMap for DecoderMap<'_, '_, '_, '_> {
    fn frames(&self) -> usize {
        self.frames
    }

    fn tokens(&self) -> usize {
        self.frames / self.model.frames_per_token().max(1)
    }

    fn width(&self) -> usize {
        self.model.decoder().code_width()
    }

    fn forward(&mut self, u: &[f32]) -> Result<(), Stop> {
        self.watch.evaluation = self.watch.evaluation.saturating_add(1);
        let limit = self.model.embedding_limit();
        self.in_range = u.iter().all(|v| v.abs() <= limit);
        if !self.in_range {
            return self.watch.ask();
        }
        let (decoder, channels) = (self.model.decoder(), self.channels);
        let (values, work) = (&mut *self.values, &mut *self.work);
        watched(&mut self.watch, |check| decoder.forward(u, channels, values, work, check))?;
        let features =
            Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() };
        features.integrate(self.path);
        let error = self.control_error();
        self.watch.report(Some(error))
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

    fn backward(&mut self, du: &mut [f32]) -> Result<(), Stop> {
        let features =
            Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() };
        let used = self.values.len();
        let gradient = part_mut!(self.gradient, ..used);
        features.integrate_gradient(self.path, gradient);
        let (decoder, channels, work) = (self.model.decoder(), self.channels, &mut *self.work);
        let gradient = &*gradient;
        watched(&mut self.watch, |check| decoder.backward(gradient, channels, du, work, check))
    }
}
