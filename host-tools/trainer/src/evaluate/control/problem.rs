//! Anchors of a clip: family, number, whose motion they are places of, seed.

use motionette_host::motion::Pose;
use motionette_host::reference::{Anchor, Target};
use serde::{Deserialize, Serialize};

use crate::control::anchors::{EXTREMITIES, Kind, draw};
use crate::evaluate::prompt::Prompt;
use crate::random::Random;

/// Streams of random numbers that draw anchors.
const STREAM: u64 = 1 << 44;
/// Streams of random numbers that draw foreign clips.
const PARTNER_STREAM: u64 = 1 << 45;
/// So many tokens longer a foreign clip may be.
const LONGER: usize = 5;
/// Frames of the six-joint problem: five of them make 30 anchors.
const SPARSE_FRAMES: usize = 5;

/// Which anchors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Problem {
    /// So many anchors of a family at random frames; body points take feet, head and hands at random.
    Family(Kind, usize),
    /// Pelvis, feet, head and hands at five random frames.
    SixJoints,
    /// Joints of [`LED`], bit by bit, at random frames or all of them: as tracks.
    Tracks(u8, Density),
}

/// Joints that tracks lead, in the order of ControlMM's tables: pelvis, feet, head, wrists.
pub const LED: [usize; 6] = [0, 10, 11, 15, 20, 21];
/// Their names, and those of all that lead several.
const NAMES: [&str; 6] = ["pelvis", "left_foot", "right_foot", "head", "left_wrist", "right_wrist"];

/// At how many frames tracks say where joints are (ControlMM, table 4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Density {
    /// So many frames.
    Frames(usize),
    /// A share of all frames, percent.
    Percent(usize),
}

/// The densities of the table.
pub const DENSITIES: [Density; 5] =
    [Density::Frames(1), Density::Frames(2), Density::Frames(5), Density::Percent(25), Density::Percent(100)];

impl Density {
    /// So many of `frames`.
    pub fn of(self, frames: usize) -> usize {
        match self {
            Density::Frames(count) => count.min(frames),
            Density::Percent(share) => (share * frames).div_ceil(100),
        }
    }

    /// As tables say it: a number of frames, or the percentage.
    pub const fn number(self) -> usize {
        match self {
            Density::Frames(number) | Density::Percent(number) => number,
        }
    }
}

/// Whose motion anchors are places of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Targets {
    /// The clip's own, which leak the truth.
    Own,
    /// Another clip's of about the same length and another label, from the same start and heading.
    Foreign,
}

impl Targets {
    /// As tables say it.
    pub const fn name(self) -> &'static str {
        match self {
            Targets::Own => "own",
            Targets::Foreign => "foreign",
        }
    }

    /// The prompt whose clip's places are aimed at from prompt `place`: for foreign ones any of another label that is not shorter, and not
    /// longer by more than five tokens, or else the one nearest in length.
    pub fn of(self, prompts: &[Prompt], place: usize, seed: u64) -> usize {
        if self == Targets::Own {
            return place;
        }
        let (own, label) = (prompts[place].tokens, prompts[place].label);
        let others = || (0..prompts.len()).filter(|i| prompts[*i].label != label);
        let alike: Vec<usize> = others().filter(|i| (own..=own + LONGER).contains(&prompts[*i].tokens)).collect();
        if alike.is_empty() {
            return others().min_by_key(|i| prompts[*i].tokens.abs_diff(own)).unwrap_or(place);
        }
        alike[Random::new(seed, PARTNER_STREAM + place as u64).below(alike.len())]
    }
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
            Problem::Tracks(joints, _) if joints.count_ones() == 1 => NAMES[joints.trailing_zeros() as usize],
            Problem::Tracks(..) => "cross",
        }
    }

    /// Number of anchors.
    pub fn count(&self) -> usize {
        match self {
            Problem::Family(_, count) => *count,
            Problem::SixJoints => (1 + EXTREMITIES.len()) * SPARSE_FRAMES,
            Problem::Tracks(_, density) => density.number(),
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
            Problem::Tracks(joints, density) => {
                // Not frame 0, where every motion begins.
                let mut frames: Vec<usize> = (1..real.len()).collect();
                let count = density.of(frames.len());
                for place in 0..count {
                    let other = place + random.below(frames.len() - place);
                    frames.swap(place, other);
                }
                frames.truncate(count);
                frames.sort_unstable();
                let led = LED.iter().enumerate().filter(|(bit, _)| joints >> bit & 1 == 1);
                let led: Vec<usize> = led.map(|(_, joint)| *joint).collect();
                let place = |frame: usize, joint: usize| {
                    let position = real[frame][joint].map(f64::from);
                    Anchor { frame, target: Target::Joint { joint, position } }
                };
                frames.iter().flat_map(|frame| led.iter().map(move |joint| place(*frame, *joint))).collect()
            }
        }
    }

    /// Whether it is given as tracks, not as anchors.
    pub const fn is_tracks(&self) -> bool {
        matches!(self, Problem::Tracks(..))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_targets_are_of_another_label_and_about_as_long() {
        let prompt = |(clip, tokens, label): (usize, usize, usize)| Prompt {
            clip,
            caption: String::new(),
            content: String::new(),
            style: None,
            label,
            tokens,
        };
        let prompts = [(0, 20, 0), (1, 21, 0), (2, 22, 1), (3, 25, 2), (4, 40, 3), (5, 19, 1)].map(prompt);
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..40 {
            assert_eq!(Targets::Own.of(&prompts, 3, seed), 3);
            let other = Targets::Foreign.of(&prompts, 0, seed);
            assert_eq!(other, Targets::Foreign.of(&prompts, 0, seed));
            seen.insert(other);
            assert_eq!(Targets::Foreign.of(&prompts, 4, seed), 3, "nothing is as long: the nearest");
        }
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), [2, 3]);
    }

    #[test]
    fn anchors_depend_on_clip_and_seed_alone_and_are_met_by_the_clip() {
        let real: Vec<Pose> = (0..60).map(|t| std::array::from_fn(|j| [t as f32, j as f32, 0.5])).collect();
        let all = Problem::Tracks(0b11_1111, Density::Percent(100));
        let anchors = all.anchors(&real, 3, 1);
        assert_eq!(anchors.len(), 59 * 6);
        assert!(anchors.iter().all(|anchor| anchor.error(&real) == 0.0 && anchor.frame > 0));
        assert_eq!(Problem::Tracks(0b100, Density::Frames(5)).anchors(&real, 3, 1).len(), 5);
        assert_eq!(Problem::Tracks(0b10_0001, Density::Percent(25)).anchors(&real, 3, 1).len(), 15 * 2);
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
