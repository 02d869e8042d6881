//! The token grid: which frames a token stands for.

/// Tokens of a motion and the frames of each: token l stands for the frames `r l` to `r l + r - 1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TokenGrid {
    /// Tokens of the motion.
    pub tokens: usize,
    /// Frames of a token, r.
    pub frames_per_token: usize,
}

impl TokenGrid {
    /// Frames of the motion.
    #[must_use]
    pub const fn frames(&self) -> usize {
        self.tokens.saturating_mul(self.frames_per_token)
    }

    /// The middle of a token's frames, `r l + (r - 1) / 2`.
    #[must_use]
    pub const fn middle(&self, token: usize) -> f32 {
        let first = token.saturating_mul(self.frames_per_token);
        first as f32 + 0.5 * self.frames_per_token.saturating_sub(1) as f32
    }

    /// The first token whose middle does not lie before `frame`; the number of tokens when all do.
    #[must_use]
    pub const fn first_token_from(&self, frame: usize) -> usize {
        // r l + (r - 1) / 2 >= frame <=> 2 r l >= 2 frame + 1 - r <=> l >= (frame + r / 2) / r, both rounded down.
        match frame.saturating_add(self.frames_per_token / 2).checked_div(self.frames_per_token) {
            Some(token) if token < self.tokens => token,
            _ => self.tokens,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_falls_before_the_first_middle_that_is_not_before_it() {
        for frames_per_token in 1..=16 {
            let grid = TokenGrid { tokens: 9, frames_per_token };
            assert_eq!(grid.frames(), 9 * frames_per_token);
            for frame in 0..=grid.frames() {
                let expected = (0..9).find(|&token| {
                    let own = token * frames_per_token..(token + 1) * frames_per_token;
                    own.map(|t| t as f32).sum::<f32>() / frames_per_token as f32 >= frame as f32
                });
                assert_eq!(grid.first_token_from(frame), expected.unwrap_or(9), "{frames_per_token}, frame {frame}");
            }
            let mean = |token: usize| {
                (token * frames_per_token..(token + 1) * frames_per_token).sum::<usize>() as f32
                    / frames_per_token as f32
            };
            assert!((0..9).all(|token| grid.middle(token) == mean(token)), "{frames_per_token}");
        }
        assert_eq!(TokenGrid { tokens: 3, frames_per_token: 0 }.first_token_from(1), 3);
    }
}
