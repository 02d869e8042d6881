//! Motions and sentences in one space: is a motion's own sentence among the nearest?
//!
//! HumanML3D's R-precision, with one change: the 32 candidates have distinct labels (action and style), so that no wrong candidate says
//! what the right one says.

use crate::random::Random;

/// Sentences a motion's own is ranked among, itself included.
pub const CANDIDATES: usize = 32;

/// Euclidean distance.
pub fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt()
}

/// For every motion how many of 31 candidates are nearer to it than its own sentence: 0 is top-1.
///
/// `motions[i]` belongs to `texts[i]`, `labels[i]` names the label of both. The other candidates are sentences of distinct other labels,
/// drawn anew for every motion. Equal distances count half, rounded up, so that a judge that cannot tell sentences apart does not
/// score. With fewer labels than candidates all labels take part.
pub fn ranks(motions: &[&[f64]], texts: &[&[f64]], labels: &[usize], random: &mut Random) -> Vec<usize> {
    let kinds = labels.iter().max().map_or(0, |label| label + 1);
    let mut members = vec![Vec::new(); kinds];
    for (index, label) in labels.iter().enumerate() {
        members[*label].push(index);
    }
    let present: Vec<usize> = (0..kinds).filter(|kind| !members[*kind].is_empty()).collect();
    let rank = |index: usize| {
        let mut others: Vec<usize> = present.iter().copied().filter(|kind| *kind != labels[index]).collect();
        let own = distance(motions[index], texts[index]);
        let (mut nearer, mut equal) = (0usize, 0usize);
        for _ in 1..CANDIDATES.min(others.len() + 1) {
            let kind = others.swap_remove(random.below(others.len()));
            let candidate = members[kind][random.below(members[kind].len())];
            let other = distance(motions[index], texts[candidate]);
            nearer += usize::from(other < own);
            equal += usize::from(other == own);
        }
        nearer + equal.div_ceil(2)
    };
    (0..motions.len()).map(rank).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three labels, fewer than candidates: all take part, so ranks can be counted by hand.
    #[test]
    fn a_small_example_by_hand() {
        let texts: [&[f64]; 4] = [&[0.0, 0.0], &[1.0, 0.0], &[0.0, 3.0], &[0.0, 0.1]];
        // Label 0 has two sentences (0 and 3), which never compete.
        let labels = [0, 1, 2, 0];
        let motions: [&[f64]; 4] = [&[0.0, 0.0], &[0.1, 0.0], &[0.4, 0.2], &[0.0, 0.04]];
        for seed in 0..8 {
            let ranks = ranks(&motions, &texts, &labels, &mut Random::new(seed, 0));
            assert_eq!(ranks, [0, 1, 2, 0]);
        }
    }

    #[test]
    fn sentences_that_cannot_be_told_apart_are_at_chance() {
        let text = [0.5, 0.5];
        let texts = vec![&text[..]; 64];
        let labels: Vec<usize> = (0..64).collect();
        assert!(ranks(&texts, &texts, &labels, &mut Random::new(1, 0)).iter().all(|rank| *rank == 16));
    }

    /// Motions and sentences without relation: top-k at k / 32.
    #[test]
    fn unrelated_motions_are_at_chance() {
        let mut random = Random::new(3, 0);
        let mut points = || -> Vec<[f64; 2]> { (0..4000).map(|_| [random.symmetric(), random.symmetric()]).collect() };
        let (motions, texts) = (points(), points());
        let labels: Vec<usize> = (0..4000).map(|i| i % 80).collect();
        let motions: Vec<&[f64]> = motions.iter().map(|p| &p[..]).collect();
        let texts: Vec<&[f64]> = texts.iter().map(|p| &p[..]).collect();
        let ranks = ranks(&motions, &texts, &labels, &mut Random::new(4, 0));
        for top in 1..=3 {
            let share = ranks.iter().filter(|rank| **rank < top).count() as f64 / 4000.0;
            let chance = top as f64 / CANDIDATES as f64;
            // Four standard deviations.
            let spread = 4.0 * (chance * (1.0 - chance) / 4000.0).sqrt();
            assert!((share - chance).abs() < spread, "top-{top}: {share}, chance is {chance}");
        }
    }
}
