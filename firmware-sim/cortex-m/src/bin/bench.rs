//! The bench image: proves on the device that its kernels are the portable ones bit for bit, then runs layers between the
//! marks that `firmware-sim/twin/count.c` counts instructions between. The program `motionette-bench` knows
//! what the regions are.
#![no_std]
#![no_main]

use core::{hint::black_box, panic::PanicInfo};

use cortex_m as _;
use cortex_m_rt::entry;
use motionette::{
    blob::Aligned,
    kernels::{self, check},
    nn::{
        conv1d::{Conv1d, ConvShape, Rows},
        linear::{Linear, Weights},
        quantise, softmax,
    },
    numerics::hash::Stream,
};
use semihosting::{println, process::exit};

/// Rows, and the widest layer.
const ROWS: usize = 49;
const WIDE: usize = 768;
const MOST: usize = 192 * WIDE;
/// Rows that the decoder's layers multiply at a time, unless told otherwise.
const BLOCK: usize = 3 * motionette::ROWS;

/// Everything that layers work on, beside the check's own buffers.
struct Buffers {
    weights: [i8; MOST],
    weights4: Aligned<[u8; 192 * 192 / 2]>,
    scales: [f32; WIDE],
    biases: [f32; WIDE],
    x: [f32; ROWS * 192],
    out: [f32; ROWS * 192],
    q: [i16; ROWS * 192],
    row_scales: [f32; ROWS],
    row: [f32; WIDE],
    acc: [i32; ROWS * 192 + kernels::room(ROWS, 192)],
}

/// Runs something as a region of the counting plugin.
macro_rules! region {
    ($number:literal, $body:expr) => {{
        // SAFETY: a hint without effect.
        unsafe { core::arch::asm!(concat!("dbg #", $number)) };
        $body;
        // SAFETY: as above.
        unsafe { core::arch::asm!("dbg #0") };
    }};
}

#[entry]
fn main() -> ! {
    let Some(memory) = cortex_m::singleton!(: check::Buffers = check::Buffers::new()) else { exit(1) };
    match check::run(&check::CHOSEN, memory) {
        Ok(cases) => println!("bench check={cases}"),
        Err(mismatch) => {
            println!("kernels differ: {:?}", mismatch);
            exit(1)
        }
    }
    let Some(buffers) = cortex_m::singleton!(: Buffers = Buffers {
        weights: [0; MOST],
        weights4: Aligned([0; 192 * 192 / 2]),
        scales: [0.0; WIDE],
        biases: [0.0; WIDE],
        x: [0.0; ROWS * 192],
        out: [0.0; ROWS * 192],
        q: [0; ROWS * 192],
        row_scales: [0.0; ROWS],
        row: [0.0; WIDE],
        acc: [0; ROWS * 192 + kernels::room(ROWS, 192)],
    }) else {
        exit(1)
    };
    buffers.fill();
    linear_49(buffers);
    linear_1(buffers);
    linear4_49(buffers);
    conv_49(buffers);
    transposed_49(buffers);
    region!("11", softmax_rows(black_box(&mut buffers.x)));
    exit(0)
}

impl Buffers {
    fn fill(&mut self) {
        let mut random = Stream::new(1);
        self.weights.fill_with(|| random.below(255) as i8);
        self.weights4.0.fill_with(|| random.below(255) as u8);
        self.scales.fill_with(|| 0.001 + 0.001 * random.unit());
        self.biases.fill_with(|| random.unit() - 0.5);
        self.x.fill_with(|| 4.0 * random.unit() - 2.0);
    }
}

#[inline(never)]
fn linear_49(b: &mut Buffers) {
    let Some(layer) = Linear::new(192, Weights::I8(&b.weights[..192 * 192]), &b.scales[..192], &b.biases[..192]) else {
        return;
    };
    region!("1", linear(&layer, &b.x, &mut b.out, &mut b.q, &mut b.row_scales, &mut b.acc));
    region!("2", kernel(&b.q, &b.weights[..192 * 192], 192, 192, &mut b.acc));
}

