//! What a prior checkpoint says about itself.

use serde::{Deserialize, Serialize};

use crate::checkpoint::config::parse;
use crate::checkpoint::error::{ErrorKind, Result};
use crate::checkpoint::words::hash;
use crate::motion::side::Side;

use super::SPECIAL;

/// Word of the unconditional prompt, id 0.
pub const UNCONDITIONAL: &str = "<none>";
/// Word that stands for every word outside the vocabulary, id 1.
pub const UNKNOWN: &str = "<unknown>";
/// Rows of the table of times.
pub const TIMES: usize = 32;
/// Rows of the table of the strength of guidance: 0, 1, 2, 3, 4.
pub const STRENGTHS: usize = 5;
/// Rows of the table of open ends.
pub const BOUNDARIES: usize = 4;

/// Largest width, hidden width, code count that is believed; anything larger is a damaged option.
pub(in crate::checkpoint) const MAX_EXTENT: usize = 1 << 12;
/// Most codes, words of a vocabulary.
const MAX_ROWS: usize = 1 << 15;
/// Most layers.
pub(in crate::checkpoint) const MAX_LAYERS: usize = 64;
/// Longest phrase, bytes.
pub const MAX_PHRASE: usize = 64;
/// Longest word, bytes: longer ones are unknown to every vocabulary.
pub const MAX_WORD: usize = 32;
/// Longest prompt and longest motion, in words and tokens.
pub(in crate::checkpoint) const MAX_LENGTH: usize = 256;

/// Where the norms of a block stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NormOrder {
    /// Before every sublayer, on its input alone: `x + f(norm(x))`.
    Pre,
    /// Behind every sublayer, on the sum: `norm(x + f(x))`.
    Post,
}

/// Nonlinearity between the two linears of a feed-forward sublayer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Activation {
    /// `x / 2 (1 + erf(x / sqrt 2))`.
    Gelu,
    /// `max(x, 0)`.
    Relu,
}

/// Sizes of one transformer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sizes {
    /// Width of a row.
    pub width: usize,
    /// Attention heads; `width` is a multiple.
    pub heads: usize,
    /// Blocks.
    pub layers: usize,
    /// Width between the two linears of the feed-forward sublayer.
    pub hidden: usize,
}

impl Sizes {
    /// Refuses sizes that no transformer has; `name` is what the configuration calls it.
    pub(in crate::checkpoint) fn check(&self, name: &str) -> Result<()> {
        let key = |of: &str| format!("{name}.{of}");
        check_extent(&key("width"), self.width, MAX_EXTENT)?;
        check_extent(&key("heads"), self.heads, 255)?;
        check_extent(&key("layers"), self.layers, MAX_LAYERS)?;
        check_extent(&key("hidden"), self.hidden, MAX_EXTENT)?;
        if self.width.is_multiple_of(self.heads) {
            return Ok(());
        }
        let expected = format!("a divisor of the width {}", self.width);
        Err(ErrorKind::Option { key: key("heads"), value: self.heads.to_string(), expected })
    }
}

/// What the blocks of a transformer have in common besides their sizes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Form {
    /// What norms add to the variance.
    pub epsilon: f64,
    /// Where the norms stand.
    pub norm: NormOrder,
    /// Nonlinearity of the feed-forward sublayers.
    pub activation: Activation,
}

/// Refuses a size of 0 or beyond `max`.
pub(in crate::checkpoint) fn check_extent(key: &str, value: usize, max: usize) -> Result<()> {
    if (1..=max).contains(&value) {
        return Ok(());
    }
    Err(ErrorKind::Option { key: key.into(), value: value.to_string(), expected: format!("1 to {max}") })
}

/// Refuses what is no positive number, also as the f32 of a blob.
pub(in crate::checkpoint) fn check_positive(key: &str, value: f64) -> Result<()> {
    if (value as f32).is_normal() && value > 0.0 {
        return Ok(());
    }
    Err(ErrorKind::Option { key: key.into(), value: value.to_string(), expected: "a positive number".into() })
}

