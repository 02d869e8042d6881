//! How long the motion becomes.

use crate::nn::softmax;

/// Length of the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Length {
    /// So many tokens.
    Tokens(u16),
    /// At least so many frames, to the next whole token.
    Frames(u16),
    /// What the text suggests, but never shorter than anchors and fixed tokens need.
    #[default]
    Predicted,
}

/// The median of the distribution that `logits [n]` over lengths `1..=n` describe; overwrites them with probabilities.
#[must_use]
pub fn median(logits: &mut [f32]) -> usize {
    softmax::softmax(logits);
    let mut sum = 0.0;
    for (class, p) in logits.iter().enumerate() {
        sum += *p;
        if sum >= 0.5 {
            return class + 1;
        }
    }
    logits.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_of_known_distributions() {
        assert_eq!(median(&mut [0.0]), 1);
        assert_eq!(median(&mut [0.0, 0.0, 0.0]), 2);
        assert_eq!(median(&mut [0.0, 0.0, 0.0, 0.0]), 2);
        assert_eq!(median(&mut [-5.0, -5.0, -5.0, 9.0]), 4);
        // 0.4, 0.4, 0.2
        assert_eq!(median(&mut [0.0, 0.0, -core::f32::consts::LN_2]), 2);
    }
}
