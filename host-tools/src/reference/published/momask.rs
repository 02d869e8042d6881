//! MoMask's networks.

use super::draw::guided;
use crate::checkpoint::prior::Activation;
use crate::checkpoint::published::momask::{self as source, FORM, HEAD_EPSILON};
use crate::reference::real::Real;
use crate::reference::transformer::{Block, Embedding, LayerNorm, Linear, Sight, activate, add};

/// What both transformers have in common.
#[derive(Debug, Clone)]
struct Trunk<T> {
    width: usize,
    condition: Linear<T>,
    input: Linear<T>,
    positions: Embedding<T>,
    layers: Vec<Block<T>>,
    dense: Linear<T>,
    norm: LayerNorm<T>,
    output: Linear<T>,
}

/// Rows as they enter the first layer and as they leave each.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace<T> {
    /// `[1 + L][d]`, the condition first.
    pub input: Vec<T>,
    /// The same behind each layer.
    pub layers: Vec<Vec<T>>,
}

impl<T: Real> Trunk<T> {
    fn new(source: &source::Trunk) -> Self {
        Self {
            width: source.sizes.width,
            condition: Linear::new(&source.condition),
            input: Linear::new(&source.input),
            positions: Embedding::new(&source.positions),
            layers: source.layers.iter().map(|layer| Block::new(layer, source.sizes.heads, FORM)).collect(),
            dense: Linear::new(&source.dense),
            norm: LayerNorm::new(&source.norm, HEAD_EPSILON),
            output: Linear::new(&source.output),
        }
    }

    /// Rows of a text's vector; of no text those of zeros.
    fn row_of_text(&self, text: Option<&[T]>) -> Vec<T> {
        match text {
            Some(text) => self.condition.forward(text),
            None => self.condition.forward(&vec![T::ZERO; self.condition.inputs]),
        }
    }

    /// Rows `[L][d]` of embeddings `[L][code]`, with their places.
    fn rows(&self, embeddings: &[T]) -> Vec<T> {
        let mut rows = self.input.forward(embeddings);
        rows.chunks_exact_mut(self.width).enumerate().for_each(|(place, row)| self.positions.add(place, row));
        rows
    }

    /// Through all layers; of `first` rows and the tokens behind them those that are no padding are seen.
    fn layers(&self, mut x: Vec<T>, seen: usize) -> Trace<T> {
        let input = x.clone();
        let layer = |layer: &Block<T>| {
            layer.forward_seeing(&mut x, Sight::First(seen));
            x.clone()
        };
        let layers = self.layers.iter().map(layer).collect();
        Trace { input, layers }
    }

    /// Outputs for rows.
    fn head(&self, rows: &[T]) -> Vec<T> {
        let mut x = self.dense.forward(rows);
        activate(&mut x, Activation::Gelu);
        self.output.forward(&self.norm.forward(&x))
    }
}

/// The mask transformer.
#[derive(Debug, Clone)]
pub struct Mask<T> {
    /// Codes V: as a token what is to be planned, V + 1 padding.
    pub codes: usize,
    trunk: Trunk<T>,
    tokens: Embedding<T>,
}

impl<T: Real> Mask<T> {
    /// From a checkpoint.
    #[must_use]
    pub fn new(source: &source::Mask) -> Self {
        Self { codes: source.codes, trunk: Trunk::new(&source.trunk), tokens: Embedding::new(&source.tokens) }
    }

    /// Numbers of a text's vector.
    #[must_use]
    pub fn text_width(&self) -> usize {
        self.trunk.condition.inputs
    }

    /// The rows of tokens, and of a text's vector in front of them, through all layers. Padding is not seen.
    ///
    /// # Panics
    /// For a token above V + 1, or a text of another width.
    #[must_use]
    pub fn trace(&self, tokens: &[usize], text: Option<&[T]>) -> Trace<T> {
        let embeddings: Vec<T> = tokens.iter().flat_map(|&token| self.tokens.row(token).iter().copied()).collect();
        let rows = [self.trunk.row_of_text(text), self.trunk.rows(&embeddings)].concat();
        let valid = tokens.iter().take_while(|token| **token != self.codes + 1).count();
        self.trunk.layers(rows, 1 + valid)
    }

    /// Logits `[L][V]`.
    ///
    /// # Panics
    /// As [`Mask::trace`].
    #[must_use]
    pub fn logits(&self, tokens: &[usize], text: Option<&[T]>) -> Vec<T> {
        let trace = self.trace(tokens, text);
        let last = trace.layers.last().unwrap_or(&trace.input);
        self.trunk.head(&last[self.trunk.width..])
    }

    /// Guided logits `[L][V]`.
    ///
    /// # Panics
    /// As [`Mask::trace`].
    #[must_use]
    pub fn guided(&self, tokens: &[usize], text: &[T], scale: f64) -> Vec<T> {
        guided(&self.logits(tokens, Some(text)), &self.logits(tokens, None), scale)
    }
}

/// The residual transformer.
#[derive(Debug, Clone)]
pub struct Residual<T> {
    /// Codes V of each layer: as a token nothing at all.
    pub codes: usize,
    /// Layers of codes.
    pub quantizers: usize,
    trunk: Trunk<T>,
    quantizer: Linear<T>,
    inputs: Vec<Embedding<T>>,
    outputs: Vec<Linear<T>>,
}

impl<T: Real> Residual<T> {
    /// From a checkpoint.
    #[must_use]
    pub fn new(source: &source::Residual) -> Self {
        Self {
            codes: source.codes,
            quantizers: source.quantizers,
            trunk: Trunk::new(&source.trunk),
            quantizer: Linear::new(&source.quantizer),
            inputs: source.tables.iter().map(|table| Embedding::new(&table.input)).collect(),
            outputs: source.tables.iter().map(|table| Linear::new(&table.output)).collect(),
        }
    }

    /// Logits `[L][V + 1]` of layer `layer`, 1 to Q - 1, given the tokens `[L][Q]` of those before it; rows behind the first whose token of
    /// layer 0 is V are padding.
    ///
    /// # Panics
    /// For a token above V, a layer that there is not, or a text of another width.
    #[must_use]
    pub fn logits(&self, tokens: &[usize], layer: usize, text: Option<&[T]>) -> Vec<T> {
        let code = self.trunk.input.inputs;
        let positions = tokens.chunks_exact(self.quantizers);
        let valid = positions.clone().take_while(|position| position[0] != self.codes).count();
        let mut embeddings = vec![T::ZERO; positions.len() * code];
        for (sum, position) in embeddings.chunks_exact_mut(code).zip(positions) {
            for (table, token) in self.inputs.iter().zip(position).take(layer) {
                add(sum, table.row(*token));
            }
        }
        let mut which = vec![T::ZERO; self.quantizers];
        which[layer] = T::ONE;
        let first = [self.trunk.row_of_text(text), self.quantizer.forward(&which)].concat();
        let trace = self.trunk.layers([first, self.trunk.rows(&embeddings)].concat(), 2 + valid);
        let last = trace.layers.last().unwrap_or(&trace.input);
        self.outputs[layer - 1].forward(&self.trunk.head(&last[2 * self.trunk.width..]))
    }

    /// Guided logits `[L][V + 1]`.
    ///
    /// # Panics
    /// As [`Residual::logits`].
    #[must_use]
    pub fn guided(&self, tokens: &[usize], layer: usize, text: &[T], scale: f64) -> Vec<T> {
        guided(&self.logits(tokens, layer, Some(text)), &self.logits(tokens, layer, None), scale)
    }
}
