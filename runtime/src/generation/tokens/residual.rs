//! The transformer that plans the further quantizers of a motion whose first are planned (MoMask 3.4): one pass each.
//!
//! Rows of quantizer q: `condition(text)`, `quantizer[q]`, then a row a token, `sum_{j < q} table_j[id_j] + position[i]`; blocks with self-attention
//! over all rows; hidden rows of a [`Head`] whose last layer is the quantizer's own. Class V of the logits, behind the codes, stands for nothing: it may be
//! drawn, comes in as an embedding of its own, and adds nothing to the motion.

use super::head::Head;
use crate::blob::{Error, HeadConfig, ResidualConfig, Tensors};
use crate::codec::codebook::Codebooks;
use crate::nn::attention::Heads;
use crate::nn::block::{BlockScratch, Sizes, Stack, StackScratch, below};
use crate::nn::embedding::Embedding;
use crate::nn::linear::Linear;
use crate::nn::norm::MAX_INPUT;
use crate::stop::{Check, Stop};
use crate::text::Text;
use core::ops::ControlFlow;

/// The planner of further quantizers in flash.
#[derive(Debug, Clone, Copy)]
pub struct Residual<'a> {
    guidance: f32,
    codes: u16,
    condition: Linear<'a>,
    quantizer: Embedding<'a>,
    position: Embedding<'a>,
    stack: Stack<'a>,
    /// With the last layer of the second quantizer.
    head: Head<'a>,
    /// What tokens of each quantizer but the last come in as, left in the tensor table.
    tables: Tensors<'a>,
    /// Last layers of the third quantizer and on, likewise.
    outs: Tensors<'a>,
    quantizers: u16,
}

impl<'a> Residual<'a> {
    /// Reads it from the next tensors, for motions of up to so many tokens, and checks that activations stay finite.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor.
    pub fn open(
        tensors: &mut Tensors<'a>,
        config: &ResidualConfig,
        text: &Text<'_>,
        codebooks: &Codebooks<'_>,
        max_tokens: u16,
    ) -> Result<Self, Error> {
        let ResidualConfig { transformer, epsilon, guidance } = *config;
        let (width, first) = (transformer.width, tensors.index());
        let dims = u16::try_from(text.width()).map_err(|_| Error::Manifest)?;
        let codes = u16::try_from(codebooks.codes()).map_err(|_| Error::Manifest)?;
        let quantizers = u16::try_from(codebooks.quantizers()).map_err(|_| Error::Manifest)?;
        let classes = codes.saturating_add(1);
        let condition = Linear::open(tensors, dims, width)?;
        let quantizer = Embedding::open(tensors, quantizers, width)?;
        let position = Embedding::open(tensors, max_tokens, width)?;
        let (tables, mut rows) = (tensors.trusted(), position.bound());
        for _ in 1..quantizers {
            rows += Embedding::open(tensors, classes, width)?.bound();
        }
        let stack = Stack::open(tensors, transformer, None)?;
        let head = Head::open(tensors, &transformer, HeadConfig::Dense { epsilon }, classes, false)?;
        let outs = tensors.trusted();
        for _ in 2..quantizers {
            let index = tensors.index();
            head.check(&Linear::open(tensors, width, classes)?, index)?;
        }
        let others = [condition.bound(text.bound()), quantizer.bound()];
        let rows = others.into_iter().fold(rows, |bound, other| if other > bound { other } else { bound });
        let rows = stack.bound(below(rows, MAX_INPUT, first)?, 0.0, 0.0)?;
        below(head.inner_bound(rows), MAX_INPUT, first)?;
        Ok(Residual { guidance, codes, condition, quantizer, position, stack, head, tables, outs, quantizers })
    }

    /// Width of a row.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.stack.config().width as usize
    }

    /// Whether keys and values have 16 bits.
    #[cfg(feature = "wide-layers")]
    #[must_use]
    pub const fn wide(&self) -> bool {
        self.stack.wide()
    }

    /// How it is split.
    #[must_use]
    pub const fn heads(&self) -> Heads {
        self.stack.heads()
    }

    /// How strongly the text guides.
    #[must_use]
    pub const fn guidance(&self) -> f32 {
        self.guidance
    }

    /// Whether that takes a second pass.
    #[must_use]
    pub fn guided(&self) -> bool {
        self.guidance != 1.0
    }

    /// Behind the last block, of a quantizer from 1 on.
    #[must_use]
    pub fn head(&self, quantizer: usize) -> Head<'a> {
        let (mut outs, mut head) = (self.outs, self.head);
        for _ in 1..quantizer {
            // They opened once, so they open again.
            let out = Linear::open(&mut outs, self.stack.config().width, self.codes.saturating_add(1));
            invariant!(out.is_ok(), "{out:?}");
            head = out.map_or(head, |out| head.with(out));
        }
        head
    }

    /// What a [`BlockScratch`](crate::nn::block::BlockScratch) must serve for so many tokens.
    #[must_use]
    pub fn sizes(&self, tokens: usize) -> Sizes {
        let inputs = self.condition.inputs();
        self.stack.sizes(2 + tokens, 0, 0).with(Sizes { inputs, ..Sizes::default() })
    }

    /// Multiply-accumulates of all passes over so many tokens, logits included.
    #[must_use]
    pub fn macs(&self, tokens: usize) -> u64 {
        let (rows, all) = (2 + tokens, u64::from(self.quantizers.saturating_sub(1)));
        let pass = self.condition.macs() + self.stack.macs(rows, 0, 0) + rows as u64 * self.head.hidden_macs();
        let passes = if self.guided() { 2 } else { 1 };
        all * (passes * pass + tokens as u64 * self.head.out().macs())
    }

    /// One pass for `quantizer`: hidden rows into `x [2 + L][d]`, given a text's vector and the tokens `[L][Q]` of the quantizers before.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn forward(
        &self,
        quantizer: usize,
        text: &[f32],
        (tokens, quantizers): (&[u16], usize),
        x: &mut [f32],
        scratch: &mut StackScratch<'_, '_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        let width = self.width().max(1);
        self.begin(quantizer, text, part_mut!(x, ..2 * width), scratch.block);
        let others = part_mut!(x, 2 * width..);
        others.fill(0.0);
        let mut tables = self.tables;
        for before in 0..quantizer {
            let table = Embedding::open(&mut tables, self.codes.saturating_add(1), self.stack.config().width);
            invariant!(table.is_ok(), "{table:?}");
            let Ok(table) = table else { break };
            for (tokens, row) in tokens.chunks_exact(quantizers.max(1)).zip(others.chunks_exact_mut(width)) {
                let token = tokens.get(before).map_or(self.codes, |token| (*token).min(self.codes));
                table.add(usize::from(token), row);
            }
        }
        for (i, row) in others.chunks_exact_mut(width).enumerate() {
            self.position.add(i, row);
        }
        for block in self.stack.blocks() {
            block.forward(x, &mut scratch.own, None, None, scratch.block);
            check()?;
        }
        self.head.hide(x, scratch.block);
        ControlFlow::Continue(())
    }

    /// The rows in front of the tokens'.
    fn begin(&self, quantizer: usize, text: &[f32], rows: &mut [f32], scratch: &mut BlockScratch<'_>) {
        let Some((first, second)) = rows.split_at_mut_checked(self.width()) else { return };
        scratch.linear(&self.condition, text, first);
        second.fill(0.0);
        self.quantizer.add(quantizer, second);
    }
}
