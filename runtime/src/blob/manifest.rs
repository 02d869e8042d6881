//! The manifest: what the blob contains. Serialised with postcard by the host tools, read in place by the runtime.
//!
//! On the wire: `Manifest`, then `tensor_count` times `TensorEntry`, nothing after.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Upsampling stages a decoder may have (temporal factor 2 each).
pub const MAX_STAGES: usize = 3;
/// Residual blocks a stage may have.
pub const MAX_BLOCKS: usize = 4;
/// Tensors a blob may have.
pub const MAX_TENSORS: usize = 1024;
/// Bytes of a tensor's name.
pub const MAX_NAME: usize = 64;

/// Everything about a model but its weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest<'a> {
    /// Who the model is and what binds its use.
    #[serde(borrow)]
    pub card: Card<'a>,
    /// What the feature channels mean.
    pub representation: Representation,
    /// Frames a second of the motion.
    pub frame_rate: u16,
    /// Longest motion, tokens.
    pub max_tokens: u16,
    /// Token decoder.
    pub decoder: DecoderConfig,
    /// A request whose result is known, so that a device can prove itself.
    pub self_test: SelfTest,
    /// Entries of the tensor table that follows. Order: `statistics.mean`, `statistics.std` (F32 `[F]`), one codebook a
    /// quantizer (F16 `[V][du]`), then the decoder's layers in order of execution; a layer is its int16 rows if it has
    /// any (I16Planes), its int8 rows if it has any (I8), scales (F32 `[N]`), biases (F32 `[N]`).
    pub tensor_count: u16,
}

/// Model card in a blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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

/// Meaning of the feature channels (EQUATIONS section 1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Representation {
    /// HumanML3D's 263 channels of a body with 22 joints.
    HumanMl3d,
    /// Channels that are the actuator values themselves.
    Direct {
        /// Number of channels.
        channels: u16,
    },
}

/// Shape of the VQ decoder (EQUATIONS section 6, DESIGN section 3 "Topology").
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DecoderConfig {
    /// Channels of every hidden layer.
    pub width: u16,
    /// Width of a code, `du`.
    pub code_width: u16,
    /// Codes in a codebook, `V`.
    pub codes: u16,
    /// Residual quantizers whose codes are summed.
    pub quantizers: u8,
    /// Upsampling stages, temporal factor `2^stages`.
    pub stages: u8,
    /// Dilations of a stage's residual blocks in order of execution.
    pub dilations: Vec<u8, MAX_BLOCKS>,
    /// Output features, `F`.
    pub features: u16,
}

/// A request with a known answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SelfTest {
    /// Seed of the token sequence (see [`crate::hash::Stream`]).
    pub seed: u32,
    /// Tokens in the sequence.
    pub tokens: u16,
    /// [`crate::hash::motion`] of the decoded motion; 0 = the blob carries no self-test.
    pub hash: u64,
}

/// Number format of a tensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum DType {
    /// int8, symmetric, -127..=127.
    I8,
    /// int16 as two int8 planes, all high halves first: `w = 256 hi + lo`, hi in -127..=127.
    I16Planes,
    /// IEEE half.
    F16,
    /// IEEE single.
    F32,
}

impl DType {
    /// Bytes of one element.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            DType::I8 => 1,
            DType::I16Planes | DType::F16 => 2,
            DType::F32 => 4,
        }
    }
}

/// One tensor of the weight section.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TensorEntry<'a> {
    /// Name in the checkpoint, with `.wide` for int16 rows.
    pub name: &'a str,
    /// Number format.
    pub dtype: DType,
    /// Shape, slowest dimension first, unused leading dimensions 1. Convolution weights: `[taps][outputs][inputs]`.
    pub shape: [u16; 3],
    /// Offset from the start of the weight section, bytes, a multiple of 16.
    pub offset: u32,
}

impl TensorEntry<'_> {
    /// Number of elements.
    #[must_use]
    pub const fn elements(&self) -> u64 {
        let [a, b, c] = self.shape;
        a as u64 * b as u64 * c as u64
    }
}
