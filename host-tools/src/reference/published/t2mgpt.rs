//! T2M-GPT's network.

use crate::checkpoint::published::t2mgpt::{self as source, FORM};
use crate::reference::real::Real;
use crate::reference::transformer::{Block, Embedding, LayerNorm, Linear, Sight};

/// The transformer.
#[derive(Debug, Clone)]
pub struct Gpt<T> {
    /// Codes V; class V ends the motion.
    pub codes: usize,
    /// Rows there may be, the text's with them.
    pub places: usize,
    width: usize,
    base: usize,
    condition: Linear<T>,
    tokens: Embedding<T>,
    positions: Embedding<T>,
    layers: Vec<Block<T>>,
    norm: LayerNorm<T>,
    output: Linear<T>,
}

impl<T: Real> Gpt<T> {
    /// From a checkpoint.
    #[must_use]
    pub fn new(source: &source::Gpt) -> Self {
        Self {
            codes: source.codes,
            places: source.positions.rows,
            width: source.sizes.width,
            base: source.base,
            condition: Linear::new(&source.condition),
            tokens: Embedding::new(&source.tokens),
            positions: Embedding::new(&source.positions),
            layers: source.layers.iter().map(|layer| Block::new(layer, source.sizes.heads, FORM)).collect(),
            norm: LayerNorm::new(&source.norm, FORM.epsilon),
            output: Linear::new(&source.output),
        }
    }

    /// Numbers of a text's vector.
    #[must_use]
    pub fn text_width(&self) -> usize {
        self.condition.inputs
    }

    /// Rows `[1 + L][d]` behind the first part, and behind the second.
    ///
    /// # Panics
    /// For a token above V + 1, a text of another width, or more rows than there may be.
    #[must_use]
    pub fn rows(&self, tokens: &[usize], text: &[T]) -> [Vec<T>; 2] {
        let mut x = self.condition.forward(text);
        x.extend(tokens.iter().flat_map(|&token| self.tokens.row(token).iter().copied()));
        x.chunks_exact_mut(self.width).enumerate().for_each(|(place, row)| self.positions.add(place, row));
        self.layers[..self.base].iter().for_each(|layer| layer.forward_seeing(&mut x, Sight::Causal));
        let base = x.clone();
        self.layers[self.base..].iter().for_each(|layer| layer.forward_seeing(&mut x, Sight::Causal));
        [base, x]
    }

    /// Logits `[1 + L][V + 1]`: behind the text and behind each token.
    ///
    /// # Panics
    /// As [`Gpt::rows`].
    #[must_use]
    pub fn logits(&self, tokens: &[usize], text: &[T]) -> Vec<T> {
        let [_, rows] = self.rows(tokens, text);
        self.output.forward(&self.norm.forward(&rows))
    }
}
