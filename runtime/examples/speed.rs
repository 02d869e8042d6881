//! What the runtime's parts take on this machine, in milliseconds and multiply-accumulates a second, and a digest of
//! what they computed: the same on every machine.
//!
//! `cargo run --release -p motionette --example speed -- models/nano.blob`

use std::ops::ControlFlow;

use std::error::Error;
use std::hint::black_box;
use std::time::Instant;

use motionette::codec::Decode;
use motionette::generation::tokens::{PlanningLimits, Session};
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::representation::humanml3d;
use motionette::{MOST_ROWS, ROWS};
use motionette::{Model, Planning, Prompt};

/// Timings of each part; the fastest counts.
const RUNS: usize = 100;
const PROMPT: &str = "a person walks forward and waves the right hand";

fn main() -> Result<(), Box<dyn Error>> {
    let bytes = std::fs::read(std::env::args_os().nth(1).ok_or("give a blob")?)?;
    let mut aligned = vec![0u128; bytes.len().div_ceil(16)];
    for (to, from) in bytemuck::cast_slice_mut::<_, u8>(&mut aligned).iter_mut().zip(&bytes) {
        *to = *from;
    }
    let model = Model::open(bytemuck::cast_slice(&aligned))?;
    println!("| part | ms | GMAC/s | digest |");
    println!("|---|---|---|---|");
    for rows in [ROWS, MOST_ROWS] {
        decoder(&model, rows)?;
        planner(&model, rows)?;
    }
    Ok(())
}

/// The decoder's forward pass and gradient at the longest motion, for root channels and for all, so many rows at a time.
fn decoder(model: &Model<'_>, rows: usize) -> Result<(), Box<dyn Error>> {
    let (decoder, tokens) = (model.decoder(), model.max_tokens());
    for (name, joints) in [("root", 1), ("all", u32::MAX)] {
        let channels = humanml3d::channels(joints);
        let mut memory = vec![0u128; decoder.workspace_bytes(tokens, channels.count(), rows).div_ceil(16)];
        let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
        let mut work = decoder.workspace(&mut arena, tokens, channels.count(), rows)?;
        let mut stream = Stream::new(1);
        let codes = u32::try_from(model.codebooks().codes())?;
        let mut u = vec![0.0; tokens * decoder.code_width()];
        for u in u.chunks_exact_mut(decoder.code_width()) {
            for (u, v) in u.iter_mut().zip(model.codebooks().values(stream.below(codes) as usize)) {
                *u = v;
            }
        }
        let mut out = vec![0.0; tokens * model.frames_per_token() * channels.count()];
        let mut du = vec![0.0; u.len()];
        let macs = decoder.macs(tokens, &channels, rows);
        let seconds = fastest(|| {
            let _ = decoder.forward(black_box(&u), &channels, &mut out, &mut work, &mut || ControlFlow::Continue(()));
        });
        report(&format!("decoder forward, {name} channels, {rows} rows at a time"), seconds, macs, &out);
        let seconds = fastest(|| {
            let _ = decoder.forward(black_box(&u), &channels, &mut out, &mut work, &mut || ControlFlow::Continue(()));
            let _ = decoder.backward(&out, &channels, &mut du, &mut work, &mut || ControlFlow::Continue(()));
        });
        report(
            &format!("decoder forward and gradient, {name} channels, {rows} rows at a time"),
            seconds,
            2 * macs,
            &du,
        );
    }
    Ok(())
}

/// One planner pass at the longest motion, without guidance, and what follows it, for few of its rows at a time and for many.
fn planner(model: &Model<'_>, rows: usize) -> Result<(), Box<dyn Error>> {
    let Some(modules) = model.planning() else { return Ok(()) };
    let tokens = model.max_tokens();
    let limits =
        PlanningLimits { words: PROMPT.split(' ').count(), steps: 1, guided: false, anchors: false, clauses: 1 };
    let mut memory = vec![0u128; modules.bytes(tokens, &limits, rows).all().div_ceil(16)];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
    let mut session = Session::new(modules, &mut arena, tokens, &limits, rows)?;
    let _ = session.read(&Prompt::Text(PROMPT), &mut || ControlFlow::Continue(()))?;
    let planning = Planning { guidance: 1.0, ..Planning::DEFAULT };
    let mut stream = Stream::new(2);
    let mut ids = vec![0; tokens];
    session.begin(&planning, &mut stream, &mut ids);
    let seconds = fastest(|| {
        let _ = session.pass(black_box(&ids), 0.5, &planning, &mut || ControlFlow::Continue(()));
    });
    let macs = modules.planner.pass_macs(tokens, 0, limits.words);
    report(&format!("planner pass, {rows} rows at a time"), seconds, macs, session.logits(tokens - 1));
    let seconds = fastest(|| session.advance(&planning, Some(2), &mut stream, &mut ids));
    let drawn: Vec<f32> = ids.iter().map(|&id| f32::from(id)).collect();
    let macs = tokens as u64 * modules.planner.logits_macs();
    report("logits, proposals, step", seconds, macs, &drawn);
    Ok(())
}

/// Seconds of the fastest run.
fn fastest(mut run: impl FnMut()) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..RUNS {
        let start = Instant::now();
        run();
        best = best.min(start.elapsed().as_secs_f64());
    }
    best
}

fn report(part: &str, seconds: f64, macs: u64, values: &[f32]) {
    // FNV-1a over the bits.
    let digest = values.iter().fold(0xcbf2_9ce4_8422_2325_u64, |digest, value| {
        (digest ^ u64::from(value.to_bits())).wrapping_mul(0x0100_0000_01b3)
    });
    println!("| {part} | {:.3} | {:.2} | {digest:016x} |", 1e3 * seconds, macs as f64 / seconds / 1e9);
}
