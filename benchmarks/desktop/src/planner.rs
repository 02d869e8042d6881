//! The planner over any [`Engine`]: rows to guided logits.

use anyhow::{Context, Result, ensure};
use motionette_host::checkpoint::prior::{self, Activation, NormOrder, PriorCheckpoint};
use motionette_host::reference::transformer::Linear;

use crate::engine::Engine;

/// A block, and what it sees of the text and of the prompt that says nothing: keys and values.
struct Block<E: Engine> {
    norm1: E::Norm,
    qkv: E::Linear,
    output: E::Linear,
    norm_cross: E::Norm,
    query: E::Linear,
    memories: [[E::Value; 2]; 2],
    cross_output: E::Linear,
    norm2: E::Norm,
    expand: E::Linear,
    contract: E::Linear,
}

/// A planner with its weights in an engine, and a text that was read.
pub struct Planner<E: Engine> {
    blocks: Vec<Block<E>>,
    norm: E::Norm,
    token: E::Linear,
    width: usize,
    heads: usize,
    guidance: f32,
}

impl<E: Engine> Planner<E> {
    /// Makes a checkpoint's weights and two memories `[n][dt]`, of the text and of the prompt that says nothing, ready.
    ///
    /// # Errors
    /// The library's, and for checkpoints of another form than pre-norm with GELU.
    pub fn new(engine: &mut E, source: &PriorCheckpoint, memories: [&[f32]; 2], guidance: f32) -> Result<Self> {
        let (config, form) = (&source.config.planner, source.config.form());
        ensure!(
            form.norm == NormOrder::Pre && form.activation == Activation::Gelu,
            "the planner has another form than pre-norm with GELU; give a checkpoint of that form"
        );
        let width = config.width;
        let mut block = |block: &prior::Block| -> Result<Block<E>> {
            let cross = block.cross.as_ref().context("a planner block without cross-attention")?;
            let key_value = Linear::<f32>::new(&cross.key_value);
            let mut memory = |memory: &[f32]| -> Result<[E::Value; 2]> {
                let both = engine.constant(&key_value.forward(memory), 2 * width)?;
                Ok([engine.columns(&both, 0, width)?, engine.columns(&both, width, width)?])
            };
            Ok(Block {
                memories: [memory(memories[0])?, memory(memories[1])?],
                norm1: engine.norm_weights(&block.norm1, form.epsilon)?,
                qkv: engine.linear_weights(&block.qkv)?,
                output: engine.linear_weights(&block.output)?,
                norm_cross: engine.norm_weights(&cross.norm, form.epsilon)?,
                query: engine.linear_weights(&cross.query)?,
                cross_output: engine.linear_weights(&cross.output)?,
                norm2: engine.norm_weights(&block.norm2, form.epsilon)?,
                expand: engine.linear_weights(&block.expand)?,
                contract: engine.linear_weights(&block.contract)?,
            })
        };
        let blocks = source.planner.layers.iter().map(&mut block).collect::<Result<_>>()?;
        Ok(Self {
            blocks,
            norm: engine.norm_weights(&source.planner.norm, form.epsilon)?,
            token: engine.linear_weights(&source.planner.token)?,
            width,
            heads: config.heads,
            guidance,
        })
    }

    /// Rows `[1 + L][d]`, as the text and as the prompt that says nothing make them, to guided logits `[L][V]`: two passes.
    ///
    /// # Errors
    /// The library's.
    pub fn forward(&self, engine: &mut E, [text, none]: [&E::Value; 2]) -> Result<E::Value> {
        let [text, none] = [self.hidden(engine, text, 0)?, self.hidden(engine, none, 1)?];
        // Logits are affine in the hidden rows, so these can be guided instead.
        let guided = engine.extrapolate(&none, &text, self.guidance)?;
        engine.linear(&self.token, &guided)
    }

    fn hidden(&self, engine: &mut E, rows: &E::Value, memory: usize) -> Result<E::Value> {
        let mut x = rows.clone();
        for block in &self.blocks {
            let h = engine.norm(&block.norm1, &x)?;
            let qkv = engine.linear(&block.qkv, &h)?;
            let q = engine.columns(&qkv, 0, self.width)?;
            let k = engine.columns(&qkv, self.width, self.width)?;
            let v = engine.columns(&qkv, 2 * self.width, self.width)?;
            let h = engine.attend(&q, &k, &v, self.heads)?;
            let h = engine.linear(&block.output, &h)?;
            x = engine.add(&x, &h)?;

            let h = engine.norm(&block.norm_cross, &x)?;
            let q = engine.linear(&block.query, &h)?;
            let [k, v] = &block.memories[memory];
            let h = engine.attend(&q, k, v, self.heads)?;
            let h = engine.linear(&block.cross_output, &h)?;
            x = engine.add(&x, &h)?;

            let h = engine.norm(&block.norm2, &x)?;
            let h = engine.linear(&block.expand, &h)?;
            let h = engine.gelu(&h)?;
            let h = engine.linear(&block.contract, &h)?;
            x = engine.add(&x, &h)?;
        }
        let x = engine.rows_from(&x, 1)?;
        engine.norm(&self.norm, &x)
    }
}
