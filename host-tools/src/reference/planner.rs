//! The planner: noisy or masked tokens, a time and a text to logits over clean tokens.
//!
//! Rows are 1 + L: row 0 carries text, time and open ends, row 1 + i token i. Every layer attends over all of them and over the memory
//! of the text. Anchors add rows that self-attention looks at ([`super::control`]).

use super::control::AnchorContext;
use super::real::Real;
use super::text::Encoded;
use super::transformer::{Block, Embedding, LayerNorm, Linear, Segment, add};
use crate::checkpoint::prior::{PriorCheckpoint, STRENGTHS, TIMES};

/// A text, and anchors, as the layers see them: the same in every step.
#[derive(Debug, Clone)]
pub struct Context<T> {
    /// `[d]`
    global: Vec<T>,
    /// A layer each: keys and values `[n][2 d]`.
    memories: Vec<Vec<T>>,
    /// Of a motion of as many tokens as logits are asked for.
    pub(super) anchors: Option<AnchorContext<T>>,
}

/// What is known of a motion besides its text.
#[derive(Debug, Clone, Copy, Default)]
pub struct Window<'a> {
    /// Which tokens are fixed; missing ones are not.
    pub fixed: &'a [bool],
    /// The motion went on before the first token.
    pub start_open: bool,
    /// The motion goes on behind the last token.
    pub end_open: bool,
}

/// The planner.
#[derive(Debug, Clone)]
pub struct Planner<T> {
    /// Codes V.
    pub codes: usize,
    /// Longest motion, tokens.
    pub max_tokens: usize,
    global: Linear<T>,
    time: Embedding<T>,
    boundary: Embedding<T>,
    position: Embedding<T>,
    end: Embedding<T>,
    fixed: Embedding<T>,
    guidance: Option<Embedding<T>>,
    layers: Vec<Block<T>>,
    norm: LayerNorm<T>,
    token: Linear<T>,
    tokens: Embedding<T>,
    mask: Option<Embedding<T>>,
    width: usize,
}

impl<T: Real> Planner<T> {
    /// From a checkpoint.
    #[must_use]
    pub fn new(checkpoint: &PriorCheckpoint) -> Self {
        let (config, p) = (&checkpoint.config, &checkpoint.planner);
        Self {
            codes: config.codes,
            max_tokens: config.max_tokens,
            global: Linear::new(&p.global),
            time: Embedding::new(&p.time),
            boundary: Embedding::new(&p.boundary),
            position: Embedding::new(&p.position),
            end: Embedding::new(&p.end),
            fixed: Embedding::new(&p.fixed),
            guidance: p.guidance.as_ref().map(Embedding::new),
            layers: p.layers.iter().map(|b| Block::new(b, config.planner.heads, config.form())).collect(),
            norm: LayerNorm::new(&p.norm, config.epsilon),
            token: Linear::new(&p.token),
            tokens: Embedding::of_rows(&p.token),
            mask: p.mask.as_ref().map(Embedding::new),
            width: config.planner.width,
        }
    }

    /// Whether the planner is told the strength of guidance, so that one pass is enough.
    #[must_use]
    pub fn one_pass(&self) -> bool {
        self.guidance.is_some()
    }

    /// What every step needs of a text that guides with `strength`, which counts only where the planner is told it.
    #[must_use]
    pub fn context(&self, text: &Encoded<T>, strength: f32) -> Context<T> {
        let mut global = self.global.forward(&text.pooled);
        if let Some(table) = &self.guidance {
            // Between two rows of the table; beyond its end the last one.
            let last = (STRENGTHS - 1) as f32;
            let strength = strength.clamp(0.0, last);
            let below = (strength.floor() as usize).min(STRENGTHS - 2);
            let share = T::from_f32(strength - below as f32);
            for (i, x) in global.iter_mut().enumerate() {
                let (a, b) = (table.row(below)[i], table.row(below + 1)[i]);
                *x += a + share * (b - a);
            }
        }
        Context { global, memories: self.layers.iter().map(|l| l.remember(&text.memory)).collect(), anchors: None }
    }

    /// Logits `[L][V]` over the clean tokens, given `tokens` at time `time` in `0..1`.
    ///
    /// # Panics
    /// For a token outside the codebook that is no masked one, or more than [`Planner::max_tokens`] of them.
    #[must_use]
    pub fn logits(&self, context: &Context<T>, tokens: &[u16], time: f64, window: Window<'_>) -> Vec<T> {
        self.observe(context, tokens, time, window, &mut |_, _, _| ())
    }

    /// The same; `see` is told what each linear of each layer reads, by its name within the layer.
    ///
    /// # Panics
    /// As [`Planner::logits`].
    pub fn observe(
        &self,
        context: &Context<T>,
        tokens: &[u16],
        time: f64,
        window: Window<'_>,
        see: &mut dyn FnMut(usize, &'static str, &[T]),
    ) -> Vec<T> {
        let mut x = context.global.clone();
        self.time.add(((TIMES as f64 * time) as usize).min(TIMES - 1), &mut x);
        self.boundary.add(2 * usize::from(window.start_open) + usize::from(window.end_open), &mut x);
        for (i, &token) in tokens.iter().enumerate() {
            let start = x.len();
            x.extend_from_slice(match &self.mask {
                Some(mask) if usize::from(token) == self.codes => mask.row(0),
                _ => self.tokens.row(usize::from(token)),
            });
            let row = &mut x[start..];
            self.position.add(i, row);
            if !window.end_open {
                self.end.add(tokens.len() - 1 - i, row);
            }
            if window.fixed.get(i).copied().unwrap_or(false) {
                self.fixed.add(0, row);
            }
        }
        if let Some(anchors) = &context.anchors {
            add(&mut x, &anchors.rows);
        }
        for (m, (layer, memory)) in self.layers.iter().zip(&context.memories).enumerate() {
            let anchors = context.anchors.as_ref().and_then(|a| a.memories.get(m));
            let stride = 2 * self.width;
            let extra = anchors.map(|rows| Segment { rows, stride, keys: 0, values: self.width });
            layer.observe(&mut x, memory, extra.as_slice(), &mut |name, rows| see(m, name, rows));
        }
        self.token.forward(&self.norm.forward(&x[self.width..]))
    }
}
