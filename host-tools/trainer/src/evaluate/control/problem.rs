//! Anchors of a clip: family, number, seed.

use motionette_host::motion::Pose;
use motionette_host::reference::{Anchor, Target};
use serde::{Deserialize, Serialize};

use crate::control::anchors::{EXTREMITIES, Kind, draw};
use crate::random::Random;

/// Streams of random numbers that draw anchors.
const STREAM: u64 = 1 << 44;
/// Frames of the six-joint problem: five of them make 30 anchors.
const SPARSE_FRAMES: usize = 5;

/// Which anchors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Problem {
    /// So many anchors of a family at random frames; body points take feet, head and hands at random.
    Family(Kind, usize),
    /// Pelvis, feet, head and hands at five random frames.
    SixJoints,
}

impl Problem {
    /// Name of the family.
    pub fn family(&self) -> &'static str {
        match self {
            Problem::Family(Kind::Root3d, _) => "root3d",
            Problem::Family(Kind::Planar, _) => "planar",
            Problem::Family(Kind::Body, _) => "body",
            Problem::Family(Kind::Mixed, _) => "mixed",
            Problem::SixJoints => "six_joints",
        }
    }

    /// Number of anchors.
    pub fn count(&self) -> usize {
        match self {
            Problem::Family(_, count) => *count,
            Problem::SixJoints => (1 + EXTREMITIES.len()) * SPARSE_FRAMES,
        }
    }

    /// Anchors on `real`, the same for every way to meet them.
    pub fn anchors(&self, real: &[Pose], prompt: usize, seed: u64) -> Vec<Anchor> {
        let mut random = Random::new(seed, STREAM + prompt as u64);
        match *self {
            Problem::Family(kind, count) => draw(kind, count, real, &EXTREMITIES, &mut random),
            Problem::SixJoints => {
                let roots = draw(Kind::Root3d, SPARSE_FRAMES, real, &EXTREMITIES, &mut random);
                let frames: Vec<usize> = roots.iter().map(|anchor| anchor.frame).collect();
                let points = frames.into_iter().flat_map(|frame| {
                    EXTREMITIES.map(|joint| {
                        let position = real[frame][joint].map(f64::from);
                        Anchor { frame, target: Target::Joint { joint, position } }
                    })
                });
                let mut anchors: Vec<Anchor> = points.collect();
                anchors.extend(roots);
                anchors.sort_by_key(|anchor| (anchor.frame, anchor.joint()));
                anchors
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_depend_on_clip_and_seed_alone_and_are_met_by_the_clip() {
        let real: Vec<Pose> = (0..60).map(|t| std::array::from_fn(|j| [t as f32, j as f32, 0.5])).collect();
        for problem in [Problem::Family(Kind::Root3d, 8), Problem::Family(Kind::Body, 32), Problem::SixJoints] {
            let anchors = problem.anchors(&real, 3, 1);
            assert_eq!(anchors.len(), problem.count());
            assert_eq!(anchors, problem.anchors(&real, 3, 1));
            assert_ne!(anchors, problem.anchors(&real, 4, 1));
            assert_ne!(anchors, problem.anchors(&real, 3, 2));
            assert!(anchors.iter().all(|anchor| anchor.error(&real) == 0.0));
        }
    }
}
