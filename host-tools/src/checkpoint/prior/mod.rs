//! A motion prior in memory, put together from named tensors: the text encoder and the planner.
//!
//! Linears are torch's, `y = W x + b` with `W` `[out][in]`. The order in which [`PriorCheckpoint::text_parts`] and
//! [`PriorCheckpoint::planner_parts`] list the parts is that of a blob.

pub(super) mod config;

use std::path::Path;

pub use config::{
    Activation, BOUNDARIES, Corruption, Form, MAX_PHRASE, MAX_WORD, Meaning, NormOrder, PriorConfig, STRENGTHS, Sizes,
    TIMES, UNCONDITIONAL, UNKNOWN,
};

use sha2::{Digest, Sha256};

use super::error::{Error, ErrorKind, Result};
use super::tensors::TensorMap;
use super::tokenizer::{Conv1d, TokenizerCheckpoint};
use super::words::LARGEST;
use crate::input;

/// Value of `format` in the metadata.
pub const FORMAT: &str = "motionette-prior";
/// Value of `version` in the metadata.
pub const VERSION: &str = "1";

/// Weights and bias of `y = W x + b`.
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    /// Name without `.weight`.
    pub name: String,
    /// Numbers out.
    pub outputs: usize,
    /// Numbers in.
    pub inputs: usize,
    /// `[outputs][inputs]`.
    pub weight: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
}

impl Linear {
    /// The same as a convolution of one tap.
    #[must_use]
    pub fn as_convolution(&self) -> Conv1d {
        let Self { name, outputs, inputs, weight, bias } = self.clone();
        Conv1d { name, outputs, inputs, kernel: 1, weight, bias }
    }
}

/// A table with a row for every id.
#[derive(Debug, Clone, PartialEq)]
pub struct Embedding {
    /// Name without `.weight`.
    pub name: String,
    /// Ids.
    pub rows: usize,
    /// Numbers a row.
    pub width: usize,
    /// `[rows][width]`.
    pub weight: Vec<f32>,
}

impl Embedding {
    /// The rows as outputs of a convolution of one tap, without bias.
    #[must_use]
    pub fn as_convolution(&self) -> Conv1d {
        let Self { name, rows, width, weight } = self.clone();
        Conv1d { name, outputs: rows, inputs: width, kernel: 1, weight, bias: vec![0.0; rows] }
    }
}

/// `(x - mean) / sqrt(variance + epsilon) * weight + bias`.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerNorm {
    /// Name without `.weight`.
    pub name: String,
    /// `[width]`.
    pub weight: Vec<f32>,
    /// `[width]`.
    pub bias: Vec<f32>,
}

/// Attention of a row over the memory of a text.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossAttention {
    /// Its norm.
    pub norm: LayerNorm,
    /// d to d.
    pub query: Linear,
    /// Width of the memory to 2 d: keys, then values.
    pub key_value: Linear,
    /// d to d.
    pub output: Linear,
}

/// One layer of a transformer.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Norm of the self-attention.
    pub norm1: LayerNorm,
    /// d to 3 d: queries, keys, values.
    pub qkv: Linear,
    /// d to d.
    pub output: Linear,
    /// Cross-attention, in the planner.
    pub cross: Option<CrossAttention>,
    /// Norm of the feed-forward sublayer.
    pub norm2: LayerNorm,
    /// d to hidden.
    pub expand: Linear,
    /// Hidden to d.
    pub contract: Linear,
}

/// Words to a memory and a distribution over lengths.
#[derive(Debug, Clone, PartialEq)]
pub struct TextEncoder {
    /// What a word becomes.
    pub table: WordRows,
    /// A row a place in the prompt.
    pub position: Embedding,
    /// In order of execution.
    pub layers: Vec<Block>,
    /// Behind the last layer.
    pub norm: LayerNorm,
    /// Pooled memory to a class a length in tokens, class k = k + 1 tokens.
    pub length: Linear,
    /// Pooled memory to a logit for each of [`PriorConfig::meanings`], where the prior learnt them.
    pub meaning: Option<Linear>,
}

/// What words become before their places are added.
#[derive(Debug, Clone, PartialEq)]
pub enum WordRows {
    /// An embedding each.
    Embedding(Embedding),
    /// Vectors from elsewhere, through a linear.
    Vectors(WordVectors),
}

