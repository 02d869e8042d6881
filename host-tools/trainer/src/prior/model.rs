//! Text encoder and planner on the framework: words and corrupted tokens to logits of the clean ones.

use burn::tensor::{Device, Tensor, TensorData};

use super::captions::UNCONDITIONAL;
use super::config::{Architecture, MAX_TOKENS, TIME_BINS};
use crate::transformer::{Attended, Dropout, Guest, Layout, Rows, Weights, padding};

/// Deviation of embeddings at the start.
const EMBEDDING: f64 = 0.1;

/// All parameters in the order of the checkpoint.
pub fn layout(a: &Architecture, vocabulary: usize, codes: usize) -> Layout {
    let mut layout = Layout::default();
    let (text, planner) = (&a.text, &a.planner);
    layout.embedding("text.embedding", vocabulary, text.width, EMBEDDING);
    layout.embedding("text.position", a.max_words, text.width, EMBEDDING);
    layout.blocks("text", text, None);
    layout.norm("text.norm", text.width);
    layout.linear("text.length", MAX_TOKENS, text.width, 0.1);
    layout.linear("planner.global", planner.width, text.width, 1.0);
    for (table, rows) in
        [("time", TIME_BINS), ("boundary", 4), ("position", MAX_TOKENS), ("end", MAX_TOKENS), ("fixed", 1)]
    {
        layout.embedding(&format!("planner.{table}"), rows, planner.width, EMBEDDING);
    }
    layout.blocks("planner", planner, Some(text.width));
    layout.norm("planner.norm", planner.width);
    layout.embedding("planner.token", codes, planner.width, 1.0 / (planner.width as f64).sqrt());
    layout.bias("planner.token", codes);
    layout
}

/// What the planner sees of one motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Example {
    /// Ids of the prompt's words; `[UNCONDITIONAL]` for the empty prompt.
    pub words: Vec<usize>,
    /// Corrupted tokens.
    pub z: Vec<u16>,
    /// Tokens that are clean and stay.
    pub fixed: Vec<bool>,
    /// Time of the corruption, in [0, 1).
    pub t: f32,
    /// Begins in the middle of a motion.
    pub start_open: bool,
    /// Ends in the middle of a motion.
    pub end_open: bool,
}

/// What the networks say of a batch.
pub struct Output {
    /// Logits of the clean tokens, `[B, L, V]`, L the longest of the batch.
    pub tokens: Tensor<3>,
    /// Logits of the length, `[B, 1, MAX_TOKENS]`.
    pub length: Tensor<3>,
}

/// Ids for a padded `[B, window]` table.
fn padded<'e, T: 'e>(
    batch: &'e [Example],
    window: usize,
    fill: usize,
    of: impl Fn(&'e Example, usize) -> Option<T>,
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
    let (size, text, planner) = (batch.len(), &a.text, &a.planner);

    let counts: Vec<usize> = batch.iter().map(|e| e.words.len()).collect();
    let window = counts.iter().copied().max().unwrap_or(1);
    let ids = padded(batch, window, UNCONDITIONAL, |e, i| e.words.get(i), |id| *id);
    let places: Vec<usize> = (0..window).collect();
    let x = weights.rows("text.embedding", &ids).reshape([size, window, text.width])
        + weights.rows("text.position", &places).reshape([1, window, text.width]);
    let mask = padding(&counts, window, device);
    let own = Attended::own(mask.as_ref());
    let memory = weights.norm("text.norm", weights.blocks("text", text, x, own, &mut (), &mut dropout));
    // Mean over the words that are there, as a product with a row of shares.
    let shares: Vec<f32> =
        counts.iter().flat_map(|n| (0..window).map(move |i| if i < *n { 1.0 / *n as f32 } else { 0.0 })).collect();
    let shares: Tensor<3> = Tensor::from_data(TensorData::new(shares, [size, 1, window]), device);
    let pooled = shares.matmul(memory.clone());
    let length = weights.linear("text.length", pooled.clone());

    let lengths: Vec<usize> = batch.iter().map(|e| e.z.len()).collect();
    let window = lengths.iter().copied().max().unwrap_or(1);
    let d = planner.width;
    let rows = |name: &str, ids: &[usize]| weights.rows(name, ids).reshape([size, ids.len() / size, d]);
    let bins: Vec<usize> = batch.iter().map(|e| time_bin(e.t)).collect();
    let boundaries: Vec<usize> =
        batch.iter().map(|e| 2 * usize::from(e.start_open) + usize::from(e.end_open)).collect();
    let global =
        weights.linear("planner.global", pooled) + rows("planner.time", &bins) + rows("planner.boundary", &boundaries);
    let tokens = padded(batch, window, 0, |e, i| e.z.get(i), |z| usize::from(*z));
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
    let x = rows("planner.token", &tokens)
        + weights.rows("planner.position", &places).reshape([1, window, d])
        + rows("planner.end", &to_end) * closed
        + weights.rows("planner.fixed", &[0]).reshape([1, 1, d]) * fixed;
    let x = Tensor::cat(vec![global, x], 1);
    let own: Vec<usize> = lengths.iter().map(|n| n + 1).collect();
    let own = padding(&own, window + 1, device);
    let memory = Some(Rows { rows: &memory, mask: mask.as_ref() });
    let x = weights.blocks("planner", planner, x, Attended { mask: own.as_ref(), memory }, guest, &mut dropout);
    let h = weights.norm("planner.norm", x.narrow(1, 1, window));
    Output { tokens: weights.linear("planner.token", h), length }
}

/// Row of the time table.
pub fn time_bin(t: f32) -> usize {
    ((t * TIME_BINS as f32) as usize).min(TIME_BINS - 1)
}
