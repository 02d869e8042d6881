//! Text to words to a memory: the tokenizer's rules stated again, and the text encoder.

use std::collections::HashMap;

use super::real::Real;
use super::transformer::{Block, Embedding, LayerNorm, Linear, softmax};
use crate::checkpoint::prior::{MAX_WORD, PriorCheckpoint, SPECIAL, WordRows, WordVectors};

/// Id of the unconditional prompt.
pub const UNCONDITIONAL: u16 = 0;
/// Id of a word outside the vocabulary.
pub const UNKNOWN: u16 = 1;

/// Endings and what stands in their place, in the order in which they are tried on a word that is not in the vocabulary.
const ENDINGS: [(&str, &str); 13] = [
    ("'s", ""),
    ("s", ""),
    ("es", ""),
    ("ies", "y"),
    ("ing", ""),
    ("ing", "e"),
    ("ing", "s"),
    ("ed", ""),
    ("ed", "e"),
    ("ed", "s"),
    ("", "s"),
    ("", "es"),
    ("", "ing"),
];

/// Why a prompt could not be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PromptError {
    /// No word in it.
    #[error("the prompt has no word; say what the motion is")]
    Empty,
    /// Nothing in it is in the vocabulary.
    #[error("none of the prompt's {words} words is in the vocabulary; `motionette inspect` lists it")]
    OnlyUnknown {
        /// Words.
        words: usize,
    },
    /// More words than the encoder has places for.
    #[error("the prompt has {words} words, at most {limit} are allowed; say it shorter")]
    TooLong {
        /// Words.
        words: usize,
        /// Places.
        limit: usize,
    },
}

/// The words of a prompt.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Words {
    /// Ids in order.
    pub ids: Vec<u16>,
    /// The words that were found in no form, as they stand in the lowercased prompt.
    pub unknown: Vec<String>,
}

/// Words by id.
#[derive(Debug, Clone)]
pub struct Vocabulary {
    ids: HashMap<String, u16>,
}

impl Vocabulary {
    /// From words in the order of their ids.
    #[must_use]
    pub fn new(words: &[String]) -> Self {
        Self { ids: words.iter().enumerate().map(|(id, word)| (word.clone(), id as u16)).collect() }
    }

    /// Splits a prompt into words and looks them up.
    #[must_use]
    pub fn read(&self, prompt: &str) -> Words {
        let mut words = Words::default();
        let lower = prompt.to_ascii_lowercase();
        for word in lower.split(|c: char| !(c.is_alphanumeric() || c == '\'')).filter(|w| !w.is_empty()) {
            match self.find(word) {
                Some(id) => words.ids.push(id),
                None => {
                    words.ids.push(UNKNOWN);
                    words.unknown.push(word.to_owned());
                }
            }
        }
        words
    }

    /// The id of a word or of the first of its forms that is there.
    fn find(&self, word: &str) -> Option<u16> {
        let with = |(ending, other): (&str, &str)| {
            word.strip_suffix(ending).and_then(|stem| self.ids.get(&format!("{stem}{other}")))
        };
        // running -> runn -> run.
        let single = || {
            let stem = word.strip_suffix("ing")?;
            let mut letters = stem.chars().rev();
            let last = letters.next()?;
            let doubled = last.is_ascii_alphabetic() && !"aeiou".contains(last) && letters.next() == Some(last);
            doubled.then(|| &stem[..stem.len() - 1])
        };
        if word.len() > MAX_WORD {
            return None;
        }
        self.ids
            .get(word)
            .or_else(|| ENDINGS.into_iter().find_map(with))
            .or_else(|| single().and_then(|stem| self.ids.get(stem).or_else(|| self.ids.get(&format!("{stem}s")))))
            .copied()
    }
}

/// A text as the planner sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoded<T> {
    /// `[n][dt]`
    pub memory: Vec<T>,
    /// Mean of the memory, `[dt]`.
    pub pooled: Vec<T>,
}

/// Words to rows.
#[derive(Debug, Clone)]
enum Table<T> {
    Embedding(Embedding<T>),
    /// Vectors `[words - 2][dims]`, whose rows a linear makes.
    Vectors {
        vectors: Vec<T>,
        special: Embedding<T>,
        projection: Linear<T>,
    },
}

impl<T: Real> Table<T> {
    fn new(rows: &WordRows) -> Self {
        match rows {
            WordRows::Embedding(table) => Table::Embedding(Embedding::new(table)),
            WordRows::Vectors(WordVectors { numbers, scales, special, projection }) => {
                let rows = numbers.chunks_exact(projection.inputs.max(1)).zip(scales);
                let vector = |(row, scale): (&[f32], &f32)| -> Vec<T> {
                    row.iter().map(|n| T::from_f64(f64::from(*n) * f64::from(*scale))).collect()
                };
                Table::Vectors {
                    vectors: rows.flat_map(vector).collect(),
                    special: Embedding::new(special),
                    projection: Linear::new(projection),
                }
            }
        }
    }