/// Vectors of words, `numbers * scale`, and what rows become of them.
#[derive(Debug, Clone, PartialEq)]
pub struct WordVectors {
    /// `[words - 2][dims]`, whole numbers from -7 to 7.
    pub numbers: Vec<f32>,
    /// `[words - 2]`, of half precision.
    pub scales: Vec<f32>,
    /// Rows of the two words without a vector, the unconditional and the unknown one.
    pub special: Embedding,
    /// Vectors to rows.
    pub projection: Linear,
}

/// Noisy tokens and a text to logits over clean tokens.
#[derive(Debug, Clone, PartialEq)]
pub struct Planner {
    /// Pooled memory to row 0.
    pub global: Linear,
    /// [`TIMES`] rows.
    pub time: Embedding,
    /// [`BOUNDARIES`] rows: `2 start_open + end_open`.
    pub boundary: Embedding,
    /// A row a place from the start.
    pub position: Embedding,
    /// A row a place from the end.
    pub end: Embedding,
    /// One row, added where a token is fixed.
    pub fixed: Embedding,
    /// [`STRENGTHS`] rows by the strength of guidance, of a planner that is told it; without them guidance takes two passes.
    pub guidance: Option<Embedding>,
    /// One row, of a masked token, where tokens are masked.
    pub mask: Option<Embedding>,
    /// In order of execution.
    pub layers: Vec<Block>,
    /// Behind the last layer.
    pub norm: LayerNorm,
    /// Logits; its rows are the embeddings of the tokens as well.
    pub token: Linear,
}

