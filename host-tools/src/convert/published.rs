//! Published planners as a blob holds them: products of matrices that meet without anything between them are multiplied once, here, in f64.
//!
//! | of the checkpoint | in the blob |
//! |---|---|
//! | MoMask: `poseEmbedding . token_emb`, its bias included | a row a token, and one for `[MASK]` |
//! | `position_enc`, as many rows as the longest motion has tokens | a row a place |
//! | residual: `poseEmbedding . token_embed[q]` | a row a token of each quantizer but the last; the bias is in the rows of places |
//! | `quant_emb . onehot(q)` | a row a quantizer |
//! | `output_proj[q] . poseFinal` | a linear a quantizer but the first |
//! | T2M-GPT: `cond_emb` and the place of its row | one linear |
//! | its other places, and its tokens without the two that are never read | a row each |

use motionette::blob::{HeadConfig, PrefixConfig, ResidualConfig, TransformerConfig};

use super::Error;
use super::blob::transformer_config;
use super::conv1d::Options;
use super::prior::{Inputs, QuantisedPart, quantised};
use crate::blob::QuantisedConv1d;
use crate::blob::write::narrow;
use crate::checkpoint::prior::{Block, Embedding, Form, LayerNorm, Linear, Part};
use crate::checkpoint::published::momask::{self, Trunk};
use crate::checkpoint::published::t2mgpt;
use crate::checkpoint::published::{Gpt, Mask, PublishedPlanner, Residual};
use crate::checkpoint::{Conv1d, ErrorKind, TokenizerCheckpoint};

/// Guidance of MoMask's evaluation, of the mask and of the residual transformer.
const GUIDANCE: (f32, f32) = (4.0, 5.0);

/// A published planner that goes into a blob, and how.
#[derive(Debug, Clone, Copy)]
pub struct PublishedSource<'a> {
    /// Mask transformer or GPT.
    pub planner: &'a PublishedPlanner,
    /// What plans the further quantizers.
    pub residual: Option<&'a Residual>,
    /// Prompts to store: a vector each.
    pub bank: &'a [super::bank::Entry],
}

/// Its planners in integers, in the order of a blob.
#[derive(Debug, Clone, PartialEq)]
pub struct QuantisedPublished {
    /// Of the first quantizer.
    pub planner: Vec<QuantisedPart>,
    /// Of the others; empty without one.
    pub residual: Vec<QuantisedPart>,
}

/// Anything with weights, folded.
#[derive(Debug, Clone, PartialEq)]
enum Folded {
    Linear(Linear),
    Table(Embedding),
    Norm(LayerNorm),
}

impl Folded {
    const fn part(&self) -> Part<'_> {
        match self {
            Self::Linear(linear) => Part::Linear(linear),
            Self::Table(table) => Part::Embedding(table),
            Self::Norm(norm) => Part::Norm(norm),
        }
    }
}

impl Folded {
    fn quantised(&self, options: &Options) -> QuantisedPart {
        let wide = |source: &Conv1d| QuantisedConv1d::new(source, (source.outputs, 8), &Options::PLAIN, None);
        match self {
            Self::Linear(linear) if options.wide_planner && options.four_bits.of(&linear.name) == 8 => {
                QuantisedPart::Linear(wide(&linear.as_convolution()))
            }
            Self::Table(table) if options.wide_planner => QuantisedPart::Table(wide(&table.as_convolution())),
            other => quantised(other.part(), options, &Inputs::new()),
        }
    }
}

