//! Multi-head attention over segments of keys and values, int8 (DESIGN section 4).
//!
//! Head h of row r: `p = softmax_j(q_r . k_j / sqrt(dh))` over the rows j of all segments, `y_r = sum_j p_j v_j`. Queries
//! become int16 with one scale a (row, head), keys and values are int8 with one scale a (row, head); the values' scales
//! are folded into the probabilities before these become int16. Segments are summed in their order.
//!
//! Where there is room for a second plane, keys and values have 16 bits, `256 high + low`; each plane's products are added in turn, the high one's first.

use super::linear::MOST_ROWS;
use super::{quantise, softmax};
use crate::kernels::{self, linear_s16s8, linear_transposed_s16s8, wide};

/// How a width is split into heads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heads {
    /// Number of heads `H`.
    pub count: usize,
    /// Channels of one, `dh`.
    pub width: usize,
}

/// Keys and values of some rows, to be attended to.
#[derive(Debug, Clone, Copy)]
pub struct Segment<'a> {
    /// Rows `n`.
    pub rows: usize,
    /// Rows that there is room for.
    #[cfg(feature = "autoregressive")]
    pub room: usize,
    /// `[H][n][dh]`
    pub keys: &'a [i8],
    /// `[H][n]`
    pub key_scales: &'a [f32],
    /// `[H][n][dh]`
    pub values: &'a [i8],
    /// `[H][n]`
    pub value_scales: &'a [f32],
    /// Low planes of keys and values; empty where they have 8 bits.
    #[cfg(feature = "wide-layers")]
    pub low: (&'a [i8], &'a [i8]),
}

/// The same while it is written.
#[derive(Debug)]
pub struct SegmentMut<'a> {
    /// Rows `n`.
    pub rows: usize,
    /// `[H][n][dh]`
    pub keys: &'a mut [i8],
    /// `[H][n]`
    pub key_scales: &'a mut [f32],
    /// `[H][n][dh]`
    pub values: &'a mut [i8],
    /// `[H][n]`
    pub value_scales: &'a mut [f32],
    /// Room for low planes of keys and values; empty where they have 8 bits.
    #[cfg(feature = "wide-layers")]
    pub low: (&'a mut [i8], &'a mut [i8]),
}

impl Segment<'_> {
    /// Rows from one head to the next.
    const fn stride(&self) -> usize {
        #[cfg(feature = "autoregressive")]
        return self.room;
        #[cfg(not(feature = "autoregressive"))]
        self.rows
    }

    /// Its first rows alone.
    #[cfg(feature = "autoregressive")]
    #[must_use]
    pub const fn first(self, rows: usize) -> Self {
        Segment { rows, ..self }
    }
}

impl SegmentMut<'_> {
    /// To read from.
    #[must_use]
    pub fn view(&self) -> Segment<'_> {
        Segment {
            rows: self.rows,
            #[cfg(feature = "autoregressive")]
            room: self.rows,
            keys: self.keys,
            key_scales: self.key_scales,
            values: self.values,
            value_scales: self.value_scales,
            #[cfg(feature = "wide-layers")]
            low: (self.low.0, self.low.1),
        }
    }

    /// Stores the keys `[H dh]` of row `row`.
    pub fn put_key(&mut self, heads: Heads, row: usize, key: &[f32]) {
        #[cfg(feature = "wide-layers")]
        if !self.low.0.is_empty() {
            return put_planes(heads, self.rows, row, key, (self.keys, self.low.0), self.key_scales);
        }
        put(heads, self.rows, row, key, self.keys, self.key_scales);
    }

    /// Stores the values `[H dh]` of row `row`.
    pub fn put_value(&mut self, heads: Heads, row: usize, value: &[f32]) {
        #[cfg(feature = "wide-layers")]
        if !self.low.1.is_empty() {
            return put_planes(heads, self.rows, row, value, (self.values, self.low.1), self.value_scales);
        }
        put(heads, self.rows, row, value, self.values, self.value_scales);
    }
}

#[inline(never)]
fn put(heads: Heads, rows: usize, row: usize, x: &[f32], q: &mut [i8], scales: &mut [f32]) {
    for (head, x) in x.chunks_exact(heads.width.max(1)).enumerate() {
        let at = head * rows + row;
        let q = part_mut!(q, at * heads.width..(at + 1) * heads.width);
        if let Some(scale) = scales.get_mut(at) {
            *scale = quantise::row_narrow(x, q);
        }
    }
}

#[cfg(feature = "wide-layers")]
#[inline(never)]
fn put_planes(
    heads: Heads,
    rows: usize,
    row: usize,
    x: &[f32],
    (high, low): (&mut [i8], &mut [i8]),
    scales: &mut [f32],
) {
    for (head, x) in x.chunks_exact(heads.width.max(1)).enumerate() {
        let at = head * rows + row;
        let place = at * heads.width..(at + 1) * heads.width;
        if let Some(scale) = scales.get_mut(at) {
            *scale = quantise::row_planes(x, part_mut!(high, place.clone()), part_mut!(low, place));
        }
    }
}

