//! The oracle of the planner and what it reads: text encoder, anchor control, transformer and sampler in f64, from the blob's weights as
//! real numbers, with the softmax over the whole row, nothing quantised, and nothing shared with the runtime.

use motionette::blob::{Activation, Norm, TransformerConfig};

use motionette::Anchor;

use crate::naive_scaffold;
use crate::tiny::{Block, Layer, NormWeights, Tiny};

/// Rows of numbers.
pub type Rows = Vec<Vec<f64>>;

/// `W x + b`.
fn linear(layer: &Layer, x: &[f64]) -> Vec<f64> {
    let row = |n: usize| &layer.weights[n * layer.inputs..(n + 1) * layer.inputs];
    (0..layer.outputs).map(|n| row(n).iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + layer.biases[n]).collect()
}

fn normed((weight, bias): &NormWeights, epsilon: f64, x: &[f64]) -> Vec<f64> {
    let count = x.len() as f64;
    let mean = x.iter().sum::<f64>() / count;
    let variance = x.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / count;
    let scale = (variance + epsilon).sqrt();
    x.iter().zip(weight.iter().zip(bias)).map(|(x, (w, b))| (x - mean) / scale * w + b).collect()
}

/// `erf` by its series; far out it is 1 to the last bit.
fn erf(x: f64) -> f64 {
    if x.abs() > 6.0 {
        return x.signum();
    }
    let (mut term, mut sum) = (x, x);
    for n in 1..200 {
        term *= -x * x / f64::from(n);
        sum += term / f64::from(2 * n + 1);
    }
    sum * 2.0 / std::f64::consts::PI.sqrt()
}

fn activated(kind: Activation, x: f64) -> f64 {
    match kind {
        Activation::Relu => x.max(0.0),
        Activation::Gelu => 0.5 * x * (1.0 + erf(x / std::f64::consts::SQRT_2)),
    }
}

/// `softmax`.
#[must_use]
pub fn softmax(x: &[f64]) -> Vec<f64> {
    let most = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let e: Vec<f64> = x.iter().map(|x| (x - most).exp()).collect();
    let sum: f64 = e.iter().sum();
    e.iter().map(|e| e / sum).collect()
}

/// Attention of every row of `q` over all rows of `k` and `v`, head by head.
#[must_use]
pub fn attention(heads: usize, q: &Rows, k: &Rows, v: &Rows) -> Rows {
    let width = v[0].len() / heads;
    q.iter()
        .map(|q| {
            let mut out = Vec::new();
            for head in 0..heads {
                let columns = head * width..(head + 1) * width;
                let score = |k: &Vec<f64>| {
                    let dot: f64 = q[columns.clone()].iter().zip(&k[columns.clone()]).map(|(a, b)| a * b).sum();
                    dot / (width as f64).sqrt()
                };
                let p = softmax(&k.iter().map(score).collect::<Vec<_>>());
                out.extend(columns.map(|c| p.iter().zip(v).map(|(p, v)| p * v[c]).sum::<f64>()));
            }
            out
        })
        .collect()
}

fn columns(x: &Rows, first: usize, count: usize) -> Rows {
    x.iter().map(|row| row[first..first + count].to_vec()).collect()
}

/// `x += f(LN x)` or `x = LN(x + f(x))`.
fn sublayer(config: &TransformerConfig, norm: &NormWeights, x: &mut Rows, f: impl Fn(&Rows) -> Rows) {
    let epsilon = f64::from(config.epsilon);
    let input = match config.norm {
        Norm::Pre => x.iter().map(|x| normed(norm, epsilon, x)).collect(),
        Norm::Post => x.clone(),
    };
    for (x, y) in x.iter_mut().zip(f(&input)) {
        for (x, y) in x.iter_mut().zip(y) {
            *x += y;
        }
        if config.norm == Norm::Post {
            *x = normed(norm, epsilon, x);
        }
    }
}

/// `extra` are keys and values that self-attention reads behind the block's own.
fn block(config: &TransformerConfig, b: &Block, x: &mut Rows, extra: Option<&(Rows, Rows)>, memory: &Rows) {
    let (d, heads) = (usize::from(config.width), usize::from(config.heads));
    let all = |layer: &Layer, x: &Rows| x.iter().map(|x| linear(layer, x)).collect::<Rows>();
    sublayer(config, &b.norm1, x, |h| {
        let qkv = all(&b.qkv, h);
        let (mut keys, mut values) = (columns(&qkv, d, d), columns(&qkv, 2 * d, d));
        if let Some((more_keys, more_values)) = extra {
            keys.extend(more_keys.iter().cloned());
            values.extend(more_values.iter().cloned());
        }
        all(&b.out, &attention(heads, &columns(&qkv, 0, d), &keys, &values))
    });
    if let Some((norm, query, keys_values, out)) = &b.cross {
        sublayer(config, norm, x, |h| {
            let kv = all(keys_values, memory);
            all(out, &attention(heads, &all(query, h), &columns(&kv, 0, d), &columns(&kv, d, d)))
        });
    }
    sublayer(config, &b.norm2, x, |h| {
        let up = all(&b.up, h);
        let act = up.iter().map(|row| row.iter().map(|&v| activated(config.activation, v)).collect()).collect();
        all(&b.down, &act)
    });
}

