//! The model blob: header, postcard manifest and a weight section that is read in place from flash.
//!
//! The byte layout is specified in `FORMAT.md` beside this file. [`Model::open`](crate::Model::open) checks everything
//! once; afterwards no accessor can fail. The manifest types are shared with the host tools, which write blobs.

mod entry;
mod error;
mod header;
mod manifest;
mod tensors;

// What a manifest says of layers is theirs to define.
#[doc(hidden)]
pub use crate::nn::activation::Activation;
#[doc(hidden)]
pub use crate::nn::block::{Norm, TransformerConfig};
#[doc(hidden)]
pub use crate::nn::conv1d::Padding;
#[doc(hidden)]
pub use entry::{DType, MAX_NAME, MAX_TENSORS, TensorEntry};
pub use error::Error;
pub use header::{ALIGNMENT, HEADER_LEN, Header, MAGIC, MAJOR, MINOR, crc32};
pub use manifest::{Card, SelfTest, Skeleton};
// What the host tools write blobs with.
#[doc(hidden)]
pub use manifest::{
    Codec, ControlConfig, Corruption, DecoderConfig, Generator, Guidance, HeadConfig, HumanMl3d, MAX_BANK, MAX_BLOCKS,
    MAX_CONVOLUTIONS, MAX_STAGES, MAX_VOCABULARY, Manifest, PhraseBank, PlannerConfig, PrefixConfig, Representation,
    ResidualConfig, SELF_TEST_NUMBERS, SKELETON_BYTES, TextConfig, TextEncoderConfig, TextEncoding, TextLength,
    TextTable,
};
#[doc(hidden)]
pub use tensors::{Tensor, Tensors};

/// Puts what it holds on an [`ALIGNMENT`]-byte boundary, as a blob in flash must be:
/// `static BLOB: &Aligned<[u8]> = &Aligned(*include_bytes!("nano.blob"));`
#[derive(Debug, Clone, Copy)]
#[repr(C, align(16))]
pub struct Aligned<T: ?Sized>(
    /// What is aligned.
    pub T,
);