    fn row(&self, word: usize) -> Vec<T> {
        match self {
            Table::Embedding(table) => table.row(word).to_vec(),
            Table::Vectors { special, .. } if word < SPECIAL => special.row(word).to_vec(),
            Table::Vectors { vectors, projection, .. } => {
                let dims = projection.inputs;
                projection.forward(&vectors[(word - SPECIAL) * dims..][..dims])
            }
        }
    }
}

/// The text encoder.
#[derive(Debug, Clone)]
pub struct TextEncoder<T> {
    /// Words by id.
    pub vocabulary: Vocabulary,
    /// Longest prompt, words.
    pub max_words: usize,
    table: Table<T>,
    position: Embedding<T>,
    layers: Vec<Block<T>>,
    norm: LayerNorm<T>,
    length: Linear<T>,
    meaning: Option<Linear<T>>,
    width: usize,
}

impl<T: Real> TextEncoder<T> {
    /// From a checkpoint.
    #[must_use]
    pub fn new(checkpoint: &PriorCheckpoint) -> Self {
        let (config, text) = (&checkpoint.config, &checkpoint.text);
        Self {
            vocabulary: Vocabulary::new(&config.vocabulary),
            max_words: config.max_words,
            table: Table::new(&text.table),
            position: Embedding::new(&text.position),
            layers: text.layers.iter().map(|b| Block::new(b, config.text.heads, config.form())).collect(),
            norm: LayerNorm::new(&text.norm, config.epsilon),
            length: Linear::new(&text.length),
            meaning: text.meaning.as_ref().map(Linear::new),
            width: config.text.width,
        }
    }

    /// The words of a prompt, as many as can be encoded.
    ///
    /// # Errors
    /// [`PromptError`].
    pub fn read(&self, prompt: &str) -> Result<Words, PromptError> {
        let words = self.vocabulary.read(prompt);
        let (count, limit) = (words.ids.len(), self.max_words);
        if count == 0 {
            Err(PromptError::Empty)
        } else if count > limit {
            Err(PromptError::TooLong { words: count, limit })
        } else if words.unknown.len() == count {
            Err(PromptError::OnlyUnknown { words: count })
        } else {
            Ok(words)
        }
    }

    /// Word ids, one to [`TextEncoder::max_words`] of them, to a memory.
    ///
    /// # Panics
    /// For an id outside the vocabulary, or more words than that.
    #[must_use]
    pub fn encode(&self, words: &[u16]) -> Encoded<T> {
        let mut x = Vec::with_capacity(words.len() * self.width);
        for (i, &word) in words.iter().enumerate() {
            let start = x.len();
            x.extend(self.table.row(usize::from(word)));
            self.position.add(i, &mut x[start..]);
        }
        for layer in &self.layers {
            layer.forward(&mut x, &[], &[]);
        }
        let memory = self.norm.forward(&x);
        let mut pooled = vec![T::ZERO; self.width];
        for row in memory.chunks_exact(self.width) {
            pooled.iter_mut().zip(row).for_each(|(p, &v)| *p += v);
        }
        let count = T::from_f64(words.len() as f64);
        pooled.iter_mut().for_each(|p| *p = *p / count);
        Encoded { memory, pooled }
    }

    /// Logits over lengths, class k = k + 1 tokens.
    #[must_use]
    pub fn length_logits(&self, pooled: &[T]) -> Vec<T> {
        self.length.forward(pooled)
    }

    /// Probabilities of what the text means, one for each of the checkpoint's meanings; empty where the prior did not learn them.
    #[must_use]
    pub fn meanings(&self, pooled: &[T]) -> Vec<T> {
        let logits = self.meaning.as_ref().map_or_else(Vec::new, |meaning| meaning.forward(pooled));
        logits.into_iter().map(|x| T::ONE / (T::ONE + (-x).exp())).collect()
    }

    /// The median of the distribution over lengths, tokens.
    #[must_use]
    pub fn length(&self, pooled: &[T]) -> usize {
        let mut p = self.length_logits(pooled);
        softmax(&mut p);
        let half = T::from_f64(0.5);
        let mut sum = T::ZERO;
        let class = p.iter().position(|&p| {
            sum += p;
            sum >= half
        });
        class.unwrap_or(p.len().saturating_sub(1)) + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_of_words() {
        let words =
            ["<none>", "<unknown>", "a", "person", "walks", "carry", "dance", "run", "jumps", "wave", "don't", "über"];
        let vocabulary = Vocabulary::new(&words.map(str::to_owned));
        for (prompt, expected) in [
            ("A person's walking.", vec![2, 3, 4]),
            ("PERSON,walk;walked", vec![3, 4, 4]),
            ("carries dancing danced waves waving", vec![5, 6, 6, 9, 9]),
            ("running runs run jumping jumped jump", vec![7, 7, 7, 8, 8, 8]),
            ("don't don't! 'a'", vec![10, 10, 1]),
            ("über ÜBER", vec![11, 1]),
            ("", vec![]),
            (" ,.;\u{3000}", vec![]),
            ("<none> none", vec![1, 1]),
        ] {
            assert_eq!(vocabulary.read(prompt).ids, expected, "{prompt}");
        }
        assert_eq!(vocabulary.read("a Flying fish").unknown, ["flying", "fish"]);
    }
}