impl PublishedSource<'_> {
    /// Refuses planners that do not belong to the tokenizer or to each other.
    pub(super) fn check(&self, tokenizer: &TokenizerCheckpoint) -> Result<(), Error> {
        let mismatch =
            |what: &str, found: usize, expected: usize| Err(Error::Planner { what: what.to_owned(), found, expected });
        let c = &tokenizer.config;
        let codes = match self.planner {
            PublishedPlanner::Mask(mask) => mask.codes,
            PublishedPlanner::Gpt(gpt) => gpt.codes,
            PublishedPlanner::Residual(_) => {
                return Err(Error::Prior(ErrorKind::Extent {
                    tensor: "quant_emb.weight".into(),
                    what: "is of a residual transformer, which plans nothing alone; give it with --residual".into(),
                }));
            }
        };
        if codes != c.codes {
            return mismatch("the planner's codes", codes, c.codes);
        }
        if let Some(entry) = self.bank.iter().find(|entry| entry.rows.len() != self.vector()) {
            let what = format!("the numbers of the stored prompt {:?}", entry.name);
            return Err(Error::Vector { what, found: entry.rows.len(), expected: self.vector() });
        }
        let Some(residual) = self.residual else { return Ok(()) };
        if !matches!(self.planner, PublishedPlanner::Mask(_)) {
            return mismatch("layers of codes of T2M-GPT, which a residual transformer cannot follow,", 1, 2);
        }
        if residual.codes != c.codes {
            return mismatch("the residual transformer's codes", residual.codes, c.codes);
        }
        if residual.quantizers != c.quantizers {
            return mismatch("the residual transformer's layers of codes", residual.quantizers, c.quantizers);
        }
        if residual.trunk.condition.inputs != self.vector() {
            return mismatch(
                "width of the residual transformer's text",
                residual.trunk.condition.inputs,
                self.vector(),
            );
        }
        Ok(())
    }

    /// Numbers of a prompt's vector.
    pub(super) const fn vector(&self) -> usize {
        match self.planner {
            PublishedPlanner::Mask(mask) => mask.trunk.condition.inputs,
            PublishedPlanner::Residual(residual) => residual.trunk.condition.inputs,
            PublishedPlanner::Gpt(gpt) => gpt.condition.inputs,
        }
    }

    /// Longest motion, tokens: 196 frames, or as many as there are places.
    pub(super) fn max_tokens(&self) -> usize {
        let places = match self.planner {
            PublishedPlanner::Mask(mask) => mask.trunk.positions.rows.min(super::MAX_TOKENS),
            PublishedPlanner::Residual(residual) => residual.trunk.positions.rows,
            // The first is the text's.
            PublishedPlanner::Gpt(gpt) => gpt.positions.rows.saturating_sub(1),
        };
        self.residual.map_or(places, |residual| places.min(residual.trunk.positions.rows))
    }

    /// What the manifest says of it.
    pub(super) fn config(&self) -> Result<PrefixConfig, Error> {
        let (form, sizes, head, guidance) = match self.planner {
            PublishedPlanner::Gpt(gpt) => (t2mgpt::FORM, gpt.sizes, HeadConfig::Norm, 1.0),
            PublishedPlanner::Mask(Mask { trunk, .. }) | PublishedPlanner::Residual(Residual { trunk, .. }) => {
                let head = HeadConfig::Dense { epsilon: momask::HEAD_EPSILON as f32 };
                (momask::FORM, trunk.sizes, head, GUIDANCE.0)
            }
        };
        let transformer = |form: Form, sizes| -> Result<TransformerConfig, Error> { transformer_config(form, sizes) };
        let residual = |residual: &Residual| -> Result<ResidualConfig, Error> {
            Ok(ResidualConfig {
                transformer: transformer(momask::FORM, residual.trunk.sizes)?,
                epsilon: momask::HEAD_EPSILON as f32,
                guidance: GUIDANCE.1,
            })
        };
        Ok(PrefixConfig {
            max_tokens: narrow(self.max_tokens(), "longest motion")?,
            transformer: transformer(form, sizes)?,
            head,
            guidance,
            residual: self.residual.map(residual).transpose()?,
        })
    }

    /// Its planners in integers.
    pub(super) fn quantise(&self, options: &Options) -> QuantisedPublished {
        let all = |parts: Vec<Folded>| crate::parallel::map(&parts, |part| part.quantised(options));
        let places = self.max_tokens();
        QuantisedPublished {
            planner: all(match self.planner {
                PublishedPlanner::Mask(mask) => fold_mask(mask, places),
                PublishedPlanner::Gpt(gpt) => fold_gpt(gpt, places),
                PublishedPlanner::Residual(_) => Vec::new(),
            }),
            residual: all(self.residual.map(|residual| fold_residual(residual, places)).unwrap_or_default()),
        }
    }
}

/// `[rows][inner] x [outputs][inner] -> [rows][outputs]`, with a bias where there is one.
fn product(rows: &[f32], weight: &[f32], inner: usize, bias: Option<&[f32]>) -> Vec<f32> {
    let mut all = Vec::with_capacity(rows.len() / inner * (weight.len() / inner));
    for row in rows.chunks_exact(inner) {
        for (output, weights) in weight.chunks_exact(inner).enumerate() {
            let sum: f64 = row.iter().zip(weights).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
            all.push((sum + bias.map_or(0.0, |bias| f64::from(bias[output]))) as f32);
        }
    }
    all
}

/// The layer of `outer` behind `inner`: `outer(inner(x))`.
fn behind(inner: &Linear, outer: &Linear, name: String) -> Linear {
    let columns: Vec<f32> =
        (0..inner.inputs).flat_map(|column| inner.weight.iter().skip(column).step_by(inner.inputs)).copied().collect();
    Linear {
        name,
        outputs: outer.outputs,
        inputs: inner.inputs,
        weight: product(&outer.weight, &columns, inner.outputs, None),
        bias: product(&inner.bias, &outer.weight, inner.outputs, Some(&outer.bias)),
    }
}