/// Anything with weights.
#[derive(Debug, Clone, Copy)]
pub enum Part<'a> {
    /// A linear.
    Linear(&'a Linear),
    /// A table.
    Embedding(&'a Embedding),
    /// A norm.
    Norm(&'a LayerNorm),
}

impl<'a> Part<'a> {
    /// Its tensors by their names in a checkpoint.
    fn tensors(self) -> Vec<(String, &'a [f32])> {
        let (name, weight, bias) = match self {
            Part::Linear(linear) => (&linear.name, &linear.weight, Some(&linear.bias)),
            Part::Embedding(table) => (&table.name, &table.weight, None),
            Part::Norm(norm) => (&norm.name, &norm.weight, Some(&norm.bias)),
        };
        let bias = bias.map(|bias| (format!("{name}.bias"), bias.as_slice()));
        core::iter::once((format!("{name}.weight"), weight.as_slice())).chain(bias).collect()
    }
}

/// Anything with weights, to change it.
#[derive(Debug)]
pub enum PartMut<'a> {
    /// A linear.
    Linear(&'a mut Linear),
    /// A table.
    Embedding(&'a mut Embedding),
    /// A norm.
    Norm(&'a mut LayerNorm),
}

/// A prior read from a checkpoint, checked: every tensor present, of the shape the configuration says, finite.
#[derive(Debug, Clone, PartialEq)]
pub struct PriorCheckpoint {
    /// Sizes, vocabulary and provenance.
    pub config: PriorConfig,
    /// The text encoder.
    pub text: TextEncoder,
    /// The planner.
    pub planner: Planner,
}

/// Reads a prior checkpoint (`nano.prior.safetensors`).
///
/// # Errors
/// [`Error`] with the path and what is wrong.
pub fn load(path: &Path) -> core::result::Result<PriorCheckpoint, Error> {
    let read = || of_bytes(&input::read(path, input::ANY)?);
    read().map_err(|kind| Error { path: path.to_owned(), kind })
}

/// Reads one that is in memory; errors call it `name`.
///
/// # Errors
/// As [`load`].
pub fn from_bytes(bytes: &[u8], name: &str) -> core::result::Result<PriorCheckpoint, Error> {
    of_bytes(bytes).map_err(|kind| Error { path: name.into(), kind })
}

fn of_bytes(bytes: &[u8]) -> Result<PriorCheckpoint> {
    let (map, config) = super::of_format(bytes, FORMAT, VERSION)?;
    PriorCheckpoint::build(&map, PriorConfig::from_json(&config)?)
}

/// Words without a vector.
pub const SPECIAL: usize = 2;
/// Names of the tensors of words' vectors.
const VECTORS: &str = "text.vectors.weight";
const SCALES: &str = "text.scales.weight";

/// Takes tensors out of a map.
pub(super) struct Builder<'a> {
    pub(super) map: &'a TensorMap,
}

impl Builder<'_> {
    pub(super) fn tensor(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let shape: Vec<Option<usize>> = shape.iter().copied().map(Some).collect();
        Ok(self.map.get(name, &shape)?.data.clone())
    }

    pub(super) fn linear(&self, name: String, outputs: usize, inputs: usize) -> Result<Linear> {
        let weight = self.tensor(&format!("{name}.weight"), &[outputs, inputs])?;
        let bias = self.tensor(&format!("{name}.bias"), &[outputs])?;
        Ok(Linear { name, outputs, inputs, weight, bias })
    }

    pub(super) fn embedding(&self, name: &str, rows: usize, width: usize) -> Result<Embedding> {
        let weight = self.tensor(&format!("{name}.weight"), &[rows, width])?;
        Ok(Embedding { name: name.to_owned(), rows, width, weight })
    }

    fn word_rows(&self, config: &PriorConfig) -> Result<WordRows> {
        let (words, dims, dt) = (config.vocabulary.len(), config.word_vectors, config.text.width);
        if dims == 0 {
            return Ok(WordRows::Embedding(self.embedding("text.embedding", words, dt)?));
        }
        let numbers = self.tensor(VECTORS, &[words - SPECIAL, dims])?;
        let scales = self.tensor(SCALES, &[words - SPECIAL, 1])?;
        let refuse =
            |tensor: &str, what: &str| Err(ErrorKind::Extent { tensor: tensor.to_owned(), what: what.to_owned() });
        let largest = f32::from(LARGEST);
        if numbers.iter().any(|number| number.fract() != 0.0 || number.abs() > largest) {
            return refuse(VECTORS, "holds other numbers than whole ones from -7 to 7");
        }
        if scales.iter().any(|scale| *scale <= 0.0 || half::f16::from_f32(*scale).to_f32() != *scale) {
            return refuse(SCALES, "holds other scales than positive ones of half precision");
        }
        let special = self.embedding("text.special", SPECIAL, dt)?;
        let projection = self.linear("text.projection".into(), dt, dims)?;
        Ok(WordRows::Vectors(WordVectors { numbers, scales, special, projection }))
    }

    fn meaning(&self, config: &PriorConfig) -> Result<Option<Linear>> {
        let (count, dt) = (config.meanings.len(), config.text.width);
        (count > 0).then(|| self.linear("text.meaning".into(), count, dt)).transpose()
    }

    pub(super) fn norm(&self, name: String, width: usize) -> Result<LayerNorm> {
        let weight = self.tensor(&format!("{name}.weight"), &[width])?;
        let bias = self.tensor(&format!("{name}.bias"), &[width])?;
        Ok(LayerNorm { name, weight, bias })
    }

    /// `memory`: width of the rows that cross-attention looks at.
    pub(super) fn layers(&self, base: &str, sizes: Sizes, memory: Option<usize>) -> Result<Vec<Block>> {
        let Sizes { width, hidden, .. } = sizes;
        let cross = |name: &str, memory: usize| -> Result<CrossAttention> {
            Ok(CrossAttention {
                norm: self.norm(format!("{name}.norm_cross"), width)?,
                query: self.linear(format!("{name}.cross.q"), width, width)?,
                key_value: self.linear(format!("{name}.cross.kv"), 2 * width, memory)?,
                output: self.linear(format!("{name}.cross.out"), width, width)?,
            })
        };
        let block = |i: usize| {
            let name = format!("{base}.layers.{i}");
            Ok(Block {
                norm1: self.norm(format!("{name}.norm1"), width)?,
                qkv: self.linear(format!("{name}.attention.qkv"), 3 * width, width)?,
                output: self.linear(format!("{name}.attention.out"), width, width)?,
                cross: memory.map(|memory| cross(&name, memory)).transpose()?,
                norm2: self.norm(format!("{name}.norm2"), width)?,
                expand: self.linear(format!("{name}.ffn.in"), hidden, width)?,
                contract: self.linear(format!("{name}.ffn.out"), width, hidden)?,
            })
        };
        (0..sizes.layers).map(block).collect()
    }
}

impl PriorCheckpoint {
    /// Puts a prior together and checks every tensor against `config`.
    ///
    /// # Errors
    /// The first tensor that is missing, misshapen or not finite, by name; [`ErrorKind::Option`] for a configuration out of range.
    pub fn build(map: &TensorMap, config: PriorConfig) -> Result<Self> {
        config.check()?;
        let builder = Builder { map };
        let (dt, d) = (config.text.width, config.planner.width);
        let text = TextEncoder {
            table: builder.word_rows(&config)?,
            position: builder.embedding("text.position", config.max_words, dt)?,
            layers: builder.layers("text", config.text, None)?,
            norm: builder.norm("text.norm".into(), dt)?,
            length: builder.linear("text.length".into(), config.max_tokens, dt)?,
            meaning: builder.meaning(&config)?,
        };
        let planner = Planner {
            global: builder.linear("planner.global".into(), d, dt)?,
            time: builder.embedding("planner.time", TIMES, d)?,
            boundary: builder.embedding("planner.boundary", BOUNDARIES, d)?,
            position: builder.embedding("planner.position", config.max_tokens, d)?,
            end: builder.embedding("planner.end", config.max_tokens, d)?,
            fixed: builder.embedding("planner.fixed", 1, d)?,
            guidance: config.guidance.then(|| builder.embedding("planner.guidance", STRENGTHS, d)).transpose()?,
            mask: (!config.corruption.is_near()).then(|| builder.embedding("planner.mask", 1, d)).transpose()?,
            layers: builder.layers("planner", config.planner, Some(dt))?,
            norm: builder.norm("planner.norm".into(), d)?,
            token: builder.linear("planner.token".into(), config.codes, d)?,
        };
        Ok(Self { config, text, planner })
    }

    /// Refuses a tokenizer other than the one whose tokens the prior was trained on.
    ///
    /// # Errors
    /// [`ErrorKind::Option`] when the sizes differ, [`ErrorKind::OtherTokenizer`] when the codebook does.
    pub fn check_tokenizer(&self, tokenizer: &TokenizerCheckpoint) -> Result<()> {
        let c = &tokenizer.config;
        let sizes = [
            ("codes", self.config.codes, c.codes),
            ("code_dim", self.config.code_dim, c.code_dim),
            ("quantizers", 1, c.quantizers),
        ];
        for (key, value, expected) in sizes {
            if value != expected {
                let expected = format!("{expected}, as the tokenizer has");
                return Err(ErrorKind::Option { key: key.into(), value: value.to_string(), expected });
            }
        }
        let actual = codebook_hash(tokenizer.codebooks.iter().flatten());
        if actual == self.config.tokenizer {
            return Ok(());
        }
        Err(ErrorKind::OtherTokenizer { expected: self.config.tokenizer.clone(), actual })
    }

    /// The same with those of its words with vectors that `keep` accepts by row and word.
    #[must_use]
    pub fn with_words(mut self, keep: impl Fn(usize, &str) -> bool) -> Self {
        let WordRows::Vectors(vectors) = &mut self.text.table else { return self };
        let config = &mut self.config;
        let words = config.vocabulary.split_off(SPECIAL);
        let kept: Vec<usize> = (0..words.len()).filter(|row| keep(*row, &words[*row])).collect();
        let dims = config.word_vectors;
        vectors.numbers = kept.iter().flat_map(|row| &vectors.numbers[row * dims..][..dims]).copied().collect();
        vectors.scales = kept.iter().map(|row| vectors.scales[*row]).collect();
        if !config.word_tiers.is_empty() {
            config.word_tiers = kept.iter().map(|row| config.word_tiers[*row]).collect();
        }
        config.vocabulary.extend(kept.iter().map(|row| words[*row].clone()));
        self
    }

    /// [`weights_hash`] of all tensors that were trained: how a control checkpoint names the prior it was trained on.
    #[must_use]
    pub fn weights_hash(&self) -> String {
        let parts = self.text_parts().into_iter().chain(self.planner_parts());
        let tensors: Vec<(String, &[f32])> = parts.flat_map(Part::tensors).collect();
        weights_hash(tensors.iter().map(|(name, values)| (name.as_str(), *values)))
    }

    /// Parts of the text encoder in the order of a blob.
    #[must_use]
    pub fn text_parts(&self) -> Vec<Part<'_>> {
        let t = &self.text;
        let mut parts = match &t.table {
            WordRows::Embedding(table) => vec![Part::Embedding(table)],
            WordRows::Vectors(v) => vec![Part::Embedding(&v.special), Part::Linear(&v.projection)],
        };
        parts.push(Part::Embedding(&t.position));
        t.layers.iter().for_each(|b| b.parts(&mut parts));
        parts.extend([Part::Norm(&t.norm), Part::Linear(&t.length)]);
        parts.extend(t.meaning.as_ref().map(Part::Linear));
        parts
    }

    /// Parts of the planner in the order of a blob.
    #[must_use]
    pub fn planner_parts(&self) -> Vec<Part<'_>> {
        let p = &self.planner;
        let tables = [&p.time, &p.boundary, &p.position, &p.end, &p.fixed];
        let mut parts = vec![Part::Linear(&p.global)];
        parts.extend(tables.map(Part::Embedding));
        parts.extend([&p.guidance, &p.mask].into_iter().flatten().map(Part::Embedding));
        p.layers.iter().for_each(|b| b.parts(&mut parts));
        parts.extend([Part::Norm(&p.norm), Part::Linear(&p.token)]);
        parts
    }

    /// Parts of both, text encoder first, to change them.
    #[must_use]
    pub fn parts_mut(&mut self) -> Vec<PartMut<'_>> {
        let (t, p) = (&mut self.text, &mut self.planner);
        let mut parts = match &mut t.table {
            WordRows::Embedding(table) => vec![PartMut::Embedding(table)],
            WordRows::Vectors(v) => vec![PartMut::Embedding(&mut v.special), PartMut::Linear(&mut v.projection)],
        };
        parts.push(PartMut::Embedding(&mut t.position));
        t.layers.iter_mut().for_each(|b| b.parts_mut(&mut parts));
        parts.extend([PartMut::Norm(&mut t.norm), PartMut::Linear(&mut t.length)]);
        parts.extend(t.meaning.as_mut().map(PartMut::Linear));
        parts.push(PartMut::Linear(&mut p.global));
        let tables = [&mut p.time, &mut p.boundary, &mut p.position, &mut p.end, &mut p.fixed];
        parts.extend(tables.map(PartMut::Embedding));
        parts.extend([&mut p.guidance, &mut p.mask].into_iter().flatten().map(PartMut::Embedding));
        p.layers.iter_mut().for_each(|b| b.parts_mut(&mut parts));
        parts.extend([PartMut::Norm(&mut p.norm), PartMut::Linear(&mut p.token)]);
        parts
    }
}

