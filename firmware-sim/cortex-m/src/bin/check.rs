//! The runtime's public road and nothing else: measures code size and finds call sites of panics.
//!
//! Blob, arena and request come through pointers that the optimiser cannot see through, so nothing of the runtime is
//! folded away. The image is linked and inspected, never run. With the feature `gate` its panic handler calls a symbol
//! that nobody defines, so that one reachable panic fails the link.
#![no_std]
#![no_main]

use core::{hint::black_box, panic::PanicInfo};

use cortex_m as _;
use cortex_m_rt::entry;
use motionette::{
    Anchor, Error, Flow, Generator, Limits, Model, Observer, Plan, Progress, Request, Source, StreamLimits, StreamPlan,
    refining::Config,
};

/// An observer whose answer the optimiser cannot know.
struct Watch(Flow);

impl Observer for Watch {
    fn progress(&mut self, progress: Progress) -> Flow {
        black_box(progress);
        black_box(self.0)
    }
}

/// Everything a firmware may ask for.
#[inline(never)]
fn serve(blob: &[u8], arena: &mut [u8], tokens: &[u16], u: &[f32], anchors: &[Anchor]) -> Result<u64, Refused> {
    let model = Model::open(blob).map_err(Refused::Blob)?;
    let refinement = black_box(Config::default());
    let limits = Limits { tokens: tokens.len(), anchors: anchors.len(), refinement, planning: None };
    black_box(Plan::for_request(&model, &limits));
    let mut generator = Generator::new(model, arena).map_err(Refused::Request)?;
    black_box(generator.self_test().map_err(Refused::Request)?);
    let sources = [Source::Tokens(tokens), Source::Embeddings(u)];
    let mut hash = 0;
    for source in black_box(sources) {
        let request = Request { source, anchors, refinement: black_box(Some(refinement)) };
        black_box(generator.plan(&request).map_err(Refused::Request)?);
        let motion = generator.generate(&request, &mut Watch(Flow::Continue)).map_err(Refused::Request)?;
        black_box(motion.frames());
        hash ^= motion.hash();
    }
    Ok(hash ^ stream(&mut generator, tokens)?)
}

/// The same of a motion made piece by piece.
#[inline(never)]
fn stream(generator: &mut Generator<'_>, tokens: &[u16]) -> Result<u64, Refused> {
    let limits = black_box(StreamLimits { tokens: tokens.len() });
    black_box(StreamPlan::new(generator.model(), &limits));
    let mut stream = generator.stream(&limits).map_err(Refused::Request)?;
    let mut hash = 0;
    for last in black_box([false, true]) {
        black_box((stream.room(), stream.frames_ahead(), stream.rebase()));
        stream.push(tokens).map_err(Refused::Request)?;
        if last {
            stream.finish();
        }
        while let Some(frames) = stream.frames(&mut Watch(Flow::Continue)).map_err(Refused::Request)? {
            hash += black_box(frames).len() as u64;
        }
    }
    Ok(hash)
}

/// Why there was no motion; the fields are read through [`black_box`] only.
#[derive(Clone, Copy)]
#[expect(dead_code, reason = "never run, only linked")]
enum Refused {
    Blob(motionette::blob::Error),
    Request(Error),
}

#[entry]
fn main() -> ! {
    let mut arena = [0u8; 64];
    let anchors = [Anchor::root(0, [0.0; 3])];
    let result = serve(black_box(&[]), black_box(&mut arena), black_box(&[0]), black_box(&[]), black_box(&anchors));
    let _ = black_box(result);
    loop {
        cortex_m::asm::nop();
    }
}

#[cfg(not(feature = "gate"))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        cortex_m::asm::nop();
    }
}

#[cfg(feature = "gate")]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        safe fn a_panic_is_reachable() -> !;
    }
    a_panic_is_reachable()
}
