//! A blob's bytes in memory, where the runtime can read them.

use motionette::blob::ALIGNMENT;

/// A blob in memory, on the boundary that the runtime asks for.
#[derive(Debug, Clone)]
pub struct AlignedBlob {
    words: Vec<u128>,
    len: usize,
}

impl AlignedBlob {
    /// Copies `bytes` to an aligned place.
    #[must_use]
    pub fn new(bytes: &[u8]) -> Self {
        let words = bytes
            .chunks(ALIGNMENT)
            .map(|chunk| {
                let mut word = [0; ALIGNMENT];
                word[..chunk.len()].copy_from_slice(chunk);
                u128::from_le_bytes(word)
            })
            .collect();
        Self { words, len: bytes.len() }
    }

    /// The blob.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.len]
    }
}
