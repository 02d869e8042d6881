//! Rows to what others attend to: `x_i += position[i]`, blocks with self-attention, `h = LN(x)`, and the mean of `h_i` over i.

use super::block::{Stack, StackScratch, TransformerConfig};
use super::embedding::Embedding;
use super::norm::LayerNorm;
use crate::blob::{Error, Tensors};
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;

/// An encoder in flash.
#[derive(Debug, Clone, Copy)]
pub struct Encoder<'a> {
    position: Embedding<'a>,
    stack: Stack<'a>,
    norm: LayerNorm<'a>,
}

impl<'a> Encoder<'a> {
    /// Reads positions, blocks and norm from the next tensors, for at most `rows` rows, and checks that activations stay finite
    /// when the rows before their positions are added are at most `bound` in magnitude.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor.
    pub fn open(tensors: &mut Tensors<'a>, rows: u16, config: TransformerConfig, bound: f32) -> Result<Self, Error> {
        let position = Embedding::open(tensors, rows, config.width)?;
        let stack = Stack::open(tensors, config, None)?;
        stack.bound(bound + position.bound(), 0.0, 0.0)?;
        let norm = LayerNorm::open(tensors, config.width, config.epsilon)?;
        Ok(Encoder { position, stack, norm })
    }

    /// A bound of the rows it makes, and of their mean.
    #[must_use]
    pub fn bound(&self) -> f32 {
        self.norm.bound()
    }

    /// Its blocks.
    #[must_use]
    pub const fn stack(&self) -> &Stack<'a> {
        &self.stack
    }

    /// Encodes `x [n][d]` in place, its mean into `mean [d]`.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn forward(
        &self,
        x: &mut [f32],
        mean: &mut [f32],
        scratch: &mut StackScratch<'_, '_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        let width = mean.len().max(1);
        for (i, row) in x.chunks_exact_mut(width).enumerate() {
            self.position.add(i, row);
        }
        for block in self.stack.blocks() {
            block.forward(x, &mut scratch.own, None, None, scratch.block);
            check()?;
        }
        self.norm.forward_in_place(x);
        mean.fill(0.0);
        for row in x.chunks_exact(width) {
            for (sum, v) in mean.iter_mut().zip(row) {
                *sum += *v;
            }
        }
        let count = (x.len() / width) as f32;
        for v in mean {
            *v /= count;
        }
        ControlFlow::Continue(())
    }
}