#[inline(never)]
fn linear_1(b: &mut Buffers) {
    let Some(layer) = Linear::new(192, Weights::I8(&b.weights), &b.scales, &b.biases) else { return };
    region!("3", linear(&layer, &b.x[..192], &mut b.out[..WIDE], &mut b.q, &mut b.row_scales, &mut b.acc));
    region!("4", kernel(&b.q[..192], &b.weights, 192, WIDE, &mut b.acc));
}

#[inline(never)]
fn linear4_49(b: &mut Buffers) {
    let weights = &b.weights4.0;
    let Some(layer) = Linear::new(192, Weights::I4(weights), &b.scales[..192], &b.biases[..192]) else { return };
    region!("9", linear(&layer, &b.x, &mut b.out, &mut b.q, &mut b.row_scales, &mut b.acc));
    region!("10", {
        for q in b.q.chunks(BLOCK * 192) {
            kernels::linear_s16s4(q, weights, 192, 192, &mut b.acc);
        }
    });
}

#[inline(never)]
fn linear(layer: &Linear<'_>, x: &[f32], out: &mut [f32], q: &mut [i16], scales: &mut [f32], acc: &mut [i32]) {
    let rows = x.len() / layer.inputs();
    quantise::rows(x, layer.inputs(), quantise::limit(layer.inputs()), q, scales);
    let rows = Rows { q: &q[..rows * layer.inputs()], scales: &scales[..rows] };
    layer.forward(rows, out, acc);
}

/// The integer kernel by itself, in the blocks that layers give it.
#[inline(never)]
fn kernel(q: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    for q in q.chunks(BLOCK * inputs) {
        kernels::linear_s16s8(q, w, inputs, outputs, acc);
    }
}

#[inline(never)]
fn transposed(q: &[i16], w: &[i8], inputs: usize, outputs: usize, acc: &mut [i32]) {
    for q in q.chunks(BLOCK * outputs) {
        kernels::linear_transposed_s16s8(q, w, inputs, outputs, acc);
    }
}

#[inline(never)]
fn conv_49(b: &mut Buffers) {
    let shape = ConvShape { taps: 3, dilation: 3, right: 3, inputs: 128, outputs: 128 };
    let weights = &b.weights[..3 * 128 * 128];
    let Some(layer) = Conv1d::new(shape, weights, &b.scales[..128], &b.biases[..128]) else { return };
    let (x, out, q) = (&b.x[..ROWS * 128], &mut b.out[..ROWS * 128], &mut b.q[..ROWS * 128]);
    region!("5", conv(&layer, x, out, q, &mut b.row_scales, &mut b.acc));
    region!("6", {
        for tap in weights.chunks(128 * 128) {
            kernel(q, tap, 128, 128, &mut b.acc);
        }
    });
}

#[inline(never)]
fn conv(layer: &Conv1d<'_>, x: &[f32], out: &mut [f32], q: &mut [i16], scales: &mut [f32], acc: &mut [i32]) {
    quantise::rows(x, layer.inputs(), quantise::limit(layer.inputs()), q, scales);
    layer.forward(Rows { q, scales }, 0, out, BLOCK, acc);
}

#[inline(never)]
fn transposed_49(b: &mut Buffers) {
    let shape = ConvShape { taps: 1, dilation: 1, right: 0, inputs: 192, outputs: 192 };
    let weights = &b.weights[..192 * 192];
    let Some(layer) = Conv1d::new(shape, weights, &b.scales[..192], &b.biases[..192]) else { return };
    region!("7", {
        layer.quantise_gradient(&b.x, &mut b.q, &mut b.row_scales, &mut b.row);
        layer.backward(Rows { q: &b.q, scales: &b.row_scales }, 0, &mut b.out, BLOCK, &mut b.acc);
    });
    region!("8", transposed(&b.q, weights, 192, 192, &mut b.acc));
}

#[inline(never)]
fn softmax_rows(x: &mut [f32]) {
    softmax::rows(x.get_mut(..ROWS * ROWS).unwrap_or(&mut []), ROWS);
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    println!("{}", info);
    exit(101)
}
