//! The word table (`models/words.safetensors`): vectors of words from a pretrained sentence encoder. Its form: docs/data.md, "Word table".

use std::path::Path;

use ::safetensors::{Dtype, SafeTensors};
use motionette::numerics::hash::fnv32;

use super::error::{Error, ErrorKind, Result};
use super::tensors::to_f32;
use crate::input;

/// Largest magnitude of a number: four bits, symmetric.
pub const LARGEST: i8 = 7;

/// Words by rising hash, each with its vector: `numbers * scale`.
#[derive(Debug, Clone, PartialEq)]
pub struct WordTable {
    /// `[n]`, in the order of their hashes.
    pub words: Vec<String>,
    /// `[n][dims]`, -7 to 7.
    pub numbers: Vec<i8>,
    /// `[n]`.
    pub scales: Vec<f32>,
    /// `[n]`: 0 a word of captions or phrases, 1 a common one, 2 another.
    pub tiers: Vec<u8>,
    /// Numbers of a vector.
    pub dims: usize,
}

impl WordTable {
    /// Reads and checks a table.
    ///
    /// # Errors
    /// [`Error`] with the path and the tensor that is missing, of another type or shape, or holds what cannot be.
    pub fn read(path: &Path) -> core::result::Result<Self, Error> {
        let read = || Self::from_bytes(&input::read(path, input::ANY)?);
        read().map_err(|kind| Error { path: path.to_owned(), kind })
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let file = SafeTensors::deserialize(bytes).map_err(|error| ErrorKind::Safetensors(error.to_string()))?;
        let tensor = |name: &str, dtype: Dtype, rank: usize| {
            let wrong = |what: String| ErrorKind::Extent { tensor: name.to_owned(), what };
            let tensor = file.tensor(name).map_err(|error| wrong(error.to_string()))?;
            if tensor.dtype() == dtype && tensor.shape().len() == rank {
                return Ok((tensor.shape().to_vec(), tensor.data().to_vec()));
            }
            Err(wrong(format!(
                "it is {:?} {:?}, a word table has {dtype:?} of {rank} dimensions",
                tensor.dtype(),
                tensor.shape()
            )))
        };
        let (_, hashes) = tensor("hash", Dtype::U32, 1)?;
        let hashes: Vec<u32> = hashes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        let (shape, packed) = tensor("vector", Dtype::U8, 2)?;
        let (_, scales) = tensor("scale", Dtype::F16, 1)?;
        let (_, tiers) = tensor("tier", Dtype::U8, 1)?;
        let (_, words) = tensor("words", Dtype::U8, 1)?;
        let wrong = |tensor: &str, what: String| ErrorKind::Extent { tensor: tensor.to_owned(), what };
        let words = String::from_utf8(words).map_err(|error| wrong("words", error.to_string()))?;
        let nibble = |four: u8| ((four << 4) as i8) >> 4;
        let table = Self {
            words: words.split('\n').map(str::to_owned).collect(),
            numbers: packed.iter().flat_map(|byte| [nibble(byte & 15), nibble(byte >> 4)]).collect(),
            scales: to_f32("F16", &scales).unwrap_or_default(),
            tiers,
            dims: 2 * shape[1],
        };
        let rows = hashes.len();
        for (name, found) in [
            ("vector", shape[0]),
            ("scale", table.scales.len()),
            ("tier", table.tiers.len()),
            ("words", table.words.len()),
        ] {
            if found != rows {
                return Err(wrong(name, format!("{found} rows, the table has {rows} hashes")));
            }
        }
        if let Some(at) = hashes.windows(2).position(|pair| pair[0] >= pair[1]) {
            return Err(wrong("hash", format!("row {} does not rise", at + 1)));
        }
        if let Some(at) = (0..rows).find(|at| hash(&table.words[*at]) != hashes[*at]) {
            return Err(wrong("hash", format!("row {at} is not that of the word {:?}", table.words[at])));
        }
        if let Some(at) = table.scales.iter().position(|scale| !(scale.is_finite() && *scale > 0.0)) {
            return Err(wrong("scale", format!("row {at} holds {}", table.scales[at])));
        }
        if table.numbers.iter().any(|number| *number < -LARGEST) {
            return Err(wrong("vector", format!("a number below -{LARGEST}")));
        }
        Ok(table)
    }
}

/// FNV-1a, 32 bits, of a word's UTF-8 bytes: the hash that a device looks it up by.
#[must_use]
pub fn hash(word: &str) -> u32 {
    fnv32(word.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> WordTable {
        WordTable::read(Path::new("../models/words.safetensors")).unwrap()
    }

    /// Published test values of FNV-1a.
    #[test]
    fn hashes_are_those_of_fnv1a() {
        assert_eq!((hash(""), hash("a"), hash("foobar")), (0x811C_9DC5, 0xE40C_292C, 0xBF9C_F968));
    }

    /// Directions mean something: a word is nearer to one that means the same than to one that does not.
    #[test]
    fn the_shipped_table_knows_what_is_alike() {
        let table = shipped();
        let row = |word: &str| {
            let at = table.words.iter().position(|other| other == word).unwrap();
            &table.numbers[at * table.dims..][..table.dims]
        };
        let cosine = |a: &str, b: &str| {
            let dot = |a: &[i8], b: &[i8]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
            dot(row(a), row(b)) / (dot(row(a), row(a)) * dot(row(b), row(b))).sqrt()
        };
        for [word, near, far] in [["jump", "leap", "sit"], ["sad", "unhappy", "kick"], ["walk", "stroll", "punch"]] {
            assert!(cosine(word, near) > cosine(word, far) + 0.2, "{word} {near} {far}");
        }
        assert_eq!((table.dims, table.words.len()), (64, 14_019));
    }

    #[test]
    fn damaged_tables_are_refused_by_tensor() {
        let bytes = std::fs::read("../models/words.safetensors").unwrap();
        let refused = |change: &dyn Fn(&mut Vec<u8>), what: &str| {
            let mut damaged = bytes.clone();
            change(&mut damaged);
            let error = WordTable::from_bytes(&damaged).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        };
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let begin = |name: &str| file.tensor(name).unwrap().data().as_ptr() as usize - bytes.as_ptr() as usize;
        assert!(begin("hash") >= header);
        refused(&|b| b.truncate(b.len() - 1), "safetensors");
        refused(&|b| b[begin("hash") + 1] ^= 1, "hash");
        refused(&|b| b[begin("scale")..][..2].copy_from_slice(&[0, 0]), "scale");
        refused(&|b| b[begin("vector")] = 0x08, "vector");
        refused(&|b| b[begin("words")] = b'\n', "words");
    }
}
