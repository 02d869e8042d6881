//! MoMask's transformers: `[condition] + tokens` to logits, `[condition, quantizer] + tokens` to logits of the next layer of codes.

use super::{Block, Builder, Embedding, LayerNorm, Linear, MAX_COUNT, MAX_EXTENT, Options, Result, Sizes, TensorMap};
use super::{check_heads, extents};
use crate::checkpoint::error::ErrorKind;
use crate::checkpoint::prior::{Activation, Form, NormOrder};

/// Of its blocks.
pub const FORM: Form = Form { epsilon: 1e-5, norm: NormOrder::Post, activation: Activation::Gelu };
/// What the norm in front of the logits adds to the variance.
pub const HEAD_EPSILON: f64 = 1e-12;

/// What both transformers have in common.
#[derive(Debug, Clone, PartialEq)]
pub struct Trunk {
    /// Width, heads, layers.
    pub sizes: Sizes,
    /// A text's vector to the first row.
    pub condition: Linear,
    /// A code's embedding to a row.
    pub input: Linear,
    /// Added to the rows of tokens, counted from 0: a row a place.
    pub positions: Embedding,
    /// In order of execution; no norm follows.
    pub layers: Vec<Block>,
    /// Behind the last layer, in front of an activation (GELU).
    pub dense: Linear,
    /// Behind that, with [`HEAD_EPSILON`].
    pub norm: LayerNorm,
    /// Behind that: logits, or an embedding that is compared with those of codes.
    pub output: Linear,
}

/// The mask transformer.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// The network; its output has a logit a code.
    pub trunk: Trunk,
    /// Codes V. Token V stands for what is to be planned, V + 1 for nothing at all.
    pub codes: usize,
    /// Embeddings of V + 2 tokens.
    pub tokens: Embedding,
}

/// Embeddings of a layer of codes, as they come in and as they are to come out.
#[derive(Debug, Clone, PartialEq)]
pub struct Tables {
    /// V + 1 rows: what a token of this layer adds to the input; token V adds what padding adds.
    pub input: Embedding,
    /// V + 1 rows: logits of the layer above are products with them.
    pub output: Linear,
}

/// The residual transformer.
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    /// The network; its output has the width of an embedding.
    pub trunk: Trunk,
    /// Codes V of each layer. Token V stands for nothing at all.
    pub codes: usize,
    /// Layers Q of codes, the first of them planned by a mask transformer.
    pub quantizers: usize,
    /// Which layer is to be planned, one of Q, to the second row.
    pub quantizer: Linear,
    /// For each layer but the last its input, and the output of the next.
    pub tables: Vec<Tables>,
}

impl Trunk {
    fn build(map: &TensorMap, options: &Options) -> Result<Self> {
        let builder = Builder { map };
        let sizes = Sizes {
            width: options.count("latent_dim", MAX_EXTENT)?,
            heads: options.count("n_heads", MAX_COUNT)?,
            layers: options.count("n_layers", MAX_COUNT)?,
            hidden: options.count("ff_size", MAX_EXTENT)?,
        };
        check_heads("n_heads", sizes)?;
        let width = sizes.width;
        let [_, condition] = extents(map, "cond_emb.weight")?;
        let [_, code] = extents(map, "input_process.poseEmbedding.weight")?;
        let [outputs, _] = extents(map, "output_process.poseFinal.weight")?;
        let [places, one, _] = extents(map, "position_enc.pe")?;
        let positions = builder.tensor("position_enc.pe", &[places, one, width])?;
        if one != 1 {
            let what = format!("holds {one} tables, expected one");
            return Err(ErrorKind::Extent { tensor: "position_enc.pe".into(), what });
        }
        let beyond = format!("seqTransEncoder.layers.{}.", sizes.layers);
        if map.names().any(|name| name.starts_with(&beyond)) {
            return Err(ErrorKind::Option {
                key: "n_layers".into(),
                value: sizes.layers.to_string(),
                expected: "as many layers as the checkpoint has, which has more".into(),
            });
        }
        Ok(Self {
            sizes,
            condition: builder.linear("cond_emb".into(), width, condition)?,
            input: builder.linear("input_process.poseEmbedding".into(), width, code)?,
            positions: Embedding { name: "position_enc.pe".into(), rows: places, width, weight: positions },
            layers: (0..sizes.layers).map(|layer| block(&builder, layer, sizes)).collect::<Result<_>>()?,
            dense: builder.linear("output_process.dense".into(), width, width)?,
            norm: builder.norm("output_process.LayerNorm".into(), width)?,
            output: builder.linear("output_process.poseFinal".into(), outputs, width)?,
        })
    }

