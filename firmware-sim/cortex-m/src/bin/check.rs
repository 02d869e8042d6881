//! The runtime's public road and nothing else: measures code size and finds call sites of panics.
//!
//! Blob, arena and request come through pointers that the optimiser cannot see through, so nothing of the runtime is
//! folded away. The image is linked and inspected, never run. With the feature `gate` its panic handler calls a symbol
//! that nobody defines, so that one reachable panic fails the link.
#![no_std]
#![no_main]

use core::ops::ControlFlow;
use core::{hint::black_box, panic::PanicInfo};

use cortex_m as _;
use cortex_m_rt::entry;
use motionette::ROWS;
use motionette::{
    Anchor, AnchorList, Error, Fixed, Generator, Limits, Model, Observer, Plan, Planning, Progress, Prompt, Request,
    Sampling, Source, Stop, StreamLimits, StreamPlan, generation::tokens as planning, refining::Config,
};
#[cfg(feature = "playback")]
use motionette::{
    Motion,
    playback::{
        Handles, MotionQueue, Robot, RobotError, When,
        output::{Runner, Sts3215},
        reach,
    },
};

/// An observer whose answer the optimiser cannot know.
struct Watch(ControlFlow<Stop>);

impl Observer for Watch {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        black_box(progress);
        black_box(self.0)
    }

    fn tokens(&mut self, step: u16, tokens: &[u16]) {
        black_box((step, tokens));
    }
}

/// Everything a firmware may ask for.
#[inline(never)]
fn serve(
    blob: &[u8],
    arena: &mut [u8],
    tokens: &[u16],
    u: &[f32],
    anchors: &[Anchor],
    (text, fixed): (&str, &[Fixed]),
) -> Result<u64, Refused> {
    let model = Model::open(blob).map_err(Refused::Blob)?;
    let refinement = black_box(Config::default());
    let planning = black_box(Some(planning::Limits { words: text.len(), steps: 10, guided: true, anchors: true }));
    let limits = Limits { tokens: tokens.len(), anchors: anchors.len(), refinement, planning, rows: ROWS };
    let _ = black_box(Plan::for_request(&model, &limits));
    let mut generator = Generator::new(model, arena).map_err(Refused::Request)?;
    black_box(generator.self_test().map_err(Refused::Request)?);
    let sources = [
        Source::Tokens(tokens),
        Source::Embeddings(u),
        Source::Text(Prompt::Text(text)),
        Source::Text(Prompt::Bank(text)),
    ];
    let samplings = [
        Sampling::Greedy,
        Sampling::Sample { temperature: 1.0, top_k: 5, top_p: 0.9 },
        Sampling::Gumbel { temperature: 1.0 },
    ];
    // By frame or by time: the optimiser cannot know.
    let list = black_box(AnchorList::Frames(anchors));
    let mut hash = 0;
    for source in black_box(sources) {
        let [sampling, ..] = black_box(samplings);
        let planning = black_box(Planning { sampling, fixed, ..Planning::DEFAULT });
        let request = Request { source, anchors: list, refinement: black_box(Some(refinement)), planning };
        black_box(generator.plan(&request).map_err(Refused::Request)?);
        let motion = generator.generate(&request, &mut Watch(ControlFlow::Continue(()))).map_err(Refused::Request)?;
        black_box((motion.frames(), motion.tokens(), motion.words(), motion.unknown_words()));
        black_box(motion.unconditioned_anchors());
        hash ^= motion.hash();
        #[cfg(feature = "playback")]
        black_box(play(blob, &motion).map_err(Refused::Robot)?);
    }
    let limits = black_box(StreamLimits { tokens: tokens.len(), planning, rows: ROWS });
    let _ = black_box(StreamPlan::new(generator.model(), &limits));
    for source in black_box(sources) {
        let [sampling, ..] = black_box(samplings);
        let planning = black_box(Planning { sampling, fixed, ..Planning::DEFAULT });
        let request = black_box(Request { source, anchors: list, refinement: None, planning });
        hash ^= stream(&mut generator, &limits, &request)?;
    }
    Ok(hash)
}

/// A serial port about which the optimiser knows nothing.
#[cfg(feature = "playback")]
struct Port;

