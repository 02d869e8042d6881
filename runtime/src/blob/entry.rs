//! One line of the tensor table.

use serde::{Deserialize, Serialize};

/// Tensors a blob may have.
pub const MAX_TENSORS: usize = 1024;
/// Bytes of a tensor's name.
pub const MAX_NAME: usize = 64;

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
    /// 4 bits, symmetric, two a byte ([`crate::kernels`]): weights of linear layers.
    I4,
    /// Whole numbers of 32 bits without a sign: hashes.
    U32,
}

impl DType {
    /// Number formats there are.
    pub(super) const COUNT: u8 = 6;

    /// Bits of one element.
    #[must_use]
    pub const fn bits(self) -> u8 {
        match self {
            DType::I4 => 4,
            DType::I8 => 8,
            DType::I16Planes | DType::F16 => 16,
            DType::F32 | DType::U32 => 32,
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
