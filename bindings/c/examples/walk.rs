//! The desktop's side of `walk.c`: the same request in Rust, without the C library, printed in the same words.
//! `cargo xtask c` compares what the two print.

use core::ops::ControlFlow;
use std::{error::Error, fs};

use motionette::{
    Anchor, Generator, Joint, Limits, Model, Observer, Plan, PlanningLimits, Progress, Request, Stop, blob::Aligned,
    refining::Config,
};

/// Counts how often it was asked.
struct Calls(u32);

impl Observer for Calls {
    fn progress(&mut self, _: Progress) -> ControlFlow<Stop> {
        self.0 += 1;
        ControlFlow::Continue(())
    }
}

fn print_cm(what: &str, metres: f32) {
    let hundredths = (metres * 10000.0) as u32;
    println!("{what} {}.{:02} cm", hundredths / 100, hundredths % 100);
}

fn main() -> Result<(), Box<dyn Error>> {
    let file = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/nano.blob"))?;
    let mut blocks = vec![Aligned([0; 16]); file.len().div_ceil(16)];
    for (block, bytes) in blocks.iter_mut().zip(file.chunks(16)) {
        block.0[..bytes.len()].copy_from_slice(bytes);
    }
    // SAFETY: `Aligned<[u8; 16]>` is 16 bytes without padding.
    let (_, blob, _) = unsafe { blocks.align_to::<u8>() };
    let model = Model::open(blob)?;

    let planning = Some(PlanningLimits { words: 8, steps: 5, guided: true, anchors: true, clauses: 1 });
    let plan = Plan::for_request(
        &model,
        &Limits {
            tokens: 15,
            anchors: 2,
            tracked: 0,
            timeline: None,
            refinement: Config::default(),
            planning,
            rows: motionette::ROWS,
        },
    )?;
    println!("plan: {} bytes of arena, {} million multiply-accumulates", plan.arena_bytes, plan.macs / 1_000_000);

    let mut arena = vec![0; plan.arena_bytes + 15];
    let mut generator = Generator::new(model.clone(), &mut arena)?;
    assert_eq!(generator.self_test()?, Some(true), "self-test");
    let wrist = Joint::RightWrist;
    let anchors = [Anchor::root(30, [0.2, 0.9, 1.6]), Anchor::joint(50, wrist.into(), [-0.2, 1.4, 2.8])];
    let request = Request::text("a person walks forward").frames(60).steps(5).seed(7).through(&anchors);
    let mut calls = Calls(0);
    let motion = generator.generate(&request, &mut calls)?;
    let (frames, tokens) = (motion.frames(), motion.tokens().len());
    println!("{} frames, {tokens} tokens, {} calls of progress", frames.len(), calls.0);
    if let Some(understood) = motion.understood() {
        println!("understood as: {}", model.in_words(understood));
    }
    let report = motion.refinement.ok_or("no refinement")?;
    print_cm("control error before refinement", report.before.ok_or("not measured")?.mean);
    print_cm("control error", report.after.ok_or("not measured")?.mean);
    print_cm("right wrist at frame 50, height", frames[50][wrist.index()][1]);
    println!("motion {:016x}", motion.hash());
    Ok(())
}