/// Memory and pooled vector of word ids.
///
/// # Panics
/// When the model has no encoder.
#[must_use]
pub fn encode(tiny: &Tiny, words: &[u16]) -> (Rows, Vec<f64>) {
    let config = &tiny.shape.prior.as_ref().expect("a prior").text;
    let (embedding, position, blocks, norm) = tiny.prior.as_ref().and_then(|p| p.encoder.as_ref()).expect("an encoder");
    let add = |(i, w): (usize, &u16)| -> Vec<f64> {
        embedding[usize::from(*w)].iter().zip(&position[i]).map(|(a, b)| a + b).collect()
    };
    let mut x: Rows = words.iter().enumerate().map(add).collect();
    for b in blocks {
        block(config, b, &mut x, None, &Vec::new());
    }
    let memory: Rows = x.iter().map(|x| normed(norm, f64::from(config.epsilon), x)).collect();
    let pooled = (0..memory[0].len()).map(|c| memory.iter().map(|row| row[c]).sum::<f64>() / words.len() as f64);
    let pooled = pooled.collect();
    (memory, pooled)
}

/// Memory and pooled vector of a stored prompt.
///
/// # Panics
/// When there is no such prompt.
#[must_use]
pub fn stored(tiny: &Tiny, index: usize) -> (Rows, Vec<f64>) {
    let mut rows = tiny.prior.as_ref().expect("a prior").bank[index].clone();
    let pooled = rows.pop().expect("a pooled row");
    (rows, pooled)
}

/// Probabilities of lengths 1 and up.
///
/// # Panics
/// When the model has no prior.
#[must_use]
pub fn lengths(tiny: &Tiny, pooled: &[f64]) -> Vec<f64> {
    softmax(&linear(&tiny.prior.as_ref().expect("a prior").length, pooled))
}

/// Probability of every phrase.
///
/// # Panics
/// When the model has no phrases.
#[must_use]
pub fn meanings(tiny: &Tiny, pooled: &[f64]) -> Vec<f64> {
    let layer = tiny.prior.as_ref().and_then(|prior| prior.meaning.as_ref()).expect("phrases");
    linear(layer, pooled).into_iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect()
}

/// What the planner sees beside the text.
#[derive(Debug, Clone, Default)]
pub struct Scene {
    /// Tokens; V is a masked one.
    pub tokens: Vec<u16>,
    /// Which are given.
    pub fixed: Vec<usize>,
    /// Time.
    pub time: f64,
    /// The motion begins in the middle of another.
    pub start_open: bool,
    /// The motion goes on behind its end.
    pub end_open: bool,
    /// How strongly it is guided; of account when the model is told it.
    pub strength: f64,
    /// What conditions it, in order of frames and without duplicates; of account when the model has anchor control.
    pub anchors: Vec<Anchor>,
}

/// What anchors tell the planner: a row for each of its own, and keys and values for each of its blocks.
struct Told {
    shares: Rows,
    blocks: Vec<(Rows, Rows)>,
}

/// The scaffold of anchors, and what follows from it.
fn told(tiny: &Tiny, anchors: &[Anchor], tokens: usize) -> Option<Told> {
    let prior = tiny.shape.prior.as_ref()?;
    let (config, control) = (prior.control.as_ref()?, tiny.control.as_ref()?);
    let each = 1 << tiny.shape.stages;
    let seen: Vec<Anchor> =
        anchors.iter().filter(|a| a.target.family().bit() & config.families != 0).copied().collect();
    if seen.is_empty() {
        return None;
    }
    let c = naive_scaffold::features(&seen, tokens * each, 20.0, &control.mean, &control.std);
    let frames: Rows = c.iter().map(|c| linear(&control.frame, c).into_iter().map(|v| v.max(0.0)).collect()).collect();
    let row = |(l, frames): (usize, &[Vec<f64>])| -> Vec<f64> {
        let merged = linear(&control.merge, &frames.concat());
        merged.iter().zip(&control.position[l]).map(|(a, b)| a + b).collect()
    };
    let mut x: Rows = frames.chunks(each).enumerate().map(row).collect();
    for b in &control.blocks {
        block(&config.scaffold, b, &mut x, None, &Vec::new());
    }
    let h: Rows = x.iter().map(|x| normed(&control.norm, f64::from(config.scaffold.epsilon), x)).collect();
    let d = usize::from(prior.planner.width);
    let blocks = control.anchors.iter().map(|(down, kv)| {
        let rows: Rows = h.iter().map(|h| linear(kv, &linear(down, h))).collect();
        (columns(&rows, 0, d), columns(&rows, d, d))
    });
    let shares = match &control.context {
        None => vec![vec![0.0; d]; 1 + tokens],
        Some((enter, leave, local)) => {
            let mean: Vec<f64> =
                (0..h[0].len()).map(|k| h.iter().map(|h| h[k]).sum::<f64>() / h.len() as f64).collect();
            let hidden: Vec<f64> = linear(enter, &mean).into_iter().map(|v| activated(Activation::Gelu, v)).collect();
            let mut shares = vec![linear(leave, &hidden)];
            shares.extend(h.iter().map(|h| linear(local, h)));
            shares
        }
    };
    Some(Told { shares, blocks: blocks.collect() })
}

