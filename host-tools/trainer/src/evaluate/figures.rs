//! From judged motions to one row of figures.
//!
//! Figures of single motions are means over seeds and prompts; sets (Fréchet distance, diversity) are measured seed by seed and
//! averaged. Intervals draw the prompts again, all seeds of a prompt together.

use std::collections::BTreeMap;

use super::bootstrap::half_width;
use super::frechet::{self, Gaussian};
use super::prompt::Prompt;
use super::retrieval;
use super::sample::{Controlled, Judged, Sample};
use super::spread::{Distances, mean_distance};
use crate::random::Random;

/// A place that is farther off than this is missed, centimetres (ControlMM, table 1).
const MISSED_CM: f64 = 50.0;

/// Names of the figures, in the order of the table.
pub const METRICS: [&str; 11] = [
    "fid",
    "action_accuracy",
    "style_accuracy",
    "top1",
    "top2",
    "top3",
    "mm_dist",
    "diversity",
    "multimodality",
    "foot_skating",
    "near_copies",
];

/// A mean and half the width of its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    /// Mean.
    pub mean: f64,
    /// Half width.
    pub half_width: f64,
}

/// One row of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name.
    pub name: String,
    /// Figures by name; a figure that the row cannot have is missing.
    pub figures: BTreeMap<&'static str, Figure>,
}

/// What all rows of a table are measured against.
pub struct Yardstick {
    /// The prompts.
    pub prompts: Vec<Prompt>,
    /// `[prompt]` embedding of the sentence.
    pub texts: Vec<Vec<f64>>,
    /// `[prompt]` embedding of real test motion.
    pub real: Vec<Vec<f64>>,
    /// Rounds of R-precision of rows with one seed.
    pub rounds: usize,
}

impl Yardstick {
    /// Measures a row over the prompts `members`. Candidates of R-precision come from all prompts.
    pub fn measure(&self, sample: &Sample, members: &[usize]) -> Row {
        let Row { name, mut figures } = self.measure_singles(sample, members);
        let whole: Vec<usize> = (0..members.len()).collect();
        let distances: Vec<Distances> = sample
            .motions
            .iter()
            .map(|motions| Distances::of(&members.iter().map(|i| motions[*i].embedding.as_slice()).collect::<Vec<_>>()))
            .collect();
        let diversity = |draws: &[usize]| mean(distances.iter().map(|d| d.mean(draws)));
        let fid = |draws: &[usize]| {
            let real = Gaussian::of(draws.iter().map(|i| self.real[members[*i]].as_slice()));
            let root = real.root();
            mean((0..sample.seeds()).map(|seed| {
                let own = Gaussian::of(draws.iter().map(|i| sample.standing(seed, members[*i])));
                frechet::distance_with_root(&real, &root, &own)
            }))
        };
        figures.insert("diversity", figure(&whole, diversity));
        // Anchors of all motions together, not motions.
        let errors = |draws: &[usize]| -> Vec<f64> {
            let of = |i: usize| sample.motions.iter().filter_map(move |motions| motions[i].controlled.as_ref());
            draws
                .iter()
                .flat_map(|i| of(members[*i]).flat_map(|controlled| controlled.errors_cm.iter().copied()))
                .collect()
        };
        if !errors(&whole).is_empty() {
            let p95 = |draws: &[usize]| percentile(errors(draws), 0.95);
            figures.insert("control_error_p95_cm", figure(&whole, p95));
            let largest = errors(&whole).into_iter().fold(0.0, f64::max);
            figures.insert("control_error_max_cm", Figure { mean: largest, half_width: 0.0 });
        }
        figures.insert("fid", figure(&whole, fid));
        Row { name, figures }
    }

    /// The figures of single motions alone: for few prompts, of which a set says nothing.
    pub fn measure_singles(&self, sample: &Sample, members: &[usize]) -> Row {
        let mut figures = BTreeMap::new();
        for (name, values) in self.single(sample) {
            let present: Vec<f64> = members.iter().filter_map(|index| values[*index]).collect();
            if present.is_empty() {
                continue;
            }
            let mean = |draws: &mut dyn Iterator<Item = usize>| {
                let (sum, count) = draws.fold((0.0, 0.0), |(sum, count), i| (sum + present[i], count + 1.0));
                sum / count
            };
            let half_width = half_width(present.len(), 1, |draws| mean(&mut draws.iter().copied()));
            figures.insert(name, Figure { mean: mean(&mut (0..present.len())), half_width });
        }
        Row { name: sample.name.clone(), figures }
    }