/// The first `rows` rows.
fn first_rows(table: &Embedding, from: usize, rows: usize, name: &str) -> Embedding {
    let weight = table.weight[from * table.width..(from + rows) * table.width].to_vec();
    Embedding { name: name.to_owned(), rows, width: table.width, weight }
}

fn renamed(linear: &Linear, name: String) -> Folded {
    Folded::Linear(Linear { name, ..linear.clone() })
}

fn norm(norm: &LayerNorm, name: String) -> Folded {
    Folded::Norm(LayerNorm { name, ..norm.clone() })
}

/// The blocks in the order of a blob, under its names.
fn blocks(layers: &[Block], base: &str) -> Vec<Folded> {
    let parts = layers.iter().enumerate().flat_map(|(i, block)| {
        let name = format!("{base}.layers.{i}");
        [
            norm(&block.norm1, format!("{name}.norm1")),
            renamed(&block.qkv, format!("{name}.attention.qkv")),
            renamed(&block.output, format!("{name}.attention.out")),
            norm(&block.norm2, format!("{name}.norm2")),
            renamed(&block.expand, format!("{name}.ffn.in")),
            renamed(&block.contract, format!("{name}.ffn.out")),
        ]
    });
    parts.collect()
}

fn fold_mask(mask: &Mask, places: usize) -> Vec<Folded> {
    let Trunk { condition, input, positions, layers, dense, norm: last, output, .. } = &mask.trunk;
    let rows = mask.codes + 1;
    let tokens = &mask.tokens.weight[..rows * mask.tokens.width];
    let tokens = product(tokens, &input.weight, input.inputs, Some(&input.bias));
    let mut parts = vec![
        renamed(condition, "planner.global".into()),
        Folded::Table(Embedding { name: "planner.tokens".into(), rows, width: input.outputs, weight: tokens }),
        Folded::Table(first_rows(positions, 0, places, "planner.position")),
    ];
    parts.extend(blocks(layers, "planner"));
    parts.extend([
        renamed(dense, "planner.dense".into()),
        norm(last, "planner.norm".into()),
        renamed(output, "planner.token".into()),
    ]);
    parts
}

fn fold_residual(residual: &Residual, places: usize) -> Vec<Folded> {
    let Trunk { condition, input, positions, layers, dense, norm: last, output, .. } = &residual.trunk;
    let (width, quantizer) = (input.outputs, &residual.quantizer);
    let quantizers = (0..residual.quantizers).flat_map(|q| {
        let column = quantizer.weight.iter().skip(q).step_by(quantizer.inputs);
        column.zip(&quantizer.bias).map(|(weight, bias)| weight + bias)
    });
    let quantizers =
        Embedding { name: "residual.quantizer".into(), rows: residual.quantizers, width, weight: quantizers.collect() };
    let mut position = first_rows(positions, 0, places, "residual.position");
    for row in position.weight.chunks_exact_mut(width) {
        row.iter_mut().zip(&input.bias).for_each(|(v, bias)| *v += bias);
    }
    let mut parts =
        vec![renamed(condition, "residual.global".into()), Folded::Table(quantizers), Folded::Table(position)];
    for (q, tables) in residual.tables.iter().enumerate() {
        let weight = product(&tables.input.weight, &input.weight, input.inputs, None);
        let rows = tables.input.rows;
        parts.push(Folded::Table(Embedding { name: format!("residual.tokens.{q}"), rows, width, weight }));
    }
    parts.extend(blocks(layers, "residual"));
    parts.extend([renamed(dense, "residual.dense".into()), norm(last, "residual.norm".into())]);
    for (q, tables) in residual.tables.iter().enumerate() {
        parts.push(Folded::Linear(behind(output, &tables.output, format!("residual.token.{q}"))));
    }
    parts
}

fn fold_gpt(gpt: &Gpt, places: usize) -> Vec<Folded> {
    let mut condition = Linear { name: "planner.global".into(), ..gpt.condition.clone() };
    condition.bias.iter_mut().zip(&gpt.positions.weight).for_each(|(bias, place)| *bias += place);
    let mut parts = vec![
        Folded::Linear(condition),
        Folded::Table(first_rows(&gpt.tokens, 0, gpt.codes, "planner.tokens")),
        Folded::Table(first_rows(&gpt.positions, 1, places, "planner.position")),
    ];
    parts.extend(blocks(&gpt.layers, "planner"));
    parts.extend([norm(&gpt.norm, "planner.norm".into()), renamed(&gpt.output, "planner.token".into())]);
    parts
}
