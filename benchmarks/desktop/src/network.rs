//! The checkpoints as the other libraries take them: chosen channels, planner inputs, and what the reference makes of them.

use anyhow::{Context, Result};
use motionette::channels::Channels;
use motionette::numerics::hash::Stream;
use motionette_host::checkpoint::prior::{Embedding, PriorCheckpoint, TIMES};
use motionette_host::checkpoint::{self, Conv1d, TokenizerCheckpoint};
use motionette_host::reference::planner::Window;
use motionette_host::reference::text::UNCONDITIONAL;
use motionette_host::reference::transformer::Linear;
use motionette_host::reference::{self, Prior};

/// A decoder with a choice of output channels, an input, a gradient, and the reference's results.
pub struct DecoderCase {
    /// Weights with only the chosen output rows.
    pub weights: checkpoint::Decoder,
    /// Chosen channels, how many.
    pub channels: usize,
    /// Code width du.
    pub width: usize,
    /// Tokens L.
    pub tokens: usize,
    /// Frames T.
    pub frames: usize,
    /// Latent `[L][du]`: drawn codes.
    pub latent: Vec<f32>,
    /// `dJ/dfeatures` `[T][channels]`: the features themselves.
    pub gradient: Vec<f32>,
    /// Reference: normalised features `[T][channels]`.
    pub features: Vec<f32>,
    /// Reference: `dJ/dlatent` `[L][du]`.
    pub latent_gradient: Vec<f32>,
}

impl DecoderCase {
    /// Draws `tokens` codes and runs the reference.
    ///
    /// # Errors
    /// When the checkpoint has no codebook.
    pub fn new(source: &TokenizerCheckpoint, channels: &Channels, tokens: usize) -> Result<Self> {
        let mut weights = source.decoder.clone();
        weights.output = chosen(&weights.output, channels);
        let (width, codebook) = (source.config.code_dim, source.codebooks.first().context("no codebook")?);
        let mut stream = Stream::new(1);
        let codes = u32::try_from(source.config.codes)?;
        let latent = (0..tokens)
            .flat_map(|_| codebook.chunks_exact(width).nth(stream.below(codes) as usize).unwrap_or(&[]).to_vec())
            .collect::<Vec<f32>>();
        let decoder = reference::Decoder::<f32>::new(&weights, channels.count());
        let trace = decoder.forward(&latent);
        let (gradient, features) = (trace.features.clone(), trace.features.clone());
        let latent_gradient = decoder.backward(&trace, &gradient);
        let (channels, frames) = (channels.count(), tokens * source.config.frames_per_token());
        Ok(Self { weights, channels, width, tokens, frames, latent, gradient, features, latent_gradient })
    }
}

/// Only the chosen output channels.
fn chosen(conv: &Conv1d, channels: &Channels) -> Conv1d {
    let each = conv.inputs * conv.kernel;
    let rows = || channels.ranges().flat_map(|range| range.first..range.first + range.count);
    Conv1d {
        outputs: channels.count(),
        weight: rows().flat_map(|o| conv.weight[o * each..][..each].to_vec()).collect(),
        bias: rows().map(|o| conv.bias[o]).collect(),
        ..conv.clone()
    }
}

/// One guided pass of the planner over drawn tokens, with the reference's result.
pub struct PlannerCase {
    /// Tokens `[L]`.
    pub tokens: Vec<u16>,
    /// Memory `[n][dt]` of the text and of the prompt that says nothing.
    pub memories: [Vec<f32>; 2],
    /// Rows `[2][1 + L][d]` that the blocks begin with, text first: row 0 differs.
    pub rows: [Vec<f32>; 2],
    /// Width d.
    pub width: usize,
    /// Reference: guided logits `[L][V]`.
    pub logits: Vec<f32>,
}

/// Time of the pass.
pub const TIME: f32 = 0.5;

impl PlannerCase {
    /// Draws `tokens` tokens and runs the reference.
    ///
    /// # Errors
    /// When the prompt cannot be read.
    pub fn new(
        prior: &PriorCheckpoint,
        tokenizer: &TokenizerCheckpoint,
        prompt: &str,
        guidance: f32,
        tokens: usize,
    ) -> Result<Self> {
        let mut stream = Stream::new(2);
        let codes = u32::try_from(prior.config.codes)?;
        let tokens: Vec<u16> = (0..tokens).map(|_| stream.below(codes) as u16).collect();
        let reference = Prior::<f32>::new(prior, tokenizer);
        let words = reference.text.read(prompt)?.ids;
        let (text, unconditional) = (reference.text.encode(&words), reference.text.encode(&[UNCONDITIONAL]));
        let logits =
            reference.logits(&reference.guided(&words, guidance), &tokens, f64::from(TIME), Window::default().fixed);
        let rows = [&text.pooled, &unconditional.pooled].map(|pooled| rows(prior, pooled, &tokens));
        let width = prior.config.planner.width;
        Ok(Self { tokens, memories: [text.memory, unconditional.memory], rows, width, logits })
    }
}

/// What the planner's first block sees of a pooled text and tokens of a whole motion.
fn rows(prior: &PriorCheckpoint, pooled: &[f32], tokens: &[u16]) -> Vec<f32> {
    let planner = &prior.planner;
    let row = |table: &Embedding, id: usize| table.weight[id * table.width..][..table.width].to_vec();
    let sum = |parts: &[Vec<f32>]| -> Vec<f32> {
        (0..parts[0].len()).map(|i| parts.iter().map(|part| part[i]).sum()).collect()
    };
    let time = (TIMES as f32 * TIME) as usize;
    let global = Linear::<f32>::new(&planner.global).forward(pooled);
    let mut rows = sum(&[global, row(&planner.time, time), row(&planner.boundary, 0)]);
    for (i, &token) in tokens.iter().enumerate() {
        let embedding =
            planner.token.weight[usize::from(token) * planner.token.inputs..][..planner.token.inputs].to_vec();
        rows.extend(sum(&[embedding, row(&planner.position, i), row(&planner.end, tokens.len() - 1 - i)]));
    }
    rows
}

/// Largest absolute difference; infinite when the lengths differ.
#[must_use]
pub fn difference(a: &[f32], b: &[f32]) -> f64 {
    if a.len() != b.len() {
        return f64::INFINITY;
    }
    // `max` would hide NaN.
    a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, |most, d| if d <= most { most } else { d })
}