    /// Width of an embedding of a code.
    #[must_use]
    pub fn code_dim(&self) -> usize {
        self.input.inputs
    }
}

/// One of torch's encoder layers.
fn block(builder: &Builder<'_>, layer: usize, sizes: Sizes) -> Result<Block> {
    let Sizes { width, hidden, .. } = sizes;
    let name = format!("seqTransEncoder.layers.{layer}");
    let attention = format!("{name}.self_attn");
    Ok(Block {
        norm1: builder.norm(format!("{name}.norm1"), width)?,
        qkv: Linear {
            weight: builder.tensor(&format!("{attention}.in_proj_weight"), &[3 * width, width])?,
            bias: builder.tensor(&format!("{attention}.in_proj_bias"), &[3 * width])?,
            name: format!("{attention}.in_proj"),
            outputs: 3 * width,
            inputs: width,
        },
        output: builder.linear(format!("{attention}.out_proj"), width, width)?,
        cross: None,
        norm2: builder.norm(format!("{name}.norm2"), width)?,
        expand: builder.linear(format!("{name}.linear1"), hidden, width)?,
        contract: builder.linear(format!("{name}.linear2"), width, hidden)?,
    })
}

impl Mask {
    /// Puts it together and checks every tensor against its options.
    ///
    /// # Errors
    /// As [`super::PublishedPlanner::build`].
    pub fn build(map: &TensorMap, options: &Options) -> Result<Self> {
        let trunk = Trunk::build(map, options)?;
        let codes = trunk.output.outputs;
        let tokens = Builder { map }.embedding("token_emb", codes + 2, trunk.code_dim())?;
        Ok(Self { trunk, codes, tokens })
    }
}

impl Residual {
    /// Puts it together and checks every tensor against its options.
    ///
    /// # Errors
    /// As [`super::PublishedPlanner::build`].
    pub fn build(map: &TensorMap, options: &Options) -> Result<Self> {
        let trunk = Trunk::build(map, options)?;
        let builder = Builder { map };
        let [_, quantizers] = extents(map, "quant_emb.weight")?;
        let quantizer = builder.linear("quant_emb".into(), trunk.sizes.width, quantizers)?;
        // With shared weights a layer comes in as the embeddings as which it went out; the first and the last have their own.
        let shared = map.find("embed_proj_shared_weight").is_some() || map.find("token_embed_weight_").is_some();
        let [own, first, last] = match shared {
            true => ["embed_proj_shared_weight", "token_embed_weight_", "output_proj_weight_"],
            false => ["", "token_embed_weight", "output_proj_weight"],
        };
        let [_, rows, _] = extents(map, first)?;
        let (code, codes) = (trunk.code_dim(), rows.saturating_sub(1));
        if trunk.output.outputs != code {
            let what = format!("has {} outputs, embeddings have {code}", trunk.output.outputs);
            return Err(ErrorKind::Extent { tensor: "output_process.poseFinal.weight".into(), what });
        }
        if quantizers < 2 || codes == 0 {
            let what = format!("is for {quantizers} layers of {codes} codes, expected two or more");
            return Err(ErrorKind::Extent { tensor: "quant_emb.weight".into(), what });
        }
        let tables = |name: &str, count: usize| -> Result<Vec<Vec<f32>>> {
            if count == 0 {
                return Ok(Vec::new());
            }
            let all = builder.tensor(name, &[count, rows, code])?;
            Ok(all.chunks_exact(rows * code).map(<[f32]>::to_vec).collect())
        };
        let (inputs, outputs) = match shared {
            true => {
                let between = tables(own, quantizers - 2)?;
                ([tables(first, 1)?, between.clone()].concat(), [between, tables(last, 1)?].concat())
            }
            false => (tables(first, quantizers - 1)?, tables(last, quantizers - 1)?),
        };
        let biases = match map.find("output_proj_bias") {
            None => vec![vec![0.0; rows]; quantizers - 1],
            Some(_) => {
                let [count, _] = extents(map, "output_proj_bias")?;
                let all = builder.tensor("output_proj_bias", &[count.max(quantizers - 1), rows])?;
                all.chunks_exact(rows).take(quantizers - 1).map(<[f32]>::to_vec).collect()
            }
        };
        let tables =
            inputs.into_iter().zip(outputs).zip(biases).enumerate().map(|(layer, ((input, weight), bias))| Tables {
                input: Embedding { name: format!("token_embed.{layer}"), rows, width: code, weight: input },
                output: Linear { name: format!("output_proj.{layer}"), outputs: rows, inputs: code, weight, bias },
            });
        Ok(Self { codes, quantizers, quantizer, tables: tables.collect(), trunk })
    }
}
