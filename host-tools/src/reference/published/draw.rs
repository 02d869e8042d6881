//! Choices of a class from logits.

use crate::reference::real::Real;

/// What noise is kept above.
const LEAST: f64 = 1e-20;

/// How a class is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Divides the logits, positive.
    pub temperature: f64,
    /// Share of the classes that are left out, the least likely ones.
    pub filter: f64,
}

impl Choice {
    /// As the published evaluation has it.
    pub const PUBLISHED: Self = Self { temperature: 1.0, filter: 0.9 };

    /// Classes that stay of so many: `ceil((1 - filter) classes)`, at least one.
    #[must_use]
    pub fn kept(&self, classes: usize) -> usize {
        (((1.0 - self.filter) * classes as f64).ceil() as usize).clamp(1, classes.max(1))
    }

    /// `argmax(logit / temperature + g)` over the classes that stay, `g = -ln(max(-ln(max(u, 1e-20)), 1e-20))`. One number is drawn a
    /// class, whether it stays or not.
    ///
    /// # Panics
    /// Without logits.
    pub fn draw<T: Real>(&self, logits: &[T], mut uniform: impl FnMut() -> f32) -> usize {
        let mut ranked = logits.to_vec();
        ranked.sort_by(|a, b| b.partial_cmp(a).unwrap_or(core::cmp::Ordering::Equal));
        let least = ranked[self.kept(logits.len()) - 1];
        let floor = |value: T| value.larger(T::from_f64(LEAST));
        let mut best = None;
        for (class, &logit) in logits.iter().enumerate() {
            let noise = -floor(-floor(T::from_f32(uniform())).ln()).ln();
            let value = logit / T::from_f64(self.temperature) + noise;
            if logit >= least && best.is_none_or(|(most, _)| value > most) {
                best = Some((value, class));
            }
        }
        best.map_or(0, |(_, class)| class)
    }
}

/// `unconditional + (conditional - unconditional) scale`.
pub fn guided<T: Real>(conditional: &[T], unconditional: &[T], scale: f64) -> Vec<T> {
    let scale = T::from_f64(scale);
    conditional.iter().zip(unconditional).map(|(&with, &without)| without + (with - without) * scale).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_filter_keeps_a_tenth_rounded_up() {
        let kept = |classes| Choice::PUBLISHED.kept(classes);
        assert_eq!([kept(64), kept(65), kept(512), kept(513), kept(3), kept(1)], [7, 7, 52, 52, 1, 1]);
        assert_eq!(Choice { filter: 1.0, ..Choice::PUBLISHED }.kept(8), 1);
        assert_eq!(Choice { filter: 0.0, ..Choice::PUBLISHED }.kept(8), 8);
    }

    /// Gumbel noise draws from the softmax: shares of many draws against it, over the classes that stay.
    #[test]
    fn draws_have_the_probabilities_of_what_stays() {
        let logits = [0.3_f64, -0.2, 1.1, 0.9, -3.0];
        let choice = Choice { temperature: 1.0, filter: 0.4 };
        let mut state = 7_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        let mut counts = [0.0; 5];
        for _ in 0..20_000 {
            counts[choice.draw(&logits, &mut uniform)] += 1.0 / 20_000.0;
        }
        let total: f64 = [0, 2, 3].iter().map(|&i: &usize| logits[i].exp()).sum();
        for (class, share) in counts.into_iter().enumerate() {
            let wanted = if [0, 2, 3].contains(&class) { logits[class].exp() / total } else { 0.0 };
            assert!((share - wanted).abs() < 0.015, "{class}: {share} {wanted}");
        }
        assert_eq!(choice.draw(&logits, || 0.0), 2, "no noise is infinite");
    }
}
