//! The manifest: what the blob contains. Written with postcard by the host tools, read in place by the runtime.
//!
//! On the wire: `Manifest`, then `tensor_count` times [`TensorEntry`](super::TensorEntry), nothing after. Whatever may come in another kind
//! one day is an enum, its index first: a kind that came later is refused by the name of its section
//! ([`Error::Unknown`]), and all that stands before it has been read.

mod codec;
mod generator;
mod reader;
mod representation;
mod text;

pub use codec::{Codec, DecoderConfig, MAX_BLOCKS, MAX_CONVOLUTIONS, MAX_STAGES};
pub use generator::{
    ControlConfig, Corruption, Generator, Guidance, HeadConfig, PlannerConfig, PrefixConfig, ResidualConfig,
};
pub use representation::{HumanMl3d, Representation, SKELETON_BYTES, Skeleton};
pub use text::{
    MAX_BANK, MAX_VOCABULARY, PhraseBank, TextConfig, TextEncoderConfig, TextEncoding, TextLength, TextTable,
};

use super::Error;
pub(super) use reader::Reader;
use serde::Serialize;

/// Token numbers (tokens times quantizers) a self-test may have.
pub const SELF_TEST_NUMBERS: usize = 64;

/// Everything about a model but its weights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Manifest<'a> {
    /// Who the model is and what binds its use.
    pub card: Card<'a>,
    /// What a frame of the motion is made of.
    pub representation: Representation<'a>,
    /// Motion tokens to frames.
    pub codec: Codec,
    /// Text encoder and stored prompts; `None`: the blob knows no text.
    pub text: Option<TextConfig<'a>>,
    /// Where motion tokens come from.
    pub generator: Generator,
    /// A request whose result is known, so that a device can prove itself.
    pub self_test: SelfTest,
    /// Entries of the tensor table that follows. Order: `statistics.mean`, `statistics.std` (F32 `[F]`), one codebook a
    /// quantizer (F16 `[V][du]`), then the decoder's layers in order of execution; a layer is its int16 rows if it has
    /// any (I16Planes), its int8 rows if it has any (I8), scales (F32 `[N]`), biases (F32 `[N]`). Then the text encoder,
    /// the length head, the stored prompts, the planner and its anchor control, as `FORMAT.md` lists them.
    pub tensor_count: u16,
}

/// Model card in a blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Card<'a> {
    /// Name of the model, e.g. `nano`.
    pub name: &'a str,
    /// Licence of the weights.
    pub licence: &'a str,
    /// Data the weights were trained on.
    pub data: &'a str,
    /// Hash of the checkpoint the blob was converted from.
    pub checkpoint: &'a str,
}

/// A request with a known answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct SelfTest {
    /// Seed of the token sequence (see [`crate::numerics::hash::Stream`]).
    pub seed: u32,
    /// Tokens in the sequence.
    pub tokens: u16,
    /// [`crate::numerics::hash::motion`] of the decoded motion; 0 = the blob carries no self-test.
    pub hash: u64,
}

impl<'a> Manifest<'a> {
    /// Reads the manifest at the begin of `bytes`, of a blob of that minor format version; what follows it, the tensor table, comes back
    /// with it.
    ///
    /// # Errors
    /// [`Error::Manifest`] where the bytes end early or mean nothing, [`Error::Unknown`] where a section is of a kind that
    /// came later. Values are not judged here.
    pub fn read(bytes: &'a [u8], minor: u16) -> Result<(Self, &'a [u8]), Error> {
        let mut reader = Reader::new(bytes, minor);
        let from = &mut reader;
        let manifest = Manifest {
            card: Card { name: from.text(), licence: from.text(), data: from.text(), checkpoint: from.text() },
            representation: Representation::read(from),
            codec: Codec::read(from),
            text: TextConfig::read(from),
            generator: Generator::read(from),
            self_test: SelfTest { seed: from.take(), tokens: from.short(), hash: from.take() },
            tensor_count: from.short(),
        };
        let table = reader.finish()?;
        Ok((manifest, table))
    }
}
