//! A motion's own joint rotations, computed when they are asked for.

use super::buffers::rotation_columns;
use crate::channels::Channels;
use crate::nn::conv1d::Rows;
use crate::nn::output::{Output, OutputScratch};
use crate::representation::Pose;
use crate::representation::rotations::{CHANNELS, FIRST, turned};

/// What a motion's rotations are computed from: the last layer's input, as it was left in the arena.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rotations<'a> {
    /// The last layer.
    pub output: &'a Output<'a>,
    /// Its input `[T][K]`, quantised.
    pub rows: Rows<'a>,
    /// Means and standard deviations of all channels.
    pub mean: &'a [f32],
    /// See [`Rotations::mean`].
    pub std: &'a [f32],
    /// Cosine and sine of the heading, one a frame.
    pub cos: &'a [f32],
    /// See [`Rotations::cos`].
    pub sin: &'a [f32],
}

impl Rotations<'_> {
    /// `pose`, the positions of a frame, with its bones turned as that frame's rotations say. `None`: the model has no such channels,
    /// or the motion no such frame.
    #[inline(never)]
    pub fn pose(&self, frame: usize, pose: &Pose) -> Option<Pose> {
        if rotation_columns(self.output) == 0 {
            return None;
        }
        let heading = (*self.cos.get(frame)?, *self.sin.get(frame)?);
        let mut channels = Channels::new();
        channels.push(FIRST, CHANNELS);
        let (mut values, mut acc, mut acc_low) = ([0.0; CHANNELS], [0; CHANNELS], [0; CHANNELS]);
        let mut scratch = OutputScratch {
            row: &mut [],
            q: &mut [],
            scales: &mut [],
            rows_per_block: 1,
            acc: &mut acc,
            acc_low: &mut acc_low,
        };
        self.output.forward(self.rows, frame, &channels, &mut values, &mut scratch);
        let constants = self.std.iter().zip(self.mean).skip(FIRST);
        for (value, (std, mean)) in values.iter_mut().zip(constants) {
            *value = *value * *std + *mean;
        }
        Some(turned(&values, heading, pose))
    }
}