#[cfg(feature = "playback")]
impl embedded_io::ErrorType for Port {
    type Error = embedded_io::ErrorKind;
}

#[cfg(feature = "playback")]
impl embedded_io::Read for Port {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Self::Error> {
        black_box(bytes);
        black_box(Ok(1))
    }
}

#[cfg(feature = "playback")]
impl embedded_io::ReadReady for Port {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        black_box(Ok(true))
    }
}

#[cfg(feature = "playback")]
impl embedded_io::Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        black_box(bytes);
        black_box(Ok(bytes.len()))
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<(), Self::Error> {
        black_box(bytes);
        black_box(Ok(()))
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        black_box(Ok(()))
    }
}

/// A motion moves servos.
#[cfg(feature = "playback")]
#[inline(never)]
fn play(bytes: &[u8], motion: &Motion<'_>) -> Result<u32, RobotError> {
    let robot = Robot::open(black_box(bytes))?;
    let mut line = black_box(MotionQueue::<16, 8>::new());
    let Ok(Handles { mut feeder, mut player, control }) = line.split(&robot) else { return Ok(0) };
    for when in black_box([When::Then, When::Now]) {
        let _ = black_box(feeder.play(motion, when));
    }
    let _ = black_box(feeder.begin(black_box(20)));
    for frame in motion.frames() {
        let _ = black_box(feeder.frame(frame));
        black_box(reach(&robot, frame, black_box(&[])));
    }
    let _ = black_box((feeder.end(), feeder.queued(), feeder.free()));
    player.stand_at(black_box(&[0.0]));
    for order in black_box([0, 1, 2, 3]) {
        match order {
            0 => control.stop(),
            1 => control.hold(),
            2 => control.neutral(),
            _ => control.resume(),
        }
        black_box(player.tick());
        black_box(player.stand());
        player.rewind();
    }
    black_box(player.angles().count());
    let mut runner = Runner::new(player, Sts3215::new(Port));
    control.release();
    for _ in 0..black_box(100) {
        let _ = black_box(runner.tick(&mut || black_box(0), black_box(5000)));
    }
    black_box(runner.bus());
    Ok(control.status().ticks)
}

/// A motion made piece by piece.
#[inline(never)]
fn stream(generator: &mut Generator<'_>, limits: &StreamLimits, request: &Request<'_>) -> Result<u64, Refused> {
    let mut stream = generator.stream(limits).map_err(Refused::Request)?;
    let mut frames = 0;
    for last in black_box([false, true]) {
        black_box((stream.room(), stream.frames_ahead(), stream.rebase()));
        let watch = &mut Watch(ControlFlow::Continue(()));
        let planned = if last { stream.plan_last(request, watch) } else { stream.plan(request, watch) };
        black_box(planned.map_err(Refused::Request)?);
        black_box(stream.push(black_box(&[0])).map_err(Refused::Request)?);
        black_box(stream.tokens());
        while let Some(piece) = stream.frames(watch).map_err(Refused::Request)? {
            frames += black_box(piece).len() as u64;
        }
    }
    stream.finish();
    Ok(frames)
}

/// Why there was no motion; the fields are read through [`black_box`] only.
#[derive(Clone, Copy)]
#[expect(dead_code, reason = "never run, only linked")]
enum Refused {
    Blob(motionette::blob::Error),
    Request(Error),
    #[cfg(feature = "playback")]
    Robot(RobotError),
}

#[entry]
fn main() -> ! {
    let mut arena = [0u8; 64];
    let anchors = [Anchor::root(0, [0.0; 3])];
    let fixed = [Fixed { position: 0, token: 0 }];
    // Slices, so that the optimiser does not know their lengths.
    let (blob, tokens, u, text): (&[u8], &[u16], &[f32], &str) = black_box((&[], &[0], &[], "wave"));
    let (anchors, fixed): (&[Anchor], &[Fixed]) = black_box((&anchors, &fixed));
    #[cfg(feature = "planted")]
    black_box(tokens[black_box(7)]);
    let result = serve(blob, black_box(&mut arena), tokens, u, anchors, (text, fixed));
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
