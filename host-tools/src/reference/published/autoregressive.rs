//! Autoregressive planning (T2M-GPT 3.2): a token at a time until the stop class.

use crate::reference::real::Real;

/// Plans at most `longest` tokens. `logits` gives `[V + 1]` behind the tokens so far, `choose` one of these classes; class V is the end.
///
/// A first choice of the end is a motion of no tokens.
pub fn plan<T: Real>(
    longest: usize,
    mut logits: impl FnMut(&[usize]) -> Vec<T>,
    mut choose: impl FnMut(&[T]) -> usize,
) -> Vec<usize> {
    let mut tokens = Vec::new();
    while tokens.len() < longest {
        let row = logits(&tokens);
        let class = choose(&row);
        if class + 1 == row.len() {
            break;
        }
        tokens.push(class);
    }
    tokens
}