/// What a sentence may mean.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Meaning {
    /// Name of the action or style.
    pub name: String,
    /// Side that the sentence says.
    pub side: Side,
    /// Whether it is a style, not an action.
    pub style: bool,
    /// The plainest way to say it, at most 64 bytes.
    pub phrase: String,
}

/// What the planner recovers clean tokens from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Corruption {
    /// Tokens that moved to near codes (TMD).
    #[default]
    Near,
    /// Tokens some of which are masked.
    Masks,
}

impl Corruption {
    /// Whether it is [`Corruption::Near`], which was all there was once.
    #[must_use]
    pub fn is_near(&self) -> bool {
        *self == Self::Near
    }
}

/// Sizes and provenance of a prior (text encoder and planner).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PriorConfig {
    /// Words in the order of their ids, [`UNCONDITIONAL`] and [`UNKNOWN`] first.
    pub vocabulary: Vec<String>,
    /// Numbers of a word's vector; 0 where every word has an embedding of its own.
    #[serde(default)]
    pub word_vectors: usize,
    /// What prompts may mean, actions before styles; empty where the prior did not learn it.
    #[serde(default)]
    pub meanings: Vec<Meaning>,
    /// Whether the planner is told how strongly it is guided, so that guidance takes one pass.
    #[serde(default)]
    pub guidance: bool,
    /// Probability of the likeliest action from which a prompt counts as understood.
    #[serde(default = "default_threshold")]
    pub threshold: f32,
    /// Tier of each word with a vector: those of a low one are kept first where room is short; empty where nobody knows.
    #[serde(default)]
    pub word_tiers: Vec<u8>,
    /// Longest prompt, words.
    pub max_words: usize,
    /// Longest motion, tokens.
    pub max_tokens: usize,
    /// Codes V of the tokenizer.
    pub codes: usize,
    /// Code width du of the tokenizer.
    pub code_dim: usize,
    /// The text encoder.
    pub text: Sizes,
    /// The planner.
    pub planner: Sizes,
    /// What norms add to the variance.
    pub epsilon: f64,
    /// Where the norms stand.
    pub norm: NormOrder,
    /// Nonlinearity of the feed-forward sublayers.
    pub activation: Activation,
    /// What the planner recovers clean tokens from.
    #[serde(default, skip_serializing_if = "Corruption::is_near")]
    pub corruption: Corruption,
    /// Factor of `beta(t) = c (t / (1 - t))^a`, of account where tokens move to near codes.
    #[serde(default)]
    pub c: f64,
    /// Its exponent.
    #[serde(default)]
    pub a: f64,
    /// SHA-256, hex, over the little-endian bytes of the tokenizer's f32 codebook.
    pub tokenizer: String,
    /// Name of the configuration ("nano").
    #[serde(default)]
    pub preset: String,
    /// Seed of the training run.
    #[serde(default)]
    pub seed: u64,
    /// Optimiser steps taken.
    #[serde(default)]
    pub steps: u64,
    /// Hash of the dataset it was trained on.
    #[serde(default)]
    pub data_hash: String,
    /// Figures of the training run, as the trainer wrote them.
    #[serde(default)]
    pub metrics: serde_json::Value,
}

fn default_threshold() -> f32 {
    0.5
}

impl PriorConfig {
    /// Reads the `config` entry of a checkpoint.
    ///
    /// # Errors
    /// [`ErrorKind::Option`] when the JSON is broken or a value is out of range.
    pub fn from_json(text: &str) -> Result<Self> {
        let config: Self = parse(text)?;
        config.check()?;
        Ok(config)
    }

    /// What the blocks of both transformers have in common.
    #[must_use]
    pub fn form(&self) -> Form {
        Form { epsilon: self.epsilon, norm: self.norm, activation: self.activation }
    }

