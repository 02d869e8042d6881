//! The transformer that plans the further quantizers of a motion whose first are planned (MoMask 3.4): one pass each.
//!
//! Rows of quantizer q: `condition(text)`, `quantizer[q]`, then a row a token, `sum_{j < q} table_j[id_j] + position[i]`; blocks with self-attention
//! over all rows; hidden rows of a [`Head`] whose last layer is the quantizer's own. Class V of the logits, behind the codes, stands for nothing: it may be
//! drawn, comes in as an embedding of its own, and adds nothing to the motion.

use super::head::Head;
use crate::blob::{Error, HeadConfig, ResidualConfig, Tensors};
use crate::codec::codebook::Codebooks;
use crate::nn::attention::Heads;
use crate::nn::block::{self, Sizes, Stack, StackScratch, below, heads};
use crate::nn::embedding::Embedding;
use crate::nn::linear::Linear;
use crate::nn::norm::MAX_INPUT;
use crate::stop::{Check, Stop};
use crate::text::Text;
use core::ops::ControlFlow;

/// The planner of further quantizers. Its layers stay in the tensor table and are resolved when they are used, as a stack's blocks are.
#[derive(Debug, Clone, Copy)]
pub struct Residual<'a> {
    config: ResidualConfig,
    /// Numbers of a text's vector.
    text: u16,
    codes: u16,
    quantizers: u16,
    max_tokens: u16,
    /// Weights, keys and values have 16 bits.
    #[cfg(feature = "wide-layers")]
    wide: bool,
    first: Tensors<'a>,
}

/// Its layers.
#[derive(Debug, Clone, Copy)]
struct Layers<'a> {
    condition: Linear<'a>,
    quantizer: Embedding<'a>,
    position: Embedding<'a>,
    /// What tokens of each quantizer but the last come in as.
    tables: Tensors<'a>,
    stack: Stack<'a>,
    /// With the last layer of the second quantizer.
    head: Head<'a>,
    /// Last layers of the third quantizer and on.
    outs: Tensors<'a>,
}

