//! Residual planning (MoMask 3.3): one pass for each layer of codes behind the first.

use super::draw::Choice;
use crate::reference::real::Real;

/// Draws layers 1 to Q - 1 of `tokens` `[L][Q]`, whose layer 0 is there. `logits` gives `[L][V + 1]` of a layer, given the tokens of those before;
/// `uniform` the number of a layer, position and class. A token V, which may be drawn, is used as it is by the layers that follow.
///
/// # Panics
/// When `logits` gives other shapes.
pub fn plan<T: Real>(
    tokens: &mut [usize],
    (quantizers, codes): (usize, usize),
    choice: &Choice,
    mut logits: impl FnMut(&[usize], usize) -> Vec<T>,
    mut uniform: impl FnMut(usize, usize, usize) -> f32,
) {
    for layer in 1..quantizers {
        let all = logits(tokens, layer);
        for (position, logits) in all.chunks_exact(codes + 1).enumerate() {
            let mut class = 0;
            tokens[position * quantizers + layer] = choice.draw(logits, || {
                class += 1;
                uniform(layer, position, class - 1)
            });
        }
    }
}
