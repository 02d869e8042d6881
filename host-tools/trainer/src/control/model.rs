//! Anchors to what the planner reads of them, on the framework.
//!
//! `f = relu(frame c)`, `h = merge [4 frames] + position`, `H = LN(blocks(h))`; AnchorKV: `Ks, Vs = kv_l(down_l(H))` beside each block's
//! own keys and values; dual context: row 0 `+= out(gelu(in(mean H)))`, row 1 + l `+= local(H_l)`.

use burn::tensor::activation::{gelu, relu};
use burn::tensor::{Tensor, TensorData};
use motionette_host::reference::scaffold::WIDTH;

use super::config::{Architecture, Variant};
use crate::prior::config::MAX_TOKENS;
use crate::tokenizer::config::FRAMES_PER_TOKEN;
use crate::transformer::{Attended, Dropout, Guest, KeysValues, Layout, Rows, Sizes, Weights, padding};

/// Deviation of position embeddings at the start.
const EMBEDDING: f64 = 0.1;

/// All parameters in the order of the checkpoint. `memory` is the width of a text's rows.
pub fn layout(a: &Architecture, planner: &Sizes, memory: usize) -> Layout {
    let mut layout = Layout::default();
    let (s, d) = (a.scaffold.width, planner.width);
    layout.linear("control.frame", a.frame_width, WIDTH, 4.0);
    layout.linear("control.merge", s, FRAMES_PER_TOKEN * a.frame_width, 1.0);
    layout.embedding("control.position", MAX_TOKENS, s, EMBEDDING);
    layout.blocks("control", &a.scaffold, None);
    layout.norm("control.norm", s);
    match a.variant {
        Variant::AnchorKv => {
            for layer in 0..planner.layers {
                layout.linear(&format!("control.anchor.{layer}.down"), a.rank, s, 1.0);
                layout.linear(&format!("control.anchor.{layer}.kv"), 2 * d, a.rank, 0.5);
            }
        }
        Variant::Cross => {
            for layer in 0..planner.layers {
                let name = |part: &str| format!("control.cross.{layer}.{part}");
                layout.norm(&name("norm"), d);
                layout.linear(&name("q"), d, d, 1.0);
                layout.linear(&name("kv"), 2 * d, s, 1.0);
                layout.linear(&name("out"), d, d, 0.1);
            }
        }
        Variant::Copy => {
            layout.linear("control.input", d, s, 0.0);
            layout.blocks("control.copy", planner, Some(memory));
            for layer in 0..planner.layers {
                layout.linear(&format!("control.zero.{layer}"), d, d, 0.0);
            }
        }
    }
    // Without dual context it only serves the encoder's first steps.
    layout.linear("control.local", d, s, 0.0);
    if a.context {
        layout.linear("control.global.in", s, s, 1.0);
        layout.linear("control.global.out", d, s, 0.0);
    }
    layout
}

/// A random start; the copy begins as the planner it copies, named parameters of which are `prior`.
pub fn initial<'v>(layout: &Layout, seed: u64, prior: impl Fn(&str) -> Option<&'v [f32]>) -> Vec<f32> {
    let mut values = layout.initial(seed);
    let mut rest = &mut values[..];
    for parameter in &layout.parameters {
        let (own, after) = rest.split_at_mut(parameter.len());
        rest = after;
        if let Some(copied) = parameter.name.strip_prefix("control.copy.").and_then(|n| prior(&format!("planner.{n}")))
        {
            own.copy_from_slice(copied);
        }
    }
    values
}

/// Anchor context of a batch, ready to have its say in the planner.
pub struct Anchored<'w> {
    weights: &'w Weights,
    architecture: &'w Architecture,
    planner: &'w Sizes,
    /// `[B, L, ws]`
    h: Tensor<3>,
    /// `[B, 1, 1, L]`
    mask: Tensor<4>,
    /// `[B, 1, L]`: a row of equal shares of the rows that are there.
    shares: Tensor<3>,
    copies: Vec<Tensor<3>>,
}

/// What the anchors of a batch look like to the scaffold encoder.
#[derive(Clone, Copy)]
pub struct Scaffold<'b> {
    /// Scaffold features of every motion, `[frames][WIDTH]`.
    pub features: &'b [Vec<f32>],
    /// Tokens of every motion.
    pub lengths: &'b [usize],
}

