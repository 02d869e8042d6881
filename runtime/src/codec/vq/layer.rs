//! What a decoder consists of: its layers in order, and which rows each of them needs.

use super::decoder::Decoder;
use crate::blob::{MAX_BLOCKS, MAX_STAGES};
use crate::nn::conv1d::Conv1d;
use crate::nn::output::Output;
use crate::nn::residual::Residual;

/// Layers a decoder may have.
pub(super) const MAX_LAYERS: usize = 3 + MAX_STAGES * (MAX_BLOCKS + 1);

/// Which way rows pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Direction {
    /// From the embeddings to the features.
    Forward,
    /// Gradients, from the features to the embeddings.
    Back,
}

/// A layer of the chain.
#[derive(Debug, Clone, Copy)]
pub(super) enum Layer<'d, 'a> {
    /// Convolution, then ReLU.
    Convolution(&'d Conv1d<'a>),
    /// Residual block.
    Residual(&'d Residual<'a>),
    /// Every row twice, then convolution.
    Upsample(&'d Conv1d<'a>),
    /// The last convolution. It takes gradients from the features themselves: on the way back rows begin behind it.
    Output(&'d Output<'a>),
}

impl Layer<'_, '_> {
    /// Channels of the rows that enter.
    pub(super) const fn width(&self, way: Direction) -> usize {
        match (self, way) {
            (Layer::Convolution(conv) | Layer::Upsample(conv), Direction::Forward) => conv.inputs(),
            (Layer::Convolution(conv) | Layer::Upsample(conv), Direction::Back) => conv.outputs(),
            (Layer::Residual(block), _) => block.conv1.inputs(),
            (Layer::Output(output), _) => output.inputs(),
        }
    }

    /// Rows before a row and behind it that what leaves the layer there depends on, forward; for an upsampling they count after it.
    #[inline(never)]
    const fn padding(&self) -> (usize, usize) {
        match self {
            Layer::Convolution(conv) | Layer::Upsample(conv) => (conv.left(), conv.right()),
            Layer::Residual(block) => (block.conv1.left(), block.conv1.right()),
            Layer::Output(output) => (output.left(), output.right()),
        }
    }

    /// Rows that must have come after a row before what leaves the layer there is final. Forward an upsampling counts in copies: the second
    /// copy of a row may look at the first copy of the next.
    pub(super) const fn ahead(&self, way: Direction) -> usize {
        let (left, right) = self.padding();
        match way {
            Direction::Forward => right,
            // What a row looked back at, a gradient looks ahead at.
            Direction::Back => left,
        }
    }

    /// Rows before a row that what leaves the layer there depends on; so many rows behind the first that is kept lies the next result.
    pub(super) const fn behind(&self, way: Direction) -> usize {
        let (left, right) = self.padding();
        match way {
            Direction::Forward => left,
            Direction::Back => right,
        }
    }

    /// Quantised rows that the next results still depend on.
    pub(super) const fn kept(&self, way: Direction) -> usize {
        match (self, way) {
            (Layer::Upsample(_), Direction::Forward) => 1,
            (Layer::Upsample(_), Direction::Back) => 0,
            _ => self.ahead(way) + self.behind(way),
        }
    }

    /// Rows as they were that the next results are added to or made of, at most.
    pub(super) const fn skipped(&self, way: Direction) -> usize {
        match (self, way) {
            (Layer::Residual(_), _) => self.ahead(way),
            // Both rows beside the next row's copies, and a copy if the other is yet to come.
            (Layer::Upsample(_), Direction::Back) => 3,
            _ => 0,
        }
    }

    /// Rows of ReLUs' bits for each row of the layer.
    pub(super) const fn gates(&self) -> usize {
        match self {
            Layer::Convolution(_) => 1,
            // Its input's, then its hidden rows'.
            Layer::Residual(_) => 2,
            Layer::Upsample(_) | Layer::Output(_) => 0,
        }
    }
}

impl<'a> Decoder<'a> {
    /// Layer `index` in order of execution, and the upsampling stages that lie before it.
    #[inline(never)]
    fn layer(&self, index: usize) -> Option<(usize, Layer<'_, 'a>)> {
        let Some(mut at) = index.checked_sub(1) else { return Some((0, Layer::Convolution(&self.input))) };
        for (stage, layers) in self.stages.iter().enumerate() {
            if let Some(block) = layers.blocks.get(at) {
                return Some((stage, Layer::Residual(block)));
            }
            if at == layers.blocks.len() {
                return Some((stage, Layer::Upsample(&layers.upsample)));
            }
            at -= layers.blocks.len() + 1;
        }
        match at {
            0 => Some((self.stages.len(), Layer::Convolution(&self.middle))),
            1 => Some((self.stages.len(), Layer::Output(&self.output))),
            _ => None,
        }
    }

    /// Layers in order of execution, each with the upsampling stages before it.
    pub(super) fn layers(&self) -> impl Iterator<Item = (usize, Layer<'_, 'a>)> {
        (0..MAX_LAYERS).map_while(|index| self.layer(index))
    }

    /// The same in the order in which rows pass them, from the last but one for gradients, each with how often rows are doubled where
    /// they enter.
    pub(super) fn passed(&self, way: Direction) -> impl Iterator<Item = (usize, Layer<'_, 'a>)> {
        let before_output = self.layers().count().saturating_sub(2);
        (0..MAX_LAYERS).map_while(move |place| match way {
            Direction::Forward => self.layer(place),
            Direction::Back => {
                let (stage, layer) = self.layer(before_output.checked_sub(place)?)?;
                Some((stage + usize::from(matches!(layer, Layer::Upsample(_))), layer))
            }
        })
    }

    /// Rows of ReLUs' bits of a motion of so many tokens.
    pub(super) fn gates(&self, tokens: usize) -> usize {
        self.layers().fold(0, |sum, (stage, layer)| sum + layer.gates() * (tokens << stage))
    }
}
