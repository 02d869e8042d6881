//! Text encoder and planner on the framework: words and corrupted tokens to logits of the clean ones.

use burn::tensor::{Device, Tensor, TensorData};

use super::captions::UNCONDITIONAL;
use super::config::{Architecture, Config, MAX_TOKENS, TIME_BINS};
use super::state::Sources;
use crate::transformer::{Attended, Dropout, Guest, Layout, Rows, Weights, padding};
use motionette_host::checkpoint::prior::{SPECIAL, STRENGTHS};

/// Deviation of embeddings at the start.
const EMBEDDING: f64 = 0.1;
/// The row of a masked token.
const MASK: &str = "planner.mask";
/// Gain of the layer that takes words' vectors, which are no longer than 1.
const PROJECTION: f64 = 3.0;

/// All parameters in the order of the checkpoint.
pub fn layout(config: &Config, sources: &Sources) -> Layout {
    let mut layout = Layout::default();
    let a = &config.architecture;
    let (text, planner) = (&a.text, &a.planner);
    let (words, dims) = (sources.vocabulary.len(), sources.word_vectors);
    if dims == 0 {
        layout.embedding("text.embedding", words, text.width, EMBEDDING);
    } else {
        layout.constant("text.vectors", words - SPECIAL, dims);
        layout.constant("text.scales", words - SPECIAL, 1);
        layout.embedding("text.special", SPECIAL, text.width, EMBEDDING);
        layout.linear("text.projection", text.width, dims, PROJECTION);
    }
    layout.embedding("text.position", a.max_words, text.width, EMBEDDING);
    layout.blocks("text", text, None);
    layout.norm("text.norm", text.width);
    layout.linear("text.length", MAX_TOKENS, text.width, 0.1);
    if !sources.meanings.is_empty() {
        layout.linear("text.meaning", sources.meanings.len(), text.width, 0.1);
    }
    layout.linear("planner.global", planner.width, text.width, 1.0);
    for (table, rows) in
        [("time", TIME_BINS), ("boundary", 4), ("position", MAX_TOKENS), ("end", MAX_TOKENS), ("fixed", 1)]
    {
        layout.embedding(&format!("planner.{table}"), rows, planner.width, EMBEDDING);
    }
    if sources.guidance {
        layout.embedding("planner.guidance", STRENGTHS, planner.width, 0.0);
    }
    if !config.corruption.is_near() {
        layout.embedding(MASK, 1, planner.width, EMBEDDING);
    }
    layout.blocks("planner", planner, Some(text.width));
    layout.norm("planner.norm", planner.width);
    layout.embedding("planner.token", sources.codes, planner.width, 1.0 / (planner.width as f64).sqrt());
    layout.bias("planner.token", sources.codes);
    layout
}

/// What the planner sees of one motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Example {
    /// Ids of the prompt's words; `[UNCONDITIONAL]` for the empty prompt.
    pub words: Vec<usize>,
    /// Corrupted tokens; V, behind the codes, is a masked one.
    pub z: Vec<u16>,
    /// Tokens that are clean and stay.
    pub fixed: Vec<bool>,
    /// Time of the corruption, in [0, 1).
    pub t: f32,
    /// Begins in the middle of a motion.
    pub start_open: bool,
    /// Ends in the middle of a motion.
    pub end_open: bool,
    /// Strength of guidance, for a planner that is told it.
    pub strength: f32,
}

/// What the networks say of a batch.
pub struct Output {
    /// Logits of the clean tokens, `[B, L, V]`, L the longest of the batch.
    pub tokens: Tensor<3>,
    /// Logits of the length, `[B, 1, MAX_TOKENS]`.
    pub length: Tensor<3>,
    /// Logits of what the sentence means, `[B, 1, meanings]`, where the prior learns it.
    pub meaning: Option<Tensor<3>>,
}