impl Block {
    pub(super) fn parts<'a>(&'a self, parts: &mut Vec<Part<'a>>) {
        parts.extend([Part::Norm(&self.norm1), Part::Linear(&self.qkv), Part::Linear(&self.output)]);
        if let Some(c) = &self.cross {
            parts.push(Part::Norm(&c.norm));
            parts.extend([&c.query, &c.key_value, &c.output].map(Part::Linear));
        }
        parts.extend([Part::Norm(&self.norm2), Part::Linear(&self.expand), Part::Linear(&self.contract)]);
    }

    pub(super) fn parts_mut<'a>(&'a mut self, parts: &mut Vec<PartMut<'a>>) {
        parts.extend([
            PartMut::Norm(&mut self.norm1),
            PartMut::Linear(&mut self.qkv),
            PartMut::Linear(&mut self.output),
        ]);
        if let Some(c) = &mut self.cross {
            parts.push(PartMut::Norm(&mut c.norm));
            parts.extend([&mut c.query, &mut c.key_value, &mut c.output].map(PartMut::Linear));
        }
        parts.extend([
            PartMut::Norm(&mut self.norm2),
            PartMut::Linear(&mut self.expand),
            PartMut::Linear(&mut self.contract),
        ]);
    }
}

/// SHA-256, hex, over the little-endian bytes of the values of all codebooks: how a prior names its tokenizer.
#[must_use]
pub fn codebook_hash<'c>(values: impl IntoIterator<Item = &'c f32>) -> String {
    let mut hash = Sha256::new();
    values.into_iter().for_each(|v| hash.update(v.to_le_bytes()));
    hex(hash)
}

/// SHA-256, hex, over named tensors in the order of their names: the bytes of the name, then the little-endian bytes of the values.
#[must_use]
pub fn weights_hash<'t>(tensors: impl IntoIterator<Item = (&'t str, &'t [f32])>) -> String {
    let mut tensors: Vec<(&str, &[f32])> = tensors.into_iter().collect();
    tensors.sort_unstable_by_key(|(name, _)| *name);
    let mut hash = Sha256::new();
    for (name, values) in tensors {
        hash.update(name);
        values.iter().for_each(|v| hash.update(v.to_le_bytes()));
    }
    hex(hash)
}

fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}
