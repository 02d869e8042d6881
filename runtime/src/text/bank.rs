//! Stored prompts: memory and pooled vector of texts that were encoded on the host, by name.

use super::VECTORS;
use super::words::Vocabulary;
use crate::blob::{Error, MAX_BANK, Tensors};
use half::f16;

/// Largest magnitude of a stored number.
pub const MAX_VALUE: f32 = 1e4;
/// Name of the prompt that says nothing.
pub const UNCONDITIONAL: &str = "<none>";

/// The stored prompts of a blob.
#[derive(Debug, Clone, Copy)]
pub struct Bank<'a> {
    names: Vocabulary<'a>,
    first: Tensors<'a>,
    width: usize,
}

/// One of them.
#[derive(Debug, Clone, Copy)]
pub struct Entry<'a> {
    /// Half precision, `[n + 1][dt]`: the memory, then the pooled vector.
    values: &'a [u16],
    width: usize,
}

impl<'a> Bank<'a> {
    /// Checks the prompts in the next tensors, of up to so many words; 0 for vectors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or holds refused values; [`Error::Config`] of a
    /// count.
    pub fn open(tensors: &mut Tensors<'a>, names: &'a str, width: u16, max_words: u16) -> Result<Self, Error> {
        let names = Vocabulary::new(names);
        let (count, limit) = (names.len(), MAX_BANK as u32);
        if count > MAX_BANK {
            return Err(Error::Config { what: "text.bank", found: u32::try_from(count).unwrap_or(u32::MAX), limit });
        }
        let first = tensors.trusted();
        // Those of no words are vectors without a memory.
        let least = if VECTORS && max_words == 0 { 1 } else { 2 };
        for _ in 0..count {
            let tensor = tensors.take()?;
            let [_, rows, _] = tensor.entry.shape;
            if rows < least || rows > max_words.saturating_add(1) {
                let limit = u32::from(max_words) + 1;
                return Err(Error::Config { what: "rows of a stored prompt", found: u32::from(rows), limit });
            }
            let values = tensor.f16s(rows, width)?;
            if let Some(element) = values.iter().position(|&v| !(f16::from_bits(v).to_f32().abs() <= MAX_VALUE)) {
                let element = u32::try_from(element).unwrap_or(u32::MAX);
                return Err(Error::TensorValue { index: tensor.index, element });
            }
        }
        Ok(Bank { names, first, width: usize::from(width) })
    }

    /// Prompts there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Their names.
    pub fn names(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        let count = self.names.len();
        self.names.entries().take(count).map(|name| core::str::from_utf8(name).unwrap_or(""))
    }

    /// The prompt of that name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<Entry<'a>> {
        let position = self.names.position(name.as_bytes())?;
        let mut tensors = self.first;
        for _ in 0..position {
            tensors.take().ok()?;
        }
        let tensor = tensors.take().ok()?;
        let [_, rows, width] = tensor.entry.shape;
        Some(Entry { values: tensor.f16s(rows, width).ok()?, width: self.width })
    }
}

impl Entry<'_> {
    /// Rows of its memory.
    #[must_use]
    pub fn rows(&self) -> usize {
        (self.values.len() / self.width.max(1)).saturating_sub(1)
    }

    /// Its memory into `memory [n][dt]`, its pooled vector into `pooled [dt]`.
    pub fn read(&self, memory: &mut [f32], pooled: &mut [f32]) {
        let to = memory.iter_mut().take(self.rows() * self.width).chain(pooled);
        for (to, bits) in to.zip(self.values) {
            *to = f16::from_bits(*bits).to_f32();
        }
    }
}
