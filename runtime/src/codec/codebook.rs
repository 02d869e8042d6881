//! Code embeddings, residual quantizers summed (EQUATIONS section 6).

use crate::blob::{DecoderConfig, Error, Tensors};
use crate::nn::conv1d::larger;
use half::f16;

/// Residual quantizers a blob may have.
pub const MAX_QUANTIZERS: usize = 6;

/// Codebooks `[Q][V][du]` in flash, half precision.
#[derive(Debug, Clone, Copy)]
pub struct Codebooks<'a> {
    books: [&'a [u16]; MAX_QUANTIZERS],
    quantizers: usize,
    codes: usize,
    width: usize,
    largest: f32,
}

/// A token that no codebook has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TokenOutOfRange {
    /// Position in the request's tokens.
    pub index: usize,
    /// The token.
    pub token: u16,
    /// Codes there are.
    pub codes: u16,
}

impl<'a> Codebooks<'a> {
    /// The token that adds nothing, in any layer.
    pub const NONE: u16 = u16::MAX;

    /// Reads one codebook a quantizer from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor that is missing, of another shape, or not finite.
    pub fn open(tensors: &mut Tensors<'a>, config: &DecoderConfig) -> Result<Self, Error> {
        let mut books: [&[u16]; MAX_QUANTIZERS] = [&[]; MAX_QUANTIZERS];
        let mut largest = 0.0;
        for book in books.iter_mut().take(usize::from(config.quantizers)) {
            *book = tensors.take()?.f16s(config.codes, config.code_width)?;
            let magnitude = book.iter().fold(0.0, |largest, v| larger(largest, f16::from_bits(*v).to_f32().abs()));
            largest += magnitude;
        }
        Ok(Codebooks {
            books,
            quantizers: usize::from(config.quantizers),
            codes: usize::from(config.codes),
            width: usize::from(config.code_width),
            largest,
        })
    }

    /// A bound of the magnitude of any embedding.
    #[must_use]
    pub const fn largest(&self) -> f32 {
        self.largest
    }

    /// Codes in each codebook.
    #[must_use]
    pub const fn codes(&self) -> usize {
        self.codes
    }

    /// Width of a code, `du`.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// One code of the first codebook, `[du]`; nothing where there is none.
    pub fn values(&self, code: usize) -> impl Iterator<Item = f32> + Clone + use<'a> {
        let [first, ..] = self.books;
        let bits = first.get(code * self.width..(code + 1) * self.width).unwrap_or(&[]);
        bits.iter().map(|bits| f16::from_bits(*bits).to_f32())
    }

    /// Quantizers.
    #[must_use]
    pub const fn quantizers(&self) -> usize {
        self.quantizers
    }

    /// `u0 [L][du]`: for each of the `L` positions the sum of its quantizers' codes. `tokens` is `[L][Q]`.
    ///
    /// # Errors
    /// [`TokenOutOfRange`]; [`Codebooks::NONE`] is always in range.
    pub fn embed(&self, tokens: &[u16], u: &mut [f32]) -> Result<(), TokenOutOfRange> {
        u.fill(0.0);
        let quantizers = self.quantizers.max(1);
        let positions = tokens.chunks_exact(quantizers).zip(u.chunks_exact_mut(self.width.max(1)));
        for (l, (tokens, u)) in positions.enumerate() {
            for (q, (&token, book)) in tokens.iter().zip(self.books).enumerate() {
                if token == Self::NONE {
                    continue;
                }
                let start = usize::from(token) * self.width;
                let code = book.get(start..start + self.width).ok_or(TokenOutOfRange {
                    index: l * quantizers + q,
                    token,
                    codes: self.codes as u16,
                })?;
                for (u, bits) in u.iter_mut().zip(code) {
                    *u += f16::from_bits(*bits).to_f32();
                }
            }
        }
        Ok(())
    }
}