/// Logits `[L][V]` of one pass.
///
/// # Panics
/// When the model has no planner.
#[must_use]
pub fn logits(tiny: &Tiny, scene: &Scene, memory: &Rows, pooled: &[f64]) -> Rows {
    let config = &tiny.shape.prior.as_ref().expect("a prior").planner;
    let prior = tiny.prior.as_ref().expect("a prior");
    let [time, boundary, position, end, fixed] = &prior.tables;
    let d = usize::from(config.width);
    let sum = |parts: &[&[f64]]| (0..d).map(|c| parts.iter().map(|p| p[c]).sum::<f64>()).collect::<Vec<f64>>();
    let global = linear(&prior.global, pooled);
    let number = 2 * usize::from(scene.start_open) + usize::from(scene.end_open);
    let mut x = vec![sum(&[&global, &time[((32.0 * scene.time) as usize).min(31)], &boundary[number]])];
    if let Some(table) = &prior.guidance {
        let strength = scene.strength.min(4.0);
        let below = (strength.floor() as usize).min(3);
        let share = strength - below as f64;
        for (c, x) in x[0].iter_mut().enumerate() {
            *x += table[below][c] * (1.0 - share) + table[below + 1][c] * share;
        }
    }
    let nothing = vec![0.0; d];
    for (i, &token) in scene.tokens.iter().enumerate() {
        let token = match &prior.mask {
            Some(mask) if token == tiny.shape.codes => &mask[0],
            _ => &prior.token.weights[usize::from(token) * d..(usize::from(token) + 1) * d],
        };
        let end = if scene.end_open { &nothing } else { &end[scene.tokens.len() - 1 - i] };
        let fixed = if scene.fixed.contains(&i) { &fixed[0] } else { &nothing };
        x.push(sum(&[token, &position[i], end, fixed]));
    }
    let told = told(tiny, &scene.anchors, scene.tokens.len());
    if let Some(told) = &told {
        x.iter_mut().zip(&told.shares).for_each(|(x, s)| x.iter_mut().zip(s).for_each(|(x, s)| *x += s));
    }
    for (i, b) in prior.blocks.iter().enumerate() {
        block(config, b, &mut x, told.as_ref().map(|told| &told.blocks[i]), memory);
    }
    let hidden = x[1..].iter().map(|x| normed(&prior.norm, f64::from(config.epsilon), x));
    hidden.map(|h| linear(&prior.token, &h)).collect()
}

/// `dist(i, x) = (2 - 2 cos(e_i, e_x))^2` over codes `[V][du]`.
#[must_use]
pub fn distance(codes: &[f64], width: usize, i: usize, x: usize) -> f64 {
    let code = |i: usize| &codes[i * width..(i + 1) * width];
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let cosine = dot(code(i), code(x)) / (dot(code(i), code(i)) * dot(code(x), code(x))).sqrt();
    (2.0 - 2.0 * cosine).powi(2)
}

/// `beta(t) = c (t / (1 - t))^a`.
#[must_use]
pub fn beta(t: f64, c: f64, a: f64) -> f64 {
    c * (t / (1.0 - t)).powf(a)
}

/// Distribution of the token that `present` becomes in a step from `t` to `t + h` towards `proposal`: equations 18 and 21
/// to 23 with `beta(t + h) - beta(t)` for `h beta'(t)` and `q` in the middle of the step.
#[must_use]
pub fn transition(
    codes: &[f64],
    width: usize,
    (present, proposal): (usize, usize),
    (t, h): (f64, f64),
    beta: impl Fn(f64) -> f64,
) -> Vec<f64> {
    let count = codes.len() / width;
    let d = |i: usize| distance(codes, width, i, proposal);
    let middle = beta(t + h / 2.0);
    let q = softmax(&(0..count).map(|i| -middle * d(i)).collect::<Vec<_>>());
    let increase = beta(t + h) - beta(t);
    let u: Vec<f64> = (0..count).map(|i| q[i] * increase * (d(present) - d(i)).max(0.0)).collect();
    let rate: f64 = u.iter().sum();
    let change = 1.0 - (-rate).exp();
    (0..count)
        .map(|i| {
            let stays = if i == present { 1.0 - change } else { 0.0 };
            stays + if rate > 0.0 { change * u[i] / rate } else { 0.0 }
        })
        .collect()
}
