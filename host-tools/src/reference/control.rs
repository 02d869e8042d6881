//! Anchors to what the planner sees of them: keys and values for every layer, and rows that are added to its own (EQUATIONS section 3).
//!
//! ```text
//! f[t] = relu(frame c[t])                                    features of scaffold
//! h[l] = merge [f[4l] .. f[4l+3]] + position[l]
//! H    = LN(blocks(h))
//! Ks, Vs of layer m = kv_m(down_m(H))
//! row 0 += out(gelu(in(mean of H))),  row 1 + l += local(H[l])   with dual context
//! ```

use super::anchors::{Anchor, Family};
use super::real::Real;
use super::scaffold::{self, Statistics};
use super::transformer::{Block, Embedding, LayerNorm, Linear, activate};
use crate::checkpoint::control::{ControlCheckpoint, FRAMES};
use crate::checkpoint::prior::Activation;

/// Anchors as the planner sees them: the same in every pass.
#[derive(Debug, Clone, PartialEq)]
pub struct AnchorContext<T> {
    /// A layer each: keys and values `[L][2 d]`.
    pub(super) memories: Vec<Vec<T>>,
    /// What is added to the planner's rows, `[1 + L][d]`; empty without dual context.
    pub(super) rows: Vec<T>,
}

/// Linears of the dual context.
#[derive(Debug, Clone)]
struct DualContext<T> {
    expand: Linear<T>,
    contract: Linear<T>,
    local: Linear<T>,
}

/// The control of a planner.
#[derive(Debug, Clone)]
pub struct Control<T> {
    families: Vec<Family>,
    statistics: Statistics,
    rate: f64,
    frame: Linear<T>,
    merge: Linear<T>,
    position: Embedding<T>,
    layers: Vec<Block<T>>,
    norm: LayerNorm<T>,
    anchors: Vec<[Linear<T>; 2]>,
    context: Option<DualContext<T>>,
}

impl<T: Real> Control<T> {
    /// From a checkpoint; `rate` is that of the motion, frames a second.
    #[must_use]
    pub fn new(checkpoint: &ControlCheckpoint, rate: f64) -> Self {
        let config = &checkpoint.config;
        let block = |b| Block::new(b, config.scaffold.heads, config.form());
        Self {
            families: config.families.clone(),
            statistics: checkpoint.statistics.clone(),
            rate,
            frame: Linear::new(&checkpoint.frame),
            merge: Linear::new(&checkpoint.merge),
            position: Embedding::new(&checkpoint.position),
            layers: checkpoint.layers.iter().map(block).collect(),
            norm: LayerNorm::new(&checkpoint.norm, config.epsilon),
            anchors: checkpoint.anchors.iter().map(|a| [&a.down, &a.key_value].map(Linear::new)).collect(),
            context: checkpoint.context.as_ref().map(|c| DualContext {
                expand: Linear::new(&c.expand),
                contract: Linear::new(&c.contract),
                local: Linear::new(&c.local),
            }),
        }
    }

    /// Whether an anchor is of a family that the control was trained with.
    #[must_use]
    pub fn sees(&self, anchor: &Anchor) -> bool {
        self.families.contains(&anchor.family())
    }

    /// Rows of the scaffold `[L][ws]` of frame features `[4 L][WIDTH]`.
    ///
    /// # Panics
    /// For more tokens than the longest motion has.
    #[must_use]
    pub fn encode(&self, features: &[T]) -> Vec<T> {
        let mut frames = self.frame.forward(features);
        activate(&mut frames, Activation::Relu);
        let mut x = self.merge.forward(&frames);
        for (l, row) in x.chunks_exact_mut(self.merge.outputs).enumerate() {
            self.position.add(l, row);
        }
        for layer in &self.layers {
            layer.forward(&mut x, &[], &[]);
        }
        self.norm.forward(&x)
    }

    /// What the planner sees of anchors inside a motion of `tokens` tokens; `None` when it sees none of them.
    ///
    /// # Panics
    /// For an anchor behind the motion's end, or more tokens than the longest motion has.
    #[must_use]
    pub fn context(&self, anchors: &[Anchor], tokens: usize) -> Option<AnchorContext<T>> {
        let seen: Vec<Anchor> = anchors.iter().copied().filter(|anchor| self.sees(anchor)).collect();
        if seen.is_empty() {
            return None;
        }
        let h = self.encode(&scaffold::features(&seen, FRAMES * tokens, self.rate, &self.statistics));
        let memories = self.anchors.iter().map(|[down, key_value]| key_value.forward(&down.forward(&h))).collect();
        let rows = self.context.as_ref().map_or_else(Vec::new, |c| {
            let width = self.merge.outputs;
            let mut pooled = vec![T::ZERO; width];
            for row in h.chunks_exact(width) {
                pooled.iter_mut().zip(row).for_each(|(p, &v)| *p += v);
            }
            let count = T::from_f64(tokens as f64);
            pooled.iter_mut().for_each(|p| *p = *p / count);
            let mut hidden = c.expand.forward(&pooled);
            activate(&mut hidden, Activation::Gelu);
            [c.contract.forward(&hidden), c.local.forward(&h)].concat()
        });
        Some(AnchorContext { memories, rows })
    }
}