/// What the text encoder makes of sentences.
pub struct Encoded {
    /// `[B, S, C]`, S the most words of the batch.
    memory: Tensor<3>,
    /// Hides the padding.
    mask: Option<Tensor<4>>,
    /// The mean of the memory, `[B, 1, C]`.
    pooled: Tensor<3>,
}

impl Encoded {
    /// Logits of what the sentences mean, `[B, 1, meanings]`, where the prior learns it.
    pub fn meaning(&self, weights: &Weights) -> Option<Tensor<3>> {
        weights.has("text.meaning.bias").then(|| weights.linear("text.meaning", self.pooled.clone()))
    }
}

/// Rows of `ids [B, S]`: embeddings, or the words' vectors through a linear layer.
fn word_rows(weights: &Weights, ids: &[usize], [size, window, width]: [usize; 3]) -> Tensor<3> {
    if weights.has("text.embedding.weight") {
        return weights.rows("text.embedding", ids).reshape([size, window, width]);
    }
    let known: Vec<usize> = ids.iter().map(|id| id.saturating_sub(SPECIAL)).collect();
    let vectors = weights.rows("text.vectors", &known) * weights.rows("text.scales", &known);
    let dims = vectors.dims()[1];
    let projected = weights.linear("text.projection", vectors.reshape([size, window, dims]));
    let first: Vec<usize> = ids.iter().map(|id| (*id).min(SPECIAL - 1)).collect();
    let special = weights.rows("text.special", &first).reshape([size, window, width]);
    let share: Vec<f32> = ids.iter().map(|id| if *id < SPECIAL { 0.0 } else { 1.0 }).collect();
    let share: Tensor<3> = Tensor::from_data(TensorData::new(share, [size, window, 1]), weights.device());
    special.clone() + (projected - special) * share
}

/// Runs the text encoder over sentences.
pub fn encode(a: &Architecture, weights: &Weights, sentences: &[&[usize]], dropout: &mut Dropout) -> Encoded {
    let device: &Device = weights.device();
    let (size, text) = (sentences.len(), &a.text);
    let counts: Vec<usize> = sentences.iter().map(|words| words.len()).collect();
    let window = counts.iter().copied().max().unwrap_or(1);
    let ids = padded(sentences, window, UNCONDITIONAL, |words, i| words.get(i), |id| *id);
    let places: Vec<usize> = (0..window).collect();
    let x = word_rows(weights, &ids, [size, window, text.width])
        + weights.rows("text.position", &places).reshape([1, window, text.width]);
    let mask = padding(&counts, window, device);
    let own = Attended::own(mask.as_ref());
    let memory = weights.norm("text.norm", weights.blocks("text", text, x, own, &mut (), dropout));
    // Mean over the words that are there, as a product with a row of shares.
    let shares: Vec<f32> =
        counts.iter().flat_map(|n| (0..window).map(move |i| if i < *n { 1.0 / *n as f32 } else { 0.0 })).collect();
    let shares: Tensor<3> = Tensor::from_data(TensorData::new(shares, [size, 1, window]), device);
    let pooled = shares.matmul(memory.clone());
    Encoded { memory, mask, pooled }
}