    /// Refuses sizes, words and numbers that no prior has.
    ///
    /// # Errors
    /// [`ErrorKind::Option`], naming the first of them.
    pub fn check(&self) -> Result<()> {
        check_extent("max_words", self.max_words, MAX_LENGTH)?;
        check_extent("max_tokens", self.max_tokens, MAX_LENGTH)?;
        check_extent("codes", self.codes, MAX_ROWS)?;
        check_extent("code_dim", self.code_dim, MAX_EXTENT)?;
        self.text.check("text")?;
        self.planner.check("planner")?;
        check_positive("epsilon", self.epsilon)?;
        if self.corruption.is_near() {
            check_positive("c", self.c)?;
            check_positive("a", self.a)?;
        }
        self.check_vocabulary()?;
        self.check_words()?;
        self.check_meanings()
    }

    /// Words with vectors stand in the order of their hashes, of which no two are alike.
    fn check_words(&self) -> Result<()> {
        if self.word_vectors == 0 {
            return Ok(());
        }
        let group = motionette::kernels::GROUP;
        if !self.word_vectors.is_multiple_of(group) || self.word_vectors > MAX_EXTENT {
            let expected = format!("a multiple of {group}, at most {MAX_EXTENT}");
            let value = self.word_vectors.to_string();
            return Err(ErrorKind::Option { key: "word_vectors".into(), value, expected });
        }
        let words = &self.vocabulary[SPECIAL..];
        if let Some(pair) = words.windows(2).find(|pair| hash(&pair[0]) >= hash(&pair[1])) {
            let expected = "words with vectors in the order of their hashes, none of which occurs twice".into();
            return Err(ErrorKind::Option { key: "vocabulary".into(), value: pair[1].clone(), expected });
        }
        if !self.word_tiers.is_empty() && self.word_tiers.len() != words.len() {
            let (value, expected) = (format!("{} tiers", self.word_tiers.len()), format!("{}", words.len()));
            return Err(ErrorKind::Option { key: "word_tiers".into(), value, expected });
        }
        Ok(())
    }

    fn check_meanings(&self) -> Result<()> {
        let refuse = |value: String, expected: &str| {
            Err(ErrorKind::Option { key: "meanings".into(), value, expected: expected.into() })
        };
        let styles = self.meanings.iter().skip_while(|meaning| !meaning.style);
        if styles.clone().any(|meaning| !meaning.style) || (!self.meanings.is_empty() && self.meanings[0].style) {
            return refuse("an order".into(), "actions, one at least, before styles");
        }
        let long = |phrase: &str| phrase.is_empty() || phrase.len() > MAX_PHRASE || phrase.contains('\n');
        if let Some(meaning) = self.meanings.iter().find(|meaning| long(&meaning.phrase)) {
            return refuse(meaning.phrase.clone(), "phrases of 1 to 64 bytes without line breaks");
        }
        if self.meanings.len() > motionette::blob::MAX_BANK {
            return refuse(format!("{} of them", self.meanings.len()), "at most 512");
        }
        if !(self.threshold > 0.0 && self.threshold < 1.0) {
            let value = self.threshold.to_string();
            return Err(ErrorKind::Option {
                key: "threshold".into(),
                value,
                expected: "a share between 0 and 1".into(),
            });
        }
        Ok(())
    }

    fn check_vocabulary(&self) -> Result<()> {
        let refuse =
            |value: String, expected: String| Err(ErrorKind::Option { key: "vocabulary".into(), value, expected });
        let words = &self.vocabulary;
        if words.len() > MAX_ROWS
            || words.first().map(String::as_str) != Some(UNCONDITIONAL)
            || words.get(1).map(String::as_str) != Some(UNKNOWN)
        {
            let start = words.iter().take(2).cloned().collect::<Vec<_>>().join(", ");
            return refuse(
                format!("{} words that begin with {start:?}", words.len()),
                format!("{UNCONDITIONAL}, {UNKNOWN}, then at most {} others", MAX_ROWS - 2),
            );
        }
        let mut seen = std::collections::HashSet::new();
        for word in words {
            if word.is_empty() || word.len() > MAX_WORD || word.contains('\n') || !seen.insert(word) {
                let expected = format!("different words of at most {MAX_WORD} bytes without line breaks");
                return refuse(word.clone(), expected);
            }
        }
        Ok(())
    }
}
