//! A prior made ready to run: a prompt to tokens.

use super::anchors::Anchor;
use super::control::Control;
use super::planner::{Context, Planner, Window};
use super::real::Real;
use super::sampler::Sampler;
use super::text::{self, TextEncoder};
use super::tmd::Settings;
use crate::checkpoint::prior::PriorCheckpoint;
use crate::checkpoint::{ControlCheckpoint, TokenizerCheckpoint};

/// What a motion is planned from: a text, how strongly it guides, anchors, and what is known of the motion.
#[derive(Debug, Clone)]
pub struct Guided<T> {
    conditional: Context<T>,
    /// Of neither text nor anchors: `unconditional + guidance (conditional - unconditional)`; absent when guidance is 1, or the planner is
    /// told it.
    unconditional: Option<Context<T>>,
    guidance: T,
    /// The motion went on before the first token.
    pub start_open: bool,
    /// The motion goes on behind the last token.
    pub end_open: bool,
}

/// Text encoder, planner, its control and sampler.
#[derive(Debug, Clone)]
pub struct Prior<T> {
    /// Prompt to memory.
    pub text: TextEncoder<T>,
    /// Noisy tokens to logits.
    pub planner: Planner<T>,
    /// Anchors to what the planner sees of them.
    pub control: Option<Control<T>>,
    /// Corruption and sampling.
    pub sampler: Sampler<T>,
}

impl<T: Real> Prior<T> {
    /// From a checkpoint and the tokenizer it was trained with ([`PriorCheckpoint::check_tokenizer`] says whether it was).
    #[must_use]
    pub fn new(checkpoint: &PriorCheckpoint, tokenizer: &TokenizerCheckpoint) -> Self {
        let codebook = tokenizer.codebooks.first().map_or(&[][..], Vec::as_slice);
        Self::with_codebook(checkpoint, codebook)
    }

    /// From a checkpoint and a codebook `[V][du]`.
    #[must_use]
    pub fn with_codebook(checkpoint: &PriorCheckpoint, codebook: &[f32]) -> Self {
        let c = &checkpoint.config;
        Self {
            text: TextEncoder::new(checkpoint),
            planner: Planner::new(checkpoint),
            control: None,
            sampler: Sampler::new(c.corruption, (codebook, c.code_dim), (c.c, c.a)),
        }
    }

    /// The same with a control that was trained on it ([`ControlCheckpoint::check_prior`] says whether it was); `rate` is that of the
    /// motion, frames a second.
    #[must_use]
    pub fn controlled(self, checkpoint: &ControlCheckpoint, rate: f64) -> Self {
        Self { control: Some(Control::new(checkpoint, rate)), ..self }
    }

    /// The length the text encoder predicts, tokens.
    #[must_use]
    pub fn length(&self, words: &[u16]) -> usize {
        self.text.length(&self.text.encode(words).pooled)
    }

    /// Makes words ready for planning; guidance 1 means none.
    #[must_use]
    pub fn guided(&self, words: &[u16], guidance: f32) -> Guided<T> {
        let context = |words: &[u16]| self.planner.context(&self.text.encode(words), guidance);
        let two_passes = guidance != 1.0 && !self.planner.one_pass();
        Guided {
            conditional: context(words),
            unconditional: two_passes.then(|| context(&[text::UNCONDITIONAL])),
            guidance: T::from_f32(guidance),
            start_open: false,
            end_open: false,
        }
    }

    /// The same conditioned on anchors in a motion of `tokens` tokens, which is how many must be planned then; what guides is text and
    /// anchors together. Without a control, or when it sees none of the anchors, nothing changes.
    ///
    /// # Panics
    /// For an anchor behind the motion's end, or more tokens than the longest motion has.
    #[must_use]
    pub fn through(&self, mut guided: Guided<T>, anchors: &[Anchor], tokens: usize) -> Guided<T> {
        let context = self.control.as_ref().and_then(|control| control.context(anchors, tokens));
        guided.conditional.anchors = context;
        guided
    }

    /// Logits `[L][V]` over clean tokens, given `tokens` at `time`; `fixed` says which of them are given (missing ones are not).
    #[must_use]
    pub fn logits(&self, guided: &Guided<T>, tokens: &[u16], time: f64, fixed: &[bool]) -> Vec<T> {
        let window = Window { fixed, start_open: guided.start_open, end_open: guided.end_open };
        let mut logits = self.planner.logits(&guided.conditional, tokens, time, window);
        if let Some(context) = &guided.unconditional {
            let without = self.planner.logits(context, tokens, time, window);
            for (with, without) in logits.iter_mut().zip(without) {
                *with = without + guided.guidance * (*with - without);
            }
        }
        logits
    }

    /// Tells `see` what every linear of the planner's blocks reads, by its name in a checkpoint, in one pass for words.
    pub fn observe(&self, words: &[u16], tokens: &[u16], time: f64, see: &mut dyn FnMut(String, &[T])) {
        let text = self.text.encode(words);
        let context = self.planner.context(&text, 1.0);
        let mut layers = 0;
        let _ = self.planner.observe(&context, tokens, time, Window::default(), &mut |layer, name, rows| {
            layers = layers.max(layer + 1);
            see(format!("planner.layers.{layer}.{name}"), rows);
        });
        (0..layers).for_each(|layer| see(format!("planner.layers.{layer}.cross.kv"), &text.memory));
    }

    /// Plans `length` tokens; returns them after every step, the last are the result.
    #[must_use]
    pub fn sample(&self, guided: &Guided<T>, length: usize, settings: &Settings) -> Vec<Vec<u16>> {
        let mut fixed = vec![false; length];
        for &(position, _) in &settings.fixed {
            fixed[position] = true;
        }
        self.sampler.sample(length, settings, |tokens, time| self.logits(guided, tokens, time, &fixed))
    }

    /// Plans `length` tokens of a motion for words.
    #[must_use]
    pub fn generate(&self, words: &[u16], guidance: f32, length: usize, settings: &Settings) -> Vec<u16> {
        self.sample(&self.guided(words, guidance), length, settings).pop().unwrap_or_default()
    }
}
