//! The standard request of the budgets (`firmware-sim/src/standard_request.rs`), between the marks that
//! `firmware-sim/twin/count.c` counts instructions between: the model opened, the whole request, then the same request once
//! more stage by stage, then with as many rows at a time as may be.
#![no_std]
#![no_main]

use core::ops::ControlFlow;
use core::panic::PanicInfo;

use cortex_m_rt::entry;
use motionette::MOST_ROWS;
use motionette::{Anchor, Generator, MAX_ANCHORS, Model, Observer, Progress, Request, Stage, Stop, blob::Aligned};
use motionette_cortex_m::{stack, standard_request};
use semihosting::{println, process::exit};

const MODEL: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/model.blob"));

#[unsafe(link_section = ".blob")]
static BLOB: Aligned<[u8; MODEL.len()]> = Aligned(*include_bytes!(concat!(env!("OUT_DIR"), "/model.blob")));

const ARENA_BYTES: usize = 400 * 1024;
/// Tokens of the standard request.
const TOKENS: usize = standard_request::FRAMES as usize / 4;

/// Ends the region before and begins the one of this number.
macro_rules! mark {
    ($number:literal) => {
        // SAFETY: a hint without effect.
        unsafe { core::arch::asm!(concat!("dbg #", $number)) }
    };
}

/// Marks where stages begin.
struct Stages;

impl Observer for Stages {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        match progress.stage {
            Stage::Reading => mark!("3"),
            Stage::Planning => mark!("4"),
            Stage::Refining => mark!("5"),
            Stage::Decoding => mark!("6"),
        }
        ControlFlow::Continue(())
    }
}

#[entry]
fn main() -> ! {
    let Some(arena) = cortex_m::singleton!(: Aligned<[u8; ARENA_BYTES]> = Aligned([0; ARENA_BYTES])) else { exit(1) };
    match run(&mut arena.0) {
        Ok(()) => exit(0),
        Err(error) => {
            println!("refused: {:?}", error);
            exit(1)
        }
    }
}

// Frames of their own, here and below: what is on the stack while motions are made is to be little more than what makes them.
#[inline(never)]
fn open(arena: &mut [u8]) -> Result<Generator<'_>, motionette::Error> {
    mark!("1");
    let model = Model::open(&BLOB.0);
    mark!("0");
    let Ok(model) = model else { exit(1) };
    Generator::new(model, arena)
}

fn run(arena: &mut [u8]) -> Result<(), motionette::Error> {
    let mut generator = open(arena)?;
    standard(&mut generator)
}

#[inline(never)]
fn standard(generator: &mut Generator<'_>) -> Result<(), motionette::Error> {
    let anchors = standard_request::anchors();
    let request = standard_request::request().through(&anchors);
    let plan = generator.plan(&request)?;
    mark!("2");
    let motion = generator.generate(&request, &mut ())?;
    mark!("0");
    let report = motion.refinement;
    println!(
        "bench hash={} plan_macs={} evaluations={} gradients={} stack={} arena={} generator={}",
        motion.hash(),
        plan.macs,
        report.map_or(0, |r| r.evaluations),
        report.map_or(0, |r| r.gradients),
        stack::high_water(),
        motion.arena_used,
        size_of::<Generator<'_>>()
    );
    let hash = motion.hash();
    generator.generate(&request, &mut Stages)?;
    mark!("0");
    generator.set_rows(MOST_ROWS);
    mark!("7");
    let motion = generator.generate(&request, &mut ())?;
    mark!("0");
    println!("bench roomy_arena={}", motion.arena_used);
    if motion.hash() != hash {
        exit(1);
    }

    let mut tokens = [0; TOKENS];
    tokens.iter_mut().zip(motion.tokens()).for_each(|(to, from)| *to = *from);
    edit(generator, &tokens)
}

/// What the edit alone takes: the same tokens without it, and through as many anchors as there may be.
#[inline(never)]
fn edit(generator: &mut Generator<'_>, tokens: &[u16]) -> Result<(), motionette::Error> {
    let decoded = Request::tokens(tokens).unrefined();
    mark!("8");
    let motion = generator.generate(&decoded, &mut ())?;
    mark!("0");
    let most = core::array::from_fn::<_, MAX_ANCHORS, _>(|i| {
        let (frame, joint) = (6 * i + 5, [0, 20, 21, 15, 7, 8][i % 6]);
        let [x, y, z] = motion.frames()[frame][joint];
        Anchor::joint(frame as u16, joint as u8, [x + 0.1, y - 0.03, z + 0.1])
    });
    let edited = decoded.through(&most);
    mark!("9");
    let motion = generator.generate(&edited, &mut ())?;
    mark!("0");
    let rounds = motion.refinement.and_then(|report| report.edited).map_or(0, |edited| edited.rounds);
    println!("bench edit_rounds={} edit_arena={}", rounds, motion.arena_used);
    Ok(())
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    println!("{}", info);
    exit(101)
}
