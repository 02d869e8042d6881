//! T2M-GPT's transformer: condition and tokens so far to logits of the next.

use super::{Block, Builder, Embedding, LayerNorm, Linear, MAX_COUNT, MAX_EXTENT, Options, Result, Sizes, TensorMap};
use super::{check_heads, extents, unbiased};
use crate::checkpoint::error::ErrorKind;
use crate::checkpoint::prior::{Activation, Form, NormOrder};

/// Of its blocks, and of the norm behind them.
pub const FORM: Form = Form { epsilon: 1e-5, norm: NormOrder::Pre, activation: Activation::Gelu };

/// The transformer, its `trans_base` and `trans_head` in one.
#[derive(Debug, Clone, PartialEq)]
pub struct Gpt {
    /// Width, heads, layers of both parts.
    pub sizes: Sizes,
    /// Layers of the first part.
    pub base: usize,
    /// Codes V. Class V of the logits ends the motion.
    pub codes: usize,
    /// A text's vector to the first row.
    pub condition: Linear,
    /// Embeddings of tokens, V + 2 rows.
    pub tokens: Embedding,
    /// Added to all rows, the condition's included: a row a place. As many rows as there may be.
    pub positions: Embedding,
    /// In order of execution.
    pub layers: Vec<Block>,
    /// Behind the last layer.
    pub norm: LayerNorm,
    /// V + 1 logits.
    pub output: Linear,
}

impl Gpt {
    /// Puts it together and checks every tensor against its options.
    ///
    /// # Errors
    /// As [`super::PublishedPlanner::build`].
    pub fn build(map: &TensorMap, options: &Options) -> Result<Self> {
        let builder = Builder { map };
        let width = options.count("embed_dim_gpt", MAX_EXTENT)?;
        let each = options.count("num_layers", MAX_COUNT)?;
        let hidden = width * options.count("ff_rate", MAX_COUNT)?;
        let sizes = Sizes { width, heads: options.count("n_head_gpt", MAX_COUNT)?, layers: 2 * each, hidden };
        check_heads("n_head_gpt", sizes)?;
        let [codes, places] = [options.count("nb_code", MAX_EXTENT)?, options.count("block_size", MAX_EXTENT)?];
        let [_, condition] = extents(map, "trans_base.cond_emb.weight")?;
        let positions = builder.tensor("trans_base.pos_embed.embed", &[places, 1, width])?;
        let layer = |index: usize| {
            let part = if index < each { "trans_base" } else { "trans_head" };
            block(&builder, &format!("{part}.blocks.{}", index % each), sizes)
        };
        if map.names().any(|name| name.starts_with(&format!("trans_base.blocks.{each}."))) {
            let expected = "as many layers as the checkpoint has, which has more".into();
            return Err(ErrorKind::Option { key: "num_layers".into(), value: each.to_string(), expected });
        }
        Ok(Self {
            sizes,
            base: each,
            codes,
            condition: builder.linear("trans_base.cond_emb".into(), width, condition)?,
            tokens: builder.embedding("trans_base.tok_emb", codes + 2, width)?,
            positions: Embedding { name: "trans_base.pos_embed".into(), rows: places, width, weight: positions },
            layers: (0..sizes.layers).map(layer).collect::<Result<_>>()?,
            norm: builder.norm("trans_head.ln_f".into(), width)?,
            output: unbiased(&builder, "trans_head.head", codes + 1, width)?,
        })
    }
}

fn block(builder: &Builder<'_>, name: &str, sizes: Sizes) -> Result<Block> {
    let Sizes { width, hidden, .. } = sizes;
    let parts = ["query", "key", "value"].map(|part| builder.linear(format!("{name}.attn.{part}"), width, width));
    let [query, key, value] = parts;
    let [query, key, value] = [query?, key?, value?];
    Ok(Block {
        norm1: builder.norm(format!("{name}.ln1"), width)?,
        qkv: Linear {
            name: format!("{name}.attn.qkv"),
            outputs: 3 * width,
            inputs: width,
            weight: [query.weight, key.weight, value.weight].concat(),
            bias: [query.bias, key.bias, value.bias].concat(),
        },
        output: builder.linear(format!("{name}.attn.proj"), width, width)?,
        cross: None,
        norm2: builder.norm(format!("{name}.ln2"), width)?,
        expand: builder.linear(format!("{name}.mlp.0"), hidden, width)?,
        contract: builder.linear(format!("{name}.mlp.2"), width, hidden)?,
    })
}
