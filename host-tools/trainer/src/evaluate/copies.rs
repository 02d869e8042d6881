//! Whether a generated sequence repeats a training one.

/// Share of equal tokens from which a sequence is a near-copy.
pub const NEAR: f64 = 0.9;

/// Whether at least [`NEAR`] of the tokens equal those of one training sequence, laid over it at the best place. The sequence may stand
/// over the ends; what stands over differs.
pub fn is_near_copy(tokens: &[u16], training: &[Vec<u16>]) -> bool {
    let misses = tokens.len() - (NEAR * tokens.len() as f64).ceil() as usize;
    !tokens.is_empty() && training.iter().any(|other| fits(tokens, other, misses))
}

/// Whether some alignment leaves at most `misses` tokens without an equal partner.
fn fits(tokens: &[u16], other: &[u16], misses: usize) -> bool {
    // Token 0 lies at place `start` of the other sequence; at most `misses` tokens may stand over either end.
    let (length, places) = (tokens.len() as isize, other.len() as isize);
    let misses = misses as isize;
    (-misses..=places - length + misses).any(|start| {
        let inside = |i: isize| usize::try_from(start + i).ok().and_then(|at| other.get(at));
        let mut missed = 0;
        (0..length).all(|i| {
            missed += isize::from(inside(i) != tokens.get(i as usize));
            missed <= misses
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    #[test]
    fn by_hand() {
        let training = vec![(0..30).collect::<Vec<u16>>()];
        let near = |tokens: &[u16]| is_near_copy(tokens, &training);
        assert!(near(&[7, 8, 9]) && !near(&[7, 8, 10]));
        let mut ten: Vec<u16> = (11..21).collect();
        ten[4] = 99;
        assert!(near(&ten), "nine of ten");
        ten[5] = 99;
        assert!(!near(&ten), "eight of ten");
        // One of ten stands over the end.
        assert!(near(&(21..31).collect::<Vec<_>>()) && !near(&(22..32).collect::<Vec<_>>()));
        assert!(near(&[&[99][..], &(0..9).collect::<Vec<_>>()].concat()));
        assert!(!near(&(0..40).collect::<Vec<_>>()), "longer than anything in training");
        assert!(!near(&[]) && !is_near_copy(&[1], &[]));
    }

    /// Against a count of equal tokens over every shift.
    #[test]
    fn agrees_with_a_count_over_all_shifts() {
        let mut random = Random::new(2, 2);
        let mut found = 0;
        for _ in 0..4000 {
            let mut draw = |n: usize| -> Vec<u16> { (0..n).map(|_| random.below(2) as u16).collect() };
            let longer = usize::from(draw(3).iter().sum::<u16>());
            let (tokens, other) = (draw(11), draw(9 + 2 * longer));
            let equal = |shift: isize| {
                let pair = |i: usize| other.get(usize::try_from(i as isize + shift).ok()?).map(|x| *x == tokens[i]);
                (0..tokens.len()).filter(|i| pair(*i) == Some(true)).count()
            };
            let expected = (-20..30).map(equal).max().unwrap() as f64 >= NEAR * tokens.len() as f64;
            assert_eq!(is_near_copy(&tokens, std::slice::from_ref(&other)), expected, "{tokens:?} {other:?}");
            found += usize::from(expected);
        }
        assert!(found > 50 && found < 3950, "{found}");
    }
}