/// AttentionScratch of [`attend`].
#[derive(Debug)]
pub struct AttentionScratch<'a> {
    /// One head of the queries, `[rows][dh]`.
    pub q: &'a mut [i16],
    /// Its scales, `[rows]`.
    pub scales: &'a mut [f32],
    /// Scores, then probabilities: one a row and key of all segments, `[rows][keys]`, no more rows than [`MOST_ROWS`].
    pub scores: &'a mut [f32],
    /// Probabilities times value scales, `[rows][n]` of one segment at a time.
    pub p: &'a mut [i16],
    /// `[rows][max(keys, dh)]`, and the kernels' room
    pub acc: &'a mut [i32],
}

/// Multiply-accumulates of one query row over `keys` keys.
#[must_use]
pub const fn macs(heads: Heads, keys: usize) -> u64 {
    2 * (heads.count * heads.width * keys) as u64
}

/// Attends from at most [`MOST_ROWS`] rows of queries `q [R][H dh]` to all `segments`; `out [R][H dh]`.
pub fn attend(heads: Heads, q: &[f32], segments: &[Segment<'_>], out: &mut [f32], scratch: &mut AttentionScratch<'_>) {
    let (dh, width) = (heads.width.max(1), (heads.count * heads.width).max(1));
    let keys = segments.iter().fold(0, |sum, s| sum + s.rows);
    let root = 1.0 / kernels::sqrt(dh as f32);
    let rows = q.len() / width;
    out.fill(0.0);
    if keys == 0 || rows > MOST_ROWS {
        return;
    }
    let mut steps = [quantise::Step::default(); MOST_ROWS];
    for head in 0..heads.count {
        let columns = head * dh..(head + 1) * dh;
        let each = q.chunks_exact(width).zip(scratch.q.chunks_exact_mut(dh)).zip(scratch.scales.iter_mut());
        for ((q, to), scale) in each {
            *scale = quantise::row(part!(q, columns.clone()), to, quantise::limit(dh));
        }
        let queries = part!(scratch.q, ..rows * dh);
        let mut first = 0;
        for s in segments {
            let n = s.rows;
            linear_s16s8(
                queries,
                part!(s.keys, head * s.stride() * dh..(head * s.stride() + n) * dh),
                dh,
                n,
                scratch.acc,
            );
            let key_scales = part!(s.key_scales, head * s.stride()..head * s.stride() + n);
            let each = scratch.scores.chunks_exact_mut(keys).zip(scratch.acc.chunks_exact(n.max(1)));
            for ((scores, acc), scale) in each.zip(scratch.scales.iter()).take(rows) {
                let (factor, scores) = (*scale * root, part_mut!(scores, first..));
                wide!({
                    for ((to, acc), key_scale) in scores.iter_mut().zip(acc).zip(key_scales) {
                        *to = *acc as f32 * factor * *key_scale;
                    }
                });
            }
            #[cfg(feature = "wide-layers")]
            if !s.low.0.is_empty() {
                let low = part!(s.low.0, head * s.stride() * dh..(head * s.stride() + n) * dh);
                linear_s16s8(queries, low, dh, n, scratch.acc);
                let each = scratch.scores.chunks_exact_mut(keys).zip(scratch.acc.chunks_exact(n.max(1)));
                for ((scores, acc), scale) in each.zip(scratch.scales.iter()).take(rows) {
                    let factor = *scale * root;
                    for ((to, acc), key_scale) in part_mut!(scores, first..).iter_mut().zip(acc).zip(key_scales) {
                        *to = *to * 256.0 + *acc as f32 * factor * *key_scale;
                    }
                }
            }
            first += n;
        }
        softmax::rows(part_mut!(scratch.scores, ..rows * keys), keys);
        for (scores, step) in scratch.scores.chunks_exact_mut(keys).zip(&mut steps).take(rows) {
            let mut rest = scores.iter_mut();
            for s in segments {
                let value_scales = part!(s.value_scales, head * s.stride()..head * s.stride() + s.rows);
                for (p, scale) in rest.by_ref().take(s.rows).zip(value_scales) {
                    *p *= *scale;
                }
            }
            *step = quantise::step(scores, quantise::limit(keys));
        }
        let mut first = 0;
        for s in segments {
            let n = s.rows;
            let p = part_mut!(scratch.p, ..rows * n);
            for ((p, scores), step) in p.chunks_exact_mut(n.max(1)).zip(scratch.scores.chunks_exact(keys)).zip(&steps) {
                quantise::part(part!(scores, first..first + n), *step, p);
            }
            let values = part!(s.values, head * s.stride() * dh..(head * s.stride() + n) * dh);
            linear_transposed_s16s8(p, values, dh, n, scratch.acc);
            #[cfg(feature = "wide-layers")]
            if !s.low.1.is_empty() {
                for ((out, acc), step) in out.chunks_exact_mut(width).zip(scratch.acc.chunks_exact(dh)).zip(&steps) {
                    let scale = 256.0 * step.scale;
                    for (y, a) in part_mut!(out, columns.clone()).iter_mut().zip(acc) {
                        *y += *a as f32 * scale;
                    }
                }
                let low = part!(s.low.1, head * s.stride() * dh..(head * s.stride() + n) * dh);
                linear_transposed_s16s8(p, low, dh, n, scratch.acc);
            }
            for ((out, acc), step) in out.chunks_exact_mut(width).zip(scratch.acc.chunks_exact(dh)).zip(&steps) {
                let out = part_mut!(out, columns.clone());
                wide!({
                    for (y, a) in out.iter_mut().zip(acc) {
                        *y += *a as f32 * step.scale;
                    }
                });
            }
            first += n;
        }
    }
}
