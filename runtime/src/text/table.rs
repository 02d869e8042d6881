//! Words to the rows that an encoder begins with: an embedding each, or vectors that were made elsewhere, through a linear layer.

use super::words::{UNKNOWN, Vocabulary, Word};
use crate::blob::{Error, MAX_VOCABULARY, Tensors, TextTable};
use crate::kernels::{GROUP, GROUP_BYTES, unpacked};
use crate::nn::conv1d::larger;
use crate::nn::embedding::Embedding;
use crate::nn::linear::Linear;
use crate::numerics::hash::fnv32;
use half::f16;

/// Words without a vector: the empty prompt, the unknown word.
const SPECIAL: u16 = UNKNOWN + 1;
/// Largest magnitude of a vector's numbers.
const LARGEST: f32 = 8.0;

/// Words by id.
#[derive(Debug, Clone, Copy)]
pub enum WordIds<'a> {
    /// Written out, in the order of their ids.
    Listed(Vocabulary<'a>),
    /// Hashes of the words with a vector, rising; the first of them has the id 2.
    Hashed(&'a [u32]),
}

impl WordIds<'_> {
    /// Words there are, `<none>` and `<unknown>` with them.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            WordIds::Listed(words) => words.len(),
            WordIds::Hashed(hashes) => hashes.len() + usize::from(SPECIAL),
        }
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Id of a word: its own, or that of its first other form that is there ([`Word::forms`]), or [`UNKNOWN`].
    #[must_use]
    pub fn id(&self, word: &Word) -> u16 {
        word.forms(|form| self.position(form)).unwrap_or(UNKNOWN)
    }

    // Looked up for every form of a word, from three places.
    #[inline(never)]
    fn position(&self, word: &[u8]) -> Option<u16> {
        match self {
            WordIds::Listed(words) => words.position(word),
            WordIds::Hashed(hashes) => {
                let place = hashes.binary_search(&fnv32(word)).ok()?;
                u16::try_from(place).ok()?.checked_add(SPECIAL)
            }
        }
    }
}

/// Rows of words.
#[derive(Debug, Clone, Copy)]
enum Rows<'a> {
    Embedding(Embedding<'a>),
    Vectors {
        /// `[words][dims / 2]`, packed as [`unpacked`] reads them.
        numbers: &'a [u8],
        /// `[words]`, half precision.
        scales: &'a [u16],
        special: Embedding<'a>,
        projection: Linear<'a>,
    },
}

/// A table in flash.
#[derive(Debug, Clone, Copy)]
pub struct WordTable<'a> {
    ids: WordIds<'a>,
    rows: Rows<'a>,
}

impl<'a> WordTable<'a> {
    /// Reads the table, for rows of that width, from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor; [`Error::Config`] of a list of words that cannot be.
    pub fn open(tensors: &mut Tensors<'a>, table: &TextTable<'a>, width: u16) -> Result<Self, Error> {
        match *table {
            TextTable::Words(words) => {
                let vocabulary = Vocabulary::new(words);
                let found = u32::try_from(vocabulary.len()).unwrap_or(u32::MAX);
                let limit = MAX_VOCABULARY as u32;
                let mut entries = vocabulary.entries();
                let first = [b"<none>".as_slice(), b"<unknown>"];
                if !first.into_iter().all(|word| entries.next() == Some(word)) {
                    let what = "text.encoder.table without <none> and <unknown>";
                    return Err(Error::Config { what, found, limit });
                }
                if found > limit {
                    return Err(Error::Config { what: "text.encoder.table", found, limit });
                }
                let rows = Rows::Embedding(Embedding::open(tensors, found as u16, width)?);
                Ok(WordTable { ids: WordIds::Listed(vocabulary), rows })
            }
            TextTable::Vectors { words, dims } => {
                let hashes = tensors.take()?.hashes(words)?;
                let numbers = tensors.take()?.nibbles([1, words, dims])?;
                let scales = tensors.take()?.f16s(1, words)?;
                let special = Embedding::open(tensors, SPECIAL, width)?;
                let index = tensors.index();
                let projection = Linear::open(tensors, dims, width)?;
                if projection.packed() {
                    return Err(Error::TensorShape { index, found: 0, expected: projection.macs() as u32 });
                }
                let rows = Rows::Vectors { numbers, scales, special, projection };
                Ok(WordTable { ids: WordIds::Hashed(hashes), rows })
            }
        }
    }

    /// The words.
    #[must_use]
    pub const fn ids(&self) -> &WordIds<'a> {
        &self.ids
    }

    /// A bound of the rows.
    #[must_use]
    pub fn bound(&self) -> f32 {
        match &self.rows {
            Rows::Embedding(table) => table.bound(),
            Rows::Vectors { scales, special, projection, .. } => {
                let largest =
                    scales.iter().fold(0.0, |most, scale| larger(most, f16::from_bits(*scale).to_f32().abs()));
                larger(special.bound(), projection.bound(LARGEST * largest))
            }
        }
    }

    /// The row of `word` into `x [width]`, zeros for a word that is not there.
    pub fn read(&self, word: u16, x: &mut [f32]) {
        x.fill(0.0);
        match &self.rows {
            Rows::Embedding(table) => table.add(usize::from(word), x),
            Rows::Vectors { numbers, scales, special, projection } => match word.checked_sub(SPECIAL) {
                None => special.add(usize::from(word), x),
                Some(row) => {
                    let row = usize::from(row);
                    let Some(scale) = scales.get(row) else { return };
                    let bytes = projection.inputs() / 2;
                    let vector = part!(numbers, row * bytes..(row + 1) * bytes);
                    project(projection, vector, f16::from_bits(*scale).to_f32(), x);
                }
            },
        }
    }
}

/// `x[n] = (scale * sum_k q[k] w[n][k]) * s[n] + b[n]` of 4-bit numbers `q`; the sum is exact.
#[inline(never)]
fn project(layer: &Linear<'_>, vector: &[u8], scale: f32, x: &mut [f32]) {
    let (vector, _) = vector.as_chunks::<GROUP_BYTES>();
    for (n, x) in x.iter_mut().enumerate() {
        let (weights, s) = layer.row(n);
        let mut sum = 0;
        for (bytes, weights) in vector.iter().zip(weights.as_chunks::<GROUP>().0) {
            for (q, w) in unpacked(bytes).iter().zip(weights) {
                sum += i32::from(*q) * i32::from(*w);
            }
        }
        *x = (scale * sum as f32) * s + layer.bias(n);
    }
}
