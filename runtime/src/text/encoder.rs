//! Words to a memory, one row a word, and a pooled vector.
//!
//! `x_i = row of w_i + position[i]`, blocks with self-attention, `memory = LN(x)`, `pooled = mean over i`.

use super::table::{WordIds, WordTable};
use crate::blob::{Error, Tensors, TextEncoderConfig};
use crate::nn::block::{Sizes, Stack, StackScratch};
use crate::nn::encoder::Encoder;
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;

/// The encoder in flash.
#[derive(Debug, Clone, Copy)]
pub struct TextEncoder<'a> {
    table: WordTable<'a>,
    encoder: Encoder<'a>,
}

impl<'a> TextEncoder<'a> {
    /// Reads the encoder of prompts of at most `max_words` words from the next tensors and checks that activations stay finite.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor or configuration value.
    pub fn open(tensors: &mut Tensors<'a>, config: &TextEncoderConfig<'a>, max_words: u16) -> Result<Self, Error> {
        let TextEncoderConfig { table, transformer } = config;
        let table = WordTable::open(tensors, table, transformer.width)?;
        let encoder = Encoder::open(tensors, max_words, *transformer, table.bound())?;
        Ok(TextEncoder { table, encoder })
    }

    /// The words it knows.
    #[must_use]
    pub const fn vocabulary(&self) -> &WordIds<'a> {
        self.table.ids()
    }

    /// A bound of memory and pooled vector.
    #[must_use]
    pub fn bound(&self) -> f32 {
        self.encoder.bound()
    }

    /// Its blocks.
    #[must_use]
    pub const fn stack(&self) -> &Stack<'a> {
        self.encoder.stack()
    }

    /// What a [`BlockScratch`] must serve for `words` words.
    #[must_use]
    pub fn sizes(&self, words: usize) -> Sizes {
        self.stack().sizes(words, 0, 0)
    }

    /// Multiply-accumulates of a text of `words` words.
    #[must_use]
    pub fn macs(&self, words: usize) -> u64 {
        self.stack().macs(words, 0, 0)
    }

    /// Encodes `words` into `memory [n][dt]` and `pooled [dt]`.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn encode(
        &self,
        words: &[u16],
        memory: &mut [f32],
        pooled: &mut [f32],
        scratch: &mut StackScratch<'_, '_>,
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        for (word, row) in words.iter().zip(memory.chunks_exact_mut(pooled.len().max(1))) {
            self.table.read(*word, row);
        }
        self.encoder.forward(memory, pooled, scratch, check)
    }
}
