//! The digital twin on the device: runs the seeded requests and reports their hashes through defmt over semihosting.
//!
//! Lines that begin with `twin` are read by `motionette-twin` on the host as `key=value` pairs.
#![no_std]
#![no_main]

use core::panic::PanicInfo;

use cortex_m_rt::{ExceptionFrame, entry, exception};
use defmt_semihosting as _;
use motionette::{Generator, Model};
use motionette_cortex_m::{
    stack,
    twin::{self, Digest},
};
use semihosting::process::exit;

/// Begins on the boundary that tensors need.
#[repr(C, align(16))]
struct Aligned<T>(T);

const MODEL: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/model.blob"));

#[unsafe(link_section = ".blob")]
static BLOB: Aligned<[u8; MODEL.len()]> = Aligned(*include_bytes!(concat!(env!("OUT_DIR"), "/model.blob")));

/// Token sequences of recorded motions.
static RECORDED: &[&[u16]] = include!(concat!(env!("OUT_DIR"), "/recorded.rs"));

/// Bytes of the arena: DESIGN's limit for all RAM of requests with up to 32 anchors.
const ARENA_BYTES: usize = 400 * 1024;
/// Value of arena bytes that were never taken.
const ARENA_PAINT: u8 = 0xA5;

/// Exit statuses, besides 0.
mod status {
    /// The program panicked.
    pub const PANIC: i32 = 101;
    /// The processor took a fault.
    pub const FAULT: i32 = 102;
    /// The runtime refused the blob, its self-test or a request.
    pub const REFUSED: i32 = 103;
}

#[entry]
fn main() -> ! {
    let Some(arena) = cortex_m::singleton!(: Aligned<[u8; ARENA_BYTES]> = Aligned([0; ARENA_BYTES])) else {
        exit(status::REFUSED)
    };
    arena.0.fill(ARENA_PAINT);
    run(&mut arena.0);
    run_small(&mut arena.0);
    let touched = arena.0.iter().rposition(|&byte| byte != ARENA_PAINT).map_or(0, |last| last + 1);
    defmt::println!(
        "twin end=1 stack={=usize} arena_high_water={=usize} generator={=usize}",
        stack::high_water(),
        touched,
        size_of::<Generator<'_>>()
    );
    exit(0)
}

/// Runs the requests of the model; its frame holds the generator.
#[inline(never)]
fn run(arena: &mut [u8]) {
    let model = match Model::open(&BLOB.0) {
        Ok(model) => model,
        Err(error) => {
            defmt::error!("blob refused: {}", error);
            exit(status::REFUSED)
        }
    };
    match Generator::new(model, arena) {
        Ok(mut generator) => requests(&mut generator),
        Err(error) => refuse(error),
    }
}

// Its own frame: what requests take is not to lie below the opening of the model.
#[inline(never)]
fn requests(generator: &mut Generator<'_>) {
    match generator.self_test() {
        Ok(None) => defmt::println!("the blob carries no self-test"),
        Ok(Some(true)) => defmt::println!("self-test passed"),
        Ok(Some(false)) => {
            defmt::error!("self-test failed: this machine computes other bits than the one that wrote the blob");
            exit(status::REFUSED)
        }
        Err(error) => refuse(error),
    }
    for index in 0..twin::REQUESTS {
        match twin::run(generator, index, RECORDED) {
            Ok(digest) => report(index, &digest),
            Err(error) => refuse(error),
        }
    }
}

/// Runs the requests of small models.
#[inline(never)]
fn run_small(arena: &mut [u8]) {
    for index in 0..twin::SMALL_REQUESTS {
        match twin::run_small(arena, index) {
            Ok(digest) => report(twin::REQUESTS + index, &digest),
            Err(error) => refuse(error),
        }
    }
}

fn report(index: usize, digest: &Digest) {
    let Digest { numbers, anchors, evaluations, gradients, before, after, arena_used, tokens, u, joints } = digest;
    defmt::println!(
        "twin request={=usize} numbers={=usize} anchors={=usize} evaluations={=u16} gradients={=u16} before={=u32} after={=u32} arena_used={=usize} tokens={=u64} u={=u64} joints={=u64}",
        index,
        numbers,
        anchors,
        evaluations,
        gradients,
        before,
        after,
        arena_used,
        tokens,
        u,
        joints
    );
}

fn refuse(error: motionette::Error) -> ! {
    defmt::error!("refused: {}", error);
    exit(status::REFUSED)
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    defmt::error!("{}", defmt::Display2Format(info));
    exit(status::PANIC)
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    defmt::error!("hard fault at {=u32:#x}", frame.pc());
    exit(status::FAULT)
}
