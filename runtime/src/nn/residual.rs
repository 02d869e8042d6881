//! Pre-activation residual block, in place: `x <- x + conv2(relu(conv1(relu(x))))` (EQUATIONS, DESIGN section 3).

use super::conv1d::{Conv1d, Rows};
use super::{mask, quantise};
use crate::kernels::wide;

/// A dilated k3 convolution and a k1 convolution around a skip connection.
#[derive(Debug, Clone, Copy)]
pub struct Residual<'a> {
    /// Kernel 3, dilated.
    pub conv1: Conv1d<'a>,
    /// Kernel 1.
    pub conv2: Conv1d<'a>,
}

/// ResidualScratch shared by the layers of a sequence.
#[derive(Debug)]
pub struct ResidualScratch<'a> {
    /// Quantised rows `[R][W]`.
    pub q: &'a mut [i16],
    /// Their scales `[R]`.
    pub scales: &'a mut [f32],
    /// One row, `[W]`.
    pub row: &'a mut [f32],
    /// ResidualScratch of one block.
    pub block: Block<'a>,
}

/// ResidualScratch of the rows that a layer multiplies at a time, `B`.
#[derive(Debug)]
pub struct Block<'a> {
    /// f32 rows, `[B][W]`.
    pub rows: &'a mut [f32],
    /// Quantised rows, `[B][W]`.
    pub q: &'a mut [i16],
    /// Their scales, `[B]`.
    pub scales: &'a mut [f32],
    /// Accumulators, `[B][W]`.
    pub acc: &'a mut [i32],
}

impl Residual<'_> {
    /// The rows that the dilated convolution reads: `relu(x)`, quantised to `q` and `scales`.
    pub fn activate(&self, x: &[f32], q: &mut [i16], scales: &mut [f32], row: &mut [f32], masks: &mut [u32]) {
        let width = self.conv1.inputs().max(1);
        let words = mask::words(width).max(1);
        let limit = quantise::limit(width);
        let rows = x.chunks_exact(width).zip(q.chunks_exact_mut(width)).zip(scales);
        for (((x, q), scale), mask) in rows.zip(masks.chunks_exact_mut(words)) {
            let row = part_mut!(row, ..width);
            for (row, x) in row.iter_mut().zip(x) {
                *row = *x;
            }
            mask::relu(row, mask);
            *scale = quantise::row(row, q, limit);
        }
    }

    /// Adds what the block makes of `input` to `x [B][W]`, which are rows `first..` of the block's own input.
    pub fn add(&self, input: Rows<'_>, first: usize, x: &mut [f32], scratch: &mut Block<'_>, masks: &mut [u32]) {
        let width = self.conv1.inputs().max(1);
        let words = mask::words(width).max(1);
        let rows_per_block = scratch.scales.len();
        // Never zero; written so that the compiler can see it.
        let (block_len, mask_len) = ((rows_per_block * width).max(1), (rows_per_block * words).max(1));
        let limit = quantise::limit(width);
        for (block, (x, masks)) in x.chunks_mut(block_len).zip(masks.chunks_mut(mask_len)).enumerate() {
            let hidden = part_mut!(scratch.rows, ..x.len());
            self.conv1.forward(input, first + block * rows_per_block, hidden, rows_per_block, scratch.acc);
            mask::relu_rows(hidden, masks, width);
            quantise::rows(hidden, width, limit, scratch.q, scratch.scales);
            let count = x.len() / width;
            let rows = Rows { q: part!(scratch.q, ..count * width), scales: part!(scratch.scales, ..count) };
            self.conv2.add_pointwise(rows, x, scratch.acc);
        }
    }

    /// What the dilated convolution's gradient reads: of rows `g [R][W]` of `dJ/d(output)` the rows of `dJ/d(hidden)`, with its
    /// output scales folded in, quantised to `q` and `scales`. `masks` are those of the hidden rows.
    pub fn enter_gradient(
        &self,
        g: &[f32],
        q: &mut [i16],
        scales: &mut [f32],
        row: &mut [f32],
        scratch: &mut Block<'_>,
        masks: &[u32],
    ) {
        let width = self.conv1.inputs().max(1);
        let words = mask::words(width).max(1);
        let rows_per_block = scratch.scales.len();
        let (block_len, mask_len) = ((rows_per_block * width).max(1), (rows_per_block * words).max(1));
        let quantised = q.chunks_mut(block_len).zip(scales.chunks_mut(rows_per_block.max(1)));
        for ((g, masks), (q, scales)) in g.chunks(block_len).zip(masks.chunks(mask_len)).zip(quantised) {
            self.conv2.quantise_gradient(g, scratch.q, scratch.scales, row);
            let count = g.len() / width;
            let outer = Rows { q: part!(scratch.q, ..count * width), scales: part!(scratch.scales, ..count) };
            let hidden = part_mut!(scratch.rows, ..g.len());
            self.conv2.backward(outer, 0, hidden, rows_per_block, scratch.acc);
            mask::gate_rows(hidden, masks, width);
            self.conv1.quantise_gradient(hidden, q, scales, row);
        }
    }

    /// Adds what the block carries back from the `hidden` rows to `g [B][W]`, which are rows `first..` of `dJ/d(output)` and become
    /// `dJ/d(input)`. `masks` are those of the input rows.
    pub fn add_gradient(&self, hidden: Rows<'_>, first: usize, g: &mut [f32], scratch: &mut Block<'_>, masks: &[u32]) {
        let width = self.conv1.inputs().max(1);
        let words = mask::words(width).max(1);
        let rows_per_block = scratch.scales.len();
        let (block_len, mask_len) = ((rows_per_block * width).max(1), (rows_per_block * words).max(1));
        for (block, (g, masks)) in g.chunks_mut(block_len).zip(masks.chunks(mask_len)).enumerate() {
            let dx = part_mut!(scratch.rows, ..g.len());
            self.conv1.backward(hidden, first + block * rows_per_block, dx, rows_per_block, scratch.acc);
            mask::gate_rows(dx, masks, width);
            add(g, dx);
        }
    }
}

/// `x += y`.
fn add(x: &mut [f32], y: &[f32]) {
    wide!({
        for (x, y) in x.iter_mut().zip(y) {
            *x += *y;
        }
    });
}
