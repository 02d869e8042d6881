//! The manifest: what the blob contains. Serialised with postcard by the host tools, read in place by the runtime.
//!
//! On the wire: `Manifest`, then `tensor_count` times `TensorEntry`, nothing after.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Blocks a transformer may have.
pub const MAX_LAYERS: usize = 32;
/// Words a vocabulary may have.
pub const MAX_VOCABULARY: usize = 16_384;
/// Prompts a blob may store.
pub const MAX_BANK: usize = 512;
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
    /// Text encoder and stored prompts; `None`: the blob knows no text.
    #[serde(borrow)]
    pub text: Option<TextConfig<'a>>,
    /// Planner: text to motion tokens.
    pub planner: Option<PlannerConfig>,
    /// Anchor control of the planner; `None`: anchors only bend what was planned.
    pub control: Option<ControlConfig>,
    /// A request whose result is known, so that a device can prove itself.
    pub self_test: SelfTest,
    /// Entries of the tensor table that follows. Order: `statistics.mean`, `statistics.std` (F32 `[F]`), one codebook a
    /// quantizer (F16 `[V][du]`), then the decoder's layers in order of execution; a layer is its int16 rows if it has
    /// any (I16Planes), its int8 rows if it has any (I8), scales (F32 `[N]`), biases (F32 `[N]`). Then the text encoder,
    /// the length head, the stored prompts, the planner and its anchor control, as `FORMAT.md` lists them.
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

/// Where a transformer block normalises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Norm {
    /// What goes into each sublayer: `x += f(LN x)`.
    Pre,
    /// What comes out of each skip connection: `x = LN(x + f(x))`.
    Post,
}

/// Activation of a feed-forward layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Activation {
    /// `max(x, 0)`
    Relu,
    /// `x/2 (1 + erf(x / sqrt 2))`
    Gelu,
}

/// Shape of a stack of transformer blocks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TransformerConfig {
    /// Width of a row.
    pub width: u16,
    /// Attention heads; they divide the width.
    pub heads: u8,
    /// Blocks.
    pub layers: u8,
    /// Width of the feed-forward layer.
    pub hidden: u16,
    /// Where blocks normalise.
    pub norm: Norm,
    /// Activation of the feed-forward layer.
    pub activation: Activation,
    /// Added to the variance under the root.
    pub epsilon: f32,
}

/// What the blob knows of text.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TextConfig<'a> {
    /// Width of a memory row and of the pooled vector.
    pub width: u16,
    /// Longest prompt, words.
    pub max_words: u16,
    /// Words in id order, `\n` between; 0 is `<none>`, 1 is `<unknown>`. Empty without an encoder.
    pub vocabulary: &'a str,
    /// Encoder; `None`: stored prompts only.
    pub encoder: Option<TransformerConfig>,
    /// Names of the stored prompts, `\n` between; empty for none.
    pub bank: &'a str,
}

/// The planner.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlannerConfig {
    /// Its blocks.
    pub transformer: TransformerConfig,
    /// How tokens are drawn from its proposals.
    pub sampler: Sampler,
}

/// How anchors reach the planner: scaffold encoder, AnchorKV, dual context (EQUATIONS section 3).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ControlConfig {
    /// Blocks of the scaffold encoder.
    pub scaffold: TransformerConfig,
    /// Width of a frame's features behind the first layer.
    pub frame_width: u16,
    /// Rank of the projections to keys and values, `r`.
    pub rank: u16,
    /// Whether anchors also join the planner's rows (dual context).
    pub context: bool,
    /// Families of anchors it was trained for, a set of bits: 1 Root-3D, 2 Planar-root, 4 Body-point.
    pub families: u8,
}

/// A sampler and its constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Sampler {
    /// Transition masked diffusion, `beta(t) = c (t / (1 - t))^a` (EQUATIONS section 4).
    Tmd {
        /// Factor.
        c: f32,
        /// Exponent.
        a: f32,
    },
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
    /// 4 bits, symmetric, two a byte ([`crate::kernels`]): weights of linear layers. Format version 3.1.
    I4,
}

impl DType {
    /// Bits of one element.
    #[must_use]
    pub const fn bits(self) -> u8 {
        match self {
            DType::I4 => 4,
            DType::I8 => 8,
            DType::I16Planes | DType::F16 => 16,
            DType::F32 => 32,
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

    /// Bytes of its elements.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        (self.elements() * self.dtype.bits() as u64).div_ceil(8)
    }
}