impl<'a> Residual<'a> {
    /// Checks it in the next tensors, for motions of up to so many tokens, and that activations stay finite.
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
        let first = tensors.index();
        let small = |value: usize| u16::try_from(value).map_err(|_| Error::Manifest);
        let residual = Residual {
            config: *config,
            text: small(text.width())?,
            codes: small(codebooks.codes())?,
            quantizers: small(codebooks.quantizers())?,
            max_tokens,
            #[cfg(feature = "wide-layers")]
            wide: false,
            first: tensors.trusted(),
        };
        let Layers { condition, quantizer, position, mut tables, stack, head, mut outs } = residual.layers(tensors)?;
        let mut rows = position.bound();
        for _ in 1..residual.quantizers {
            rows += residual.table(&mut tables)?.bound();
        }
        for _ in 2..residual.quantizers {
            let index = outs.index();
            head.check(&residual.out(&mut outs)?, index)?;
        }
        let others = [condition.bound(text.bound()), quantizer.bound()];
        let rows = others.into_iter().fold(rows, |bound, other| if other > bound { other } else { bound });
        let rows = stack.bound(below(rows, MAX_INPUT, first)?, 0.0, 0.0)?;
        below(head.inner_bound(rows), MAX_INPUT, first)?;
        Ok(Residual {
            #[cfg(feature = "wide-layers")]
            wide: stack.wide(),
            ..residual
        })
    }

    /// Reads its layers from the next tensors.
    #[inline(never)]
    fn layers(&self, tensors: &mut Tensors<'a>) -> Result<Layers<'a>, Error> {
        let ResidualConfig { transformer, epsilon, .. } = self.config;
        let width = transformer.width;
        let condition = Linear::open(tensors, self.text, width)?;
        let quantizer = Embedding::open(tensors, self.quantizers, width)?;
        let position = Embedding::open(tensors, self.max_tokens, width)?;
        let tables = tensors.trusted();
        for _ in 1..self.quantizers {
            self.table(tensors)?;
        }
        let stack = Stack::open(tensors, transformer, None)?;
        let head = Head::open(tensors, &transformer, HeadConfig::Dense { epsilon }, self.classes(), false)?;
        let outs = tensors.trusted();
        for _ in 2..self.quantizers {
            self.out(tensors)?;
        }
        Ok(Layers { condition, quantizer, position, tables, stack, head, outs })
    }

    /// Those that opened once.
    fn opened(&self) -> Option<Layers<'a>> {
        let layers = self.layers(&mut { self.first });
        invariant!(layers.is_ok(), "{layers:?}");
        layers.ok()
    }

    /// The next table of tokens.
    fn table(&self, tensors: &mut Tensors<'a>) -> Result<Embedding<'a>, Error> {
        Embedding::open(tensors, self.classes(), self.config.transformer.width)
    }

    /// The next last layer.
    fn out(&self, tensors: &mut Tensors<'a>) -> Result<Linear<'a>, Error> {
        Linear::open(tensors, self.config.transformer.width, self.classes())
    }

    const fn classes(&self) -> u16 {
        self.codes.saturating_add(1)
    }

    /// Width of a row.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.config.transformer.width as usize
    }

    /// Whether keys and values have 16 bits.
    #[cfg(feature = "wide-layers")]
    #[must_use]
    pub const fn wide(&self) -> bool {
        self.wide
    }

    /// How it is split.
    #[must_use]
    pub const fn heads(&self) -> Heads {
        heads(&self.config.transformer)
    }

    /// How strongly the text guides.
    #[must_use]
    pub const fn guidance(&self) -> f32 {
        self.config.guidance
    }

    /// Whether that takes a second pass.
    #[must_use]
    pub fn guided(&self) -> bool {
        self.config.guidance != 1.0
    }

    /// Behind the last block, of a quantizer from 1 on.
    #[must_use]
    pub fn head(&self, quantizer: usize) -> Option<Head<'a>> {
        let Layers { mut head, mut outs, .. } = self.opened()?;
        for _ in 1..quantizer {
            head = head.with(self.out(&mut outs).ok()?);
        }
        Some(head)
    }

    /// What a [`BlockScratch`](crate::nn::block::BlockScratch) must serve for so many tokens.
    #[must_use]
    pub fn sizes(&self, tokens: usize) -> Sizes {
        block::sizes(&self.config.transformer, usize::from(self.text), 2 + tokens, 0)
    }

    /// Multiply-accumulates of all passes over so many tokens, logits included.
    #[must_use]
    pub fn macs(&self, tokens: usize) -> u64 {
        let Some(Layers { condition, stack, head, .. }) = self.opened() else { return 0 };
        let (rows, all) = (2 + tokens, u64::from(self.quantizers.saturating_sub(1)));
        let pass = condition.macs() + stack.macs(rows, 0, 0) + rows as u64 * head.hidden_macs();
        let passes = if self.guided() { 2 } else { 1 };
        all * (passes * pass + tokens as u64 * head.out().macs())
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
        let Some(Layers { condition, quantizer: number, position, mut tables, stack, head, .. }) = self.opened() else {
            return ControlFlow::Continue(());
        };
        let width = self.width().max(1);
        if let Some((first, rest)) = x.split_at_mut_checked(width) {
            scratch.block.linear(&condition, text, first);
            let second = part_mut!(rest, ..width);
            second.fill(0.0);
            number.add(quantizer, second);
        }
        let others = part_mut!(x, 2 * width..);
        others.fill(0.0);
        for before in 0..quantizer {
            let table = self.table(&mut tables);
            invariant!(table.is_ok(), "{table:?}");
            let Ok(table) = table else { break };
            for (tokens, row) in tokens.chunks_exact(quantizers.max(1)).zip(others.chunks_exact_mut(width)) {
                let token = tokens.get(before).map_or(self.codes, |token| (*token).min(self.codes));
                table.add(usize::from(token), row);
            }
        }
        for (i, row) in others.chunks_exact_mut(width).enumerate() {
            position.add(i, row);
        }
        for block in stack.blocks() {
            block.forward(x, &mut scratch.own, None, None, scratch.block);
            check()?;
        }
        head.hide(x, scratch.block);
        ControlFlow::Continue(())
    }
}
