//! What comes behind a planner's last block: hidden rows, then logits.

use super::request::MAX_GUIDANCE;
use crate::blob::{Error, HeadConfig, Tensors};
use crate::model::MAX_MAGNITUDE;
use crate::nn::block::{BlockScratch, TransformerConfig, below};
use crate::nn::linear::Linear;
use crate::nn::norm::LayerNorm;

/// `h = LN x`, or `h = LN gelu(dense x)`; `logits = out h`.
#[derive(Debug, Clone, Copy)]
pub struct Head<'a> {
    #[cfg(feature = "masked")]
    dense: Option<Linear<'a>>,
    norm: LayerNorm<'a>,
    out: Linear<'a>,
}

impl<'a> Head<'a> {
    /// Reads it from the next tensors, for logits of so many classes. With `embeds` the rows of its last layer are embeddings as well.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor.
    pub fn open(
        tensors: &mut Tensors<'a>,
        config: &TransformerConfig,
        kind: HeadConfig,
        classes: u16,
        embeds: bool,
    ) -> Result<Self, Error> {
        let width = config.width;
        #[cfg(feature = "masked")]
        let dense = match kind {
            HeadConfig::Norm => None,
            HeadConfig::Dense { .. } => Some(Linear::open(tensors, width, width)?),
        };
        let epsilon = match kind {
            HeadConfig::Dense { epsilon } => epsilon,
            HeadConfig::Norm => config.epsilon,
        };
        let norm = LayerNorm::open(tensors, width, epsilon)?;
        let index = tensors.index();
        let out = Linear::open(tensors, width, classes)?;
        if embeds && (out.packed() || out.wide()) {
            return Err(Error::TensorShape { index, found: 0, expected: out.macs() as u32 });
        }
        // Guidance stretches hidden rows before they meet the last layer.
        below(out.bound((1.0 + 2.0 * MAX_GUIDANCE) * norm.bound()), MAX_MAGNITUDE, index)?;
        Ok(Head {
            #[cfg(feature = "masked")]
            dense,
            norm,
            out,
        })
    }

    /// Refuses another last layer, tensor `index`, whose logits could leave their range.
    #[cfg(feature = "residual")]
    pub fn check(&self, out: &Linear<'_>, index: u16) -> Result<(), Error> {
        below(out.bound((1.0 + 2.0 * MAX_GUIDANCE) * self.norm.bound()), MAX_MAGNITUDE, index).map(|_| ())
    }

    /// The same with another last layer.
    #[cfg(feature = "residual")]
    #[must_use]
    pub const fn with(self, out: Linear<'a>) -> Self {
        Head { out, ..self }
    }

    /// A bound of what the norm is given, for rows of at most so much.
    pub fn inner_bound(&self, rows: f32) -> f32 {
        #[cfg(feature = "masked")]
        if let Some(dense) = &self.dense {
            return dense.bound(rows);
        }
        rows
    }

    /// The layer that makes logits of hidden rows.
    pub const fn out(&self) -> &Linear<'a> {
        &self.out
    }

    /// Multiply-accumulates of a hidden row.
    pub const fn hidden_macs(&self) -> u64 {
        #[cfg(feature = "masked")]
        if let Some(dense) = &self.dense {
            return dense.macs();
        }
        0
    }

    /// Rows `x [R][d]` to hidden ones, in place.
    pub fn hide(&self, x: &mut [f32], scratch: &mut BlockScratch<'_>) {
        #[cfg(feature = "masked")]
        if let Some(dense) = &self.dense {
            scratch.replace(dense, x);
            crate::nn::activation::apply(crate::nn::activation::Activation::Gelu, x);
        }
        let _ = &scratch;
        self.norm.forward_in_place(x);
    }

    /// Logits `[R][V]` of hidden rows `h [R][d]`, no more rows than `scratch` has room for.
    pub fn logits(&self, h: &[f32], logits: &mut [f32], scratch: &mut BlockScratch<'_>) {
        scratch.linear(&self.out, h, logits);
    }
}