impl<'w> Anchored<'w> {
    /// Encodes the scaffold of a batch.
    pub fn new(
        architecture: &'w Architecture,
        planner: &'w Sizes,
        weights: &'w Weights,
        Scaffold { features, lengths }: Scaffold<'_>,
        mut dropout: Dropout,
    ) -> Self {
        let device = weights.device();
        let (size, window) = (lengths.len(), lengths.iter().copied().max().unwrap_or(1));
        let frames = FRAMES_PER_TOKEN * window;
        let mut padded = vec![0.0; size * frames * WIDTH];
        for (row, features) in padded.chunks_exact_mut(frames * WIDTH).zip(features) {
            row[..features.len()].copy_from_slice(features);
        }
        let c = Tensor::from_data(TensorData::new(padded, [size, frames, WIDTH]), device);
        let f = relu(weights.linear("control.frame", c));
        let merged = f.reshape([size, window, FRAMES_PER_TOKEN * architecture.frame_width]);
        let places: Vec<usize> = (0..window).collect();
        let position = weights.rows("control.position", &places).reshape([1, window, architecture.scaffold.width]);
        let h = weights.linear("control.merge", merged) + position;
        let mask = padding(lengths, window, device);
        let own = Attended::own(mask.as_ref());
        let h = weights.blocks("control", &architecture.scaffold, h, own, &mut (), &mut dropout);
        let shares: Vec<f32> =
            lengths.iter().flat_map(|n| (0..window).map(move |i| if i < *n { 1.0 / *n as f32 } else { 0.0 })).collect();
        Self {
            weights,
            architecture,
            planner,
            h: weights.norm("control.norm", h),
            mask: mask.unwrap_or_else(|| Tensor::zeros([size, 1, 1, window], device)),
            shares: Tensor::from_data(TensorData::new(shares, [size, 1, window]), device),
            copies: Vec::new(),
        }
    }
}

impl Anchored<'_> {
    /// What anchors alone suggest, in the space of token embeddings, `[B, L, d]`.
    pub fn suggested(&self) -> Tensor<3> {
        self.weights.linear("control.local", self.h.clone())
    }
}

impl Guest for Anchored<'_> {
    fn before(&mut self, mut x: Tensor<3>, attended: Attended<'_>) -> Tensor<3> {
        let w = self.weights;
        if self.architecture.variant == Variant::Copy {
            let [size, _, d] = x.dims();
            let input = w.linear("control.input", self.h.clone());
            let mut copy = x.clone() + Tensor::cat(vec![Tensor::zeros([size, 1, d], w.device()), input], 1);
            let mut off = Dropout::off();
            for layer in 0..self.planner.layers {
                let name = format!("control.copy.layers.{layer}");
                copy = w.block(&name, self.planner.heads, copy, attended, None, &mut off);
                self.copies.push(w.linear(&format!("control.zero.{layer}"), copy.clone()));
            }
        }
        if self.architecture.context {
            let pooled = self.shares.clone().matmul(self.h.clone());
            let global = w.linear("control.global.out", gelu(w.linear("control.global.in", pooled)));
            x = x + Tensor::cat(vec![global, self.suggested()], 1);
        }
        x
    }

    fn keys_values(&mut self, layer: usize) -> Option<KeysValues> {
        if self.architecture.variant != Variant::AnchorKv {
            return None;
        }
        let low = self.weights.linear(&format!("control.anchor.{layer}.down"), self.h.clone());
        let rows = self.weights.linear(&format!("control.anchor.{layer}.kv"), low);
        Some(KeysValues { rows, mask: self.mask.clone() })
    }

    fn behind(&mut self, layer: usize, x: Tensor<3>) -> Tensor<3> {
        match self.architecture.variant {
            Variant::AnchorKv => x,
            Variant::Cross => {
                let name = format!("control.cross.{layer}");
                let rows = Rows { rows: &self.h, mask: Some(&self.mask) };
                let more = self.weights.cross(&format!("{name}.norm"), &name, self.planner.heads, x.clone(), rows);
                x + more
            }
            Variant::Copy => match self.copies.get(layer) {
                Some(copy) => x + copy.clone(),
                None => x,
            },
        }
    }
}