/// Ids for a padded `[B, window]` table.
fn padded<'e, E, T: 'e>(
    batch: &'e [E],
    window: usize,
    fill: usize,
    of: impl Fn(&'e E, usize) -> Option<T>,
    id: impl Fn(T) -> usize,
) -> Vec<usize> {
    batch.iter().flat_map(|e| (0..window).map(|i| of(e, i).map_or(fill, &id)).collect::<Vec<_>>()).collect()
}

/// Runs text encoder and planner over a batch; `guest` has a say in the planner's blocks.
pub fn forward(
    a: &Architecture,
    weights: &Weights,
    batch: &[Example],
    guest: &mut dyn Guest,
    mut dropout: Dropout,
) -> Output {
    let device: &Device = weights.device();
    let (size, planner) = (batch.len(), &a.planner);
    let sentences: Vec<&[usize]> = batch.iter().map(|e| e.words.as_slice()).collect();
    let encoded = encode(a, weights, &sentences, &mut dropout);
    let meaning = encoded.meaning(weights);
    let Encoded { memory, mask, pooled } = encoded;
    let length = weights.linear("text.length", pooled.clone());

    let lengths: Vec<usize> = batch.iter().map(|e| e.z.len()).collect();
    let window = lengths.iter().copied().max().unwrap_or(1);
    let d = planner.width;
    let rows = |name: &str, ids: &[usize]| weights.rows(name, ids).reshape([size, ids.len() / size, d]);
    let bins: Vec<usize> = batch.iter().map(|e| time_bin(e.t)).collect();
    let boundaries: Vec<usize> =
        batch.iter().map(|e| 2 * usize::from(e.start_open) + usize::from(e.end_open)).collect();
    let mut global =
        weights.linear("planner.global", pooled) + rows("planner.time", &bins) + rows("planner.boundary", &boundaries);
    if weights.has("planner.guidance.weight") {
        // Between two rows of the table.
        let below = |e: &Example| (e.strength as usize).min(STRENGTHS - 2);
        let shares: Vec<f32> = batch.iter().map(|e| e.strength - below(e) as f32).collect();
        let share: Tensor<3> = Tensor::from_data(TensorData::new(shares, [size, 1, 1]), device);
        let first = rows("planner.guidance", &batch.iter().map(below).collect::<Vec<_>>());
        let second = rows("planner.guidance", &batch.iter().map(|e| below(e) + 1).collect::<Vec<_>>());
        global = global + first.clone() + (second - first) * share;
    }
    let places: Vec<usize> = (0..window).collect();
    let to_end = padded(batch, window, 0, |e, i| (e.z.len() - 1).checked_sub(i), |left| left);
    let choose = |of: &dyn Fn(&Example, usize) -> bool| -> Tensor<3> {
        let values: Vec<f32> = batch
            .iter()
            .flat_map(|e| (0..window).map(|i| if of(e, i) { 1.0 } else { 0.0 }).collect::<Vec<f32>>())
            .collect();
        Tensor::from_data(TensorData::new(values, [size, window, 1]), device)
    };
    let closed = choose(&|e, _| !e.end_open);
    let fixed = choose(&|e, i| e.fixed.get(i).copied().unwrap_or(false));
    let mut tokens = padded(batch, window, 0, |e, i| e.z.get(i), |z| usize::from(*z));
    let mut own = None;
    if weights.has(&format!("{MASK}.weight")) {
        let codes = weights.get("planner.token.weight").dims()[0];
        let masked = choose(&|e, i| e.z.get(i).is_some_and(|z| usize::from(*z) == codes));
        // Of the token that stands there nothing is left.
        tokens.iter_mut().for_each(|token| *token = (*token).min(codes - 1));
        own = Some((weights.rows(MASK, &[0]).reshape([1, 1, d]), masked));
    }
    let mut tokens = rows("planner.token", &tokens);
    if let Some((mask, masked)) = own {
        tokens = tokens.clone() + (mask - tokens) * masked;
    }
    let x = tokens
        + weights.rows("planner.position", &places).reshape([1, window, d])
        + rows("planner.end", &to_end) * closed
        + weights.rows("planner.fixed", &[0]).reshape([1, 1, d]) * fixed;
    let x = Tensor::cat(vec![global, x], 1);
    let own: Vec<usize> = lengths.iter().map(|n| n + 1).collect();
    let own = padding(&own, window + 1, device);
    let memory = Some(Rows { rows: &memory, mask: mask.as_ref() });
    let x = weights.blocks("planner", planner, x, Attended { mask: own.as_ref(), memory }, guest, &mut dropout);
    let h = weights.norm("planner.norm", x.narrow(1, 1, window));
    Output { tokens: weights.linear("planner.token", h), length, meaning }
}

/// Row of the time table.
pub fn time_bin(t: f32) -> usize {
    ((t * TIME_BINS as f32) as usize).min(TIME_BINS - 1)
}
