//! What training lowers: a contrastive term between motions and sentences, and cross-entropies of content and style.
//!
//! Contrastive (InfoNCE): with `s_ij` the cosine of motion i and sentence j over the temperature, the mean over i of
//! `-ln(exp s_ii / sum_j exp s_ij)` and of the same with rows and columns exchanged, halved. A pair of one content, side and style, or of one
//! sentence, is not in the sum: it is neither the pair asked for nor a wrong one.

use burn::tensor::activation::log_softmax;
use burn::tensor::{Device, Tensor, TensorData};
use serde::{Deserialize, Serialize};

use super::config::Config;
use super::corpus::Batch;
use super::model::MotionOutput;

/// Added to similarities that are not in the sum.
const EXCLUDED: f32 = -1e4;

/// Terms of the objective.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Terms {
    /// InfoNCE.
    pub contrastive: f32,
    /// Cross-entropy of the content.
    pub content: f32,
    /// Cross-entropy of the style.
    pub style: f32,
    /// Their weighted sum.
    pub total: f32,
}

/// What a step lowers.
pub struct Objective {
    /// The weighted sum, as the root of a graph.
    pub total: Tensor<1>,
    /// Its terms.
    pub terms: Terms,
}

/// The objective of a batch.
pub fn objective(motion: MotionOutput, text: Tensor<2>, batch: &Batch, config: &Config, device: &Device) -> Objective {
    let n = batch.lengths.len();
    let similarity = motion.embedding.matmul(text.transpose()).div_scalar(config.temperature);
    let similarity =
        similarity + square(excluded(batch).into_iter().map(|x| if x { EXCLUDED } else { 0.0 }), n, device);
    let diagonal = square((0..n * n).map(|i| if i % (n + 1) == 0 { 1.0 } else { 0.0 }), n, device);
    let rows = log_softmax(similarity.clone(), 1) + log_softmax(similarity, 0);
    let contrastive = (rows * diagonal).sum().mul_scalar(-0.5 / n as f32);
    let content = cross_entropy(motion.content, &batch.contents, device);
    let style = cross_entropy(motion.style, &batch.styles, device);
    let total =
        contrastive.clone() + content.clone().mul_scalar(config.content) + style.clone().mul_scalar(config.style);
    let value = |tensor: &Tensor<1>| tensor.clone().into_scalar::<f32>();
    let terms = Terms {
        contrastive: value(&contrastive),
        content: value(&content),
        style: value(&style),
        total: value(&total),
    };
    Objective { total, terms }
}

/// `[B][B]`: pairs that are neither right nor wrong. Never the diagonal.
pub(super) fn excluded(batch: &Batch) -> Vec<bool> {
    let n = batch.lengths.len();
    let same_label = |i: usize, j: usize| {
        batch.contents[i].is_some()
            && batch.contents[i] == batch.contents[j]
            && batch.sides[i] == batch.sides[j]
            && batch.styles[i] == batch.styles[j]
    };
    let same = |i: usize, j: usize| same_label(i, j) || batch.sentences[i] == batch.sentences[j];
    (0..n * n).map(|k| (k / n, k % n)).map(|(i, j)| i != j && same(i, j)).collect()
}

fn square(values: impl Iterator<Item = f32>, n: usize, device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values.collect::<Vec<_>>(), [n, n]), device)
}

/// Mean of `-ln softmax(logits)[target]` over the rows that have a target; 0 without any.
fn cross_entropy(logits: Tensor<2>, targets: &[Option<usize>], device: &Device) -> Tensor<1> {
    let [rows, classes] = logits.dims();
    let count = targets.iter().flatten().count().max(1) as f32;
    let mut chosen = vec![0.0f32; rows * classes];
    for (row, target) in chosen.chunks_exact_mut(classes).zip(targets) {
        if let Some(target) = target {
            row[*target] = -1.0 / count;
        }
    }
    let chosen = Tensor::<2>::from_data(TensorData::new(chosen, [rows, classes]), device);
    (log_softmax(logits, 1) * chosen).sum()
}
