//! Residual vector quantisation: ids are chosen one codebook after the other, the latent is the sum of their rows.

use super::real::{Real, convert, dot};

/// An id that adds nothing, in any layer.
pub const NOTHING: i64 = -1;

/// An id outside the codebook.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("id {id} at token {token}, quantizer {quantizer} is outside the codebook, expected -1..{codes}")]
pub struct BadId {
    /// The id.
    pub id: i64,
    /// Token it stands at.
    pub token: usize,
    /// Quantizer it belongs to.
    pub quantizer: usize,
    /// Codes of the codebook.
    pub codes: usize,
}

/// The codebooks of a tokenizer.
#[derive(Debug, Clone)]
pub struct Quantizer<T> {
    /// Code width du.
    pub width: usize,
    /// Codes of each codebook.
    pub codes: usize,
    books: Vec<Vec<T>>,
    /// `|c|^2` of every code.
    norms: Vec<Vec<T>>,
}

impl<T: Real> Quantizer<T> {
    /// From codebooks `[codes][width]`.
    #[must_use]
    pub fn new(codebooks: &[Vec<f32>], width: usize) -> Self {
        let books: Vec<Vec<T>> = codebooks.iter().map(|b| convert(b)).collect();
        let norms = books.iter().map(|b| b.chunks_exact(width).map(|c| dot(c, c)).collect()).collect();
        let codes = books.first().map_or(0, |b| b.len() / width);
        Self { width, codes, books, norms }
    }

    /// Number of codebooks Q.
    #[must_use]
    pub fn quantizers(&self) -> usize {
        self.books.len()
    }

    /// Latent `[L][du]` to ids `[L][Q]`: the smallest `|r|^2 - 2 r.c + |c|^2` of each quantizer in turn, first of equals.
    #[must_use]
    pub fn encode(&self, latent: &[T]) -> Vec<i64> {
        let mut ids = Vec::with_capacity(latent.len() / self.width * self.books.len());
        let two = T::from_f64(2.0);
        for row in latent.chunks_exact(self.width) {
            let mut residual = row.to_vec();
            for (book, norms) in self.books.iter().zip(&self.norms) {
                let norm = dot(&residual, &residual);
                let mut best: Option<(usize, T)> = None;
                for (i, (code, &n)) in book.chunks_exact(self.width).zip(norms).enumerate() {
                    let distance = norm - two * dot(&residual, code) + n;
                    if best.is_none_or(|(_, least)| distance < least) {
                        best = Some((i, distance));
                    }
                }
                let chosen = best.map_or(0, |(i, _)| i);
                for (r, &c) in residual.iter_mut().zip(&book[chosen * self.width..]) {
                    *r -= c;
                }
                ids.push(chosen as i64);
            }
        }
        ids
    }

    /// Ids `[L][Q]` to latent `[L][du]`: the sum of the rows; [`NOTHING`] adds nothing.
    ///
    /// # Errors
    /// [`BadId`] for an id outside the codebook.
    pub fn decode(&self, ids: &[i64]) -> Result<Vec<T>, BadId> {
        let mut latent = Vec::with_capacity(ids.len() / self.books.len().max(1) * self.width);
        for (token, ids) in ids.chunks_exact(self.books.len().max(1)).enumerate() {
            let start = latent.len();
            latent.resize(start + self.width, T::ZERO);
            for (quantizer, (&id, book)) in ids.iter().zip(&self.books).enumerate() {
                if id == NOTHING {
                    continue;
                }
                let row = usize::try_from(id).ok().and_then(|i| book.chunks_exact(self.width).nth(i));
                let row = row.ok_or(BadId { id, token, quantizer, codes: self.codes })?;
                for (u, &c) in latent[start..].iter_mut().zip(row) {
                    *u += c;
                }
            }
        }
        Ok(latent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_and_absent_ids() {
        let q = Quantizer::<f32>::new(&[vec![1.0, 0.0, 0.0, 1.0, 4.0, 4.0], vec![0.5, 0.0, 0.0, 0.25, 9.0, 9.0]], 2);
        assert_eq!(q.encode(&[0.1, 1.2, 4.4, 4.0]), [1, 1, 2, 0]);
        assert_eq!(q.decode(&[1, 1, 2, -1, -1, 0]).expect("valid"), [0.0, 1.25, 4.0, 4.0, 0.5, 0.0]);
        assert_eq!(q.decode(&[0, 3]).expect_err("outside"), BadId { id: 3, token: 0, quantizer: 1, codes: 3 });
        assert_eq!(q.decode(&[-2, 0]).expect_err("outside").id, -2);
    }
}
