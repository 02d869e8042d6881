//! How different motions are: from one another (diversity), for one sentence (multimodality).
//!
//! HumanML3D draws pairs at random; here all pairs count, which is the mean of such draws.

use super::retrieval::distance;

/// Distances of all pairs of a set, `[n][n]`.
#[derive(Clone, Debug)]
pub struct Distances {
    values: Vec<f64>,
    n: usize,
}

impl Distances {
    /// Of vectors of one length.
    pub fn of(vectors: &[&[f64]]) -> Self {
        let values = vectors.iter().flat_map(|a| vectors.iter().map(|b| distance(a, b))).collect();
        Self { values, n: vectors.len() }
    }

    /// Mean distance of the pairs of `members`; a member that occurs twice makes no pair with itself. 0 without a pair.
    pub fn mean(&self, members: &[usize]) -> f64 {
        let (mut sum, mut pairs) = (0.0, 0usize);
        for (at, i) in members.iter().enumerate() {
            for j in members[at + 1..].iter().filter(|j| *j != i) {
                sum += self.values[i * self.n + j];
                pairs += 1;
            }
        }
        sum / pairs.max(1) as f64
    }
}

/// Mean distance of the pairs of a set; none for fewer than two vectors.
pub fn mean_distance(vectors: &[&[f64]]) -> Option<f64> {
    let members: Vec<usize> = (0..vectors.len()).collect();
    (vectors.len() > 1).then(|| Distances::of(vectors).mean(&members))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_points_by_hand() {
        let points: [&[f64]; 3] = [&[0.0, 0.0], &[3.0, 4.0], &[3.0, 0.0]];
        let distances = Distances::of(&points);
        assert_eq!(distances.mean(&[0, 1, 2]), 4.0);
        assert_eq!(mean_distance(&points), Some(4.0));
        // Pairs of (0, 0, 1): 0-1 twice.
        assert_eq!(distances.mean(&[0, 0, 1]), 5.0);
        assert_eq!(distances.mean(&[1]), 0.0);
        assert_eq!(mean_distance(&points[..1]), None);
    }
}