    /// Figures of single motions, `[prompt]` each, averaged over seeds.
    fn single(&self, sample: &Sample) -> Vec<(&'static str, Vec<Option<f64>>)> {
        let prompts = 0..self.prompts.len();
        let over_seeds = |value: &dyn Fn(&Judged, &Prompt) -> f64| -> Vec<Option<f64>> {
            prompts
                .clone()
                .map(|i| {
                    let prompt = &self.prompts[sample.against[i]];
                    Some(mean(sample.motions.iter().map(|motions| value(&motions[i], prompt))))
                })
                .collect()
        };
        let yes = |holds: bool| f64::from(u8::from(holds));
        let right_style =
            over_seeds(&|motion, prompt| yes(prompt.style.as_ref().is_some_and(|style| *style == motion.style)));
        let asked = |i: usize| self.prompts[sample.against[i]].style.is_some();
        let style_accuracy = right_style.into_iter().enumerate().map(|(i, share)| share.filter(|_| asked(i))).collect();
        let texts: Vec<&[f64]> = sample.against.iter().map(|i| self.texts[*i].as_slice()).collect();
        let labels: Vec<usize> = sample.against.iter().map(|i| self.prompts[*i].label).collect();
        let rounds = sample.motions.len().max(self.rounds);
        let mut tops = [(); 3].map(|()| vec![0.0; self.prompts.len()]);
        for round in 0..rounds {
            let motions = &sample.motions[round % sample.motions.len()];
            let motions: Vec<&[f64]> = motions.iter().map(|m| m.embedding.as_slice()).collect();
            let ranks = retrieval::ranks(&motions, &texts, &labels, &mut Random::new(1, round as u64));
            for (i, rank) in ranks.into_iter().enumerate() {
                tops.iter_mut().skip(rank).for_each(|top| top[i] += 1.0 / rounds as f64);
            }
        }
        let [top1, top2, top3] = tops.map(|top| top.into_iter().map(Some).collect());
        let distances = prompts.clone().map(|i| {
            Some(mean(sample.motions.iter().map(|motions| retrieval::distance(&motions[i].embedding, texts[i]))))
        });
        let anchored = |value: &dyn Fn(&Controlled) -> f64| -> Vec<Option<f64>> {
            let mean_of = |i: usize| -> Option<f64> {
                let of: Option<Vec<f64>> =
                    sample.motions.iter().map(|motions| motions[i].controlled.as_ref().map(value)).collect();
                of.map(|values| mean(values.into_iter()))
            };
            prompts.clone().map(mean_of).collect()
        };
        vec![
            ("control_error_cm", anchored(&|c| mean(c.errors_cm.iter().copied()))),
            ("trajectory_error", anchored(&|c| yes(c.errors_cm.iter().any(|error| *error > MISSED_CM)))),
            ("location_error", anchored(&|c| mean(c.errors_cm.iter().map(|error| yes(*error > MISSED_CM))))),
            ("loosened", anchored(&|c| c.loosened as f64 / c.anchors().max(1) as f64)),
            ("unreachable", anchored(&|c| c.unreachable as f64 / c.anchors().max(1) as f64)),
            ("jerk", anchored(&|c| c.jerk)),
            ("jerk_at_anchors", anchored(&|c| c.jerk_at_anchors)),
            ("foot_speed", anchored(&|c| c.foot_speed)),
            ("speed", anchored(&|c| c.speed)),
            ("bone_mm", anchored(&|c| c.bone_mm)),
            ("du", anchored(&|c| c.distance)),
            ("evaluations", anchored(&|c| c.evaluations)),
            ("strain", anchored(&|c| c.strain)),
            ("action_accuracy", over_seeds(&|motion, prompt| yes(motion.content == prompt.content))),
            ("style_accuracy", style_accuracy),
            ("top1", top1),
            ("top2", top2),
            ("top3", top3),
            ("mm_dist", distances.collect()),
            ("multimodality", self.multimodality(sample)),
            ("foot_skating", over_seeds(&|motion, _| motion.foot_skating)),
            ("near_copies", over_seeds(&|motion, _| yes(motion.near_copy))),
        ]
    }

    /// Mean distance of a prompt's motions of different seeds; in a row with one seed, of a motion to the others of its label.
    fn multimodality(&self, sample: &Sample) -> Vec<Option<f64>> {
        let embedding = |seed: usize, i: usize| sample.motions[seed][i].embedding.as_slice();
        let prompts = 0..self.prompts.len();
        let of_seeds =
            |i: usize| mean_distance(&(0..sample.motions.len()).map(|seed| embedding(seed, i)).collect::<Vec<_>>());
        let of_label = |i: usize| {
            let same = |j: &usize| *j != i && self.prompts[*j].label == self.prompts[i].label;
            let others: Vec<usize> = prompts.clone().filter(same).collect();
            let distances = others.iter().map(|j| retrieval::distance(embedding(0, i), embedding(0, *j)));
            (!others.is_empty()).then(|| mean(distances))
        };
        let several = sample.motions.len() > 1;
        prompts.clone().map(|i| if several { of_seeds(i) } else { of_label(i) }).collect()
    }
}

fn figure(whole: &[usize], statistic: impl Fn(&[usize]) -> f64 + Sync) -> Figure {
    Figure { mean: statistic(whole), half_width: half_width(whole.len(), 1, &statistic) }
}

/// The value that a share of them does not exceed; 0 of nothing.
fn percentile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
}

/// Arithmetic mean; 0 of nothing.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), x| (sum + x, count + 1));
    sum / count.max(1) as f64
}
