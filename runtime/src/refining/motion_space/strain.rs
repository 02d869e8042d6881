//! How far an edit takes a motion from what was generated.

use crate::JOINTS;
use crate::kernels;
use crate::numerics::vector::{Vector, dot, subtract};
use crate::representation::Pose;

/// How many times faster, or slower, the pelvis goes over the floor on average, of which alone a warning is given.
const FASTER: f32 = 2.7;
/// Speed that is added to both, metres a second: who stands may sway.
const SWAY: f32 = 0.15;
/// Distance of joints from where they were generated, as the pelvis sees them, root of the mean square, of which a warning is given, metres.
const APART: f32 = 0.15;

/// How much anchors ask of a motion: whether it still does what the prompt says, or glides where it was to wave.
///
/// A proxy, since no device can recognise actions: by how much faster or slower the pelvis goes over the floor on average, and how far joints
/// are from where they were generated as the pelvis sees them, each as a share of that of which alone a warning is given; the length of both
/// together. The shares are chosen on validation clips, `motionette-train evaluate --table strain`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Strain {
    /// 0 where nothing was edited; above [`Strain::WARNING`] the motion may no longer do what the prompt says.
    pub value: f32,
    /// The anchor that causes most of it, from which the generated motion was farthest; counted in the caller's list.
    pub anchor: u16,
}

impl Strain {
    /// Of so much people are warned.
    pub const WARNING: f32 = 1.0;

    /// Whether the motion may no longer do what the prompt says.
    #[must_use]
    pub fn warns(&self) -> bool {
        self.value > Self::WARNING
    }
}

/// The strain of the frames so far.
pub struct Tally {
    frame_rate: f32,
    frames: f32,
    /// Squares of distances of joints, metres.
    apart: f32,
    /// Of the pelvis, as generated and as edited: where it was, and its way over the floor, metres.
    before: Option<[Vector; 2]>,
    ways: [f32; 2],
}

impl Tally {
    /// Of no frame yet.
    pub fn new(frame_rate: u16) -> Self {
        Tally { frame_rate: f32::from(frame_rate), frames: 0.0, apart: 0.0, before: None, ways: [0.0; 2] }
    }

    /// Adds the next frame, as generated and as edited; not where one of them is beyond all measure, which only a broken blob's are.
    pub fn add(&mut self, generated: &Pose, edited: &Pose) -> bool {
        let roots = [generated, edited].map(|pose| pose.first().copied().unwrap_or_default());
        let [was, is] = roots;
        let mut apart = 0.0;
        for (a, b) in generated.iter().zip(edited) {
            let moved = subtract(subtract(*b, is), subtract(*a, was));
            apart += dot(moved, moved);
        }
        if !apart.is_finite() {
            return false;
        }
        self.apart += apart;
        if let Some(before) = self.before {
            for (way, (root, before)) in self.ways.iter_mut().zip(roots.iter().zip(before)) {
                let [x, _, z] = subtract(*root, before);
                *way += kernels::sqrt(x * x + z * z);
            }
        }
        self.before = Some(roots);
        self.frames += 1.0;
        true
    }

    /// The strain of all of them.
    pub fn value(&self) -> f32 {
        let steps = if self.frames > 1.0 { self.frames - 1.0 } else { 1.0 };
        let [was, is] = self.ways.map(|way| way * self.frame_rate / steps + SWAY);
        let times = if is > was { is / was } else { was / is };
        let faster = (times - 1.0) / (FASTER - 1.0);
        let frames = if self.frames > 0.0 { self.frames } else { 1.0 };
        let apart = self.apart / (frames * JOINTS as f32 * APART * APART);
        kernels::sqrt(faster * faster + apart)
    }
}
